"""The grid that a pair is matched on: common longitudes, a common plane, pixels of one size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely
from affine import Affine

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.limits import check_pixel_ratio
from pcwlad_geo.raster.crs import name_of, transform_xy, transformation_warnings
from pcwlad_geo.raster.grid import Grid, TiltedGrid, Window, jacobian, linear_part, map_px
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.view import View, ViewResampling
from pcwlad_geo.types import Float64

TURN: float = 360.0
"""Degrees of longitude around the earth: 180.04 and -179.96 are the same meridian."""


def moved_across_antimeridian(reference: RasterInfo, target: RasterInfo) -> RasterInfo:
    """Return the reference with 360 degrees added to or subtracted from its longitudes, nearest the target's.

    A reference whose CRS is not in degrees is returned unchanged. The reference is moved rather than the
    target because no output is made of its pixels: the outputs have the longitudes of the target. Raises
    `InputError` if the reference would have to be moved and its mask has another grid.
    """
    crs = reference.grid.crs
    if crs is None or target.grid.crs is None or not crs.is_geographic:
        return reference
    if not crs.units_factor[0].lower().startswith("degree"):
        return reference
    middle = transform_xy(target.grid.to_xy(target.grid.middle_px), target.grid.crs, crs)
    difference = float(middle[0, 0] - reference.grid.to_xy(reference.grid.middle_px)[0, 0])
    turns = round(difference / TURN) if np.isfinite(difference) else 0
    if turns == 0:
        return reference
    mask = reference.mask_grid
    if mask is not None and mask.crs is not None and mask != reference.grid:
        raise InputError(
            f"{reference.uri} and {target.uri} count longitudes differently across 180 degrees, and the mask "
            f"{reference.mask_uri} has other pixels than {reference.uri}: give a mask of the same pixels"
        )
    a, b, c, d, e, f = tuple(reference.grid.transform)[:6]
    moved = replace(reference.grid, transform=Affine(a, b, c + turns * TURN, d, e, f))
    return replace(reference, grid=moved, mask_grid=moved if mask == reference.grid else mask)


MIN_SHARED: Final = 0.1
"""Share of the smaller extent within the other from which coordinates are taken to be in the other's CRS."""


def share_plane(reference: RasterInfo, target: RasterInfo) -> tuple[RasterInfo, RasterInfo, tuple[str, ...]]:
    """Give grids to rasters whose geotransform has no CRS.

    - Neither has a CRS: both geotransforms are taken to be in one plane of unknown units.
    - One has a CRS, and the other's extent overlaps it: the other is taken to be in that CRS.
    - Otherwise both are unchanged.

    Returned are both with their new grids, and warnings of the assumptions made.
    """
    if reference.plane_transform is not None and target.plane_transform is not None:
        warning = (
            f"neither {reference.uri} nor {target.uri} has a CRS: their geotransforms are taken to be in one "
            "plane, and metres are not known; assign both their CRS (gdal_edit.py -a_srs) to have them"
        )
        return _placed(reference, None), _placed(target, None), (warning,)
    for lacking, other in ((reference, target), (target, reference)):
        grid = grid_on_plane_of(lacking, other.grid)
        if grid.crs is not None and not lacking.georeferenced:
            warning = (
                f"{lacking.uri} has a geotransform and no CRS: it is taken to be in {name_of(grid.crs)} as "
                f"{other.uri}, where its coordinates lie; assign it its CRS (gdal_edit.py -a_srs)"
            )
            found = _placed(lacking, grid)
            return (found, target, (warning,)) if lacking is reference else (reference, found, (warning,))
    return reference, target, ()


def grid_on_plane_of(info: RasterInfo, grid: Grid) -> Grid:
    """Return the grid of a raster, its geotransform without a CRS taken to be in the plane of another grid.

    This is the raster's own grid where it has no such geotransform, the other grid has no map coordinates,
    or the two do not overlap.
    """
    if info.plane_transform is None or info.georeferenced or not grid.located:
        return info.grid
    own = Grid(info.grid.shape, info.plane_transform, grid.crs)
    extents = [shapely.Polygon(each.to_xy(each.boundary_px())) for each in (own, grid)]
    least = min(extent.area for extent in extents)
    shared = extents[0].intersection(extents[1]).area
    return own if shared >= MIN_SHARED * least > 0 else info.grid


def _placed(info: RasterInfo, grid: Grid | None) -> RasterInfo:
    if grid is None and info.plane_transform is not None:
        grid = Grid(info.grid.shape, info.plane_transform, None)
    return replace(info, grid=grid or info.grid, georeferenced=True)


MARGIN_PX = 64
"""Margin of a resampled view around the overlap."""
EXTENT_MARGIN_PX = 256
"""Margin of the target around an extent, for its displacement, matching-grid px."""
_SAME_SIZE_PX = 0.01  # what differing pixel sizes may add up to over the overlap
FINER: Final = 0.99
"""The reference counts as finer below this ratio of the pixel sizes."""
# File px per matching-grid px from which area averages are used. Below it the edges of the cells, which fall
# anywhere in a pixel, would displace the image by more than 0.02 px, varying from pixel to pixel.
_AVERAGE_FROM = 2.0 - 1e-6


@dataclass(frozen=True, slots=True)
class ViewPair:
    """Two bands on pixels of the same size and axes.

    Predicted target-view px = reference-view px + `offset_px`.
    """

    reference: View
    target: View
    offset_px: tuple[float, float]
    """Offset (col, row), px."""
    overlap: Window
    """Bounding box of the overlap by georeferencing, reference-view px."""
    warnings: tuple[str, ...]

    @property
    def georeferenced(self) -> bool:
        """Whether both rasters are georeferenced; otherwise they are compared by pixel coordinates."""
        return self.reference.info.georeferenced and self.target.info.georeferenced


def plan_views(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    """Choose the grid that two bands are matched on.

    - Equal pixel sizes, axes and CRS: nothing is resampled, the grids' sub-pixel offset is recorded.
    - One of them flipped (south-up): its own pixels in the other's order.
    - One coarser, same axes and CRS: the coarser band's own pixels, the finer band averaged onto them.
    - Rotated, another CRS, or slightly different sizes: the finer band (the target where they are about
      equal) interpolated once onto the coarser band's grid.
    - Either without georeferencing: both on their own pixels.

    Raises `InputError` if the two do not overlap, or their CRSs cannot be transformed into one another.
    """
    if not (reference.georeferenced and target.georeferenced):
        return _plan_by_pixels(reference, target)
    warnings = transformation_warnings(reference.grid.crs, target.grid.crs)
    common = _overlap(reference, target)
    steps = jacobian(_centre(common), reference.grid, target.grid)[0]
    check_pixel_ratio(reference.uri, target.uri, np.linalg.svd(steps, compute_uv=False).tolist())
    own = _plan_own_pixels(reference, target, common, warnings)
    return own or _plan_resampled(reference, target, common, warnings)


def limited(pair: ViewPair, extent: tuple[float, float, float, float]) -> ViewPair:
    """Return the part of a pair that shows an extent; of the target with a margin for its displacement.

    Nothing else is read then. Raises `InputError` if the reference has no map coordinates or its RPCs, or
    those of the target, place the pair, or if the extent lies elsewhere. The `extent` is x_min, y_min, x_max,
    y_max in the CRS of the reference.
    """
    view, grids = pair.reference, (pair.reference.info.grid, pair.target.info.grid)
    if not pair.georeferenced or any(type(grid) is not Grid for grid in grids):
        raise InputError("--extent needs two rasters with a geotransform: leave it out, or cut the files")
    outline = shapely.segmentize(shapely.box(*extent), max(extent[2] - extent[0], extent[3] - extent[1]) / 32)
    corners_px = view.from_file_px(grids[0].to_px(shapely.get_coordinates(outline)))
    corners_px = corners_px[np.isfinite(corners_px).all(axis=1)]
    low, high = (corners_px.min(axis=0), corners_px.max(axis=0)) if len(corners_px) else (np.zeros(2),) * 2
    window = Window.around(low + 1e-6, high - 1e-6).clipped(view.grid.shape)
    col, row = np.rint(pair.offset_px).astype(int).tolist()
    around = window.moved(row, col).padded(EXTENT_MARGIN_PX).clipped(pair.target.grid.shape)
    if window.empty or around.empty:
        raise InputError(
            f"the extent x {extent[0]:.10g} to {extent[2]:.10g}, y {extent[1]:.10g} to {extent[3]:.10g} lies "
            f"outside of what both rasters show: give one in the CRS of {view.info.uri}"
        )
    offset = (pair.offset_px[0] + window.col - around.col, pair.offset_px[1] + window.row - around.row)
    covered = pair.overlap.moved(-window.row, -window.col).clipped(window.shape)
    return replace(
        pair,
        reference=_part(view, window),
        target=_part(pair.target, around),
        offset_px=offset,
        overlap=covered,
    )


def _part(view: View, window: Window) -> View:
    """Return a window of a view as a view of its own."""
    grid = view.grid.part((window.col, window.row), window.shape)
    return View(view.info, grid, "nearest" if view.resampling == "none" else view.resampling)


def _plan_by_pixels(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    lacking = [info.uri for info in (reference, target) if not info.georeferenced]
    warning = (
        f"no georeferencing that the two share (CRS and geotransform) in {' and '.join(lacking)}: only "
        "their pixels tell how the two lie"
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
    """Plan for grids that differ only by a shift and the direction of their axes."""
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
    # Whole-pixel offsets are rounded: map coordinates have rounding errors.
    nearest = np.rint(offset)
    col, row = np.where(np.abs(offset - nearest) < 1e-6, nearest, offset).tolist()
    overlap = _window_around(common).clipped(reference.grid.shape)
    return ViewPair(_own(reference), view, (col, row), overlap, warnings)


def _plan_resampled(
    reference: RasterInfo, target: RasterInfo, common: shapely.Geometry, warnings: tuple[str, ...]
) -> ViewPair:
    """Plan for one of the two on its own pixels, the other resampled onto them."""
    matrix = jacobian(_centre(common), reference.grid, target.grid)[0]
    if np.sqrt(abs(np.linalg.det(matrix))) < FINER:
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
    """Return the finer band on the coarser band's grid, limited to the overlap and a margin."""
    around = box.padded(MARGIN_PX)
    grid = coarser.part((around.col, around.row), around.shape)
    scale = _axis_scale(grid, finer.grid, shapely.box(0, 0, grid.shape[1], grid.shape[0]))
    averaged = scale is not None and np.abs(scale).min() >= _AVERAGE_FROM
    resampling: ViewResampling = "average" if averaged else "cubic"
    return View(finer, grid, resampling)


def _axis_scale(from_grid: Grid, to_grid: Grid, common: shapely.Geometry) -> Float64 | None:
    """Return (2,) signed px of a grid per px of another along columns and rows; None for other axes."""
    tilted = isinstance(from_grid, TiltedGrid) or isinstance(to_grid, TiltedGrid)
    if tilted or not _same_coordinates(from_grid, to_grid, common):
        return None
    matrix = inverse(linear_part(to_grid.transform)) @ linear_part(from_grid.transform)
    left, top, right, bottom = common.bounds
    skew_px = max(abs(matrix[0, 1]) * (bottom - top), abs(matrix[1, 0]) * (right - left))
    return None if skew_px > _SAME_SIZE_PX else np.diagonal(matrix).copy()


def _same_coordinates(from_grid: Grid, to_grid: Grid, common: shapely.Geometry) -> bool:
    """Whether both CRSs give the same coordinates for the same ground, under whatever name."""
    if from_grid.crs == to_grid.crs:
        return True
    dense = shapely.get_coordinates(shapely.segmentize(common, max(common.length / 64, 1.0)))
    as_if_equal = to_grid.to_px(from_grid.to_xy(dense))
    return bool(np.abs(map_px(dense, from_grid, to_grid) - as_if_equal).max() <= 0.001)


def _flipped(grid: Grid, signs: Float64) -> Grid:
    rows, cols = grid.shape
    origin = (cols if signs[0] < 0 else 0, rows if signs[1] < 0 else 0)
    return grid.resampled_grid(((float(signs[0]), 0.0), (0.0, float(signs[1]))), origin, grid.shape)


def _overlap(reference: RasterInfo, target: RasterInfo) -> shapely.Geometry:
    """Return the area that both rasters cover, a polygon in reference px."""
    footprint = _footprint(target.grid, reference.grid)
    if footprint is not None:
        common = footprint.intersection(_rectangle(reference.grid))
    else:  # the target exceeds the domain of the reference's projection: intersect in the target's CRS
        covered = _footprint(reference.grid, target.grid)
        if covered is None:
            raise InputError(
                f"cannot transform between {name_of(reference.grid.crs)} of {reference.uri} and "
                f"{name_of(target.grid.crs)} of {target.uri} where the rasters lie: check both CRSs"
            )
        common = _mapped(covered.intersection(_rectangle(target.grid)), target.grid, reference.grid)
    if common.area < 1.0:
        plane = name_of(reference.grid.crs) if reference.grid.crs else "the plane of their geotransforms"
        raise InputError(
            f"the rasters do not overlap: in {plane}, {reference.uri} covers "
            f"{_extent(reference.grid, reference.grid)} and {target.uri} covers "
            f"{_extent(target.grid, reference.grid)}: "
            "give two rasters of the same ground, or correct their georeferencing"
            + ("" if reference.grid.crs else " (gdal_edit.py -unsetgt removes it)")
        )
    return common


def _footprint(grid: Grid, onto: Grid) -> shapely.Geometry | None:
    """Return the outline of a raster in another grid's px; None where its CRS is not defined there."""
    outline = grid.boundary_px()
    mapped = map_px(outline, grid, onto)
    if not np.isfinite(mapped).all():
        return None
    back = map_px(mapped, onto, grid)
    polygon = shapely.Polygon(mapped)
    # Outside its domain a projection may fold: mapping back then gives another point.
    if not np.allclose(back, outline, rtol=0, atol=0.5) or not polygon.is_valid:
        return None
    return polygon


def _rectangle(grid: Grid) -> shapely.Geometry:
    rows, cols = grid.shape
    return shapely.box(0, 0, cols, rows)


def _mapped(polygon: shapely.Geometry, from_grid: Grid, to_grid: Grid) -> shapely.Geometry:
    """Map a polygon, its sides densified so that they may become curves."""
    if polygon.is_empty:
        return polygon
    left, top, right, bottom = polygon.bounds
    dense = shapely.segmentize(polygon, max(right - left, bottom - top) / 32)
    return shapely.transform(dense, lambda points_px: map_px(points_px, from_grid, to_grid))


def _centre(polygon: shapely.Geometry) -> Float64:
    point = polygon.representative_point()
    return np.array([[point.x, point.y]])


def _window_around(polygon: shapely.Geometry) -> Window:
    low, high = np.array(polygon.bounds).reshape(2, 2)
    # A millionth of a pixel is a rounding error and adds no row.
    return Window.around(low + 1e-6, high - 1e-6)


def _extent(grid: Grid, onto: Grid) -> str:
    """Return the extent of a raster in another's CRS, as text for messages."""
    xy = transform_xy(grid.to_xy(grid.boundary_px()), grid.crs, onto.crs)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if len(xy) == 0:
        return "ground far outside of it"
    (left, bottom), (right, top) = xy.min(axis=0), xy.max(axis=0)
    return f"x {left:.10g} to {right:.10g}, y {bottom:.10g} to {top:.10g}"
