"""The smoothing thin-plate spline as a sparse least-squares problem.

A thin-plate spline minimises Σ weight · residual² + λ ∬ f_xx² + 2 f_xy² + f_yy² (Duchon 1977,
doi:10.1007/BFb0086566). Here f is a bicubic spline on a regular grid, so that the equations are sparse and
neither fit nor evaluation grows with the square of the number of points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg, splu

from pcwlad_geo.correction.spline import SplineGrid, cubic_b_splines

Array = NDArray[np.float64]
Sparse: TypeAlias = scipy.sparse.csc_array

MOST_CELLS = 40
"""Cells along the longer side: wavelengths down to an eighth of it."""
CELL_PER_WINDOW = 0.75
"""A displacement averaged over a window has no detail that smaller cells would hold."""
BATCH = 4
"""Right-hand sides solved at once: with more, BLAS threads wait for each other longer than they work."""
MOST_STEPS = 12
"""Of conjugate gradients, before a new factor is made."""
REST = 1e-7
"""Share of the right side that they may leave."""


def grid_of(xy_px: Array, footprint_px: float) -> SplineGrid:
    """Return the grid on the box of (n, 2) points (col, row): at most about one cell a point."""
    low, extent = xy_px.min(axis=0), np.maximum(np.ptp(xy_px, axis=0), 1e-6)
    finest = float(np.sqrt(np.prod(extent) / len(xy_px)))
    spacing = max(float(extent.max()) / MOST_CELLS, CELL_PER_WINDOW * footprint_px, finest)
    cells = np.maximum(np.ceil(extent / spacing * (1 - 1e-9)), 1).astype(int)
    # The box sits in the middle of the grid.
    origin = low - (cells * spacing - extent) / 2
    return SplineGrid((float(origin[0]), float(origin[1])), spacing, (int(cells[0]), int(cells[1])))


def bending(grid: SplineGrid) -> Sparse:
    """Return the (k, k) matrix of the bending energy over the grid, its cells of side 1."""
    along_cols, along_rows = ([_gram(cells, k) for k in range(3)] for cells in grid.cells)
    energy = (
        scipy.sparse.kron(along_rows[0], along_cols[2])
        + 2 * scipy.sparse.kron(along_rows[1], along_cols[1])
        + scipy.sparse.kron(along_rows[2], along_cols[0])
    )
    return scipy.sparse.csc_array(energy)


def _gram(cells: int, derivative: int) -> Sparse:
    """Return the integrals of products of two B-splines' derivatives."""
    node, weight = np.polynomial.legendre.leggauss(4)  # exact to degree 7
    values = cubic_b_splines((node + 1) / 2)[derivative]
    cell = (values.T * weight / 2) @ values
    total = np.zeros((cells + 3, cells + 3))
    for first in range(cells):
        total[first : first + 4, first : first + 4] += cell
    return scipy.sparse.csc_array(total)


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """Points on a grid: everything but weights and smoothing."""

    grid: SplineGrid
    design: scipy.sparse.csr_array
    """(n, k) values of the B-splines at the points."""
    energy: Sparse
    """(k, k) bending energy."""
    energy_of_both: Sparse
    """(2 k, 2 k) of col, then row."""

    @classmethod
    def of(cls, xy_px: Array, footprint_px: float) -> Plate:
        """Return the plate under (n, 2) points (col, row)."""
        grid = grid_of(xy_px, footprint_px)
        energy = bending(grid)
        return cls(grid, grid.design(xy_px), energy, scipy.sparse.block_diag([energy, energy], format="csc"))

    def normal(self, precision: Array) -> Sparse:
        """Return the normal equations for precisions of one axis (n,), or of both (n, 2, 2).

        Of both axes: all coefficients of col, then all of row.
        """
        if precision.ndim == 1:
            return scipy.sparse.csc_array(self.design.T @ (self.design * precision[:, None]))
        col, cross, row = (self.normal(precision[:, a, b]) for a, b in ((0, 0), (0, 1), (1, 1)))
        return scipy.sparse.csc_array(scipy.sparse.block_array([[col, cross], [cross, row]]))

    def planes(self, root: Array) -> Array:
        """Return (n, 3) orthonormal vectors that span the planes at the points, times the (n,) root."""
        nodes = self.grid.nodes_px()
        nodes = (nodes - nodes.mean(axis=0)) / self.grid.spacing_px
        planes = self.design @ np.column_stack([np.ones(len(nodes)), nodes])
        return np.asarray(np.linalg.qr(root[:, None] * planes)[0])

    def freedom(self, stiffness: float, probes: Array) -> float:
        """Return the effective number of parameters of an axis, for points of equal precision.

        It is the trace of the smoother. A spline leaves planes as they are: they are 3, and (n, m) random
        signs estimate the rest.
        """
        precision = np.ones(len(probes))
        factor = self.factor(self.normal(precision), self.smoothing(stiffness, precision))
        planes = self.planes(precision)
        bent = probes - planes @ (planes.T @ probes)
        smoothed = self.design @ factor.solve(self.design.T @ bent)
        return 3 + float((bent * smoothed).sum()) / float(probes.shape[1])

    def smoothing(self, stiffness: float, precision: Array) -> float:
        """Return λ for (n,) precisions: the stiffness times the precision of the points of a mean cell."""
        return stiffness * float(precision.sum()) / float(np.prod(self.grid.cells))

    def factor(self, normal: Sparse, smoothing: float) -> Factor:
        """Factorise normal equations with the bending energy, times the smoothing, added."""
        energy = self.energy if normal.shape == self.energy.shape else self.energy_of_both
        return Factor(
            splu(
                scipy.sparse.csc_array(normal + smoothing * energy),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        )


class Factor:
    """A factorised symmetric positive matrix."""

    def __init__(self, factor: object) -> None:
        self._solve = factor.solve  # type: ignore[attr-defined]  # SuperLU has no type

    def solve(self, right: Array) -> Array:
        """Return the solutions for the columns of (k, m) right sides."""
        parts = [
            self._solve(np.ascontiguousarray(right[:, start : start + BATCH]))
            for start in range(0, right.shape[1], BATCH)
        ]
        return np.concatenate(parts, axis=1)

    def solve_one(self, right: Array) -> Array:
        """Return the (k,) solution for one right side."""
        return np.asarray(self.solve(right.reshape(-1, 1))[:, 0])


class Successive:
    """Fits both axes for one set of precisions after another, each near the one before.

    A factor preconditions conjugate gradients for as long as these come to rest within few steps: a step
    costs a thirtieth of a factor.

    Parameters
    ----------
    plate : Plate
    values_px : (n, 2) array
        What the spline is fitted to, (col, row).
    """

    def __init__(self, plate: Plate, values_px: Array) -> None:
        self._plate, self._values_px = plate, values_px
        self._factor: Factor | None = None
        self._found: Array | None = None

    def solve(self, precision: Array, smoothing: float) -> Array:
        """Return the (k, 2) coefficients for (n, 2, 2) precisions."""
        design, energy = self._plate.design, self._plate.energy_of_both

        def pulled(at_points: Array) -> Array:
            weighted = np.einsum("iab,ib->ia", precision, at_points)
            return np.asarray((design.T @ weighted).T.ravel())

        def times(flat: Array) -> Array:
            return np.asarray(pulled(design @ flat.reshape(2, -1).T) + smoothing * (energy @ flat))

        right, rests = pulled(self._values_px), False
        if self._factor is not None:
            before = LinearOperator(energy.shape, matvec=self._factor.solve_one, dtype=np.float64)
            system = LinearOperator(energy.shape, matvec=times, dtype=np.float64)
            self._found, left = cg(system, right, self._found, rtol=REST, maxiter=MOST_STEPS, M=before)
            rests = left == 0
        if not rests:
            self._factor = self._plate.factor(self._plate.normal(precision), smoothing)
            self._found = self._factor.solve_one(right)
        return np.asarray(self._found).reshape(2, -1).T


def mean_precision(whitener: Array, weight: Array) -> Array:
    """Return the (n,) weighted precision of a point, averaged over all directions."""
    return np.asarray(weight * (whitener**2).sum(axis=(1, 2)) / 2)
