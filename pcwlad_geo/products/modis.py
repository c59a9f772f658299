"""MODIS of level 1B: swaths in HDF4, which most builds of GDAL do not read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import rasterio

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in

_MODIS_FILE: Final = re.compile(
    r"M[OY]D(?:02(?:1KM|HKM|QKM|SSH)|03)\.A\d{7}\.\d{4}\.\d{3}\.\d{13}(?:\.NRT)?\.hdf", re.IGNORECASE
)


def _refuse(name: str, path: Path) -> None:
    """Raise `InputError`, which says how a file of MODIS is read."""
    with rasterio.Env() as environment:
        has_driver = "HDF4" in environment.drivers()
    warped = 'gdalwarp -geoloc HDF4_EOS:EOS_SWATH:"…":MODIS_SWATH_Type_L1B:EV_1KM_Emissive out.tif'
    raise InputError(
        f"{name} of {path} is a swath of MODIS in HDF4, which is not read as a product"
        + ("" if has_driver else ", and for which this GDAL has no driver")
        + f": warp a band of it where GDAL has one, as conda-forge's with libgdal-hdf4 ({warped}), and give "
        "the result"
    )


def _find(tree: FileTree) -> Product | None:
    files = [name for name in tree.names if _MODIS_FILE.fullmatch(name_in(name))]
    if files:
        _refuse(name_in(files[0]), tree.path)
    return None


def _of_file(path: Path) -> Product | None:
    if _MODIS_FILE.fullmatch(path.name):
        _refuse(path.name, path.parent)
    return None


MODIS: Final = ProductKind(
    name="MODIS",
    marks=lambda name: _MODIS_FILE.fullmatch(name) is not None,
    find=_find,
    of_file=_of_file,
)
"""The kind of all swaths of MODIS, none of which is read."""
