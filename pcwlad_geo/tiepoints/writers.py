"""Writers of tie points: CSV, the GCP files of QGIS, ENVI and GDAL, and the GeoPackage with its styles."""

from __future__ import annotations

import csv
import math
import sqlite3
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.errors import OutputError
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import moved_xy
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.tiepoints.table import COLUMNS, ENVI_ORIGIN_PX, TiePointTable, columns_of
from pcwlad_geo.types import Float64


def write_csv(table: TiePointTable, path: Path) -> None:
    """Write the table as UTF-8 CSV, one row a tie point; NaN becomes an empty cell.

    Pixels and metres are written to 1e-6, map coordinates to 15 significant digits.
    """
    cells = [_cells(name, values.tolist()) for name, values in columns_of(table).items()]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(zip(*cells, strict=True))


def _cells(name: str, values: list[Any]) -> list[str]:
    """Return the texts of a column."""
    if not values or not isinstance(values[0], float):
        return list(map(str, values))
    form = "{:.15g}" if name in ("x", "y") else "{:.6f}"
    zero = form.format(-0.0)
    texts = ["" if text in ("nan", "inf", "-inf") else text for text in map(form.format, values)]
    return [text[1:] if text == zero else text for text in texts]


def write_points(
    table: TiePointTable, path: Path, target_info_georeferenced: bool, target_grid: Grid
) -> None:
    """Write a `.points` file of the QGIS Georeferencer; rejected points are included, but not enabled.

    Points without a position in both files and on the map are left out, as in all files of control points.
    mapX, mapY = `xy`; dX, dY = -`residual_px`, 0 where unknown: QGIS defines residuals as predicted minus
    observed, in pixels, columns to the right and rows down. It loads `<target file name>.points` with the
    raster beside it, and expects layer coordinates where that is georeferenced, otherwise (col, -row).
    """
    table = table.placed
    if target_info_georeferenced:
        source_xy = target_grid.to_xy(table.target_px)
    else:
        source_xy = table.target_px * np.array([1.0, -1.0])
    qgis_residual_px = -np.nan_to_num(table.residual_px)
    lines = [] if table.crs is None else [f"#CRS: {' '.join(table.crs.to_wkt(version='WKT2_2019').split())}"]
    lines.append("mapX,mapY,sourceX,sourceY,enable,dX,dY,residual")
    for xy, source, (d_x, d_y), status in zip(
        table.xy, source_xy, qgis_residual_px, table.status, strict=True
    ):
        numbers = [_number(value) for value in (*xy, *source)]
        residuals = [_number(round(value, 6)) for value in (d_x, d_y, np.hypot(d_x, d_y))]
        lines.append(",".join([*numbers, "0" if status == "rejected" else "1", *residuals]))
    _write_lines(path, lines)


def write_envi(table: TiePointTable, path: Path, reference_name: str, target_name: str) -> None:
    """Write an ENVI image-to-image `.pts` file; rejected points are left out.

    Base = `reference_px`, warp = `target_px`, both + 1 because ENVI counts from 1. The names are those of the
    base and the warp file, for the header.
    """
    used = table[table.status != "rejected"].placed
    lines = [
        "; ENVI Image to Image GCP File",
        f"; base file: {_without_line_breaks(reference_name)}",
        f"; warp file: {_without_line_breaks(target_name)}",
        "; Base Image (x,y), Warp Image (x,y)",
        ";",
    ]
    for base, warp in zip(used.reference_px + ENVI_ORIGIN_PX, used.target_px + ENVI_ORIGIN_PX, strict=True):
        lines.append(" ".join(f"{value:14.6f}" for value in (*base, *warp)))
    _write_lines(path, lines)


def _number(value: float) -> str:
    return f"{value + 0.0:.15g}"


def _without_line_breaks(name: str) -> str:
    """Return a file name without line breaks, as the next line would be read as a tie point."""
    return "_".join(name.splitlines())


def _write_lines(path: Path, lines: list[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")


def write_gcps_vrt(
    path: Path, target_path: str | Path, table: TiePointTable, crs: CRS | None, *, final_path: Path
) -> None:
    """Write a VRT of the target with the tie points as ground control points; rejected ones are left out.

    Pixel, line = `target_px`; X, Y = `xy`, in the CRS, without one in the pixel plane, y = -row. The path to
    the target in it is relative to the folder of its `final_path`.
    """
    tree = vrt.describe_file(target_path, final_path)
    # Copies of a file with GCPs and AREA_OR_POINT=Point would be shifted by a pixel.
    for item in tree.iter("MDI"):
        if item.get("key") == "AREA_OR_POINT":
            item.text = "Area"
    tree.insert(0, _gcp_list(table[table.status != "rejected"].placed, crs))
    vrt.write(tree, path)


def _gcp_list(table: TiePointTable, crs: CRS | None) -> ET.Element:
    gcps = ET.Element("GCPList")
    if crs is not None:
        gcps.set("Projection", crs.to_wkt(version="WKT2_2019"))
    for number, (pixel, xy) in enumerate(zip(table.target_px, table.xy, strict=True), start=1):
        attributes = {"Id": str(number), "Pixel": f"{pixel[0]:.6f}", "Line": f"{pixel[1]:.6f}"}
        ET.SubElement(gcps, "GCP", attributes, X=repr(float(xy[0])), Y=repr(float(xy[1])))
    return gcps


LIMITS_PX: Final = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Class limits of residuals for the colours, the same for all registrations so that they can be compared."""
COLOURS: Final = ("68,1,84", "59,82,139", "33,145,140", "94,201,98", "253,231,37", "213,94,0")
"""Colours of the classes, RGB, from dark to bright: distinguishable with colour blindness."""
NOT_FITTED, REJECTED = "0,114,178", "130,130,130"
"""Colours of points without a residual and of rejected points, RGB."""
LENGTH: Final = 'sqrt("residual_col"^2 + "residual_row"^2)'
"""Expression of QGIS for the length of the residual, px."""


@dataclass(frozen=True, slots=True)
class _Rule:
    """A rule of a QGIS style: a filter and the symbol of its features."""

    label: str
    filter: str
    symbol: ET.Element
    shown: bool = True


def enlargement(from_xy: Float64, to_xy: Float64) -> float:
    """Return the factor by which arrows are drawn longer: 1, 2 or 5 times a power of ten, at least 1.

    Arrows go from the (n, 2) `from_xy` to the (n, 2) `to_xy` (x, y), map units.
    """
    lengths = np.hypot(*(to_xy - from_xy).T)
    lengths = lengths[np.isfinite(lengths)]
    typical = float(np.median(lengths)) if len(lengths) else 0.0
    side = float(np.ptp(from_xy, axis=0).max()) if len(from_xy) else 0.0
    wanted = 0.03 * side / typical if typical > 0 else 1.0
    if not 1.0 < wanted < math.inf:
        return 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9))


def points_style() -> str:
    """Return the style of the points: rings round check points, crosses on rejected ones."""
    ring = _point("circle", "0,0,0,0", "204,121,167,255", "0.4", "3.2")
    rules = [_Rule("rejected", "\"status\" = 'rejected'", _marker("cross2", REJECTED))]
    rules += [_Rule(label, filter_, _marker("circle", colour)) for label, filter_, colour in _classes()]
    rules.append(_Rule("check point", "\"status\" = 'check'", ring))
    return _style("marker", rules)


def arrows_style(factor: float) -> str:
    """Return the style of the displacements: arrows longer than the lines by a factor."""
    times = "" if factor == 1 else f" (arrows × {factor:g})"
    rules = [
        _Rule("rejected" + times, "\"status\" = 'rejected'", _arrow(REJECTED, factor), shown=False),
        *(_Rule(label + times, filter_, _arrow(colour, factor)) for label, filter_, colour in _classes()),
    ]
    return _style("line", rules)


def _classes() -> list[tuple[str, str, str]]:
    """Return label, filter and colour of points that are not rejected."""
    kept = "\"status\" <> 'rejected'"
    found = [("not fitted", f'{kept} AND "residual_col" IS NULL', NOT_FITTED)]
    for low, high, colour in zip((None, *LIMITS_PX), (*LIMITS_PX, None), COLOURS, strict=True):
        above = "" if low is None else f" AND {LENGTH} > {low:g}"
        below = "" if high is None else f" AND {LENGTH} <= {high:g}"
        words = (
            f"up to {high:g}" if low is None else f"over {low:g}" if high is None else f"{low:g} to {high:g}"
        )
        found.append((f"residual {words} px", f'{kept} AND "residual_col" IS NOT NULL{above}{below}', colour))
    return found


def _marker(shape: str, colour: str) -> ET.Element:
    cross = shape == "cross2"
    outline, width = (f"{colour},255", "0.3") if cross else ("255,255,255,255", "0.15")
    return _point(shape, f"{colour},255", outline, width, "1.8")


def _point(shape: str, fill: str, outline: str, width: str, size: str) -> ET.Element:
    marker = {"name": shape, "color": fill, "outline_color": outline, "outline_width": width}
    return _layer("SimpleMarker", **marker, size=size, size_unit="MM")


def _arrow(colour: str, factor: float) -> ET.Element:
    fill = ET.Element("symbol", type="fill", name="@@0@0@0", alpha="1")
    fill.append(_layer("SimpleFill", color=f"{colour},255", style="solid", outline_style="no"))
    sizes_mm = {
        "arrow_width": "0.35",
        "arrow_start_width": "0.35",
        "head_length": "1.5",
        "head_thickness": "0.8",
    }
    units = {f"{name}_unit": "MM" for name in sizes_mm}
    plain = dict.fromkeys(("head_type", "arrow_type", "is_curved", "is_repeated"), "0")
    arrow = _layer("ArrowLine", **sizes_mm, **units, **plain)
    arrow.append(fill)
    line = ET.Element("symbol", type="line", name="@0@0", alpha="1")
    line.append(arrow)
    begin, end = "start_point($geometry)", "end_point($geometry)"
    step = ", ".join(f"{factor:g} * ({axis}({end}) - {axis}({begin}))" for axis in ("x", "y"))
    longer = _layer(
        "GeometryGenerator",
        SymbolType="Line",
        geometryModifier=f"make_line({begin}, translate({begin}, {step}))",
        units="MapUnit",
    )
    longer.append(line)
    return longer


def _layer(symbol_class: str, **properties: str) -> ET.Element:
    layer = ET.Element("layer", {"class": symbol_class, "enabled": "1", "pass": "0", "locked": "0"})
    for key, value in properties.items():
        ET.SubElement(layer, "prop", k=key, v=value)
    return layer


def _style(kind: str, rules: Sequence[_Rule]) -> str:
    style = ET.Element("qgis", version="3.16.0", styleCategories="Symbology")
    renderer = ET.SubElement(style, "renderer-v2", type="RuleRenderer", symbollevels="0", forceraster="0")
    listed = ET.SubElement(renderer, "rules", key="all")
    library = ET.SubElement(renderer, "symbols")
    for index, rule in enumerate(rules):
        state = {} if rule.shown else {"checkstate": "0"}
        attributes = {
            "key": f"rule {index}",
            "symbol": str(index),
            "label": rule.label,
            "filter": rule.filter,
        }
        ET.SubElement(listed, "rule", attributes | state)
        symbol = ET.SubElement(library, "symbol", type=kind, name=str(index), alpha="1")
        symbol.append(rule.symbol)
    return "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n" + ET.tostring(
        style, encoding="unicode"
    )


# A constant time stamp, so that the same points give the same file.
_TIMESTAMP = "2000-01-01T00:00:00.000Z"
# GDAL's default, 1.4, causes warnings in older versions of QGIS; nothing of 1.4 is needed.
# GDAL maps this name to GeoPackage's CRS -1, a plane without a CRS.
_UNDEFINED_PLANE = 'LOCAL_CS["Undefined Cartesian SRS"]'


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
    kept = (table.status != "rejected") & np.isfinite(lines_xy).all(axis=(1, 2))
    arrows = arrows_style(enlargement(table.xy[kept], shown_xy[kept]))
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


def _geometry(make: Callable[[Float64], NDArray[np.object_]], coordinates: Float64) -> NDArray[np.object_]:
    """Return the (n,) geometries of (n, …) coordinates; None where a coordinate is NaN."""
    known = np.isfinite(coordinates).all(axis=tuple(range(1, coordinates.ndim)))
    geometry = np.full(len(coordinates), None, dtype=object)
    geometry[known] = make(coordinates[known])
    return geometry


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
