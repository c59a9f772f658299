"""Products of several files, told from plain rasters; the names that results take from them."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import landsat, sentinel2
from pcwlad_geo.raster.file_tree import FileTree, is_archive, tree_of
from pcwlad_geo.raster.product import Product

PathLike = str | os.PathLike[str]

_STEM: Final = re.compile(r"(_MTL\.(txt|json|xml)|(\.SAFE)?(\.zip|\.tar|\.tar\.gz|\.tgz)?)$", re.IGNORECASE)


def find_product(path: PathLike) -> Product | None:
    """Return the product that a path stands for; None where it is a plain raster.

    A folder or an archive (.zip, .tar, .tar.gz) that holds a Landsat Collection 2 scene or a Sentinel-2 SAFE,
    the MTL file of the former, or the MTD_MSIL*.xml of the latter.

    Raises
    ------
    InputError
        If it is a product and cannot be used, or an archive without one.
    """
    place = Path(path)
    try:
        if place.is_dir():
            return _found(tree_of(place)) if _may_hold_product(place) else None
        if not place.is_file():
            return None
    except (OSError, ValueError):  # a GDAL URI that is no path
        return None
    match = landsat.FILE.fullmatch(place.name)
    if match and landsat.METADATA.fullmatch(match["part"]):
        return landsat.find_landsat(_folder_of(place), match["id"])
    if sentinel2.METADATA.fullmatch(place.name):
        return sentinel2.find_sentinel2(tree_of(place.parent))
    if not is_archive(place):
        return None
    product = _found(tree_of(place))
    if product is None:
        raise InputError(
            f"{path} holds no Landsat Collection 2 and no Sentinel-2 product: give a raster inside it as "
            "/vsizip/… or /vsitar/…"
        )
    return product


def stem_of(path: PathLike) -> str:
    """Return the name of a raster or product without its ending: results are named after it."""
    place = Path(path)
    if sentinel2.METADATA.fullmatch(place.name):
        place = place.parent
    if place.name in ("", ".."):
        place = place.resolve()
    shortened = _STEM.sub("", place.name)
    return shortened if shortened != place.name else place.stem if not place.is_dir() else place.name


def _found(tree: FileTree) -> Product | None:
    found = [product for product in (landsat.find_landsat(tree), sentinel2.find_sentinel2(tree)) if product]
    if len(found) > 1:
        raise InputError(f"{tree.path} holds a Landsat and a Sentinel-2 product: give the folder of one")
    return found[0] if found else None


def _folder_of(file: Path) -> FileTree:
    names = sorted(entry.name for entry in file.parent.iterdir() if entry.is_file())
    return FileTree(file.parent, tuple(names))


def _may_hold_product(folder: Path) -> bool:
    """Whether it is worth listing all of a folder: a wrong one may be the root of a disk."""
    names = [entry.name for entry in folder.iterdir()]
    return any(
        landsat.FILE.fullmatch(name)
        or sentinel2.METADATA.fullmatch(name)
        or name == "GRANULE"
        or name.upper().endswith(".SAFE")
        for name in names
    )
