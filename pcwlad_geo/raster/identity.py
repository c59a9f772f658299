"""Identities of the files that a raster is read from, to detect changes while a job runs or after it."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.file_tree import plain_uri
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.trust.destinations import destination
from pcwlad_geo.raster.trust.file_kinds import HEAD_BYTES, kind_of_head
from pcwlad_geo.raster.trust.signing import signed, unsigned

HEADER_BYTES: Final = 65536
"""Number of bytes at the beginning of a file that count as its header."""
MAX_FILES: Final = 200
"""Largest number of files identified per input; a mosaic of more sources is identified by the first."""
_REMOTE: Final = re.compile(r"(?:/vsicurl/)?(?P<url>https?://.+)", re.DOTALL)
_NO_PIXELS: Final = (".aux.xml",)
"""Endings of files that other programs write beside a raster at any time: statistics, as QGIS keeps them."""


@dataclass(frozen=True, slots=True)
class FileIdentity:
    """The version of a file, as far as it can be determined without reading all of it."""

    path: str
    """Absolute path, or URL; for a file in an archive, the path of the archive."""
    size: Annotated[int, ("minimum", 0)] | None
    """Bytes; None where a server does not report it."""
    modified_ns: int | None
    """Time of the last change, ns since 1970."""
    inode: int | None = None
    device: int | None = None
    """None for a file on a server."""
    etag: str | None = None
    """The server's entity tag of this version of the file; None for a file on a disk."""
    header_sha256: Annotated[str, ("pattern", "^[0-9a-f]{64}$")] | None = None
    """SHA-256, in hexadecimal digits, of the first `HEADER_BYTES` bytes; None for a file on a server."""

    def difference(self, now: FileIdentity | None) -> str | None:
        """Describe how a file has changed since; None where no change is detected.

        Inodes are compared on the same device only: device numbers change at each start of a machine.
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

    With `raster`, the files that belong to it are included (headers, overviews, masks, the sources of a VRT
    and of the VRTs among them), except statistics beside it (.aux.xml), which hold no pixels and which other
    programs may rewrite at any time. Inputs that are neither files nor on a web server (databases, object
    stores) have none. Raises `InputError` if the raster, or one that a VRT names, cannot be opened.
    """
    uri = os.fspath(uri)
    identities: dict[str, FileIdentity] = {}
    # opened first: a server is not asked for a file that may not be opened
    waiting = [uri, *_files_of(uri)] if raster else [uri]
    visited: set[str] = set()
    while waiting and len(identities) < MAX_FILES:
        source = waiting.pop(0)
        if source in visited or source.endswith(_NO_PIXELS):
            continue
        visited.add(source)
        identity = _identify(source, ask_servers=raster)
        if identity is not None:
            identities.setdefault(identity.path, identity)
        if raster and source != uri and _is_vrt(source):
            waiting += _files_of(source)
    return tuple(identities.values())


def first_difference(before: Iterable[FileIdentity]) -> str | None:
    """Identify files again and describe the first that has changed; None where none has."""
    for file in before:
        difference = file.difference(_identify(file.path))
        if difference is not None:
            return f"{file.path} was changed ({difference})"
    return None


def check_unchanged(before: Iterable[FileIdentity]) -> None:
    """Check that no file has changed since the work began.

    Raises `InputError` if a file has changed: the results may then mix both versions.
    """
    difference = first_difference(before)
    if difference is not None:
        raise InputError(
            f"{difference} while the job ran, so nothing is written: run it again when the file stays so"
        )


def same(before: Sequence[FileIdentity], now: Sequence[FileIdentity]) -> bool:
    """Whether `before` and `now` list the same files with the same content."""
    return len(before) == len(now) and all(
        a.path == b.path and a.difference(b) is None for a, b in zip(before, now, strict=True)
    )


def digest(files: Iterable[FileIdentity]) -> str:
    """Return 16 hexadecimal digits that are equal for the same content of the same files."""
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
    """Return the file of a path or GDAL URI, the archive for a file inside one; None where there is none."""
    uri = re.sub(r"^(/vsi(zip|tar|gzip|7z|rar)/|/vsisubfile/[^,]*,)+", "", uri)
    braced = re.match(r"\{(?P<archive>[^}]+)\}", uri)
    place = Path(braced["archive"] if braced else uri)
    for candidate in (place, *place.parents):
        try:
            if candidate.is_file():
                return candidate
        except (OSError, ValueError):  # too long or odd for a path, as GDAL URIs may be
            return None
    return None


def _of_server(url: str) -> FileIdentity | None:
    """Ask a web server for the version of a file; fields that it does not report are None."""
    import urllib.request  # slow to load, and most files lie on a disk
    from email.utils import parsedate_to_datetime
    from http.client import HTTPException

    request = urllib.request.Request(signed(url), method="HEAD")
    try:
        with urllib.request.urlopen(request, timeout=10.0) as answer:
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
    """Whether a file that a raster is made of is a VRT, which refers to other files."""
    if uri.lower().endswith(".vrt"):
        return True
    path = Path(uri)
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return kind_of_head(file.read(HEAD_BYTES)) == "vrt"
    except (OSError, ValueError):
        return False


def _files_of(uri: str) -> list[str]:
    """Return the files that GDAL reads a raster from.

    Raises `InputError` if the raster cannot be opened.
    """
    with open_raster(uri) as dataset:
        files = dataset.files or [uri]  # a cube of HDF5 is a VRT in memory
        files += [name for tag, name in dataset.tags(ns="GEOLOCATION").items() if tag.endswith("_DATASET")]
        return [unsigned(destination(file).path if file.startswith("HDF5:") else file) for file in files]
