"""Where paths and GDAL URIs lead: to a file, an archive, memory or a server."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, Literal, NamedTuple

_VSI: Final = re.compile(r"/vsi(?=([a-z0-9_]+))", re.IGNORECASE)
_NETWORK: Final = re.compile(r"(curl|s3|gs|az|adls|oss|swift|webhdfs|hdfs)(_streaming)?", re.IGNORECASE)
_SCHEME: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_ARCHIVE_SCHEMES: Final = frozenset(["zip", "tar", "gzip"])
_SUBDATASET: Final = re.compile(
    r'(?:NETCDF|HDF5|GTIFF_DIR:\d+|NITF_IM:\d+):(?:"(?P<quoted>[^"]+)"|(?P<plain>(?:[A-Za-z]:)?[^:]+))(?::.*)?',
    re.DOTALL | re.IGNORECASE,
)
_HDF5_ARRAY: Final = re.compile(
    r'HDF5:(?:"(?P<quoted>[^"]+)"|(?P<plain>(?:[A-Za-z]:)?[^:"]+))://[^:]*', re.IGNORECASE | re.DOTALL
)
"""GDAL's name of an array of an HDF5 file, whose path begins with two slashes, as no scheme of a server."""
_PREFIX: Final = re.compile(r"\w{2,}:")

Where = Literal["file", "archive", "memory", "network", "unknown"]


class Destination(NamedTuple):
    """What a name refers to."""

    where: Where
    path: str
    """The file, or GDAL's name of a file in an archive; otherwise the name itself."""


def destination(uri: str) -> Destination:
    """Return what a name refers to; `unknown` where it cannot be determined what GDAL would open.

    A vrt:// connection refers to what its raster refers to.
    """
    if uri.startswith("vrt://"):
        return destination(uri.removeprefix("vrt://").partition("?")[0])
    if uri.startswith("file://"):
        return destination(uri.removeprefix("file://"))
    array = _HDF5_ARRAY.fullmatch(uri)
    if array is not None:
        return destination(array["quoted"] or array["plain"])
    scheme = _SCHEME.match(uri)
    if not uri.startswith(("/vsi", "<")) and scheme is None and _exists(uri):
        return Destination("file", uri)
    handlers = [match[1] for match in _VSI.finditer(uri)]
    schemes = set(scheme[1].lower().split("+")) if scheme else set()
    if any(map(_NETWORK.fullmatch, handlers)) or "://" in uri[scheme.end() if scheme else 0 :]:
        return Destination("network", uri)
    if schemes:
        archive = schemes <= _ARCHIVE_SCHEMES
        return destination(gdal_name(uri)) if archive else Destination("network", uri)
    if uri.startswith("/vsi"):
        packed = handlers in (["zip"], ["tar"], ["gzip"], ["subfile"], ["subfile", "gzip"])
        return Destination("memory" if handlers == ["mem"] else "archive" if packed else "unknown", uri)
    inside = _SUBDATASET.fullmatch(uri)
    if inside is not None:
        return destination(inside["quoted"] or inside["plain"])
    return Destination("unknown" if uri.startswith("<") or _PREFIX.match(uri) else "file", uri)


def gdal_name(uri: str) -> str:
    """Return a URI as GDAL names it: ``zip://a.zip!b.tif`` is ``/vsizip/a.zip/b.tif``."""
    scheme = _SCHEME.match(uri)
    parts = scheme[1].lower().split("+") if scheme else []
    if scheme is None or uri.startswith("/vsi") or not set(parts) <= _ARCHIVE_SCHEMES | {"file"}:
        return uri
    archive, _, member = uri[scheme.end() :].rpartition("!")
    place = f"{archive}/{member.lstrip('/')}" if archive else member
    chain = "".join(f"/vsi{part}" for part in parts if part != "file")
    return f"{chain}/{place}" if chain else place


def _exists(path: str) -> bool:
    try:
        return Path(path).exists()
    except (OSError, ValueError):  # too long or odd for a path
        return False


def split_archive(uri: str) -> tuple[Path, str] | None:
    """Return the archive of a /vsizip/ or /vsitar/ name and the file in it; None for other names."""
    if not uri.startswith(("/vsizip/", "/vsitar/")):
        return None
    path = uri[len("/vsizip/") :]
    if path.startswith("{"):
        archive, _, name = path[1:].partition("}/")
        return Path(archive), name
    places = [match.start() for match in re.finditer("/", path[1:])]
    candidates = ((Path(path[: place + 1]), path[place + 2 :]) for place in places)
    return next(((archive, name) for archive, name in candidates if archive.is_file()), None)
