"""Vectors in memory that follow a correction: the geometries of a GeoDataFrame."""

from __future__ import annotations

from typing import Any

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.correction.precision import Precision
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.report.finished import FinishedRegistration
from pcwlad_geo.vector_warping import SIGMA_FIELD, Movement, in_metres, moved_shapes


def is_vector_frame(value: object) -> bool:
    """Return whether this is a GeoDataFrame or a GeoSeries of GeoPandas, which need not be installed."""
    return all(hasattr(value, name) for name in ("geometry", "crs", "to_crs", "sindex"))


def warp_frame(
    frame: Any,  # noqa: ANN401  # of GeoPandas, which has no types
    registration: FinishedRegistration,
    *,
    is_inverse: bool,
    precision: Precision | None,
    on_event: EventCallback,
) -> Any:  # noqa: ANN401
    """Return a GeoDataFrame or GeoSeries whose vertices are moved by a registration; the rest stays.

    With a `precision`, the column ``sigma_m`` is the largest standard deviation of the correction, along an
    axis, at the vertices of each row, metres.
    """
    crs = _crs_of(frame, registration)
    told_m = None if precision is None else in_metres(precision, registration.target_grid)
    movement = Movement(registration, crs, is_inverse, precision=told_m)
    shapes = np.array(frame.geometry, dtype=object)
    moved_geometry, sigma_m = moved_shapes(shapes, movement, "the GeoDataFrame", on_event)
    moved = type(frame.geometry)(moved_geometry, index=frame.index, crs=frame.crs)
    if frame is frame.geometry or not hasattr(frame, "set_geometry"):
        if precision is not None:
            raise InputError("sigma_m is a column, which a GeoSeries has none of: give a GeoDataFrame")
        return moved
    warped = frame.set_geometry(moved)
    if precision is not None:
        warped[SIGMA_FIELD] = sigma_m
    return warped


def _crs_of(frame: Any, registration: FinishedRegistration) -> CRS | None:  # noqa: ANN401
    """Return the CRS of a frame; None where neither it nor the target has one."""
    target = registration.target_grid.crs
    if registration.rpc is not None:
        raise InputError(
            "the target has RPCs, whose correction needs the height of every vertex: digitise on the "
            "orthorectified raster instead"
        )
    if (frame.crs is None) != (target is None):
        raise InputError(
            "the GeoDataFrame has no CRS: assign it (set_crs)"
            if frame.crs is None
            else "the GeoDataFrame has a CRS and the target has none: give vectors in the target's pixels, "
            "without a CRS (set_crs(None, allow_override=True))"
        )
    return None if frame.crs is None else CRS.from_wkt(frame.crs.to_wkt())
