"""Fit a projective transformation: robust Gauss-Newton from the affine."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.fitted import ParametricFit, checked
from pcwlad_geo.correction.models import ProjectiveCorrection
from pcwlad_geo.correction.robust_linear import COARSE_STEPS, COLLINEAR, Solution, estimate, reweighted
from pcwlad_geo.errors import InputError

Array = NDArray[np.float64]

LEAST_POINTS = 6
STEPS = 30
STEP_TOLERANCE_PX = 1e-6
"""The next step would be its square, relative to the radius of the points."""


def fit_projective(
    predicted_px: Array, observed_px: Array, covariance_px2: Array, *, footprint_px: float = 0.0
) -> ParametricFit:
    """Fit a projective transformation: of a plane seen from elsewhere.

    Parameters
    ----------
    predicted_px, observed_px, covariance_px2, footprint_px
        As for `fit_shift`; n ≥ 6, spread in both directions.

    Raises
    ------
    InputError
        If the points are too few or do not determine the transformation, or an array has a wrong shape or
        values that are not finite.
    """
    predicted, observed, covariance = checked(
        "projective", LEAST_POINTS, predicted_px, observed_px, covariance_px2
    )
    centre = predicted.mean(axis=0)
    radius = float(np.sqrt(((predicted - centre) ** 2).sum(axis=1).mean())) or 1.0
    place = (predicted - centre) / radius
    affine = estimate(np.column_stack([np.ones(len(place)), place]), observed - predicted, covariance)
    start = np.zeros(8)
    start[:6] = (affine.parameters + radius * np.eye(3, 2, -1)).ravel()

    def solve(whitener: Array, weight: Array) -> Solution:
        root = np.sqrt(weight)[:, None, None] * whitener
        parameters = _gauss_newton(start, place, observed - centre, root, radius)
        fitted = _moved(parameters, place, radius) + centre - predicted
        return Solution(parameters, fitted, 4.0)

    found = reweighted(solve, affine.fitted_px, observed - predicted, covariance, coarse_steps=COARSE_STEPS)
    matrix = _matrix(found.parameters, centre, radius)
    return ParametricFit.of(
        correction=ProjectiveCorrection("projective", matrix),
        jacobian=partial(_jacobian_px, parameters=found.parameters, centre_px=centre, radius_px=radius),
        predicted_px=predicted,
        observed_px=observed,
        estimate=found,
        footprint_px=footprint_px,
    )


def _gauss_newton(start: Array, place: Array, moved_px: Array, root: Array, radius_px: float) -> Array:
    """Return the parameters of least squares: six of the affine numerator, two of the horizon, px."""
    parameters = start
    for _ in range(STEPS):
        rows = (root @ _jacobian(parameters, place, radius_px)).reshape(-1, 8)
        values = np.einsum("iab,ib->ia", root, moved_px - _moved(parameters, place, radius_px)).ravel()
        if not (np.isfinite(rows).all() and np.isfinite(values).all()):
            raise InputError(
                "no projective transformation fits the tie points: its horizon would lie among them; use "
                "another model"
            )
        normal = rows.T @ rows
        eigenvalues = np.linalg.eigvalsh(normal)
        if eigenvalues[0] < COLLINEAR**2 * eigenvalues[-1]:
            raise InputError(
                f"the {np.count_nonzero(root.any(axis=(1, 2)))} consistent tie points lie too nearly on a "
                "line to determine the projective model; use a simpler model, or more tie points"
            )
        step = np.linalg.solve(normal, rows.T @ values)
        parameters = parameters + step
        if np.abs(step).max() < STEP_TOLERANCE_PX:
            break
    return np.asarray(parameters)


def _moved(parameters: Array, place: Array, radius_px: float) -> Array:
    """Return the (n, 2) observed px about the centre; NaN beyond the horizon."""
    numerator = parameters[:2] + place @ parameters[2:6].reshape(2, 2)
    return np.asarray(numerator / _denominator(parameters, place, radius_px)[:, None])


def _denominator(parameters: Array, place: Array, radius_px: float) -> Array:
    w = 1 + place @ parameters[6:] / radius_px
    return np.where(w > 0, w, np.nan)


def _jacobian(parameters: Array, place: Array, radius_px: float) -> Array:
    """Return the (n, 2, 8) derivatives of the observed px by the parameters."""
    n = len(place)
    terms = np.column_stack([np.ones(n), place])
    numerator = np.einsum("it,ab->iatb", terms, np.eye(2)).reshape(n, 2, 6)
    horizon = -_moved(parameters, place, radius_px)[:, :, None] * place[:, None, :] / radius_px
    both = np.concatenate([numerator, horizon], axis=2)
    return np.asarray(both / _denominator(parameters, place, radius_px)[:, None, None])


def _jacobian_px(at_px: Array, *, parameters: Array, centre_px: Array, radius_px: float) -> Array:
    return _jacobian(parameters, (at_px - centre_px) / radius_px, radius_px)


def _matrix(parameters: Array, centre_px: Array, radius_px: float) -> Array:
    """Return the (3, 3) matrix between pixels."""
    normalised = np.array([[1, 0, -centre_px[0]], [0, 1, -centre_px[1]], [0, 0, radius_px]]) / radius_px
    moved = np.vstack([parameters[:6].reshape(3, 2)[[1, 2, 0]].T, [*parameters[6:] / radius_px, 1]])
    back = np.array([[1, 0, centre_px[0]], [0, 1, centre_px[1]], [0, 0, 1]])
    return np.asarray(back @ moved @ normalised)
