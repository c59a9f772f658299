"""The bands of a stack: which of which raster, and what they are called."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.geodesy import middle_pixel_size_m
from pcwlad_geo.raster.native_pixels import native_px_m
from pcwlad_geo.raster.products import stem_of
from pcwlad_geo.raster.source import RasterInfo, describe, file_name, open_raster, plain_uri
from pcwlad_geo.stacks.inputs import PathLike, Wanted, expand

LONGEST_NAME: Final = 24
"""Descriptions that are longer are no names."""
_ONE_SIZE: Final = 1.05
"""Pixels whose areas differ by less than this factor are of one size."""


@dataclass(frozen=True, slots=True)
class Band:
    """A band of the stack."""

    name: str
    """Short and unique in the stack."""
    info: RasterInfo
    description: str | None
    """As the file has it."""
    px_m: tuple[float, float] | None
    """Pixel size (col, row), metres; None without a CRS."""
    native_m: tuple[float, float] | None
    """Pixel size (col, row) that the sensor recorded; that of the file where nothing else is known."""
    native_told: bool
    """Whether a known sensor or the user says so."""
    product: str | None = None
    """Path of the product that it is of; None: the raster was given itself."""
    notes: tuple[str, ...] = ()
    """What to warn of."""

    @property
    def file(self) -> str:
        """Path or GDAL URI of its file."""
        return plain_uri(self.info.uri)

    @property
    def where(self) -> str:
        """Its file and number."""
        return f"{file_name(self.info.uri)}, band {self.info.band}"


def list_bands(
    rasters: Sequence[PathLike], bands: Sequence[int | str] | None = None, mask: PathLike | None = None
) -> list[Band]:
    """Describe the bands of a stack, those of the finest pixels first.

    Parameters
    ----------
    rasters : sequence of path
        Rasters or products; ``FILE:2,4,5``, ``FILE:1-4`` or ``PRODUCT:B4,B10`` takes these bands of it.
    bands : sequence of int or str, optional
        Bands of those that do not name theirs; None = all that are no alpha and no cirrus band.
    mask : path, optional
        Mask of all rasters, 0 = excluded; None = those of the products.

    Raises
    ------
    InputError
        If a raster, band or mask cannot be used, a band is there twice, or there are fewer than two.
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
    """Return the band of a name: its short name, description, file name or stem, or the end of one.

    Raises
    ------
    SettingsError
        If there is none, or more than one.
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


def with_native_px(bands: Sequence[Band], told: Sequence[str]) -> list[Band]:
    """Return the bands with the native pixel sizes that the user tells.

    Parameters
    ----------
    bands : sequence of Band
    told : sequence of str
        ``NAME=METRES``, or ``METRES`` for all bands.

    Raises
    ------
    SettingsError
        If one cannot be read, or names no band.
    """
    result = {band.name: band for band in bands}
    if told and any(band.px_m is None for band in bands):
        raise SettingsError("native_px is in metres, and there is a band without a CRS: leave it out")
    for text in told:
        name, _, size = text.rpartition("=")
        try:
            metres = float(size)
        except ValueError:
            metres = 0.0
        if not 0 < metres < float("inf"):
            raise SettingsError(f"native_px = {text!r}: give NAME=METRES, such as B10=100, or METRES")
        for band in [find_band(bands, name)] if name else bands:
            result[band.name] = replace(result[band.name], native_m=(metres, metres), native_told=True)
    return list(result.values())


def _finest_first(bands: Sequence[Band]) -> list[Band]:
    """Return the bands by the size of their pixels; those of one size stay in their order.

    On the ground pixels of one size are not quite of one size, as the scale of a map changes with the place.
    """
    areas = [0.0 if band.px_m is None else band.px_m[0] * band.px_m[1] for band in bands]
    size, sizes = 0.0, {}
    for area in sorted(set(areas)):
        size = area if area > size * _ONE_SIZE else size
        sizes[area] = size
    return [band for _, band in sorted(zip(areas, bands, strict=True), key=lambda pair: sizes[pair[0]])]


def _described(wanted: Wanted) -> Band:
    info = describe(wanted.uri, band=wanted.number, mask=wanted.mask)
    description = wanted.name
    if description is None:
        with open_raster(wanted.uri) as dataset:
            description = dataset.descriptions[wanted.number - 1]
    px_m = middle_pixel_size_m(info.grid)
    known = native_px_m(Path(file_name(wanted.uri)).stem, description)
    native = (known, known) if known else px_m
    return Band("", info, description, px_m, native, known is not None, wanted.product, wanted.notes)


def _same(a: Band, b: Band) -> bool:
    if a.info.band != b.info.band:
        return False
    return Path(a.file).absolute() == Path(b.file).absolute()


def _names(bands: Sequence[Band]) -> list[str]:
    """Return a short, unique name for each: a word for its file where there are several, and one for it.

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
    """Return what a band may be called, in full."""
    path = Path(band.file)
    numbered = (f"{path.name}:{band.info.band}", f"{path.stem}:{band.info.band}", str(band.info.band))
    return [band.description or "", path.name, path.stem, band.file, band.info.uri, *numbered]


def _last_words(band: Band) -> list[str]:
    texts = (band.name, band.description or "", Path(band.file).stem)
    return [re.split(r"[_\-. ]", text)[-1] for text in texts]


def _without_zero(name: str) -> str:
    """Return a name as it is compared where nothing else is found: B4 and b04 are one."""
    return re.sub(r"\bb0(?=\d)", "b", name.casefold())


def _own_name(band: Band) -> str:
    """Return what a band is called within its file."""
    text = " ".join((band.description or "").split())
    return text if 0 < len(text) <= LONGEST_NAME else f"band {band.info.band}"


def _short_stems(stems: Sequence[str]) -> list[str]:
    """Return the word that tells each file: the first, or what follows the words that all share."""
    different = list(dict.fromkeys(stems))
    if len(different) < 2:
        return list(stems)
    first = {stem: re.split(r"[_\-. ]", stem)[0] for stem in different}
    if all(first.values()) and len(set(first.values())) == len(different):
        return [first[stem] for stem in stems]
    low, high = min(different), max(different)  # what these two share, all do
    shared = next((i for i, pair in enumerate(zip(low, high, strict=False)) if pair[0] != pair[1]), len(low))
    cut = max(low.rfind(mark, 0, shared) for mark in "_-. ") + 1
    short = [stem[cut:] for stem in stems]
    return short if all(short) else list(stems)
