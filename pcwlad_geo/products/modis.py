"""MODIS of levels 1B and 2: swaths of which GeoTIFFs were written, as GDAL does not read their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree, open_raster
from pcwlad_geo.raster.file_tree import name_in
from pcwlad_geo.raster.hdf4_files import HDF4_FILES

_MODIS: Final = HDF4_FILES.modis


def _find(tree: FileTree) -> Product | None:
    images = [name for name in tree.names if _MODIS.raster.fullmatch(name_in(name))]
    return _product(tree, images, str(tree.path)) if len(_granules(images)) == 1 else None


def _of_file(path: Path) -> Product | None:
    if _MODIS.hdf4.fullmatch(path.name) and not _MODIS.has_images([path.name]):
        raise InputError(f"{path} holds no image: give one of its folder, {_MODIS.example}")
    if _MODIS.hdf4.fullmatch(path.name):
        raise HDF4_FILES.unread(path)
    if not _MODIS.raster.fullmatch(path.name):
        return None
    clear = sorted(file.name for file in (path.parent / _MODIS.beside).glob("*_clear.tif"))
    tree = FileTree(path.parent, (path.name, *(f"{_MODIS.beside}/{name}" for name in clear)))
    return replace(_product(tree, [path.name], str(path)), of_one_file=True)


def _granules(names: Sequence[str]) -> set[tuple[str, ...]]:
    found = map(_MODIS.raster.fullmatch, map(name_in, names))
    return {match.group("satellite", "kind", "time") for match in found if match}


def _product(tree: FileTree, images: Sequence[str], path: str) -> Product:
    ((satellite, kind, time),) = _granules(images)
    bands = []
    for name in images:
        with open_raster(tree.uri(name)) as file:
            bands += [
                ProductBand(band or "", tree.uri(name), nodata=None, number=number)
                for number, band in enumerate(file.descriptions, 1)
            ]
    clouds = f"{satellite}35_L2.{time}_clear.tif"
    clear = [*tree.named(f"{satellite}{kind}.{time}.*_clear.tif"), *tree.named(clouds)]
    mask = tree.uri(clear[-1]) if clear else None
    if mask and (step := _MODIS.step(kind)) > 1:
        mask = f"vrt://{mask}?outsize={step}00%,{step}00%"
    ordered = sorted(bands, key=lambda band: (len(band.name.rstrip("hilo")), band.name))  # B2 before B13lo
    return Product(
        path, f"MODIS {satellite}{kind}", tuple(ordered), mask, mask_file=f"{satellite}35_L2.{time}.*.hdf"
    )


def _part(names: Sequence[str]) -> str | None:
    """Return what a folder with these names holds, and what to do."""
    count = len(_granules(names))
    if count > 1:
        return f"{count} granules of MODIS: give the file of one"
    if any(map(_MODIS.hdf4.fullmatch, names)):
        return f"parts of a granule of MODIS without its images: add {_MODIS.example}"
    return None


MODIS: Final = ProductKind(
    name="MODIS",
    marks=lambda name: bool(_MODIS.hdf4.fullmatch(name) or _MODIS.raster.fullmatch(name)),
    find=_find,
    of_file=_of_file,
    part=_part,
)
"""The kind of all swaths of MODIS of levels 1B and 2 that are read."""
