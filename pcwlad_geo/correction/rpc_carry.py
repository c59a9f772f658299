"""The correction of one image's RPC carried over to another image that the same platform took beside it.

What is wrong with an RPC is position and attitude of the platform (Fraser & Hanley 2005,
doi:10.14358/PERS.71.8.909): images taken with it at the same time err on the ground by the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.rpc_model import RpcModel

Array = NDArray[np.float64]

NODES = (9, 9, 3)
"""Columns, rows, heights: where the two RPCs are compared."""
SAME_PX = 1e-3
"""A shift that is everywhere the same to this is one."""
LEAST_HEIGHTS_M = 100.0
"""Between heights that tell from where an image is seen."""
_M_PER_DEG = 111_320.0


def carried(
    original: RpcModel,
    corrected: RpcModel,
    sibling: RpcModel,
    shape: tuple[int, int],
    heights_m: tuple[float, float],
) -> tuple[AffineCorrection, float]:
    """Return the correction of another image's pixels, and how far it is from what is carried over.

    A place that the sibling's RPC predicts to be seen at q is seen, by the corrected RPC, at a pixel of the
    registered image that the original RPC takes for another place of the same height; the sibling shows it
    where its own RPC puts that other place. An affine transformation, or a shift where that is enough, is
    fitted to this over the sibling.

    Parameters
    ----------
    original, corrected : RpcModel
        Of the registered image.
    sibling : RpcModel
    shape : (int, int)
        Rows and columns of the sibling.
    heights_m : (float, float)
        Lowest and highest ground below it, m above the ellipsoid.

    Returns
    -------
    correction : AffineCorrection
        Maps predicted to observed pixels (col, row) of the sibling.
    misfit_px : float
        Largest distance from what is carried over, px of the sibling; NaN where nothing is.
    """
    predicted, ground = _lattice(sibling, shape, heights_m)
    claimed = original.to_ground(corrected.to_px(ground), ground[:, 2])
    observed = sibling.to_px(np.column_stack([claimed, ground[:, 2]]))
    known = np.isfinite(predicted).all(axis=1) & np.isfinite(observed).all(axis=1)
    if not known.any():
        return AffineCorrection("shift", np.eye(2, 3)), float("nan")
    predicted, observed = predicted[known], observed[known]
    shift = (observed - predicted).mean(axis=0)
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), shift]))
    misfit_px = _largest(observed - correction.forward(predicted))
    if misfit_px > SAME_PX:
        middle = predicted.mean(axis=0)
        design = np.column_stack([predicted - middle, np.ones(len(predicted))])
        solution = np.linalg.lstsq(design, observed, rcond=None)[0].T
        linear = solution[:, :2]
        correction = AffineCorrection("affine", np.column_stack([linear, solution[:, 2] - linear @ middle]))
        misfit_px = _largest(observed - correction.forward(predicted))
    return correction, misfit_px


def parallax(
    original: RpcModel, sibling: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float]
) -> float:
    """Return how far apart on the ground two images show what is a metre higher: 0 m from one viewpoint.

    Parameters
    ----------
    original, sibling : RpcModel
    shape : (int, int)
        Rows and columns of the sibling.
    heights_m : (float, float)
        Lowest and highest ground below it, m above the ellipsoid.
    """
    middle, reach = np.mean(heights_m), max(np.ptp(heights_m), LEAST_HEIGHTS_M) / 2
    low, high = float(middle - reach), float(middle + reach)
    pixels, ground = _lattice(sibling, shape, (low, low))
    there = original.to_ground(original.to_px(ground), high) - sibling.to_ground(pixels, high)
    east = there[:, 0] * np.cos(np.radians(ground[:, 1]))
    return float(np.nanmedian(np.hypot(east, there[:, 1]))) * _M_PER_DEG / (high - low)


def _lattice(rpc: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float]) -> tuple[Array, Array]:
    """Return (n, 2) pixels spread over an image at several heights, and the (n, 3) ground that they show."""
    rows, cols = shape
    axes = np.meshgrid(*(np.linspace(0.0, 1.0, count) for count in NODES), indexing="ij")
    share = np.stack([axis.ravel() for axis in axes], axis=1)
    pixels = share[:, :2] * [cols, rows]
    heights = heights_m[0] + share[:, 2] * (heights_m[1] - heights_m[0])
    return pixels, np.column_stack([rpc.to_ground(pixels, heights), heights])


def _largest(difference: Array) -> float:
    return float(np.hypot(*difference.T).max())
