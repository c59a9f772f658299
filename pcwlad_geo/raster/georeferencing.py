"""The grid of an open raster, from its geotransform or its ground control points, and its checks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS
from rasterio.io import DatasetReader

from pcwlad_geo.estimation.solving import solve
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.limits import check_coordinates, check_gcp_misfit, check_geotransform, check_latitudes
from pcwlad_geo.raster.crs import WGS84, transform_xy, utm_zone_of
from pcwlad_geo.raster.geolocation import swath_grid
from pcwlad_geo.raster.grid import Grid, apply, is_invertible, linear_part
from pcwlad_geo.types import Float64

EXACT_PX: Final = 0.05
"""Up to this residual control points count as fitted by a geotransform of their own CRS."""


def _has_transform(dataset: DatasetReader) -> bool:
    """Whether there is an invertible geotransform other than the identity."""
    transform = dataset.transform
    if transform == Affine.identity() or not np.isfinite([*transform]).all():
        return False
    return is_invertible(linear_part(transform))


def grid_of_file(uri: str, dataset: DatasetReader) -> tuple[Grid, float | None]:
    """Return the grid, and its largest residual in px where it was fitted to control points."""
    if dataset.crs is not None and _has_transform(dataset):
        return Grid(dataset.shape, dataset.transform, dataset.crs), None
    swath = swath_grid(uri, dataset)
    if swath is not None:
        return swath, None
    gcps, crs = dataset.gcps
    # Beside RPCs, control points are the approximate corners of an image (NITF).
    check_coordinates(uri, [value for gcp in gcps for value in (gcp.col, gcp.row, gcp.x, gcp.y)])
    if crs is None or dataset.tags(ns="RPC"):
        return Grid(dataset.shape, Affine.identity(), None), None
    return _grid_of_gcps(dataset.shape, gcps, crs)


def _grid_of_gcps(
    shape: tuple[int, int], gcps: Sequence[GroundControlPoint], crs: CRS
) -> tuple[Grid, float | None]:
    """Return the grid that fits control points best, in their CRS or, of degrees, in the UTM zone if better.

    Degrees of longitude become shorter towards the poles: over a radar swath of 250 km by hundreds of pixels.
    """
    fit = geotransform_of(gcps)
    if fit is not None and fit[1] > EXACT_PX and crs.is_geographic:
        lon_lat = np.array([[gcp.x, gcp.y] for gcp in gcps])
        zone = utm_zone_of(transform_xy(lon_lat[len(lon_lat) // 2][None], crs, WGS84)[0])
        in_zone = zip(gcps, transform_xy(lon_lat, crs, zone).tolist(), strict=True)
        zone_fit = geotransform_of([GroundControlPoint(gcp.row, gcp.col, x, y) for gcp, (x, y) in in_zone])
        if zone_fit is not None and zone_fit[1] < fit[1]:
            fit, crs = zone_fit, zone
    if fit is None:
        return Grid(shape, Affine.identity(), None), None
    return Grid(shape, fit[0], crs), fit[1]


def plane_transform_of(uri: str, dataset: DatasetReader) -> Affine | None:
    """Return the geotransform of a file that has one but no CRS."""
    if dataset.crs is not None or not _has_transform(dataset):
        return None
    transform: Affine = dataset.transform
    check_geotransform(uri, tuple(transform)[:6], dataset.shape)
    return transform


def check_place(uri: str, grid: Grid, misfit_px: float | None) -> None:
    """Raise where the georeferencing is not plausible."""
    if misfit_px is not None:
        check_gcp_misfit(uri, misfit_px, grid.shape)
    if grid.crs is None:
        return
    check_geotransform(uri, tuple(grid.transform)[:6], grid.shape)
    if grid.crs.is_geographic and grid.crs.units_factor[0].lower().startswith("degree"):
        rows, cols = grid.shape
        corners = grid.to_xy(np.array([[0.0, 0.0], [cols, 0.0], [cols, rows], [0.0, rows]]))[:, 1]
        pixel = float(np.abs(linear_part(grid.transform)[1]).max())
        check_latitudes(uri, float(corners.min()), float(corners.max()), min(pixel, 1.0))


def geotransform_of(gcps: Sequence[GroundControlPoint]) -> tuple[Affine, float] | None:
    """Fit a geotransform to ground control points by least squares; None if fewer than three, or on a line.

    Pixel and line are corner-based: (0, 0) is the top-left corner of the first pixel. The second result is
    the largest residual of a control point, px; infinite for a geotransform that cannot be inverted.
    """
    if len(gcps) < 3:
        return None
    px = np.array([[gcp.col, gcp.row] for gcp in gcps], dtype=np.float64)
    xy = np.array([[gcp.x, gcp.y] for gcp in gcps], dtype=np.float64)
    if not (np.isfinite(px).all() and np.isfinite(xy).all()):
        return None
    if _on_a_line(px) or _on_a_line(xy):
        return None
    (a, b, c), (d, e, f) = AffineTransform.fit(px, xy).rows.tolist()
    transform = Affine(a, b, c, d, e, f)
    if not is_invertible(linear_part(transform)):
        return transform, np.inf
    residual_px = solve(linear_part(transform), (xy - apply(transform, px)).T)
    return transform, float(np.linalg.norm(residual_px, axis=0).max())


def _on_a_line(points: Float64) -> bool:
    large, small = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(small <= 1e-6 * large)
