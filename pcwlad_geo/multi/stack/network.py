"""The normal equations of all images of a stack, and their solution."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import MEASURED, reliability
from pcwlad_geo.estimation.solving import NormalEquations, factorised, solve, undetermined
from pcwlad_geo.multi.stack.equations import EdgeEquations, ends_of
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT, AdjustmentParameters
from pcwlad_geo.types import Bool, Float64, Index


class UndeterminedImageError(InputError):
    """The tie points of an image, which has a number or a name, leave its correction open."""

    def __str__(self) -> str:
        return (
            f"the points of image {self.args[0]} do not determine its correction, as they are few or lie on "
            "a line: give more, or a simpler --model"
        )


@contextmanager
def named(images: Sequence[int | str]) -> Iterator[None]:
    """Give the image of an `UndeterminedImageError` its number or its name among `images`."""
    try:
        yield
    except UndeterminedImageError as error:
        error.args = (images[error.args[0]],)
        raise


@dataclass(frozen=True, slots=True)
class EdgeFit:
    """How a pair agrees with all others."""

    in_use: bool
    """False for a pair that contradicts the others."""
    offset: tuple[float, float]
    """By how much its points lie off the adjustment on average (x, y), map units."""
    sigma: float
    """Standard deviation of that offset along an axis, if the pair is right, map units."""
    redundancy: float
    """Share of the offset that the other pairs check, 0 to 1: nothing tells whether one of 0 is wrong."""
    scatter: float
    """Robust standard deviation of its points along an axis, map units."""
    shared: float
    """Standard deviation of the error that all its points share, along an axis, map units."""

    @property
    def ratio(self) -> float:
        """The offset in standard deviations."""
        return float(np.hypot(*self.offset)) / self.sigma


def factor_of(normal: csc_array, images: int, fixed: Sequence[int], *, check: bool = False) -> SuperLU:
    """Return the factors of the normal matrix of all `images` but the `fixed`, which must be determined.

    With `check` by more than rounding; raises `UndeterminedImageError`.
    """
    factor = None
    with suppress(InputError):
        factor = factorised(normal, MEASURED)
    unknown = undetermined(normal, factor) if check or factor is None else None
    if factor is None or unknown is not None:
        free = np.delete(np.arange(images), fixed)
        raise UndeterminedImageError(int(free[(unknown or 0) * len(free) // normal.shape[0]]))
    return factor


@dataclass(frozen=True, slots=True, eq=False)
class NetworkSolution:
    """A solution of the normal equations."""

    coefficients: Float64
    """(images, terms, 2)."""
    fits: tuple[EdgeFit, ...]
    normal: csc_array


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The unknowns: image by image, then axis, then term."""

    images: int
    terms: int
    fixed: tuple[int, ...]
    """Numbers of the images whose coefficients are no unknowns."""
    penalty: Float64
    """(terms, terms) normal matrix of what is known of an image's coefficients beforehand, axis by axis."""
    mixing: Float64 | None = None
    """(2 terms, p) coefficients of an image by its p unknowns, axis by axis; None: they are the unknowns."""
    prior: Float64 | None = None
    """(images, terms, terms) normal matrices of what is known of each beforehand, axis by axis, besides."""
    parameters: AdjustmentParameters = ADJUSTMENT

    @property
    def size(self) -> int:
        """Number of unknowns of an image."""
        return 2 * self.terms if self.mixing is None else self.mixing.shape[1]

    @property
    def free(self) -> Index:
        """The (free,) numbers of the unknowns of images that are not fixed."""
        size = self.size
        every = np.arange(self.images * size).reshape(self.images, size)
        return np.delete(every, self.fixed, axis=0).ravel()

    def solve(self, parts: Sequence[EdgeEquations], in_use: Bool, shared: Float64) -> NetworkSolution:
        """Solve the normal equations of the edges in use, each with a sigma of its shared error.

        The (edges,) bool array `in_use` says which count, and the (edges,) array `shared` the standard
        deviation of the shared error of each, map units.
        """
        normal, right = self.equations(parts, in_use, shared)
        factor = factor_of(normal, self.images, self.fixed)
        coefficients = self.unpacked(factor.solve(right))
        largest = max(float(np.abs(part.observed).max()) for part in parts)
        size = np.abs(coefficients).max(axis=(1, 2))
        if not size.max(initial=0.0) < self.parameters.max_growth * (1.0 + largest):
            raise UndeterminedImageError(int(size.argmax()))
        fits = tuple(
            self._fit(part, coefficients, bool(good), float(sigma), factor)
            for part, good, sigma in zip(parts, in_use, shared, strict=True)
        )
        return NetworkSolution(coefficients, fits, normal)

    def equations(
        self, parts: Sequence[EdgeEquations], in_use: Bool, shared: Float64
    ) -> tuple[csc_array, Float64]:
        """Return the (free, free) normal matrix of the coefficients, and the (free,) right-hand side.

        The (edges,) arrays `in_use` and `shared` are those of `solve`.
        """
        size = self.size
        selection = [part for part, good in zip(parts, in_use, strict=True) if good]
        normal, across, inner, rhs, shared_rhs = (
            np.array([getattr(part, name) for part in selection])
            for name in ("normal", "across", "inner", "rhs", "shared_rhs")
        )
        inner = inner + np.eye(inner.shape[1]) / (shared[in_use] ** 2)[:, None, None]
        gain = solve(inner, across.transpose(0, 2, 1), MEASURED).transpose(0, 2, 1)
        block = normal - gain @ across.transpose(0, 2, 1)
        rhs = rhs - (gain @ shared_rhs[:, :, None])[:, :, 0]
        if self.mixing is not None:
            block, rhs = self.mixing.T @ block @ self.mixing, rhs @ self.mixing
        equations = NormalEquations(self.images * size)
        places = np.arange(self.images * size).reshape(self.images, size)
        equations.add(
            places[ends_of(selection)].reshape(len(selection), -1),
            np.kron([[1.0, -1.0], [-1.0, 1.0]], block),
            np.hstack([-rhs, rhs]),
        )
        for information in (self.penalty[None], self.prior):
            if information is not None and information.any():  # of each image, axis by axis
                both_axes = np.kron(np.eye(2), information)
                equations.add(places, np.broadcast_to(both_axes, (self.images, size, size)))
        free = self.free
        return csc_array(equations.matrix[free][:, free]), equations.right[free]

    def coefficients(self, parts: Sequence[EdgeEquations], in_use: Bool, shared: Float64) -> Float64:
        """Return the (images, terms, 2) coefficients alone; (edges,) `in_use` and `shared` as in `solve`."""
        normal, right = self.equations(parts, in_use, shared)
        return self.unpacked(factor_of(normal, self.images, self.fixed).solve(right))

    def unpacked(self, free: Float64) -> Float64:
        """Return the (images, terms, 2) coefficients of the (free,) `free`; zeros of images that stay."""
        unknowns = np.zeros(self.images * self.size)
        unknowns[self.free] = free
        if self.mixing is not None:
            unknowns = (unknowns.reshape(self.images, -1) @ self.mixing.T).ravel()
        return unknowns.reshape(self.images, 2, self.terms).transpose(0, 2, 1)

    def _fit(
        self, part: EdgeEquations, coefficients: Float64, in_use: bool, shared: float, factor: SuperLU
    ) -> EdgeFit:
        """Return how an edge agrees with a solution, in which one not in use had no part."""
        offset = part.observed - part.values @ (coefficients[part.second] - coefficients[part.first])
        row = np.zeros((self.images, 2, self.terms))  # of x; the other axis is as well known
        row[part.second, 0], row[part.first, 0] = part.values, -part.values
        of_image = row.reshape(self.images, -1)
        free = (of_image if self.mixing is None else of_image @ self.mixing).ravel()[self.free]
        adjusted = float(free @ factor.solve(free))
        # an edge that nothing checks agrees with itself
        sigma, redundancy = reliability(
            shared**2 + part.formal, adjusted, in_use, self.parameters.min_sigma_redundancy
        )
        return EdgeFit(in_use, (float(offset[0]), float(offset[1])), sigma, redundancy, part.scatter, shared)
