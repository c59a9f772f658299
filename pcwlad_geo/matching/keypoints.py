"""Candidates: FAST corners on the phase congruency of the reference, and the outcome of matching each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.paper import PAPER
from pcwlad_geo.types import Bool, Float32, Float64, Floating, Index


@dataclass(frozen=True, slots=True)
class CornerParameters:
    """How corners are detected, and weighted by contrast."""

    threshold: int = 2
    """FAST threshold on the 8-bit map; it is low, since cells and ranking choose among the corners."""
    least_contrast: float = 0.02
    """Share of the scene's range below which local contrast counts as noise."""
    detail_px: float = 3.0
    """Sigma of the Gaussian that is subtracted to leave the local detail."""
    neighbourhood_px: float = 8.0
    """Sigma of the Gaussian over which the energy of the detail is averaged."""
    most_deviation: float = 1e6
    """Largest deviation from the mean, in least contrasts, so that its square stays finite."""
    noise_margin: float = 1.2
    """Factor on the noise energy that is subtracted, for its own scatter."""
    full_scale: float = 0.5
    """The map value that becomes 255; it is fixed, so that every tile of a scene has the same corners."""


CORNERS: Final = CornerParameters()
"""Those in use."""
OUTCOMES: Final = (
    *("matched", "not_comparable", "not_similar", "at_search_border", "not_converged", "directions_disagree"),
)
"""Outcomes of a candidate: a match, or the stage that rejected it, in the order of the stages."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Corners of the reference that were searched for in the target."""

    reference_xy_px: Float64
    """(n, 2) positions in the reference image (col, row), corner-based."""
    outcome: NDArray[np.uint8]
    """(n,) index into `OUTCOMES`."""
    are_all: bool = True
    """False where the first of them agreed, so that no others were searched."""

    def __len__(self) -> int:
        return len(self.outcome)

    @property
    def lost(self) -> Candidates:
        """The candidates without a match."""
        return self.part(self.outcome > 0)

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
        xy, outcome = [part.reference_xy_px for part in parts], [part.outcome for part in parts]
        return Candidates(np.concatenate(xy), np.concatenate(outcome)) if parts else Candidates.empty()


def contrast_weight(image: Floating, epsilon: float, noise_sigma: float = 0.0, least: float = 0.0) -> Float32:
    """Weight pixels by local contrast: near 0 where it is below a fiftieth of the scene's range, else near 1.

    Phase congruency without noise filter has corners in noise and rounding, too. The (rows, cols) `image` is
    finite; `epsilon` stands for the scene's range (see `maps.scene_epsilon`). Noise of standard deviation
    `noise_sigma` is no contrast. Where the RMS of the detail is at most `least`, in units of the image, it
    may be rounding: no corner may lie there, and the weight is -1. The result is a (rows, cols) float32
    array.
    """
    floor = max(CORNERS.least_contrast * 255.0 / PAPER.byte_epsilon * epsilon, 1e-30)
    most = CORNERS.most_deviation
    scaled = np.clip((image - image.mean(dtype=np.float64)) / floor, -most, most).astype(np.float32)
    detail = scaled - cv2.GaussianBlur(scaled, (0, 0), CORNERS.detail_px)
    energy = cv2.GaussianBlur(np.square(detail), (0, 0), CORNERS.neighbourhood_px)
    rounding = energy <= np.float32((least / floor) ** 2) if least > 0 else None
    energy = np.maximum(energy - np.float32(CORNERS.noise_margin * (noise_sigma / floor) ** 2), 0)
    weight: Float32 = energy / (energy + np.float32(1.0))
    if rounding is not None:
        weight[rounding] = -1
    return weight


def detect_corners(moment: Float32, usable: Bool, weight: Float32) -> tuple[Index, Float32]:
    """Find FAST corners (type 9-16, non-maximum suppression).

    Corners of the (rows, cols) `moment` lie where the (rows, cols) mask `usable` is true. Return their (n, 2)
    row and column, and the (n,) FAST response times the (rows, cols) `weight`.
    """
    scaled = np.clip(moment * np.float32(255 / CORNERS.full_scale), 0, 255).astype(np.uint8)
    detector = cv2.FastFeatureDetector.create(CORNERS.threshold, True, cv2.FAST_FEATURE_DETECTOR_TYPE_9_16)
    detected = detector.detect(scaled)
    places = np.array(cv2.KeyPoint.convert(detected), np.float32).reshape(-1, 2)
    corners_rc = np.ascontiguousarray(places[:, ::-1].astype(np.intp))
    index = np.flatnonzero(usable[corners_rc[:, 0], corners_rc[:, 1]])
    corners_rc = corners_rc[index]
    response = np.fromiter((detected[k].response for k in index.tolist()), np.float32, len(index))
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
    corners_rc: Index, response: Floating, cell_px: int, origin_rc: tuple[int, int]
) -> tuple[Index, Index]:
    """Sort corners by cell, the strongest of each cell first.

    The (n, 2) `corners_rc` (row, col) are in a window whose first pixel is `origin_rc` of the scene, so that
    the cells, `cell_px` wide, do not depend on the tile; the (n,) `response` ranks them. Return the (n,)
    indices that sort the corners, and the (n,) rank of each corner so sorted in its cell, from 0.
    """
    cells = (corners_rc + np.asarray(origin_rc)) // cell_px
    order = np.lexsort((corners_rc[:, 1], corners_rc[:, 0], -response, cells[:, 1], cells[:, 0]))
    ordered = cells[order]
    new_cell = np.r_[True, (np.diff(ordered, axis=0) != 0).any(axis=1)] if len(order) else np.empty(0, bool)
    starts = np.flatnonzero(new_cell)
    return order, np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
