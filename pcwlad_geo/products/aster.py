"""ASTER of level 1B and surface temperature: scenes of which GeoTIFFs were written, one a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in
from pcwlad_geo.raster.hdf4_files import HDF4_FILES

_ASTER: Final = HDF4_FILES.aster


def _find(tree: FileTree) -> Product | None:
    names = [name for name in tree.names if _ASTER.raster.fullmatch(name_in(name))]
    return _product(tree, names, str(tree.path)) if len(_scenes(names)) == 1 else None


def _of_file(path: Path) -> Product | None:
    if _ASTER.hdf4.fullmatch(path.name):
        raise HDF4_FILES.unread(path)
    if not _ASTER.raster.fullmatch(path.name):
        return None
    return replace(_product(FileTree(path.parent, (path.name,)), [path.name], str(path)), of_one_file=True)


def _product(tree: FileTree, names: Sequence[str], path: str) -> Product:
    bands = [ProductBand(Path(name).stem.rpartition("_")[2], tree.uri(name), nodata=None) for name in names]
    ordered = sorted(bands, key=lambda band: (len(band.name.rstrip("N")), band.name))  # B3N before B10
    ((kind, _),) = _scenes(names)
    return Product(path, f"ASTER {kind}", tuple(ordered), None)


def _scenes(names: Sequence[str]) -> set[tuple[str, ...]]:
    found = map(_ASTER.raster.fullmatch, map(name_in, names))
    return {match.groups() for match in found if match}


def _part(names: Sequence[str]) -> str | None:
    """Return what a folder with these names holds, and what to do."""
    count = len(_scenes(names))
    return f"{count} scenes of ASTER: give the file of one" if count > 1 else None


ASTER: Final = ProductKind(
    name="ASTER",
    marks=lambda name: bool(_ASTER.hdf4.fullmatch(name) or _ASTER.raster.fullmatch(name)),
    find=_find,
    of_file=_of_file,
    part=_part,
)
"""The kind of all scenes of ASTER that are read."""
