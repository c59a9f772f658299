"""Corrections in image space folded into the coefficients of an RPC.

After Grodecki & Dial 2003 (doi:10.14358/PERS.69.1.59) and Fraser & Hanley 2005 (doi:10.14358/PERS.71.8.909),
who correct the image coordinates that an RPC gives; the corrected RPC gives them corrected.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.rpc_model import TERMS, Coefficients, RpcModel, polynomial_terms

Array = NDArray[np.float64]

FOLD_TOLERANCE_PX = 1e-3
NODES = (15, 15, 5)
"""Longitude, latitude, height: where the numerators are fitted again."""
RIDGE = 1e-12
"""Relative to the largest singular value; 1e-6 would already cost 0.01 px."""
CHECK_NODES = (25, 25, 7)
WHOLE_RANGE: Array = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
"""Of normalised longitude, latitude, height."""


def covered_range(rpc: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float]) -> Array:
    """Return the (2, 3) lowest and highest normalised longitude, latitude, height that an image covers.

    A part cut from a product covers little of the range, -1 to 1, of the product's RPC.

    Parameters
    ----------
    rpc : RpcModel
    shape : (int, int)
        Rows and columns of the image.
    heights_m : (float, float)
        Lowest and highest ground, m above the ellipsoid; the RPC's own range of heights counts besides.
    """
    rows, cols = shape
    lattice = (_lattice(CHECK_NODES) + 1) / 2
    low = min(heights_m[0], rpc.height_off - abs(rpc.height_scale))
    high = max(heights_m[1], rpc.height_off + abs(rpc.height_scale))
    heights = low + lattice[:, 2] * (high - low)
    ground = np.column_stack([rpc.to_ground(lattice[:, :2] * [cols, rows], heights), heights])
    found = rpc.normalised(ground[np.isfinite(ground).all(axis=1)])
    return WHOLE_RANGE if len(found) == 0 else np.stack([found.min(axis=0), found.max(axis=0)])


def fold(rpc: RpcModel, correction: AffineCorrection, covered: Array | None = None) -> RpcModel:
    """Return the RPC that gives observed pixels where the original gives predicted ones.

    Shift and the gain of an axis go into offset and scale, exactly. What one axis adds to the other goes
    into the numerators, fitted again with the denominators as they are.

    Parameters
    ----------
    rpc : RpcModel
    correction : AffineCorrection
        Maps predicted to observed pixels (col, row), corner-based.
    covered : (2, 3) array, optional
        Lowest and highest normalised longitude, latitude, height at which it has to hold, see
        `covered_range`; -1 to 1 by default.
    """
    low, high = WHOLE_RANGE if covered is None else covered
    terms = polynomial_terms((low + high) / 2 + _lattice(NODES) * (high - low) / 2)
    samp = np.array(rpc.samp_num_coeff) @ terms / (np.array(rpc.samp_den_coeff) @ terms)
    line = np.array(rpc.line_num_coeff) @ terms / (np.array(rpc.line_den_coeff) @ terms)
    scale, offset = np.array([rpc.samp_scale, rpc.line_scale]), np.array([rpc.samp_off, rpc.line_off]) + 0.5
    # About the middle of what is covered: offsets may lie far outside of the image.
    middle = np.array([np.median(samp), np.median(line)])
    middle_px = middle * scale + offset
    matrix = np.asarray(correction.matrix, dtype=np.float64)
    gain = np.diag(matrix[:, :2])
    new_offset = correction.forward(middle_px[None])[0] + gain * (offset - middle_px) - 0.5
    new_scale = gain * scale
    folded = replace(
        rpc,
        samp_off=float(new_offset[0]),
        line_off=float(new_offset[1]),
        samp_scale=float(new_scale[0]),
        line_scale=float(new_scale[1]),
    )
    # in units of its own new scale, what an axis takes from the other
    cross = np.array([matrix[0, 1], matrix[1, 0]]) * scale[::-1] / new_scale
    if not cross.any():
        return folded
    samp_added, line_added = cross[0] * (line - middle[1]), cross[1] * (samp - middle[0])
    return replace(
        folded,
        samp_num_coeff=_refitted(rpc.samp_num_coeff, rpc.samp_den_coeff, terms, samp_added),
        line_num_coeff=_refitted(rpc.line_num_coeff, rpc.line_den_coeff, terms, line_added),
    )


def fold_error_px(
    rpc: RpcModel,
    folded: RpcModel,
    correction: AffineCorrection,
    shape: tuple[int, int],
    heights_m: tuple[float, float],
) -> float:
    """Return the largest distance between the folded RPC and the correction of the original's pixels, px.

    Parameters
    ----------
    rpc, folded : RpcModel
    correction : AffineCorrection
    shape : (int, int)
        Rows and columns of the image.
    heights_m : (float, float)
        Lowest and highest ground, m above the ellipsoid.
    """
    rows, cols = shape
    lattice = (_lattice(CHECK_NODES) + 1) / 2
    heights = heights_m[0] + lattice[:, 2] * (heights_m[1] - heights_m[0])
    ground = rpc.to_ground(lattice[:, :2] * [cols, rows], heights)
    ground = np.column_stack([ground, heights])[np.isfinite(ground).all(axis=1)]
    if len(ground) == 0:
        return float("nan")
    difference = folded.to_px(ground) - correction.forward(rpc.to_px(ground))
    return float(np.hypot(*difference.T).max())


def _refitted(numerator: Coefficients, denominator: Coefficients, terms: Array, added: Array) -> Coefficients:
    """Return the numerator whose ratio has grown by `added` (n,) at the terms (20, n) of n places."""
    design = (terms / (np.array(denominator) @ terms)).T
    left, singular, right = np.linalg.svd(design, full_matrices=False)
    ridge = (RIDGE * singular[0]) ** 2
    change = right.T @ (singular / (singular**2 + ridge) * (left.T @ added))
    values: list[float] = (np.array(numerator) + change).tolist()
    if len(values) != TERMS:
        raise ValueError(f"an RPC polynomial has {TERMS} coefficients, not {len(values)}")
    return tuple(values)


def _lattice(nodes: tuple[int, int, int]) -> Array:
    """(n, 3): all combinations of so many places from -1 to 1 an axis."""
    axes = np.meshgrid(*(np.linspace(-1.0, 1.0, count) for count in nodes), indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)
