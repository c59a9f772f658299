"""Selection of tie points: outliers, thinning, check points, and cross-validation blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcwlad_geo.correction.fitted import Fit
from pcwlad_geo.estimation.robust import axis_sigma, irls, sigma_of, weighted
from pcwlad_geo.estimation.shared_errors import Overlaps, random_signs
from pcwlad_geo.estimation.solving import check_observations, solve
from pcwlad_geo.types import Bool, Float64, Index

SURFACE_NEIGHBOURS = 40
"""Number of neighbours that a local surface is fitted to."""


def local_surface(xy_px: Float64, values_px: Float64) -> Float64:
    """Return the (n, 2) values, px, of robust quadratic surfaces through the nearest neighbours of points.

    The points are at (n, 2) `xy_px` (col, row), px, and have (n, 2) `values_px`, such as displacements. Of
    fewer than 40 points the surface is a plane.
    """
    n = len(xy_px)
    _, near = cKDTree(xy_px).query(xy_px, k=np.arange(1, min(SURFACE_NEIGHBOURS, n) + 1))
    offset = xy_px[near] - xy_px[:, None]
    offset /= np.maximum(np.abs(offset).max(axis=(1, 2)), 1e-9)[:, None, None]
    x, y = np.moveaxis(offset, 2, 0)
    terms = [np.ones_like(x), x, y]
    design = np.stack(terms if n < SURFACE_NEIGHBOURS else [*terms, x * x, x * y, y * y], axis=2)
    around = values_px[near]
    scatter = around - np.median(around, axis=1, keepdims=True)
    value = np.empty_like(values_px)
    for _ in range(8):
        size = np.hypot(scatter[..., 0], scatter[..., 1])
        scale = np.maximum(np.median(size, axis=1, keepdims=True), 1e-6)  # 0 where the fit is exact
        weighted = design / (1 + (size / (2 * scale)) ** 2)[..., None]
        turned = weighted.transpose(0, 2, 1)
        normal = turned @ design
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(design.shape[2])
        found = solve(normal, turned @ around)
        scatter = around - design @ found
        value = found[:, 0]
    return value


AGREEMENT_NEIGHBOURS: Final = 8
"""Number of nearest neighbours that a tie point is compared with."""
MIN_COMPARED_POINTS: Final = 6
"""Least number of points among which outliers can be found."""
SCATTERS: Final = 6.11
"""The limit is this many times the robust scatter, per axis, of all points about their neighbours."""
SIGMAS: Final = 4.0
"""The limit is at least this many times the sigma of the point, where it has one."""
MIN_PX: Final = 1e-3
"""Least limit, and least sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """How well tie points agree with one another."""

    kept: Bool
    """(n,) False for points that disagree with their neighbours."""
    linear: Float64
    """(2, 2) linear part of the affine trend from predicted to observed."""
    sigma_px: float
    """Standard deviation per axis of a kept point about its neighbours, px; NaN of fewer than six points."""
    unexplained: float
    """Median distance of all points from the affine trend, as a share of their spread."""


def agreement(predicted_px: Float64, observed_px: Float64, sigma_px: Float64 | None = None) -> Agreement:
    """Compare every tie point with its neighbours, after the affine trend of all is subtracted.

    The trend may be large (points of a scanned map rotate and scale); what remains is smooth, so that the
    median of the nearest neighbours predicts it. The limit follows the scatter of the points themselves. The
    (n, 2) arrays `predicted_px` and `observed_px` are target positions (col, row), px, by the original
    georeferencing and as found. The (n,) `sigma_px` is the radial standard deviation of the latter, NaN where
    unknown.
    """
    check_observations("tie points", predicted_px, observed_px)
    n = len(predicted_px)
    if n < MIN_COMPARED_POINTS:
        return Agreement(np.ones(n, bool), np.eye(2), float("nan"), 0.0)
    residual_px, linear = _about_the_trend(predicted_px, observed_px)
    spread_px = float(np.sqrt(observed_px.var(axis=0).sum()))
    unexplained = float(np.median(np.linalg.norm(residual_px, axis=1))) / max(spread_px, MIN_PX)
    own = np.zeros(n) if sigma_px is None else np.nan_to_num(sigma_px)
    kept = np.ones(n, bool)
    for _ in range(4):
        difference_px = _from_neighbours(predicted_px, residual_px, kept)
        size_px = np.linalg.norm(difference_px, axis=1)
        scatter_px = axis_sigma(size_px[kept])
        again = size_px <= np.maximum(np.maximum(SCATTERS * scatter_px, SIGMAS * own), MIN_PX)
        if (again == kept).all() or again.sum() < MIN_COMPARED_POINTS:
            break
        kept = again
    # The median of k neighbours has a variance of its own, π/2k of a point's.
    per_axis_px = sigma_of(difference_px[kept])
    neighbours = min(AGREEMENT_NEIGHBOURS, int(kept.sum()) - 1)
    sigma = per_axis_px / np.sqrt(1 + np.pi / (2 * neighbours))
    return Agreement(kept, linear, max(float(sigma), MIN_PX), unexplained)


def _about_the_trend(predicted_px: Float64, observed_px: Float64) -> tuple[Float64, Float64]:
    """Return (n, 2) residuals of the affine trend of least absolute deviations, and its linear part."""
    centre_px = np.median(predicted_px, axis=0)
    scale_px = max(float(np.abs(predicted_px - centre_px).mean()), MIN_PX)
    basis = np.column_stack([np.ones(len(predicted_px)), (predicted_px - centre_px) / scale_px])
    found, left_px, _ = irls(
        weighted(basis, observed_px),
        lambda left_px: 1 / np.maximum(np.linalg.norm(left_px, axis=1), MIN_PX),
        np.ones(len(basis)),
        rounds=50,
    )
    return left_px, found[1:].T / scale_px


def _from_neighbours(xy_px: Float64, residual_px: Float64, kept: Bool) -> Float64:
    """Return (n, 2) residuals less the median of those of the nearest kept neighbours."""
    index = np.flatnonzero(kept)
    k = min(AGREEMENT_NEIGHBOURS, len(index) - 1)
    _, near = cKDTree(xy_px[index]).query(xy_px, k=k + 1)
    neighbours = index[near]
    # A kept point is its own nearest; one at the same place as another may come second.
    itself = neighbours == np.arange(len(xy_px))[:, None]
    itself[~itself.any(axis=1), -1] = True
    others = neighbours[~itself].reshape(len(xy_px), k)
    return np.asarray(residual_px - np.median(residual_px[others], axis=1))


def thin(xy_px: Float64, sigma: Float64, count: int | None) -> Bool:
    """Keep at most `count` well-spread points, the most precise of every cell.

    The bounding box of the points is divided into the finest grid of nearly square cells of which no more
    than `count` are occupied. Every occupied cell keeps its most precise point; the rest of `count` are the
    second best points of the cells, the most precise first, then the third best, and so on.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    sigma : (n,) array of float
        Standard deviation of each point, any unit; NaN comes last.
    count : int or None
        Largest number of points kept; None keeps all.

    Returns
    -------
    (n,) array of bool
        True where a point is kept; min(n, count) of them. The order of the points matters for ties only.
    """
    keep = np.ones(len(xy_px), dtype=bool)
    if count is None or len(xy_px) <= count:
        return keep
    keep[:] = False
    if count > 0:
        cell, _ = cells(xy_px, count)
        keep[best_of_cells(cell, sigma)[:count]] = True
    return keep


def cells(xy_px: Float64, most_occupied: int) -> tuple[Index, Float64]:
    """Divide the bounding box of the points into the finest grid with at most `most_occupied` occupied cells.

    For the (n, 2) positions `xy_px` (col, row), at least one, return the (n,) int index of the cell in which
    each lies, and its (n,) distance from the centre of that cell, in cell sides (the larger of the two axes).
    """
    low = xy_px.min(axis=0)
    extent = np.maximum(xy_px.max(axis=0) - low, 1e-9)
    # The side is searched by bisection of its logarithm. Occupancy does not fall strictly with the side,
    # so this finds a grid close to the finest; that is all that spreading needs.
    coarse, fine = float(extent.max()), float(extent.max()) / (most_occupied + 1)
    for _ in range(30):
        side = float(np.sqrt(coarse * fine))
        if len(np.unique(_cell_of(xy_px, low, extent, side)[0])) <= most_occupied:
            coarse = side
        else:
            fine = side
    return _cell_of(xy_px, low, extent, coarse)


def best_of_cells(cell: Index, badness: Float64) -> Index:
    """Return the (n,) indices that sort points: the best of every cell, then the second best, and so on.

    The (n,) array `cell` has the index of the cell of each point; the (n,) `badness` ranks points, the least
    first.
    """
    by_cell = np.lexsort((badness, cell))
    _, start, size = np.unique(cell[by_cell], return_index=True, return_counts=True)
    rank = np.empty(len(cell), dtype=np.intp)
    rank[by_cell] = np.arange(len(cell)) - np.repeat(start, size)
    return np.lexsort((badness, rank))


def _cell_of(xy_px: Float64, low: Float64, extent: Float64, side: float) -> tuple[Index, Float64]:
    shape = np.maximum(np.rint(extent / side), 1).astype(np.intp)
    place = (xy_px - low) / extent * shape
    index = np.minimum(place.astype(np.intp), shape - 1)
    return index[:, 1] * shape[0] + index[:, 0], np.abs(place - index - 0.5).max(axis=1)


def hold_out(xy_px: Float64, footprint_px: float, wanted: int = 30) -> NDArray[np.str_]:
    """Divide tie points into fit points, check points and points that are neither.

    The check points are spread by cells over the whole area. In each cell the point nearest to the cell's
    centre is taken, whatever its precision, so that they are a fair sample of the points. Matching windows
    that overlap share pixels, and so errors: points whose windows overlap that of a check point are left
    out of the fit (`unused`), as far as the number of points allows. The compromise, in this order:

    1. one point in twenty (at least `wanted`) is a check point, no fit point within `footprint_px` of one;
    2. `wanted` check points with the same guard;
    3. `wanted` check points with the widest guard that leaves 75 % of the points to the fit (of 100 to 119
       points what the check points leave).

    The first that leaves at least 75 % of the points to the fit is taken. (1000 points in 512 × 512 px with
    81 px windows: 30 check points and a guard of about 25 px.) Of fewer than 100 points one in five is a
    check point, of fewer than 10 none. The result is not random.

    Parameters
    ----------
    xy_px : (n, 2) array of float
        Positions (col, row), px.
    footprint_px : float
        Side of the matching window, px. The guard is measured along the larger of the two axes, as square
        windows overlap.
    wanted : int
        Least number of check points where there are at least 100 points and `wanted` is at most 40 % of them.

    Returns
    -------
    (n,) array of str
        ``fit``, ``check`` or ``unused``.
    """
    n = len(xy_px)
    if n < 10 or wanted < 1:
        return np.full(n, "fit", dtype="<U6")
    count = wanted if n >= 100 else min(wanted, n // 5)
    count = min(count, int(0.4 * n))
    least_fit = min(int(np.ceil(0.75 * n)), n - count)
    for number in (max(n // 20, count), count):
        check = _spread(xy_px, number)
        nearest = cKDTree(xy_px[check]).query(xy_px, p=np.inf)[0]
        guard = min(footprint_px, float(np.sort(nearest[~check])[-least_fit]))
        if guard >= footprint_px:
            break
    fit = ~check & (nearest >= guard)
    return np.where(check, "check", np.where(fit, "fit", "unused"))


def _spread(xy_px: Float64, count: int) -> Bool:
    cell, centre_distance = cells(xy_px, count)
    chosen = np.zeros(len(xy_px), dtype=bool)
    chosen[best_of_cells(cell, centre_distance)[:count]] = True
    return chosen


GROUPS = 16
"""Largest number of folds of a cross-validation."""
MAX_BLOCKS = 1024
"""Largest number of blocks of a cross-validation."""


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidationBlocks:
    """A division of points for cross-validation."""

    block: Index
    """(n,) index of the compact block in which each point lies."""
    tests: tuple[Bool, ...]
    """(n,) masks, one per fold, of the points that are predicted from all others. Every point is in one."""


def cross_validation_blocks(xy_px: Float64, footprint_px: float) -> CrossValidationBlocks:
    """Divide points into compact blocks of equal numbers, and the blocks into at most 16 folds.

    The blocks are one matching window of side `footprint_px` wide (0: independent errors), so that those of a
    fold, which lie far apart, are predicted over a distance typical of the use of a correction; there are at
    least 16 of them, if there are enough points. The points are at (n, 2) `xy_px` (col, row), px; n ≥ 3.
    """
    area = float(np.prod(np.ptp(xy_px, axis=0)))
    room = min(area / footprint_px**2, MAX_BLOCKS) if footprint_px > 0 else MAX_BLOCKS
    block = spatial_blocks(xy_px, int(min(max(GROUPS, room), len(xy_px) // 3)))
    # The last four halvings number 16 neighbours: equal remainders are 16 blocks apart.
    group = block % GROUPS
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


PROBES = 8
"""Number of random sign vectors that estimate the errors shared with a fold."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedNoise:
    """Errors that points in a fold share, through overlapping windows, with points outside it."""

    probes: Float64
    """(n, 2, m) random signs."""
    shared: tuple[Float64, ...]
    """For every fold (n, 2, m), the covariance of all points with the fold's, times the probes, px²."""

    @classmethod
    def of(cls, fit: Fit, xy_px: Float64, footprint_px: float, blocks: CrossValidationBlocks) -> SharedNoise:
        """Return the shared noise that a fit, the most flexible one, finds in points.

        The points are at (n, 2) `xy_px` (col, row), px, and the matching window is `footprint_px` wide, 0 for
        independent errors. The fit's residuals and its sharing of errors count.
        """
        probes = random_signs(xy_px, 2 * PROBES).reshape(len(xy_px), 2, PROBES)
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
    squared = np.empty(len(noise.probes))
    values = [np.concatenate([fit.remainder_px[:, :, None], shared], axis=2) for shared in noise.shared]
    for test, predicted in zip(blocks.tests, fit.left_out(blocks.tests, values), strict=True):
        missed = fit.remainder_px[test] - predicted[:, :, 0]
        optimism = (noise.probes[test] * predicted[:, :, 1:]).sum(axis=(1, 2)) / PROBES
        squared[test] = (missed**2).sum(axis=1) + 2 * optimism
    return squared
