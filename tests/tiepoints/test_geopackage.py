"""tiepoints.gpkg: geometry true to scale, attributes, styles, and the same bytes for the same points."""

from __future__ import annotations

import sqlite3
import warnings
import xml.etree.ElementTree as ET
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio
import pyogrio.raw
import pytest
import shapely
from pyproj import Geod
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError, OutputError, TrustError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster import Trust, trusting
from pcwlad_geo.raster.crs import displacement_m
from pcwlad_geo.tiepoints import geopackage
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import POINT_COLUMNS, TiePointTable


def table(crs: CRS | None, xy: np.ndarray, displacement_m: np.ndarray) -> TiePointTable:
    n = len(xy)
    predicted_px = np.arange(2.0 * n).reshape(n, 2)
    return TiePointTable(
        reference_px=predicted_px,
        target_px=predicted_px + np.array([0.25, -0.5]),
        predicted_px=predicted_px,
        xy=xy,
        displacement_m=displacement_m,
        covariance_px2=np.tile(np.eye(2) * 0.01, (n, 1, 1)),
        score=np.linspace(0, 1, n),
        residual_px=np.full((n, 2), np.nan),
        status=np.array(["fit", "check", "rejected", "unused"])[np.arange(n) % 4],
        crs=crs,
    )


def lines(path: Path) -> np.ndarray:
    geometry = shapely.from_wkb(pyogrio.raw.read(path, layer="displacements")[2])
    return shapely.get_coordinates(geometry).reshape(-1, 2, 2)


UTM_TABLE = table(
    CRS.from_epsg(32633),
    np.array([[5e5, 49e5], [6e5, 48e5], [55e4, 5e6]]),
    np.array([[3.0, -4], [0, 1], [-7, 0]]),
)


def test_points_lines_and_attributes(tmp_path: Path) -> None:
    path = tmp_path / "tiepoints.gpkg"
    geopackage.write_geopackage(UTM_TABLE, path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layers = [name for name, kind in pyogrio.list_layers(path) if kind]
        meta, _, geometry, fields = pyogrio.raw.read(path, layer="tie_points")
    assert layers == ["tie_points", "displacements"]
    assert CRS.from_user_input(meta["crs"]) == UTM_TABLE.crs
    assert shapely.get_coordinates(shapely.from_wkb(geometry)) == pytest.approx(UTM_TABLE.xy)
    values = dict(zip(meta["fields"], fields, strict=True))
    assert tuple(values) == POINT_COLUMNS
    assert list(values["id"]) == [1, 2, 3]
    assert list(values["status"]) == ["fit", "check", "rejected"]
    assert values["d_row"] == pytest.approx([-0.5] * 3)
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("SELECT residual_col FROM tie_points").fetchall() == [(None,)] * 3
    assert lines(path)[:, 0] == pytest.approx(UTM_TABLE.xy)
    assert displacement_m(*lines(path).transpose(1, 0, 2), UTM_TABLE.crs) == pytest.approx(
        UTM_TABLE.displacement_m, abs=1e-6
    )


def changed(path: Path, statements: str) -> Path:
    geopackage.write_geopackage(UTM_TABLE, path)
    with closing(sqlite3.connect(path)) as database:
        database.executescript(statements)
    return path


ENDLESS = """DROP TABLE tie_points; CREATE VIEW tie_points AS
WITH RECURSIVE numbers(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM numbers) SELECT id, {} FROM numbers
WHERE id < 0"""


def test_a_query_of_a_stranger_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = ", ".join(f"0.0 AS {name}" for name in POINT_COLUMNS[1:])
    path = changed(tmp_path / "endless.gpkg", ENDLESS.format(columns))
    with pytest.raises(TrustError, match=r"the view 'tie_points', a query that may never end.*--trust-vrt"):
        read_point_file(path)
    monkeypatch.setattr("pcwlad_geo.raster.vectors.LIMITS", replace(LIMITS, reading_s=0.2))
    with trusting(Trust(vrt=True)), pytest.raises(InputError, match="interrupted"):
        read_point_file(path)


LONG = """CREATE TABLE copy AS SELECT * FROM tie_points; DROP TABLE tie_points;
UPDATE copy SET ref_col = zeroblob(100000000) WHERE id = 2; ALTER TABLE copy RENAME TO tie_points"""


def test_a_long_cell_is_no_number(tmp_path: Path) -> None:
    path = changed(tmp_path / "long.gpkg", LONG)
    with pytest.raises(InputError, match="1 of 3 points lack a coordinate"):
        read_point_file(path)


def test_feet_and_degrees(tmp_path: Path) -> None:
    feet = table(CRS.from_epsg(2263), np.array([[1e6, 2e5]]), np.array([[3.048, -6.096]]))
    geopackage.write_geopackage(feet, tmp_path / "feet.gpkg")
    assert np.diff(lines(tmp_path / "feet.gpkg"), axis=1)[0, 0] == pytest.approx([10.0, -20.0], abs=1e-3)

    places = np.array([[359.99995, 60.0], [15.0, -45.0]])
    moved_m = np.array([[30.0, 40.0], [-20.0, 5.0]])
    geopackage.write_geopackage(table(CRS.from_epsg(4326), places, moved_m), tmp_path / "degrees.gpkg")
    for (start, end), (east, north) in zip(lines(tmp_path / "degrees.gpkg"), moved_m, strict=True):
        azimuth, _, distance = Geod(ellps="WGS84").inv(*start, *end)
        assert distance == pytest.approx(np.hypot(east, north), abs=1e-4)
        assert azimuth == pytest.approx(np.degrees(np.arctan2(east, north)), abs=1e-3)
        assert abs(end[0] - start[0]) < 0.01


def test_without_a_crs_lines_lie_in_the_pixel_plane(tmp_path: Path) -> None:
    path = tmp_path / "plain.gpkg"
    geopackage.write_geopackage(table(None, np.array([[10.0, -20.0]]), np.full((1, 2), np.nan)), path)
    assert lines(path)[0].tolist() == [[10.0, -20.0], [10.25, -19.5]]
    with closing(sqlite3.connect(path)) as database:
        assert set(database.execute("SELECT srs_id FROM gpkg_geometry_columns")) == {(-1,)}


def test_every_layer_has_a_default_style(tmp_path: Path) -> None:
    path = tmp_path / "t.gpkg"
    geopackage.write_geopackage(UTM_TABLE, path)
    with closing(sqlite3.connect(path)) as database:
        styles = database.execute(
            "SELECT f_table_name, f_geometry_column, styleQML FROM layer_styles WHERE useAsDefault = 1"
        ).fetchall()
        columns = dict(database.execute("SELECT table_name, column_name FROM gpkg_geometry_columns"))
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    assert {name: column for name, column, _ in styles} == columns
    for _, _, qml in styles:
        renderer = ET.fromstring(qml).find("renderer-v2")
        assert renderer is not None
        symbols = [symbol.get("name") for symbol in renderer.findall("symbols/symbol")]
        rules = renderer.findall("rules/rule")
        assert [rule.get("symbol") for rule in rules] == symbols
        assert "residual up to 0.1 px" in str(rules[2].get("label"))
    arrows = [qml for name, _, qml in styles if name == "displacements"]
    assert "ArrowLine" in arrows[0]


def test_a_layer_that_gdal_has_not_written_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    really = pyogrio.raw.write

    def write_one(path: str, *, layer: str, **options: object) -> None:
        if layer == "displacements":
            really(path, layer=layer, **options)

    monkeypatch.setattr("pyogrio.raw.write", write_one)
    with pytest.raises(OutputError, match=r"there is no layer tie_points in it; is the disk full\?"):
        geopackage.write_geopackage(UTM_TABLE, tmp_path / "t.gpkg")


def test_the_same_points_make_the_same_file(tmp_path: Path) -> None:
    for name in ("a.gpkg", "b.gpkg"):
        geopackage.write_geopackage(UTM_TABLE, tmp_path / name)
    assert (tmp_path / "a.gpkg").read_bytes() == (tmp_path / "b.gpkg").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gpkg", "b.gpkg"]


def test_the_file_does_not_depend_on_how_gdal_laid_out_its_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    geopackage.write_geopackage(UTM_TABLE, tmp_path / "a.gpkg")
    really = pyogrio.raw.write

    def write_with_gaps(path: str, **options: object) -> None:
        really(path, **options)
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("CREATE TABLE for_a_while (text TEXT)")
            database.execute("INSERT INTO for_a_while VALUES (hex(randomblob(5000)))")
            database.execute("DROP TABLE for_a_while")

    monkeypatch.setattr("pyogrio.raw.write", write_with_gaps)
    geopackage.write_geopackage(UTM_TABLE, tmp_path / "b.gpkg")
    assert _without_counters(tmp_path / "a.gpkg") == _without_counters(tmp_path / "b.gpkg")


def _without_counters(path: Path) -> bytes:
    """Return the bytes of a database but for its counter of changed schemas, which a dropped table moves."""
    data = path.read_bytes()
    return data[:40] + data[44:]


def test_older_programs_know_its_version(tmp_path: Path) -> None:
    path = tmp_path / "tiepoints.gpkg"
    geopackage.write_geopackage(UTM_TABLE, path)
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA user_version").fetchone() == (10200,)


def test_no_points_and_no_folder(tmp_path: Path) -> None:
    geopackage.write_geopackage(UTM_TABLE[:0], tmp_path / "empty.gpkg")
    assert pyogrio.read_info(tmp_path / "empty.gpkg", layer="displacements")["features"] == 0
    with pytest.raises(OutputError, match="nowhere"):
        geopackage.write_geopackage(UTM_TABLE, tmp_path / "nowhere" / "t.gpkg")
