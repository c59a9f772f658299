"""The bands of a stack: which of which raster, and what they are called."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from rasterio.enums import ColorInterp

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.geodesy import middle_pixel_size_m
from pcwlad_geo.raster.native_pixels import native_px_m
from pcwlad_geo.raster.source import RasterInfo, describe, open_raster

PathLike = str | os.PathLike[str]

LONGEST_NAME: Final = 24
"""Descriptions that are longer are no names."""


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

    @property
    def where(self) -> str:
        """Its file and number."""
        return f"{Path(self.info.uri).name}, band {self.info.band}"


def list_bands(
    rasters: Sequence[PathLike], bands: Sequence[int] | None = None, mask: PathLike | None = None
) -> list[Band]:
    """Describe the bands of a stack, those of the finest pixels first.

    Parameters
    ----------
    rasters : sequence of path
        Rasters; ``FILE:2,4,5`` or ``FILE:1-4`` takes these bands of it.
    bands : sequence of int, optional
        Bands of the rasters that do not name theirs; None = all that are no alpha.
    mask : path, optional
        Mask of all rasters, 0 = excluded.

    Raises
    ------
    InputError
        If a raster, band or mask cannot be used, a band is there twice, or there are fewer than two.
    """
    found = [_described(uri, number, mask) for raster in rasters for uri, number in _expanded(raster, bands)]
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
    return sorted(named, key=lambda band: 0.0 if band.px_m is None else round(band.px_m[0] * band.px_m[1], 6))


def find_band(bands: Sequence[Band], name: str) -> Band:
    """Return the band of a name: its short name, description, file name or stem, or the end of one.

    Raises
    ------
    SettingsError
        If there is none, or more than one.
    """
    wanted = name.casefold()

    def exact(band: Band) -> bool:
        path = Path(band.info.uri)
        numbered = (f"{path.name}:{band.info.band}", f"{path.stem}:{band.info.band}", str(band.info.band))
        return wanted in {
            text.casefold()
            for text in (band.name, band.description or "", path.name, path.stem, band.info.uri, *numbered)
        }

    def ending(band: Band) -> bool:
        texts = (band.name, band.description or "", Path(band.info.uri).stem)
        return any(re.split(r"[_\-. ]", text.casefold())[-1] == wanted for text in texts)

    matches = [band for band in bands if band.name.casefold() == wanted]
    matches = matches or [band for band in bands if exact(band)] or [band for band in bands if ending(band)]
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


def split_bands(raster: PathLike) -> tuple[str, list[int] | None]:
    """Return a path without its ending ``:2,4-6``, and those bands; a GDAL URI stays as it is."""
    raster = os.fspath(raster)
    match = re.fullmatch(r"(.+):(\d+(?:-\d+)?(?:,\d+(?:-\d+)?)*)", raster)
    if match is None or Path(raster).exists() or not _is_file(match[1]):
        return raster, None
    return match[1], parse_bands(match[2])


def parse_bands(text: str) -> list[int]:
    """Return the numbers of ``2,4-6``.

    Raises
    ------
    SettingsError
        If they cannot be read.
    """
    numbers: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or int(first) < 1:
            raise SettingsError(f"bands = {text!r}: give numbers from 1, such as 2,4,5 or 1-4")
        span = range(int(first), int(last or first) + 1)
        if not span or len(span) > 1000:
            raise SettingsError(f"bands = {text!r}: {part.strip()} is no range of bands")
        numbers += span
    return numbers


def _expanded(raster: PathLike, bands: Sequence[int] | None) -> list[tuple[str, int]]:
    """Return the path and number of each band that a command-line word asks for."""
    # The seam for products: a Landsat folder, MTL file or SAFE folder expands into its bands here.
    uri, own = split_bands(raster)
    if not uri:
        raise InputError("a raster has an empty name: give its path")
    wanted = own or bands
    with open_raster(uri) as dataset:
        if wanted is None:
            kinds = zip(dataset.indexes, dataset.colorinterp, strict=True)
            wanted = [number for number, kind in kinds if kind != ColorInterp.alpha] or [1]
    return [(uri, number) for number in wanted]


def _is_file(path: str) -> bool:
    return path.startswith("/vsi") or Path(path).exists()


def _described(uri: str, number: int, mask: PathLike | None) -> Band:
    info = describe(uri, band=number, mask=mask)
    with open_raster(uri) as dataset:
        description = dataset.descriptions[number - 1]
    px_m = middle_pixel_size_m(info.grid)
    known = native_px_m(Path(uri).stem, description)
    return Band("", info, description, px_m, (known, known) if known else px_m, known is not None)


def _same(a: Band, b: Band) -> bool:
    if a.info.band != b.info.band:
        return False
    return a.info.uri == b.info.uri or Path(a.info.uri).absolute() == Path(b.info.uri).absolute()


def _names(bands: Sequence[Band]) -> list[str]:
    """Return a short, unique name for each: a word for its file where there are several, and one for it."""
    files = _short_stems([Path(band.info.uri).stem for band in bands])
    several = len({band.info.uri for band in bands}) > 1
    names = []
    for band, file in zip(bands, files, strict=True):
        own = _own_name(band)
        alone = band.info.band_count == 1
        names.append(file if several and alone else f"{file} {own}" if several else own)
    for form in ("{stem} {band}", "{uri} {band}"):
        if len(set(names)) == len(names):
            break
        names = [
            form.format(stem=Path(band.info.uri).stem, uri=band.info.uri, band=band.info.band)
            for band in bands
        ]
    return names


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
