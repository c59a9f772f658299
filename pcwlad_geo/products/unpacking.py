"""Inputs that GDAL does not read where they lie, as files: parts of JPEGs, HDF4, HDF5 in archives."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

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


@contextmanager
def unpacked(names: Sequence[PathLike], out_dir: PathLike, *, overwrite: bool) -> Iterator[list[str]]:
    """Give the names of inputs; those that need it are written to ``<out_dir>_inputs``, and named there.

    Results may refer to these files: they are removed only where the job within the context leaves no
    `out_dir`. Those of an earlier run that are younger than what they are of are used again, without
    `overwrite`. Raises `InputError` if an input cannot be read, and `OutputError` if they cannot be written.
    """
    texts = [os.fspath(name) for name in names]
    places = unpacked_places(texts, out_dir)
    try:
        if overwrite or not all(_is_there(texts[number], place) for number, place in places.items()):
            _write(texts, places)
        yield [
            f"{places[number]}{_split(text)[1]}" if number in places else text
            for number, text in enumerate(texts)
        ]
    finally:
        if places and not Path(out_dir).exists():
            shutil.rmtree(_folder_of(out_dir), ignore_errors=True)


def unpacked_places(names: Sequence[str], out_dir: PathLike) -> dict[int, Path]:
    """Return the places of the inputs that `unpacked` writes, by their numbers."""
    folder = _folder_of(out_dir)
    places = {number: folder / f"{stem}.tif" for number, stem in part_stems(names).items()}
    return places | {
        number: folder / stem_of(_split(name)[0]) for number, name in enumerate(names) if _unread_in(name)
    }


def _folder_of(out_dir: PathLike) -> Path:
    return Path(f"{os.fspath(out_dir)}_inputs").absolute()


def _split(name: str) -> tuple[str, str]:
    """Return the path of an input, and the bands that follow it after a colon."""
    path, colon, bands = name.rpartition(":")
    has_bands = bool(colon) and not part_of_jpeg(name) and not Path(name).exists() and Path(path).exists()
    return (path, colon + bands) if has_bands else (name, "")


def _write(names: Sequence[str], places: dict[int, Path]) -> None:
    scratch = Scratch()
    for number, file in enumerate(part_files(names, scratch)):
        if number not in places:
            continue
        if scratch.holds(str(file)):
            scratch.copy(str(file), places[number].parent, overwrite=True)
        members = _unread_in(names[number])
        for tree, member in members:
            path = tree.unpack(member, places[number]) if tree.prefix else tree.path / member
            if path.name.endswith(_HDF4):
                HDF4_FILES.write_rasters(path, [name_in(other) for _, other in members], places[number])
                if tree.prefix:
                    path.unlink()


def _is_there(name: str, place: Path) -> bool:
    """Whether what an input is unpacked to is there, and younger than the input; of HDF4 it is never."""
    part = part_of_jpeg(name)
    files = [place] if part else [place / name_in(member) for _, member in _unread_in(name)]
    try:
        changed_ns = Path(part[0] if part else _split(name)[0]).stat().st_mtime_ns
        return all(file.stat().st_mtime_ns >= changed_ns for file in files)
    except OSError:
        return False


def _unread_in(name: str) -> list[tuple[FileTree, str]]:
    """Return the files of a product that are not read where they lie: of HDF4, and of HDF5 in archives."""
    path = Path(_split(name)[0])
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
    known = KINDS.ask(lambda kind: any(map(kind.marks, filter(_is_hdf5, names))), bool)
    return [(tree, member) for member in members] if any(known) or HDF4_FILES.has_images(names) else []


def _is_hdf5(name: str) -> bool:
    return not name.endswith(_HDF4)
