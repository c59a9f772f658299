"""Vectors follow a finished registration: from where the target drew them to where they belong."""

from __future__ import annotations

import json
import sqlite3
import struct
import warnings
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio
import pyogrio.raw
import pyproj
import pytest
import rasterio
import shapely
from numpy.typing import NDArray

from pcwlad_geo import InputError, OutputError, SettingsError, Warned, warp
from pcwlad_geo.cli.app import run
from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.correction.vertices import DensifyingParameters, densify
from pcwlad_geo.events import Event
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster import Grid
from pcwlad_geo.vector_warping import Movement, is_vector
from tests.registrations import SHIFT_PX, Make

Array = NDArray[np.float64]
PIXEL_M = 30.0
ORIGIN_XY = np.array([500000.0, 4600000.0])
SPLINE = SplineCorrection(
    "tps", SplineGrid((0.0, 0.0), 200.0, (3, 2)), np.random.default_rng(1).uniform(-3, 3, (5, 6, 2))
)


def xy_of(px: Array) -> Array:
    return ORIGIN_XY + px * [PIXEL_M, -PIXEL_M]


def px_of(xy: Array) -> Array:
    return (xy - ORIGIN_XY) / [PIXEL_M, -PIXEL_M]


def write_vectors(path: str, shapes: list[shapely.Geometry | None], crs: str | None = "EPSG:32633") -> str:
    names = np.array([f"name {number}" for number in range(len(shapes))], dtype=object)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a missing CRS
        pyogrio.raw.write(
            path,
            shapely.to_wkb(np.array(shapes, dtype=object)),
            [np.arange(len(shapes)), names],
            ["number", "name"],
            geometry_type="Unknown",
            crs=crs,
        )
    return path


def geometries(path: Path | str, layer: str | None = None) -> NDArray[np.object_]:
    return np.asarray(shapely.from_wkb(pyogrio.raw.read(path, layer=layer)[2]), dtype=object)


def test_points_move_against_the_displacement(make: Make) -> None:
    """What the target shows at a pixel lies where the reference has that pixel less the shift."""
    drawn_px = np.array([[100.5, 50.25], [300.0, 200.0]])
    source = write_vectors("a b.gpkg", [shapely.Point(place) for place in xy_of(drawn_px)])
    (path,) = warp(make(), [source], out_dir="moved here")
    assert path == Path("moved here/a b_registered.gpkg")
    moved_px = px_of(shapely.get_coordinates(geometries(path)))
    np.testing.assert_allclose(moved_px, drawn_px - SHIFT_PX, atol=1e-9)


@pytest.mark.parametrize("suffix", ["gpkg", "geojson"])
def test_all_kinds_of_geometry_keep_their_parts_and_heights(make: Make, suffix: str) -> None:
    ring = xy_of(np.array([[50.0, 50], [90, 50], [90, 90], [50, 90], [50, 50]]))
    hole = xy_of(np.array([[60.0, 60], [70, 60], [70, 70], [60, 60]]))
    polygon = shapely.Polygon(ring, [hole])
    line = shapely.LineString(np.column_stack([ring, np.arange(5.0)]))
    shapes = [
        polygon,
        shapely.MultiPolygon([polygon, shapely.affinity.translate(polygon, 3000, 0)]),
        line,
        shapely.MultiLineString([line, line]),
        shapely.Point(*ring[0], 12.5),
        shapely.GeometryCollection([polygon, line]),
        None,
    ]
    source = write_vectors(f"all.{suffix}", shapes)
    (path,) = warp(make(), [source])
    moved, drawn = geometries(path), geometries(source)
    assert [type(shape) for shape in moved] == [type(shape) for shape in drawn]
    to_truth = np.array([-SHIFT_PX[0] * PIXEL_M, SHIFT_PX[1] * PIXEL_M, 0.0])
    for before, after in zip(drawn, moved, strict=True):
        xyz, expected = (shapely.get_coordinates(shape, include_z=True) for shape in (after, before))
        np.testing.assert_allclose(xyz, expected + to_truth, atol=1e-6)


def test_layers_attributes_and_styles_stay(make: Make) -> None:
    folder, source = make(), "roads.gpkg"
    points = shapely.to_wkb(np.array([shapely.Point(xy_of(np.array([9.0, 9]))), None], dtype=object))
    days = np.array(["2020-02-29T12:00:00", "NaT"], dtype="datetime64[ms]")
    whole, gaps = np.array([7, 0]), np.array([False, True])
    for number, layer in enumerate(("roads", "houses")):
        pyogrio.raw.write(
            source,
            points,
            [whole, np.array(["ä", None], dtype=object), days],
            ["number", "name", "day"],
            field_mask=[gaps, None, None],
            geometry_type="Point",
            crs="EPSG:32633",
            layer=layer,
            append=number > 0,
        )
    pyogrio.raw.write(
        source, None, [np.array(["<qgis/>"], dtype=object)], ["styleQML"], layer="layer_styles", append=True
    )
    Path("roads.qml").write_text("<qgis/>", encoding="utf-8")
    (path,) = warp(folder, [source], out_dir="out")
    assert sorted(map(str, pyogrio.list_layers(path)[:, 0])) == ["houses", "layer_styles", "roads"]
    assert Path("out/roads_registered.qml").read_text(encoding="utf-8") == "<qgis/>"
    for layer in ("roads", "houses"):
        (about, _, _, before), (as_moved, _, _, after) = (
            pyogrio.raw.read(name, layer=layer) for name in (source, path)
        )
        assert (about["crs"], *about["fields"]) == (as_moved["crs"], *as_moved["fields"])
        assert about["dtypes"].tolist() == as_moved["dtypes"].tolist()
        for ours, theirs in zip(after, before, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_another_crs_is_kept_and_moves_by_the_same_ground(make: Make) -> None:
    drawn_px = np.array([[100.0, 50.0], [550.0, 390.0]])
    to_degrees = pyproj.Transformer.from_crs(32633, 4326, always_xy=True)
    degrees = np.column_stack(to_degrees.transform(*xy_of(drawn_px).T))
    source = write_vectors("lonlat.geojson", [shapely.LineString(degrees)], "EPSG:4326")
    (path,) = warp(make(), [source])
    assert pyogrio.read_info(path)["crs"] == "EPSG:4326"
    moved = shapely.get_coordinates(geometries(path))
    moved_px = px_of(np.column_stack(to_degrees.transform(*moved.T, direction="INVERSE")))
    np.testing.assert_allclose(moved_px[[0, -1]], drawn_px - SHIFT_PX, atol=2e-4)


def test_a_line_follows_a_bent_correction_and_returns(make: Make) -> None:
    """New vertices keep the moved line within 0.05 px of the correction of every place on it."""
    ends_px = np.array([[20.0, 30.0], [580.0, 370.0]])
    source = write_vectors("line.gpkg", [shapely.LineString(xy_of(ends_px))])
    folder = make(correction=SPLINE)
    (path,) = warp(folder, [source])
    (line,) = geometries(path)
    along_px = ends_px[0] + np.linspace(0, 1, 2001)[:, None] * (ends_px[1] - ends_px[0])
    places = shapely.points(xy_of(SPLINE.inverse(along_px)))
    assert shapely.distance(places, line).max() / PIXEL_M < 0.06
    assert 2 < shapely.get_num_coordinates(line) < 200
    (again,) = warp(folder, [path], inverse=True, out_dir="back")
    (back,) = geometries(again)
    assert shapely.hausdorff_distance(back, geometries(source)[0], densify=0.01) / PIXEL_M < 0.06


def test_vectors_lie_on_the_warped_raster(make: Make) -> None:
    """A blob in the warped raster lies where its outline, drawn on the target, has moved."""
    folder = make(correction=SPLINE, resampling="bilinear")
    row, col = np.mgrid[:400, :600] + 0.5
    centres_px = np.array([[150.0, 120.0], [420.0, 260.0]])
    blobs = sum(np.exp(-((col - x) ** 2 + (row - y) ** 2) / 50) for x, y in centres_px)
    with rasterio.open("b10.tif") as file:
        profile = file.profile | {"dtype": "float32"}
    with rasterio.open("blobs.tif", "w", **profile) as file:
        file.write(blobs.astype("float32"), 1)
    circles = [shapely.Point(centre).buffer(5 * PIXEL_M, 64) for centre in xy_of(centres_px)]
    raster, vector = warp(folder, ["blobs.tif", write_vectors("circles.gpkg", circles)])
    with rasterio.open(raster) as file:
        values, place = file.read(1), Grid(file.shape, file.transform, file.crs)
    for circle in geometries(vector):
        middle = place.to_px(np.array(circle.centroid.coords))[0]
        rows, cols = np.mgrid[: values.shape[0], : values.shape[1]] + 0.5
        near = values * (np.hypot(cols - middle[0], rows - middle[1]) < 20)
        centre = np.array([(near * cols).sum(), (near * rows).sum()]) / near.sum()
        assert np.abs(centre - middle).max() < 0.05


def test_vertices_beyond_the_image_are_told(make: Make) -> None:
    told: list[Event] = []
    places = xy_of(np.array([[-5.0, 10], [10, 10], [700, 10]]))
    source = write_vectors("far.gpkg", [shapely.LineString(places)])
    warp(make(), [source], on_event=told.append)
    (message,) = (event.message for event in told if isinstance(event, Warned))
    assert "2 of 3 vertices lie beyond the target image, where the correction is extrapolated" in message


def test_what_cannot_be_moved_is_told(make: Make) -> None:
    folder = make()
    point = shapely.Point(xy_of(np.array([9.0, 9])))
    with pytest.raises(InputError, match=r"no CRS: assign it"):
        warp(folder, [write_vectors("none.gpkg", [point], None)])
    Path("cut.geojson").write_text('{"type": "FeatureCollection", "features": [', encoding="utf-8")
    with pytest.raises(InputError, match=r"cut\.geojson cannot be read as a vector file"):
        warp(folder, ["cut.geojson"])
    Path("some.gml").write_text("<a/>", encoding="utf-8")
    with pytest.raises(InputError, match=r"some\.gml is no GeoPackage, .* or give --trust-vrt"):
        warp(folder, ["some.gml"])
    source = write_vectors("good.gpkg", [point])
    with pytest.raises(SettingsError, match="inverse moves vectors alone"):
        warp(folder, ["b10.tif", source], inverse=True)
    with pytest.raises(SettingsError, match=r"good\.gpkg is a vector file"):
        warp(folder, [source], output_raster="one.tif")
    warp(folder, [source])
    with pytest.raises(OutputError, match="exists: give --overwrite"):
        warp(folder, [source])
    assert not list(Path().glob(".*"))


def test_a_file_that_cannot_be_moved_leaves_nothing_written(make: Make) -> None:
    """All files are read and moved before the first one is written, rasters too."""
    folder = make()
    good = write_vectors("good.gpkg", [shapely.Point(xy_of(np.array([9.0, 9])))])
    Path("cut.geojson").write_text('{"type": "FeatureCollection", "features": [', encoding="utf-8")
    with pytest.raises(InputError, match=r"cut\.geojson cannot be read"):
        warp(folder, ["b10.tif", good, "cut.geojson"], out_dir="out")
    assert not Path("out").exists()
    places = warp(folder, ["b10.tif", good], out_dir="out")
    assert [path.is_file() for path in places] == [True, True]
    assert not list(Path("out").glob(".*"))


def test_a_vertex_is_mapped_to_pixels_once(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, original, mapped = make(correction=SPLINE), Movement.to_px, 0

    def counted(movement: Movement, xy: Array) -> Array:
        nonlocal mapped
        mapped += len(xy)
        return original(movement, xy)

    monkeypatch.setattr(Movement, "to_px", counted)
    line = shapely.LineString(xy_of(np.array([[20.0, 30.0], [580.0, 370.0]])))
    (path,) = warp(folder, [write_vectors("line.gpkg", [line])])
    assert mapped == shapely.get_num_coordinates(geometries(path)[0])


def test_features_tell_the_precision_of_their_places(make: Make) -> None:
    """By the tie points' own noise: 0.1 px each, of which 0.6 is common to all; the fit of 81 adds 0.01."""
    folder = make()
    near, far = (shapely.Point(place) for place in xy_of(np.array([[300.0, 200.0], [9.0, 9.0]])))
    line = shapely.LineString([near, far])
    shapes = [near, line, None, shapely.GeometryCollection([near, line]), shapely.Polygon()]
    (path,) = warp(folder, [write_vectors("all.gpkg", shapes)], write_sigma=True)
    about, _, _, values = pyogrio.raw.read(path)
    assert list(about["fields"]) == ["number", "name", "sigma_m"]
    sigma_px = values[2] / PIXEL_M
    np.testing.assert_array_equal(np.isfinite(sigma_px), [True, True, False, True, False])
    truth_px = np.hypot(0.06, 0.1 / np.sqrt(81))
    assert np.abs(sigma_px[[0, 1, 3]] - truth_px).max() < 0.01


def test_a_precision_that_is_not_known_is_told(make: Make) -> None:
    folder = make()
    source = write_vectors("good.gpkg", [shapely.Point(xy_of(np.array([9.0, 9])))])
    with pytest.raises(SettingsError, match=r"write_sigma is of vectors alone, and b10\.tif is a raster"):
        warp(folder, ["b10.tif", source], write_sigma=True)
    (once,) = warp(folder, [source], write_sigma=True, out_dir="once")
    with pytest.raises(InputError, match="has a field sigma_m already"):
        warp(folder, [once], write_sigma=True, out_dir="twice")
    points = folder / "tiepoints.csv"
    rows = points.read_text(encoding="utf-8").splitlines()
    column = rows[0].split(",").index("d_col")
    moved = [row.split(",") for row in rows[1:]]
    for cells in moved:
        cells[column] = f"{float(cells[column]) + 1:.6f}"
    points.write_text("\n".join([rows[0], *map(",".join, moved)]) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a correction that lies up to (0\.9|1\.0)\d px off"):
        warp(folder, [source], write_sigma=True, out_dir="edited")
    points.unlink()
    with pytest.raises(InputError, match=r"no tiepoints\.csv, from which the sigma"):
        warp(folder, [source], write_sigma=True, out_dir="missing")
    assert not any(Path(name).exists() for name in ("twice", "edited", "missing"))


def test_curves_and_invalid_geometries_move_as_they_are(make: Make) -> None:
    """A curve becomes a line, as shapely has none, and nobody repairs a polygon that crosses itself."""
    drawn_px = np.array([[100.0, 100.0], [150.0, 50.0], [200.0, 100.0]])
    curve = struct.pack("<BII6d", 1, 8, 3, *xy_of(drawn_px).ravel())  # a half circle
    pyogrio.raw.write(
        "curve.gpkg", np.array([curve], object), [], [], geometry_type="Unknown", crs="EPSG:32633"
    )
    with closing(sqlite3.connect("curve.gpkg")) as database, database:
        database.execute("UPDATE gpkg_geometry_columns SET geometry_type_name = 'CIRCULARSTRING'")
    corners = xy_of(np.array([[10.0, 10], [50, 50], [50, 10], [10, 50], [10, 10]]))
    bow_tie = shapely.Polygon(corners)
    curved, crossed = warp(make(), ["curve.gpkg", write_vectors("bow tie.gpkg", [bow_tie])])
    on_curve_px = px_of(shapely.get_coordinates(geometries(curved)))
    radius_px = np.hypot(*(on_curve_px - (np.array([150.0, 100.0]) - SHIFT_PX)).T)
    assert len(radius_px) > 20
    assert np.abs(radius_px - 50).max() < 0.05
    (moved,) = geometries(crossed)
    assert not moved.is_valid
    np.testing.assert_allclose(px_of(shapely.get_coordinates(moved)), px_of(corners) - SHIFT_PX, atol=1e-6)


def test_an_endless_table_of_contents_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A GeoPackage is asked for features within the time that reading may take."""
    monkeypatch.setattr("pcwlad_geo.raster.vectors.LIMITS", replace(LIMITS, reading_s=0.2))
    path = tmp_path / "endless.gpkg"
    with closing(sqlite3.connect(path)) as database:
        database.execute(
            "CREATE VIEW gpkg_contents AS WITH RECURSIVE a(data_type) AS "
            "(SELECT 'tiles' UNION ALL SELECT 'tiles' FROM a) SELECT data_type FROM a"
        )
    assert not is_vector(str(path))


def test_the_command_moves_an_empty_layer_too(make: Make, capsys: pytest.CaptureFixture[str]) -> None:
    make()
    write_vectors("empty.geojson", [])
    assert run(["warp", "done", "empty.geojson", "-o", "out", "--progress", "none"]) == 0
    assert capsys.readouterr().out.strip() == str(Path("out/empty_registered.geojson"))
    assert json.loads(Path("out/empty_registered.geojson").read_text(encoding="utf-8"))["features"] == []


def test_straight_moves_insert_nothing_and_lines_stay_apart() -> None:
    vertices = np.array([[0.0, 0, 1], [100, 0, 2], [5, 5, 3], [900, 400, 4], [0, 0, 5]])
    starts = np.array([0, 2, 2, 5, 5])

    def shear(xy: Array) -> Array:
        return xy @ np.array([[1.0, 0.1], [0.0, 1.0]]) + 3

    same, same_starts = densify(vertices, vertices[:, :2], starts, shear)
    np.testing.assert_array_equal(same, vertices)
    np.testing.assert_array_equal(same_starts, starts)

    def bent(xy: Array) -> Array:
        return xy + np.column_stack([np.zeros(len(xy)), np.sin(xy[:, 0] / 60)])

    parameters = DensifyingParameters()
    dense, places = densify(vertices, vertices[:, :2], starts, bent)
    assert places[0] == 0
    assert places[1] == places[2]
    assert places[-1] == places[-2] == len(dense)
    for line, before in ((dense[: places[1]], vertices[:2]), (dense[places[2] :], vertices[2:])):
        np.testing.assert_array_equal(line[[0, -1]], before[[0, -1]])
        t = np.linspace(0, 1, 50)[:, None]
        for first, last in zip(line[:-1, :2], line[1:, :2], strict=True):
            chord = bent(first[None]) + t * (bent(last[None]) - bent(first[None]))
            off = np.linalg.norm(bent(first + t * (last - first)) - chord, axis=1)
            assert off.max() <= 1.2 * parameters.tolerance_px
