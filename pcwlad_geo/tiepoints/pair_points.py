"""Tie points of a file on a pair: which interpretation of its columns lies on the rasters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import RasterInfo, RpcGrid, ViewPair, transform_xy
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.tiepoints.format import PointFile
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import (
    TiePointTable,
    ground_xy,
    place,
    predict_target_px,
)
from pcwlad_geo.types import Float64

MARGIN: Final = 0.1
"""Distance outside the raster, as a share of its size, at which points still count as on it."""
OTHER_PX: Final = 0.5
"""Tolerated difference of redundant columns, px; a larger one indicates other rasters."""


def read_tie_points(path: Path | str, pair: ViewPair, *, as_stated: bool = False) -> TiePointTable:
    """Read a file of tie points for a pair, in one of the formats of `read_point_file`.

    Map coordinates without a CRS are taken to be in the reference's. The statuses of the table are those that
    the file states if `as_stated`, or else ``matched``, ``rejected`` where it disables a point; the
    covariance is NaN without a sigma in the file, the score 1 without one. Raises `InputError` if the file
    cannot be read, or most points are outside a raster, as with swapped columns, another CRS or other
    rasters.
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
    covariance_px2 = sigma_px[:, :, None] * sigma_px[:, None, :]
    correlation = np.zeros(count) if points.correlation is None else points.correlation
    covariance_px2[:, [0, 1], [1, 0]] *= correlation[:, None]
    score = np.ones(count) if points.score is None else np.nan_to_num(points.score, nan=1.0)
    table = place(reference_px, target_px, covariance_px2, score, pair)
    if not np.isfinite(table.predicted_px).all():
        if isinstance(target.grid, RpcGrid):
            raise InputError(f"{path}: some points lie where the DEM has no height: remove them")
        raise InputError(
            f"{path}: some points lie where {name_of(reference.grid.crs)} cannot be transformed to "
            f"{name_of(target.grid.crs)}: remove them"
        )
    status = np.where(points.enabled, "matched", "rejected").astype("<U8")
    return replace(table, status=points.status if as_stated and points.status is not None else status)


def swapped(points: PointFile, side: Literal["reference", "target"]) -> PointFile:
    """Return `points` with x and y of one `side` exchanged."""
    if side == "reference":
        return replace(points, reference=points.reference[:, ::-1])
    return replace(points, target=points.target[:, ::-1])


def _on_raster(
    path: Path | str, points: PointFile, side: Literal["reference", "target"], info: RasterInfo
) -> Float64:
    """Return (n, 2) px (col, row) of a raster; raise if most of the points are outside of it."""
    readings = _readings(points, side, info)
    for found_px in readings:
        if _inside(found_px, info):
            return found_px
    exchanged = any(_inside(found_px, info) for found_px in _readings(swapped(points, side), side, info))
    values = points.reference if side == "reference" else points.target
    low, high = values.min(axis=0), values.max(axis=0)
    crs_text = f" ({name_of(points.crs)} by its first line)" if points.crs is not None else ""
    raise InputError(
        f"{path}: most of the {side} positions, x {low[0]:.10g} to {high[0]:.10g} and y {low[1]:.10g} to "
        f"{high[1]:.10g}{crs_text}, lie outside of {info.uri}: "
        + (
            "its columns x and y look exchanged: exchange them"
            if exchanged
            else "the file is of other rasters, in another CRS, or its columns are exchanged"
        )
    )


def _readings(points: PointFile, side: Literal["reference", "target"], info: RasterInfo) -> list[Float64]:
    """Return the possible (n, 2) px of one side of the points, the most likely interpretation first."""
    if side == "reference":
        if points.reference_in == "px":
            return [points.reference]
        return [_from_map(points, info)]
    if points.target_in == "px":
        return [points.target]
    # QGIS: layer coordinates of a georeferenced source, (col, -row) of any other, and of either by
    # programs that do not distinguish them.
    # A source with an RPC has no layer coordinates.
    info = info.as_in_file()
    plane = points.target * [1.0, -1.0]
    return [info.grid.to_px(points.target), plane] if info.on_map else [plane]


def _from_map(points: PointFile, info: RasterInfo) -> Float64:
    if not info.georeferenced:
        if points.crs is not None:
            raise InputError(
                f"the tie points are in {name_of(points.crs)}, and {info.uri} has no georeferencing: give "
                "the raster they were taken on, or georeference it"
            )
        return points.reference * [1.0, -1.0]
    return info.grid.to_px(transform_xy(points.reference, points.crs or info.grid.crs, info.grid.crs))


def _inside(px: Float64, info: RasterInfo) -> bool:
    size = np.array(info.grid.shape[::-1], dtype=np.float64)
    inside = ((px >= -MARGIN * size) & (px <= (1 + MARGIN) * size)).all(axis=1)
    return bool(inside.mean() >= 0.5)


def _check_against_itself(
    path: Path | str, points: PointFile, reference_px: Float64, target_px: Float64, pair: ViewPair
) -> None:
    """Raise if redundant columns contradict each other for this pair."""
    with np.errstate(over="ignore", invalid="ignore"):  # 1e308 contradicts like any other number
        if points.xy is not None:
            grid = pair.reference.info.grid
            difference = points.xy - ground_xy(reference_px, pair)
            in_px = np.asarray(grid.to_px(points.xy) - reference_px) if grid.located else difference
            _check_same(path, in_px, "x, y and ref_col, ref_row", pair.reference.info)
        if points.displacement_px is not None:
            difference = target_px - points.displacement_px - predict_target_px(reference_px, pair)
            _check_same(path, difference, "d_col, d_row and tgt_col, tgt_row", pair.target.info)


def _check_same(path: Path | str, difference_px: Float64, columns: str, info: RasterInfo) -> None:
    size_px = np.linalg.norm(difference_px, axis=1)
    size_px = size_px[np.isfinite(size_px)]
    if len(size_px) and np.median(size_px) > OTHER_PX:
        raise InputError(
            f"{path}: its columns {columns} differ by {np.median(size_px):.1f} px on {info.uri}: columns "
            "are exchanged, or the file is of another raster or CRS; give the pair it was made from, or "
            "leave out the columns that do not hold"
        )
