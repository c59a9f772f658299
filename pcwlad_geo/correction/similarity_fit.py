"""Fits of a shift and a rotation, with a scale (similarity) or without (rigid)."""

from __future__ import annotations

from functools import partial

import numpy as np

from pcwlad_geo.correction.fitted import FIT, FitParameters, ParametricFit, Trend, checked, gauss_newton
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.estimation.robust import ROBUST, Solution, reweighted
from pcwlad_geo.estimation.transforms import SimilarityTransform
from pcwlad_geo.types import Float64


def fit_similarity(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    *,
    footprint_px: float = 0.0,
    trend: Trend | None = None,
    scaled: bool = True,
    parameters: FitParameters = FIT,
) -> ParametricFit:
    """Fit a shift, a rotation and, if `scaled`, a scale that is the same in all directions.

    Raises `InputError` if the points are too few or lie on a line, or an array has a wrong shape or values
    that are not finite. The (n, 2) `predicted_px` and `observed_px` and the (n, 2, 2) `covariance_px2` are
    those of `fit.fit_polynomial`, as are `footprint_px`, `trend` and `parameters`; n ≥ 4.
    """
    name, unknowns = ("similarity", 4) if scaled else ("rigid", 3)
    predicted, observed, covariance = checked(
        name, 2 + parameters.redundancy, predicted_px, observed_px, covariance_px2
    )
    trend = trend or Trend.of(predicted, observed, covariance)
    centre, radius, start_px = trend.centre_px, trend.radius_px, trend.estimate.fitted_px
    place = (predicted - centre) / radius
    start = _values(SimilarityTransform.fit(place, place + start_px / radius), radius)[:unknowns]

    needs = (
        "{} consistent tie points lie in one place and determine no rotation; use a shift, or more tie points"
    )
    image, jacobian = (partial(function, place=place, radius_px=radius) for function in (_image, _jacobian))
    solved = partial(gauss_newton, start, image, jacobian, needs)

    def fitted(whitener: Float64, weight: Float64) -> Solution:
        values = solved(observed - centre, np.sqrt(weight)[:, None, None] * whitener, parameters)
        return Solution(values, _image(values, place, radius) + centre - predicted, unknowns / 2)

    estimated = reweighted(
        fitted, start_px, observed - predicted, covariance, coarse_steps=ROBUST.coarse_steps
    )
    return ParametricFit.of(
        correction=AffineCorrection(name, _rows(estimated.parameters, centre, radius)),
        jacobian=partial(_jacobian_px, values=estimated.parameters, centre_px=centre, radius_px=radius),
        predicted_px=predicted,
        observed_px=observed,
        estimate=estimated,
        footprint_px=footprint_px,
    )


def _values(transform: SimilarityTransform, radius_px: float) -> Float64:
    """Return the (4,) values, px, of a transform in units of the radius: shift, rotation and scale."""
    factor = complex(transform.linear[0, 0], transform.linear[1, 0])
    logarithm = np.log(factor) * radius_px
    return np.array([*(transform.offset * radius_px), logarithm.imag, logarithm.real])


def _factor(values: Float64, radius_px: float) -> complex:
    """Return the rotation and the scale, 1 of a rigid transform, as a complex number."""
    logarithm = complex(values[3] if len(values) > 3 else 0.0, values[2]) / radius_px
    return complex(np.exp(logarithm))


def _rows(values: Float64, centre_px: Float64, radius_px: float) -> Float64:
    """Return the (2, 3) matrix between pixels."""
    factor = _factor(values, radius_px)
    linear = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
    return SimilarityTransform.from_parts(linear, centre_px + values[:2] - linear @ centre_px).rows


def _image(values: Float64, place: Float64, radius_px: float) -> Float64:
    """Return the (n, 2) observed px about the centre of (n, 2) places in units of the radius."""
    turned = _factor(values, radius_px) * (place @ (1, 1j)) * radius_px
    return values[:2] + np.column_stack([turned.real, turned.imag])


def _jacobian(values: Float64, place: Float64, radius_px: float) -> Float64:
    """Return the (n, 2, 3) or (n, 2, 4) derivatives of the observed px by the values."""
    turned = _factor(values, radius_px) * (place @ (1, 1j))
    columns = [np.ones_like(turned), 1j * np.ones_like(turned), 1j * turned, turned][: len(values)]
    derivatives = np.stack(columns, axis=1)
    return np.stack([derivatives.real, derivatives.imag], axis=1)


def _jacobian_px(at_px: Float64, *, values: Float64, centre_px: Float64, radius_px: float) -> Float64:
    return _jacobian(values, (at_px - centre_px) / radius_px, radius_px)
