"""The correction as a grid of offsets that PROJ takes (Geodetic TIFF grid), with which any layer moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyproj
import rasterio
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid
from pcwlad_geo.types import Float64

DEGREE_BANDS: Final = ("latitude_offset", "longitude_offset")
"""Names that PROJ knows for the bands of a grid in degrees; latitudes come first."""
MAP_BANDS: Final = ("easting_offset", "northing_offset")
"""Those of a grid in the units of a projected CRS."""
AXIS_SWAP: Final = "+proj=axisswap +order=2,1"
"""The step that swaps east and north."""


@dataclass(frozen=True, slots=True)
class ProjGridParameters:
    """How fine the grid is."""

    tolerance_px: float = 0.01
    """Largest error of PROJ's bilinear interpolation between nodes, target px."""
    widest_px: float = 64.0
    """Spacing of the nodes of a correction that bends little, target px."""
    narrowest_px: float = 4.0
    """Spacing that is not refined further, target px."""
    margin_px: float = 64.0
    """Width beyond the target that the grid covers, target px: what lies across its border moves, too."""


def write_proj_grid(
    path: Path,
    correction: Correction,
    target: Grid,
    parameters: ProjGridParameters | None = None,
    *,
    is_inverse: bool = False,
) -> None:
    """Write the offsets from where the target draws a place to where it belongs, in the target's CRS.

    The inverse grid, from where a place belongs to where the target draws it, serves to warp rasters. PROJ
    would find it from the first one by iteration, which fails for a pixel in a thousand of a projected CRS
    (seen with PROJ 9.5, 9.7 and 9.9). A grid is laid north up over the target. Its nodes are so near that
    PROJ's bilinear interpolation is right to a hundredth of a pixel. Raises `InputError` if the target has
    no CRS.
    """
    if target.crs is None:
        raise InputError("--write-proj-grid: the target has no CRS, and PROJ moves map coordinates only")
    parameters = parameters or ProjGridParameters()
    spacing_px = parameters.widest_px
    move = correction.forward if is_inverse else correction.inverse
    while True:
        place, shape = _nodes(target, spacing_px, parameters.margin_px)
        offsets = _offsets(move, target, _positions(place, shape))
        fewer = shape[0] - 1, shape[1] - 1
        halfway = _offsets(move, target, _positions(place @ Affine.translation(0.5, 0.5), fewer))
        values = offsets.reshape(*shape, 2)
        between = (values[:-1, :-1] + values[:-1, 1:] + values[1:, :-1] + values[1:, 1:]) / 4
        error = np.abs(halfway.reshape(between.shape) - between) / _pixel_size(target)
        if spacing_px <= parameters.narrowest_px or np.nanmax(error, initial=0.0) <= parameters.tolerance_px:
            break
        spacing_px /= 2
    pipelines = {
        tag: proj_pipeline(path.name, target.crs, is_inverse=is_inverse, is_for_gdal=is_for_gdal)
        for tag, is_for_gdal in (("pipeline", False), ("gdal_pipeline", True))
    }
    _write(path, np.nan_to_num(values), place, target.crs, pipelines)


def proj_pipeline(path: str, crs: CRS, *, is_inverse: bool = False, is_for_gdal: bool = False) -> str:
    """Return the PROJ pipeline that corrects map coordinates of a CRS by a grid, or an inverse grid.

    It takes east first. GDAL (``gdalwarp -ct``, ``ogr2ogr -ct``) hands coordinates over in the order of the
    CRS's axes, which is north first for EPSG:4326 and for some projected CRSs.
    """
    grids = f'+grids="{path}"' if " " in path else f"+grids={path}"
    inverse = "+inv " if is_inverse else ""
    steps = [f"{inverse}+proj=gridshift {grids}"]
    if crs.is_geographic:
        to_rad, to_deg = (
            f"+proj=unitconvert +xy_in={a} +xy_out={b}" for a, b in (("deg", "rad"), ("rad", "deg"))
        )
        steps = [to_rad, f"{inverse}+proj=hgridshift {grids}", to_deg]
    if is_for_gdal and _gdal_swaps_axes(crs):
        steps = [AXIS_SWAP, *steps, AXIS_SWAP]
    return " ".join(["+proj=pipeline", *(f"+step {step}" for step in steps)])


def _gdal_swaps_axes(crs: CRS) -> bool:
    """Return whether GDAL puts north first: for CRSs of EPSG only, and not where both axes point north."""
    described = pyproj.CRS.from_wkt(crs.to_wkt())
    directions = [axis.direction for axis in described.axis_info[:2]]
    return described.to_authority("EPSG") is not None and directions == ["north", "east"]


def _pixel_size(grid: Grid) -> Float64:
    """Return the (2,) extent of a pixel along the axes of the map, map units."""
    place = grid.transform
    return np.hypot([place.a, place.d], [place.b, place.e])


def _nodes(target: Grid, spacing_px: float, margin_px: float) -> tuple[Affine, tuple[int, int]]:
    """Return the place of the nodes (at whole pixels) of a grid that lies north up over the target."""
    rows, cols = target.shape
    low, high = np.array([-margin_px, -margin_px]), np.array([cols + margin_px, rows + margin_px])
    xy = target.to_xy(np.array([low, (low[0], high[1]), high, (high[0], low[1])]))
    step = spacing_px * _pixel_size(target)
    count = np.maximum(np.ceil((xy.max(axis=0) - xy.min(axis=0)) / step).astype(int) + 1, 2)
    place = Affine(float(step[0]), 0, float(xy[:, 0].min()), 0, -float(step[1]), float(xy[:, 1].max()))
    return place, (int(count[1]), int(count[0]))


def _positions(place: Affine, shape: tuple[int, int]) -> Float64:
    """Return the (rows · cols, 2) map coordinates of nodes, row by row."""
    col_row = positions(np.arange(shape[1], dtype=float), np.arange(shape[0], dtype=float))
    return Grid(shape, place, None).to_xy(col_row)


def _offsets(move: Callable[[Float64], Float64], target: Grid, xy: Float64) -> Float64:
    """Return the (n, 2) map units by which (n, 2) places on the target's map move."""
    return target.to_xy(move(target.to_px(xy))) - xy


def _write(path: Path, values: Float64, place: Affine, crs: CRS, pipelines: dict[str, str]) -> None:
    names, unit, bands = MAP_BANDS, "metre", values
    if crs.is_geographic:
        names, unit, bands = DEGREE_BANDS, "degree", values[..., ::-1]
    rows, cols = values.shape[:2]
    profile = {
        "driver": "GTiff",
        "width": cols,
        "height": rows,
        "count": 2,
        "dtype": "float32",
        "crs": crs,
        "transform": place @ Affine.translation(-0.5, -0.5),
        "compress": "deflate",
        "predictor": 3,
        "interleave": "band",
    }
    tags = {
        "AREA_OR_POINT": "Point",
        "TYPE": "HORIZONTAL_OFFSET",
        "TIFFTAG_IMAGEDESCRIPTION": "Correction of a raster: from where it draws a place to where it belongs",
        "TIFFTAG_COPYRIGHT": "As the rasters from which it was made",
        "area_of_use": "The raster that was registered, and its surroundings",
    } | pipelines
    for which in ("source_crs", "target_crs", "interpolation_crs"):
        code = crs.to_epsg()
        tags |= {f"{which}_wkt": crs.to_wkt()} if code is None else {f"{which}_epsg_code": str(code)}
    with rasterio.open(path, "w", **profile) as file:
        file.update_tags(**tags)
        for band, name in enumerate(names, start=1):
            file.write(bands[..., band - 1].astype(np.float32), band)
            file.set_band_description(band, name)
            file.set_band_unit(band, unit)
        if crs.is_geographic:
            file.update_tags(2, positive_value="east")
