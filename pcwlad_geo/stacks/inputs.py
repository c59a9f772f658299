"""What the user names, rasters and products, to the bands of a stack."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rasterio.enums import ColorInterp

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.product import Product
from pcwlad_geo.raster.products import find_product
from pcwlad_geo.raster.source import open_raster
from pcwlad_geo.raster.unknown_products import no_product
from pcwlad_geo.registration.settings import BAND_NAME

PathLike = str | os.PathLike[str]

_BANDS: Final = re.compile(r"(.+):((?:\d+(?:-\d+)?|[A-Za-z]\w*)(?:,(?:\d+(?:-\d+)?|[A-Za-z]\w*))*)")


@dataclass(frozen=True, slots=True)
class Wanted:
    """A band that is to be compared."""

    uri: str
    """What is opened."""
    number: int
    mask: PathLike | None
    name: str | None = None
    """As its product calls it."""
    product: str | None = None
    """Path of the product, if it is of one."""
    notes: tuple[str, ...] = ()
    """What to warn of."""


def expand(
    raster: PathLike, bands: Sequence[int | str] | None = None, mask: PathLike | None = None
) -> list[Wanted]:
    """Return the bands that a word of the command line asks for.

    Parameters
    ----------
    raster : path
        A raster or a product (see `products.find_product`); ``FILE:2,4-6`` and ``PRODUCT:B4,B10`` take these
        bands of it.
    bands : sequence of int or str, optional
        Bands where the word names none; None = all that show the ground.
    mask : path, optional
        Of all bands, 0 = excluded; None = the product's own.

    Raises
    ------
    InputError
        If it cannot be used, or lacks a band.
    """
    path, own = split_bands(raster)
    if not path:
        raise InputError("a raster has an empty name: give its path")
    wanted = own or bands
    product = find_product(path)
    return _of_raster(path, wanted, mask) if product is None else _of_product(product, wanted, mask)


def split_bands(raster: PathLike) -> tuple[str, list[int | str] | None]:
    """Return a path without its ending ``:2,4-6`` or ``:B4,B10``, and those bands.

    A GDAL URI stays as it is.
    """
    raster = os.fspath(raster)
    match = _BANDS.fullmatch(raster)
    if match is None or Path(raster).exists() or not _is_file(match[1]):
        return raster, None
    return match[1], parse_bands(match[2])


def parse_bands(text: str) -> list[int | str]:
    """Return the bands of ``2,4-6`` or ``B4,B10``.

    Raises
    ------
    SettingsError
        If they cannot be read.
    """
    bands: list[int | str] = []
    for part in text.split(","):
        if BAND_NAME.match(part.strip()):
            bands.append(part.strip())
            continue
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or int(first) < 1:
            raise SettingsError(
                f"bands = {text!r}: give numbers from 1, such as 2,4,5 or 1-4, or names of a product's bands"
            )
        span = range(int(first), int(last or first) + 1)
        if not span or len(span) > 1000:
            raise SettingsError(f"bands = {text!r}: {part.strip()} is no range of bands")
        bands += span
    return bands


def _is_file(path: str) -> bool:
    return path.startswith("/vsi") or Path(path).exists()


def _of_raster(uri: str, wanted: Sequence[int | str] | None, mask: PathLike | None) -> list[Wanted]:
    problem = no_product(uri)
    if problem is not None:
        raise InputError(problem)
    if wanted is None:
        with open_raster(uri) as dataset:
            kinds = zip(dataset.indexes, dataset.colorinterp, strict=True)
            wanted = [number for number, kind in kinds if kind != ColorInterp.alpha] or [1]
    for number in wanted:
        problem = no_product(uri, number) if isinstance(number, str) else None
        if problem is not None:
            raise InputError(problem)
    return [Wanted(uri, int(number), mask) for number in wanted]


def _of_product(product: Product, wanted: Sequence[int | str] | None, mask: PathLike | None) -> list[Wanted]:
    if wanted is None:
        bands, notes = product.ground_bands()
    else:
        bands, notes = tuple(product.band(name) for name in wanted), ()
    notes += product.notes(mask is not None)
    chosen = mask or product.mask
    return [Wanted(band.opened_as(), 1, chosen, band.name, product.path, notes) for band in bands]
