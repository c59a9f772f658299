"""Pixels that count as nodata though the file does not say so: collars, impossible values and fill."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, MaskFlags

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.plausible import is_plausible, plausible_limits
from pcwlad_geo.in_memory import equals_nodata
from pcwlad_geo.raster.band_pixels import BandPixels
from pcwlad_geo.raster.collars import find_collar
from pcwlad_geo.raster.fill import fill_note, find_fills
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.pixels import read_nearest
from pcwlad_geo.raster.scanned_frames import find_frame
from pcwlad_geo.raster.source import RasterInfo, has_quick_overview, is_huge


@dataclass(frozen=True, slots=True)
class UndeclaredParameters:
    """Which undeclared pixels are looked for, and which of them are worth a warning."""

    noted_border: float = 0.01
    """Least share of a raster that its constant border takes for a warning."""
    min_bytes: int = 4
    """Numbers of fewer bytes cannot be so far from the others that nothing measures them."""


UNDECLARED: Final = UndeclaredParameters()
"""Those in use."""


def without_undeclared(
    info: RasterInfo, pixels: BandPixels | None = None
) -> tuple[RasterInfo, tuple[str, ...]]:
    """Return a band with its collar, its impossible values and its fill as nodata, and notes of them.

    Fill is a value that more than a percent of the band has exactly, at an end of its range and far from all
    other values. What the file declares as nodata or masks counts as neither, and beside a mask file nothing
    is looked for. A huge band is returned as it is, and one that cannot be read here: whoever reads it next
    reports that. The `pixels` are those of this band, where others use them too.
    """
    if is_huge(info.grid):
        return info, ()
    pixels = pixels or BandPixels(info)
    info, collar = without_collar(info, pixels)
    info, extremes = without_extremes(info, pixels)
    notes = (*collar, *extremes)
    if info.mask_uri is None and info.brightness is None:
        with suppress(InputError):
            fills = find_fills(pixels.sample, info)
            notes += tuple(fill_note(info, fill, "far from all others") for fill in fills)
            info = replace(info, fills=fills)
    return info, notes


def without_collar(info: RasterInfo, pixels: BandPixels | None = None) -> tuple[RasterInfo, tuple[str, ...]]:
    """Return a band with its collar as nodata, and a note that says so if it has one.

    A collar is a constant border that nothing marks (see `collars.find_collar`). A band with a nodata value,
    an alpha band or a mask of any kind has said which of its pixels count, and is returned as it is, as is
    one that cannot be read here: whoever reads it next reports that. Of any other band four corners are read,
    and more of it only if one of them is constant. The `pixels` are those of the band.
    """
    if info.nodata is not None or info.mask_uri is not None:
        return info, ()
    pixels = pixels or BandPixels(info)
    collar, is_frame = None, False
    with suppress(InputError), open_raster(info.uri) as dataset:

        def read(window: Window, shape: tuple[int, int]) -> NDArray[np.generic]:
            if window.shape == dataset.shape and shape == pixels.overview_shape:
                return pixels.overview.values
            return read_nearest(dataset, info.band, window, shape)

        is_marked = dataset.mask_flag_enums[info.band - 1] != [MaskFlags.all_valid]
        if not is_marked and ColorInterp.alpha not in dataset.colorinterp:
            collar = find_collar(read, dataset.shape)
            is_frame = collar is None and (collar := find_frame(read, dataset.shape)) is not None
    if collar is None:
        return info, ()
    what = "a border of a scanned frame (tone about" if is_frame else "a constant border (value"
    note = (
        f"{what} {collar.value:g}) of {100 * collar.share:.2g} % of {info.uri} is taken "
        "for nodata; if it is data, declare another nodata value, or give a mask"
    )
    return replace(info, collar=collar), (note,) if collar.share >= UNDECLARED.noted_border else ()


def without_extremes(
    info: RasterInfo, pixels: BandPixels | None = None
) -> tuple[RasterInfo, tuple[str, ...]]:
    """Return a band whose impossible values are nodata, and a note that says so if an overview shows some.

    A band that cannot be read here is returned as it is: whoever reads it next reports that. The `pixels`
    are those of the band.
    """
    if np.dtype(info.dtype).itemsize < UNDECLARED.min_bytes:
        return info, ()
    with suppress(InputError):
        if has_quick_overview(info):
            overview = (pixels or BandPixels(info)).overview
            values = overview.values[overview.valid & ~equals_nodata(overview.values, info.nodata)]
            limits = plausible_limits(values)
            wrong = values[~is_plausible(values, limits)]
            notes = (
                ()
                if not len(wrong)
                else (
                    f"values that nothing measures, such as {float(wrong[0]):g}, are taken for nodata "
                    f"({100 * len(wrong) / len(values):.2g} % of {info.uri}); declare them so (gdal_edit.py "
                    "-a_nodata), or give a mask",
                )
            )
            return replace(info, limits=limits), notes
    return info, ()
