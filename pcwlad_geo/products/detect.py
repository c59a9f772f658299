"""Recognition of products and of native pixel sizes by file names and band descriptions."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.products import landsat, sentinel2
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster.file_tree import FileTree, is_archive, is_folder, tree_of
from pcwlad_geo.raster.masks import is_quality_raster
from pcwlad_geo.raster.source import file_name, plain_uri
from pcwlad_geo.types import Float64, PathLike

_LANDSAT: Final = re.compile(
    r"^L([COTEM])(?:0([1-9])_\w{4}_\d{6}_.*?_(?:(?:SR|ST)_)?|([1-9])\d{13}[A-Z]{3}\d\d_)B(\d+)$",
    re.IGNORECASE,
)
_SENTINEL2_BAND: Final = re.compile(
    r"^(?:L2A_)?(?:T\d{2}[A-Z]{3}_\d{8}T\d{6}|S2[A-D]_.*)_B(\d{1,2}|8A)(?:_\d+m)?$", re.IGNORECASE
)
_SURFACE_TEMPERATURE: Final = re.compile(r"^ST_B(\d+)$", re.IGNORECASE)

_THERMAL_M: Final = {"10": 100.0, "11": 100.0}
_SENTINEL2_M: Final = {
    **dict.fromkeys(("1", "9", "10"), 60.0),
    **dict.fromkeys(("2", "3", "4", "8"), 10.0),
    **dict.fromkeys(("5", "6", "7", "8A", "11", "12"), 20.0),
}
TIRS_M: Final = 100.0
"""Native pixel size of the thermal bands of Landsat 8 and 9, which are delivered at 30 m."""


_NOMINAL: Final = 0.002
"""Tolerance of nominal pixel sizes, which refer to map grids: UTM lengths are true within 0.1 %."""


def native_per_px(px_m: tuple[float, float], native_m: float | tuple[float, float]) -> Float64:
    """Return the pixel size in native pixels along (col, row).

    The pixel is `px_m` large on the ground, metres, and the native pixel nominally `native_m`. The (2,)
    result is 1 where the sizes differ only by the tolerance of nominal sizes.
    """
    ratio = np.array(px_m) / native_m
    return np.where(np.abs(ratio - 1.0) <= _NOMINAL, 1.0, ratio)


def native_px_m(stem: str, description: str | None) -> float | None:
    """Return the pixel size recorded by the sensor, in metres; None if the names do not determine it.

    Parameters
    ----------
    stem : str
        File name without its suffix: band files of Landsat and Sentinel-2 are recognised.
    description : str, optional
        Description of the band: surface temperature bands of Landsat are recognised (`ST_B10`; `ST_B6` of
        Landsat 4 to 7 may be 60 or 120 m and gives None).
    """
    if match := _LANDSAT.match(stem):
        return _landsat(match[1].upper(), int(match[2] or match[3]), match[4])
    if match := _SENTINEL2_BAND.match(stem):
        return _SENTINEL2_M.get(match[1].upper().lstrip("0"))
    if description and (match := _SURFACE_TEMPERATURE.match(description.strip())):
        return _THERMAL_M.get(match[1])
    return None


def _landsat(sensor: str, mission: int, band: str) -> float | None:
    if mission >= 8:
        return _THERMAL_M.get(band) or (15.0 if band == "8" else 30.0)
    if band == "6":
        return {"E": 60.0, "T": 120.0}.get(sensor)
    if sensor not in "ET":
        return None
    return 15.0 if band == "8" else 30.0


_OLD_LANDSAT: Final = re.compile(r"L[COTEM]\d{14}[A-Z]{3}\d\d(_.*)?", re.IGNORECASE)
"""Names from before the Collections, such as LC81980302020222LGN00_B4.TIF."""
_TILED_LANDSAT: Final = re.compile(r"L[COTEM]0\d_(CU|AK|HI)_\d{6}_.*", re.IGNORECASE)
"""Names of analysis-ready tiles, such as LC08_CU_003008_20200809_20210504_02_SR_B4.TIF."""
_SENTINEL2_NAME: Final = re.compile(r".*_B\d[\dA](_\d\dm)?\.jp2|IMG_DATA|R\d\dm", re.IGNORECASE)
_LANDSAT_BAND: Final = re.compile(r"L[COTEM].*_B\d{1,2}(_VCID_\d)?\.TIFF?", re.IGNORECASE)


def no_product(path: str, band: str | None = None) -> str | None:
    """Return why a path is not a product whose bands have names, and what to do.

    For this path `find_product` finds no product. The result is None if it may be a raster and no `band` was
    requested by name.
    """
    place = Path(path)
    if is_folder(place):
        return _folder(place)
    if band is None:
        return None
    if _LANDSAT_BAND.fullmatch(place.name) or _SENTINEL2_NAME.fullmatch(place.name):
        return (
            f"{path} is the file of one band of a product, in which band {band} cannot be found by name: "
            "leave the band out, or give the folder of the product"
        )
    return (
        f"band {band} of {path}: it is no product, and only the bands of Landsat and Sentinel-2 products "
        "have names; give the number of a band, from 1"
    )


def _folder(folder: Path) -> str:
    names = [entry.name for entry in folder.iterdir()]
    if any(_OLD_LANDSAT.fullmatch(name) for name in names):
        what = "a Landsat scene of before the Collections without its bands and its MTL file"
    elif any(_TILED_LANDSAT.fullmatch(name) for name in names):
        what = "a Landsat analysis-ready tile"
    elif any(_SENTINEL2_NAME.fullmatch(name) for name in names):
        return (
            f"{folder} holds band files of Sentinel-2 outside of their product: give the SAFE folder as it "
            "was packed (with MTD_MSIL1C.xml or MTD_MSIL2A.xml and GRANULE), its .zip, or one band file"
        )
    else:
        return (
            f"{folder} is a folder, and neither a Landsat scene nor a Sentinel-2 SAFE product: give a raster "
            "file"
        )
    return (
        f"{folder} holds {what}, which is not read as a product (whole scenes of Landsat and Sentinel-2 "
        "are): give one of its band files, and a mask with 0 where there are clouds"
    )


_STEM: Final = re.compile(r"(_MTL\.(txt|json|xml)|(\.SAFE)?(\.zip|\.tar|\.tar\.gz|\.tgz)?)$", re.IGNORECASE)


_FOUND: Final[ContextVar[dict[str, Product | None] | None]] = ContextVar("found products", default=None)


@contextmanager
def products_found_once() -> Iterator[None]:
    """Find the product of a path once within the context, which is that of a job."""
    known = _FOUND.get()
    token = _FOUND.set({} if known is None else known)
    try:
        yield
    finally:
        _FOUND.reset(token)


def find_product(path: PathLike) -> Product | None:
    """Return the product at a path; None for a plain raster.

    A product is given by a folder or an archive (.zip, .tar, .tar.gz) with a Landsat scene or a
    Sentinel-2 SAFE, by the MTL file of the former or the MTD_MSIL*.xml of the latter. Raises `InputError` if
    the product cannot be used, or an archive holds none.
    """
    known = _FOUND.get()
    if known is None:
        return _search(path)
    name = os.fspath(path)
    if name not in known:
        known[name] = _search(path)
    return known[name]


def _search(path: PathLike) -> Product | None:
    place = Path(path)
    try:
        if place.is_dir():
            return _found(tree_of(place)) if _may_hold_product(place) else None
        if not place.is_file():
            return None
    except (OSError, ValueError):  # a GDAL URI that is not a path
        return None
    match = landsat.METADATA.fullmatch(place.name)
    if match and match["id"]:
        return landsat.find_landsat(_folder_of(place), match["id"])
    if sentinel2.METADATA.fullmatch(place.name):
        return sentinel2.find_sentinel2(tree_of(place.parent))
    if not is_archive(place):
        return None
    product = _found(tree_of(place))
    if product is None:
        raise InputError(
            f"{path} holds no Landsat and no Sentinel-2 product: give a raster inside it as "
            "/vsizip/… or /vsitar/…"
        )
    return product


def stem_of(path: PathLike) -> str:
    """Return the name of a raster or product without its suffix, from which names of outputs are formed."""
    place = Path(path)
    if sentinel2.METADATA.fullmatch(place.name):
        place = place.parent
    if place.name in ("", ".."):
        place = place.resolve()
    shortened = _STEM.sub("", place.name)
    return shortened if shortened != place.name else place.stem if not is_folder(place) else place.name


def _found(tree: FileTree) -> Product | None:
    found = [product for product in (landsat.find_landsat(tree), sentinel2.find_sentinel2(tree)) if product]
    if len(found) > 1:
        raise InputError(f"{tree.path} holds a Landsat and a Sentinel-2 product: give the folder of one")
    return found[0] if found else None


def _folder_of(file: Path) -> FileTree:
    names = sorted(entry.name for entry in file.parent.iterdir() if entry.is_file())
    return FileTree(file.parent, tuple(names))


def _may_hold_product(folder: Path) -> bool:
    """Whether a folder may hold a product; others, such as the root of a disk, are not listed completely."""
    names = [entry.name for entry in folder.iterdir()]
    return any(
        landsat.FILE.fullmatch(name)
        or landsat.METADATA.fullmatch(name)
        or sentinel2.METADATA.fullmatch(name)
        or name == "GRANULE"
        or name.upper().endswith(".SAFE")
        for name in names
    )


BAND_OF: Final = re.compile(
    r"(?P<scene>.+?)_(?:(?:SR|ST)_)?(?P<band>B(?:\d{1,2}|8A))(?:_VCID_\d|_\d\dm)?", re.IGNORECASE
)
"""File name, without its suffix, of a band of a product."""
RASTERS: Final = (".tif", ".tiff", ".vrt", ".jp2", ".img")
"""Endings of the files of a folder that are taken for images."""


def rasters_of(folder: PathLike) -> list[str]:
    """Return the images of a folder that is no product: all rasters but quality rasters, by name."""
    files = sorted(file for file in Path(folder).iterdir() if file.suffix.casefold() in RASTERS)
    return [os.fspath(file) for file in files if not is_quality_raster(file.name)]


def of_one_product(first: str, second: str) -> bool:
    """Whether two files are bands of one product, which were recorded and placed together.

    Parameters
    ----------
    first, second : str
        Paths or GDAL URIs. The names tell of Landsat and Sentinel-2, or those of renamed files in one folder
        the metadata file beside them (``a_B4.tif``, ``a_B10.tif``, ``a_MTL.txt``).
    """
    stems = [Path(file_name(uri)).stem for uri in (first, second)]
    one, other = map(BAND_OF.fullmatch, stems)
    if one is None or other is None or one["scene"].upper() != other["scene"].upper() or one[0] == other[0]:
        return False
    if any(native_px_m(stem, None) for stem in stems):  # a name that is the scene's alone
        return True
    folder, beside = (Path(plain_uri(uri)).parent for uri in (first, second))
    ends = ("txt", "json", "xml")
    return folder == beside and any((folder / f"{one['scene']}_MTL.{end}").is_file() for end in ends)
