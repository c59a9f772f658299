"""Ground control points as georeferencing: the geotransform that fits them best, and how well."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.control import GroundControlPoint

LEAST_POINTS: Final = 3
_FLATTEST: Final = 1e-6
"""Ratio of the points' extents below which they lie on a line."""


def geotransform_of(gcps: Sequence[GroundControlPoint]) -> tuple[Affine, float] | None:
    """Fit a geotransform to ground control points by least squares.

    Parameters
    ----------
    gcps : sequence of GroundControlPoint
        Pixel and line are corner-based.

    Returns
    -------
    transform : Affine
    misfit_px : float
        Largest distance of a control point from where the geotransform puts it, px.
    None
        Instead, of fewer than three points or points on a line.
    """
    if len(gcps) < LEAST_POINTS:
        return None
    px = np.array([[gcp.col, gcp.row] for gcp in gcps], dtype=np.float64)
    xy = np.array([[gcp.x, gcp.y] for gcp in gcps], dtype=np.float64)
    if not (np.isfinite(px).all() and np.isfinite(xy).all()):
        return None
    # About the means: eastings and northings have more digits than normal equations keep.
    centre_px, centre_xy = px.mean(axis=0), xy.mean(axis=0)
    if _on_a_line(px - centre_px) or _on_a_line(xy - centre_xy):
        return None
    linear = np.linalg.lstsq(px - centre_px, xy - centre_xy, rcond=None)[0].T
    residual_px = np.linalg.solve(linear, (xy - centre_xy).T).T - (px - centre_px)
    origin = centre_xy - linear @ centre_px
    (a, b), (d, e) = linear.tolist()
    transform = Affine(a, b, float(origin[0]), d, e, float(origin[1]))
    return transform, float(np.linalg.norm(residual_px, axis=1).max())


def _on_a_line(points: NDArray[np.float64]) -> bool:
    large, small = np.linalg.svd(points, compute_uv=False)
    return bool(small <= _FLATTEST * large)
