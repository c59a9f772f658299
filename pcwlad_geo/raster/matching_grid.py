"""The grid that a pair is matched on: a common plane, pixels of one size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.limits import check_pixel_ratio
from pcwlad_geo.raster.crs import displacement_m, name_of, transformation_warnings
from pcwlad_geo.raster.grid import Grid, Window, jacobian, linear_part, map_px
from pcwlad_geo.raster.overlap import bounds_of, common_ground, extent_text, shown_by, window_of
from pcwlad_geo.raster.source import RasterInfo, check_part, is_huge
from pcwlad_geo.raster.view import View, ViewResampling, file_px_per_px
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class MatchingGridParameters:
    """How the grid that two bands are matched on is chosen."""

    min_shared: float = 0.1
    """Share of the smaller extent within the other from which coordinates count as in the other's CRS."""
    margin_px: int = 64
    """Margin of a resampled view around the overlap."""
    extent_margin_px: int = 256
    """Margin of the target around an extent, for its displacement, matching-grid px."""
    same_size_px: float = 0.01
    """What differing pixel sizes may add up to over the overlap."""
    finer: float = 0.99
    """The reference counts as finer below this ratio of the pixel sizes."""
    alike: float = 2.0
    """Largest ratio of two pixel sizes, and of how much their lengths on the ground differ, that is about
    one."""
    average_from: float = 2.0 - 1e-6
    """File px per matching-grid px from which area averages are used. Below it the edges of the cells, which
    fall anywhere in a pixel, would displace the image by more than 0.02 px, varying from pixel to pixel."""


MATCHING_GRIDS: Final = MatchingGridParameters()
"""Those in use."""
ONLY_PIXELS: Final = "only their pixels tell how the two lie"
"""What is said of a pair without georeferencing, unless tie points are given."""


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
            info = _placed(lacking, grid)
            return (info, target, (warning,)) if lacking is reference else (reference, info, (warning,))
    return reference, target, ()


def grid_on_plane_of(info: RasterInfo, grid: Grid) -> Grid:
    """Return the grid of a raster, its geotransform without a CRS taken to be in the plane of another grid.

    This is the raster's own grid where it has no such geotransform, the other grid has no map coordinates,
    or the two do not overlap. A raster of the pixels of a grid that the user has placed lies as that does;
    raises `InputError` if it has another size.
    """
    if grid.by_hand:
        if info.grid.shape != grid.shape:
            raise InputError(
                f"{info.uri} has {info.grid.shape[1]} x {info.grid.shape[0]} pixels, and the target, which "
                f"--place has placed, {grid.shape[1]} x {grid.shape[0]}: give a raster of the same size"
            )
        return grid
    if info.plane_transform is None or info.georeferenced or not grid.located:
        return info.grid
    assumed = Grid(info.grid.shape, info.plane_transform, grid.crs)
    extents = [shapely.Polygon(candidate.to_xy(candidate.boundary_px())) for candidate in (assumed, grid)]
    least = min(extent.area for extent in extents)
    shared = extents[0].intersection(extents[1]).area
    return assumed if shared >= MATCHING_GRIDS.min_shared * least > 0 else info.grid


def _placed(info: RasterInfo, grid: Grid | None) -> RasterInfo:
    if grid is None and info.plane_transform is not None:
        grid = Grid(info.grid.shape, info.plane_transform, None)
    return replace(info, grid=grid or info.grid, georeferenced=True)


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

    @property
    def by_hand(self) -> bool:
        """Whether the user has placed the target, about where it lies."""
        return self.target.info.grid.by_hand

    @property
    def in_perspective(self) -> bool:
        """Whether one of the two may be a photograph, as nothing but a hand has placed it on a map."""
        return not self.georeferenced or self.by_hand or self.reference.info.grid.crs is None


def plan_views(reference: RasterInfo, target: RasterInfo) -> ViewPair:
    """Choose the grid that two bands are matched on.

    - Equal pixel sizes, axes and CRS: nothing is resampled, the grids' sub-pixel offset is recorded.
    - One of them flipped (south-up): its own pixels in the other's order.
    - One coarser, same axes and CRS: the coarser band's own pixels, the finer band averaged onto them.
    - Rotated, another CRS, or slightly different sizes: the finer band (the target where they are about
      equal) interpolated once onto the coarser band's grid. Where the map of one stretches or shears pixels
      that are about as large, that one is interpolated.
    - Either without georeferencing: both on their own pixels.

    Raises `InputError` if the two do not overlap, or their CRSs cannot be transformed into one another.
    """
    if not (reference.georeferenced and target.georeferenced):
        return _plan_by_pixels(reference, target)
    warnings = transformation_warnings(reference.grid.crs, target.grid.crs)
    common = _overlap(reference, target)
    steps = jacobian(_typical_place(common, reference.grid, target.grid), reference.grid, target.grid)[0]
    check_pixel_ratio(reference.uri, target.uri, np.linalg.svd(steps, compute_uv=False).tolist())
    unresampled = _plan_own_pixels(reference, target, common, warnings)
    return unresampled or _plan_resampled(reference, target, common, warnings)


def limited(pair: ViewPair, extent: tuple[float, float, float, float]) -> ViewPair:
    """Return the part of a pair that shows an extent; of the target with a margin for its displacement.

    Nothing else is read then. Raises `InputError` if the reference has no map coordinates or its RPCs, or
    those of the target, place the pair, or if the extent lies elsewhere. The `extent` is x_min, y_min, x_max,
    y_max in the CRS of the reference.
    """
    view, grids = pair.reference, (pair.reference.info.grid, pair.target.info.grid)
    if not pair.georeferenced or any(type(grid) is not Grid for grid in grids):
        raise InputError("--extent needs two rasters with a geotransform: leave it out, or cut the files")
    outline = shapely.transform(shapely.box(*extent), grids[0].to_px)
    visible = shapely.segmentize(shown_by(grids[0], outline), max(grids[0].shape) / 32)
    corners_px = view.from_file_px(shapely.get_coordinates(visible))
    corners_px = corners_px[np.isfinite(corners_px).all(axis=1)]
    low, high = (corners_px.min(axis=0), corners_px.max(axis=0)) if len(corners_px) else (np.zeros(2),) * 2
    window = Window.around(low + 1e-6, high - 1e-6).clipped(view.grid.shape)
    limits = _limited_to(pair, window)
    if limits is None:
        raise InputError(
            f"the extent x {extent[0]:.10g} to {extent[2]:.10g}, y {extent[1]:.10g} to {extent[3]:.10g} lies "
            f"outside of what both rasters show: give one in the CRS of {view.info.uri}"
        )
    return limits


def limited_to_overlap(pair: ViewPair) -> ViewPair:
    """Return the part of a pair that both rasters show, if one of them is too large to be read as a whole.

    Raises `InputError` if what is read then is still too large.
    """
    if is_huge(pair.reference.grid) or is_huge(pair.target.grid):
        pair = _limited_to(pair, pair.overlap) or pair
    for view in (pair.reference, pair.target):
        (rows, cols), whole = np.ceil(view.grid.shape * file_px_per_px(view)[::-1]), view.info.grid.shape
        check_part(view.info, (min(int(rows), whole[0]), min(int(cols), whole[1])))
    return pair


def _limited_to(pair: ViewPair, window: Window) -> ViewPair | None:
    """Return a pair whose reference view is a window of its own; None if that shows nothing of both."""
    col, row = np.rint(pair.offset_px).astype(int).tolist()
    around = window.moved(row, col).padded(MATCHING_GRIDS.extent_margin_px).clipped(pair.target.grid.shape)
    if window.empty or around.empty:
        return None
    offset = (pair.offset_px[0] + window.col - around.col, pair.offset_px[1] + window.row - around.row)
    covered = pair.overlap.moved(-window.row, -window.col).clipped(window.shape)
    return replace(
        pair,
        reference=_part(pair.reference, window),
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
        f"no georeferencing that the two share (CRS and geotransform) in {' and '.join(lacking)}: "
        f"{ONLY_PIXELS}"
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
    if np.max(np.abs(scale - signs) * [right - left, bottom - top]) > MATCHING_GRIDS.same_size_px:
        return None
    view = _own(target) if (signs > 0).all() else View(target, _flipped(target.grid, signs), "nearest")
    centre = _centre(common)
    offset = (map_px(centre, reference.grid, view.grid) - centre)[0]
    # Whole-pixel offsets are rounded: map coordinates have rounding errors.
    nearest = np.rint(offset)
    col, row = np.where(np.abs(offset - nearest) < 1e-6, nearest, offset).tolist()
    overlap = window_of(common, reference.grid, reference.grid).clipped(reference.grid.shape)
    return ViewPair(_own(reference), view, (col, row), overlap, warnings)


def _plan_resampled(
    reference: RasterInfo, target: RasterInfo, common: shapely.Geometry, warnings: tuple[str, ...]
) -> ViewPair:
    """Plan for one of the two on its own pixels, the other resampled onto them."""
    if _on_target_grid(reference.grid, target.grid, common):
        box = window_of(common, reference.grid, target.grid)
        view = _resampled(reference, target.grid, box)
        overlap = box.clipped(target.grid.shape).moved(
            MATCHING_GRIDS.margin_px - box.row, MATCHING_GRIDS.margin_px - box.col
        )
        offset = (float(box.col - MATCHING_GRIDS.margin_px), float(box.row - MATCHING_GRIDS.margin_px))
        return ViewPair(view, _own(target), offset, overlap, warnings)
    box = window_of(common, reference.grid, reference.grid)
    view = _resampled(target, reference.grid, box)
    offset = (float(MATCHING_GRIDS.margin_px - box.col), float(MATCHING_GRIDS.margin_px - box.row))
    return ViewPair(_own(reference), view, offset, box.clipped(reference.grid.shape), warnings)


def _on_target_grid(reference: Grid, target: Grid, common: shapely.Geometry) -> bool:
    """Return whether the grid of the target is the one to match on; `common` is a polygon in reference px.

    It is that of the coarser pixels. Of two in different CRSs that are about as coarse, it is that whose
    pixels have more alike sides on the ground where the other's map stretches or shears them.
    """
    at_px = _typical_place(common, reference, target)
    step = float(np.sqrt(abs(np.linalg.det(jacobian(at_px, reference, target)[0]))))
    if reference.crs != target.crs and 1 / MATCHING_GRIDS.alike < step < MATCHING_GRIDS.alike:
        everywhere_px = _places_in(common)
        reference_log, target_log = (
            np.log(_longest_by_shortest(grid, px))
            for grid, px in (
                (reference, everywhere_px),
                (target, map_px(everywhere_px, reference, target)),
            )
        )
        finite = np.isfinite(reference_log) & np.isfinite(target_log)
        excess = float((reference_log - target_log)[finite].mean()) if finite.any() else 0.0
        if abs(excess) > np.log(MATCHING_GRIDS.alike):
            return excess > 0
    return step < MATCHING_GRIDS.finer


def _longest_by_shortest(grid: Grid, at_px: Float64) -> Float64:
    """Return the (n,) ratios of the lengths on the ground of a pixel's longest and shortest directions.

    They are NaN where the grid is not defined; `at_px` is an (n, 2) array of (col, row).
    """
    corners_px = at_px[:, None] + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    xy = grid.to_xy(corners_px.reshape(-1, 2)).reshape(-1, 3, 2)
    from_xy = np.repeat(xy[:, :1], 2, axis=1).reshape(-1, 2)
    sides_m = displacement_m(from_xy, xy[:, 1:].reshape(-1, 2), grid.crs).reshape(-1, 2, 2)
    ratios = np.full(len(at_px), np.nan)
    finite = np.isfinite(sides_m).all(axis=(1, 2))
    longest, shortest = np.linalg.svd(sides_m[finite], compute_uv=False).T
    ratios[finite] = longest / np.maximum(shortest, 1e-12)
    return ratios


def _resampled(finer: RasterInfo, coarser: Grid, box: Window) -> View:
    """Return the finer band on the coarser band's grid, limited to the overlap and a margin."""
    around = box.padded(MATCHING_GRIDS.margin_px)
    grid = coarser.part((around.col, around.row), around.shape)
    area = shapely.box(
        MATCHING_GRIDS.margin_px,
        MATCHING_GRIDS.margin_px,
        MATCHING_GRIDS.margin_px + box.cols,
        MATCHING_GRIDS.margin_px + box.rows,
    )
    scale = _axis_scale(grid, finer.grid, area)
    averaged = scale is not None and np.abs(scale).min() >= MATCHING_GRIDS.average_from
    resampling: ViewResampling = "average" if averaged else "cubic"
    return View(finer, grid, resampling)


def _axis_scale(from_grid: Grid, to_grid: Grid, common: shapely.Geometry) -> Float64 | None:
    """Return (2,) signed px of a grid per px of another along columns and rows; None for other axes."""
    plain = from_grid.has_plane_of(to_grid) or (type(from_grid) is Grid and type(to_grid) is Grid)
    if not plain or not _same_coordinates(from_grid, to_grid, common):
        return None
    matrix = inverse(linear_part(to_grid.transform)) @ linear_part(from_grid.transform)
    left, top, right, bottom = common.bounds
    skew_px = max(abs(matrix[0, 1]) * (bottom - top), abs(matrix[1, 0]) * (right - left))
    return None if skew_px > MATCHING_GRIDS.same_size_px else np.diagonal(matrix).copy()


def _same_coordinates(from_grid: Grid, to_grid: Grid, common: shapely.Geometry) -> bool:
    """Whether both CRSs give the same coordinates for the same ground, or all a turn around the earth off."""
    turn_px = to_grid.turn_px
    if from_grid.crs == to_grid.crs and turn_px is None:
        return True
    inner = common.buffer(
        -MATCHING_GRIDS.same_size_px
    )  # rounding may take the edge of a map around the earth
    dense = shapely.get_coordinates(shapely.segmentize(inner, max(common.length / 64, 1.0)))
    away = map_px(dense, from_grid, to_grid) - to_grid.to_px(from_grid.to_xy(dense))
    if turn_px is not None and len(away):
        away -= np.rint(away[0] @ turn_px / (turn_px @ turn_px)) * turn_px
    return bool(np.abs(away).max(initial=0.0) <= 0.001)


def _flipped(grid: Grid, signs: Float64) -> Grid:
    rows, cols = grid.shape
    origin = (cols if signs[0] < 0 else 0, rows if signs[1] < 0 else 0)
    return grid.resampled_grid(((float(signs[0]), 0.0), (0.0, float(signs[1]))), origin, grid.shape)


def _overlap(reference: RasterInfo, target: RasterInfo) -> shapely.Geometry:
    """Return the area that both rasters cover, a polygon in reference px."""
    common = common_ground(reference.grid, target.grid)
    if common.area < 1.0:
        plane = name_of(reference.grid.crs) if reference.grid.crs else "the plane of their geotransforms"
        raise InputError(
            f"the rasters do not overlap: in {plane}, {reference.uri} covers "
            f"{extent_text(reference.grid, reference.grid)} and {target.uri} covers "
            f"{extent_text(target.grid, reference.grid)}: "
            "give two rasters of the same ground, or correct their georeferencing"
            + ("" if reference.grid.crs else " (gdal_edit.py -unsetgt removes it)")
        )
    return common


def _typical_place(common: shapely.Geometry, reference: Grid, target: Grid) -> Float64:
    """Return a (1, 2) place, reference px, at which the pixels of the two compare as at most others.

    It is the middle of the common ground unless that is unlike the others, as a pole is.
    """
    at_px = _places_in(common)
    steps = jacobian(at_px, reference, target)
    finite = np.isfinite(steps).all(axis=(1, 2))
    sizes = np.full((len(at_px), 2), np.inf)
    with np.errstate(divide="ignore"):
        sizes[finite] = np.log(np.linalg.svd(steps[finite], compute_uv=False))
    unlike = np.abs(sizes - np.median(sizes[finite], axis=0)).max(axis=1) if finite.any() else np.zeros(1)
    return at_px[[0 if unlike[0] <= np.log(MATCHING_GRIDS.alike) else int(np.nanargmin(unlike))]]


def _places_in(common: shapely.Geometry) -> Float64:
    """Return (n, 2) places (col, row) all over a polygon, its middle first."""
    at_px = positions(*np.linspace(*bounds_of(common), 9).T)
    return np.concatenate([_centre(common), at_px[shapely.contains_xy(common, at_px)]])


def _centre(polygon: shapely.Geometry) -> Float64:
    point = polygon.representative_point()
    return np.array([[point.x, point.y]])
