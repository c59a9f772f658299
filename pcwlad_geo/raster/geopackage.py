"""`tiepoints.gpkg`: tie points and displacement lines with their styles, for QGIS."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from pcwlad_geo.errors import OutputError
from pcwlad_geo.raster import qgis_styles, tie_point_csv
from pcwlad_geo.raster.geodesy import moved_xy
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.tie_point_table import TiePointTable

Array = NDArray[np.float64]

# The same points make the same file: its time stamps are this one.
_TIMESTAMP = "2000-01-01T00:00:00.000Z"
# GDAL's own choice, 1.4, makes the GDAL of older QGIS warn; nothing of 1.4 is used.
_VERSION = "1.2"
# GDAL maps this name to GeoPackage's CRS -1, a plane without a CRS.
_UNDEFINED_PLANE = 'LOCAL_CS["Undefined Cartesian SRS"]'


def write(table: TiePointTable, path: Path, target_grid: Grid | None = None) -> None:
    """Write the layers `tie_points` and `displacements`, each with the columns of tiepoints.csv.

    Displacements are lines from the predicted to the observed place on the map, true to scale; their style
    draws them longer.
    Without a CRS the map is the plane that both geotransforms share, or else the pixel plane of the
    reference, y = -row.

    Parameters
    ----------
    table : TiePointTable
        All its points are written, rejected ones too; what has no place on the map has no geometry.
    path : pathlib.Path
        The file to write.
    target_grid : Grid, optional
        Where the target lies, for a plane that both share.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    # inside: GDAL's messages are kept from the terminal in the thread that loads it
    import pyogrio.raw
    from pyogrio.errors import DataLayerError, DataSourceError

    seen_xy = observed_xy(table, target_grid)
    lines_xy = np.stack([table.xy, seen_xy], axis=1)
    layers = {
        "tie_points": ("Point", _geometry(shapely.points, table.xy)),
        "displacements": ("LineString", _geometry(shapely.linestrings, lines_xy)),
    }
    kept = (table.status != "rejected") & np.isfinite(lines_xy).all(axis=(1, 2))
    arrows = qgis_styles.arrows_style(qgis_styles.enlargement(table.xy[kept], seen_xy[kept]))
    styles = {"tie_points": qgis_styles.points_style(), "displacements": arrows}
    columns = tie_point_csv.columns_of(table)
    try:
        for name, (geometry_type, geometry) in layers.items():
            pyogrio.raw.write(
                str(path),
                geometry=shapely.to_wkb(geometry),
                field_data=[_field(values) for values in columns.values()],
                fields=list(columns),
                layer=name,
                driver="GPKG",
                dataset_options={"VERSION": _VERSION},
                geometry_type=geometry_type,
                crs=_UNDEFINED_PLANE if table.crs is None else table.crs.to_wkt(version="WKT2_2019"),
            )
        with closing(sqlite3.connect(path)) as database, database:
            _add_styles(database, styles)
    except (DataSourceError, DataLayerError, sqlite3.Error, OSError) as error:
        raise OutputError(f"cannot write {path}: {error}; is the disk full?") from error


def _geometry(make: Callable[[Array], NDArray[np.object_]], coordinates: Array) -> NDArray[np.object_]:
    """Make a geometry of each of (n, …) coordinates; None where one of them is not known."""
    known = np.isfinite(coordinates).all(axis=tuple(range(1, coordinates.ndim)))
    geometry = np.full(len(coordinates), None, dtype=object)
    geometry[known] = make(coordinates[known])
    return geometry


def observed_xy(table: TiePointTable, target_grid: Grid | None = None) -> Array:
    """Return (n, 2): where the observed target position lies on the map, in units of the reference CRS."""
    if target_grid is not None and target_grid.crs is None and target_grid.located:
        return target_grid.to_xy(table.target_px)
    if table.crs is None:
        plane_xy: Array = table.xy + table.displacement_px * np.array([1.0, -1.0])
        return plane_xy
    return moved_xy(table.xy, table.displacement_m, table.crs)


def _field(values: NDArray[np.generic]) -> NDArray[np.generic]:
    return values.astype(object) if values.dtype.kind == "U" else np.ascontiguousarray(values)


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


def _add_styles(database: sqlite3.Connection, styles: Mapping[str, str]) -> None:
    """Add QGIS's table of styles; a layer takes its default style from there."""
    database.execute(_LAYER_STYLES)
    database.execute(_CONTENTS, (_TIMESTAMP,))
    geometry_columns = dict(database.execute("SELECT table_name, column_name FROM gpkg_geometry_columns"))
    for layer, style in styles.items():
        database.execute(_STYLE, (layer, geometry_columns[layer], layer, style, _TIMESTAMP))
    database.execute("UPDATE gpkg_contents SET last_change = ?", (_TIMESTAMP,))
