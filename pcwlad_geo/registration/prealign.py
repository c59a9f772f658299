"""Rough alignment: by the georeferencing, or by a pyramid search where that is absent or too coarse."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.global_search import SearchResult, search_shift
from pcwlad_geo.matching.noise import Noise, measure_noise
from pcwlad_geo.matching.phase_congruency import scene_epsilon
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.view import Patch, View
from pcwlad_geo.raster.windows import Window
from pcwlad_geo.registration.result import Prealignment
from pcwlad_geo.registration.tiles import Scene

LOOK_SIDE_PX: Final = 1024
"""The overview that the search and the ε are taken from has at most so many pixels a side."""
RADIUS_PX: Final = 12
"""Search radius around a georeferencing that is believed."""
RADIUS_AFTER_SEARCH_PX: Final = 8
SAMPLE_PX: Final = 256
SAMPLES_ACROSS: Final = 3
"""The noise is judged on so many by so many samples at full resolution."""
SEARCH_ERROR_PX: Final = 2.0
"""Of the overview's pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """Both bands at a glance, at one resolution."""

    reference: Patch
    target: Patch
    factor: float
    """View pixels per pixel of the look."""
    scenes: tuple[Scene, Scene]
    """Reference and target."""


def look_at(pair: ViewPair) -> Look:
    """Read an overview of both views.

    Raises
    ------
    InputError
        If one of them has no valid pixel, or is constant.
    """
    sides = max(pair.reference.grid.shape), max(pair.target.grid.shape)
    factor = max(1.0, max(sides) / LOOK_SIDE_PX)
    patches = [
        view.read_decimated(max(1, round(side / factor)))[0]
        for view, side in zip((pair.reference, pair.target), sides, strict=True)
    ]
    scenes = []
    for patch, view in zip(patches, (pair.reference, pair.target), strict=True):
        epsilon = scene_epsilon(patch.values, patch.valid)
        _check_content(patch, view.info, epsilon)
        scenes.append(Scene(epsilon, _noise(view)))
    return Look(patches[0], patches[1], factor, (scenes[0], scenes[1]))


def by_georeferencing(search_radius: int | None) -> Prealignment:
    """Believe the georeferencing (pixel coordinates where there is none)."""
    return Prealignment("georeferencing", (0.0, 0.0), search_radius or RADIUS_PX)


def by_search(
    pair: ViewPair, look: Look, search_radius: int | None
) -> tuple[Prealignment | None, SearchResult]:
    """Search the shift on the overview; None where nothing credible is found.

    Parameters
    ----------
    pair : ViewPair
    look : Look
    search_radius : int, optional
        Radius of the coarse match afterwards; chosen from the search's precision if not given.
    """
    found = search_shift(
        look.reference.values.astype(np.float64),
        look.target.values.astype(np.float64),
        look.reference.valid,
        look.target.valid,
    )
    if not found.accepted:
        return None, found
    absolute = np.asarray(found.shift_xy) * look.factor
    shift = absolute - np.asarray(pair.offset_px)
    uncertainty = SEARCH_ERROR_PX * (look.factor - 1) + found.spread_px * look.factor
    radius = search_radius or RADIUS_AFTER_SEARCH_PX + math.ceil(uncertainty)
    return Prealignment("search", (float(shift[0]), float(shift[1])), radius), found


def target_offset_px(pair: ViewPair, prealignment: Prealignment) -> tuple[int, int]:
    """Return the whole-pixel (col, row) offset from reference view to target view to start from."""
    col, row = np.round(np.asarray(pair.offset_px) + prealignment.shift_px).astype(int)
    return int(col), int(row)


def _noise(view: View) -> Noise:
    """Return the typical noise of samples spread over the view at full resolution."""
    rows, cols = view.grid.shape
    side_r, side_c = min(rows, SAMPLE_PX), min(cols, SAMPLE_PX)
    found = []
    for row in np.unique(np.linspace(0, rows - side_r, SAMPLES_ACROSS).astype(int)):
        for col in np.unique(np.linspace(0, cols - side_c, SAMPLES_ACROSS).astype(int)):
            with suppress(InputError):  # the tile that holds it tells what cannot be read
                patch = view.read(Window(int(row), int(col), side_r, side_c))
                noise = measure_noise(patch.values, patch.valid)
                found += [noise] if noise.ratio > 0 else []
    if not found:
        return Noise()
    ratio, sigma = np.median([(noise.ratio, noise.sigma) for noise in found], axis=0)
    return Noise(float(ratio), float(sigma))


def _check_content(patch: Patch, info: RasterInfo, epsilon: float) -> None:
    if not patch.valid.any():
        raise InputError(
            f"band {info.band} of {info.uri} has no valid pixel (nodata, masks) where the two overlap: "
            "check its nodata value, its mask, or choose another band"
        )
    if epsilon <= 0:
        raise InputError(
            f"band {info.band} of {info.uri} is constant where the two overlap: there is nothing to match; "
            "choose another band"
        )
