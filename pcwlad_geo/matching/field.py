"""The displacement field between the tie points: robust local surfaces through their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.estimation.robust import SIGMA_OF_MEDIAN_LENGTH, irls
from pcwlad_geo.estimation.solving import least_squares, pseudo_inverse
from pcwlad_geo.matching.kernels.local_surfaces import fit_surfaces
from pcwlad_geo.types import Float64, Index


@dataclass(frozen=True, slots=True)
class Surface:
    """The polynomial surface that is fitted to the neighbours of a place."""

    count: int
    """Number of neighbours."""
    order: int
    """1: a plane, 2: a quadratic surface."""


@dataclass(frozen=True, slots=True)
class FieldParameters:
    """How the displacement field between tie points is predicted."""

    simpler_within_px: float = 0.02
    """A simpler surface may err by so much more than the best; a third of it would reach the tie points."""
    exclusion: float = 0.75
    """Neighbours nearer than this share of the window see the same pixels."""
    correlation: float = 0.6
    """Mean correlation of the errors of points that are less than a window apart."""
    rough_scatters: float = 3.0
    """A field is too rough where independent neighbours err by so many scatters of the nearest points."""
    rough_from_px: float = 0.15
    """Least such error of a field that is too rough."""
    most_neighbours: int = 384
    """Largest number of neighbours of a surface. Of more, every k-th is taken: windows share pixels."""
    sample: int = 400
    """Largest number of points that are compared with the prediction of their neighbours."""
    surfaces: tuple[tuple[int, int], ...] = (
        *((3072, 1), (768, 1), (768, 2), (192, 1), (384, 2), (192, 2), (48, 1), (96, 2)),
    )
    """Counts and orders of the surfaces to choose from, the simplest first."""


FIELD: Final = FieldParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The surface that predicts best, and how well it does."""

    surface: Surface
    residual_px: Float64
    """(m, 2), see `independent_residual`."""
    smooth: bool
    """Whether neighbours a window away predict a point about as well as the nearest ones do."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """The displacement that the neighbours of n places predict there; NaN where there are too few."""

    displacement_px: Float64
    """(n, 2) displacement (col, row)."""
    slope: Float64
    """(n, 2, 2) derivatives of the displacement (component, by x and y), px per px."""
    scatter_px: Float64
    """(n,) robust standard deviation per axis of the neighbours about their surface."""
    leverage: Float64
    """(n,) variance of the prediction over that of one neighbour, if their errors are independent."""

    @staticmethod
    def concatenate(parts: Sequence[Prediction]) -> Prediction:
        """Return the predictions at the places of all parts, in their order."""
        return Prediction(
            *(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(Prediction))
        )


def predict(
    xy_px: Float64, displacement_px: Float64, at_xy_px: Float64, surface: Surface, threads: int = 1
) -> Prediction:
    """Predict the displacement at places from a robust surface through their nearest points.

    The tie points have (m, 2) positions `xy_px` and (m, 2) displacements `displacement_px` (col, row). The
    (n, 2) `at_xy_px` are the places, which the `threads` share; the result is of shape (n, 2).
    """
    thinned_xy, thinned_displacement, thinned = _thinned(xy_px, displacement_px, surface)
    tree = cKDTree(thinned_xy)
    step = max(1, 2_000_000 // max(min(len(thinned_xy), thinned.count), 1))  # limits the memory
    parts = [
        _NeighbourSearch.of(tree, at_xy_px[begin : begin + step], thinned.count, threads=threads).predict(
            thinned_displacement, thinned
        )
        for begin in range(0, max(len(at_xy_px), 1), step)
    ]
    return Prediction.concatenate(parts)


def choose_surface(xy_px: Float64, displacement_px: Float64, window_px: int, threads: int = 1) -> Choice:
    """Choose the simplest surface that predicts about as well as the best one.

    The tie points have (m, 2) positions `xy_px` and (m, 2) displacements `displacement_px` (col, row). Those
    within a matching window, `window_px` wide, are not independent.
    """
    n = len(xy_px)
    candidates = [Surface(count, order) for count, order in FIELD.surfaces if count < n] or [Surface(n, 1)]
    residuals = _against_neighbours(xy_px, displacement_px, window_px, candidates, threads)
    errors = [_typical(residual) for residual, _ in residuals]
    best = next((i for i, error in enumerate(errors) if error <= min(errors) + FIELD.simpler_within_px), -1)
    residual, share = residuals[best]
    rough_px = FIELD.rough_scatters * _nearest_scatter(xy_px, displacement_px)
    smooth = errors[best] <= max(FIELD.rough_from_px, rough_px)
    return Choice(candidates[best], residual * share[:, None], smooth)


def _nearest_scatter(xy: Float64, displacement: Float64) -> float:
    """Return the typical distance of a displacement from the median of its nearest neighbours."""
    sample = np.unique(np.linspace(0, len(xy) - 1, min(FIELD.sample, len(xy))).astype(np.intp))
    _, neighbours = cKDTree(xy).query(xy[sample], k=np.arange(1, min(12, len(xy)) + 1))
    return _typical(displacement[sample] - np.median(displacement[neighbours], axis=1))


def independent_residual(
    xy_px: Float64, displacement_px: Float64, window_px: int, surface: Surface
) -> tuple[Float64, float]:
    """Compare a sample of points with the prediction of neighbours that share no pixels with them.

    For the (m, 2) positions `xy_px` and displacements `displacement_px` (col, row), return the (m, 2)
    displacement minus the prediction, px, scaled to the size of the point's own error, NaN outside the sample
    and without such neighbours, and the typical share of that error in the variance before, 0 to 1.
    """
    ((residual, share),) = _against_neighbours(xy_px, displacement_px, window_px, [surface])
    finite_share = share[np.isfinite(share)]
    return residual * share[:, None], float(np.median(finite_share**2)) if len(finite_share) else 0.0


def _against_neighbours(
    xy: Float64, displacement: Float64, window_px: int, surfaces: Sequence[Surface], threads: int = 1
) -> list[tuple[Float64, Float64]]:
    """Return displacement minus prediction, (m, 2), and how much of it is the point's own error, (m,).

    One pair for each of the surfaces; neighbours are searched once for all that use the same points.
    """
    sample = np.unique(np.linspace(0, len(xy) - 1, min(FIELD.sample, len(xy))).astype(np.intp))
    steps = {_step(surface) for surface in surfaces}
    searches = {
        step: _NeighbourSearch.of(
            cKDTree(xy[::step]),
            xy[sample],
            max(surface.count // step for surface in surfaces if _step(surface) == step),
            FIELD.exclusion * window_px,
            threads,
        )
        for step in steps
    }
    # points whose windows share pixels have correlated errors: together they say little more than one
    correlated = {
        step: FIELD.correlation * search.typical_count(window_px / np.sqrt(np.pi))
        for step, search in searches.items()
    }
    comparisons: list[tuple[Float64, Float64]] = []
    for surface in surfaces:
        _, thinned_displacement, thinned = _thinned(xy, displacement, surface)
        predicted = searches[_step(surface)].predict(thinned_displacement, thinned)
        residual, share = np.full(xy.shape, np.nan), np.full(len(xy), np.nan)
        residual[sample] = displacement[sample] - predicted.displacement_px
        share[sample] = 1 / np.sqrt(1 + predicted.leverage * correlated[_step(surface)])
        comparisons.append((residual, share))
    return comparisons


def _thinned(xy: Float64, displacement: Float64, surface: Surface) -> tuple[Float64, Float64, Surface]:
    """Return every k-th point, and the surface with as many fewer neighbours."""
    step = _step(surface)
    return xy[::step], displacement[::step], Surface(surface.count // step, surface.order)


def _step(surface: Surface) -> int:
    """Return k, where every k-th point is used as a neighbour."""
    return -(-surface.count // FIELD.most_neighbours)


def _typical(residual: Float64) -> float:
    radial = np.hypot(residual[:, 0], residual[:, 1])
    finite = radial[np.isfinite(radial)]
    return float(np.median(finite)) if len(finite) else np.inf


def global_affine(xy_px: Float64, displacement_px: Float64) -> tuple[Float64, Float64]:
    """Fit displacement = offset + linear · (xy - centre) robustly.

    For the (m, 2) positions `xy_px` and displacements `displacement_px` (col, row) of tie points, return the
    (2, 2) deformation of the target against the reference (component, by x and y), px per px, and its (2, 2)
    standard error if the errors of the points are independent.
    """
    design = np.c_[np.ones(len(xy_px)), xy_px - xy_px.mean(axis=0)]

    def solve(root: Float64) -> tuple[Float64, Float64]:
        parameters = least_squares(design * root[:, None], displacement_px * root[:, None])
        return parameters, displacement_px - design @ parameters

    def roots(residual: Float64) -> Float64:
        """Return the (n,) square roots of weights."""
        radial = np.hypot(residual[:, 0], residual[:, 1])
        scale = max(float(np.median(radial)), 1e-6)
        return np.asarray(1 / np.sqrt(1 + (radial / scale) ** 2))

    solution, residual, weight = irls(solve, roots, np.ones(len(xy_px)), rounds=20)
    # points on one line leave the slope across it undetermined: both give 0 there
    inverse = pseudo_inverse((design * weight[:, None] ** 2).T @ design, least=1e-10)
    variance = (weight[:, None] ** 2 * residual**2).sum(axis=0) / (weight**2).sum()
    return solution[1:].T.copy(), np.sqrt(np.outer(variance, np.diagonal(inverse)[1:]))


@dataclass(frozen=True, slots=True, eq=False)
class _NeighbourSearch:
    """Points near each of n places, the nearest first."""

    tree: cKDTree
    at: Float64
    """(n, 2) places (col, row)."""
    distance: Float64
    index: Index
    """(n, k) indices of the nearest points, of which `distance` is the distance, px."""
    excluded_px: float
    """Points nearer than this do not count."""
    nearer: int
    """Largest number of such points at a place."""
    threads: int

    @staticmethod
    def of(
        tree: cKDTree, at: Float64, count: int, excluded_px: float = 0.0, threads: int = 1
    ) -> _NeighbourSearch:
        """Search the nearest `count` points that count."""
        at, nearer = np.ascontiguousarray(at, np.float64), 0
        if excluded_px and tree.n > 1 and len(at):
            nearer = int(tree.query_ball_point(at, excluded_px, return_length=True).max())
        nearest = np.arange(1, min(tree.n, count + nearer) + 1)
        distance, index = tree.query(at, k=nearest, workers=threads)
        return _NeighbourSearch(tree, at, distance, index.astype(np.intp), excluded_px, nearer, threads)

    def typical_count(self, radius_px: float) -> float:
        """Return the median number of points within a radius of the places; 1 if there is no place."""
        counts = self.tree.query_ball_point(self.at, radius_px, return_length=True)
        return float(np.median(counts)) if len(counts) else 1.0

    def predict(self, displacement: Float64, surface: Surface) -> Prediction:
        """Fit a surface to the nearest points that count."""
        reach = min(self.tree.n, surface.count + self.nearer)
        index = np.ascontiguousarray(self.index[:, :reach])
        usable = np.ones(index.shape, bool)
        if self.excluded_px:
            usable = self.distance[:, :reach] >= self.excluded_px
            usable &= np.cumsum(usable, axis=1) <= surface.count
        n = len(self.at)
        out, slope = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
        scatter, leverage = np.full(n, np.nan), np.full(n, np.nan)
        values = np.ascontiguousarray(displacement, np.float64)
        outputs = (out, slope, scatter, leverage)
        fit_surfaces(self.tree.data, values, self.at, index, usable, surface.order, *outputs, self.threads)
        return Prediction(out, slope, SIGMA_OF_MEDIAN_LENGTH * scatter, leverage)
