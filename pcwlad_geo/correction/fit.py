"""Fit corrections to tie points: robust, weighted by the points' covariance, with the fit's own precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.overlap import parameter_covariance
from pcwlad_geo.correction.robust_linear import design, estimate
from pcwlad_geo.errors import InputError

Array = NDArray[np.float64]

REDUNDANCY = 2
"""Points needed beyond those that just determine a model: without them an outlier cannot be told."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A correction, and how well the tie points determine it."""

    correction: Correction
    parameter_covariance: Array
    """(p, p) covariance of the parameters of `jacobian`, px². Shift: (col, row). Affine: the displacement at
    the points' centre (col, row), then what it gains over one RMS radius of the points along col (col, row)
    and along row (col, row). Overlapping windows are allowed for."""
    jacobian: Callable[[Array], Array]
    """Maps (n, 2) predicted px to the (n, 2, p) derivative of the observed px by the parameters."""
    inlier: NDArray[np.bool_]
    """(n,) False where the point has no weight."""
    variance_floor_px2: float
    """Variance per axis of real displacements about the model, beyond the points' own covariance, px²."""
    effective_points: float
    """Number of independent points that would determine the correction as well as these points do."""


class FitFunction(Protocol):
    """How every model is fitted."""

    def __call__(
        self, predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
    ) -> Fit:
        """Fit the model."""


def fit_shift(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> Fit:
    """Fit a shift: observed = predicted + constant.

    Parameters
    ----------
    predicted_px : (n, 2) array of float
        Target position (col, row) that the original georeferencing predicts, px; n ≥ 3.
    observed_px : (n, 2) array of float
        Observed target position (col, row), px.
    covariance_px2 : (n, 2, 2) array of float
        Covariance of the observed position, px². Where the points scatter more than it says, a variance
        common to all points is added, so that points with tiny covariances do not decide alone.
    footprint_px : float
        Side of the matching window, px: points whose windows overlap share errors. 0: independent errors.

    Raises
    ------
    InputError
        If there are too few points, or an array has a wrong shape or values that are not finite.
    """
    return _fit("shift", 1, predicted_px, observed_px, covariance_px2, footprint_px)


def fit_affine(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> Fit:
    """Fit an affine transformation: observed = matrix · (predicted col, predicted row, 1).

    Parameters
    ----------
    predicted_px, observed_px, covariance_px2, footprint_px
        As for `fit_shift`; n ≥ 5, not on one line.

    Raises
    ------
    InputError
        If there are too few points, the points lie on one line, or an array has a wrong shape or values
        that are not finite.
    """
    return _fit("affine", 3, predicted_px, observed_px, covariance_px2, footprint_px)


FITS: Mapping[str, FitFunction] = MappingProxyType({"shift": fit_shift, "affine": fit_affine})
"""Every model, the simplest first."""


def predicted_sigma(fit: Fit, at_px: Array) -> Array:
    """Return the standard deviation of the correction itself at (n, 2) predicted px: (n, 2) (col, row), px.

    It says how well the model is determined, not how far a single pixel may be off it: real displacements
    about the model add `fit.variance_floor_px2`.
    """
    jacobian = fit.jacobian(np.asarray(at_px, dtype=np.float64))
    variance = np.einsum("iap,pq,iaq->ia", jacobian, fit.parameter_covariance, jacobian)
    return np.asarray(np.sqrt(variance))


def _fit(
    name: str, terms: int, predicted_px: Array, observed_px: Array, covariance_px2: Array, footprint_px: float
) -> Fit:
    predicted, observed, covariance = _checked(
        name, terms + REDUNDANCY, predicted_px, observed_px, covariance_px2
    )
    centre = predicted.mean(axis=0)
    # Coordinates of order one about the centre: normal equations of raw pixels would lose half the digits.
    radius = float(np.sqrt(((predicted - centre) ** 2).sum(axis=1).mean())) or 1.0
    basis = _basis(predicted, centre, radius, terms)
    found = estimate(basis, observed - predicted, covariance)
    residual = observed - predicted - basis @ found.parameters
    parameter_covariance_px2, effective_points = parameter_covariance(
        design(basis, found.whitener),
        found.weight,
        np.einsum("iab,ib->ia", found.whitener, residual),
        predicted,
        footprint_px,
    )
    matrix = np.zeros((2, 3))
    matrix[:, :2] = np.eye(2)
    matrix[:, : terms - 1] += found.parameters[1:].T / radius
    matrix[:, 2] = found.parameters[0] - (matrix[:, :2] - np.eye(2)) @ centre
    return Fit(
        correction=AffineCorrection(name, matrix),
        parameter_covariance=parameter_covariance_px2,
        jacobian=partial(_jacobian, centre_px=centre, radius_px=radius, terms=terms),
        inlier=found.weight > 0,
        variance_floor_px2=found.variance_floor_px2,
        effective_points=effective_points,
    )


def _basis(at_px: Array, centre_px: Array, radius_px: float, terms: int) -> Array:
    """Return the (n, terms) basis functions: 1, and for the affine col and row about the centre."""
    return np.column_stack([np.ones(len(at_px)), (at_px - centre_px) / radius_px])[:, :terms]


def _jacobian(at_px: Array, *, centre_px: Array, radius_px: float, terms: int) -> Array:
    identity = np.broadcast_to(np.eye(2), (len(at_px), 2, 2))
    return design(_basis(at_px, centre_px, radius_px, terms), identity)


def _checked(
    name: str, least: int, predicted_px: Array, observed_px: Array, covariance_px2: Array
) -> tuple[Array, Array, Array]:
    arrays = tuple(np.asarray(a, dtype=np.float64) for a in (predicted_px, observed_px, covariance_px2))
    n = len(arrays[0])
    shapes = tuple(a.shape for a in arrays)
    if shapes != ((n, 2), (n, 2), (n, 2, 2)):
        raise InputError(f"tie points of shapes {shapes}: give (n, 2), (n, 2) and (n, 2, 2) arrays")
    if n < least:
        raise InputError(
            f"{n} tie point{'' if n == 1 else 's'} for the {name} model, which needs at least {least}; "
            "use a simpler model, or more tie points"
        )
    if not all(np.isfinite(a).all() for a in arrays):
        raise InputError(f"some of the {n} tie points are not finite; leave them out")
    return arrays[0], arrays[1], arrays[2]
