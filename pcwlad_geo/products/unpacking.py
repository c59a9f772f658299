"""Inputs that GDAL does not read where they lie, as files: parts of JPEGs, HDF4, HDF5 in archives."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.finding import KINDS, stem_of
from pcwlad_geo.products.jpeg_parts import part_files, part_stems
from pcwlad_geo.products.names import HDF5_ENDINGS, beside
from pcwlad_geo.raster import FileTree, is_folder
from pcwlad_geo.raster.file_tree import is_archive, name_in, tree_of
from pcwlad_geo.raster.hdf4_files import HDF4_FILES
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.text import part_of_jpeg
from pcwlad_geo.types import PathLike

_HDF4: Final = ".hdf"
"""Ending of files of HDF4."""


class _Unread(NamedTuple):
    """An input that is written to a place of its own."""

    path: str
    bands: str
    """What follows the path after a colon."""
    place: Path
    members: list[tuple[FileTree, str]]
    """Its files that are not read where they lie; none of a part of a JPEG."""

    @property
    def is_there(self) -> bool:
        """Whether what it is unpacked to is there, and younger than the input; of HDF4 it is never."""
        files = [self.place / name_in(member) for _, member in self.members] or [self.place]
        try:
            changed_ns = Path(self.path).stat().st_mtime_ns
            return all(file.stat().st_mtime_ns >= changed_ns for file in files)
        except OSError:
            return False


@contextmanager
def unpacked(names: Sequence[PathLike], out_dir: PathLike, *, overwrite: bool) -> Iterator[list[str]]:
    """Give the names of inputs; those that need it are written to ``<out_dir>_inputs``, and named there.

    Results may refer to these files: they are removed only where the job within the context leaves no
    `out_dir`. Those of an earlier run that are younger than what they are of are used again, without
    `overwrite`. Raises `InputError` if an input cannot be read, and `OutputError` if they cannot be written.
    """
    texts = [os.fspath(name) for name in names]
    inputs = _unread(texts, out_dir)
    try:
        if overwrite or not all(one.is_there for one in inputs.values()):
            _write(texts, inputs)
        yield [
            f"{inputs[number].place}{inputs[number].bands}" if number in inputs else text
            for number, text in enumerate(texts)
        ]
    finally:
        if inputs and not Path(out_dir).exists():
            shutil.rmtree(_folder_of(out_dir), ignore_errors=True)


def unpacked_places(names: Sequence[str], out_dir: PathLike) -> dict[int, Path]:
    """Return the places of the inputs that `unpacked` writes, by their numbers."""
    return {number: one.place for number, one in _unread(names, out_dir).items()}


def _folder_of(out_dir: PathLike) -> Path:
    return Path(f"{os.fspath(out_dir)}_inputs").absolute()


def _unread(names: Sequence[str], out_dir: PathLike) -> dict[int, _Unread]:
    """Return the inputs that are not read where they lie, by their numbers."""
    folder, stems, inputs = _folder_of(out_dir), part_stems(names), {}
    for number, name in enumerate(names):
        if part := part_of_jpeg(name):
            inputs[number] = _Unread(part[0], "", folder / f"{stems[number]}.tif", [])
            continue
        path, colon, bands = name.rpartition(":")
        if not colon or Path(name).exists() or not Path(path).exists():
            path, colon, bands = name, "", ""
        if members := _unread_in(Path(path)):
            inputs[number] = _Unread(path, colon + bands, folder / stem_of(path), members)
    return inputs


def _write(names: Sequence[str], inputs: Mapping[int, _Unread]) -> None:
    scratch = Scratch()
    files = part_files(names, scratch)
    for number, (_, _, place, members) in inputs.items():
        if scratch.holds(str(files[number])):
            scratch.copy(str(files[number]), place.parent, overwrite=True)
        for tree, member in members:
            path = tree.unpack(member, place) if tree.prefix else tree.path / member
            if path.name.endswith(_HDF4):
                HDF4_FILES.write_rasters(path, [name_in(other) for _, other in members], place)
                if tree.prefix:
                    path.unlink()


def _unread_in(path: Path) -> list[tuple[FileTree, str]]:
    """Return the files of a product that are not read where they lie: of HDF4, and of HDF5 in archives."""
    try:
        if HDF4_FILES.has_images([path.name]):
            tree = beside(path)
            return [(tree, member) for member in HDF4_FILES.granule_of(path.name, tree.names)]
        if is_folder(path):
            tree = beside(path / "-")
        elif is_archive(path) and path.is_file():
            tree = tree_of(path)
        else:
            return []
    except (InputError, OSError, ValueError):  # it is told where the input is opened
        return []
    members = [
        member
        for member in tree.names
        if member.lower().endswith(HDF5_ENDINGS if tree.prefix else _HDF4) or member.endswith(_HDF4)
    ]
    names = [name_in(member) for member in members]
    cubes = [name for name in names if not name.endswith(_HDF4)]
    is_product = any(KINDS.ask(lambda kind: any(map(kind.marks, cubes)), bool))
    return [(tree, member) for member in members] if is_product or HDF4_FILES.has_images(names) else []
