"""The grid two bands are matched on: own pixels wherever possible, else the finer on the coarser's grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_pixel_ratio
from pcwlad_geo.raster.crs import name_of, transform_xy, transformation_warnings
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.view import Resampling, View
from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]

MARGIN_PX = 64
"""How far a resampled view reaches beyond the overlap."""
_SAME_SIZE_PX = 0.01  # what differing pixel sizes may add up to over the overlap
_SAME_COORDINATES_PX = 0.001
_FINER = 0.99  # the reference counts as finer below this ratio of the pixel sizes
# File px per matching-grid px from which area averages are used. Below it their cells' edges, which fall
# anywhere in a pixel, would shake the image by more than 0.02 px, from pixel to pixel.
_AVERAGE_FROM = 2.0 - 1e-6


@dataclass(frozen=True, slots=True)
class ViewPair:
    """Two bands on pixels of the same size and axes.

    Predicted target-view px = reference-view px + `offset_px`.
    """

    reference: View
    target: View
    offset_px: tuple[float, float]
    """(col, row)."""
    overlap: Window
    """What the target covers of the reference by georeferencing: bounding box, reference-view px."""
    warnings: tuple[str, ...]

    @property
    def georeferenced(self) -> bool:
        """Whether both are: otherwise their pixels are compared as they lie."""
        return self.reference.info.georeferenced and self.target.info.georeferenced


def plan_views(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    """Decide on which grid two bands are matched.

    - Equal pixel sizes, axes and CRS: nothing is resampled, the grids' sub-pixel offset is kept as a number.
    - One of them flipped (south-up): its own pixels in the other's order.
    - One coarser, same axes and CRS: the coarser's own pixels, the finer averaged onto them.
    - Rotated, another CRS, or sizes that differ a little: the finer (the target where they are about
      equal) interpolated once onto the coarser's grid.
    - Either without georeferencing: both as they are.

    Raises
    ------
    InputError
        If the two do not overlap, or their CRSs cannot be transformed into one another.
    """
    if not (reference.georeferenced and target.georeferenced):
        return _plan_by_pixels(reference, target)
    warnings = transformation_warnings(reference.grid.crs, target.grid.crs)
    common = _overlap(reference, target)
    steps = jacobian(_centre(common), reference.grid, target.grid)[0]
    check_pixel_ratio(reference.uri, target.uri, np.linalg.svd(steps, compute_uv=False).tolist())
    own = _plan_own_pixels(reference, target, common, warnings)
    return own or _plan_resampled(reference, target, common, warnings)


def _plan_by_pixels(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    lacking = [info.uri for info in (reference, target) if not info.georeferenced]
    warning = (
        f"no georeferencing that the two share (CRS and geotransform) in {' and '.join(lacking)}: pixels "
        "compared as they lie"
    )
    return ViewPair(
        _own(reference),
        _own(target),
        (0.0, 0.0),
        Window.whole(reference.grid.shape).clipped(target.grid.shape),
        (warning,),
    )


def _own(info: RasterInfo) -> View:
    return View(info, info.grid, "none")


def _plan_own_pixels(
    reference: RasterInfo, target: RasterInfo, common: shapely.Geometry, warnings: tuple[str, ...]
) -> ViewPair | None:
    """Plan for grids that differ by a shift and the direction of axes only."""
    scale = _axis_scale(reference.grid, target.grid, common)
    if scale is None:
        return None
    signs = np.sign(scale)
    left, top, right, bottom = common.bounds
    if np.max(np.abs(scale - signs) * [right - left, bottom - top]) > _SAME_SIZE_PX:
        return None
    view = _own(target) if (signs > 0).all() else View(target, _flipped(target.grid, signs), "nearest")
    centre = _centre(common)
    offset = (map_px(centre, reference.grid, view.grid) - centre)[0]
    # Whole-pixel offsets stay whole: map coordinates carry rounding errors.
    nearest = np.rint(offset)
    col, row = np.where(np.abs(offset - nearest) < 1e-6, nearest, offset).tolist()
    overlap = _window_around(common).clipped(reference.grid.shape)
    return ViewPair(_own(reference), view, (col, row), overlap, warnings)


def _plan_resampled(
    reference: RasterInfo, target: RasterInfo, common: shapely.Geometry, warnings: tuple[str, ...]
) -> ViewPair:
    """Plan for one of the two on its own pixels, the other resampled onto them."""
    matrix = jacobian(_centre(common), reference.grid, target.grid)[0]
    if np.sqrt(abs(np.linalg.det(matrix))) < _FINER:
        box = _window_around(_mapped(common, reference.grid, target.grid))
        view = _resampled(reference, target.grid, box, common)
        overlap = box.clipped(target.grid.shape).moved(MARGIN_PX - box.row, MARGIN_PX - box.col)
        offset = (float(box.col - MARGIN_PX), float(box.row - MARGIN_PX))
        return ViewPair(view, _own(target), offset, overlap, warnings)
    box = _window_around(common)
    view = _resampled(target, reference.grid, box, common)
    offset = (float(MARGIN_PX - box.col), float(MARGIN_PX - box.row))
    return ViewPair(_own(reference), view, offset, box.clipped(reference.grid.shape), warnings)


def _resampled(finer: RasterInfo, coarser: Grid, box: Window, common: shapely.Geometry) -> View:
    """Return the finer band on the coarser's own grid, around the overlap only."""
    around = box.padded(MARGIN_PX)
    grid = coarser.part((around.col, around.row), around.shape)
    scale = _axis_scale(grid, finer.grid, shapely.box(0, 0, grid.shape[1], grid.shape[0]))
    averaged = scale is not None and np.abs(scale).min() >= _AVERAGE_FROM
    resampling: Resampling = "average" if averaged else "cubic"
    return View(finer, grid, resampling)


def _axis_scale(from_grid: Grid, to_grid: Grid, common: shapely.Geometry) -> Array | None:
    """(2,): signed px of one grid per px of the other along columns and rows; None where the axes differ."""
    if not _same_coordinates(from_grid, to_grid, common):
        return None
    matrix = np.linalg.inv(linear_part(to_grid.transform)) @ linear_part(from_grid.transform)
    left, top, right, bottom = common.bounds
    skew_px = max(abs(matrix[0, 1]) * (bottom - top), abs(matrix[1, 0]) * (right - left))
    return None if skew_px > _SAME_SIZE_PX else np.diagonal(matrix).copy()


def _same_coordinates(from_grid: Grid, to_grid: Grid, common: shapely.Geometry) -> bool:
    """Whether both CRSs give the ground the same x and y: equal, or different in name only."""
    if from_grid.crs == to_grid.crs:
        return True
    dense = shapely.get_coordinates(shapely.segmentize(common, max(common.length / 64, 1.0)))
    as_if_equal = to_grid.to_px(from_grid.to_xy(dense))
    return bool(np.abs(map_px(dense, from_grid, to_grid) - as_if_equal).max() <= _SAME_COORDINATES_PX)


def _flipped(grid: Grid, signs: Array) -> Grid:
    rows, cols = grid.shape
    origin = (cols if signs[0] < 0 else 0, rows if signs[1] < 0 else 0)
    return grid.remade(((float(signs[0]), 0.0), (0.0, float(signs[1]))), origin, grid.shape)


def _overlap(reference: RasterInfo, target: RasterInfo) -> shapely.Geometry:
    """Return what both rasters cover, a polygon in reference px."""
    footprint = _footprint(target.grid, reference.grid)
    if footprint is not None:
        common = footprint.intersection(_rectangle(reference.grid))
    else:  # the target is larger than the reference's projection can show: look from the other side
        seen = _footprint(reference.grid, target.grid)
        if seen is None:
            raise InputError(
                f"cannot transform between {name_of(reference.grid.crs)} of {reference.uri} and "
                f"{name_of(target.grid.crs)} of {target.uri} where the rasters lie: check both CRSs"
            )
        common = _mapped(seen.intersection(_rectangle(target.grid)), target.grid, reference.grid)
    if common.area < 1.0:
        raise InputError(
            f"the rasters do not overlap: in {_plane(reference.grid)}, {reference.uri} covers "
            f"{_extent(reference.grid, reference.grid)} and {target.uri} covers "
            f"{_extent(target.grid, reference.grid)}: "
            "give two rasters of the same ground, or correct their georeferencing"
            + ("" if reference.grid.crs else " (gdal_edit.py -unsetgt removes it)")
        )
    return common


def _plane(grid: Grid) -> str:
    return name_of(grid.crs) if grid.crs else "the plane of their geotransforms"


def _footprint(grid: Grid, onto: Grid) -> shapely.Geometry | None:
    """Return the outline of a raster in another grid's px; None where that CRS cannot show all of it."""
    outline = grid.boundary_px()
    mapped = map_px(outline, grid, onto)
    if not np.isfinite(mapped).all():
        return None
    back = map_px(mapped, onto, grid)
    polygon = shapely.Polygon(mapped)
    # Beyond its domain a projection may fold: the way back then ends elsewhere.
    if not np.allclose(back, outline, rtol=0, atol=0.5) or not polygon.is_valid:
        return None
    return polygon


def _rectangle(grid: Grid) -> shapely.Geometry:
    rows, cols = grid.shape
    return shapely.box(0, 0, cols, rows)


def _mapped(polygon: shapely.Geometry, from_grid: Grid, to_grid: Grid) -> shapely.Geometry:
    """Map a polygon, with points along its sides so that they may bend."""
    if polygon.is_empty:
        return polygon
    left, top, right, bottom = polygon.bounds
    dense = shapely.segmentize(polygon, max(right - left, bottom - top) / 32)
    return shapely.transform(dense, lambda points_px: map_px(points_px, from_grid, to_grid))


def _centre(polygon: shapely.Geometry) -> Array:
    point = polygon.representative_point()
    return np.array([[point.x, point.y]])


def _window_around(polygon: shapely.Geometry) -> Window:
    left, top, right, bottom = polygon.bounds
    # A millionth of a pixel is rounding, not a row more.
    return Window.from_bounds(
        int(np.floor(top + 1e-6)),
        int(np.floor(left + 1e-6)),
        int(np.ceil(bottom - 1e-6)),
        int(np.ceil(right - 1e-6)),
    )


def _extent(grid: Grid, onto: Grid) -> str:
    """Return the extent of a raster in another's CRS, in words."""
    xy = transform_xy(grid.to_xy(grid.boundary_px()), grid.crs, onto.crs)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if len(xy) == 0:
        return "ground far outside of it"
    (left, bottom), (right, top) = xy.min(axis=0), xy.max(axis=0)
    return f"x {left:.10g} to {right:.10g}, y {bottom:.10g} to {top:.10g}"
