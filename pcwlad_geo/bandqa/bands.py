"""The bands that are compared, from the rasters and products that the user names."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from rasterio.enums import ColorInterp

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import BAND_NAME
from pcwlad_geo.products import Product, find_product, native_px_m, no_product, rasters_of, stem_of
from pcwlad_geo.raster.file_tree import is_folder
from pcwlad_geo.raster.geodesy import middle_pixel_size_m
from pcwlad_geo.raster.source import RasterInfo, describe, file_name, open_raster, plain_uri, without_collar
from pcwlad_geo.types import PathLike

_BANDS: Final = re.compile(r"(.+):((?:\d+(?:-\d+)?|[A-Za-z]\w*)(?:,(?:\d+(?:-\d+)?|[A-Za-z]\w*))*)")


@dataclass(frozen=True, slots=True)
class Wanted:
    """A band that is requested for comparison."""

    uri: str
    """Path or GDAL URI that is opened."""
    number: int
    mask: PathLike | None
    name: str | None = None
    """Name of the band in its product."""
    product: str | None = None
    """Path of the product, if the band belongs to one."""
    notes: tuple[str, ...] = ()
    """Warnings about the band."""


def expand(
    raster: PathLike, bands: Sequence[int | str] | None = None, mask: PathLike | None = None
) -> list[Wanted]:
    """Return the bands requested by an argument of the command line.

    Raises `InputError` if the raster or product cannot be used, or lacks a band.

    Parameters
    ----------
    raster : path
        A raster, a product (see `detect.find_product`) or a folder of rasters; ``FILE:2,4-6`` and
        ``PRODUCT:B4,B10`` select these bands of it.
    bands : sequence of int or str, optional
        Bands if the argument names none; None = all that show the ground.
    mask : path, optional
        Mask of all bands, 0 = excluded; None = the product's own.
    """
    path, own = split_bands(raster)
    if not path:
        raise InputError("a raster has an empty name: give its path")
    wanted = own or bands
    product = find_product(path)
    if product is not None:
        return _of_product(product, wanted, mask)
    files = rasters_of(path) if is_folder(path) else []
    return [each for file in files or [path] for each in _of_raster(file, wanted, mask)]


def split_bands(raster: PathLike) -> tuple[str, list[int | str] | None]:
    """Return a path without its suffix ``:2,4-6`` or ``:B4,B10``, and the bands that this names.

    A GDAL URI is unchanged.
    """
    raster = os.fspath(raster)
    match = _BANDS.fullmatch(raster)
    if match is None or Path(raster).exists() or not _is_file(match[1]):
        return raster, None
    return match[1], parse_bands(match[2])


def parse_bands(text: str) -> list[int | str]:
    """Parse a list of bands such as ``2,4-6`` or ``B4,B10``.

    Raises `SettingsError` if the list cannot be parsed.
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


LONGEST_NAME: Final = 24
"""Largest length of a description that is used as a name."""
_ONE_SIZE: Final = 1.05
"""Ratio of pixel areas below which pixels count as equal in size."""


@dataclass(frozen=True, slots=True)
class Band:
    """A band of the set that is compared."""

    name: str
    """Short name, unique in the set."""
    info: RasterInfo
    description: str | None
    """Description of the band in its file."""
    px_m: tuple[float, float] | None
    """Pixel size (col, row), metres; None without a CRS."""
    native_m: tuple[float, float] | None
    """Native pixel size (col, row) of the sensor, metres; that of the file if no other is known."""
    native_known: bool
    """Whether the native pixel size is stated by a known sensor or the user."""
    product: str | None = None
    """Path of the band's product; None if the raster itself was given."""
    notes: tuple[str, ...] = ()
    """Warnings about the band."""

    @property
    def file(self) -> str:
        """Path or GDAL URI of its file."""
        return plain_uri(self.info.uri)

    @property
    def where(self) -> str:
        """File and number of the band, as text."""
        return f"{file_name(self.info.uri)}, band {self.info.band}"


def list_bands(
    rasters: Sequence[PathLike], bands: Sequence[int | str] | None = None, mask: PathLike | None = None
) -> list[Band]:
    """Describe the bands that are compared, those with the finest pixels first.

    Raises `InputError` if a raster, band or mask cannot be used, a band occurs twice, or there are fewer than
    two.

    Parameters
    ----------
    rasters : sequence of path
        Rasters or products; ``FILE:2,4,5``, ``FILE:1-4`` or ``PRODUCT:B4,B10`` selects bands.
    bands : sequence of int or str, optional
        Bands of the rasters without such a selection; None = all except alpha and cirrus bands.
    mask : path, optional
        Mask of all rasters, 0 = excluded; None = those of the products.
    """
    found = [_described(wanted) for raster in rasters for wanted in expand(raster, bands, mask)]
    for band in found:
        if sum(_same(band, other) for other in found) > 1:
            raise InputError(f"{band.where} is there twice: name every band once")
    if len(found) < 2:
        raise InputError(
            f"a quality report compares two bands or more, and there is {len(found)}: give more "
            "rasters, or more bands of it"
        )
    names = _names(found)
    named = [replace(band, name=name) for band, name in zip(found, names, strict=True)]
    return _finest_first(named)


def find_band(bands: Sequence[Band], name: str) -> Band:
    """Return the one of `bands` whose short name, description, file name or stem is, or ends with, `name`.

    Raises `SettingsError` if no band or more than one has the name.
    """
    matches: list[Band] = []
    for fold in (str.casefold, _without_zero):
        wanted = fold(name)
        matches = matches or [band for band in bands if fold(band.name) == wanted]
        matches = matches or [band for band in bands if wanted in map(fold, _spellings(band))]
        matches = matches or [band for band in bands if wanted in map(fold, _last_words(band))]
    if len(matches) == 1:
        return matches[0]
    names = ", ".join(band.name for band in (matches or bands))
    found = "is more than one band" if matches else "is none of the bands"
    raise SettingsError(f"'{name}' {found}: give one of {names}")


def with_native_px(bands: Sequence[Band], stated: Sequence[str]) -> list[Band]:
    """Return the bands with the native pixel sizes that the user states.

    Raises `SettingsError` if a size cannot be parsed, or names no band.

    Parameters
    ----------
    stated : sequence of str
        ``NAME=METRES``, or ``METRES`` for all bands.
    """
    result = {band.name: band for band in bands}
    if stated and any(band.px_m is None for band in bands):
        raise SettingsError("native_px is in metres, and there is a band without a CRS: leave it out")
    for text in stated:
        name, _, size = text.rpartition("=")
        try:
            metres = float(size)
        except ValueError:
            metres = 0.0
        if not 0 < metres < float("inf"):
            raise SettingsError(f"native_px = {text!r}: give NAME=METRES, such as B10=100, or METRES")
        for band in [find_band(bands, name)] if name else bands:
            result[band.name] = replace(result[band.name], native_m=(metres, metres), native_known=True)
    return list(result.values())


def _finest_first(bands: Sequence[Band]) -> list[Band]:
    """Return the bands sorted by pixel size; the order of bands of equal size is kept.

    Equal pixels differ slightly on the ground, because the scale of a map varies with position.
    """
    areas = [0.0 if band.px_m is None else band.px_m[0] * band.px_m[1] for band in bands]
    size, sizes = 0.0, {}
    for area in sorted(set(areas)):
        size = area if area > size * _ONE_SIZE else size
        sizes[area] = size
    return [band for _, band in sorted(zip(areas, bands, strict=True), key=lambda pair: sizes[pair[0]])]


def _described(wanted: Wanted) -> Band:
    info, collar = without_collar(describe(wanted.uri, band=wanted.number, mask=wanted.mask))
    description = wanted.name
    if description is None:
        with open_raster(wanted.uri) as dataset:
            description = dataset.descriptions[wanted.number - 1]
    px_m = middle_pixel_size_m(info.grid)
    known = native_px_m(Path(file_name(wanted.uri)).stem, description)
    native = (known, known) if known else px_m
    notes = (*wanted.notes, *collar)
    return Band("", info, description, px_m, native, known is not None, wanted.product, notes)


def _same(a: Band, b: Band) -> bool:
    if a.info.band != b.info.band:
        return False
    return Path(a.file).absolute() == Path(b.file).absolute()


def _names(bands: Sequence[Band]) -> list[str]:
    """Return a short, unique name for each band: a word for its file if there are several, and its own.

    A product counts as one file.
    """
    sources = [band.product or band.file for band in bands]
    stems = [
        stem_of(source) if band.product else Path(source).stem
        for source, band in zip(sources, bands, strict=True)
    ]
    several = len(set(sources)) > 1
    names = []
    for band, file in zip(bands, _short_stems(stems), strict=True):
        own = _own_name(band)
        alone = band.info.band_count == 1 and band.product is None
        names.append(file if several and alone else f"{file} {own}" if several else own)
    for form in ("{stem} {band}", "{uri} {band}"):
        if len(set(names)) == len(names):
            break
        names = [form.format(stem=Path(band.file).stem, uri=band.file, band=band.info.band) for band in bands]
    return names


def _spellings(band: Band) -> list[str]:
    """Return the names by which a band may be given."""
    path = Path(band.file)
    numbered = (f"{path.name}:{band.info.band}", f"{path.stem}:{band.info.band}", str(band.info.band))
    return [band.description or "", path.name, path.stem, band.file, band.info.uri, *numbered]


def _last_words(band: Band) -> list[str]:
    texts = (band.name, band.description or "", Path(band.file).stem)
    return [re.split(r"[_\-. ]", text)[-1] for text in texts]


def _without_zero(name: str) -> str:
    """Return a name without leading zeros in lower case, so that B4 and b04 are equal."""
    return re.sub(r"\bb0(?=\d)", "b", name.casefold())


def _own_name(band: Band) -> str:
    """Return the name of a band within its file."""
    text = " ".join((band.description or "").split())
    return text if 0 < len(text) <= LONGEST_NAME else f"band {band.info.band}"


def _short_stems(stems: Sequence[str]) -> list[str]:
    """Return a word that identifies each file: the first, or the part after the words common to all."""
    different = list(dict.fromkeys(stems))
    if len(different) < 2:
        return list(stems)
    first = {stem: re.split(r"[_\-. ]", stem)[0] for stem in different}
    if all(first.values()) and len(set(first.values())) == len(different):
        return [first[stem] for stem in stems]
    low, high = min(different), max(different)  # what these two share is common to all
    shared = next((i for i, pair in enumerate(zip(low, high, strict=False)) if pair[0] != pair[1]), len(low))
    cut = max(low.rfind(mark, 0, shared) for mark in "_-. ") + 1
    short = [stem[cut:] for stem in stems]
    return short if all(short) else list(stems)
