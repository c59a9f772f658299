"""Cross-validation by spatial blocks: the error at points that a fit did not see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.correction.fitted import Fit
from pcwlad_geo.estimation.shared_errors import Overlaps, random_signs
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class CrossValidationParameters:
    """How points are divided, and how the errors that they share are estimated."""

    folds: int = 16
    """Largest number of folds, a power of two."""
    max_blocks: int = 1024
    """Largest number of blocks."""
    probes: int = 8
    """Number of random sign vectors that estimate the errors shared with a fold."""


CROSS_VALIDATION: Final = CrossValidationParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidationBlocks:
    """A division of points for cross-validation."""

    block: Index
    """(n,) index of the compact block in which each point lies."""
    tests: tuple[Bool, ...]
    """(n,) masks, one per fold, of the points that are predicted from all others. Every point is in one."""


def cross_validation_blocks(
    xy_px: Float64, footprint_px: float, parameters: CrossValidationParameters = CROSS_VALIDATION
) -> CrossValidationBlocks:
    """Divide points into compact blocks of equal numbers, and the blocks into at most 16 folds.

    The blocks are one matching window of side `footprint_px` wide (0: independent errors), so that those of a
    fold, which lie far apart, are predicted over a distance typical of the use of a correction; there are at
    least 16 of them, if there are enough points. The points are at (n, 2) `xy_px` (col, row), px; n ≥ 3.
    """
    area = float(np.prod(np.ptp(xy_px, axis=0)))
    folds, most = parameters.folds, parameters.max_blocks
    room = min(area / footprint_px**2, most) if footprint_px > 0 else most
    block = spatial_blocks(xy_px, int(min(max(folds, room), len(xy_px) // 3)))
    # The last four halvings number 16 neighbours: equal remainders are 16 blocks apart.
    group = block % folds
    return CrossValidationBlocks(block, tuple(group == number for number in np.unique(group)))


def spatial_blocks(xy_px: Float64, count: int) -> Index:
    """Divide the (n, 2) points `xy_px` (col, row) into compact blocks of equal numbers; return (n,) indices.

    The points are halved at the median along the longer side of their bounding box, and the halves again,
    until there are `count` blocks (or the next lower power of two).
    """
    block = np.zeros(len(xy_px), dtype=np.intp)
    number = 1
    while 2 * number <= count:
        halves = np.zeros(len(xy_px), dtype=np.intp)
        for index in range(number):
            members = np.flatnonzero(block == index)
            axis = int(np.argmax(np.ptp(xy_px[members], axis=0)))
            order = np.argsort(xy_px[members, axis], kind="stable")
            halves[members[order[len(members) // 2 :]]] = 1
        block = 2 * block + halves
        number *= 2
    return block


@dataclass(frozen=True, slots=True, eq=False)
class SharedNoise:
    """Errors that points in a fold share, through overlapping windows, with points outside it."""

    probes: Float64
    """(n, 2, m) random signs."""
    shared: tuple[Float64, ...]
    """For every fold (n, 2, m), the covariance of all points with the fold's, times the probes, px²."""

    @classmethod
    def of(
        cls,
        fit: Fit,
        xy_px: Float64,
        footprint_px: float,
        blocks: CrossValidationBlocks,
        parameters: CrossValidationParameters = CROSS_VALIDATION,
    ) -> SharedNoise:
        """Return the shared noise that a fit, the most flexible one, finds in points.

        The points are at (n, 2) `xy_px` (col, row), px, and the matching window is `footprint_px` wide, 0 for
        independent errors. The fit's residuals and its sharing of errors count.
        """
        probes = random_signs(xy_px, 2 * parameters.probes).reshape(len(xy_px), 2, parameters.probes)
        if footprint_px <= 0:
            return cls(probes, tuple(np.zeros_like(probes) for _ in blocks.tests))
        precision = (fit.whitener**2).sum(axis=(1, 2)) / 2
        sigma = (
            np.sqrt(fit.errors.scale * fit.errors.alpha / precision)[:, None, None]
            * fit.inlier[:, None, None]
        )
        parts = np.stack([probes * sigma * test[:, None, None] for test in blocks.tests], axis=1)
        shared = sigma[:, None] * Overlaps.of(xy_px, footprint_px).times(parts)
        return cls(probes, tuple(shared[:, group] for group in range(len(blocks.tests))))


def left_out_errors(fit: Fit, blocks: CrossValidationBlocks, noise: SharedNoise) -> Float64:
    """Return the (n,) squared errors of points predicted without their fold, px².

    A point and its prediction from points whose windows overlap its own have errors in common, which make the
    prediction look better than it is: their optimism, twice their expected covariance by `noise`, is added
    (doi:10.1080/01621459.1986.10478291). Raises `InputError` if the points outside some fold do not
    determine the model.
    """
    squared, probes = np.empty(len(noise.probes)), noise.probes.shape[2]
    values = [np.concatenate([fit.remainder_px[:, :, None], shared], axis=2) for shared in noise.shared]
    for test, predicted in zip(blocks.tests, fit.left_out(blocks.tests, values), strict=True):
        missed = fit.remainder_px[test] - predicted[:, :, 0]
        optimism = (noise.probes[test] * predicted[:, :, 1:]).sum(axis=(1, 2)) / probes
        squared[test] = (missed**2).sum(axis=1) + 2 * optimism
    return squared
