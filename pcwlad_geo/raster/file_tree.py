"""Names of files: the last part of a path or URI, the files of a folder, a .zip or a .tar."""

from __future__ import annotations

import io
import lzma
import os
import re
import shutil
import tarfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Final

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.limits import LIMITS, check_count, check_unpacked
from pcwlad_geo.raster.hdf5 import array_uri, open_hdf5
from pcwlad_geo.raster.opening import check_source
from pcwlad_geo.raster.swath_files import swath_bands
from pcwlad_geo.text import read_bytes
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    import h5py

_ZIP: Final = (".zip",)
_TAR: Final = (".tar", ".tar.gz", ".tgz")
_ARCHIVE_ERRORS: Final = (
    *(OSError, EOFError, ValueError, RuntimeError, NotImplementedError, zlib.error, lzma.LZMAError),
    *(zipfile.BadZipFile, tarfile.TarError),
)
"""Exceptions of Python's archive readers for damaged, encrypted or unsupported archives."""
_SUBFILE: Final = re.compile(r"/vsisubfile/\d+_\d+_(?P<name>[^/,]+),.*", re.DOTALL)
"""A file inside an archive by its offset: GDAL ignores the name, which only this program reads."""


def file_name(uri: str) -> str:
    """Return the last part of a path or GDAL URI, without the prefix and options of a vrt:// connection."""
    return name_of_uri(plain_uri(uri))


def plain_uri(uri: str) -> str:
    """Return a path or GDAL URI without the prefix and options of a vrt:// connection."""
    return uri.removeprefix("vrt://").partition("?")[0] if uri.startswith("vrt://") else uri


def plain_name(name: str) -> str:
    """Return a name usable for output files: no reserved character, no leading dot, never empty."""
    return re.sub(r'[<>:"/\\|?*\x00-\x1f]+', "_", name).lstrip(".") or "raster"


@dataclass(frozen=True, slots=True)
class FileTree:
    """The files below a root."""

    path: Path
    """The folder or the archive."""
    names: tuple[str, ...]
    """Paths of the files relative to the root, with forward slashes, sorted."""
    prefix: str = ""
    """GDAL's prefix for the kind of archive (/vsizip/, /vsitar/); empty for a folder."""

    def uri(self, name: str) -> str:
        """Return the path or GDAL URI of a file."""
        if not self.prefix:
            return str(self.path / name)
        archive, place = self.path.absolute().as_posix(), _members(_Archive.of(self.path))[name].place
        if place is not None:
            unpacked = "" if self.path.name.lower().endswith(".tar") else "/vsigzip/"
            return f"/vsisubfile/{place}_{name_in(name).replace(',', '_')},{unpacked}{archive}"
        # Braces mark where the archive's name ends, which GDAL would guess otherwise.
        return f"{self.prefix}/{{{archive}}}/{name}"

    def named(self, pattern: str) -> list[str]:
        """Return the files in any folder that have this name, in which * stands for any text."""
        return [name for name in self.names if fnmatchcase(name_in(name), pattern)]

    def read_text(self, name: str) -> str:
        """Read a small text file.

        Raises `InputError` if it cannot be read.
        """
        try:
            data = (
                _member(_Archive.of(self.path), name)
                if self.prefix
                else read_bytes(self.path / name, LIMITS.metadata_bytes)
            )
        except (KeyError, *_ARCHIVE_ERRORS) as error:
            raise InputError(f"{name} of {self.path} cannot be read: {error}") from error
        return data.decode("utf-8", errors="replace")

    def unpack(self, name: str, folder: Path) -> Path:
        """Write a file of an archive into a folder, under its own name, and return its path.

        Raises `InputError` if it cannot be read, and `OutputError` if it cannot be written.
        """
        place = folder / name_in(name)
        try:
            with _opened_member(_Archive.of(self.path), name) as member, _written(place) as file:
                shutil.copyfileobj(member, file, 2**20)
        except (KeyError, *_ARCHIVE_ERRORS) as error:
            raise InputError(f"{name} of {self.path} cannot be read: {error}") from error
        return place

    @contextmanager
    def open_hdf5(self, name: str) -> Iterator[h5py.File]:
        """Open an HDF5 or netCDF-4 file for reading its structure, after the check that all of it is inside.

        Raises `InputError` if it lies in an archive, is damaged or lacks what is read, or h5py is missing,
        and `TrustError` if it refers to other files.
        """
        if self.prefix:
            raise InputError(f"{name} of {self.path} is read from a file of its own only: unpack it")
        check_source(str(self.path / name))
        with open_hdf5(self.path / name) as file:
            yield file

    def swath_bands(self, name: str) -> list[tuple[str, str]]:
        """Return the names and URIs of the bands in a file that another one beside it places on the ground.

        Raises `InputError` if that is missing, and what `open_hdf5` raises.
        """
        with self.open_hdf5(name) as file:
            return swath_bands(self.path / name, file)

    def array_uri(self, name: str, array: str) -> str:
        """Return GDAL's name of an array of an HDF5 file, the path of which begins with a slash."""
        return array_uri(self.path / name, array)


def is_folder(path: PathLike) -> bool:
    """Whether a path is a folder; False, where Path.is_dir raises, for a name that no file can have."""
    return os.path.isdir(path)  # noqa: PTH112


def is_archive(path: Path) -> bool:
    """Whether a path has the suffix of a .zip or .tar archive."""
    return path.name.lower().endswith((*_ZIP, *_TAR))


def tree_of(path: Path) -> FileTree:
    """List the files of a folder or an archive.

    Raises `InputError` if it cannot be read.
    """
    try:
        if path.is_dir():
            return FileTree(path, tuple(sorted(_below(path, levels=6))))
        archive = _Archive.of(path)
        return FileTree(path, tuple(sorted(_members(archive))), "/vsizip" if archive.zipped else "/vsitar")
    except _ARCHIVE_ERRORS as error:
        raise InputError(f"{path} cannot be read: it may be damaged ({error})") from error


@dataclass(frozen=True, slots=True)
class _Archive:
    """An archive in its present version, as a key of caches."""

    path: Path
    changed_ns: int
    size: int

    @staticmethod
    def of(path: Path) -> _Archive:
        status = path.stat()
        return _Archive(path.absolute(), status.st_mtime_ns, status.st_size)

    @property
    def zipped(self) -> bool:
        return self.path.name.lower().endswith(_ZIP)

    @property
    def unpacks(self) -> bool:
        """Whether the archive is compressed."""
        return not self.path.name.lower().endswith(".tar")


@dataclass(frozen=True, slots=True)
class _Member:
    """A file in an archive."""

    stored: str
    """Its name in the archive, which may begin with ./"""
    place: str | None = None
    """Offset and length in bytes, joined by _, where GDAL does not find the file by its name."""


# A job asks several times, and a .tar.gz is unpacked from its beginning each time.
@lru_cache(maxsize=16)
def _members(archive: _Archive) -> Mapping[str, _Member]:
    """Return the files of an archive by the names that GDAL gives them."""
    if archive.zipped:
        with zipfile.ZipFile(archive.path) as file:
            entries = file.infolist()
            check_count(str(archive.path), len(entries), LIMITS.members, "files")
            check_unpacked(str(archive.path), sum(entry.file_size for entry in entries), archive.size)
            return {entry.filename: _Member(entry.filename) for entry in entries if _counts(entry.filename)}
    members: dict[str, _Member] = {}
    with tarfile.open(archive.path) as tar:
        for number, member in enumerate(tar, start=1):
            check_count(str(archive.path), number, LIMITS.members, "files")
            if archive.unpacks:  # before what follows is unpacked
                check_unpacked(str(archive.path), member.offset_data + member.size, archive.size)
            if member.isfile() and _counts(member.name):
                # names of more than 100 characters are in pax headers, which GDAL does not read
                place = f"{member.offset_data}_{member.size}" if "path" in member.pax_headers else None
                members[member.name.removeprefix("./")] = _Member(member.name, place)
    return members


@lru_cache(maxsize=16)
def _member(archive: _Archive, name: str) -> bytes:
    with _opened_member(archive, name) as member:
        return _small(member, name)


@contextmanager
def _opened_member(archive: _Archive, name: str) -> Iterator[IO[bytes]]:
    stored = _members(archive)[name].stored
    if archive.zipped:
        with zipfile.ZipFile(archive.path) as file, file.open(stored) as member:
            yield member
    else:
        with tarfile.open(archive.path) as tar:
            yield tar.extractfile(stored) or io.BytesIO()


@contextmanager
def _written(place: Path) -> Iterator[IO[bytes]]:
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        partial = place.with_name(f"{place.name}.part")
        with partial.open("wb") as file:
            yield file
        partial.replace(place)
    except OSError as error:
        raise OutputError(f"cannot write {place}: {error}") from error


def _small(member: IO[bytes], name: str) -> bytes:
    data = member.read(LIMITS.metadata_bytes + 1)
    if len(data) > LIMITS.metadata_bytes:
        raise InputError(
            f"{name} unpacks to more than {LIMITS.metadata_bytes} bytes, and at most so many are read: "
            "get it again"
        )
    return data


def _counts(name: str) -> bool:
    # macOS packs a shadow of each file: ._name
    return name[-1:] != "/" and not name_in(name).startswith("._")


def _below(folder: Path, levels: int, above: str = "") -> list[str]:
    names = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_file():
                names.append(above + entry.name)
            elif entry.is_dir() and levels > 1:
                names += _below(Path(entry.path), levels - 1, f"{above}{entry.name}/")
    return names


def name_in(name: str) -> str:
    """Return the last component of a path with forward slashes."""
    return PurePosixPath(name).name


def name_of_uri(uri: str) -> str:
    """Return the name of the file that a path or GDAL URI leads to."""
    inside = _SUBFILE.fullmatch(uri)
    return inside["name"] if inside else Path(uri).name
