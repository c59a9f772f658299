"""Corrections of an RPC: by the tie points of its image, or those of another image taken with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.raster.rpc.model import TERMS, Coefficients, RpcModel, polynomial_terms
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class RefitParameters:
    """At which nodes RPCs are refitted, checked and compared, and how exactly."""

    refit_nodes: tuple[int, int, int] = (15, 15, 5)
    """Nodes along longitude, latitude, height at which numerators are refitted."""
    check_nodes: tuple[int, int, int] = (25, 25, 7)
    """Nodes along longitude, latitude, height at which a corrected RPC is checked."""
    sibling_nodes: tuple[int, int, int] = (9, 9, 3)
    """Nodes along columns, rows and heights at which two RPCs are compared."""
    ridge: float = 1e-12
    """Ridge of the refit, as a share of the largest singular value: 1e-6 would cause errors of 0.01 px."""
    shift_px: float = 1e-3
    """Largest residual with which a shift is enough for a transferred correction."""
    least_relief_m: float = 100.0
    """Least difference of heights over which a parallax is measured."""


REFIT: Final = RefitParameters()
"""Those in use."""
BIAS_TOLERANCE_PX: Final = 1e-3
"""Largest error with which a corrected RPC may represent the correction."""
WHOLE_RANGE: Final[Float64] = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
"""(2, 3) lowest and highest normalised longitude, latitude, height of the range of an RPC."""


def covered_range(rpc: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float]) -> Float64:
    """Return the range of normalised coordinates that an image covers.

    A part cut from a product covers only a part of the range, -1 to 1, of the product's RPC. The (2, 3)
    result has lowest and highest normalised longitude, latitude and height, for an image of `shape` rows and
    columns over ground within `heights_m`, m above the ellipsoid; the RPC's own range of heights is included.
    """
    low = min(heights_m[0], rpc.height_off - abs(rpc.height_scale))
    high = max(heights_m[1], rpc.height_off + abs(rpc.height_scale))
    _, ground = _image_lattice(rpc, shape, (low, high), REFIT.check_nodes)
    normalised = rpc.normalised(ground[np.isfinite(ground).all(axis=1)])
    return WHOLE_RANGE if len(normalised) == 0 else np.stack([normalised.min(axis=0), normalised.max(axis=0)])


def apply_bias(rpc: RpcModel, correction: AffineCorrection, covered: Float64 | None = None) -> RpcModel:
    """Return the RPC that gives observed pixels where the original gives predicted ones.

    This is the bias correction in image space of Fraser and Hanley (2003) and Grodecki and Dial (2003),
    carried over to the RPC. The shift and the gain of an axis are exact in its offset and scale. The
    cross terms between the axes are put into refitted numerators; the denominators are unchanged.

    Parameters
    ----------
    correction : AffineCorrection
        Maps predicted to observed pixels (col, row), corner-based.
    covered : (2, 3) array, optional
        Lowest and highest normalised longitude, latitude, height of the range of the refit, see
        `covered_range`; -1 to 1 by default.
    """
    low, high = WHOLE_RANGE if covered is None else covered
    # longitude, latitude, height
    terms = polynomial_terms((low + high) / 2 + _lattice(REFIT.refit_nodes) * (high - low) / 2)
    samp = np.array(rpc.samp_num_coeff) @ terms / (np.array(rpc.samp_den_coeff) @ terms)
    line = np.array(rpc.line_num_coeff) @ terms / (np.array(rpc.line_den_coeff) @ terms)
    scale, offset = np.array([rpc.samp_scale, rpc.line_scale]), np.array([rpc.samp_off, rpc.line_off]) + 0.5
    # Relative to the middle of the covered range: offsets may be far outside of the image.
    middle = np.array([np.median(samp), np.median(line)])
    middle_px = middle * scale + offset
    matrix = np.asarray(correction.matrix, dtype=np.float64)
    gain = np.diag(matrix[:, :2])
    new_offset = correction.forward(middle_px[None])[0] + gain * (offset - middle_px) - 0.5
    new_scale = gain * scale
    biased = replace(
        rpc,
        samp_off=float(new_offset[0]),
        line_off=float(new_offset[1]),
        samp_scale=float(new_scale[0]),
        line_scale=float(new_scale[1]),
    )
    # the cross term of an axis, in units of its own new scale
    cross = np.array([matrix[0, 1], matrix[1, 0]]) * scale[::-1] / new_scale
    if not cross.any():
        return biased
    samp_added, line_added = cross[0] * (line - middle[1]), cross[1] * (samp - middle[0])
    return replace(
        biased,
        samp_num_coeff=_refitted(rpc.samp_num_coeff, rpc.samp_den_coeff, terms, samp_added),
        line_num_coeff=_refitted(rpc.line_num_coeff, rpc.line_den_coeff, terms, line_added),
    )


def bias_error_px(
    rpc: RpcModel,
    biased: RpcModel,
    correction: AffineCorrection,
    shape: tuple[int, int],
    heights_m: tuple[float, float],
) -> float:
    """Return the largest distance between the biased RPC and the correction of the original's pixels, px.

    The RPC is the original, `biased` the result of `apply_bias`. The image has `shape` rows and columns, and
    its ground is within `heights_m`, m above the ellipsoid.
    """
    _, ground = _image_lattice(rpc, shape, heights_m, REFIT.check_nodes)
    ground = ground[np.isfinite(ground).all(axis=1)]
    if len(ground) == 0:
        return float("nan")
    return _largest(biased.to_px(ground) - correction.forward(rpc.to_px(ground)))


def _refitted(
    numerator: Coefficients, denominator: Coefficients, terms: Float64, added: Float64
) -> Coefficients:
    """Return the numerator whose ratio is increased by (n,) `added` at n points with (20, n) `terms`."""
    design = (terms / (np.array(denominator) @ terms)).T
    left_vectors, singular, right = np.linalg.svd(design, full_matrices=False)
    ridge = (REFIT.ridge * singular[0]) ** 2
    change = right.T @ (singular / (singular**2 + ridge) * (left_vectors.T @ added))
    values: list[float] = (np.array(numerator) + change).tolist()
    if len(values) != TERMS:
        raise ValueError(f"an RPC polynomial has {TERMS} coefficients, not {len(values)}")
    return tuple(values)


def _lattice(nodes: tuple[int, int, int]) -> Float64:
    """Return the (n, 3) nodes of a regular lattice over -1 to 1 along each axis."""
    axes = np.meshgrid(*(np.linspace(-1.0, 1.0, count) for count in nodes), indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)


def carried(
    original: RpcModel,
    corrected: RpcModel,
    sibling: RpcModel,
    shape: tuple[int, int],
    heights_m: tuple[float, float],
) -> tuple[AffineCorrection, float]:
    """Transfer the correction of a registered image to another image taken with it, its sibling.

    The ground point that the sibling's RPC predicts at q is projected by the corrected RPC to a pixel of the
    registered image. The original RPC relates that pixel to another ground point of the same height, and the
    sibling's RPC maps this point to the observed pixel. An affine transformation, or a shift where that is
    enough, is fitted to predicted and observed pixels (col, row) over the sibling, of that shape (rows,
    cols), between its lowest and highest ground `heights_m` above the ellipsoid. The second result is the
    largest residual of the fit, px of the sibling; NaN where no point can be transferred.
    """
    predicted, ground = _image_lattice(sibling, shape, heights_m, REFIT.sibling_nodes)
    claimed = original.to_ground(corrected.to_px(ground), ground[:, 2])
    observed = sibling.to_px(np.column_stack([claimed, ground[:, 2]]))
    finite = np.isfinite(predicted).all(axis=1) & np.isfinite(observed).all(axis=1)
    if not finite.any():
        return AffineCorrection("shift", np.eye(2, 3)), float("nan")
    predicted, observed = predicted[finite], observed[finite]
    shift = (observed - predicted).mean(axis=0)
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), shift]))
    misfit_px = _largest(observed - correction.forward(predicted))
    if misfit_px > REFIT.shift_px:
        correction = AffineCorrection.fit(predicted, observed)
        misfit_px = _largest(observed - correction.forward(predicted))
    return correction, misfit_px


def parallax(
    original: RpcModel, sibling: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float]
) -> float:
    """Return the parallax of two images on the ground, m per metre of height: 0 from one viewpoint.

    The sibling has `shape` rows and columns, and the ground below it is within `heights_m`, m above the
    ellipsoid.
    """
    middle, reach = np.mean(heights_m), max(np.ptp(heights_m), REFIT.least_relief_m) / 2
    low, high = float(middle - reach), float(middle + reach)
    pixels, ground = _image_lattice(sibling, shape, (low, low), REFIT.sibling_nodes)
    parallax_deg = original.to_ground(original.to_px(ground), high) - sibling.to_ground(pixels, high)
    east = parallax_deg[:, 0] * np.cos(np.radians(ground[:, 1]))
    return float(np.nanmedian(np.hypot(east, parallax_deg[:, 1]))) * 111_320.0 / (high - low)


def _image_lattice(
    rpc: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float], nodes: tuple[int, int, int]
) -> tuple[Float64, Float64]:
    """Return (n, 2) pixels (col, row) over an image at several heights, and their (n, 3) ground points."""
    share = (_lattice(nodes) + 1) / 2
    pixels = share[:, :2] * shape[::-1]
    heights = heights_m[0] + share[:, 2] * (heights_m[1] - heights_m[0])
    return pixels, np.column_stack([rpc.to_ground(pixels, heights), heights])


def _largest(difference: Float64) -> float:
    return float(np.hypot(*difference.T).max())
