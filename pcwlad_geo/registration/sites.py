"""Small windows where a scene has structure: at most one place of a lattice each, the best first.

Phase congruency costs the same for a lake as for a town. A look at an overview tells which windows
show structure in both bands, and are neither masked nor beyond the edge.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.fill import fill_smoothly
from pcwlad_geo.matching.keypoints import contrast_weight
from pcwlad_geo.matching.prepare import fast_even
from pcwlad_geo.raster.view import Patch
from pcwlad_geo.raster.windows import Window
from pcwlad_geo.registration.prealign import Look
from pcwlad_geo.registration.tiles import TileJob

Float64 = NDArray[np.float64]

LEAST_WINDOWS: Final = 64
CANDIDATES_PER_WINDOW: Final = 20
CELLS_ACROSS: Final = 2
"""Cells of candidates across a small window."""
LEAST_CORE_PX: Final = 80
WINDOWS_PER_SITE: Final = 4
"""The first choice and those that may follow it."""
LEAST_VALID: Final = 0.75
"""Share of a window, with what the matching needs around it, that both bands must show."""
LEAST_TEXTURE: Final = 0.05
"""Share of a window with more than faint contrast in both bands."""
CENTRE_PREFERENCE: Final = 0.3
"""Of its score, what a window in the corner of its place loses: the points are to be spread."""


def lattice_shape(region: Window, candidates: int) -> tuple[int, int]:
    """Return into how many rows and columns of places a region is divided."""
    count = max(LEAST_WINDOWS, round(candidates / CANDIDATES_PER_WINDOW))
    rows = max(1, round(np.sqrt(count * region.rows / region.cols)))
    return rows, int(np.ceil(count / rows))


def lattice_places(region: Window, candidates: int) -> list[Window]:
    """Return the places into which a region is divided, row by row."""
    shape = lattice_shape(region, candidates)
    return [_place(region, shape, row, col) for row in range(shape[0]) for col in range(shape[1])]


def small_window(base: TileJob, candidates: int, wanted: int) -> TileJob:
    """Return a small window in the corner of the region: its core is made of whole cells of candidates.

    Parameters
    ----------
    base : TileJob
    candidates : int
        In all windows together.
    wanted : int
        Tie points of all windows: candidates beyond that stand in for those that fail.
    """
    rows, cols = lattice_shape(base.region, candidates)
    around = replace(base, core=Window(0, 0, 0, 0)).read_window.rows
    cell = (fast_even(around + LEAST_CORE_PX) - around) // CELLS_ACROSS
    cells = rows * cols * CELLS_ACROSS**2
    per_cell = int(np.ceil(candidates / cells))
    settings = replace(
        base.settings,
        features=per_cell * CELLS_ACROSS**2,
        per_cell=per_cell,
        spare=max(0, per_cell - int(np.ceil(wanted / cells))),
        features_area_px2=float((CELLS_ACROSS * cell) ** 2),
    )
    core = Window(base.region.row, base.region.col, CELLS_ACROSS * cell, CELLS_ACROSS * cell)
    return replace(base, settings=settings, core=core)


def find_sites(window: TileJob, look: Look, candidates: int) -> tuple[tuple[TileJob, ...], ...]:
    """Return, for every place of the lattice, the windows that show structure, best first.

    Parameters
    ----------
    window : TileJob
        A small window of the region, see `small_window`.
    look : Look
        Both bands at a glance.
    candidates : int
        Corners to be matched in all first windows together.
    """
    region = window.region
    texture, valid = _merged(window, look)
    step = window.core.rows // CELLS_ACROSS
    sites: list[tuple[TileJob, ...]] = []
    count = 0
    for place in lattice_places(region, candidates):
        chosen = _best_windows(place, window, step, texture, valid, look.factor)
        sites.append(tuple(replace(window, id=count + k, core=core) for k, core in enumerate(chosen)))
        count += len(chosen)
    return tuple(sites)


def _place(region: Window, shape: tuple[int, int], row: int, col: int) -> Window:
    edges = [
        np.linspace(0, length, count + 1).round().astype(int)
        for length, count in zip(region.shape, shape, strict=True)
    ]
    return Window.from_bounds(
        region.row + int(edges[0][row]),
        region.col + int(edges[1][col]),
        region.row + int(edges[0][row + 1]),
        region.col + int(edges[1][col + 1]),
    )


def _best_windows(
    place: Window, window: TileJob, step: int, texture: Float64, valid: Float64, factor: float
) -> list[Window]:
    """Return the windows of a place in the order of their score; they do not share pixels."""
    side, region = window.core.rows, window.region
    reach = (window.window.rows - side) // 2
    # cores begin where cells of the scene's lattice do: then no cell reaches beyond its core
    rows = _starts(place.row - region.row, place.rows, side, step) + region.row
    cols = _starts(place.col - region.col, place.cols, side, step) + region.col
    corners = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
    middle = corners + side / 2
    off_centre = np.abs((middle - [place.row, place.col]) / place.shape - 0.5).max(axis=1) * 2
    seen = _mean_in(valid, corners - reach, side + 2 * reach, factor)
    score = _mean_in(texture, corners, side, factor)
    good = (seen >= LEAST_VALID) & (score >= LEAST_TEXTURE)
    score = score * seen * (1 - CENTRE_PREFERENCE * off_centre)
    chosen: list[int] = []
    for index in np.argsort(-np.where(good, score, -np.inf), kind="stable"):
        apart = all(np.abs(corners[index] - corners[other]).max() >= side for other in chosen)
        if good[index] and apart:
            chosen.append(int(index))
        if len(chosen) == WINDOWS_PER_SITE:
            break
    return [Window(int(corners[k, 0]), int(corners[k, 1]), side, side) for k in chosen]


def _starts(begin: int, length: int, side: int, step: int) -> NDArray[np.intp]:
    """Return the multiples of the step at which cores lie within a range; where it is narrow, begin in it."""
    first, last = -(-begin // step), (begin + max(length - side, step - 1)) // step
    return np.arange(first, max(first, last) + 1) * step


def _merged(window: TileJob, look: Look) -> tuple[Float64, Float64]:
    """Return integral images of the texture and the validity that both bands have, in reference-look px."""
    scenes = (window.reference_scene, window.target_scene)
    textures, valids = [], []
    for patch, scene in zip((look.reference, look.target), scenes, strict=True):
        textures.append(texture_of(patch, scene.epsilon))
        valids.append(patch.valid.astype(np.float32))
    shape = textures[0].shape
    offset = np.round(np.asarray(window.target_offset_px) / look.factor).astype(int)
    textures[1], valids[1] = (_moved(plane, offset, shape) for plane in (textures[1], valids[1]))
    merged = np.minimum(*textures), np.minimum(*valids)
    texture, valid = (np.asarray(cv2.integral(plane, sdepth=cv2.CV_64F), np.float64) for plane in merged)
    return texture, valid


def texture_of(patch: Patch, epsilon: float) -> NDArray[np.float32]:
    """Return where a band has more than faint contrast: near 1 there, else near 0; 0 where not valid."""
    filled = fill_smoothly(np.where(patch.valid, patch.values, 0), patch.valid)
    return contrast_weight(filled, epsilon) * patch.valid


def _moved(
    plane: NDArray[np.float32], offset_xy: NDArray[np.intp], shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """Return result[r, c] = plane[r + offset, c + offset], 0 outside."""
    result = np.zeros(shape, np.float32)
    col, row = offset_xy.tolist()
    rows = slice(max(0, -row), max(0, min(shape[0], plane.shape[0] - row)))
    cols = slice(max(0, -col), max(0, min(shape[1], plane.shape[1] - col)))
    if rows.stop > rows.start and cols.stop > cols.start:
        result[rows, cols] = plane[rows.start + row : rows.stop + row, cols.start + col : cols.stop + col]
    return result


def _mean_in(integral: Float64, corners_rc: NDArray[np.intp], side: int, factor: float) -> Float64:
    """Return the mean of a plane over squares given in view px; what lies outside counts as 0."""
    limits = np.array(integral.shape) - 1
    begin, end = corners_rc / factor, (corners_rc + side) / factor
    first = np.clip(np.round(begin), 0, limits).astype(np.intp)
    last = np.clip(np.maximum(np.round(end), np.round(begin) + 1), 0, limits).astype(np.intp)
    total = (
        integral[last[:, 0], last[:, 1]]
        - integral[first[:, 0], last[:, 1]]
        - integral[last[:, 0], first[:, 1]]
        + integral[first[:, 0], first[:, 1]]
    )
    area = np.maximum(np.round(end) - np.round(begin), 1).prod(axis=1)
    return np.asarray(total / area)
