"""The equations of smoothing splines on a grid: design, bending energy, and their solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import LinearOperator, cg

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.correction.splines import SplineGrid, cubic_b_splines
from pcwlad_geo.estimation.solving import BandedFactor, banded
from pcwlad_geo.types import Float64, Index

Sparse: TypeAlias = scipy.sparse.csc_array


@dataclass(frozen=True, slots=True)
class SplineParameters:
    """The grid of a spline, and how exactly its fit and its covariance are computed."""

    min_points: int = 12
    """Least number of tie points."""
    max_cells: int = 40
    """Largest number of cells along the longer side."""
    cell_per_window: float = 0.75
    """Least side of a cell in window sides: displacements averaged over a window have no finer detail."""
    window_nodes: int = 4
    """Number of quadrature nodes along the side of a window, over which the field is averaged."""
    hole: float = 2.0
    """Distance over which a field returns to the affine, as a multiple of the reach of its `Support`."""
    smoothing_levels: int = 14
    """Number of smoothing parameters that are tried, each a quarter of the one before."""
    finer_levels: int = 6
    """Number of these, from the one of the best score on, that are compared by the error at blocks."""
    covariance_nodes: int = 20
    """Largest number of nodes along an axis between which the covariance at many places is interpolated."""
    covariance_places: int = 32
    """Number of places whose covariance is computed at once, which limits the memory."""


THIN_PLATE: Final = SplineParameters()
"""Those of the thin-plate spline."""
WINDOWED_SPLINE: Final = SplineParameters(max_cells=80, cell_per_window=0.5)
"""Those of the measured field, which restores detail that the windows have averaged."""


def grid_of(xy_px: Float64, footprint_px: float, parameters: SplineParameters = THIN_PLATE) -> SplineGrid:
    """Return the grid for the (n, 2) points `xy_px` (col, row) with windows of side `footprint_px`, px."""
    low, extent = xy_px.min(axis=0), np.maximum(np.ptp(xy_px, axis=0), 1e-6)
    finest = float(np.sqrt(np.prod(extent) / len(xy_px)))
    least = parameters.cell_per_window * footprint_px
    spacing = max(float(extent.max()) / parameters.max_cells, least, finest)
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


def windowed_design(
    grid: SplineGrid, xy_px: Float64, footprint_px: float, window_nodes: int = WINDOWED_SPLINE.window_nodes
) -> scipy.sparse.csr_array:
    """Return the (n, k) means of the B-splines over windows of side `footprint_px` at the (n, 2) `xy_px`."""
    nodes = footprint_px * ((np.arange(window_nodes) + 0.5) / window_nodes - 0.5)
    total = sum(grid.design(xy_px + place) for place in positions(nodes, nodes))
    return scipy.sparse.csr_array(total / window_nodes**2)


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
    def of(
        cls, xy_px: Float64, footprint_px: float, parameters: SplineParameters = THIN_PLATE
    ) -> ThinPlateSystem:
        """Return the equations for the (n, 2) points `xy_px` (col, row) and windows of `footprint_px`."""
        grid = grid_of(xy_px, footprint_px, parameters)
        return cls.on(grid, grid.design(xy_px), bending(grid))

    @classmethod
    def of_field(
        cls,
        xy_px: Float64,
        footprint_px: float,
        reach_px: float,
        parameters: SplineParameters = WINDOWED_SPLINE,
    ) -> ThinPlateSystem:
        """Return the equations of the field model for the (n, 2) points `xy_px` (col, row).

        Means of the spline over windows of `footprint_px` are observed, and it decays to zero within
        `reach_px` where there are no points.
        """
        grid = grid_of(xy_px, footprint_px, parameters)
        means = windowed_design(grid, xy_px, footprint_px, parameters.window_nodes)
        return cls.on(grid, means, bending(grid) + decay(grid, reach_px))

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
        self._solution: Float64 | None = None

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
            self._solution, unconverged = cg(
                system, right, self._solution, rtol=1e-7, maxiter=12, M=preconditioner
            )
        if unconverged:
            self._factor = self._system.factor(self._system.normal(precision), smoothing)
            self._solution = self._factor.solve(right)
        return np.asarray(self._solution).reshape(2, -1).T


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
