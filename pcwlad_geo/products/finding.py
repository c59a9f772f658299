"""Which product lies at a path, and what the name of a file says, by all kinds of products."""

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
from pcwlad_geo.plugins import Registry
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import FileTree, file_name, is_folder
from pcwlad_geo.raster.file_tree import is_archive, name_in, plain_uri, tree_of
from pcwlad_geo.types import Float64, PathLike

KINDS: Final = Registry(
    "pcwlad_geo.products",
    ProductKind,
    (
        "pcwlad_geo.products.landsat:LANDSAT",
        "pcwlad_geo.products.sentinel2:SENTINEL2",
        "pcwlad_geo.products.sentinel1:SENTINEL1",
        "pcwlad_geo.products.planet:PLANET",
        "pcwlad_geo.products.hls:HLS",
        "pcwlad_geo.products.maja:MAJA",
        "pcwlad_geo.products.spectral:ENMAP",
        "pcwlad_geo.products.spectral:DESIS",
        "pcwlad_geo.products.hdf5_cubes:PRISMA",
        "pcwlad_geo.products.hdf5_cubes:EMIT",
        "pcwlad_geo.products.ecostress:ECOSTRESS",
        "pcwlad_geo.products.swaths:ECOSTRESS_SWATH",
        "pcwlad_geo.products.swaths:VIIRS_L1B",
        "pcwlad_geo.products.modis:MODIS",
        "pcwlad_geo.products.aster:ASTER",
        "pcwlad_geo.products.stac:STAC",
    ),
)
"""The kinds of products."""
_NOMINAL: Final = 0.002
"""Tolerance of nominal pixel sizes, which refer to map grids: UTM lengths are true within 0.1 %."""
_ENDING: Final = re.compile(r"(_MTL\.(txt|json|xml)|(\.SAFE)?(\.zip|\.tar|\.tar\.gz|\.tgz)?)$", re.IGNORECASE)
_FOUND: Final[ContextVar[dict[str, Product | None] | None]] = ContextVar("found products", default=None)


@contextmanager
def products_found_once() -> Iterator[None]:
    """Find the product of a path once within the context, which is that of a job."""
    cache = _FOUND.get()
    token = _FOUND.set({} if cache is None else cache)
    try:
        yield
    finally:
        _FOUND.reset(token)


def find_product(path: PathLike) -> Product | None:
    """Return the product at a path; None for a plain raster.

    A product is given by a folder or an archive (.zip, .tar, .tar.gz) with its files, by its metadata file
    (MTL, MTD_MSIL*.xml, manifest.safe …), or, where its kind says so, by one image. Raises `InputError` if
    the product cannot be used, or an archive holds none.
    """
    cache = _FOUND.get()
    if cache is None:
        return _search(path)
    name = os.fspath(path)
    if name not in cache:
        cache[name] = _search(path)
    return cache[name]


def _search(path: PathLike) -> Product | None:
    place = Path(path)
    try:
        if place.is_dir():
            return _in_tree(tree_of(place)) if may_hold_product(place) else None
        if not place.is_file():
            return None
    except (OSError, ValueError):  # a GDAL URI that is not a path
        return None
    if not is_archive(place):
        return _only(place, KINDS.ask(lambda kind: _of_file(kind, place), Product))
    product = _in_tree(tree_of(place))
    if product is None:
        names = [name_in(name) for name in tree_of(place).names]
        part = next(KINDS.ask(lambda kind: kind.part(names), str), None)
        if part:
            raise InputError(f"{path} holds {part}")
        raise InputError(
            f"{path} holds no Landsat and no Sentinel product, and no other that is known: give a raster "
            "inside it as /vsizip/… or /vsitar/…" + _problems()
        )
    return product


def _of_file(kind: ProductKind, path: Path) -> Product | None:
    """Return the product that a file stands for."""
    if kind.metadata is not None and kind.metadata.fullmatch(path.name):
        return kind.find(tree_of(path.parent))
    return kind.of_file(path)


def _in_tree(tree: FileTree) -> Product | None:
    return _only(tree.path, KINDS.ask(lambda kind: kind.find(tree), Product))


def _only(path: Path, products: Iterator[Product]) -> Product | None:
    """Return the only one of the products at a path, or None if there is none."""
    candidates = tuple(products)
    if len(candidates) > 1:
        kinds = " and a ".join(product.kind.split()[0] for product in candidates)
        raise InputError(f"{path} holds a {kinds} product: give the folder of one")
    return candidates[0] if candidates else None


def stem_of(path: PathLike) -> str:
    """Return the name of a raster or product without its suffix, from which names of outputs are formed."""
    place = Path(path)
    if any(KINDS.ask(lambda kind: bool(kind.metadata and kind.metadata.fullmatch(place.name)), bool)):
        place = place.parent
    if place.name in ("", ".."):
        place = place.resolve()
    shortened = _ENDING.sub("", place.name)
    return shortened if shortened != place.name else place.stem if not is_folder(place) else place.name


def may_hold_product(folder: Path) -> bool:
    """Whether a folder may hold a product; others, such as the root of a disk, are not listed completely."""
    names = [entry.name for entry in folder.iterdir()]
    return any(KINDS.ask(lambda kind: any(map(kind.marks, names)), bool))


def of_one_product(first: str, second: str) -> bool:
    """Whether two files are bands of one product, which were recorded and placed together.

    The names tell of Landsat and Sentinel-2, or those of renamed files in one folder the metadata file beside
    them (``a_B4.tif``, ``a_B10.tif``, ``a_MTL.txt``).
    """
    one, other = (Path(plain_uri(uri)).parent / file_name(uri) for uri in (first, second))
    if one.stem == other.stem:
        return False
    scenes = KINDS.ask(lambda kind: _common_scene(kind, one, other), str)
    return next(scenes, None) is not None


def _common_scene(kind: ProductKind, one: Path, other: Path) -> str | None:
    scene = kind.scene_of(one)
    return scene if scene is not None and scene == kind.scene_of(other) else None


def native_per_px(px_m: tuple[float, float], native_m: float | tuple[float, float]) -> Float64:
    """Return the pixel size in native pixels along (col, row).

    The pixel is `px_m` large on the ground, metres, and the native pixel nominally `native_m`. The (2,)
    result is 1 where the sizes differ only by the tolerance of nominal sizes.
    """
    ratio = np.array(px_m) / native_m
    return np.where(np.abs(ratio - 1.0) <= _NOMINAL, 1.0, ratio)


def native_px_m(stem: str, description: str | None) -> float | None:
    """Return the pixel size recorded by the sensor, in metres; None if the names do not determine it.

    The `stem` is the name of a band's file without its ending, the `description` that of the band in it.
    """
    return next(KINDS.ask(lambda kind: _recorded_m(kind, stem, description), float), None)


def _recorded_m(kind: ProductKind, stem: str, description: str | None) -> float | None:
    metres = kind.native_px_m(stem, description)
    return None if metres is None else float(metres)


def no_product(path: str, band: str | None = None) -> str | None:
    """Return why a path is not a product whose bands have names, and what to do.

    For this path `find_product` finds no product. The result is None if it may be a raster and no `band` was
    requested by name.
    """
    place = Path(path)
    if is_folder(place):
        return _folder(place) + _problems()
    if band is None:
        return None
    if any(KINDS.ask(lambda kind: bool(kind.band_file and kind.band_file.fullmatch(place.name)), bool)):
        return (
            f"{path} is the file of one band of a product, in which band {band} cannot be found by name: "
            "leave the band out, or give the folder of the product"
        )
    return (
        f"band {band} of {path}: it is no product, and only the bands of Landsat, Sentinel and other "
        "products have names; give the number of a band, from 1" + _problems()
    )


def _folder(folder: Path) -> str:
    names = [entry.name for entry in folder.iterdir()]
    if may_hold_product(folder):
        names += [name_in(name) for name in tree_of(folder).names]
    part = next(KINDS.ask(lambda kind: kind.part(names), str), None)
    return (
        f"{folder} holds {part}"
        if part
        else (
            f"{folder} is a folder, and neither a Landsat scene nor a Sentinel-1 or Sentinel-2 product: give "
            "a raster file"
        )
    )


def _problems() -> str:
    """Return the warnings about kinds of other packages that cannot be used, to end a message."""
    return "".join(f"; {problem}" for problem in KINDS.problems())
