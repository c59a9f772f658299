"""Which files a raster is read from, and whether they change: looked at before the work and after it."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.source import open_raster, plain_uri

HEADER_BYTES: Final = 65536
"""So many bytes from the beginning of a file count as its header."""
MOST_FILES: Final = 200
"""Of one input: a mosaic of more sources is told by the first of them."""
PATIENCE_S: Final = 10.0
"""How long a server may take to name a version."""
_REMOTE: Final = re.compile(r"(?:/vsicurl/)?(?P<url>https?://.+)", re.DOTALL)
_NO_PIXELS: Final = (".aux.xml",)
"""Endings of files that other programs write beside a raster at any time: statistics, as QGIS keeps them."""


@dataclass(frozen=True, slots=True)
class FileIdentity:
    """What tells one content of a file from another, as far as can be seen without reading all of it."""

    path: str
    """Absolute path, or URL; of what lies in an archive, the archive."""
    size: int | None
    """Bytes; None where a server does not tell."""
    modified_ns: int | None
    """Time of the last change, ns since 1970."""
    inode: int | None = None
    device: int | None = None
    """None for a file on a server."""
    etag: str | None = None
    """What the server calls this version of the file; None for a file on a disk."""
    header_sha256: str | None = None
    """Of the first `HEADER_BYTES` bytes, of all bytes of a shorter file; None for a file on a server."""

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> FileIdentity:
        """Build an identity from its entry in report.json, other keys aside."""
        return FileIdentity(**{name: values[name] for name in FileIdentity.__slots__})

    def to_json(self) -> dict[str, object]:
        """Return the entry of report.json."""
        return asdict(self)

    def difference(self, now: FileIdentity | None) -> str | None:
        """Say how a file differs from what it was; None where nothing shows that it does.

        A file's number (inode) counts on the same device only: devices are numbered anew at each start.
        """
        if now is None:
            return "it is gone"
        if _differ(self.size, now.size):
            return f"it had {self.size} bytes and has {now.size}"
        if _differ(self.etag, now.etag):
            return "the server has another version"
        if self.device == now.device and _differ(self.inode, now.inode):
            return "another file has taken its place"
        if _differ(self.modified_ns, now.modified_ns):
            return "it has been written to"
        return "its header is another" if _differ(self.header_sha256, now.header_sha256) else None


def identify(uri: str | os.PathLike[str], *, raster: bool = True) -> tuple[FileIdentity, ...]:
    """Identify the files that an input is read from.

    Parameters
    ----------
    uri : path or GDAL URI
    raster : bool
        Whether it is a raster: then the files that belong to it count too (headers, overviews, masks, the
        sources of a VRT and of those that it names), save statistics beside it (.aux.xml), which hold no
        pixels and which other programs write as they please.

    Returns
    -------
    tuple of FileIdentity
        Empty for what is neither a file nor on a web server (databases, object stores).

    Raises
    ------
    InputError
        If a raster cannot be opened, or one that a VRT names.
    """
    uri = os.fspath(uri)
    found: dict[str, FileIdentity] = {}
    # opened first: what may not be opened is not asked for either
    waiting = [uri, *_files_of(uri)] if raster else [uri]
    seen: set[str] = set()
    while waiting and len(found) < MOST_FILES:
        each = waiting.pop(0)
        if each in seen or each.endswith(_NO_PIXELS):
            continue
        seen.add(each)
        identity = _identify(each, ask_servers=raster)
        if identity is not None:
            found.setdefault(identity.path, identity)
        if raster and each != uri and _is_vrt(each):
            waiting += _files_of(each)
    return tuple(found.values())


def first_difference(before: Iterable[FileIdentity]) -> str | None:
    """Look at files again; return a sentence on the first that has changed, None where none has."""
    for each in before:
        difference = each.difference(_identify(each.path))
        if difference is not None:
            return f"{each.path} was changed ({difference})"
    return None


def check_unchanged(before: Iterable[FileIdentity]) -> None:
    """Raise where a file is not what it was when the work began.

    Raises
    ------
    InputError
        Then: the results may be of the one content in part, and in part of the other.
    """
    difference = first_difference(before)
    if difference is not None:
        raise InputError(
            f"{difference} while the job ran, so nothing is written: run it again when the file stays so"
        )


def same(before: Sequence[FileIdentity], now: Sequence[FileIdentity]) -> bool:
    """Whether two lists tell of the same files with the same content."""
    return len(before) == len(now) and all(
        a.path == b.path and a.difference(b) is None for a, b in zip(before, now, strict=True)
    )


def digest(files: Iterable[FileIdentity]) -> str:
    """Return a short text that is the same for the same content of the same files."""
    return hashlib.sha256(repr([*files]).encode()).hexdigest()[:16]


def _differ(before: object, now: object) -> bool:
    return before is not None and now is not None and before != now


def _identify(uri: str, *, ask_servers: bool = True) -> FileIdentity | None:
    uri = plain_uri(uri)
    remote = _REMOTE.fullmatch(uri)
    if remote:
        return _of_server(remote["url"]) if ask_servers else None
    path = file_on_disk(uri)
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            status, header = os.fstat(file.fileno()), file.read(HEADER_BYTES)
    except OSError:
        return None
    return FileIdentity(
        path=str(path.absolute()),
        size=status.st_size,
        modified_ns=status.st_mtime_ns,
        inode=status.st_ino,
        device=status.st_dev,
        header_sha256=hashlib.sha256(header).hexdigest(),
    )


def file_on_disk(uri: str) -> Path | None:
    """Return the file that a path or GDAL URI leads to, an archive for what lies in it, or None."""
    uri = re.sub(r"^(/vsi(zip|tar|gzip|7z|rar)/|/vsisubfile/[^,]*,)+", "", uri)
    braced = re.match(r"\{(?P<archive>[^}]+)\}", uri)
    place = Path(braced["archive"] if braced else uri)
    for each in (place, *place.parents):
        try:
            if each.is_file():
                return each
        except (OSError, ValueError):  # too long or odd for a path, as GDAL URIs may be
            return None
    return None


def _of_server(url: str) -> FileIdentity | None:
    """Ask a web server for the version of a file; what it does not tell is None."""
    import urllib.request  # slow to load, and most files lie on a disk
    from email.utils import parsedate_to_datetime
    from http.client import HTTPException

    request = urllib.request.Request(url, method="HEAD")
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
            said = answer.headers
            size, modified = said.get("Content-Length"), said.get("Last-Modified")
            return FileIdentity(
                path=url,
                size=int(size) if size is not None else None,
                modified_ns=int(parsedate_to_datetime(modified).timestamp()) * 10**9 if modified else None,
                etag=said.get("ETag"),
            )
    except (OSError, HTTPException, ValueError):
        return FileIdentity(path=url, size=None, modified_ns=None)


def _is_vrt(uri: str) -> bool:
    """Whether a file that a raster is made of is itself made of others."""
    if uri.lower().endswith(".vrt"):
        return True
    path = Path(uri)
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return b"<VRTDataset" in file.read(1024)
    except (OSError, ValueError):
        return False


def _files_of(uri: str) -> list[str]:
    """Return what GDAL reads a raster from.

    Raises
    ------
    InputError
        If it cannot be opened.
    """
    with open_raster(uri) as dataset:
        return list(dataset.files)
