"""Tie points as a GeoPackage, with its styles."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.crs import moved_xy
from pcwlad_geo.raster.vectors import sqlite_file
from pcwlad_geo.tiepoints.cells import Table
from pcwlad_geo.tiepoints.csv_file import points_of
from pcwlad_geo.tiepoints.format import PointFile, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.qgis_styles import arrows_style, enlargement, points_style
from pcwlad_geo.tiepoints.table import POINT_COLUMNS, TiePointTable, columns_of
from pcwlad_geo.types import Float64

# A constant time stamp, so that the same points give the same file.
_TIMESTAMP = "2000-01-01T00:00:00.000Z"
# GDAL's default, 1.4, causes warnings in older versions of QGIS; nothing of 1.4 is needed.
# GDAL maps this name to GeoPackage's CRS -1, a plane without a CRS.
_UNDEFINED_PLANE = 'LOCAL_CS["Undefined Cartesian SRS"]'
_LAYER_STYLES = """
CREATE TABLE layer_styles (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    f_table_catalog TEXT(256), f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
    styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN,
    description TEXT, owner TEXT(30), ui TEXT(30), update_time DATETIME
)
"""
_CONTENTS = """
INSERT INTO gpkg_contents (table_name, data_type, identifier, description, last_change)
VALUES ('layer_styles', 'attributes', 'layer_styles', '', ?)
"""
_STYLE = """
INSERT INTO layer_styles (
    f_table_catalog, f_table_schema, f_table_name, f_geometry_column,
    styleName, styleQML, styleSLD, useAsDefault, description, owner, update_time
) VALUES ('', '', ?, ?, ?, ?, '', 1, '', '', ?)
"""


def write_geopackage(table: TiePointTable, path: Path, target_grid: Grid | None = None) -> None:
    """Write the layers `tie_points` and `displacements`, each with the columns of tiepoints.csv.

    Displacements are lines from the predicted to the observed position on the map, true to scale; their style
    draws them longer. Without a CRS the map is the plane shared by both geotransforms, for which the target's
    grid is needed, or else the pixel plane of the reference, y = -row. All points are written, including
    rejected ones; those without map coordinates have no geometry. Raises `OutputError` if the file cannot be
    written.
    """
    # imported here: GDAL's messages are suppressed in the thread that loads it
    import pyogrio.raw
    from pyogrio.errors import DataLayerError, DataSourceError

    shown_xy = observed_xy(table, target_grid)
    lines_xy = np.stack([table.xy, shown_xy], axis=1)
    layers = {
        "tie_points": ("Point", _geometry(shapely.points, table.xy)),
        "displacements": ("LineString", _geometry(shapely.linestrings, lines_xy)),
    }
    drawn = (table.status != "rejected") & np.isfinite(lines_xy).all(axis=(1, 2))
    arrows = arrows_style(enlargement(table.xy[drawn], shown_xy[drawn]))
    styles = {"tie_points": points_style(), "displacements": arrows}
    columns = columns_of(table)
    ordered = path.with_name(f"{path.name}.ordered")
    try:
        for name, (geometry_type, geometry) in layers.items():
            pyogrio.raw.write(
                str(path),
                geometry=shapely.to_wkb(geometry),
                field_data=[
                    values.astype(object) if values.dtype.kind == "U" else np.ascontiguousarray(values)
                    for values in columns.values()
                ],
                fields=list(columns),
                layer=name,
                driver="GPKG",
                dataset_options={"VERSION": "1.2"},
                geometry_type=geometry_type,
                crs=_UNDEFINED_PLANE if table.crs is None else table.crs.to_wkt(version="WKT2_2019"),
            )
        with closing(sqlite3.connect(path)) as database:
            with database:
                _add_styles(database, styles)
            # A copy in SQLite's own order: how GDAL lays out its pages depends on its version and threads.
            database.execute("VACUUM INTO ?", (str(ordered),))
        ordered.replace(path)
    except (DataSourceError, DataLayerError, sqlite3.Error, OSError) as error:
        raise OutputError(f"cannot write {path}: {error}; is the disk full?") from error


def observed_xy(table: TiePointTable, target_grid: Grid | None = None) -> Float64:
    """Return the (n, 2) map coordinates (x, y) of the observed target positions of `table`.

    They are in units of the reference CRS; without one in the plane of `target_grid`, or the pixel plane.
    """
    if target_grid is not None and target_grid.crs is None and target_grid.located:
        return target_grid.to_xy(table.target_px)
    if table.crs is None:
        plane_xy: Float64 = table.xy + table.displacement_px * np.array([1.0, -1.0])
        return plane_xy
    return moved_xy(table.xy, table.displacement_m, table.crs)


def _geometry(make: Callable[[Float64], NDArray[np.object_]], coordinates: Float64) -> NDArray[np.object_]:
    """Return the (n,) geometries of (n, …) coordinates; None where a coordinate is NaN."""
    is_finite = np.isfinite(coordinates).all(axis=tuple(range(1, coordinates.ndim)))
    geometry = np.full(len(coordinates), None, dtype=object)
    geometry[is_finite] = make(coordinates[is_finite])
    return geometry


def _add_styles(database: sqlite3.Connection, styles: Mapping[str, str]) -> None:
    """Add QGIS's table of styles, from which a layer takes its default style."""
    database.execute(_LAYER_STYLES)
    database.execute(_CONTENTS, (_TIMESTAMP,))
    geometry_columns = dict(database.execute("SELECT table_name, column_name FROM gpkg_geometry_columns"))
    if (
        missing := styles.keys() - geometry_columns.keys()
    ):  # GDAL does not report that it could not write them
        raise OSError(f"there is no layer {', '.join(sorted(missing))} in it")
    for layer, style in styles.items():
        database.execute(_STYLE, (layer, geometry_columns[layer], layer, style, _TIMESTAMP))
    database.execute("UPDATE gpkg_contents SET last_change = ?", (_TIMESTAMP,))


def _read(source: PointSource) -> PointFile:
    """Read the columns of the layer tie_points, without its geometries."""
    path = source.path
    names = ", ".join(f'iif(length("{name}") < 100, "{name}", NULL)' for name in POINT_COLUMNS)
    try:
        with sqlite_file(Path(path)) as database:
            cells = database.execute(f"SELECT {names} FROM tie_points").fetchmany(LIMITS.points + 1)
    except sqlite3.Error as error:
        raise InputError(f"{path} holds no layer tie_points as pcwlad-geo writes it: {error}") from error
    check_count(path, len(cells), LIMITS.points, "points")
    rows = [
        (
            number,
            {name: "" if cell is None else str(cell) for name, cell in zip(POINT_COLUMNS, row, strict=True)},
        )
        for number, row in enumerate(cells, start=1)
    ]
    return points_of(Table(path, POINT_COLUMNS, rows))


GEOPACKAGE: Final = TiePointFormat(
    "geopackage", lambda source: source.head.startswith(b"SQLite format 3\0"), _read
)
"""The format of tiepoints.gpkg, which a job writes with its report."""
