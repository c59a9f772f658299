"""Fit corrections to tie points: robust, weighted by the points' covariance, with the fit's own precision."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.fitted import Fit, FitFunction, ParametricFit, checked, predicted_sigma
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.polynomial import PolynomialBasis, PolynomialCorrection
from pcwlad_geo.correction.projective_fit import fit_projective
from pcwlad_geo.correction.robust_linear import (
    COARSE_STEPS,
    Estimate,
    Solution,
    design,
    estimate,
    reweighted,
    weighted_least_squares,
)
from pcwlad_geo.correction.thin_plate import fit_tps

__all__ = [
    "FITS",
    "Fit",
    "FitFunction",
    "fit_affine",
    "fit_drift",
    "fit_polynomial2",
    "fit_polynomial3",
    "fit_projective",
    "fit_shift",
    "fit_tps",
    "predicted_sigma",
]

Array = NDArray[np.float64]

REDUNDANCY = 2
"""Points needed beyond those that just determine a model: without them an outlier cannot be told."""


def fit_shift(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> ParametricFit:
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
    return _fit("shift", 0, predicted_px, observed_px, covariance_px2, footprint_px)


def fit_drift(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> ParametricFit:
    """Fit a shift that drifts from line to line: observed = predicted + constant + slope · row.

    What a drifting attitude does to a pushbroom image (Fraser & Hanley 2005, doi:10.14358/PERS.71.8.909).
    Parameters, result and errors are those of `fit_shift`; at least four points.
    """
    return _fit("drift", 1, predicted_px, observed_px, covariance_px2, footprint_px, columns=(0, 2))


def fit_affine(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> ParametricFit:
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
    return _fit("affine", 1, predicted_px, observed_px, covariance_px2, footprint_px)


def fit_polynomial2(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> ParametricFit:
    """Fit a polynomial of order 2, continued linearly beyond the box of the points.

    Parameters
    ----------
    predicted_px, observed_px, covariance_px2, footprint_px
        As for `fit_shift`; n ≥ 8, spread in both directions.

    Raises
    ------
    InputError
        If the points are too few or do not determine the polynomial, or an array has a wrong shape or
        values that are not finite.
    """
    return _fit("polynomial2", 2, predicted_px, observed_px, covariance_px2, footprint_px)


def fit_polynomial3(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> ParametricFit:
    """Fit a polynomial of order 3: as `fit_polynomial2`, n ≥ 12."""
    return _fit("polynomial3", 3, predicted_px, observed_px, covariance_px2, footprint_px)


FITS: Mapping[str, FitFunction] = MappingProxyType(
    {
        "shift": fit_shift,
        "drift": fit_drift,
        "affine": fit_affine,
        "projective": fit_projective,
        "polynomial2": fit_polynomial2,
        "polynomial3": fit_polynomial3,
        "tps": fit_tps,
    }
)
"""Every model, the simplest first."""
CANDIDATES = tuple(name for name in FITS if name != "drift")
"""Models of any image; lines that drift are those of a sensor's geometry."""


def _fit(
    name: str,
    order: int,
    predicted_px: Array,
    observed_px: Array,
    covariance_px2: Array,
    footprint_px: float,
    columns: tuple[int, ...] | None = None,
) -> ParametricFit:
    """Fit the polynomial of an order, or some of its terms."""
    columns = columns or tuple(range((order + 1) * (order + 2) // 2))
    predicted, observed, covariance = checked(
        name, len(columns) + REDUNDANCY, predicted_px, observed_px, covariance_px2
    )
    basis = _basis(order, predicted)
    values, displacement = basis.values(predicted)[:, columns], observed - predicted
    found = estimate(values[:, :3], displacement, covariance)
    if order > 1:
        found = _refined(values, displacement, covariance, found)
    return ParametricFit.of(
        correction=_correction(name, basis, found.parameters, columns),
        jacobian=partial(_jacobian, basis=basis, columns=columns),
        predicted_px=predicted,
        observed_px=observed,
        estimate=found,
        footprint_px=footprint_px,
    )


def _basis(order: int, predicted_px: Array) -> PolynomialBasis:
    """Return terms of order one about the points' centre: raw pixels would lose half the digits."""
    centre = predicted_px.mean(axis=0)
    radius = float(np.sqrt(((predicted_px - centre) ** 2).sum(axis=1).mean())) or 1.0
    low, high = predicted_px.min(axis=0), predicted_px.max(axis=0)
    corners = [(float(corner[0]), float(corner[1])) for corner in (centre, low, high)]
    return PolynomialBasis(order, corners[0], radius, corners[1], corners[2])


def _refined(values: Array, displacement_px: Array, covariance_px2: Array, start: Estimate) -> Estimate:
    """Fit all terms, from the affine: samples of ten points hardly ever are free of outliers."""

    def solve(whitener: Array, weight: Array) -> Solution:
        parameters = weighted_least_squares(values, displacement_px, whitener, weight)
        return Solution(parameters, values @ parameters, values.shape[1])

    return reweighted(solve, start.fitted_px, displacement_px, covariance_px2, coarse_steps=COARSE_STEPS)


def _correction(
    name: str, basis: PolynomialBasis, parameters_px: Array, columns: tuple[int, ...]
) -> Correction:
    if basis.order > 1:
        return PolynomialCorrection(basis, parameters_px)
    terms = np.zeros((3, 2))
    terms[list(columns)] = parameters_px
    matrix = np.zeros((2, 3))
    matrix[:, :2] = terms[1:].T / basis.radius_px
    matrix[:, 2] = terms[0] - matrix[:, :2] @ basis.centre_px
    matrix[:, :2] += np.eye(2)
    return AffineCorrection(name, matrix)


def _jacobian(at_px: Array, *, basis: PolynomialBasis, columns: tuple[int, ...]) -> Array:
    return design(basis.values(at_px)[:, columns], np.broadcast_to(np.eye(2), (len(at_px), 2, 2)))
