"""Tie points of a file laid on a pair of rasters, and refused where they cannot belong to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import name_of, transform_xy
from pcwlad_geo.raster.locate import ground_xy, place, predict_target_px
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.rpc_grid import RpcGrid
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.tie_point_readers import PointFile, read_point_file, swapped
from pcwlad_geo.raster.tie_point_table import TiePointTable

Array = NDArray[np.float64]

MARGIN: Final = 0.1
"""Of the raster's size: points this far outside still count as on it (a control point beside a crop)."""
LEAST_INSIDE: Final = 0.5
"""Share of the points that must lie on the raster."""
OTHER_PX: Final = 0.5
"""Columns that say the same twice may differ by so much; beyond, they are of other rasters."""


def read_tie_points(path: Path | str, pair: ViewPair) -> TiePointTable:
    """Read a file of tie points for a pair.

    Parameters
    ----------
    path : path or GDAL URI
        One of the formats of `tie_point_readers.read_point_file`. Map coordinates without a CRS are in the
        reference's.
    pair : ViewPair

    Returns
    -------
    TiePointTable
        Status ``matched``, or ``rejected`` where the file has switched a point off; covariance NaN where the
        file gives no sigma, score 1 where it gives none.

    Raises
    ------
    InputError
        If the file cannot be read, or most points lie outside a raster: exchanged columns, another CRS,
        other rasters.
    """
    reference, target = pair.reference.info, pair.target.info
    points = read_point_file(path, reference_name=reference.uri, target_name=target.uri)
    if points.shape is not None and points.shape != target.grid.shape:
        raise InputError(
            f"{path} has {points.shape[1]} x {points.shape[0]} pixels and {target.uri} "
            f"{target.grid.shape[1]} x {target.grid.shape[0]}: its control points are of another raster"
        )
    reference_px = _on_raster(path, points, "reference", reference)
    target_px = _on_raster(path, points, "target", target)
    _check_against_itself(path, points, reference_px, target_px, pair)
    count = len(reference_px)
    sigma_px = np.full((count, 2), np.nan) if points.sigma_px is None else points.sigma_px
    covariance_px2 = sigma_px[:, :, None] ** 2 * np.eye(2)
    score = np.ones(count) if points.score is None else np.nan_to_num(points.score, nan=1.0)
    table = place(reference_px, target_px, covariance_px2, score, pair)
    if not np.isfinite(table.predicted_px).all():
        if isinstance(target.grid, RpcGrid):
            raise InputError(f"{path}: some points lie where the DEM has no height: remove them")
        raise InputError(
            f"{path}: some points lie where {name_of(reference.grid.crs)} cannot be transformed to "
            f"{name_of(target.grid.crs)}: remove them"
        )
    return replace(table, status=np.where(points.enabled, "matched", "rejected").astype("<U8"))


def _on_raster(
    path: Path | str, points: PointFile, side: Literal["reference", "target"], info: RasterInfo
) -> Array:
    """Return px of a raster; raise where most of the points lie outside of it."""
    readings = _readings(points, side, info)
    for found_px in readings:
        if _inside(found_px, info):
            return found_px
    exchanged = any(_inside(found_px, info) for found_px in _readings(swapped(points, side), side, info))
    values = points.reference if side == "reference" else points.target
    low, high = values.min(axis=0), values.max(axis=0)
    given = f" ({name_of(points.crs)} by its first line)" if points.crs is not None else ""
    raise InputError(
        f"{path}: most of the {side} positions, x {low[0]:.10g} to {high[0]:.10g} and y {low[1]:.10g} to "
        f"{high[1]:.10g}{given}, lie outside of {info.uri}: "
        + (
            "its columns x and y look exchanged: exchange them"
            if exchanged
            else "the file is of other rasters, in another CRS, or its columns are exchanged"
        )
    )


def _readings(points: PointFile, side: Literal["reference", "target"], info: RasterInfo) -> list[Array]:
    """Return the px that one side of the points may mean, the likeliest first."""
    if side == "reference":
        if points.reference_in == "px":
            return [points.reference]
        return [_from_map(points, info)]
    if points.target_in == "px":
        return [points.target]
    # QGIS: layer coordinates of a georeferenced source, (col, -row) of any other, and of this one by
    # programs that do not know the difference.
    # One with RPC has no layer coordinates.
    plane = points.target * [1.0, -1.0]
    on_map = info.georeferenced and not isinstance(info.grid, RpcGrid)
    return [info.grid.to_px(points.target), plane] if on_map else [plane]


def _from_map(points: PointFile, info: RasterInfo) -> Array:
    if not info.georeferenced:
        if points.crs is not None:
            raise InputError(
                f"the tie points are in {name_of(points.crs)}, and {info.uri} has no georeferencing: give "
                "the raster they were taken on, or georeference it"
            )
        return points.reference * [1.0, -1.0]
    return info.grid.to_px(transform_xy(points.reference, points.crs or info.grid.crs, info.grid.crs))


def _inside(px: Array, info: RasterInfo) -> bool:
    size = np.array(info.grid.shape[::-1], dtype=np.float64)
    inside = ((px >= -MARGIN * size) & (px <= (1 + MARGIN) * size)).all(axis=1)
    return bool(inside.mean() >= LEAST_INSIDE)


def _check_against_itself(
    path: Path | str, points: PointFile, reference_px: Array, target_px: Array, pair: ViewPair
) -> None:
    """Raise where columns that say the same twice contradict one another on this pair."""
    if points.xy is not None:
        grid = pair.reference.info.grid
        apart = points.xy - ground_xy(reference_px, pair)
        in_px = np.asarray(grid.to_px(points.xy) - reference_px) if grid.located else apart
        _check_same(path, in_px, "x, y and ref_col, ref_row", pair.reference.info)
    if points.displacement_px is not None:
        apart = target_px - points.displacement_px - predict_target_px(reference_px, pair)
        _check_same(path, apart, "d_col, d_row and tgt_col, tgt_row", pair.target.info)


def _check_same(path: Path | str, apart_px: Array, columns: str, info: RasterInfo) -> None:
    size_px = np.linalg.norm(apart_px, axis=1)
    size_px = size_px[np.isfinite(size_px)]
    if len(size_px) and np.median(size_px) > OTHER_PX:
        raise InputError(
            f"{path}: its columns {columns} differ by {np.median(size_px):.1f} px on {info.uri}: columns "
            "are exchanged, or the file is of another raster or CRS; give the pair it was made from, or "
            "leave out the columns that do not hold"
        )
