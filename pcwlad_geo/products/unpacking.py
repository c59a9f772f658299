"""Inputs that GDAL does not read where they lie, as files of their own: parts of JPEGs, HDF5 in archives."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.finding import KINDS, stem_of
from pcwlad_geo.products.jpeg_parts import part_files, part_stems
from pcwlad_geo.products.names import HDF5_ENDINGS
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import is_archive, name_in, tree_of
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.text import part_of_jpeg
from pcwlad_geo.types import PathLike


@contextmanager
def unpacked(names: Sequence[PathLike], out_dir: PathLike, *, overwrite: bool) -> Iterator[list[str]]:
    """Give the names of inputs; those that need it are written to ``<out_dir>_inputs``, and named there.

    Results may refer to these files: they are removed only where the job within the context leaves no
    `out_dir`. Those of an earlier run that are younger than what they are of are used again, without
    `overwrite`. Raises `InputError` if an input cannot be read, and `OutputError` if they cannot be written.
    """
    texts = [os.fspath(name) for name in names]
    places = unpacked_places(texts, out_dir)
    if overwrite or not all(_is_there(texts[number], place) for number, place in places.items()):
        _write(texts, places)
    try:
        yield [str(places.get(number, text)) for number, text in enumerate(texts)]
    finally:
        if places and not Path(out_dir).exists():
            shutil.rmtree(_folder_of(out_dir), ignore_errors=True)


def unpacked_places(names: Sequence[str], out_dir: PathLike) -> dict[int, Path]:
    """Return the places of the inputs that `unpacked` writes, by their numbers."""
    folder = _folder_of(out_dir)
    places = {number: folder / f"{stem}.tif" for number, stem in part_stems(names).items()}
    return places | {number: folder / stem_of(name) for number, name in enumerate(names) if _hdf5_in(name)}


def _folder_of(out_dir: PathLike) -> Path:
    return Path(f"{os.fspath(out_dir)}_inputs").absolute()


def _write(names: Sequence[str], places: dict[int, Path]) -> None:
    scratch = Scratch()
    for number, file in enumerate(part_files(names, scratch)):
        if number not in places:
            continue
        if scratch.holds(str(file)):
            scratch.copy(str(file), places[number].parent, overwrite=True)
        for tree, member in _hdf5_in(names[number]):
            tree.unpack(member, places[number])


def _is_there(name: str, place: Path) -> bool:
    """Whether what an input is unpacked to is there, and younger than the input."""
    part = part_of_jpeg(name)
    files = [place] if part else [place / name_in(member) for _, member in _hdf5_in(name)]
    try:
        changed_ns = Path(part[0] if part else name).stat().st_mtime_ns
        return all(file.stat().st_mtime_ns >= changed_ns for file in files)
    except OSError:
        return False


def _hdf5_in(name: str) -> list[tuple[FileTree, str]]:
    """Return the files of HDF5 in the archive of a product; they are checked and read outside of it only."""
    path = Path(name)
    try:
        tree = tree_of(path) if is_archive(path) and path.is_file() else None
    except (InputError, OSError, ValueError):  # it is told where the input is opened
        return []
    members = [member for member in (tree.names if tree else ()) if member.lower().endswith(HDF5_ENDINGS)]
    known = KINDS.ask(lambda kind: any(map(kind.marks, map(name_in, members))), bool)
    return [(tree, member) for member in members] if tree and any(known) else []
