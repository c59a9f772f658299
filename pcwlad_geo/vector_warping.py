"""Application of a finished registration to vector files: vertices move from where the target drew them."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.vertices import densify
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.events import EventCallback, Progress, Warned
from pcwlad_geo.outputs.folder import place_file, stage_inside
from pcwlad_geo.raster import WGS84, transform_xy
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS, ignoring
from pcwlad_geo.raster.vectors import VectorLayer, checked_vector, read_layers, sqlite_file
from pcwlad_geo.report.finished import FinishedRegistration
from pcwlad_geo.types import Float64

WRITTEN: Final = {
    ".gpkg": "GPKG",
    ".geojson": "GeoJSON",
    ".json": "GeoJSON",
    ".shp": "ESRI Shapefile",
    ".fgb": "FlatGeobuf",
}
"""Drivers of the files that are written in the format in which they are read, by suffix; others: GPKG."""
OTHER_SUFFIXES: Final = (".kml", ".kmz", ".gml", ".gpx", ".dxf", ".tab", ".mif", ".sqlite", ".parquet")
"""Further files of vectors, which are written as GeoPackage."""
STYLE_SUFFIXES: Final = (".qml", ".sld")
"""Styles beside a vector file, which are copied with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Movement:
    """Moves map positions of one CRS as a correction of the target asks for."""

    registration: FinishedRegistration
    crs: CRS | None
    """Of the positions."""
    is_inverse: bool
    """Whether positions go back to where the target draws them."""
    everywhere: bool = False
    """Whether the correction is meant for all the ground, not for that of the target alone."""

    def to_px(self, xy: Float64) -> Float64:
        """Return the (n, 2) target px (col, row) where the original georeferencing shows the (n, 2) `xy`."""
        grid = self.registration.target_grid
        return grid.to_px(xy if self.crs is None else transform_xy(xy, self.crs, grid.crs))

    def __call__(self, xy: Float64) -> Float64:
        """Return the (n, 2) positions `xy` moved; NaN where the CRS of the target has no such place."""
        correction, grid = self.registration.correction, self.registration.target_grid
        place_px = self.to_px(xy)
        moved_px = np.full_like(place_px, np.nan)
        valid = np.isfinite(place_px).all(axis=1)
        move = correction.forward if self.is_inverse else correction.inverse
        moved_px[valid] = move(place_px[valid])
        moved_xy = grid.to_xy(moved_px)
        return moved_xy if self.crs is None else transform_xy(moved_xy, grid.crs, self.crs)


def vector_place(source: str, out_dir: Path, what: str = "registered") -> Path:
    """Return the path of the moved copy of a vector file in a folder."""
    path = Path(source)
    suffix = path.suffix if path.suffix.lower() in WRITTEN else ".gpkg"
    return out_dir / f"{path.stem}_{what}{suffix}"


def is_vector(source: str) -> bool:
    """Return whether a file holds vectors by its suffix; a GeoPackage does if it has a table of features."""
    path = Path(source)
    suffix = path.suffix.lower()
    if suffix != ".gpkg":
        return suffix in (*WRITTEN, *OTHER_SUFFIXES)
    try:
        with sqlite_file(path, allows_views=True) as database:  # what opens it as vectors refuses them
            query = "SELECT 1 FROM gpkg_contents WHERE data_type = 'features' LIMIT 1"
            return database.execute(query).fetchone() is not None
    except sqlite3.Error:  # reported by what opens it as a raster
        return False


def warp_vectors(
    sources: Sequence[str],
    places: Sequence[Path],
    registration: FinishedRegistration,
    *,
    is_inverse: bool,
    everywhere: bool = False,
    overwrite: bool,
    on_event: EventCallback,
) -> tuple[Path, ...]:
    """Write copies of vector files whose vertices are moved by a registration; return their `places`.

    Layers, attributes, CRS and heights are those of the `sources`, and styles beside them are copied. New
    vertices are inserted where a moved segment would leave the correction by more than 0.05 px.

    Raises `InputError` if a file cannot be read, has no CRS that relates to the target's, or the target has
    an RPC, and `OutputError` if a copy cannot be written.
    """
    for number, (source, place) in enumerate(zip(sources, places, strict=True)):
        on_event(Progress("vectors", number, len(sources)))
        with stage_inside(place.parent) as stage:
            movement = Movement(registration, None, is_inverse, everywhere)
            _write_moved(source, stage / place.name, movement, on_event)
            for file in sorted(stage.iterdir()):
                place_file(file, place.with_suffix(file.suffix), overwrite=overwrite)
    if sources:
        on_event(Progress("vectors", len(sources), len(sources)))
    return tuple(places)


def _write_moved(source: str, staged: Path, movement: Movement, on_event: EventCallback) -> None:
    registration = movement.registration
    if registration.rpc is not None:
        raise InputError(
            f"{source}: the target has RPCs, whose correction needs the height of every vertex: digitise on "
            "the orthorectified raster instead"
        )
    name = checked_vector(source, "objects.gpkg")
    layers = read_layers(name)
    if not layers:
        raise InputError(f"{source} has no layers: there is nothing to move")
    for number, layer in enumerate(layers):
        movement = replace(movement, crs=_crs_of(layer, name, registration))
        moved_layer = _moved_layer(layer, movement, name, on_event)
        _write_layer(staged, moved_layer, WRITTEN[staged.suffix.lower()], append=number > 0)
    for suffix in STYLE_SUFFIXES:
        style = Path(source).with_suffix(suffix)
        if style.is_file():
            shutil.copyfile(style, staged.with_suffix(suffix))


def _crs_of(layer: VectorLayer, name: str, registration: FinishedRegistration) -> CRS | None:
    """Return the CRS of a layer; None where neither it nor the target has one, or it has no geometry."""
    target = registration.target_grid.crs
    if layer.geometry is None or (target is None and layer.crs is None):
        return None
    if target is None:
        raise InputError(
            f"the layer {layer.name!r} of {name} has a CRS and the target has none: give vectors in the "
            "target's pixels, without a CRS"
        )
    if layer.crs is None:
        raise InputError(
            f"the layer {layer.name!r} of {name} has no CRS: assign it (ogr2ogr -a_srs EPSG:… new.gpkg "
            f"{name})"
        )
    try:
        return CRS.from_user_input(layer.crs)
    except LIBRARY_ERRORS as error:
        raise InputError(f"the CRS of the layer {layer.name!r} of {name} cannot be read: {error}") from error


def _moved_layer(layer: VectorLayer, movement: Movement, name: str, on_event: EventCallback) -> VectorLayer:
    if layer.geometry is None:
        return layer
    try:
        shapes = np.asarray(shapely.from_wkb(layer.geometry), dtype=object)
    except (shapely.errors.ShapelyError, ValueError) as error:
        raise InputError(f"the layer {layer.name!r} of {name} has a damaged geometry: {error}") from error
    xy = shapely.get_coordinates(shapes)
    if len(xy) == 0:
        return layer
    rows, cols = movement.registration.target_grid.shape
    place_px = movement.to_px(xy)
    if not np.isfinite(place_px).all():
        lost_count = int((~np.isfinite(place_px).all(axis=1)).sum())
        raise InputError(
            f"the layer {layer.name!r} of {name} has {lost_count} vertices that the target's CRS "
            "cannot hold: clip it to the surroundings of the target (ogr2ogr -clipsrc)"
        )
    beyond = int(((place_px < 0) | (place_px > (cols, rows))).any(axis=1).sum())
    if beyond and not movement.everywhere:
        on_event(
            Warned(
                f"{name}, layer {layer.name!r}: {beyond} of {len(xy)} vertices lie beyond the target image, "
                "where the correction is extrapolated: check them"
            )
        )
    moved_shapes = np.empty(len(shapes), dtype=object)
    for kind in np.unique(shapely.get_type_id(shapes)):
        of_kind = shapely.get_type_id(shapes) == kind
        moved_shapes[of_kind] = _moved(shapes[of_kind], movement)
    return replace(layer, geometry=np.asarray(shapely.to_wkb(moved_shapes), dtype=object))


def _moved(shapes: NDArray[np.object_], movement: Movement) -> NDArray[np.object_]:
    """Return geometries of one type, moved; missing and empty ones stay."""
    if shapely.get_type_id(shapes[0]) == shapely.GeometryType.GEOMETRYCOLLECTION:
        collections = [shapely.get_parts(shape) for shape in shapes]
        parts = [
            [_moved(np.array([part], object), movement)[0] for part in collection]
            for collection in collections
        ]
        return np.array([shapely.GeometryCollection(part) for part in parts], dtype=object)
    is_filled = ~(shapely.is_missing(shapes) | shapely.is_empty(shapes))
    moved_shapes = shapes.copy()
    if not is_filled.any():
        return moved_shapes
    filled = shapes[is_filled]
    has_z = shapely.has_z(filled)
    for z in np.unique(has_z):
        indices = np.flatnonzero(is_filled)[has_z == z]
        moved_shapes[indices] = _moved_alike(shapes[indices], movement, has_z=bool(z))
    return moved_shapes


def _moved_alike(shapes: NDArray[np.object_], movement: Movement, *, has_z: bool) -> NDArray[np.object_]:
    """Return filled geometries of one type, all with or all without heights, moved."""
    kind, vertices, offsets = shapely.to_ragged_array(shapes, include_z=has_z)
    is_line = shapely.get_dimensions(shapes[0]) > 0
    correction = movement.registration.correction
    if is_line and not isinstance(correction, AffineCorrection):
        place_px = movement.to_px(vertices[:, :2])
        vertices, starts = densify(vertices, place_px, offsets[0].astype(np.intp), correction.forward)
        offsets = (starts, *offsets[1:])
    vertices = np.column_stack([movement(vertices[:, :2]), vertices[:, 2:]])
    return np.asarray(shapely.from_ragged_array(kind, vertices, offsets), dtype=object)


def _write_layer(path: Path, layer: VectorLayer, driver: str, *, append: bool) -> None:
    import pyogrio.raw

    options = {}
    if driver == "GeoJSON" and layer.crs is not None and CRS.from_user_input(layer.crs) != WGS84:
        options["RFC7946"] = "NO"  # it keeps a CRS that is not WGS 84
    if (
        driver == "FlatGeobuf"
        and layer.geometry is not None
        and any(shape is None for shape in layer.geometry)
    ):
        options["SPATIAL_INDEX"] = "NO"  # it holds no missing geometry
    values, masks = _fields(layer)
    try:
        with ignoring(UserWarning), ignoring(RuntimeWarning):  # of a missing CRS, of types of geometry
            pyogrio.raw.write(
                str(path),
                layer.geometry,
                values,
                list(layer.fields),
                field_mask=masks,
                layer=layer.name,
                driver=driver,
                geometry_type=layer.geometry_type,
                crs=layer.crs,
                append=append,
                layer_options=options,
            )
    except (*LIBRARY_ERRORS, ValueError, RuntimeError) as error:  # those of pyogrio are RuntimeErrors
        raise OutputError(f"{path} cannot be written as {driver}: {error}") from error


def _fields(layer: VectorLayer) -> tuple[list[NDArray[np.generic]], list[NDArray[np.bool_] | None]]:
    """Return the attributes by field; whole numbers with gaps, which are read as floats, are whole again."""
    values: list[NDArray[np.generic]] = []
    masks: list[NDArray[np.bool_] | None] = []
    for column, kind in zip(layer.values, layer.field_types, strict=True):
        if kind.startswith("int") and column.dtype.kind == "f":
            mask = np.isnan(column)
            values.append(np.where(mask, 0, column).astype(kind))
            masks.append(mask)
        else:
            values.append(column)
            masks.append(None)
    return values, masks
