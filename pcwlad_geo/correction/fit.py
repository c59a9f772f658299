"""Robust fits of the correction models, from the shift to the polynomials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np

from pcwlad_geo.correction.fitted import (
    FIT,
    FitFunction,
    FitParameters,
    ParametricFit,
    Trend,
    centre_and_radius,
    checked,
    gauss_newton,
)
from pcwlad_geo.correction.jitter import fit_jitter
from pcwlad_geo.correction.models import AffineCorrection, Correction, ProjectiveCorrection
from pcwlad_geo.correction.polynomials import PolynomialBasis, PolynomialCorrection
from pcwlad_geo.correction.similarity_fit import fit_similarity
from pcwlad_geo.correction.spline_fit import fit_field, fit_tps
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import (
    ROBUST,
    Solution,
    design,
    estimate,
    linear,
    reweighted,
)
from pcwlad_geo.estimation.transforms import ShiftTransform
from pcwlad_geo.types import Float64


def fit_projective(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    trend: Trend | None = None,
    parameters: FitParameters = FIT,
) -> ParametricFit:
    """Fit a projective transformation, that of a plane seen from another viewpoint.

    Raises `InputError` if the points are too few or do not determine the transformation, or an array has a
    wrong shape or values that are not finite. The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2)
    `covariance_px2` are those of `fit_polynomial`, as are `footprint_px` and `trend`; n ≥ 6, spread in both
    directions.
    """
    predicted, observed, covariance = checked(
        "projective", 4 + parameters.redundancy, predicted_px, observed_px, covariance_px2
    )
    trend = trend or Trend.of(predicted, observed, covariance)
    centre, radius, affine = trend.centre_px, trend.radius_px, trend.estimate
    place = (predicted - centre) / radius
    start = np.zeros(8)
    start[:6] = (affine.parameters + radius * np.eye(3, 2, -1)).ravel()

    def jacobian(values: Float64) -> Float64:
        derivatives = _projective_jacobian(values, place, radius)
        if not np.isfinite(derivatives).all():
            raise InputError(
                "no projective transformation fits the tie points: its horizon would lie among them; use "
                "another model"
            )
        return derivatives

    needs = (
        "{} consistent tie points lie too nearly on a line to determine the projective model; use a simpler "
        "model, or more tie points"
    )
    solved = partial(gauss_newton, start, partial(_image, place=place, radius_px=radius), jacobian, needs)

    def fitted(whitener: Float64, weight: Float64) -> Solution:
        values = solved(observed - centre, np.sqrt(weight)[:, None, None] * whitener, parameters)
        return Solution(values, _image(values, place, radius) + centre - predicted, 4.0)

    estimated = reweighted(
        fitted,
        affine.fitted_px,
        observed - predicted,
        covariance,
        coarse_steps=ROBUST.coarse_steps,
    )
    matrix = _matrix(estimated.parameters, centre, radius)
    return ParametricFit.of(
        correction=ProjectiveCorrection("projective", matrix),
        jacobian=partial(_jacobian_px, values=estimated.parameters, centre_px=centre, radius_px=radius),
        predicted_px=predicted,
        observed_px=observed,
        estimate=estimated,
        footprint_px=footprint_px,
    )


def _image(values: Float64, place: Float64, radius_px: float) -> Float64:
    """Return the (n, 2) observed px about the centre; NaN beyond the horizon."""
    numerator = values[:2] + place @ values[2:6].reshape(2, 2)
    return numerator / _denominator(values, place, radius_px)[:, None]


def _denominator(values: Float64, place: Float64, radius_px: float) -> Float64:
    w = 1 + place @ values[6:] / radius_px
    return np.where(w > 0, w, np.nan)


def _projective_jacobian(values: Float64, place: Float64, radius_px: float) -> Float64:
    """Return the (n, 2, 8) derivatives of the observed px by the values."""
    n = len(place)
    terms = np.column_stack([np.ones(n), place])
    numerator = np.einsum("it,ab->iatb", terms, np.eye(2)).reshape(n, 2, 6)
    horizon = -_image(values, place, radius_px)[:, :, None] * place[:, None, :] / radius_px
    both = np.concatenate([numerator, horizon], axis=2)
    return both / _denominator(values, place, radius_px)[:, None, None]


def _jacobian_px(at_px: Float64, *, values: Float64, centre_px: Float64, radius_px: float) -> Float64:
    return _projective_jacobian(values, (at_px - centre_px) / radius_px, radius_px)


def _matrix(values: Float64, centre_px: Float64, radius_px: float) -> Float64:
    """Return the (3, 3) matrix between pixels."""
    normalised = np.array([[1, 0, -centre_px[0]], [0, 1, -centre_px[1]], [0, 0, radius_px]]) / radius_px
    projective = np.vstack([values[:6].reshape(3, 2)[[1, 2, 0]].T, [*values[6:] / radius_px, 1]])
    return np.asarray(ShiftTransform.by(centre_px).matrix @ projective @ normalised)


def fit_polynomial(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    name: str,
    order: int,
    columns: tuple[int, ...] | None = None,
    trend: Trend | None = None,
    parameters: FitParameters = FIT,
) -> ParametricFit:
    """Fit the polynomial of an order: observed = predicted + Σ coefficient · term.

    Raises `InputError` if the points are too few or do not determine the polynomial, or an array has a wrong
    shape or values that are not finite.

    Parameters
    ----------
    predicted_px : (n, 2) array of float
        Target position (col, row) that the original georeferencing predicts, px; at least two points more
        than there are terms.
    observed_px : (n, 2) array of float
        Observed target position (col, row), px.
    covariance_px2 : (n, 2, 2) array of float
        Covariance of the observed position, px². Where the points scatter more than that, a variance
        common to all points is added, so that points with tiny covariances do not dominate.
    footprint_px : float
        Side of the matching window, px: points whose windows overlap share errors. 0: independent errors.
    name : str
        The model's name.
    order : int
        0: a shift; 1: an affine; from 2 on it is continued linearly beyond the box of the points.
    columns : tuple of int, optional
        Indices of the terms that are fitted; all by default.
    trend : Trend, optional
        That of the points, if it is known.
    parameters : FitParameters
        How it is fitted.
    """
    columns = columns or tuple(range((order + 1) * (order + 2) // 2))
    predicted, observed, covariance = checked(
        name, len(columns) + parameters.redundancy, predicted_px, observed_px, covariance_px2
    )
    basis = _basis(order, predicted)
    values, displacement = basis.values(predicted)[:, columns], observed - predicted
    if len(columns) < 3:
        estimated = estimate(values, displacement, covariance)
    else:
        estimated = (trend or Trend.of(predicted, observed, covariance)).estimate
    if order > 1:
        # from the affine, as samples of ten points are hardly ever free of outliers
        start, fit = estimated.fitted_px, linear(values, displacement)
        estimated = reweighted(fit, start, displacement, covariance, coarse_steps=ROBUST.coarse_steps)
    return ParametricFit.of(
        correction=_correction(name, basis, estimated.parameters, columns),
        jacobian=partial(_jacobian, basis=basis, columns=columns),
        predicted_px=predicted,
        observed_px=observed,
        estimate=estimated,
        footprint_px=footprint_px,
    )


def _basis(order: int, predicted_px: Float64) -> PolynomialBasis:
    """Return terms of order one about the points' centre, as raw pixels would lose half the digits."""
    centre, radius = centre_and_radius(predicted_px)
    low, high = predicted_px.min(axis=0), predicted_px.max(axis=0)
    corners = [(float(corner[0]), float(corner[1])) for corner in (centre, low, high)]
    return PolynomialBasis(order, corners[0], radius, corners[1], corners[2])


def _correction(
    name: str, basis: PolynomialBasis, parameters_px: Float64, columns: tuple[int, ...]
) -> Correction:
    if basis.order > 1:
        return PolynomialCorrection(name, basis, parameters_px)
    terms = np.zeros((3, 2))
    terms[list(columns)] = parameters_px
    matrix = np.zeros((2, 3))
    matrix[:, :2] = terms[1:].T / basis.radius_px
    matrix[:, 2] = terms[0] - matrix[:, :2] @ basis.centre_px
    matrix[:, :2] += np.eye(2)
    return AffineCorrection(name, matrix)


def _jacobian(at_px: Float64, *, basis: PolynomialBasis, columns: tuple[int, ...]) -> Float64:
    return design(basis.values(at_px)[:, columns], np.broadcast_to(np.eye(2), (len(at_px), 2, 2)))


@dataclass(frozen=True, slots=True)
class ModelFamily:
    """A family of corrections: all that the package knows of it by its name."""

    fit: FitFunction
    words: str
    """What such a correction is, for messages."""
    order: int | None = None
    """Order of the polynomial that has all terms; None for other models."""
    terms: tuple[int, ...] = ()
    """Numbers of its terms among 1, column and row, which an RPC can absorb and a geotransform without drift
    can hold, so that nothing is resampled; empty for other models."""
    automatic: bool = True
    """Whether ``auto`` tries it for any image."""
    in_geotransform: bool = False
    """Whether the geotransform of a VRT can hold it."""
    special_of: str = ""
    """Name of the model of which it is a special case, which ``auto`` tries where it has chosen that one."""


def _polynomial(
    name: str, words: str, order: int, terms: tuple[int, ...] = (), *, automatic: bool = True
) -> ModelFamily:
    fit = partial(fit_polynomial, name=name, order=order, columns=terms or None)
    in_geotransform = automatic and bool(terms)
    return ModelFamily(fit, words, order if automatic else None, terms, automatic, in_geotransform)


MODELS: Final[Mapping[str, ModelFamily]] = MappingProxyType(
    {
        "shift": _polynomial("shift", "a shift", 0, (0,)),
        "drift": _polynomial("drift", "a drift", 1, (0, 2), automatic=False),
        "rigid": ModelFamily(
            partial(fit_similarity, scaled=False), "a rotation", in_geotransform=True, special_of="affine"
        ),
        "similarity": ModelFamily(fit_similarity, "a similarity", in_geotransform=True, special_of="affine"),
        "affine": _polynomial("affine", "an affine", 1, (0, 1, 2)),
        "projective": ModelFamily(fit_projective, "a homography"),
        "polynomial2": _polynomial("polynomial2", "a polynomial of order 2", 2),
        "polynomial3": _polynomial("polynomial3", "a polynomial of order 3", 3),
        "jitter": ModelFamily(fit_jitter, "an affine with waves", automatic=False),
        "tps": ModelFamily(fit_tps, "a smooth spline"),
        "field": ModelFamily(fit_field, "the measured field"),
    }
)
"""Every model by its name, the simplest first. The drift is a shift that changes from line to line, the
effect of a drifting attitude on a pushbroom image (Fraser & Hanley 2005, doi:10.14358/PERS.71.8.909)."""
LOSSLESS: Final = {name: model.terms for name, model in MODELS.items() if model.terms}
"""Terms of the models that need no resampling, by their names."""
CANDIDATES: Final = tuple(name for name, model in MODELS.items() if model.automatic)
"""Names of the models tried for any image."""
VRT_MODELS: Final = tuple(name for name, model in MODELS.items() if model.in_geotransform)
"""Models that the geotransform of a VRT can hold."""


def of_option(option: str) -> tuple[str, ...]:
    """Return the models that a value of the option ``--model`` names: a polynomial is of order 2 or 3."""
    return tuple(name for name in MODELS if name.rstrip("23") == option.rstrip("23"))
