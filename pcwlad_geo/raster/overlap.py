"""Where two rasters show the same ground: footprints around the earth, up to the edge of a projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
from affine import Affine
from shapely.affinity import translate
from shapely.geometry.polygon import orient

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.estimation.solving import solve
from pcwlad_geo.raster.crs import WGS84, in_turn, name_of, transform_xy
from pcwlad_geo.raster.grid import Grid, Window, linear_part, map_px
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class FootprintParameters:
    """How footprints are mapped."""

    points_per_side: int = 64
    """Points on each side of an outline, and of the lattice in which common ground is looked for."""
    points_to_limb: int = 256
    """Points along each side of a raster by which its part is found that is defined."""
    round_trip_px: float = 0.5
    """Largest distance at which a point comes back; in a fold of a projection it comes back elsewhere."""
    edge_px: float = 0.01
    """What is left out at the edge of a map where that is not defined."""
    bend: float = 0.25
    """Largest distance from the chord between its neighbours, per length; at the cut of a map it is 0.5."""


FOOTPRINTS: Final = FootprintParameters()
"""The parameters of all footprints."""
EARTH: Final = Grid((180, 360), Affine(1, 0, -180, 0, -1, 90), WGS84)
"""All longitudes and latitudes, in pixels of a degree."""
Box = tuple[Float64, Float64]
"""Lowest and highest (x, y), two (2,) arrays in px."""


def common_ground(reference: Grid, target: Grid) -> shapely.Geometry:
    """Return the area that both rasters show, polygons in reference px; empty where there is none."""
    outline = _outline(target.boundary_px(FOOTPRINTS.points_per_side), target, reference)
    if outline is not None:
        return shown_by(reference, outline)
    outline = _outline(reference.boundary_px(FOOTPRINTS.points_per_side), reference, target)
    if outline is not None:
        return _mapped(shown_by(target, outline), target, reference)
    near_px = _known_px(target.lattice_px(FOOTPRINTS.points_per_side), target, reference)
    near_px = near_px[_inside(near_px, reference)]
    if len(near_px) == 0:
        return shapely.Polygon()
    low, high = near_px.min(axis=0), near_px.max(axis=0)
    size = np.maximum(high - low, 1.0) / FOOTPRINTS.points_per_side
    middles = positions(*(np.arange(a - b, c + b, b) for a, b, c in zip(low, size, high, strict=True)))
    target_xy, defined = _placed(middles, reference, target)
    middles = middles[defined & _inside(target.to_px(target.in_turn(target_xy)), target)]
    cells = shapely.box(*(middles - size / 2).T, *(middles + size / 2).T)
    return shown_by(reference, shapely.union_all(cells))


def footprint(grid: Grid, onto: Grid, outline_px: Float64 | None = None) -> tuple[shapely.Geometry, bool]:
    """Return the ground that a raster shows, or its part within (n, 2) `outline_px`, in px of another grid.

    The polygon is in one of the turns around the earth. The second result is whether all of the outline has
    coordinates in the CRS of `onto`; otherwise the polygon is around the places that have, which leaves out
    the space around a full disk.
    """
    outline_px = grid.boundary_px(FOOTPRINTS.points_per_side) if outline_px is None else outline_px
    outline = _outline(outline_px, grid, onto)
    if outline is not None:
        return outline, True
    ends = np.linspace(outline_px.min(axis=0), outline_px.max(axis=0), FOOTPRINTS.points_to_limb)
    return shapely.MultiPoint(_known_px(positions(*ends.T), grid, onto)).convex_hull, False


def lon_lat_outline(grid: Grid) -> shapely.MultiPolygon:
    """Return the outline of the ground that a raster shows, longitudes and latitudes in degrees.

    As RFC 7946 (3.1.9) asks, it is cut at 180 degrees, and none of its parts lies beyond. An outline around a
    pole goes along that parallel.
    """
    xy, defined = _placed(grid.boundary_px(FOOTPRINTS.points_per_side), grid, EARTH)
    polygon = _polygon_around(xy) if defined.all() else _hull_of_defined(grid)
    polygons = shown_by(EARTH, shapely.transform(polygon, EARTH.to_px).simplify(1e-7).buffer(0))
    parts = shapely.get_parts(shapely.transform(polygons, EARTH.to_xy))
    return shapely.MultiPolygon([orient(part) for part in parts if part.area > 0])


def _polygon_around(xy: Float64) -> shapely.Polygon:
    """Return the polygon of the (n, 2) longitudes and latitudes of an outline, in any turn."""
    xy = _unwrapped(xy, EARTH.turn)
    around = float(in_turn(xy[:1], xy[-1, 0], EARTH.turn)[0, 0] - xy[0, 0])
    if around:
        pole, end = np.copysign(90.0, xy[:, 1].mean()), xy[0, 0] + around
        xy = np.vstack([xy, [[end, xy[0, 1]], [end, pole], [xy[0, 0], pole]]])
    elif np.abs(xy[:, 0]).max() <= EARTH.turn / 2:
        xy = xy[:: FOOTPRINTS.points_per_side // 2]  # nothing is cut: corners and middles of sides
    return shapely.Polygon(xy)


def _hull_of_defined(grid: Grid) -> shapely.Geometry:
    """Return the convex hull, longitudes and latitudes, of the places of a raster that are on the earth."""
    xy, defined = _placed(grid.lattice_px(FOOTPRINTS.points_per_side), grid, EARTH)
    turned = np.exp(1j * np.radians(xy[defined, 0]))
    middle = float(np.degrees(np.angle(turned.sum()))) if defined.any() else 0.0
    return shapely.MultiPoint(in_turn(xy[defined], middle, EARTH.turn)).convex_hull


def lon_lat_bounds(boxes: Sequence[Sequence[float]]) -> tuple[float, float, float, float]:
    """Return the smallest box around boxes (west, south, east, north), degrees.

    As RFC 7946 (5.2) asks, west is larger than east where it crosses 180 degrees.
    """
    west, south, east, north = np.array(boxes, dtype=np.float64).T
    order = np.argsort(west)
    west, ends = west[order], np.maximum.accumulate((east + 360.0 * (east < west))[order])
    ends = np.maximum(ends, ends[-1] - 360.0)  # the last may reach around to the first
    gaps = np.append(west[1:], west[0] + 360.0) - ends
    last = len(gaps) - 1 if gaps[-1] >= gaps.max() - 1e-9 else int(gaps.argmax())
    if gaps[last] <= 0:
        return -180.0, float(south.min()), 180.0, float(north.max())
    end = float(ends[last] - 360.0 if ends[last] > 180.0 else ends[last])
    return float(west[(last + 1) % len(west)]), float(south.min()), end, float(north.max())


def shown_by(grid: Grid, polygons: shapely.Geometry) -> shapely.Geometry:
    """Return the part of `polygons`, px of a grid in any turn around the earth, that its raster shows."""
    raster = shapely.box(0, 0, *grid.shape[::-1])
    turn_px = grid.turn_px
    if turn_px is None or polygons.is_empty:
        return polygons.intersection(raster)
    (low, high), reach = bounds_of(polygons), np.hypot(*turn_px)
    away = (np.array(grid.shape[::-1]) - low - high) / 2 @ turn_px / reach**2
    most = (np.hypot(*(high - low)) + np.hypot(*grid.shape)) / reach / 2
    turns = np.arange(np.ceil(away - most), np.floor(away + most) + 1)
    parts = [translate(polygons, *(turn * turn_px).tolist()).intersection(raster) for turn in turns]
    return shapely.union_all(parts)


def bounds_of(polygons: shapely.Geometry) -> Box:
    """Return lowest and highest (x, y) of `polygons`, two (2,) arrays; NaN where they are empty."""
    left, bottom, right, top = polygons.bounds
    return np.array([left, bottom]), np.array([right, top])


def window_of(polygons: shapely.Geometry, from_grid: Grid, to_grid: Grid) -> Window:
    """Return the window of the pixels of a grid that show the `polygons`, px of another."""
    at_px = map_px(_points_of(polygons), from_grid, to_grid)
    if not _placed(_points_of(polygons), from_grid, to_grid)[1].all():
        # Rounding may take the edge of a map around the earth, to the other end of one that does not go on.
        inner_px = _known_px(_points_of(polygons.buffer(-FOOTPRINTS.edge_px)), from_grid, to_grid)
        at_px = inner_px if len(inner_px) else at_px
    at_px = at_px[np.isfinite(at_px).all(axis=1)]
    # A millionth of a pixel is a rounding error and adds no row.
    return Window.around(at_px.min(axis=0) + 1e-6, at_px.max(axis=0) - 1e-6)


def _points_of(polygons: shapely.Geometry) -> Float64:
    """Return (n, 2) points along the outlines of polygons, and inside of them: a pole may be there."""
    low, high = bounds_of(polygons)
    inside = positions(*np.linspace(low, high, 33).T)
    inside = inside[shapely.contains_xy(polygons, inside)]
    outline = shapely.get_coordinates(shapely.segmentize(polygons, (high - low).max() / 32))
    return np.concatenate([outline, inside])


def extent_text(grid: Grid, onto: Grid) -> str:
    """Return the extent of a raster in another's CRS, as text for messages."""
    ground, _ = footprint(grid, onto)
    if ground.is_empty:
        return f"nothing that {name_of(onto.crs)} can show"
    xy = onto.to_xy(shapely.get_coordinates(ground))
    (left, bottom), (right, top) = xy.min(axis=0), xy.max(axis=0)
    return f"x {left:.10g} to {right:.10g}, y {bottom:.10g} to {top:.10g}"


def _placed(points_px: Float64, grid: Grid, onto: Grid) -> tuple[Float64, Bool]:
    """Return (n, 2) map coordinates of a raster's points in another CRS, and which are defined both ways."""
    map_xy = grid.to_xy(points_px)
    xy = transform_xy(map_xy, grid.crs, onto.crs)
    away = in_turn(transform_xy(xy, onto.crs, grid.crs) - map_xy, 0.0, grid.turn)
    off_px = solve(linear_part(grid.transform), away.T).T
    with np.errstate(invalid="ignore"):
        defined = (np.abs(off_px) <= FOOTPRINTS.round_trip_px).all(axis=1)
    return xy, np.asarray(defined & np.isfinite(xy).all(axis=1))


def _known_px(points_px: Float64, grid: Grid, onto: Grid) -> Float64:
    """Return the px in another grid of a raster's points, without those that are not defined there."""
    xy, defined = _placed(points_px, grid, onto)
    return onto.to_px(onto.in_turn(xy[defined]))


def _inside(at_px: Float64, grid: Grid) -> Bool:
    with np.errstate(invalid="ignore"):
        return np.asarray(((at_px >= 0) & (at_px <= grid.shape[::-1])).all(axis=1))


def _outline(outline_px: Float64, grid: Grid, onto: Grid) -> shapely.Polygon | None:
    """Return a closed outline in px of another grid; None if some is not defined, cut, or around a pole."""
    xy, defined = _placed(outline_px, grid, onto)
    if not defined.all():
        return None
    xy = _unwrapped(xy, onto.turn)
    if abs(xy[-1, 0] - xy[0, 0]) > onto.turn / 2:
        return None
    px = onto.to_px(xy)
    before, after = np.roll(px, 1, axis=0)[1::2], np.roll(px, -1, axis=0)[1::2]
    bend = np.linalg.norm(px[1::2] - (before + after) / 2, axis=1)
    polygon = shapely.Polygon(px)
    straight = (bend <= FOOTPRINTS.bend * np.linalg.norm(after - before, axis=1)).all()
    return polygon if straight and polygon.is_valid else None


def _unwrapped(xy: Float64, turn: float) -> Float64:
    """Return (n, 2) map coordinates of a line, none of whose steps is half a turn around the earth."""
    return xy if np.isinf(turn) else np.column_stack([np.unwrap(xy[:, 0], period=turn), xy[:, 1]])


def _mapped(polygons: shapely.Geometry, from_grid: Grid, to_grid: Grid) -> shapely.Geometry:
    """Map polygons to those of a raster, their sides densified so that they may become curves."""
    mapped = []
    for part in shapely.get_parts(polygons):
        xy = from_grid.to_xy(shapely.get_coordinates(shapely.segmentize(part, max(part.length / 128, 1e-9))))
        xy = transform_xy(xy, from_grid.crs, to_grid.crs)
        ring = _unwrapped(xy[np.isfinite(xy).all(axis=1)], to_grid.turn)
        mapped += [shapely.Polygon(to_grid.to_px(ring)).buffer(0)] if len(ring) > 3 else []
    return shown_by(to_grid, shapely.union_all(mapped))
