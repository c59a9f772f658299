"""Where a path or GDAL URI leads, and which files the user allows rasters to make GDAL open."""

from __future__ import annotations

import gzip
import os
import posixpath
import re
import tarfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal, NamedTuple


@dataclass(frozen=True, slots=True)
class Trust:
    """Permissions to open more than plain rasters of this machine; small and picklable."""

    remote: bool = False
    """Rasters over a network that the user names."""
    vrt: bool = False
    """All files that a raster names, wherever they are, and formats whose files name others."""


_NOTHING: Final = Trust()
_current: Final[ContextVar[Trust]] = ContextVar("pcwlad_geo_trust", default=_NOTHING)


def current_trust() -> Trust:
    """Return the permissions that apply in this thread."""
    return _current.get()


@contextmanager
def trusting(trust: Trust) -> Iterator[None]:
    """Apply permissions to the opening of rasters within the context.

    Threads that are started within it do not inherit it by themselves (see `contextvars.copy_context`); tasks
    in other processes receive it with their call.
    """
    token = _current.set(trust)
    try:
        yield
    finally:
        _current.reset(token)


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
        return _in_virtual_file_system(uri, handlers)
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


def _in_virtual_file_system(uri: str, handlers: list[str]) -> Destination:
    if handlers == ["mem"]:
        return Destination("memory", uri)
    if handlers in (["zip"], ["tar"], ["gzip"], ["subfile"], ["subfile", "gzip"]):
        return Destination("archive", uri)
    return Destination("unknown", uri)


def split_archive(uri: str) -> tuple[Path, str] | None:
    """Return the archive of a /vsizip/ or /vsitar/ name and the file in it; None for other names."""
    if not uri.startswith(("/vsizip/", "/vsitar/")):
        return None
    rest = uri[len("/vsizip/") :]
    if rest.startswith("{"):
        archive, _, name = rest[1:].partition("}/")
        return Path(archive), name
    places = [match.start() for match in re.finditer("/", rest[1:])]
    found = ((Path(rest[: place + 1]), rest[place + 2 :]) for place in places)
    return next(((archive, name) for archive, name in found if archive.is_file()), None)


BESIDE: Final = (".ovr", ".msk")
"""Endings of the names of overviews and masks beside a raster."""
_SUBFILE: Final = re.compile(r"/vsisubfile/(\d+)_(\d+)[^,]*,(/vsigzip/)?(.*)", re.DOTALL)
_UNREADABLE: Final = (OSError, KeyError, EOFError, ValueError, zipfile.BadZipFile, tarfile.TarError)
Stamp = tuple[int, ...]


class UntrustedFileError(Exception):
    """A file is, or names, one that GDAL must not open unless the user trusts it; see the message."""


@dataclass(frozen=True, slots=True)
class OnDisk:
    """A file of this machine."""

    path: Path
    within: str = ""
    """GDAL URI of the part of the file that is read, possibly compressed; empty for all of it."""

    @property
    def uri(self) -> str:
        """The name by which GDAL opens the file."""
        return self.within or str(self.path)

    def stamp(self) -> Stamp:
        """Return times, size and inode, which change with the file; empty where there is no regular file."""
        return _stamp(self.path) if self.path.is_file() else ()

    def is_other(self) -> bool:
        """Whether there is something other than a regular file: a folder, a device."""
        return not self.path.is_file() and os.path.lexists(self.path)

    def read(self, most: int) -> bytes:
        """Return at most so many of its first bytes; none where it cannot be read."""
        try:
            inside = _SUBFILE.fullmatch(self.within)
            packed = bool(self.within) and (inside is None or inside[3])
            with gzip.open(self.path) if packed else self.path.open("rb") as file:
                file.seek(int(inside[1]) if inside else 0)
                return bytes(file.read(most))
        except _UNREADABLE:
            return b""

    def beside(self) -> list[OnDisk]:
        """Return the overviews and masks that GDAL finds by the file's name."""
        folder = self.path.parent
        found = _beside_in_folder(folder, _stamp(folder), self.path.name.lower())
        return [OnDisk(folder / name) for name in found]

    def named(self, name: str, *, relative: bool) -> OnDisk:
        """Return the file that this one refers to by `name`, `relative` to its folder or not.

        Raises `UntrustedFileError` if that file is not in the same folder or below.
        """
        _check_plain(name)
        folder = self.path.resolve().parent
        place = folder / name if relative else Path(name).absolute()
        real = place.resolve()
        if not any(real.is_relative_to(own) for own in (folder, self.path.parent.resolve())):
            raise UntrustedFileError(f"it names {name}, which is not in its own folder {folder} or below")
        return OnDisk(place)


@dataclass(frozen=True, slots=True)
class InArchive:
    """A file in a .zip or .tar archive."""

    archive: Path
    name: str
    uri: str

    def stamp(self) -> Stamp:
        """Return times, size and inode of the archive; empty where it has no such file."""
        return _stamp(self.archive) if self.name in self._names() else ()

    def is_other(self) -> bool:
        """Whether it is a folder of the archive."""
        return any(name.startswith(f"{self.name}/") for name in self._names())

    def read(self, most: int) -> bytes:
        """Return at most so many of its first bytes; none where it cannot be read."""
        try:
            if self._zipped:
                with zipfile.ZipFile(self.archive) as packed, packed.open(self.name) as file:
                    return file.read(most)
            with tarfile.open(self.archive) as tar:
                stored = self._names()[self.name]
                member = tar.extractfile(stored)
                return member.read(most) if member is not None else b""
        except _UNREADABLE:
            return b""

    def beside(self) -> list[InArchive]:
        """Return the overviews and masks that GDAL finds by the file's name."""
        own = self.name.lower()
        return [self._other(name) for name in self._names() if _is_beside(name.lower(), own)]

    def named(self, name: str, *, relative: bool) -> InArchive:
        """Return the file that this one refers to by `name`, `relative` to its folder or not.

        Raises `UntrustedFileError` if that file is not in the same folder or below.
        """
        _check_plain(name)
        folder = posixpath.dirname(self.name)
        place = posixpath.normpath(posixpath.join(folder, name))
        if not relative or name.startswith("/") or posixpath.relpath(place, folder or ".").startswith(".."):
            raise UntrustedFileError(f"it names {name}, which is not in its own folder or below")
        return self._other(place)

    @property
    def _zipped(self) -> bool:
        return self.uri.startswith("/vsizip/")

    def _other(self, name: str) -> InArchive:
        return InArchive(self.archive, name, self.uri[: len(self.uri) - len(self.name)] + name)

    def _names(self) -> dict[str, str]:
        return _names_in(self.archive, _stamp(self.archive), self._zipped)


Place = OnDisk | InArchive


def place_of(found: Destination) -> Place:
    """Return the file that a name refers to.

    Raises `UntrustedFileError` if its content cannot be checked before GDAL opens it.
    """
    if found.where == "file":
        return OnDisk(Path(found.path))
    inside = split_archive(found.path)
    if inside is not None:
        return InArchive(*inside, found.path)
    subfile = _SUBFILE.fullmatch(found.path)
    if subfile is not None:
        return OnDisk(Path(subfile[4]), found.path)
    if found.path.startswith("/vsigzip/"):
        return OnDisk(Path(found.path.removeprefix("/vsigzip/")), found.path)
    if found.path.startswith(("/vsizip/", "/vsitar/")):
        raise UntrustedFileError("there is no such archive, or the name of the file in it is missing")
    raise UntrustedFileError("what lies there cannot be looked at before GDAL opens it")


def _check_plain(name: str) -> None:
    if destination(name).where != "file" or ":" in name[2:] or name.startswith(("vrt:", "/vsi")):
        raise UntrustedFileError(f"it names {name}, which is no plain file")


def _stamp(path: Path) -> Stamp:
    try:
        status = path.stat()
    except (OSError, ValueError):
        return ()
    return status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino, status.st_dev


def _is_beside(name: str, own: str) -> bool:
    return name.endswith(BESIDE) and name.startswith(own) and name != own


# A job opens a file for every tile; folders of thousands of files are common.
@lru_cache(maxsize=1024)
def _beside_in_folder(folder: Path, _: Stamp, own: str) -> tuple[str, ...]:
    try:
        return tuple(sorted(file.name for file in folder.iterdir() if _is_beside(file.name.lower(), own)))
    except OSError:
        return ()


@lru_cache(maxsize=16)
def _names_in(archive: Path, _: Stamp, zipped: bool) -> dict[str, str]:
    """Return the files of an archive: GDAL's names of them and the stored names."""
    try:
        if zipped:
            with zipfile.ZipFile(archive) as file:
                return {name: name for name in file.namelist()}
        with tarfile.open(archive) as tar:
            return {member.name.removeprefix("./"): member.name for member in tar if member.isfile()}
    except _UNREADABLE:
        return {}
