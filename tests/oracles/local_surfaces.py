"""Robust local surfaces in plain numpy: what `field_kernel` must equal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.kernels.local_surfaces import SURFACE_LIMITS as LIMITS

Float64 = NDArray[np.float64]


def fit_surfaces_plain(
    offset_px: Float64, displacement_px: Float64, usable: NDArray[np.bool_], order: int
) -> tuple[Float64, Float64, Float64, Float64]:
    """Lay a robust surface through the usable neighbours of each place.

    Parameters
    ----------
    offset_px, displacement_px : (n, k, 2) arrays
        Neighbours' positions less the place, and their displacements.
    usable : (n, k) bool array
    order : int

    Returns
    -------
    value : (n, 2) array
    slope : (n, 2, 2) array
    scale, leverage : (n,) arrays
        As of `field_kernel.fit_surfaces`.
    """
    reach = np.sqrt((offset_px**2).sum(axis=2).max(axis=1)).clip(1e-9)
    x, y = np.moveaxis(offset_px / reach[:, None, None], 2, 0)
    terms = [np.ones_like(x), x, y] + ([x * x, x * y, y * y] if order == 2 else [])
    design = np.stack(terms, axis=2)
    enough = usable.sum(axis=1) >= 2 * len(terms)
    masked = np.where(usable[..., None], displacement_px, np.nan)
    masked[~enough] = 0.0
    start = np.nanmedian(masked, axis=1)
    residual = np.hypot(*np.moveaxis(displacement_px - start[:, None, :], 2, 0))
    value: Float64 = start
    scale: Float64 = np.ones(len(start))
    for _ in range(LIMITS.rounds):
        seen = np.where(usable, residual, np.nan)
        seen[~enough] = 1.0
        scale = np.nanmedian(seen, axis=1).clip(LIMITS.min_scale_px)
        weight = np.where(usable, 1 / (1 + (residual / (2 * scale[:, None])) ** 2), 0.0)
        weighted = design * weight[..., None]
        right = np.einsum("nki,nkj->nij", weighted, displacement_px)
        solution = np.linalg.solve(_normal_matrices(design, weighted), right)
        residual = np.hypot(*np.moveaxis(displacement_px - design @ solution, 2, 0))
        value = solution[:, 0, :].copy()
        slope = solution[:, 1:3, :].transpose(0, 2, 1) / reach[:, None, None]
    inverse = np.linalg.inv(_normal_matrices(design, design * usable[..., None]))
    leverage: Float64 = np.asarray(inverse[:, 0, 0], np.float64).copy()
    for array in (value, slope, scale, leverage):
        array[~enough] = np.nan
    return value, slope, np.asarray(scale, dtype=np.float64), np.asarray(leverage, dtype=np.float64)


def _normal_matrices(design: Float64, weighted: Float64) -> Float64:
    normal: Float64 = np.einsum("nki,nkj->nij", weighted, design)
    index = np.arange(1, design.shape[2])
    normal[:, index, index] += LIMITS.ridge * normal[:, 0, 0, None] + LIMITS.tiny
    normal[:, 0, 0] += LIMITS.tiny
    return normal
