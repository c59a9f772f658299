"""Smoothing thin-plate splines: sparse least squares, robust, and weighted by the points' covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import LinearOperator, cg

from pcwlad_geo.correction.dense import Lattice, positions
from pcwlad_geo.correction.fitted import Fit, Support, Trend, checked
from pcwlad_geo.correction.models import SplineCorrection, SplineGrid, cubic_b_splines
from pcwlad_geo.correction.points import PROBES, cross_validation_blocks, local_surface
from pcwlad_geo.estimation.robust import Estimate, Solution, reweighted
from pcwlad_geo.estimation.shared_errors import Overlaps, SharedErrors, probes_of, random_signs
from pcwlad_geo.estimation.solving import BandedFactor, banded
from pcwlad_geo.types import Bool, Float64, Index

Sparse: TypeAlias = scipy.sparse.csc_array

MAX_CELLS = 40
"""Largest number of cells along the longer side."""
CELL_PER_WINDOW = 0.75
"""Least side of a cell in window sides: displacements averaged over a window have no finer detail."""
MAX_FIELD_CELLS = 80
"""`MAX_CELLS` of the field model."""
FIELD_CELL_PER_WINDOW = 0.5
"""`CELL_PER_WINDOW` of the field model, which restores detail that the windows have averaged."""
WINDOW_NODES = 4
"""Number of quadrature nodes along the side of a window."""


def grid_of(xy_px: Float64, footprint_px: float, *, field: bool = False) -> SplineGrid:
    """Return the grid for the (n, 2) points `xy_px` (col, row) with windows of side `footprint_px`, px.

    The `field` model has smaller cells.
    """
    per_window, most = (FIELD_CELL_PER_WINDOW, MAX_FIELD_CELLS) if field else (CELL_PER_WINDOW, MAX_CELLS)
    low, extent = xy_px.min(axis=0), np.maximum(np.ptp(xy_px, axis=0), 1e-6)
    finest = float(np.sqrt(np.prod(extent) / len(xy_px)))
    spacing = max(float(extent.max()) / most, per_window * footprint_px, finest)
    cells = np.maximum(np.ceil(extent / spacing * (1 - 1e-9)), 1).astype(int)
    # The grid is centred on the points.
    origin = low - (cells * spacing - extent) / 2
    return SplineGrid((float(origin[0]), float(origin[1])), spacing, (int(cells[0]), int(cells[1])))


def bending(grid: SplineGrid) -> Sparse:
    """Return the (k, k) matrix of the bending energy over the grid, with cells of side 1.

    The energy is the integral of f_xx² + 2 f_xy² + f_yy² (Duchon 1977, doi:10.1007/BFb0086566).
    """
    along_cols, along_rows = ([_gram(cells, k) for k in range(3)] for cells in grid.cells)
    energy = (
        scipy.sparse.kron(along_rows[0], along_cols[2])
        + 2 * scipy.sparse.kron(along_rows[1], along_cols[1])
        + scipy.sparse.kron(along_rows[2], along_cols[0])
    )
    return scipy.sparse.csc_array(energy)


def decay(grid: SplineGrid, reach_px: float) -> Sparse:
    """Return the (k, k) matrix of a penalty on the squared values of a spline, with cells of side 1.

    Added to the bending energy, it lets the spline decay to zero within `reach_px` where there are no points.
    """
    along_cols, along_rows = (_gram(cells, 0) for cells in grid.cells)
    weight = (grid.spacing_px / reach_px) ** 4
    return scipy.sparse.csc_array(weight * scipy.sparse.kron(along_rows, along_cols))


def windowed_design(grid: SplineGrid, xy_px: Float64, footprint_px: float) -> scipy.sparse.csr_array:
    """Return the (n, k) means of the B-splines over windows of side `footprint_px` at the (n, 2) `xy_px`."""
    nodes = footprint_px * ((np.arange(WINDOW_NODES) + 0.5) / WINDOW_NODES - 0.5)
    total = sum(grid.design(xy_px + place) for place in positions(nodes, nodes))
    return scipy.sparse.csr_array(total / WINDOW_NODES**2)


def _gram(cells: int, derivative: int) -> Sparse:
    """Return the (cells + 3, cells + 3) integrals of products of two B-splines' derivatives."""
    node, weight = np.polynomial.legendre.leggauss(4)  # exact to degree 7
    values = cubic_b_splines((node + 1) / 2)[derivative]
    cell = (values.T * weight / 2) @ values
    total = np.zeros((cells + 3, cells + 3))
    for first in range(cells):
        total[first : first + 4, first : first + 4] += cell
    return scipy.sparse.csc_array(total)


@dataclass(frozen=True, slots=True, eq=False)
class ThinPlateSystem:
    """The design and the bending energy of a spline on a grid, without weights and smoothing."""

    grid: SplineGrid
    design: scipy.sparse.csr_array
    """(n, k) values of the B-splines at the points."""
    energy: Sparse
    """(k, k) bending energy; of the field model, plus its decay."""
    energy_of_both: Sparse
    """(2 * k, 2 * k) energy of the coefficients of col, then of row."""
    transposed: scipy.sparse.csc_array
    """(k, n) of the design."""
    energy_bands: tuple[Float64, Float64]
    """Diagonals of the energy of one axis and of both, see `solving.banded`."""

    @classmethod
    def of(cls, xy_px: Float64, footprint_px: float) -> ThinPlateSystem:
        """Return the equations for the (n, 2) points `xy_px` (col, row) and windows of `footprint_px`."""
        grid = grid_of(xy_px, footprint_px)
        return cls.on(grid, grid.design(xy_px), bending(grid))

    @classmethod
    def of_field(cls, xy_px: Float64, footprint_px: float, reach_px: float) -> ThinPlateSystem:
        """Return the equations of the field model for the (n, 2) points `xy_px` (col, row).

        Means of the spline over windows of `footprint_px` are observed, and it decays to zero within
        `reach_px` where there are no points.
        """
        grid = grid_of(xy_px, footprint_px, field=True)
        return cls.on(grid, windowed_design(grid, xy_px, footprint_px), bending(grid) + decay(grid, reach_px))

    @classmethod
    def on(cls, grid: SplineGrid, design: scipy.sparse.csr_array, energy: Sparse) -> ThinPlateSystem:
        """Return the equations for an (n, k) `design` and a (k, k) `energy`."""
        both = scipy.sparse.block_diag([energy, energy], format="csc")
        bands = tuple(
            banded(matrix, _order(len(grid.nodes_px()), axes)) for axes, matrix in ((1, energy), (2, both))
        )
        return cls(grid, design, energy, both, design.T, (bands[0], bands[1]))

    def normal(self, precision: Float64) -> Float64:
        """Return the diagonals (see `solving.banded`) of the normal matrix for a precision, 1/px².

        It is that of one axis for an (n,) `precision`, of both for (n, 2, 2).
        """
        if precision.ndim == 1:
            return banded(self._normal(precision), _order(self.design.shape[1], 1))
        col, cross, row = (self._normal(precision[:, a, b]) for a, b in ((0, 0), (0, 1), (1, 1)))
        both = scipy.sparse.block_array([[col, cross], [cross, row]])
        return banded(both, _order(self.design.shape[1], 2))

    def _normal(self, precision: Float64) -> Sparse:
        """Return the (k, k) normal matrix of one axis for an (n,) `precision`, 1/px²."""
        design = self.design
        scaled = design.data * np.repeat(precision, np.diff(design.indptr))
        return self.transposed @ scipy.sparse.csr_array((scaled, design.indices, design.indptr), design.shape)

    def planes(self, root: Float64) -> Float64:
        """Return (n, 3) orthonormal vectors that span the planes at the points, times the (n,) `root`."""
        nodes = self.grid.nodes_px()
        nodes = (nodes - nodes.mean(axis=0)) / self.grid.spacing_px
        planes = self.design @ np.column_stack([np.ones(len(nodes)), nodes])
        return np.linalg.qr(root[:, None] * planes)[0]

    def freedom(self, relative_smoothing: float, probes: Float64) -> float:
        """Return the effective number of parameters of an axis for equal precisions.

        It is the trace of the smoother. A spline reproduces planes, which count as 3; the (n, m) random signs
        `probes` estimate the rest.
        """
        precision = np.ones(len(probes))
        factor = self.factor(self.normal(precision), self.smoothing(relative_smoothing, precision))
        planes = self.planes(precision)
        bent = probes - planes @ (planes.T @ probes)
        smoothed = self.design @ factor.solve(self.transposed @ bent)
        return 3 + float((bent * smoothed).sum()) / float(probes.shape[1])

    def smoothing(self, relative_smoothing: float, precision: Float64) -> float:
        """Return λ for the (n,) `precision`, 1/px²: it is relative to the mean total precision of a cell."""
        return relative_smoothing * float(precision.sum()) / float(np.prod(self.grid.cells))

    def factor(self, normal: Float64, smoothing: float) -> BandedFactor:
        """Factorise the matrix with the (b, k) diagonals `normal`, plus `smoothing` times the energy."""
        count = self.design.shape[1]
        axes = normal.shape[1] // count
        energy = self.energy_bands[axes - 1]
        total = np.zeros((max(len(normal), len(energy)), axes * count))
        total[: len(normal)] = normal
        total[: len(energy)] += smoothing * energy
        needs = "the thin-plate spline needs tie points of finite sigma"
        return BandedFactor(total, _order(count, axes), needs)


def _order(count: int, axes: int) -> Index:
    """Return the places of the coefficients of one axis or of both in the band: a node's are adjacent."""
    return np.arange(axes * count).reshape(-1, axes).T.ravel()


class Successive:
    """Fits both axes for successive sets of precisions, each similar to the one before.

    A factorisation serves as the preconditioner of conjugate gradients while these converge within few steps,
    each of which costs a thirtieth of a factorisation.

    Parameters
    ----------
    system : ThinPlateSystem
        The equations.
    values_px : (n, 2) array
        Values (col, row), px, to which the spline is fitted.
    """

    def __init__(self, system: ThinPlateSystem, values_px: Float64) -> None:
        self._system, self._values_px = system, values_px
        self._factor: BandedFactor | None = None
        self._found: Float64 | None = None

    def solve(self, precision: Float64, smoothing: float) -> Float64:
        """Return the (k, 2) coefficients (col, row), px, for an (n, 2, 2) `precision` and a `smoothing`."""
        design, energy = self._system.design, self._system.energy_of_both
        transposed = self._system.transposed

        def right_side(values_px: Float64) -> Float64:
            weighted = np.einsum("iab,ib->ia", precision, values_px)
            return np.asarray((transposed @ weighted).T.ravel())

        def times(flat: Float64) -> Float64:
            return np.asarray(right_side(design @ flat.reshape(2, -1).T) + smoothing * (energy @ flat))

        right, unconverged = right_side(self._values_px), 1
        if self._factor is not None:
            preconditioner = LinearOperator(energy.shape, matvec=self._factor.solve, dtype=np.float64)
            system = LinearOperator(energy.shape, matvec=times, dtype=np.float64)
            self._found, unconverged = cg(system, right, self._found, rtol=1e-7, maxiter=12, M=preconditioner)
        if unconverged:
            self._factor = self._system.factor(self._system.normal(precision), smoothing)
            self._found = self._factor.solve(right)
        return np.asarray(self._found).reshape(2, -1).T


def precision_matrices(whitener: Float64, weight: Float64) -> Float64:
    """Return the (n, 2, 2) weighted precision matrices, 1/px², of the points.

    The (n, 2, 2) `whitener` and the (n,) `weight` are those of `Estimate`.
    """
    return weight[:, None, None] * (whitener.transpose(0, 2, 1) @ whitener)


def mean_precision(whitener: Float64, weight: Float64) -> Float64:
    """Return the (n,) weighted precision, 1/px², of each point, averaged over all directions.

    The (n, 2, 2) `whitener` and the (n,) `weight` are those of `Estimate`.
    """
    return np.asarray(weight * (whitener**2).sum(axis=(1, 2)) / 2)


@dataclass(frozen=True, slots=True)
class SmoothingTrial:
    """How well a spline of a given smoothing fits."""

    squares: float
    """Sum of the weighted squared residuals, mean of the axes."""
    used: tuple[float, float]
    """Effective parameters per point, for independent errors and for errors that windows share."""
    errors: SharedErrors
    """How far the errors are shared, as estimated from the residuals."""

    def score(self, alpha: float) -> float:
        """Return the generalised cross-validation score; infinite if the spline has too many parameters.

        A spline follows correlated errors as if it had more parameters (Opsomer, Wang & Yang 2001,
        Nonparametric regression with correlated errors, Statistical Science 16(2), 134-153).
        """
        used = (1 - alpha) * self.used[0] + alpha * self.used[1]
        return self.squares / (1 - used) ** 2 if used < 0.6 else np.inf


@dataclass(frozen=True, slots=True, eq=False)
class SmoothingTrials:
    """Weighted points to which splines of any smoothing can be fitted; col and row have the same weights."""

    system: ThinPlateSystem
    overlaps: Overlaps
    values_px: Float64
    """(n, 2) values (col, row), px."""
    normal: Float64
    """Diagonals of the normal matrix, the same for every smoothing."""
    root: Float64
    """(n, 1) square root of the precision, 1/px, 0 for outliers."""
    inlier: Float64
    """(n, 1) 1, or 0 for outliers."""
    probes: Float64
    """(n, m) random signs."""
    shared: Float64
    """(n, m) products of these signs with the overlaps of the inliers' windows."""
    planes: Float64
    """(n, 3) orthonormal vectors that span the planes, see `ThinPlateSystem.planes`."""
    patches: float
    """Number of independent windows, see `Overlaps.patches`."""
    straight: tuple[float, float]
    """Parameters of the planes, for independent errors and for errors that windows share."""
    whitened: Float64
    """(n, m') probes, products with the overlaps, planes and values, to which every spline is fitted."""
    right: Float64
    """(k, m') right sides of their normal equations."""

    @classmethod
    def of(
        cls,
        system: ThinPlateSystem,
        overlaps: Overlaps,
        probes: Float64,
        values_px: Float64,
        whitener: Float64,
        weight: Float64,
    ) -> SmoothingTrials:
        """Return trials of a spline in which inliers have weight 1.

        Weights that follow the residuals would make these look small. The (n, m) `probes` are random signs,
        see `probes_of`. Splines are fitted to the (n, 2) `values_px` (col, row). The (n, 2, 2) `whitener` and
        (n,) `weight` are those of `Estimate`.
        """
        inlier = (weight > 0).astype(np.float64)
        precision = mean_precision(whitener, inlier)
        root, of_inliers = np.sqrt(precision)[:, None], inlier[:, None]
        planes = system.planes(root[:, 0])
        count = probes.shape[1]
        times = of_inliers * overlaps.times(of_inliers * np.column_stack([probes, planes]))
        shared, straight = (
            times[:, :count],
            (float((planes**2).sum()), float((planes * times[:, count:]).sum())),
        )
        whitened = np.column_stack([probes, shared, planes, root * values_px])
        given = (
            system.normal(precision),
            root,
            of_inliers,
            probes,
            shared,
            planes,
            overlaps.patches(),
            straight,
            whitened,
        )
        return cls(system, overlaps, values_px, *given, system.transposed @ (root * whitened))

    @property
    def precision(self) -> Float64:
        """(n,) 1/px², 0 for outliers."""
        return self.root[:, 0] ** 2

    def smoothing(self, relative_smoothing: float) -> float:
        """Return the λ of a relative smoothing parameter."""
        return self.system.smoothing(relative_smoothing, self.precision)

    def at(self, smoothing: float) -> SmoothingTrial:
        """Fit a spline with the `smoothing` λ; estimate its response to independent and shared errors."""
        found = self.system.factor(self.normal, smoothing).solve(self.right)
        remaining = self.whitened - self.root * (self.system.design @ found)
        count = self.probes.shape[1]
        left, shared_error, bent, residual = np.split(remaining, [count, 2 * count, 2 * count + 3], axis=1)
        followed = self.probes - left
        own = self.inlier * self.probes
        own_error = own - followed  # a spline follows inliers alone
        times = self.inlier * self.overlaps.times(self.inlier * np.column_stack([left, residual]))
        products = [[(a * b).sum() for b in (own_error, shared_error)] for a in (left, times[:, :count])]
        squares = float((residual**2).sum()) / 2
        errors = SharedErrors.of(
            np.array(products) / count,
            squares,
            float((residual * times[:, count:]).sum()) / 2,
            self.patches,
        )
        # Planes are reproduced, and counted exactly; random signs estimate the rest of the traces.
        smoothed = followed - (self.planes - bent) @ (self.planes.T @ self.probes)
        used = [
            (part + float((smoothed * noise).sum()) / count) / float(self.inlier.sum())
            for part, noise in zip(self.straight, (own, self.shared), strict=True)
        ]
        return SmoothingTrial(squares, (used[0], used[1]), errors)


def best(trials: list[SmoothingTrial], alpha: float) -> int:
    """Return the index of the best of several trials, of which the first has the largest smoothing.

    It depends on `alpha`, the part of the errors that windows share, which itself depends on the residuals of
    the best spline. The iteration starts from 1, which smooths most, or from an earlier result.
    """
    for _ in range(4):
        index = int(np.argmin([trial.score(alpha) for trial in trials]))
        before, alpha = alpha, trials[index].errors.alpha
        if abs(alpha - before) < 0.02:
            break
    return index


CHUNK = 32
"""Number of places whose covariance is computed at once."""
NODES = 20
"""Largest number of nodes along an axis between which the covariance at many places is interpolated."""


@dataclass(frozen=True, slots=True, eq=False)
class SplineFit(Fit):
    """Fit of a thin-plate spline; its remainder is the displacements minus their robust affine."""

    system: ThinPlateSystem
    smoothing: float
    """λ."""
    footprint_px: float

    def left_out(self, folds: Sequence[Bool], values_px: Sequence[Float64]) -> list[Float64]:
        """Return the (k, 2, m) predictions for each of (n,) `folds` from (n, 2, m) `values_px`.

        See `Fit.left_out`.
        """
        precision = mean_precision(self.whitener, self.estimate.weight)
        predicted = []
        for fold, values in zip(folds, values_px, strict=True):
            of_others = np.where(fold, 0.0, precision)
            factor = self.system.factor(self.system.normal(of_others), self.smoothing)
            flat = of_others[:, None] * values.reshape(len(values), -1)
            found = self.system.design[fold] @ factor.solve(self.system.transposed @ flat)
            predicted.append(np.asarray(found.reshape(-1, *values.shape[1:])))
        return predicted

    def covariance(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance, px², of the correction at the (n, 2) predicted `at_px`.

        It is the propagated errors of the points plus the expected bias by smoothing a field as rough as this
        one (Nychka 1988, doi:10.1080/01621459.1988.10478711). At more than 400 places it is interpolated
        between at most 400 nodes, so all places should be passed at once.
        """
        at_px = np.asarray(at_px, dtype=np.float64)
        if len(at_px) <= NODES**2:
            return self._covariance(at_px)
        lattice = Lattice.over(at_px.min(axis=0), at_px.max(axis=0), self.system.grid.spacing_px, NODES)
        values = self._covariance(lattice.nodes_px()).reshape(*lattice.shape, 2, 2)
        return lattice.interpolated(values, at_px)

    def _covariance(self, at_px: Float64) -> Float64:
        normal = self.system.normal(precision_matrices(self.whitener, self.estimate.weight))
        factor = self.system.factor(normal, self.smoothing)
        parts = [
            self._covariance_of_chunk(factor, at_px[start : start + CHUNK])
            for start in range(0, len(at_px), CHUNK)
        ]
        return np.concatenate(parts) if parts else np.empty((0, 2, 2))

    def _covariance_of_chunk(self, factor: BandedFactor, at_px: Float64) -> Float64:
        m = len(at_px)
        design = self.system.grid.design(at_px).toarray().T
        k = len(design)
        right = np.zeros((2, k, m, 2))
        right[0, :, :, 0] = right[1, :, :, 1] = design
        answer = factor.solve(right.reshape(2 * k, 2 * m)).reshape(2, k, 2 * m)
        energy = np.stack([self.system.energy @ answer[axis] for axis in range(2)])
        bias = self.smoothing * _products(answer, energy)
        moved = np.stack([self.system.design @ answer[axis] for axis in range(2)], axis=1)
        # (n, 2, 2 · m) derivatives of the correction at the places by the whitened observations
        influence = self.estimate.weight[:, None, None] * (self.whitener @ moved)
        size = np.abs(influence).max(axis=(1, 2))
        near = size > 1e-3 * size.max()
        influence = influence[near]
        noise = _products(influence, influence)
        if self.footprint_px > 0:
            shared = Overlaps.of(self.predicted_px[near], self.footprint_px).times(influence)
            alpha = self.errors.alpha
            noise = (1 - alpha) * noise + alpha * _products(influence, shared)
        return self.errors.scale * (noise + bias)


def _products(left: Float64, right: Float64) -> Float64:
    """Return the (m, 2, 2) sums, over all but the last axis, of products of (..., 2 · m) arrays."""
    pairs = (each.reshape(-1, each.shape[-1] // 2, 2) for each in (left, right))
    return np.asarray(np.einsum("kma,kmb->mab", *pairs))


MIN_SPLINE_POINTS = 12
"""Least number of tie points of a thin-plate spline."""
HOLE = 2.0
"""Distance over which a field returns to the affine, as a multiple of the reach of its `Support`."""


def fit_tps(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    trend: Trend | None = None,
) -> SplineFit:
    """Fit a smoothing thin-plate spline (Duchon 1977, doi:10.1007/BFb0086566), weighted by the covariance.

    It is fitted to the residuals of a robust affine, and continued linearly beyond the box of the points. The
    smoothing minimises the generalised cross-validation score, in which errors that overlapping windows share
    do not count as detail (Opsomer, Wang & Yang 2001). The spline never interpolates the points. Raises
    `InputError` if the points are too few or lie on a line, or an array has a wrong shape or values that are
    not finite. The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2` are those of
    `fit.fit_polynomial`, as are `footprint_px` and `trend`; n ≥ 12, not on one line.
    """
    points = checked("tps", MIN_SPLINE_POINTS, predicted_px, observed_px, covariance_px2)
    return _fit_spline("tps", ThinPlateSystem.of(points[0], footprint_px), points, footprint_px, trend)


def fit_field(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    trend: Trend | None = None,
) -> SplineFit:
    """Fit the measured field: an affine, plus what the points show beyond it, weighted by the covariance.

    It differs from the thin-plate spline in four ways. Its cells are smaller. A displacement is taken for the
    mean of the field over its window, which restores detail that the windows have averaged. The difference
    from the affine decays to zero in wide holes. And the smoothing minimises the error at left-out blocks of
    one window each, with the errors that these share with their neighbours allowed for. Raises `InputError`
    if the points are too few or lie on a line, or an array has a wrong shape or values that are not finite.
    The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2` are those of
    `fit.fit_polynomial`, as are `footprint_px` and `trend`; n ≥ 12, not on one line.
    """
    points = checked("field", MIN_SPLINE_POINTS, predicted_px, observed_px, covariance_px2)
    reach_px = HOLE * (Support.of(points[0], footprint_px).reach_px or 1.0)
    system = ThinPlateSystem.of_field(points[0], footprint_px, reach_px)
    return _fit_spline("field", system, points, footprint_px, trend)


def _fit_spline(
    name: str,
    system: ThinPlateSystem,
    points: tuple[Float64, Float64, Float64],
    footprint_px: float,
    trend: Trend | None,
) -> SplineFit:
    """Fit a spline, given its equations, to (predicted, observed, covariance) of points."""
    predicted, observed, covariance = points
    trend = trend or Trend.of(predicted, observed, covariance)
    overlaps = Overlaps.of(predicted, footprint_px)
    rest = observed - predicted - trend.estimate.fitted_px
    task = _SplineTask(system, overlaps, probes_of(predicted), rest, covariance)
    start = local_surface(predicted, rest)
    if name == "field":
        relative_smoothing = _smoothing_by_blocks(task, start, footprint_px, predicted)
    else:
        relative_smoothing = _smoothing_by_score(task, start)
    found = task.fitted(relative_smoothing, start)
    smoothing = system.smoothing(relative_smoothing, mean_precision(found.whitener, found.weight))
    coefficients = found.parameters + trend.terms(system.grid.nodes_px()) @ trend.estimate.parameters
    return SplineFit(
        correction=SplineCorrection(name, system.grid, coefficients.reshape(*system.grid.shape, 2)),
        freedom=2 * found.freedom,
        predicted_px=predicted,
        remainder_px=rest,
        estimate=found,
        errors=task.trials(found).at(smoothing).errors,
        support=Support.of(predicted[found.weight > 0], footprint_px),
        system=system,
        smoothing=smoothing,
        footprint_px=footprint_px,
    )


def _smoothing_by_blocks(task: _SplineTask, start_px: Float64, footprint_px: float, xy_px: Float64) -> float:
    """Return the relative smoothing parameter with the least error at blocks left out.

    Generalised cross-validation, which smooths too much where errors are shared, gives the first one tried. A
    block and its prediction from windows that overlap it have errors in common, which makes the prediction
    look too good: twice their expected covariance is added (see `points.left_out_errors`).
    """
    tried = _tried(task)
    trials = task.trials(task.weighted(start_px))
    smoothest, trial = _best(trials, tried)
    errors = trial.errors
    blocks = cross_validation_blocks(xy_px, footprint_px)
    precision, system = trials.precision, task.system
    folds = int(np.clip(8000 // system.energy.shape[0], 4, len(blocks.tests)))
    sigma = np.divide(1, trials.root, out=np.zeros_like(trials.root), where=trials.root > 0)
    signs = random_signs(xy_px, PROBES)
    finer = tried[smoothest : smoothest + 6]
    scores = np.zeros(len(finer))
    for test in blocks.tests[:folds]:
        noise = sigma * task.overlaps.times(signs * sigma * test[:, None])
        kept = np.where(test, 0.0, precision)
        normal, values = system.normal(kept), np.column_stack([task.rest_px, noise])
        right = system.transposed @ (kept[:, None] * values)
        for step, relative_smoothing in enumerate(finer):
            factor = system.factor(normal, trials.smoothing(relative_smoothing))
            predicted = system.design[test] @ factor.solve(right)
            missed = ((task.rest_px[test] - predicted[:, :2]) ** 2).sum(axis=1)
            # 2 of the covariance, of 2 axes
            optimism = 4 * (signs[test] * predicted[:, 2:]).mean(axis=1)
            missed += errors.alpha * errors.scale * optimism
            scores[step] += float((precision[test] * missed).sum())
    return finer[int(np.argmin(scores))]


def _smoothing_by_score(task: _SplineTask, start_px: Float64) -> float:
    """Return the relative smoothing parameter of the best score.

    The robust weights are those of the residuals from a local surface through each point's neighbours, as a
    smooth spline takes detail for outliers.
    """
    tried = _tried(task)
    trials = task.trials(task.weighted(start_px))
    found, trial = _best(trials, tried)
    between = [tried[found] * factor for factor in (2.0, 1.0, 0.5)]
    less, more = (trials.at(trials.smoothing(between[k])) for k in (0, 2))
    return between[best([less, trial, more], trial.errors.alpha)]


def _tried(task: _SplineTask) -> list[float]:
    """Return the smoothing parameters that are tried, the largest first."""
    side = float(max(task.system.grid.cells))
    # The first leaves a tenth of a square plate's softest mode; each next one doubles the parameters.
    return [0.02 * side**4 / 4.0**step for step in range(14)]


def _best(trials: SmoothingTrials, tried: list[float]) -> tuple[int, SmoothingTrial]:
    """Return the index of the smoothing parameter of the best score, and its trial."""
    done = []
    for relative_smoothing in tried:
        done.append(trials.at(trials.smoothing(relative_smoothing)))
        if not np.isfinite(done[-1].score(alpha=0.0)):
            break
    index = best(done, alpha=1.0)
    return index, done[index]


@dataclass(frozen=True, slots=True, eq=False)
class _SplineTask:
    """The data to which a spline is fitted."""

    system: ThinPlateSystem
    overlaps: Overlaps
    probes: Float64
    rest_px: Float64
    """(n, 2) displacements (col, row) minus their robust affine."""
    covariance_px2: Float64

    def trials(self, pilot: Estimate) -> SmoothingTrials:
        """Return trials with the inliers of the fit `pilot`."""
        return SmoothingTrials.of(
            self.system, self.overlaps, self.probes, self.rest_px, pilot.whitener, pilot.weight
        )

    def weighted(self, start_px: Float64) -> Estimate:
        """Return the robust weights of the residuals from the (n, 2) values `start_px`."""
        unchanged = Solution(np.empty((0, 2)), start_px, 0.0)
        return reweighted(lambda *_: unchanged, start_px, self.rest_px, self.covariance_px2)

    def fitted(self, relative_smoothing: float, start_px: Float64) -> Estimate:
        """Return the robust fit that starts from given (n, 2) values."""
        freedom = self.system.freedom(relative_smoothing, self.probes)
        successive = Successive(self.system, self.rest_px)

        def solve(whitener: Float64, weight: Float64) -> Solution:
            precision = precision_matrices(whitener, weight)
            smoothing = self.system.smoothing(relative_smoothing, mean_precision(whitener, weight))
            found = successive.solve(precision, smoothing)
            return Solution(found, self.system.design @ found, freedom)

        return reweighted(solve, start_px, self.rest_px, self.covariance_px2, tolerance_px=1e-3)
