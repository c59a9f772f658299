"""Files of this machine, in folders and archives, that are looked at before GDAL opens them."""

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

from pcwlad_geo.raster.trust.destinations import Destination, destination, split_archive

SIDECARS: Final = (".ovr", ".msk")
"""Endings of the names of overviews and masks beside a raster."""
_PART_OF_FILE: Final = re.compile(r"/vsisubfile/(\d+)_(\d+)[^,]*,(/vsigzip/)?(.*)", re.DOTALL)
_UNREADABLE: Final = (
    OSError,
    KeyError,
    EOFError,
    ValueError,
    OverflowError,
    zipfile.BadZipFile,
    tarfile.TarError,
)

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
            inside = _PART_OF_FILE.fullmatch(self.within)
            packed = bool(self.within) and (inside is None or inside[3])
            with gzip.open(self.path) if packed else self.path.open("rb") as file:
                file.seek(int(inside[1]) if inside else 0)
                return bytes(file.read(most))
        except _UNREADABLE:
            return b""

    def sidecars(self) -> list[OnDisk]:
        """Return the overviews and masks that GDAL finds by the file's name."""
        folder = self.path.parent
        names = _sidecars_in_folder(folder, _stamp(folder), self.path.name.lower())
        return [OnDisk(folder / name) for name in names]

    def named(self, name: str, *, relative: bool) -> OnDisk:
        """Return the file that this one refers to by `name`, `relative` to its folder or not.

        Raises `UntrustedFileError` if that file is not in the same folder or below.
        """
        _check_plain(name)
        folder = self.path.resolve().parent
        place = folder / name if relative else Path(name).absolute()
        real = place.resolve()
        if not any(real.is_relative_to(allowed) for allowed in (folder, self.path.parent.resolve())):
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
        return _stamp(self.archive) if self.name in self._stored_names() else ()

    def is_other(self) -> bool:
        """Whether it is a folder of the archive."""
        return any(name.startswith(f"{self.name}/") for name in self._stored_names())

    def read(self, most: int) -> bytes:
        """Return at most so many of its first bytes; none where it cannot be read."""
        try:
            if self._zipped:
                with zipfile.ZipFile(self.archive) as packed, packed.open(self.name) as file:
                    return file.read(most)
            with tarfile.open(self.archive) as tar:
                stored = self._stored_names()[self.name]
                member = tar.extractfile(stored)
                return member.read(most) if member is not None else b""
        except _UNREADABLE:
            return b""

    def sidecars(self) -> list[InArchive]:
        """Return the overviews and masks that GDAL finds by the file's name."""
        raster_name = self.name.lower()
        return [self._other(name) for name in self._stored_names() if _is_sidecar(name.lower(), raster_name)]

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

    def _stored_names(self) -> dict[str, str]:
        return _names_in(self.archive, _stamp(self.archive), self._zipped)


Place = OnDisk | InArchive


def place_of(place: Destination) -> Place:
    """Return the file that a name refers to.

    Raises `UntrustedFileError` if its content cannot be checked before GDAL opens it.
    """
    if place.where == "file":
        return OnDisk(Path(place.path))
    inside = split_archive(place.path)
    if inside is not None:
        return InArchive(*inside, place.path)
    subfile = _PART_OF_FILE.fullmatch(place.path)
    if subfile is not None:
        return OnDisk(Path(subfile[4]), place.path)
    if place.path.startswith("/vsigzip/"):
        return OnDisk(Path(place.path.removeprefix("/vsigzip/")), place.path)
    if place.path.startswith(("/vsizip/", "/vsitar/")):
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


def _is_sidecar(name: str, raster_name: str) -> bool:
    return name.endswith(SIDECARS) and name.startswith(raster_name) and name != raster_name


# A job opens a file for every tile; folders of thousands of files are common.
@lru_cache(maxsize=1024)
def _sidecars_in_folder(folder: Path, _: Stamp, raster_name: str) -> tuple[str, ...]:
    try:
        return tuple(
            sorted(file.name for file in folder.iterdir() if _is_sidecar(file.name.lower(), raster_name))
        )
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
