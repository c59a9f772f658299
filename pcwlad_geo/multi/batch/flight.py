"""A flight index as the table of a batch: each photograph is looked for around its place on a reference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.arguments import shown
from pcwlad_geo.basemaps.tiles import is_tiles, lattice_of
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.raster import Grid, describe, middle_pixel_size_m, open_raster, transform_xy
from pcwlad_geo.raster.vectors import VectorLayer, checked_vector, read_layers
from pcwlad_geo.types import Float64, PathLike

PHOTOGRAPH_ENDINGS: Final = (".tif", ".tiff", ".jpg", ".jpeg", ".png", ".jp2")
"""Endings of photographs whose names in an index have none."""


@dataclass(frozen=True, slots=True)
class FlightParameters:
    """How the part of the reference is chosen that a photograph is looked for in."""

    finest: float = 0.7
    """Least size of a pixel of the photograph, in pixels of the reference that is read: finer ones of the
    reference are averaged, down to its pyramid."""
    least_px: int = 64
    """Least side of the part of the reference."""
    named: float = 0.5
    """Least share of the names in a column that are those of files."""


FLIGHT: Final = FlightParameters()
"""The numbers in use."""


@dataclass(frozen=True, slots=True)
class Flight:
    """What is known of the photographs of an index."""

    reference: str
    """The raster that they are registered to."""
    photos: Path | None = None
    """Their folder; None: that of the index."""
    name_column: str | None = None
    """Column of their file names; None: the one that has them."""
    within: float = 300.0
    """How far, in metres, they may lie from where the index says."""
    photo_size: float | None = None
    """Length of their longer side on the ground, metres: needed of an index of points."""

    @staticmethod
    def of(
        reference: PathLike | None,
        photos: PathLike | None,
        name_column: str | None,
        within: float,
        photo_size: float | None,
    ) -> Flight | None:
        """Return what a user says of a flight; None without a reference.

        Raises `SettingsError` if the other values are no lengths.
        """
        for name, value in (("within", within), ("photo_size", photo_size)):
            if value is not None and not 0 < value < LIMITS.coordinate:
                raise SettingsError(f"{name} = {shown(value)}: give a length in metres above 0")
        if reference is None:
            return None
        folder = None if photos is None else Path(photos)
        return Flight(str(Path(reference).absolute()), folder, name_column, within, photo_size)


@dataclass(frozen=True, slots=True)
class Photo:
    """A photograph of an index."""

    line: int
    """Number of its feature, from 1."""
    path: str
    reference: str
    """The part of the reference around its place; the whole one where there is none."""
    place: str
    """Geotransform, for ``--place``, by the index; empty where it cannot be read."""
    problem: str | None = None
    """Why it is not looked for."""
    extent: tuple[float, float, float, float] | None = None
    """The part of a reference of tiles around its place, as the option ``extent``."""


def photos_of(index: PathLike, flight: Flight) -> list[Photo]:
    """Return the photographs of an index, each with the part of the reference that it is looked for in.

    Raises `InputError` if the index or the reference cannot be used.
    """
    layers = [
        layer for layer in read_layers(checked_vector(index, "flight.gpkg")) if layer.geometry is not None
    ]
    if len(layers) != 1:
        raise InputError(f"{index} has {len(layers)} layers with places: give a file of one")
    layer = layers[0]
    folder = Path(index).absolute().parent if flight.photos is None else flight.photos.absolute()
    names, files = _names(layer, index, flight, folder)
    check_count(str(index), len(names), LIMITS.batch_rows, "photographs")
    is_whole = not is_tiles(flight.reference)
    grid = describe(flight.reference, part=True).grid if is_whole else lattice_of(flight.reference)
    metre = middle_pixel_size_m(grid)
    if metre is None or grid.crs is None or (is_whole and "?" in flight.reference):
        raise InputError(f"{flight.reference}: give a reference with a CRS, and without '?' in its name")
    if layer.crs is None:
        raise InputError(f"{index} has no CRS: assign one (ogr2ogr -a_srs)")
    crs = CRS.from_user_input(layer.crs)
    geometries = shapely.from_wkb(layer.geometry, on_invalid="ignore")
    photos = []
    for line, (name, geometry) in enumerate(zip(names, geometries, strict=True), 1):
        path = files.get(_key(name)) or files.get(Path(_key(name)).stem)
        if path is None:
            photos.append(Photo(line, str(folder / name), flight.reference, "", f"{name} is not in {folder}"))
            continue
        photos.append(_photo(line, path, geometry, crs, grid, max(metre), flight, is_whole=is_whole))
    return photos


def _photo(
    line: int,
    path: str,
    geometry: object,
    crs: CRS,
    grid: Grid,
    px_m: float,
    flight: Flight,
    *,
    is_whole: bool,
) -> Photo:
    """Return a photograph with the part of the reference around its place, of px of `px_m`.

    The reference `is_whole`, or consists of tiles, of which one has the `grid`.
    """
    try:
        with open_raster(path) as dataset:
            shape = dataset.shape
    except InputError as error:
        return Photo(line, path, flight.reference, "", str(error))
    outline = shapely.get_coordinates(geometry)
    at = grid.to_px(transform_xy(outline, crs, grid.crs)) if len(outline) else np.full((1, 2), np.nan)
    if not np.isfinite(at).all():
        return Photo(line, path, flight.reference, "", "the index tells no place in the reference's CRS")
    low, high = at.min(axis=0), at.max(axis=0)
    if np.ptp(at, axis=0).max() < 1:  # a point
        if flight.photo_size is None:
            raise InputError(
                "the index has points: give --photo-size, metres of the longer side on the ground"
            )
        half = math.hypot(1.0, min(shape) / max(shape)) * flight.photo_size / px_m / 2  # turned anyhow
        low, high, side = low - half, high + half, flight.photo_size / px_m
    else:
        area = float(shapely.area(shapely.polygons(at))) if len(at) > 3 else float(np.prod(high - low))
        side = max(shape) * math.sqrt(area / math.prod(shape))
    scale = side / max(shape)
    place = _geotransform((low + high) / 2, scale, shape, grid)
    margin = flight.within / px_m
    if not is_whole:
        corners = grid.to_xy(np.array([low - margin, high + margin]))
        (left, bottom), (right, top) = np.sort(corners, axis=0).tolist()
        return Photo(line, path, flight.reference, place, extent=(left, bottom, right, top))
    rows, cols = grid.shape
    first = np.clip(np.floor(low - margin), 0, (cols, rows)).astype(int)
    size = np.clip(np.ceil(high + margin), 0, (cols, rows)).astype(int) - first
    if size.min() < FLIGHT.least_px:
        return Photo(line, path, flight.reference, place, f"it lies beyond {flight.reference}")
    view = f"vrt://{flight.reference}?srcwin={first[0]},{first[1]},{size[0]},{size[1]}"
    if scale > 1 / FLIGHT.finest:
        coarse = np.maximum(np.rint(size / (scale * FLIGHT.finest)), FLIGHT.least_px).astype(int)
        view += f"&outsize={coarse[0]},{coarse[1]}&r=average"
    return Photo(line, path, view, place)


def _geotransform(middle: Float64, scale: float, shape: tuple[int, int], grid: Grid) -> str:
    """Return the geotransform of a photograph that lies north up around px `middle` of the reference."""
    corners = middle + scale * (np.array([[0, 0], [shape[1], 0], [0, shape[0]]]) - np.array(shape[::-1]) / 2)
    origin, right, down = grid.to_xy(corners)
    across, along = (right - origin) / shape[1], (down - origin) / shape[0]
    numbers = (origin[0], across[0], along[0], origin[1], across[1], along[1])
    return ",".join(f"{number:.10g}" for number in numbers)


def _names(
    layer: VectorLayer, index: PathLike, flight: Flight, folder: Path
) -> tuple[list[str], dict[str, str]]:
    """Return the names of the photographs, and the paths of the files of the folder by their keys."""
    files: dict[str, str] = {}
    for file in sorted(folder.rglob("*") if folder.is_dir() else ()):
        if file.suffix.lower() in PHOTOGRAPH_ENDINGS:
            files.setdefault(_key(file.name), str(file))
            files.setdefault(_key(file.stem), str(file))
    columns = {name: _texts(values) for name, values in zip(layer.fields, layer.values, strict=True)}
    if flight.name_column is not None:
        if flight.name_column not in columns:
            raise InputError(f"{index} has no column '{flight.name_column}', only {', '.join(columns)}")
        return columns[flight.name_column], files
    for names in columns.values():
        share = np.mean([_key(name) in files for name in names]) if names else 0.0
        if share >= FLIGHT.named:
            return names, files
    raise InputError(
        f"no column of {index} ({', '.join(columns) or 'none'}) has the names of photographs in {folder}: "
        "give --photos FOLDER, and --name-column"
    )


def _texts(values: NDArray[np.generic]) -> list[str]:
    return [str(value) for value in values]


def _key(name: str) -> str:
    """Return what is equal of two names of one file: an index may tell a folder of another computer."""
    return name.replace("\\", "/").rpartition("/")[2].strip().casefold()
