"""RPCs fitted to pixels of known ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.raster.rpc.model import TERMS, Coefficients, RpcModel, polynomial_terms
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class RationalParameters:
    """How numerators and denominators are fitted."""

    iterations: int = 4
    """Steps by which the equations, which are linear times the denominator, get their weights."""
    least: float = 1e-12
    """Singular values below this share of the largest count as none."""


RATIONAL: Final = RationalParameters()
"""Those in use."""


def fit_rpc(ground: Float64, at_px: Float64, box: tuple[Float64, Float64]) -> tuple[RpcModel, float]:
    """Return the RPC that maps the (n, 3) `ground` to the (n, 2) `at_px` best, and its largest misfit in px.

    Places are longitude, latitude (degrees) and height (m above the ellipsoid), pixels (col, row),
    corner-based. The (3,) middle and reach of the `box` about the places become offsets and scales. The
    equations are those of Tao and Hu (2001), A comprehensive study of the rational function model.
    """
    middle, reach = box
    low, high = at_px.min(axis=0), at_px.max(axis=0)
    offset, scale = (low + high) / 2, (high - low) / 2
    terms = polynomial_terms((ground - middle) / reach).T
    samp, line = (_fraction(terms, values) for values in ((at_px - offset) / scale).T)
    rpc = RpcModel(
        line_off=float(offset[1]) - 0.5,
        samp_off=float(offset[0]) - 0.5,
        lat_off=float(middle[1]),
        long_off=float(middle[0]),
        height_off=float(middle[2]),
        line_scale=float(scale[1]),
        samp_scale=float(scale[0]),
        lat_scale=float(reach[1]),
        long_scale=float(reach[0]),
        height_scale=float(reach[2]),
        line_num_coeff=line[0],
        line_den_coeff=line[1],
        samp_num_coeff=samp[0],
        samp_den_coeff=samp[1],
    )
    return rpc, float(np.hypot(*(rpc.to_px(ground) - at_px).T).max())


def _fraction(terms: Float64, values: Float64) -> tuple[Coefficients, Coefficients]:
    """Return numerator and denominator, which begins with 1, that give (n,) values of (n, 20) terms."""
    weight = np.ones(len(terms))
    for _ in range(RATIONAL.iterations):
        design = np.hstack([terms, -values[:, None] * terms[:, 1:]]) * weight[:, None]
        solution = least_squares(design, values * weight, RATIONAL.least)
        numerator, denominator = solution[:TERMS], np.concatenate([[1.0], solution[TERMS:]])
        weight = 1.0 / (terms @ denominator)
    return tuple(numerator.tolist()), tuple(denominator.tolist())
