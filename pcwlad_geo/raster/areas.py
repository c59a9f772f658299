"""Areas of vector files: the ground that counts, and that which does not."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.features import rasterize

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.raster.crs import WGS84, transform_xy, turn_of
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS
from pcwlad_geo.raster.grid import Grid, Window
from pcwlad_geo.raster.vectors import Box, ask, checked_vector
from pcwlad_geo.text import check_regular, read_bytes
from pcwlad_geo.types import Bool, Float64, Index, PathLike


@dataclass(frozen=True, slots=True)
class Areas:
    """Ground that counts, as polygons in the map coordinates of a raster."""

    within: bytes | None
    """Well-known binary of the polygons beyond which nothing counts; None where all does."""
    without: bytes | None
    """Well-known binary of those in which nothing counts."""

    def valid(self, window: Window, grid: Grid) -> Bool:
        """Return the (rows, cols) pixels of a `window` of a `grid` whose centres count."""
        valid = np.ones(window.shape, dtype=bool)
        for polygons, counts in ((self.within, True), (self.without, False)):
            if polygons is not None:
                valid &= _covered(polygons, window, grid) == counts
        return valid


@dataclass(frozen=True, slots=True)
class _Rings:
    """The rings of polygons, which may cross themselves and each other: they are cut, never mended.

    A polygon covers what lies within an odd number of its rings' turns, as in GDAL's rasterisation, and
    several polygons cover what any of them does.
    """

    xy: Float64
    """(n, 2) vertices; the last one of a ring is not the first again."""
    ring: Index
    """(n,) number of the vertex's ring, rising."""
    polygon: Index
    """Number of each ring's polygon, rising."""

    @staticmethod
    def of(rings: NDArray[np.object_], polygon: Index) -> _Rings:
        xy, ring = shapely.get_coordinates(rings, return_index=True)
        is_vertex = (np.diff(ring, append=ring[-1:] + 1) == 0) & np.isfinite(xy).all(axis=1)
        return _Rings(xy[is_vertex], ring[is_vertex], polygon)

    @np.errstate(all="ignore")  # of coordinates that are no places
    def clipped(self, box: Box) -> _Rings:
        """Return what lies in a box: each side cuts each ring, whose turns within stay what they were."""
        xy, ring = self.xy, self.ring
        for axis, limit, sign in ((0, box[0], 1), (1, box[1], 1), (0, box[2], -1), (1, box[3], -1)):
            beyond = sign * (limit - xy[:, axis])
            last = np.flatnonzero(np.diff(ring, append=ring[-1:] + 1))
            following = np.arange(1, len(ring) + 1)
            following[last] = np.append(0, last + 1)[:-1]
            crossing = (beyond > 0) != (beyond[following] > 0)
            share = beyond / (beyond - beyond[following])
            cut = xy + share[:, None] * (xy[following] - xy)
            cut[:, axis] = limit
            selection = np.stack([beyond <= 0, crossing & np.isfinite(cut).all(axis=1)], axis=1)
            xy, ring = np.stack([xy, cut], axis=1)[selection], np.repeat(ring, 2)[selection.ravel()]
        return _Rings(xy, ring, self.polygon)

    def lines(self) -> tuple[NDArray[np.object_], Index]:
        """Return the rings that have three vertices or more, and the number of each one's polygon."""
        whole = np.bincount(self.ring, minlength=1)[self.ring] >= 3
        numbers, ring = np.unique(self.ring[whole], return_inverse=True)
        _, polygon = np.unique(self.polygon[numbers], return_inverse=True)
        lines = shapely.linearrings(self.xy[whole], indices=ring) if len(ring) else np.empty(0, object)
        return lines, polygon

    def polygons(self) -> NDArray[np.object_]:
        """Return the polygons of these rings."""
        lines, polygon = self.lines()
        return np.asarray(shapely.polygons(lines, indices=polygon) if len(lines) else lines)


def read_areas(path: PathLike, grid: Grid) -> bytes:
    """Return the polygons of a vector file around a grid, in its map coordinates, as well-known binary.

    Raises `InputError` if the file at `path` is missing or of another format, has several layers, no CRS or
    no polygons, its CRS has no relation to that of the `grid`, or it asks for too much time or memory.
    """
    name = str(path)
    if _is_kml(name):
        check_regular(name)
    else:
        checked_vector(path, "areas.gpkg", "GeoPackage, GeoJSON, Shapefile (.shp), FlatGeobuf or KML")
    shapes, crs, box = (_shapes_of_kml if _is_kml(name) else _shapes_by_ogr)(name, grid)
    check_count(name, len(shapes), LIMITS.areas, "areas")
    kinds = set(shapely.get_type_id(shapes).tolist())
    if not kinds <= {shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON}:
        raise InputError(f"{name} holds other than polygons: give areas (of lines or points a buffer)")
    rings = _Rings.of(*shapely.get_rings(shapely.get_parts(shapes), return_index=True)).clipped(box)
    check_count(name, len(rings.xy), LIMITS.vertices, "vertices around the raster")
    lines, polygon = rings.lines()
    if crs != grid.crs or type(grid) is not Grid:  # edges are curved there
        step = max(box[2] - box[0], box[3] - box[1]) / 192
        lines = shapely.segmentize(lines, max(step, shapely.length(lines).sum() / LIMITS.segments))
    grid_rings = _Rings.of(
        shapely.transform(lines, lambda xy: grid.in_turn(transform_xy(xy, crs, grid.crs))), polygon
    )
    return bytes(shapely.to_wkb(shapely.multipolygons(grid_rings.polygons())))


Shapes = tuple[NDArray[np.object_], CRS, Box]


def _shapes_by_ogr(name: str, grid: Grid) -> Shapes:
    """Return the geometries of a vector file that OGR opens, their CRS, and in it where they are of use.

    Raises `InputError` if it cannot, or the file has several layers or no CRS.
    """
    layers, text = ask(name)
    if layers != 1:
        raise InputError(f"{name} has {layers} layers: write that of the areas to a file of its own")
    if not text:
        raise InputError(f"{name} has no CRS: assign it (ogr2ogr -a_srs EPSG:… areas.gpkg {name})")
    try:
        crs = CRS.from_user_input(text)
        box = _surroundings(transform_xy(grid.to_xy(grid.boundary_px()), grid.crs, crs))
        return _in_turn(lambda part: shapely.from_wkb(ask(name, part)), crs, box), crs, box
    except (*LIBRARY_ERRORS, shapely.errors.ShapelyError, ValueError) as error:
        raise InputError(f"{name} cannot be read as a vector file: {error}") from error


def _is_kml(name: str) -> bool:
    return Path(name).suffix.lower() == ".kml"


def _shapes_of_kml(name: str, grid: Grid) -> Shapes:
    """Return the geometries of all folders of a KML file, whose links and styles are not followed.

    Raises `InputError` if it cannot be understood.
    """
    box = _surroundings(transform_xy(grid.to_xy(grid.boundary_px()), grid.crs, WGS84))
    try:
        root = ET.fromstring(read_bytes(Path(name)))
        other_kinds = [root.find(f".//{{*}}{kind}") is not None for kind in ("Point", "LineString")]
        polygons = [
            shapely.Polygon(
                _ring(element.find("{*}outerBoundaryIs")),
                list(map(_ring, element.findall("{*}innerBoundaryIs"))),
            )
            for element in root.findall(".//{*}Polygon")
        ]
    except OSError as error:
        raise InputError(f"{name} cannot be opened: {error}") from error
    except (ET.ParseError, ValueError, LookupError, shapely.errors.ShapelyError) as error:
        raise InputError(f"{name} cannot be read as KML: {error}") from error
    shapes = np.array([*polygons, *([shapely.Point()] if any(other_kinds) else [])], dtype=object)
    return _in_turn(lambda _: shapes, WGS84, box), WGS84, box


def _in_turn(shapes_in: Callable[[Box], NDArray[np.object_]], crs: CRS, box: Box) -> NDArray[np.object_]:
    """Return the geometries in a box, those too whose longitudes are counted 360 degrees more or less."""
    left, bottom, right, top = box
    turn, parts = turn_of(crs), []
    for by in (-turn, 0.0, turn) if math.isfinite(turn) else (0.0,):
        if by == 0.0 or (left + by <= turn and right + by >= -turn / 2):
            shapes = np.asarray(shapes_in((left + by, bottom, right + by, top)), dtype=object)
            parts.append(shapely.transform(shapes, lambda xy, by=by: xy - [by, 0.0]) if by else shapes)
    return np.concatenate(parts)


def _ring(boundary: ET.Element | None) -> Float64:
    """Return the (n, 2) longitudes and latitudes of a boundary of a polygon."""
    text = "" if boundary is None else boundary.findtext(".//{*}coordinates", "")
    lon_lat = np.array([[float(number) for number in place.split(",")[:2]] for place in text.split()])
    if not np.isfinite(lon_lat).all():
        raise ValueError("a coordinate is no number")
    return lon_lat


def _surroundings(xy: Float64) -> Box:
    """Return left, bottom, right, top of (n, 2) coordinates that are known, and as much on each side."""
    low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    left, bottom, right, top = np.concatenate([low - (high - low), high + (high - low)]).tolist()
    return left, bottom, right, top


def _covered(polygons: bytes, window: Window, grid: Grid) -> Bool:
    """Return the (rows, cols) pixels of a window whose centres the polygons cover."""
    corner_px = np.array([window.col, window.row], np.float64)
    border_px = corner_px + Grid(window.shape, grid.transform, grid.crs).boundary_px()
    box = _surroundings(grid.to_xy(border_px))
    parts = shapely.get_parts(shapely.from_wkb(polygons))
    left, bottom, right, top = shapely.bounds(parts).reshape(-1, 4).T
    parts = parts[(left <= box[2]) & (right >= box[0]) & (bottom <= box[3]) & (top >= box[1])]
    lines, polygon = _Rings.of(*shapely.get_rings(parts, return_index=True)).clipped(box).lines()
    in_window = _Rings.of(shapely.transform(lines, lambda xy: grid.to_px(xy) - corner_px), polygon)
    shapes = in_window.polygons()
    if len(shapes) == 0:
        return np.zeros(window.shape, dtype=bool)
    return np.asarray(rasterize(shapes, window.shape, dtype="uint8"), bool)
