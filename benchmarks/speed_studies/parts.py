"""What the parts cost in CPU time, inside this process: filter bank and refinement.

Compared figures are measured in turn in one run; each is the smallest of several, as anything else that the
machine does only adds to it.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
import scipy.fft
from affine import Affine
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from rasterio.windows import Window

from benchmarks.speed_studies.scene_files import ScenePair
from benchmarks.timing import Cost, cheapest
from pcwlad_geo.matching import Image, MatchSettings, keypoints
from pcwlad_geo.matching.coarse import match_coarsely
from pcwlad_geo.matching.first_pass import margin_px
from pcwlad_geo.matching.kernels.library import fast_even
from pcwlad_geo.matching.kernels.phase_congruency import ORIENTATIONS, SCALES
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.prepare import PreparedPair, prepare
from pcwlad_geo.matching.refinement import InitialEstimate, refine
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import describe, plan_views
from pcwlad_geo.registration.planning import plan
from pcwlad_geo.registration.starts.overviews import read_overviews

ALL_POINTS: Final = MatchSettings(window=MatchingWindow(81), search_radius=12)
"""What `--points all --window 81` comes to on a georeferenced scene."""


def bare_scene_bank(pair: ScenePair) -> Cost:
    """Return what the inverse FFTs of all windows of a scene cost, both images, complex64, one worker."""
    views = plan_views(describe(pair.reference), describe(pair.target))
    tiles = plan(views, read_overviews(views), (0, 0), ALL_POINTS, Settings(points="all")).first
    sizes = Counter(tuple(map(fast_even, tile.read_window.shape)) for tile in tiles)
    costs = cheapest([partial(inverse_transforms, size) for size in sizes], 2)
    counts = [2 * count for count in sizes.values()]
    return Cost(
        sum(cost.cpu_s * count for cost, count in zip(costs, counts, strict=True)),
        sum(cost.wall_s * count for cost, count in zip(costs, counts, strict=True)),
    )


def inverse_transforms(shape: tuple[int, int]) -> None:
    """Do the inverse FFTs of a filter bank: complex64, one worker, in place."""
    spectrum = np.ones(shape, np.complex64)
    for _ in range(SCALES * ORIENTATIONS):
        scipy.fft.ifft2(spectrum, norm="ortho", workers=1, overwrite_x=True)


def refinement_ms(pair: ScenePair, windows: Sequence[int], points: int, repeats: int) -> list[float]:
    """Return the CPU time a point, ms, of one direction, shift model, one pass, for each window side."""
    images = [_read(path, 1024) for path in (pair.reference, pair.target)]
    everywhere = np.ones(images[0].shape, bool)
    reference, target = (Image(image, everywhere, scene_epsilon(image)) for image in images)
    prepared = prepare(reference, target, channels="orientations")
    corners = _corners(prepared, points)
    settings = MatchSettings()
    coarse = match_coarsely(
        prepared.reference_map,
        prepared.target_map,
        corners,
        settings.template,
        settings.search_radius,
        settings.least_valid,
    )
    start = InitialEstimate(coarse.shift_xy_px, np.zeros((len(corners), 2, 2)))
    works = [
        partial(
            refine, prepared.channels.reference, prepared.channels.target, corners, start, window_px=window
        )
        for window in windows
    ]
    return [cost.cpu_s * 1000 / len(corners) for cost in cheapest(works, repeats)]


def _corners(pair: PreparedPair, count: int) -> NDArray[np.intp]:
    """Return about so many corners, spread by cell, far enough from the edges for all windows."""
    margin = margin_px(MatchSettings(window=MatchingWindow(129)))
    usable = np.zeros(pair.reference_map.values.shape, bool)
    usable[margin:-margin, margin:-margin] = True
    corners, response = keypoints.detect_corners(pair.reference_map.values, usable, pair.contrast)
    per_cell = MatchSettings().per_cell
    cell_px = keypoints.cell_side_px(count, per_cell, float(usable.sum()))
    return keypoints.by_cell(corners, response, cell_px, (0, 0), per_cell)


def _read(path: Path, side_px: int) -> NDArray[np.float32]:
    with rasterio.open(path) as file:
        image: NDArray[np.float32] = file.read(1, window=Window(0, 0, side_px, side_px)).astype(np.float32)
    return image


def crop(path: Path, out: Path, window: Window, *, placed: bool = True) -> Path:
    """Write a part of a raster, with its georeferencing unless it is not `placed`, and return its path."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with rasterio.open(path) as file:
        profile = file.profile | {"width": window.width, "height": window.height}
        profile |= {"blockxsize": window.width, "blockysize": window.height}
        place = file.transform
        west, north = place.c + window.col_off * place.a, place.f + window.row_off * place.e
        there = {"transform": Affine(place.a, 0.0, west, 0.0, place.e, north)}
        profile |= there if placed else {"crs": None, "transform": None}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # as it is meant to be
            with rasterio.open(out, "w", **profile) as part:
                part.write(file.read(1, window=window), 1)
    return out
