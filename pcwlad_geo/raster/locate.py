"""Tie points from the matching grid to the original files, the ground and metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.tie_points import TiePoints
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.geodesy import displacement_m
from pcwlad_geo.raster.grid import jacobian, map_px
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.rpc_grid import levelled
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.tie_point_table import TiePointTable

Array = NDArray[np.float64]


def locate(points: TiePoints, pair: ViewPair, original: RasterInfo | None = None) -> TiePointTable:
    """Express tie points in the original files and on the ground.

    Parameters
    ----------
    points : TiePoints
        Reference positions in reference-view px, target positions in target-view px.
    pair : ViewPair
    original : RasterInfo, optional
        The target as its own georeferencing places it, where the matching started from a better one.

    Returns
    -------
    TiePointTable
        Status ``matched``, residuals NaN; the covariance is that of the target file's pixels.
    """
    target_view = pair.target
    reference_px = pair.reference.to_file_px(points.reference_xy_px)
    target_px = target_view.to_file_px(points.target_xy_px)
    scale = jacobian(points.target_xy_px, target_view.grid, levelled(target_view.info.grid))
    if original is not None:
        pair = replace(pair, target=replace(target_view, info=original))
    covariance_px2 = scale @ points.covariance_px2 @ scale.transpose(0, 2, 1)
    return place(reference_px, target_px, covariance_px2, points.score, pair)


def place(
    reference_px: Array, target_px: Array, covariance_px2: Array, score: Array, pair: ViewPair
) -> TiePointTable:
    """Make a table of tie points in px of the two original files.

    Parameters
    ----------
    reference_px, target_px : (n, 2) arrays of float
    covariance_px2 : (n, 2, 2) array of float
        Of target_px.
    score : (n,) array of float
    pair : ViewPair

    Returns
    -------
    TiePointTable
        Status ``matched``, residuals NaN.
    """
    predicted_px = predict_target_px(reference_px, pair)
    count = len(score)
    return TiePointTable(
        reference_px=reference_px,
        target_px=target_px,
        predicted_px=predicted_px,
        xy=ground_xy(reference_px, pair),
        displacement_m=_displacement_m(predicted_px, target_px, pair),
        covariance_px2=covariance_px2,
        score=score,
        residual_px=np.full((count, 2), np.nan),
        status=np.full(count, "matched", dtype="<U8"),
        crs=pair.reference.info.grid.crs,
    )


def predict_target_px(reference_px: Array, pair: ViewPair) -> Array:
    """Map (n, 2) reference file px to the target file px that the original georeferencing predicts."""
    return predict_px(reference_px, pair.reference.info, pair.target.info)


def predict_px(reference_px: Array, reference: RasterInfo, target: RasterInfo) -> Array:
    """Map (n, 2) px of one file to the px of another that show the same ground by georeferencing.

    The identity where either file is not georeferenced; NaN where the CRSs cannot be transformed.
    """
    if not (reference.georeferenced and target.georeferenced):
        return np.asarray(reference_px, dtype=np.float64)
    return map_px(reference_px, reference.grid, target.grid)


def overlap_middle_px(pair: ViewPair, target: RasterInfo) -> Array:
    """Return the target file px (2,) in the middle of what both rasters cover by their georeferencing.

    The middle of the target where that place has no position in it.
    """
    box, (rows, cols) = pair.overlap, target.grid.shape
    middle_px = np.array([[box.col + box.cols / 2, box.row + box.rows / 2]])
    found_px = predict_target_px(pair.reference.to_file_px(middle_px), pair)[0]
    return found_px if np.isfinite(found_px).all() else np.array([cols / 2, rows / 2])


def ground_xy(reference_px: Array, pair: ViewPair) -> Array:
    """Map (n, 2) reference file px to the reference CRS or the shared plane; else to (col, -row)."""
    grid = pair.reference.info.grid
    return grid.to_xy(reference_px) if grid.located else reference_px * [1.0, -1.0]


def _displacement_m(predicted_px: Array, target_px: Array, pair: ViewPair) -> Array:
    crs = pair.reference.info.grid.crs
    if crs is None:
        return np.full(target_px.shape, np.nan)
    # a target without georeferencing is predicted to lie on the reference's pixels
    grid = pair.target.info.grid if pair.georeferenced else pair.reference.info.grid
    predicted_xy, target_xy = (
        transform_xy(grid.to_xy(pixels), grid.crs, crs) for pixels in (predicted_px, target_px)
    )
    return displacement_m(predicted_xy, target_xy, crs)
