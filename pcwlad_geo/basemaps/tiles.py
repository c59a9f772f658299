"""A folder of tiles, or an index of them, as reference: a VRT of those that show the ground of a target."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from rasterio.crs import CRS
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import may_hold_product
from pcwlad_geo.raster import Grid, RasterInfo, describe, jacobian, map_px, open_raster, transform_xy, vrt
from pcwlad_geo.raster.file_tree import tree_of
from pcwlad_geo.raster.vectors import VectorLayer, checked_vector, read_layers, sqlite_file
from pcwlad_geo.registration import Inputs
from pcwlad_geo.text import is_uri
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class TileParameters:
    """How tiles are found and put together."""

    endings: tuple[str, ...] = (".tif", ".tiff", ".jp2", ".img", ".png", ".jpg", ".jpeg", ".webp")
    """Endings of the files of tiles. Of a folder those with the ending that most of its files have count."""
    indexes: tuple[str, ...] = (".gpkg", ".shp", ".fgb", ".geojson")
    """Endings of the files of an index."""
    columns: tuple[str, ...] = ("location", "path", "filename", "file")
    """Columns of an index that may hold the names of the tiles, the first one that there is."""
    asset: re.Pattern[str] = re.compile(r"assets\.[^.]+\.href", re.IGNORECASE)
    """The only such column otherwise: an asset of STAC items, as GDAL writes stac-geoparquet."""
    margin_px: int = 64
    """Margin around the target besides the search radius."""
    radius_px: int = 64
    """What the search radius counts where none is given."""
    off_px: float = 0.02
    """Largest distance of the pixels of a tile from those of the others."""


TILES: Final = TileParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class _Listed:
    """A tile that a folder or an index lists."""

    path: str
    box: tuple[float, float, float, float] | None = None
    """Left, bottom, right, top of its footprint in the CRS of the index, if that tells it."""


def is_tiles(name: str) -> bool:
    """Return whether a name is that of a folder of tiles, but no product, or of a vector file, an index."""
    place = Path(name)
    try:
        if place.is_dir():
            files = (file for pattern in ("*", "*/*") for file in place.glob(pattern))
            return not may_hold_product(place) and any(map(_is_tile, files))
        if place.suffix.lower() != ".gpkg":
            return place.suffix.lower() in TILES.indexes and place.is_file()
        with sqlite_file(place, allows_views=True) as database:
            kinds = database.execute("SELECT DISTINCT data_type FROM gpkg_contents").fetchall()
        return kinds == [("features",)]  # others hold a raster
    except (OSError, ValueError, sqlite3.Error):
        return False


def lattice_of(name: str) -> Grid:
    """Return the grid of the first of the tiles, whose pixels those beside it continue.

    Raises `InputError` if there is none, or it cannot be used.
    """
    return _described(_listed(name)[0][0].path).grid


def gather(name: str, inputs: Inputs, path: Path) -> Settings:
    """Write the VRT of the tiles that a target needs; return the settings to match with it.

    They are those of its footprint, as the settings place it, within their extent, and a margin. Of a target
    that nothing places it is what lies within the extent, cut out of them. Raises `InputError` if a tile is
    missing, damaged or other than those beside it, or none shows the ground.
    """
    listed, crs = _listed(name)
    first = _described(listed[0].path)
    box_px, settings = _needed(name, first, inputs)
    tiles = []
    for tile in listed:
        if _beyond(tile, crs, first, box_px):
            continue
        info = first if tile is listed[0] else _described(tile.path)
        outline_px = map_px(info.grid.boundary_px(), info.grid, first.grid)
        if _meets(outline_px, box_px):
            _check_end(info)
            tiles.append(info)
    if not tiles:
        raise InputError(
            f"none of the {len(listed)} tiles of {name} shows ground of {inputs.target}: check the "
            "georeferencing of both, or say with --place where it lies"
        )
    cut = box_px is not None and settings.extent != inputs.settings.extent
    _write(path, tiles, first.grid.to_xy(box_px) if box_px is not None and cut else None)
    return settings


def _listed(name: str) -> tuple[list[_Listed], CRS | None]:
    return _of_folder(Path(name)) if Path(name).is_dir() else _of_index(name)


def _is_tile(file: Path) -> bool:
    return file.suffix.lower() in TILES.endings


def _of_folder(folder: Path) -> tuple[list[_Listed], None]:
    """Return the tiles below a folder."""
    names = [name for name in tree_of(folder).names if _is_tile(Path(name))]
    check_count(str(folder), len(names), LIMITS.members, "tiles")
    ending, _ = Counter(Path(name).suffix.lower() for name in names).most_common(1)[0]
    return [_Listed(str(folder / name)) for name in names if name.lower().endswith(ending)], None


def _of_index(name: str) -> tuple[list[_Listed], CRS | None]:
    """Return the tiles of an index, and the CRS of their footprints."""
    import shapely

    layers = [layer for layer in read_layers(checked_vector(name, "index.gpkg")) if _column(layer)]
    if len(layers) != 1 or not len(layers[0].values[0]):
        raise InputError(
            f"{name} is no index of tiles: of a single layer one of the columns {', '.join(TILES.columns)} "
            "must name their files, as gdaltindex writes it, or "
            "a single column assets.….href"
        )
    (layer,) = layers
    names = [str(value) for value in layer.values[layer.fields.index(_column(layer))]]
    check_count(name, len(names), LIMITS.members, "tiles")
    boxes: list[tuple[float, float, float, float] | None] = [None] * len(names)
    if layer.geometry is not None and layer.crs is not None:
        bounds = shapely.bounds(shapely.from_wkb(layer.geometry, on_invalid="ignore"))
        boxes = [tuple(box) if np.isfinite(box).all() else None for box in bounds.tolist()]
    folder = Path(name).absolute().parent
    listed = [_Listed(_file_named(tile, folder, name), box) for tile, box in zip(names, boxes, strict=True)]
    return listed, None if layer.crs is None else CRS.from_user_input(layer.crs)


def _column(layer: VectorLayer) -> str:
    """Return the column that names the files; empty if there is none."""
    fields = {field.lower(): field for field in layer.fields}
    assets = [field for field in layer.fields if TILES.asset.fullmatch(field)]
    lone = assets[0] if len(assets) == 1 else ""
    return next((fields[column] for column in TILES.columns if column in fields), lone)


def _file_named(tile: str, folder: Path, index: str) -> str:
    """Return the path of a tile, which an index names by itself or beside the index."""
    if is_uri(tile) and not Path(tile).is_file():
        raise InputError(f"{index} names {tile}, which is no plain file of this machine: get the tiles first")
    return str(folder / tile) if (folder / tile).exists() else str(Path(tile).absolute())


def _described(path: str) -> RasterInfo:
    info = describe(path, part=True)
    if info.grid.crs is None:
        raise InputError(f"the tile {path} has no georeferencing: add it (gdal_edit.py), or move the file")
    return info


def _check_end(info: RasterInfo) -> None:
    """Raise `InputError` if the last pixel of a tile cannot be read: its file was cut short.

    GDAL does not name a damaged source of a VRT.
    """
    rows, cols = info.grid.shape
    with open_raster(info.uri) as dataset:
        dataset.read(1, window=FileWindow(cols - 1, rows - 1, 1, 1))


def _needed(name: str, first: RasterInfo, inputs: Inputs) -> tuple[Float64 | None, Settings]:
    """Return the (2, 2) box that is needed, px of the first tile, None for all; and the settings to match."""
    info, settings = inputs.target_beside(replace(first, uri=name)), inputs.settings
    extent_px = None
    if settings.extent is not None:
        extent_px = first.grid.to_px(np.reshape(settings.extent, (2, 2)))
        extent_px = np.array([extent_px.min(axis=0), extent_px.max(axis=0)])
    if not info.georeferenced:
        return extent_px, replace(settings, extent=None)
    outline_px = map_px(info.grid.boundary_px(), info.grid, first.grid)
    if not np.isfinite(outline_px).all():
        raise InputError(f"{inputs.target} lies where the CRS of {name} has no coordinates: give other tiles")
    step = np.linalg.norm(jacobian(info.grid.middle_px, info.grid, first.grid)[0], axis=0).max()
    margin_px = (TILES.margin_px + (settings.search_radius or TILES.radius_px)) * max(1.0, step)
    box_px = np.array([outline_px.min(axis=0) - margin_px, outline_px.max(axis=0) + margin_px])
    return box_px if extent_px is None else np.clip(box_px, *extent_px), settings


def _beyond(tile: _Listed, crs: CRS | None, first: RasterInfo, box_px: Float64 | None) -> bool:
    """Whether the footprint of a tile tells that it is not needed."""
    if tile.box is None or crs is None or box_px is None:
        return False
    left, bottom, right, top = tile.box
    corners = transform_xy(
        np.array([[left, bottom], [left, top], [right, bottom], [right, top]]), crs, first.grid.crs
    )
    margin_px = np.array([[-1.0], [1.0]]) * TILES.margin_px  # footprints may be drawn roughly
    return not _meets(first.grid.to_px(corners), box_px + margin_px)


def _meets(outline_px: Float64, box_px: Float64 | None) -> bool:
    if box_px is None:
        return True
    low, high = outline_px.min(axis=0), outline_px.max(axis=0)
    return bool((low < box_px[1]).all() and (high > box_px[0]).all())


def _write(path: Path, tiles: Sequence[RasterInfo], within_xy: Float64 | None) -> None:
    """Write the VRT of tiles, which refers to them by absolute paths, or of what lies between two corners."""
    first = tiles[0]
    offsets = np.array(list(_offsets_px(tiles)))
    low = offsets.min(axis=0)
    high = (offsets + [tile.grid.shape[::-1] for tile in tiles]).max(axis=0)
    if within_xy is not None:
        corners = first.grid.to_px(within_xy)
        low = np.maximum(low, np.floor(corners.min(axis=0)).astype(int))
        high = np.minimum(high, np.ceil(corners.max(axis=0)).astype(int))
    col, row = low.tolist()
    files = [
        vrt.MosaicFile(str(Path(tile.uri).absolute()), tile.grid.shape, (int(place[0]), int(place[1])))
        for tile, place in zip(tiles, offsets - low, strict=True)
    ]
    width, height = (high - low).tolist()
    with open_raster(first.uri) as source:
        tree = vrt.describe_mosaic(source, files, (int(height), int(width)))
    whole = first.grid.resampled_grid(((1, 0), (0, 1)), (col, row), (int(height), int(width)))
    vrt.add_georeferencing(tree, whole.transform, whole.crs)
    vrt.write(tree, path)


def _offsets_px(tiles: Sequence[RasterInfo]) -> Iterator[tuple[int, int]]:
    """Yield where the tiles begin (col, row), px of the first one.

    Raises `InputError` if one does not lie on the same pixels, or holds other values.
    """
    first = tiles[0]
    for tile in tiles:
        rows, cols = tile.grid.shape
        kinds = [(info.band_count, info.dtype, info.nodata) for info in (tile, first)]
        if repr(kinds[0]) != repr(kinds[1]):  # nodata may be NaN
            described = [f"{count} bands of {dtype} with nodata {nodata}" for count, dtype, nodata in kinds]
            raise InputError(
                f"the tiles {tile.uri} ({described[0]}) and {first.uri} ({described[1]}) differ: give "
                "those of one kind, in a folder or an index of their own"
            )
        corners = map_px(np.array([[0.0, 0.0], [cols, rows]]), tile.grid, first.grid)
        begin = np.rint(corners[0])
        off_px = np.abs(corners - begin - [[0, 0], [cols, rows]]).max()
        if tile.grid.crs != first.grid.crs or not off_px <= TILES.off_px:
            raise InputError(
                f"the tiles {tile.uri} and {first.uri} have other pixels (size, CRS or position), and both "
                "show ground of the target: give those of one grid, or a mosaic of them (gdalwarp)"
            )
        yield int(begin[0]), int(begin[1])
