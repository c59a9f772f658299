"""The bands that a quality report compares, and their names."""

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
from pcwlad_geo.products.finding import find_product, native_px_m, no_product, stem_of
from pcwlad_geo.products.names import rasters_of
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import RasterInfo, describe, file_name, is_folder, middle_pixel_size_m, open_raster
from pcwlad_geo.raster.file_tree import plain_uri
from pcwlad_geo.raster.undeclared import without_undeclared
from pcwlad_geo.text import whole
from pcwlad_geo.types import PathLike

_BANDS: Final = re.compile(r"(.+):((?:[\d.-]+(?:nm)?|[A-Za-z]\w*)(?:,(?:[\d.-]+(?:nm)?|[A-Za-z]\w*))*)")


@dataclass(frozen=True, slots=True)
class RequestedBand:
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
) -> list[RequestedBand]:
    """Return the bands requested by an argument of the command line.

    It is a raster, a product (see `products.finding.find_product`) or a folder of rasters; ``FILE:2,4-6`` and
    ``PRODUCT:B4,B10`` select these bands of it. Without such a suffix they are `bands`, by default all that
    show the ground. The `mask` applies to all of them, 0 = excluded; the default is the mask of the product.
    Raises `InputError` if the raster or product cannot be used, or lacks a band.
    """
    path, suffix_bands = split_bands(raster)
    if not path:
        raise InputError("a raster has an empty name: give its path")
    requested = suffix_bands or bands
    product = find_product(path)
    if product is not None:
        return _of_product(product, requested, mask)
    files = rasters_of(path) if is_folder(path) else []
    return [request for file in files or [path] for request in _of_raster(file, requested, mask)]


def split_bands(raster: PathLike) -> tuple[str, list[int | str] | None]:
    """Return a path without its suffix ``:2,4-6`` or ``:B4,B10``, and the bands that this names.

    A GDAL URI is unchanged.
    """
    raster = os.fspath(raster)
    match = _BANDS.fullmatch(raster)
    if match is None or Path(raster).exists() or not (match[1].startswith("/vsi") or Path(match[1]).exists()):
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
        begin, dash, end = part.partition("-")
        first, last = whole(begin), whole(end if dash else begin)
        if not first or last is None:
            raise SettingsError(
                f"bands = {text!r}: give numbers from 1, such as 2,4,5 or 1-4, or names of a product's bands"
            )
        span = range(first, last + 1)
        if not span or len(span) > 1000:
            raise SettingsError(f"bands = {text!r}: {part.strip()} is no range of bands")
        bands += span
    return bands


def _of_raster(uri: str, requested: Sequence[int | str] | None, mask: PathLike | None) -> list[RequestedBand]:
    for name in (None, *(band for band in requested or () if isinstance(band, str))):
        problem = no_product(uri, name)
        if problem is not None:
            raise InputError(problem)
    if requested is None:
        with open_raster(uri) as dataset:
            kinds = zip(dataset.indexes, dataset.colorinterp, strict=True)
            requested = [number for number, kind in kinds if kind != ColorInterp.alpha] or [1]
    return [RequestedBand(uri, int(number), mask) for number in requested]


def _of_product(
    product: Product, requested: Sequence[int | str] | None, mask: PathLike | None
) -> list[RequestedBand]:
    if requested is None:
        bands, notes = product.ground_bands()
    else:
        bands, notes = tuple(band for name in requested for band in product.chosen(name)), ()
    notes += product.notes(mask is not None)
    product_mask = mask or product.mask
    return [
        RequestedBand(band.opened_as(), band.number, product_mask, band.name, product.path, notes)
        for band in bands
    ]


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

    The parameters are those of `expand`, for several rasters. Raises `InputError` if a raster, band or mask
    cannot be used, a band occurs twice, or there are fewer than two.
    """
    described = [_described(request) for raster in rasters for request in expand(raster, bands, mask)]
    places = [(band.info.band, Path(band.file).absolute()) for band in described]
    for band, place in zip(described, places, strict=True):
        if places.count(place) > 1:
            raise InputError(f"{band.where} is there twice: name every band once")
    if len(described) < 2:
        raise InputError(
            f"a quality report compares two bands or more, and there is {len(described)}: give more "
            "rasters, or more bands of it"
        )
    return _finest_first(
        [replace(band, name=name) for band, name in zip(described, _names(described), strict=True)]
    )


def find_band(bands: Sequence[Band], name: str) -> Band:
    """Return the band whose short name, description, file name or stem is, or ends with, `name`.

    Raises `SettingsError` if no band or more than one has the name.
    """
    matches: list[Band] = []
    for fold in (str.casefold, _without_zero):
        folded = fold(name)
        matches = matches or [band for band in bands if fold(band.name) == folded]
        matches = matches or [band for band in bands if folded in map(fold, _spellings(band))]
        matches = matches or [band for band in bands if folded in map(fold, _last_words(band))]
    if len(matches) == 1:
        return matches[0]
    names = ", ".join(band.name for band in (matches or bands))
    problem = "is more than one band" if matches else "is none of the bands"
    raise SettingsError(f"'{name}' {problem}: give one of {names}")


def with_native_px(bands: Sequence[Band], stated: Sequence[str]) -> list[Band]:
    """Return the bands with the native pixel sizes that the user states.

    Raises `SettingsError` if a size cannot be parsed, or names no band. Each of the `stated` is
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
        size = area if area > size * 1.05 else size  # about equal ones count as equal
        sizes[area] = size
    return [band for _, band in sorted(zip(areas, bands, strict=True), key=lambda pair: sizes[pair[0]])]


def _described(request: RequestedBand) -> Band:
    info, undeclared = without_undeclared(describe(request.uri, band=request.number, mask=request.mask))
    description = request.name
    if description is None:
        with open_raster(request.uri) as dataset:
            description = dataset.descriptions[request.number - 1]
    px_m = middle_pixel_size_m(info.grid)
    native = native_px_m(Path(file_name(request.uri)).stem, description)
    return Band(
        name="",
        info=info,
        description=description,
        px_m=px_m,
        native_m=(native, native) if native else px_m,
        native_known=native is not None,
        product=request.product,
        notes=(*request.notes, *undeclared),
    )


def _names(bands: Sequence[Band]) -> list[str]:
    """Return a short, unique name for each band, with a word for its file or product if there are several."""
    sources = [band.product or band.file for band in bands]
    stems = [
        stem_of(source) if band.product else Path(source).stem
        for source, band in zip(sources, bands, strict=True)
    ]
    several = len(set(sources)) > 1
    names = []
    for band, file in zip(bands, _short_stems(stems), strict=True):
        band_name = _own_name(band)
        single = band.info.band_count == 1 and band.product is None
        names.append(file if several and single else f"{file} {band_name}" if several else band_name)
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
    return text if 0 < len(text) <= 24 else f"band {band.info.band}"


def _short_stems(stems: Sequence[str]) -> list[str]:
    """Return a word that identifies each file: the first, or the part after the words common to all."""
    different = list(dict.fromkeys(stems))
    if len(different) < 2:
        return list(stems)
    first = {stem: re.split(r"[_\-. ]", stem)[0] for stem in different}
    if all(first.values()) and len(set(first.values())) == len(different):
        return [first[stem] for stem in stems]
    common = os.path.commonprefix(different)  # noqa: RUF071  # of their characters
    cut = max(common.rfind(mark) for mark in "_-. ") + 1
    short = [stem[cut:] for stem in stems]
    return short if all(short) else list(stems)
