"""Areas of vector files: which pixels they leave, in any CRS, on any grid, and files that are none."""

from __future__ import annotations

import json
import sqlite3
import tracemalloc
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio.raw
import pytest
import shapely
from rasterio.crs import CRS

import pcwlad_geo
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.areas import Areas
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.source import describe, with_areas
from pcwlad_geo.raster.trust.permissions import Trust, trusting
from pcwlad_geo.raster.view import View
from tests.rpc_scene import rpc_grid, write_dem
from tests.scenes import CRS_OF_SCENE, make_grid, render, write

WGS84 = CRS.from_epsg(4326)
GRID = make_grid((120, 150))
QUICK: dict[str, Any] = {"template": 31, "window": 31, "features": 200, "jobs": 1}
LEFT_PX = ((0.0, 0.0), (60.0, 0.0), (60.0, 120.0), (0.0, 120.0))
HOLE_PX = ((20.0, 30.0), (40.0, 30.0), (40.0, 50.0), (20.0, 50.0))


def polygon(*rings_px: tuple[tuple[float, float], ...], crs: CRS = CRS_OF_SCENE) -> shapely.Polygon:
    """Return a polygon whose rings, the first the outer one, are pixels (col, row) of `GRID`."""
    dense = [shapely.get_coordinates(shapely.segmentize(shapely.LinearRing(each), 1.0)) for each in rings_px]
    outer, *inner = (transform_xy(GRID.to_xy(each), CRS_OF_SCENE, crs) for each in dense)
    return shapely.Polygon(outer, inner)


def save(path: Path, *shapes: shapely.Geometry, crs: CRS | None = CRS_OF_SCENE, layer: str = "areas") -> Path:
    pyogrio.raw.write(
        path,
        shapely.to_wkb(np.array(shapes, object)),
        [],
        [],
        geometry_type="Unknown",
        crs=None if crs is None else crs.to_wkt(),
        driver={".gpkg": "GPKG", ".geojson": "GeoJSON", ".fgb": "FlatGeobuf"}[path.suffix],
        layer=layer,
        append=path.exists(),
    )
    return path


def valid(path: Path, *, aoi: Path | None = None, exclude: Path | None = None) -> np.ndarray:
    info = with_areas(describe(path), aoi, exclude)
    return View(info, info.grid, "none").read(Window.whole(info.grid.shape)).valid


@pytest.fixture
def raster(tmp_path: Path) -> Path:
    return write(tmp_path / "raster.tif", render(GRID), GRID)


@pytest.mark.parametrize(
    ("suffix", "crs"),
    [
        pytest.param(".gpkg", CRS_OF_SCENE, marks=pytest.mark.slow),
        (".geojson", WGS84),
        pytest.param(".fgb", CRS.from_epsg(3857), marks=pytest.mark.slow),
    ],
)
def test_the_pixels_whose_centres_lie_in_the_areas_count(
    raster: Path, tmp_path: Path, suffix: str, crs: CRS
) -> None:
    areas = save(tmp_path / f"areas{suffix}", polygon(LEFT_PX, HOLE_PX, crs=crs), crs=crs)
    expected = np.zeros(GRID.shape, bool)
    expected[:, :60] = True
    expected[30:50, 20:40] = False
    np.testing.assert_array_equal(valid(raster, aoi=areas), expected)
    np.testing.assert_array_equal(valid(raster, exclude=areas), ~expected)
    right = save(tmp_path / "right.gpkg", polygon(tuple((col + 50, row) for col, row in LEFT_PX)))
    both = valid(raster, aoi=areas, exclude=right)
    np.testing.assert_array_equal(both, expected & (np.arange(150) < 50))


KML = """<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><NetworkLink><Link>
<href>other.kml</href></Link></NetworkLink><Folder><Placemark>{}</Placemark></Folder></Document></kml>"""


def boundary(kind: str, ring: shapely.LinearRing) -> str:
    at = " ".join(f"{lon!r},{lat!r},0" for lon, lat in shapely.get_coordinates(ring).tolist())
    return f"<{kind}><LinearRing><coordinates>{at}</coordinates></LinearRing></{kind}>"


def test_polygons_of_kml(raster: Path, tmp_path: Path) -> None:
    areas = polygon(LEFT_PX, HOLE_PX, crs=WGS84)
    rings = boundary("outerBoundaryIs", areas.exterior) + boundary("innerBoundaryIs", areas.interiors[0])
    path = tmp_path / "areas.kml"
    path.write_text(KML.format(f"<MultiGeometry><Polygon>{rings}</Polygon></MultiGeometry>"))
    (tmp_path / "other.kml").write_text(KML.format(f"<Polygon>{rings}</Polygon>"))
    same = save(tmp_path / "areas.geojson", areas, crs=WGS84)
    np.testing.assert_array_equal(valid(raster, aoi=path), valid(raster, aoi=same))
    for text, message in {
        KML.format("<Point><coordinates>15,41</coordinates></Point>"): "holds other than polygons",
        KML.format("<Polygon><outerBoundaryIs/></Polygon>"): "leaves nothing",
        KML.format(f"<Polygon>{rings.replace(',0 ', ',0 nan,1 ', 1)}</Polygon>"): "cannot be read as KML",
        "<kml": "cannot be read as KML",
    }.items():
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            valid(raster, aoi=path)


def test_an_encoding_that_nobody_knows_is_said(raster: Path, tmp_path: Path) -> None:
    path = tmp_path / "areas.kml"
    path.write_text('<?xml version="1.0" encoding="x-none"?><kml></kml>')
    with pytest.raises(InputError, match="cannot be read as KML: unknown encoding"):
        valid(raster, aoi=path)


def scribble(vertices: int, seed: int = 0) -> shapely.Polygon:
    """Return a polygon that crosses itself everywhere, far beyond `GRID` too, in map coordinates."""
    px = np.random.default_rng(seed).uniform(-1.0, 2.0, (vertices, 2)) * GRID.shape[::-1]
    return shapely.Polygon(GRID.to_xy(px))


def turns_are_odd(polygon: shapely.Polygon) -> np.ndarray:
    """Return whether a line to the left of each pixel's centre crosses the outline an odd number of times."""
    px = GRID.to_px(shapely.get_coordinates(polygon))
    rows, cols = GRID.shape
    row = np.arange(rows)[:, None] + 0.5
    (x, y), (next_x, next_y) = px[:-1].T, px[1:].T
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where((y > row) != (next_y > row), x + (row - y) / (next_y - y) * (next_x - x), np.inf)
    return (at[:, :, None] < np.arange(cols) + 0.5).sum(axis=1) % 2 == 1


def test_a_polygon_that_crosses_itself_covers_what_odd_turns_enclose(raster: Path, tmp_path: Path) -> None:
    areas = scribble(40)
    expected = turns_are_odd(areas)
    assert 0.2 < expected.mean() < 0.8
    path = save(tmp_path / "areas.geojson", areas)
    assert (valid(raster, aoi=path) != expected).mean() < 2e-3  # GeoJSON rounds
    stored = Areas(bytes(shapely.to_wkb(areas)), None)
    window = Window(31, 47, 50, 60)
    np.testing.assert_array_equal(stored.valid(window, GRID), expected[31:81, 47:107])
    both = save(tmp_path / "both.gpkg", areas, scribble(40, seed=1))
    either = expected | turns_are_odd(scribble(40, seed=1))
    np.testing.assert_array_equal(valid(raster, aoi=both), either)


def test_thousands_of_crossings_take_no_longer(raster: Path, tmp_path: Path) -> None:
    areas = save(tmp_path / "areas.fgb", scribble(4000))
    tracemalloc.start()
    covered = valid(raster, aoi=areas)
    assert tracemalloc.get_traced_memory()[1] < 2**28
    tracemalloc.stop()
    assert (covered != turns_are_odd(scribble(4000))).mean() < 2e-3


def test_crossings_are_cut_in_another_crs(raster: Path, tmp_path: Path) -> None:
    (west, south, east, north) = polygon(LEFT_PX, crs=WGS84).bounds
    bow_tie = shapely.Polygon([(west, south), (east, north), (east, south), (west, north)])
    far = shapely.Polygon([(-180, -90), (180, 90), (180, -90), (-180, 90)])  # as far as can be, and crossing
    areas = save(tmp_path / "areas.geojson", bow_tie, crs=WGS84)
    assert abs(int(valid(raster, aoi=areas).sum()) - 60 * 120 // 2) < 400
    assert valid(
        raster, exclude=save(tmp_path / "far.geojson", far, crs=WGS84)
    ).all()  # north of the crossing


ENDLESS = """WITH RECURSIVE numbers(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM numbers)
SELECT n AS fid, NULL AS geom FROM numbers"""


def test_views_are_refused_and_trusted_ones_end(
    raster: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path / "areas.gpkg", polygon(LEFT_PX))
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DROP TABLE areas")
        database.execute(f"CREATE VIEW areas AS {ENDLESS}")
    with pytest.raises(TrustError, match=r"the view 'areas', a query that may never end.*--trust-vrt"):
        valid(raster, aoi=path)
    monkeypatch.setattr("pcwlad_geo.raster.vectors.LIMITS", replace(LIMITS, reading_s=3.0))
    with trusting(Trust(vrt=True)), pytest.raises(InputError, match="it takes more than 3 s"):
        valid(raster, aoi=path)


def test_other_formats_are_read_where_they_are_trusted(raster: Path, tmp_path: Path) -> None:
    folder = tmp_path / "areas.gdb"
    wkb = shapely.to_wkb(np.array([polygon(LEFT_PX)], object))
    pyogrio.raw.write(
        folder, wkb, [], [], geometry_type="Polygon", crs=CRS_OF_SCENE.to_wkt(), driver="OpenFileGDB"
    )
    with pytest.raises(InputError, match=r"or KML: convert it .*, or give --trust-vrt"):
        valid(raster, aoi=folder)
    with trusting(Trust(vrt=True)):
        assert valid(raster, aoi=folder).sum() == 60 * 120


def test_a_window_is_a_part_of_the_whole_on_any_grid(tmp_path: Path) -> None:
    by_rpc = rpc_grid(write_dem(tmp_path / "dem.tif"))
    rows, cols = by_rpc.shape
    ring = np.array([[0.2, 0.3], [0.7, 0.2], [0.6, 0.8]]) * [cols, rows]
    areas = Areas(bytes(shapely.to_wkb(shapely.Polygon(by_rpc.to_xy(ring)))), None)
    whole = areas.valid(Window.whole(by_rpc.shape), by_rpc)
    edges = np.roll(ring, -1, axis=0) - ring
    row, col = np.mgrid[:rows, :cols] + 0.5
    cross = [dx * (row - y) - dy * (col - x) for (x, y), (dx, dy) in zip(ring, edges, strict=True)]
    inside = np.all(np.sign(cross) == np.sign(cross)[0], axis=0)
    assert np.count_nonzero(whole != inside) < 0.02 * np.count_nonzero(inside)  # lines of sight meet hills
    window = Window(rows // 3, cols // 4, rows // 3, cols // 2)
    np.testing.assert_array_equal(
        areas.valid(window, by_rpc), whole[window.slices_in(Window.whole(by_rpc.shape))]
    )


def test_overviews_have_the_same_areas(raster: Path, tmp_path: Path) -> None:
    areas = with_areas(describe(raster), save(tmp_path / "areas.gpkg", polygon(LEFT_PX)), None).areas
    assert areas is not None
    half = GRID.scaled((60, 75))
    np.testing.assert_array_equal(
        areas.valid(Window.whole(half.shape), half), np.broadcast_to(np.arange(75) < 30, (60, 75))
    )


@pytest.mark.filterwarnings("ignore:'crs' was not provided")
def test_what_cannot_be_used_is_said(raster: Path, tmp_path: Path) -> None:
    far = polygon(tuple((col + 5000, row) for col, row in LEFT_PX))
    several = save(tmp_path / "several.gpkg", polygon(LEFT_PX))
    save(several, far, layer="more")
    vrt = tmp_path / "areas.vrt"
    vrt.write_text("<OGRVRTDataSource></OGRVRTDataSource>")
    broken = tmp_path / "broken.geojson"
    broken.write_text('{"type": "FeatureCollection", "features": [')
    empty = tmp_path / "empty.geojson"
    empty.write_text(json.dumps({"type": "FeatureCollection", "features": []}))
    cases = {
        save(tmp_path / "far.gpkg", far): "leaves nothing of .*raster.tif",
        save(
            tmp_path / "lines.gpkg", shapely.LineString(GRID.to_xy(np.array(LEFT_PX)))
        ): "holds other than polygons",
        save(tmp_path / "without.gpkg", polygon(LEFT_PX), crs=None): "has no CRS",
        several: "has 2 layers",
        vrt: "is no GeoPackage",
        broken: "cannot be read as a vector file",
        empty: "leaves nothing of .*raster.tif",
        tmp_path / "absent.gpkg": "cannot be opened",
        tmp_path / "absent.kml": "cannot be opened",
    }
    for path, message in cases.items():
        with pytest.raises(InputError, match=message):
            with_areas(describe(raster), path, None)
    plain = write(tmp_path / "plain.tif", render(GRID), None)
    with pytest.raises(InputError, match="no georeferencing"):
        with_areas(describe(plain), tmp_path / "far.gpkg", None)


def test_areas_of_the_world_are_clipped(raster: Path, tmp_path: Path) -> None:
    world = save(tmp_path / "world.geojson", shapely.box(-180, -90, 180, 90), crs=WGS84)
    assert valid(raster, aoi=world).all()


def test_tie_points_lie_in_the_areas_and_the_error_of_all_ground_is_told(
    raster: Path, tmp_path: Path
) -> None:
    target = write(tmp_path / "target.tif", render(GRID, displacement_px=(0.4, -0.3)), GRID)
    areas = save(tmp_path / "areas.gpkg", polygon(LEFT_PX))
    found = pcwlad_geo.register(raster, target, aoi=areas, out_dir=tmp_path / "out", **QUICK)
    points = found.tie_points
    assert len(points) > 20
    assert points.reference_px[:, 0].max() <= 60.0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["settings"]["aoi"] == str(areas)
    assert [each["role"] for each in report["inputs"]] == ["reference", "target", "aoi"]
