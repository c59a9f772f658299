"""Files on disk and in archives as GDAL sees them: how they begin, what lies beside them, what they name."""

from __future__ import annotations

import gzip
import os
import posixpath
import re
import tarfile
import zipfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from pcwlad_geo.raster.uri import Destination, destination, split_archive

_BESIDE: Final = (".ovr", ".msk")
_SUBFILE: Final = re.compile(r"/vsisubfile/(\d+)_(\d+)[^,]*,(/vsigzip/)?(.*)", re.DOTALL)
_UNREADABLE: Final = (OSError, KeyError, EOFError, ValueError, zipfile.BadZipFile, tarfile.TarError)
Stamp = tuple[int, ...]


class UntrustedFileError(Exception):
    """A file names, or is, what GDAL must not open unless the user trusts it; the message tells."""


@dataclass(frozen=True, slots=True)
class OnDisk:
    """A file of this machine."""

    path: Path
    within: str = ""
    """The GDAL URI of the part of it that is read, unpacked or not; empty: all of it."""

    @property
    def uri(self) -> str:
        """What GDAL opens."""
        return self.within or str(self.path)

    def stamp(self) -> Stamp:
        """Return what changes when the file does; empty where there is no regular file."""
        return _stamp(self.path) if self.path.is_file() else ()

    def is_other(self) -> bool:
        """Whether there is something else than a regular file: a folder, a device."""
        return not self.path.is_file() and os.path.lexists(self.path)

    def read(self, most: int) -> bytes:
        """Read its first bytes; none where that cannot be done."""
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
        """Return a file that this one names; raise where it is not in the same folder or below."""
        _check_plain(name)
        folder = self.path.resolve().parent
        place = folder / name if relative else Path(name).absolute()
        real = place.resolve()
        if not any(real.is_relative_to(own) for own in (folder, self.path.parent.resolve())):
            raise UntrustedFileError(f"it names {name}, which is not in its own folder {folder} or below")
        return OnDisk(place)


@dataclass(frozen=True, slots=True)
class InArchive:
    """A file in a .zip or .tar."""

    archive: Path
    name: str
    uri: str

    def stamp(self) -> Stamp:
        """Return what changes when the archive does; empty where it has no such file."""
        return _stamp(self.archive) if self.name in self._names() else ()

    def is_other(self) -> bool:
        """Whether it is a folder of the archive."""
        return any(name.startswith(f"{self.name}/") for name in self._names())

    def read(self, most: int) -> bytes:
        """Read its first bytes; none where that cannot be done."""
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
        """Return a file that this one names; raise where it is not in the same folder or below."""
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
    """Return the file that a name leads to.

    Raises
    ------
    UntrustedFileError
        If what lies there cannot be looked at.
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
    return name.endswith(_BESIDE) and name.startswith(own) and name != own


# A job opens a file for every tile; folders of thousands of files are common.
@lru_cache(maxsize=1024)
def _beside_in_folder(folder: Path, _: Stamp, own: str) -> tuple[str, ...]:
    try:
        return tuple(sorted(file.name for file in folder.iterdir() if _is_beside(file.name.lower(), own)))
    except OSError:
        return ()


@lru_cache(maxsize=16)
def _names_in(archive: Path, _: Stamp, zipped: bool) -> dict[str, str]:
    """Return the files of an archive as GDAL calls them, and as they are stored."""
    try:
        if zipped:
            with zipfile.ZipFile(archive) as file:
                return {name: name for name in file.namelist()}
        with tarfile.open(archive) as tar:
            return {member.name.removeprefix("./"): member.name for member in tar if member.isfile()}
    except _UNREADABLE:
        return {}
