"""Candidates: FAST corners on the phase congruency of the reference, and the outcome of matching each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.maps import EPSILON_OF_BYTE_RANGE
from pcwlad_geo.types import Bool, Float32, Float64, Index

OUTCOMES: Final = (
    "matched",
    "not_comparable",
    "not_similar",
    "at_search_border",
    "not_converged",
    "directions_disagree",
)
"""Outcomes of a candidate: a match, or the stage that rejected it, in the order of the stages."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Corners of the reference that were searched for in the target."""

    reference_xy_px: Float64
    """(n, 2) positions in the reference image (col, row), corner-based."""
    outcome: NDArray[np.uint8]
    """(n,) index into `OUTCOMES`."""

    def __len__(self) -> int:
        return len(self.outcome)

    @property
    def lost(self) -> Candidates:
        """The candidates without a match."""
        some = self.outcome > 0
        return Candidates(self.reference_xy_px[some], self.outcome[some])

    @property
    def counts(self) -> dict[str, int]:
        """The number of candidates, and how many each stage rejected."""
        number = np.bincount(self.outcome, minlength=len(OUTCOMES)).tolist()
        return {"candidates": len(self), **dict(zip(OUTCOMES[1:], number[1:], strict=True))}

    def part(self, index: Bool | Index) -> Candidates:
        """Return the m candidates of the (n,) mask, or at the (m,) `index`."""
        return Candidates(self.reference_xy_px[index], self.outcome[index])

    def shifted(self, xy_px: Float64) -> Candidates:
        """Return the candidates with the constant `xy_px`, (2,) (col, row), added."""
        return replace(self, reference_xy_px=self.reference_xy_px + xy_px)

    @staticmethod
    def empty() -> Candidates:
        """Return zero candidates."""
        return Candidates(np.empty((0, 2)), np.empty(0, np.uint8))

    @staticmethod
    def concatenate(parts: Sequence[Candidates]) -> Candidates:
        """Return the candidates of all parts in their order."""
        every = [Candidates.empty(), *parts]
        return Candidates(
            np.concatenate([part.reference_xy_px for part in every]),
            np.concatenate([part.outcome for part in every]),
        )


FULL_SCALE: Final = 0.5
"""The map value that becomes 255; it is fixed, so that every tile of a scene finds the same corners."""
THRESHOLD: Final = 2
"""FAST threshold on the 8-bit map; it is low, since cells and ranking choose among the corners."""
MIN_CONTRAST: Final = 0.02
"""Share of the scene's range below which local contrast counts as noise."""
DETAIL_PX: Final = 3.0
"""Sigma of the Gaussian that is subtracted to leave the local detail."""
NEIGHBOURHOOD_PX: Final = 8.0
"""Sigma of the Gaussian over which the energy of the detail is averaged."""
LARGEST: Final = 1e6
"""Largest deviation from the mean, in units of the least contrast, so that its square stays finite."""
NOISE_MARGIN: Final = 1.2
"""Factor on the noise energy before it is subtracted, a margin for its own scatter."""


def contrast_weight(
    image: NDArray[np.floating[Any]], epsilon: float, noise_sigma: float = 0.0, least: float = 0.0
) -> Float32:
    """Weight pixels by local contrast: near 0 where it is below a fiftieth of the scene's range, else near 1.

    Phase congruency without noise filter finds corners in noise and quantisation as readily as in
    structure; corners of real structure are to be preferred. The (rows, cols) `image` is finite; `epsilon` is
    the scene's ε, which stands for its range (see `maps.scene_epsilon`). Noise of standard deviation
    `noise_sigma` does not count as contrast. The weight is -1, as no corner may lie there, where the RMS of
    the detail is at most `least`, in units of the image: it may be nothing but rounding. The result is a
    (rows, cols) float32 array.
    """
    floor = max(MIN_CONTRAST * 255.0 / EPSILON_OF_BYTE_RANGE * epsilon, 1e-30)
    scaled = np.clip((image - image.mean(dtype=np.float64)) / floor, -LARGEST, LARGEST).astype(np.float32)
    detail = scaled - cv2.GaussianBlur(scaled, (0, 0), DETAIL_PX)
    energy = cv2.GaussianBlur(np.square(detail), (0, 0), NEIGHBOURHOOD_PX)
    rounding = energy <= np.float32((least / floor) ** 2) if least > 0 else None
    energy = np.maximum(energy - np.float32(NOISE_MARGIN * (noise_sigma / floor) ** 2), 0)
    weight: Float32 = energy / (energy + np.float32(1.0))
    if rounding is not None:
        weight[rounding] = -1
    return weight


def detect_corners(moment: Float32, usable: Bool, weight: Float32) -> tuple[Index, Float32]:
    """Find FAST corners (type 9-16, non-maximum suppression).

    The (rows, cols) float32 `moment` is that of the phase congruency, and `weight`, of its shape (rows,
    cols), multiplies the response; corners lie where the (rows, cols) bool array `usable` is true. Return the
    (n, 2) intp row and column of each corner, and its (n,) float32 FAST response times the weight.
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


def strongest(corners_rc: Index, response: Float32, count: int) -> Index:
    """Return at most `count` (m, 2) corners of highest response, as the paper takes them.

    They are chosen of the (n, 2) `corners_rc` (row, column) by their (n,) `response`, see `detect_corners`.
    """
    order = np.lexsort((corners_rc[:, 1], corners_rc[:, 0], -response))
    return corners_rc[order[:count]]


def cell_side_px(features: int, per_cell: int, area_px2: float) -> int:
    """Return the side, px, of cells with `per_cell` each of `features` candidates over `area_px2`."""
    return max(8, round(math.sqrt(per_cell * area_px2 / features)))


def by_cell(
    corners_rc: Index, response: Float32, cell_px: int, origin_rc: tuple[int, int], per_cell: int
) -> Index:
    """Return the (m, 2) strongest corners of every cell of a lattice fixed to the scene.

    The parameters are those of `rank_in_cell`, the (n, 2) `corners_rc` and their (n,) `response` among them;
    a cell gives at most `per_cell` corners.
    """
    order, rank = rank_in_cell(corners_rc, response, cell_px, origin_rc)
    return corners_rc[order[rank < per_cell]]


def rank_in_cell(
    corners_rc: Index, response: NDArray[np.floating[Any]], cell_px: int, origin_rc: tuple[int, int]
) -> tuple[Index, Index]:
    """Sort corners by cell, the strongest of each cell first.

    The (n, 2) intp `corners_rc` are row, column in a window whose first pixel is `origin_rc` of the scene, so
    that the cells, `cell_px` wide, do not depend on the tile; the (n,) `response` ranks them. Return (n,)
    intp indices that sort the corners, and the (n,) intp rank of each corner so sorted in its cell, from 0.
    """
    cells = (corners_rc + np.asarray(origin_rc)) // cell_px
    order = np.lexsort((corners_rc[:, 1], corners_rc[:, 0], -response, cells[:, 1], cells[:, 0]))
    ordered = cells[order]
    new_cell = np.r_[True, (np.diff(ordered, axis=0) != 0).any(axis=1)] if len(order) else np.empty(0, bool)
    starts = np.flatnonzero(new_cell)
    return order, np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
