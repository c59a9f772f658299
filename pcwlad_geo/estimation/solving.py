"""The one place where equations are solved, and where it shows that observations leave something open.

What a solution `needs` is a sentence that names the observation: an error says it, with what was found. The
routines are those of LAPACK as numpy calls them. What is unknown in the equations (NaN) is so in the result.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

import numpy as np
import scipy.linalg
from scipy.sparse import coo_array, csc_array, diags_array, eye_array, sparray
from scipy.sparse.linalg import SuperLU, splu

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.types import Float64, Index

RANK: Final = 1e-12
"""Singular values below this share of the largest are zero."""
SCALE: Final = "a transformation needs two directions that differ, and a scale above 0"
"""What the inverse of a transformation needs."""
SIZE: Final = "a trend needs points and displacements of ordinary size"
"""What least squares need, which may leave something open."""


def check_observations(name: str, *arrays: Float64) -> None:
    """Raise `InputError` if a number of (...,) `arrays`, in the message called `name`, is beyond measure."""
    if not all(np.abs(values).max(initial=0.0) <= LIMITS.coordinate for values in arrays):  # NaN is not
        raise InputError(f"{name} have numbers not finite or beyond {LIMITS.coordinate:.0e}; leave them out")


def check_rank(matrix: Float64, least: float, needs: str) -> None:
    """Raise `InputError` if a singular value of a (..., n, k) `matrix` is at most `least` of the largest."""
    singular = _checked(lambda values: np.linalg.svd(values, compute_uv=False), needs, matrix)
    largest = singular.max(axis=-1, initial=0.0, keepdims=True)
    rank = np.count_nonzero(singular > least * largest, axis=-1).min()
    if rank < matrix.shape[-1]:
        raise InputError(f"{needs} (what is given determines {rank} of {matrix.shape[-1]} unknowns)")


def solve(matrix: Float64, right: Float64, needs: str = SCALE, least: float = 0.0) -> Float64:
    """Return the (..., n, m) or (n,) x of (..., n, n) `matrix` · x = `right`, which has the shape (n,) of x.

    `check_rank` comes first if `least` is given.
    """
    if least:
        check_rank(matrix, least, needs)
    return _checked(np.linalg.solve, needs, matrix, right)


def inverse(matrix: Float64, needs: str = SCALE) -> Float64:
    """Return the inverse of each (n, n) of a (..., n, n) `matrix`."""
    return _checked(np.linalg.inv, needs, matrix)


def triangular(matrix: Float64, needs: str) -> Float64:
    """Return the lower triangular root (Cholesky) of a positive (..., n, n) `matrix`."""
    return _checked(np.linalg.cholesky, needs, matrix)


def pseudo_inverse(matrix: Float64, least: float = 1e-15, *, hermitian: bool = False) -> Float64:
    """Return the pseudo-inverse of a (..., n, k) `matrix`, 0 for singular values below a share `least`."""
    return _checked(lambda values: np.linalg.pinv(values, rcond=least, hermitian=hermitian), SIZE, matrix)


def least_squares(design: Float64, values: Float64, least: float | None = None) -> Float64:
    """Return the (k, m) x of the least squares of (n, k) `design` · x = (n, m) `values`.

    It is 0 for singular values below a share `least` of the largest, by default that of rounding.
    """
    return _checked(lambda one, other: np.linalg.lstsq(one, other, rcond=least)[0], SIZE, design, values)


def factorised(matrix: csc_array, needs: str) -> SuperLU:
    """Return the LU factors of a sparse matrix."""
    try:
        return splu(matrix)
    except RuntimeError as error:
        raise InputError(f"{needs} (what is given is singular)") from error


def banded(matrix: sparray, order: Index) -> Float64:
    """Return the (b, k) diagonals, from the main one downwards, of a symmetric sparse (k, k) `matrix`.

    The (k,) `order` is the place of each unknown in the band.
    """
    entries = matrix.tocoo()
    row, col = order[entries.row], order[entries.col]
    below = row - col
    band = np.zeros((int(below.max()) + 1, matrix.shape[0]))
    lower = below >= 0
    band[below[lower], col[lower]] = entries.data[lower]
    return band


class BandedFactor:
    """The Cholesky factor of a symmetric positive sparse matrix whose entries lie near its diagonal.

    Where the band is narrow, as of unknowns on a lattice in the order of its rows, dense rows of it are
    factorised several times as fast as sparse ones.

    Parameters
    ----------
    band : (b, k) array
        Its diagonals, see `banded`.
    order : (k,) array of int
        Place of each unknown in the band.
    needs : str
        The sentence of the error if the matrix is singular.
    """

    def __init__(self, band: Float64, order: Index, needs: str) -> None:
        self._order = order
        try:
            self._factor = scipy.linalg.cholesky_banded(band, True, lower=True)
        except (ValueError, np.linalg.LinAlgError) as error:
            raise InputError(f"{needs} (what is given is singular, or beyond measure)") from error

    def solve(self, right: Float64) -> Float64:
        """Return the (k, m) or (k,) solutions for right sides `right` of that shape."""
        ordered = np.empty_like(right)
        ordered[self._order] = right
        solution = scipy.linalg.cho_solve_banded((self._factor, True), ordered, True, check_finite=False)
        return np.asarray(solution[self._order], np.float64)


class NormalEquations:
    """The normal equations of weighted least squares, summed up from observations of a few unknowns each."""

    def __init__(self, unknowns: int) -> None:
        self.right = np.zeros(unknowns)
        self._sums: list[tuple[Float64, Index, Index]] = []  # values, rows, columns

    def add(self, places: Index, normal: Float64, right: Float64 | float = 0.0) -> None:
        """Add (..., q, q) `normal` matrices and (..., q) `right` sides of unknowns at (..., q) `places`."""
        rows, columns = (np.broadcast_to(np.expand_dims(places, k), normal.shape) for k in (-1, -2))
        self._sums.append((normal.ravel(), rows.ravel(), columns.ravel()))
        np.add.at(self.right, places, right)

    def observe(self, places: Index, design: Float64, weight: Float64, values: Float64) -> None:
        """Add (n, a) `values` of an (n, a, q) `design` for (q,) `places`, by their (n, a, a) `weight`."""
        weighted = weight @ design
        normal = np.einsum("nap,naq->pq", design, weighted)
        self.add(places, normal, np.einsum("nap,na->p", weighted, values))

    def observe_rows(self, design: sparray, weight: Float64, values: Float64) -> None:
        """Add (n,) `values` of an (n, unknowns) sparse `design`, by their (n,) `weight`."""
        weighted = design.T @ diags_array(weight)
        normal = (weighted @ design).tocoo()
        self._sums.append((normal.data, normal.row, normal.col))
        self.right += weighted @ values

    def expect(self, places: Index, sigma: float, values: Float64 | float = 0.0) -> None:
        """Add what is known beforehand of the unknowns at (q,) `places`: (q,) `values`, with a sigma."""
        self.add(places[:, None], np.full((len(places), 1, 1), sigma**-2))
        self.right[places] += values * sigma**-2

    @property
    def matrix(self) -> csc_array:
        """(unknowns, unknowns) normal matrix."""
        data, rows, columns = (np.concatenate(parts) for parts in zip(*self._sums, strict=True))
        return coo_array((data, (rows, columns)), shape=(len(self.right),) * 2).tocsc()

    def solve(self, needs: str) -> Float64:
        """Return the (unknowns,) solution."""
        return np.asarray(factorised(self.matrix, needs).solve(self.right))

    def covariance(self, needs: str) -> Float64:
        """Return the (unknowns, unknowns) covariance of the solution."""
        return np.asarray(factorised(self.matrix, needs).solve(np.eye(len(self.right))))

    def reduced(self, count: int) -> tuple[Float64, Float64]:
        """Return the (count, count) matrix and (count,) right side of the first unknowns, without others.

        No observation is of two of these.
        """
        whole = self.matrix
        gain = whole[:count, count:] @ diags_array(1 / whole.diagonal()[count:])
        normal = (whole[:count, :count] - gain @ whole[count:, :count]).toarray()
        return normal, self.right[:count] - gain @ self.right[count:]


def components(ends: Index, count: int) -> Index:
    """Return the (count,) numbers of the groups of so many places that (n, 2) `ends` of links connect."""
    from scipy.sparse.csgraph import connected_components  # slow to load

    links = coo_array((np.ones(len(ends)), ends.T), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], np.intp)


def undetermined(normal: csc_array, factor: SuperLU | None = None) -> int | None:
    """Return the number of the unknown that a normal matrix, its `factor` if it has one, determines least.

    None if it determines all. The smallest eigenvalue of the matrix scaled to a diagonal of ones is found by
    inverse iteration.
    """
    scale = np.sqrt(np.abs(normal.diagonal()))
    if not scale.all():
        return int(scale.argmin())
    ridge = RANK * scale.max() ** 2 * eye_array(len(scale))
    factor = factor or factorised(csc_array(normal + ridge), "tie points need a sigma above 0")
    vector = np.cos(np.arange(len(scale)))  # any vector that no structure of the matrix shares
    for _ in range(4):  # a singular matrix shows after one or two
        vector = vector / np.linalg.norm(vector)
        vector = scale * factor.solve(scale * vector)
    return None if np.linalg.norm(vector) < 1 / RANK else int(np.nan_to_num(np.abs(vector)).argmax())


def _checked(routine: Callable[..., Any], needs: str, *arrays: Float64) -> Float64:
    """Return what a routine makes of arrays, if it is finite, or they hold what is unknown."""
    with suppress(np.linalg.LinAlgError):
        result = np.asarray(routine(*arrays), np.float64)
        if np.isfinite(result).all() or any(np.isnan(values).any() for values in arrays):
            return result
    raise InputError(f"{needs} (what is given is singular, or beyond measure)")
