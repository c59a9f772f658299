"""What a path or a GDAL URI leads to, told from its text alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, Literal, NamedTuple

from rasterio._path import _parse_path

Where = Literal["file", "archive", "memory", "network", "unknown"]

_VSI: Final = re.compile(r"/vsi(?=([a-z0-9_]+))", re.IGNORECASE)
_NETWORK: Final = re.compile(r"(curl|s3|gs|az|adls|oss|swift|webhdfs|hdfs)(_streaming)?", re.IGNORECASE)
_SCHEME: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_ARCHIVE_SCHEMES: Final = frozenset(["zip", "tar", "gzip"])
_SUBDATASET: Final = re.compile(
    r'(?:NETCDF|HDF5|GTIFF_DIR:\d+|NITF_IM:\d+):(?:"(?P<quoted>[^"]+)"|(?P<plain>(?:[A-Za-z]:)?[^:]+))(?::.*)?',
    re.DOTALL,
)
_PREFIX: Final = re.compile(r"\w{2,}:")


class Destination(NamedTuple):
    """Where a name leads."""

    where: Where
    path: str
    """The file, or the archive and the file in it as GDAL writes it; the name itself elsewhere."""


def destination(uri: str) -> Destination:
    """Return where a name leads; `unknown`: nobody can tell what GDAL opens for it.

    A vrt:// connection leads where the raster does that it shows.
    """
    if uri.startswith("vrt://"):
        return destination(uri.removeprefix("vrt://").partition("?")[0])
    if uri.startswith("file://"):
        return destination(uri.removeprefix("file://"))
    scheme = _SCHEME.match(uri)
    if not uri.startswith(("/vsi", "<")) and scheme is None and _exists(uri):
        return Destination("file", uri)
    handlers = [match[1] for match in _VSI.finditer(uri)]
    schemes = set(scheme[1].lower().split("+")) if scheme else set()
    if any(map(_NETWORK.fullmatch, handlers)) or "://" in uri[scheme.end() if scheme else 0 :]:
        return Destination("network", uri)
    if schemes:
        archive = schemes <= _ARCHIVE_SCHEMES
        return destination(_parse_path(uri).as_vsi()) if archive else Destination("network", uri)
    if uri.startswith("/vsi"):
        return _in_virtual_file_system(uri, handlers)
    inside = _SUBDATASET.fullmatch(uri)
    if inside is not None:
        return destination(inside["quoted"] or inside["plain"])
    return Destination("unknown" if uri.startswith("<") or _PREFIX.match(uri) else "file", uri)


def _exists(path: str) -> bool:
    try:
        return Path(path).exists()
    except (OSError, ValueError):  # too long or odd for a path
        return False


def _in_virtual_file_system(uri: str, handlers: list[str]) -> Destination:
    if handlers == ["mem"]:
        return Destination("memory", uri)
    if handlers in (["zip"], ["tar"], ["gzip"], ["subfile"], ["subfile", "gzip"]):
        return Destination("archive", uri)
    return Destination("unknown", uri)


def split_archive(uri: str) -> tuple[Path, str] | None:
    """Return the archive of a /vsizip/ or /vsitar/ name and the file in it; None where it is no such name."""
    if not uri.startswith(("/vsizip/", "/vsitar/")):
        return None
    rest = uri[len("/vsizip/") :]
    if rest.startswith("{"):
        archive, _, name = rest[1:].partition("}/")
        return Path(archive), name
    places = [match.start() for match in re.finditer("/", rest[1:])]
    found = ((Path(rest[: place + 1]), rest[place + 2 :]) for place in places)
    return next(((archive, name) for archive, name in found if archive.is_file()), None)
