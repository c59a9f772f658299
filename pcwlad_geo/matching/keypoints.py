"""FAST corners on the phase-congruency map of the reference, spread by cell or the strongest.

References
----------
.. [1] Rosten, E. and Drummond, T. (2006), doi:10.1007/11744023_34.
"""

from __future__ import annotations

import math
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.phase_congruency import EPSILON_OF_BYTE_RANGE

FULL_SCALE: Final = 0.5
"""The map value that becomes 255: fixed, so that every tile of a scene finds the same corners."""
THRESHOLD: Final = 2
"""FAST threshold on the 8-bit map: low, since cells and ranking choose among the corners."""
LEAST_CONTRAST: Final = 0.02
"""Share of the scene's range below which local contrast counts as noise."""
DETAIL_PX: Final = 3.0
NEIGHBOURHOOD_PX: Final = 8.0
LARGEST: Final = 1e6
"""Deviations from the mean, in units of the least contrast, end here: their squares stay finite."""
NOISE_MARGIN: Final = 1.2
"""Noise energy is taken off with a margin for its own scatter."""

Index = NDArray[np.intp]


def contrast_weight(
    image: NDArray[np.floating[Any]], epsilon: float, noise_sigma: float = 0.0
) -> NDArray[np.float32]:
    """Weigh places by their contrast: near 0 where it is below a fiftieth of the scene's range, else near 1.

    Phase congruency without noise filter finds corners in noise and quantisation as readily as in
    structure; corners of real structure are to be preferred.

    Parameters
    ----------
    image : (rows, cols) array
    epsilon : float
        The scene's ε, which stands for its range.
    noise_sigma : float
        Standard deviation of the image's noise, which is no contrast.

    Returns
    -------
    (rows, cols) float32 array
    """
    floor = max(LEAST_CONTRAST * 255.0 / EPSILON_OF_BYTE_RANGE * epsilon, 1e-30)
    scaled = np.clip((image - image.mean(dtype=np.float64)) / floor, -LARGEST, LARGEST).astype(np.float32)
    detail = scaled - cv2.GaussianBlur(scaled, (0, 0), DETAIL_PX)
    energy = cv2.GaussianBlur(np.square(detail), (0, 0), NEIGHBOURHOOD_PX)
    energy = np.maximum(energy - np.float32(NOISE_MARGIN * (noise_sigma / floor) ** 2), 0)
    weight: NDArray[np.float32] = energy / (energy + np.float32(1.0))
    return weight


def detect_corners(
    moment: NDArray[np.float32], usable: NDArray[np.bool_], weight: NDArray[np.float32]
) -> tuple[Index, NDArray[np.float32]]:
    """Find FAST corners (type 9-16, non-maximum suppression).

    Parameters
    ----------
    moment : (rows, cols) float32 array
        Maximum moment of the phase congruency.
    usable : (rows, cols) bool array
        Where a corner may lie.
    weight : (rows, cols) float32 array
        Multiplies the response.

    Returns
    -------
    corners_rc : (n, 2) intp array
        Row, column of each corner.
    response : (n,) float32 array
    """
    scaled = np.clip(moment * np.float32(255 / FULL_SCALE), 0, 255).astype(np.uint8)
    detector = cv2.FastFeatureDetector.create(THRESHOLD, True, cv2.FAST_FEATURE_DETECTOR_TYPE_9_16)
    found = detector.detect(scaled)
    places = np.array(cv2.KeyPoint.convert(found), np.float32).reshape(-1, 2)
    corners_rc = np.ascontiguousarray(places[:, ::-1].astype(np.intp))
    kept = np.flatnonzero(usable[corners_rc[:, 0], corners_rc[:, 1]])
    corners_rc = corners_rc[kept]
    response = np.fromiter((found[index].response for index in kept.tolist()), np.float32, len(kept))
    return corners_rc, response * weight[corners_rc[:, 0], corners_rc[:, 1]]


def strongest(corners_rc: Index, response: NDArray[np.float32], count: int) -> Index:
    """Return the `count` corners of highest response, as the paper takes them."""
    order = np.lexsort((corners_rc[:, 1], corners_rc[:, 0], -response))
    return corners_rc[order[:count]]


def cell_side_px(features: int, per_cell: int, area_px2: float) -> int:
    """Return the side of the cells of which so many candidates over an area need so many each."""
    return max(8, round(math.sqrt(per_cell * area_px2 / features)))


def by_cell(
    corners_rc: Index,
    response: NDArray[np.float32],
    cell_px: int,
    origin_rc: tuple[int, int],
    per_cell: int,
) -> Index:
    """Return the strongest corners of every cell of a lattice fixed to the scene.

    Parameters
    ----------
    corners_rc, response
        As `detect_corners` returns them, in coordinates of the window.
    cell_px : int
        Side of a cell.
    origin_rc : (int, int)
        Row, column of the window's first pixel in the scene: the cells do not depend on the tile.
    per_cell : int
        Corners of a cell, at most.
    """
    order, rank = rank_in_cell(corners_rc, response, cell_px, origin_rc)
    return corners_rc[order[rank < per_cell]]


def rank_in_cell(
    corners_rc: Index, response: NDArray[np.floating[Any]], cell_px: int, origin_rc: tuple[int, int]
) -> tuple[Index, Index]:
    """Return the order of corners by cell, the strongest of each first, and so ordered the rank in its cell.

    Parameters
    ----------
    corners_rc, response, cell_px, origin_rc
        As for `by_cell`.
    """
    cells = (corners_rc + np.asarray(origin_rc)) // cell_px
    order = np.lexsort((corners_rc[:, 1], corners_rc[:, 0], -response, cells[:, 1], cells[:, 0]))
    ordered = cells[order]
    new_cell = np.r_[True, (np.diff(ordered, axis=0) != 0).any(axis=1)] if len(order) else np.empty(0, bool)
    starts = np.flatnonzero(new_cell)
    return order, np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
