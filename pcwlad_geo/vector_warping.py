"""Application of a finished registration to vector files: vertices move from where the target drew them."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.correction.dense import in_chunks
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.precision import Precision
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.correction.vertices import densify
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.events import EventCallback, Progress, Warned
from pcwlad_geo.outputs.displacement_raster import InterpolatedCovariance
from pcwlad_geo.outputs.folder import place_file, stage_inside
from pcwlad_geo.outputs.map_raster import MAP_DEFAULTS
from pcwlad_geo.raster import WGS84, Grid, pixel_sizes_m, transform_xy
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS, ignoring
from pcwlad_geo.raster.vectors import VectorLayer, checked_vector, read_layers, sqlite_file
from pcwlad_geo.report.finished import FinishedRegistration
from pcwlad_geo.report.fitted_again import FittedAgain
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
SIGMA_FIELD: Final = "sigma_m"
"""Field with the largest standard deviation, along an axis, of the vertices of a feature, metres."""
SIGMA_DIGITS: Final = 4
"""Decimals of that field."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedInMetres:
    """The standard deviation of a correction: interpolated over the target, computed at places beyond it."""

    selection: Selection
    target: Grid

    def covariance_m2(self, predicted_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance (col, row) at the (n, 2) `predicted_px`, m²."""
        sizes_m = _sizes_m(self.target, predicted_px)
        return self.selection.covariance(predicted_px) * sizes_m[:, :, None] * sizes_m[:, None, :]

    def sigma_m(self, predicted_px: Float64) -> Float64:
        """Return the (n,) standard deviation along an axis, metres, at the (n, 2) `predicted_px`."""
        most, shape = MAP_DEFAULTS.covariance_nodes, self.target.shape
        beyond = ((predicted_px < 0) | (predicted_px > shape[::-1])).any(axis=1)
        covariance_m2 = np.empty((len(predicted_px), 2, 2))
        if not beyond.all():
            inside = InterpolatedCovariance.of(self.covariance_m2, shape, most)
            covariance_m2[~beyond] = inside.at(predicted_px[~beyond])
        if beyond.any():
            covariance_m2[beyond] = in_chunks(self.covariance_m2, predicted_px[beyond])
        return np.asarray(np.sqrt(np.trace(covariance_m2, axis1=1, axis2=2) / 2))


class SigmaInMetres(Protocol):
    """What knows the standard deviation of a correction in metres."""

    def sigma_m(self, predicted_px: Float64) -> Float64:
        """Return the (n,) standard deviation along an axis, metres, at the (n, 2) `predicted_px`."""


@dataclass(frozen=True, slots=True, eq=False)
class InMetres:
    """The precision of a correction in metres."""

    of: Precision
    target: Grid

    def sigma_m(self, predicted_px: Float64) -> Float64:
        """Return the (n,) standard deviation along an axis, metres, at the (n, 2) `predicted_px`."""
        sigma_m = self.of.sigma(predicted_px) * _sizes_m(self.target, predicted_px)
        return np.asarray(np.sqrt((sigma_m**2).mean(axis=1)))


def _sizes_m(target: Grid, predicted_px: Float64) -> Float64:
    sizes_m = pixel_sizes_m(target, predicted_px)
    if sizes_m is None:
        raise InputError("sigma_m is not known without a CRS: leave it out")
    return sizes_m


def in_metres(precision: Precision, target: Grid) -> SigmaInMetres:
    """Return the precision of a correction of a target in metres."""
    of = precision.selection if isinstance(precision, FittedAgain) else precision
    return FittedInMetres(of, target) if isinstance(of, Selection) else InMetres(of, target)


def precision_in_metres(folder: str | os.PathLike[str], registration: FinishedRegistration) -> SigmaInMetres:
    """Return the precision of a registration that was read from `folder`, or from a saved correction.

    Raises `InputError` if neither tells it.
    """
    if registration.precision is not None:
        return in_metres(registration.precision, registration.target_grid)
    return in_metres(FittedAgain.read(folder, registration), registration.target_grid)


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
    precision: SigmaInMetres | None = None
    """That of the correction, where features are to tell it."""

    def to_px(self, xy: Float64) -> Float64:
        """Return the (n, 2) target px (col, row) where the original georeferencing shows the (n, 2) `xy`."""
        grid = self.registration.target_grid
        return grid.to_px(xy if self.crs is None else transform_xy(xy, self.crs, grid.crs))

    def moved_px(self, place_px: Float64) -> Float64:
        """Return the (n, 2) `place_px` moved."""
        correction = self.registration.correction
        return (correction.forward if self.is_inverse else correction.inverse)(place_px)

    def to_xy(self, place_px: Float64) -> Float64:
        """Return the (n, 2) positions of (n, 2) `place_px`: the inverse of `to_px`."""
        grid = self.registration.target_grid
        xy = grid.to_xy(place_px)
        return xy if self.crs is None else transform_xy(xy, grid.crs, self.crs)


@dataclass(slots=True)
class Tally:
    """What the vertices of a layer are like."""

    vertices: int = 0
    beyond: int = 0
    """Of these, how many lie beyond the target image."""
    lost: int = 0
    """How many the CRS of the target has no place for."""


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


def moved_vectors(
    sources: Sequence[str], movement: Movement, on_event: EventCallback
) -> list[tuple[VectorLayer, ...]]:
    """Return the layers of vector files with their vertices moved; nothing is written.

    Layers, attributes, CRS and heights are those of the `sources`. New vertices are inserted where a moved
    segment would leave the correction by more than 0.05 px. With a precision in the `movement` features get
    the field `sigma_m`. The CRS of the movement is that of each layer.

    Raises `InputError` if a file cannot be read, has no CRS that relates to the target's, or the target has
    an RPC.
    """
    files = []
    for number, source in enumerate(sources):
        on_event(Progress("vectors", number, len(sources)))
        files.append(tuple(_moved_layers(source, movement, on_event)))
    return files


def write_vectors(
    files: Sequence[Sequence[VectorLayer]],
    sources: Sequence[str],
    places: Sequence[Path],
    *,
    overwrite: bool,
    on_event: EventCallback,
) -> None:
    """Write the moved layers of `files`, each to its place, and the styles that lie beside the `sources`.

    Raises `OutputError` if a file cannot be written; those before it are kept.
    """
    for layers, source, place in zip(files, sources, places, strict=True):
        with stage_inside(place.parent) as stage:
            for number, layer in enumerate(layers):
                driver = WRITTEN[place.suffix.lower()]
                _write_layer(stage / place.name, layer, driver, append=number > 0)
            for style in (Path(source).with_suffix(suffix) for suffix in STYLE_SUFFIXES):
                if style.is_file():
                    shutil.copyfile(style, (stage / place.name).with_suffix(style.suffix))
            for file in sorted(stage.iterdir()):
                place_file(file, place.with_suffix(file.suffix), overwrite=overwrite)
    if sources:
        on_event(Progress("vectors", len(sources), len(sources)))


def _moved_layers(source: str, movement: Movement, on_event: EventCallback) -> Iterator[VectorLayer]:
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
    for layer in layers:
        yield _moved_layer(layer, replace(movement, crs=_crs_of(layer, name, registration)), name, on_event)


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
    what = f"the layer {layer.name!r} of {name}"
    try:
        shapes = np.asarray(shapely.from_wkb(layer.geometry), dtype=object)
    except (shapely.errors.ShapelyError, ValueError) as error:
        raise InputError(f"{what} has a damaged geometry: {error}") from error
    geometries, sigma_m = moved_shapes(shapes, movement, what, on_event)
    layer = replace(layer, geometry=np.asarray(shapely.to_wkb(geometries), dtype=object))
    return layer if movement.precision is None else _with_sigma(layer, sigma_m, name)


def moved_shapes(
    shapes: NDArray[np.object_], movement: Movement, what: str, on_event: EventCallback
) -> tuple[NDArray[np.object_], Float64]:
    """Return the (n,) geometries `shapes` moved, and the (n,) standard deviation of each, metres.

    Vertices are inserted where the correction bends a segment. Missing and empty geometries stay. Vertices
    beyond the target are warned of, and `what` names the geometries. Raises `InputError` if the CRS of the
    target has no place for a vertex.
    """
    tally = Tally()
    geometries, sigma_m = np.empty(len(shapes), dtype=object), np.full(len(shapes), np.nan)
    for kind in np.unique(shapely.get_type_id(shapes)):
        of_kind = shapely.get_type_id(shapes) == kind
        geometries[of_kind], sigma_m[of_kind] = _moved(shapes[of_kind], movement, tally)
    if tally.lost:
        raise InputError(
            f"{what} has {tally.lost} vertices that the target's CRS cannot hold: clip it to the "
            "surroundings of the target (ogr2ogr -clipsrc)"
        )
    if tally.beyond and not movement.everywhere:
        on_event(
            Warned(
                f"{what}: {tally.beyond} of {tally.vertices} vertices lie beyond the target image, where the "
                "correction is extrapolated: check them"
            )
        )
    return geometries, sigma_m


def _with_sigma(layer: VectorLayer, sigma_m: Float64, name: str) -> VectorLayer:
    """Return a layer with the standard deviation of each feature as a field; none of an empty one."""
    if SIGMA_FIELD in map(str.lower, layer.fields):
        raise InputError(
            f"the layer {layer.name!r} of {name} has a field {SIGMA_FIELD} already: rename it, or leave out "
            "--write-sigma"
        )
    return replace(
        layer,
        fields=(*layer.fields, SIGMA_FIELD),
        field_types=(*layer.field_types, "float64"),
        values=(*layer.values, np.round(sigma_m, SIGMA_DIGITS)),
    )


def _moved(
    shapes: NDArray[np.object_], movement: Movement, tally: Tally
) -> tuple[NDArray[np.object_], Float64]:
    """Return geometries of one type, moved, and the (n,) sigma of each; missing and empty ones stay."""
    sigma_m = np.full(len(shapes), np.nan)
    moved_shapes = shapes.copy()
    if shapely.get_type_id(shapes[0]) == shapely.GeometryType.GEOMETRYCOLLECTION:
        for number, shape in enumerate(shapes):
            parts = [_moved(np.array([part], object), movement, tally) for part in shapely.get_parts(shape)]
            moved_shapes[number] = shapely.GeometryCollection([part[0] for part, _ in parts])
            sigma_m[number] = np.fmax.reduce([sigma[0] for _, sigma in parts], initial=np.nan)
        return moved_shapes, sigma_m
    is_filled = ~(shapely.is_missing(shapes) | shapely.is_empty(shapes))
    has_z = shapely.has_z(shapes)
    for z in np.unique(has_z[is_filled]):
        indices = np.flatnonzero(is_filled & (has_z == z))
        moved_shapes[indices], sigma_m[indices] = _moved_alike(shapes[indices], movement, tally, bool(z))
    return moved_shapes, sigma_m


def _moved_alike(
    shapes: NDArray[np.object_], movement: Movement, tally: Tally, has_z: bool
) -> tuple[NDArray[np.object_], Float64]:
    """Return filled geometries of one type, all with or all without heights, moved; and their sigmas."""
    kind, vertices, offsets = shapely.to_ragged_array(shapes, include_z=has_z)
    rows, cols = movement.registration.target_grid.shape
    place_px = movement.to_px(vertices[:, :2])
    lost = int((~np.isfinite(place_px).all(axis=1)).sum())
    tally.vertices, tally.lost = tally.vertices + len(place_px), tally.lost + lost
    if lost:
        return shapes, np.full(len(shapes), np.nan)
    tally.beyond += int(((place_px < 0) | (place_px > (cols, rows))).any(axis=1).sum())
    of_shape = shapely.get_coordinates(shapes, return_index=True)[1]
    inserted = np.zeros(len(vertices), dtype=bool)
    is_line = shapely.get_dimensions(shapes[0]) > 0
    correction = movement.registration.correction
    if is_line and not isinstance(correction, AffineCorrection):
        # numbers that are no whole ones are those of inserted vertices, which alone have no pixel yet
        numbered = np.column_stack([vertices, np.arange(len(vertices))])
        numbered, starts = densify(numbered, place_px, offsets[0].astype(np.intp), correction.forward)
        vertices, inserted = numbered[:, :-1], numbered[:, -1] % 1 != 0
        offsets, drawn_px = (starts, *offsets[1:]), place_px
        place_px = np.empty((len(vertices), 2))
        place_px[~inserted], place_px[inserted] = drawn_px, movement.to_px(vertices[inserted, :2])
    moved_px = movement.moved_px(place_px)
    sigma_m = np.full(len(shapes), np.nan)
    if movement.precision is not None:
        predicted_px = (place_px if movement.is_inverse else moved_px)[~inserted]
        np.fmax.at(sigma_m, of_shape, movement.precision.sigma_m(predicted_px))
    vertices = np.column_stack([movement.to_xy(moved_px), vertices[:, 2:]])
    return np.asarray(shapely.from_ragged_array(kind, vertices, offsets), dtype=object), sigma_m


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
