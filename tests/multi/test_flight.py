"""A flight index: each photograph is looked for around its place, and what has none is shown."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from pyogrio.raw import write as write_vector
from rasterio.errors import NotGeoreferencedWarning

import pcwlad_geo as pg
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.multi.batch.flight import Flight, photos_of
from pcwlad_geo.multi.batch.run import BatchResult
from pcwlad_geo.raster import describe, transform_xy
from pcwlad_geo.raster.gdal import ignoring
from tests.cli.process import Result
from tests.scenes import CRS_OF_SCENE, ORIGIN_XY_M, make_grid, render, write

SIDE_PX = 140
PLACES_PX = {"a_01": (120, 130)}
"""Column and row of the top left corner of the photograph on the reference."""
OFF_M = np.array([240.0, -150.0])


def places(names: list[str], off_m: np.ndarray = OFF_M) -> np.ndarray:
    middle = np.array([PLACES_PX[name] for name in names]) + SIDE_PX / 2
    return np.asarray(ORIGIN_XY_M + middle * [30, -30] + off_m)


def write_index(
    path: Path, geometries: list[object], names: list[str], crs: str | None = "EPSG:32633"
) -> Path:
    kinds = {shapely.get_type_id(geometry) for geometry in geometries}
    wkb = shapely.to_wkb(np.array(geometries))
    fields = [np.arange(len(names)), np.array(names, object)]
    kind = "Point" if kinds == {0} else "Polygon"
    write_vector(path, wkb, fields, ["number", "scan"], crs=crs, geometry_type=kind)
    return path


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a reference of 600 px, and a photograph turned by half a turn."""
    folder = tmp_path_factory.mktemp("flight")
    grid = make_grid((600, 600))
    write(folder / "ortho.tif", render(grid), grid)
    for name, (col, row) in PLACES_PX.items():
        part = make_grid((SIDE_PX, SIDE_PX), offset_m=(col * 30, row * 30))
        write(folder / f"{name}.tif", render(part)[::-1, ::-1].copy(), None, dtype="uint8")
    point, far = shapely.Point(*places(["a_01"])[0]), shapely.Point(0.0, 0.0)
    write_index(folder / "flight.gpkg", [point, point, far], [r"D:\scans\A_01.TIF", "gone.tif", "a_01"])
    return folder


def true_error_px(folder: Path, name: str) -> float:
    """Return how far the registered photograph lies off, px of the reference."""
    report = json.loads((folder / f"{name}_registered" / "report.json").read_text())
    assert report["status"] == "registered"
    with rasterio.open(folder / f"{name}_registered" / f"{name}_registered.tif") as raster:
        values, transform = raster.read(1).astype(float), raster.transform
    col, row = PLACES_PX[name]
    left, top = (round(each) for each in ~make_grid().transform @ (transform.c, transform.f))
    truth = render(make_grid((SIDE_PX, SIDE_PX), offset_m=(col * 30, row * 30)), noise=0.0)
    seen = values[row - top : row - top + SIDE_PX, col - left : col - left + SIDE_PX]
    inner = np.s_[10:-10, 10:-10]
    slopes = np.stack([each[inner].ravel() for each in np.gradient(truth)])
    return float(np.hypot(*np.linalg.lstsq(slopes.T, (seen - truth)[inner].ravel(), rcond=None)[0]))


def place_photographs(work: Path, out: Path, reference: Path) -> BatchResult:
    """Look for the photographs of the flight on a reference, by few candidates."""
    return pg.batch(
        work / "flight.gpkg",
        out_dir=out,
        reference=reference,
        photo_size=SIDE_PX * 30.0,
        within=400.0,
        executor=InThisProcess(),
        no_report=True,
        template=61,
        window=41,
        features=40,
        model="shift",
    )


def test_photographs_are_found_around_their_places(work: Path) -> None:
    out = work / "out"
    result = place_photographs(work, out, work / "ortho.tif")
    assert sorted((outcome.pair.line, outcome.status) for outcome in result.pairs) == [
        (1, "registered"),
        (2, "unusable"),
        (3, "unusable"),
    ]
    for name in PLACES_PX:
        assert true_error_px(out, name) < 0.3
    assert result.to_place is not None
    page = result.to_place.read_text(encoding="utf-8")
    assert "2 of 3 photographs have no place" in page
    assert page.count("<img") == 1
    assert "gone.tif is not in" in page
    assert "--place" in page
    with result.summary.open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert all("srcwin" in line["reference"] for line in lines if line["status"] == "registered")


def test_a_folder_of_tiles_is_a_reference_of_a_flight(work: Path, tmp_path: Path) -> None:
    for number in range(4):
        row, col = divmod(number, 2)
        grid = make_grid((300, 300), offset_m=(col * 9000.0, row * 9000.0))
        with rasterio.open(work / "ortho.tif") as whole:
            values = whole.read(1)[row * 300 :, col * 300 :][:300, :300]
        (tmp_path / "tiles").mkdir(exist_ok=True)
        write(tmp_path / "tiles" / f"tile{number}.tif", values, grid)
    result = place_photographs(work, tmp_path / "out", tmp_path / "tiles")
    assert [result.count(status) for status in ("registered", "unusable")] == [1, 2]
    assert true_error_px(tmp_path / "out", "a_01") < 0.3
    found = json.loads((tmp_path / "out" / "a_01_registered" / "report.json").read_text())
    assert found["reference"]["path"].endswith("reference.vrt")
    assert result.to_place is not None
    assert "none of the 4 tiles" in result.to_place.read_text(encoding="utf-8")


def flight(work: Path, **values: object) -> Flight:
    return Flight(str(work / "ortho.tif"), **{"photo_size": SIDE_PX * 30.0, "photos": work, **values})  # type: ignore[arg-type]


@pytest.mark.parametrize("crs", ["EPSG:32633", "EPSG:4326"])
@pytest.mark.parametrize("kind", ["points", "footprints"])
def test_only_the_part_around_a_place_is_read(work: Path, tmp_path: Path, kind: str, crs: str) -> None:
    xy = places(["a_01"], np.zeros(2))
    half = SIDE_PX * 15.0
    outline = xy + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    moved = transform_xy(xy if kind == "points" else outline, CRS_OF_SCENE, rasterio.crs.CRS.from_string(crs))
    shape = shapely.Point(*moved[0]) if kind == "points" else shapely.Polygon(moved)
    index = write_index(tmp_path / "index.geojson", [shape], ["a_01"], crs)
    (photo,) = photos_of(index, flight(work, within=300.0, photo_size=2 * half if kind == "points" else None))
    part = describe(photo.reference).grid
    corner, size = part.to_xy(np.array([[0.0, 0.0], part.shape[::-1]])), np.array(part.shape[::-1])
    reach = 30 * size / 2 - (half if kind == "footprints" else half * np.sqrt(2))
    assert reach == pytest.approx([300, 300], abs=61)
    assert corner.mean(axis=0) == pytest.approx(xy[0], abs=45)
    numbers = [float(number) for number in photo.place.split(",")]
    assert numbers == pytest.approx([xy[0, 0] - half, 30, 0, xy[0, 1] + half, 0, -30], rel=1e-3, abs=45)


def test_a_coarser_photograph_is_compared_with_the_pyramid(work: Path, tmp_path: Path) -> None:
    index = write_index(tmp_path / "index.gpkg", [shapely.Point(*places(["a_01"])[0])], ["a_01"])
    (photo,) = photos_of(index, flight(work, photo_size=4 * SIDE_PX * 30.0))
    assert describe(photo.reference).grid.transform.a == pytest.approx(4 * 30 * 0.7, rel=0.02)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"photo_size": None}, "--photo-size"),
        ({"name_column": "file"}, "no column 'file'"),
        ({"name_column": "number"}, None),
        ({"photos": Path("/nowhere")}, "has the names of photographs"),
    ],
)
def test_what_lacks_is_named(work: Path, values: dict[str, object], message: str | None) -> None:
    if message is None:
        photos = photos_of(work / "flight.gpkg", flight(work, **values))
        assert all(photo.problem for photo in photos)
        return
    with pytest.raises(InputError, match=message):
        photos_of(work / "flight.gpkg", flight(work, **values))


def test_bad_indexes_and_lengths_are_refused(work: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="within"):
        pg.batch(work / "flight.gpkg", reference=work / "ortho.tif", within=-1.0, out_dir=tmp_path)
    (tmp_path / "table.gpkg").write_text("reference,target\n")
    with pytest.raises(InputError, match="is no GeoPackage"):
        photos_of(tmp_path / "table.gpkg", flight(work))
    with pytest.warns(UserWarning, match="crs"):
        index = write_index(tmp_path / "none.gpkg", [shapely.Point(1, 2)], ["a_01"], None)
    with pytest.raises(InputError, match="no CRS"):
        photos_of(index, flight(work))
    with ignoring(NotGeoreferencedWarning), pytest.raises(InputError, match="with a CRS"):
        photos_of(work / "flight.gpkg", Flight(str(work / "a_01.tif"), work, photo_size=5000.0))


def test_the_command_takes_an_index(cli_here: Callable[..., Result], work: Path, tmp_path: Path) -> None:
    far = [shapely.Point(0, 0)] * 2
    index = write_index(tmp_path / "gone.gpkg", far, ["x.tif", "a_01"])
    out = tmp_path / "out"
    words = ["--reference", str(work / "ortho.tif"), "--photos", str(work), "--photo-size", "5000"]
    result = cli_here("batch", str(index), *words, "-o", str(out))
    assert result.returncode == 2
    assert f"to place: {out / 'to_place.html'}" in result.stdout
    assert "lies beyond" in result.stdout
