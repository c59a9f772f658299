"""Georeference Annotations: what is written comes back, and what is damaged is refused with its place."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
from rasterio.crs import CRS

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import describe, plan_views
from pcwlad_geo.tiepoints.iiif import write_annotation
from pcwlad_geo.tiepoints.pair_points import read_tie_points
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable, place
from tests.scenes import make_grid, write

GRID = make_grid((300, 400))
SERVICE = "https://example.org/iiif/sheet"


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("pair")
    flat = np.ones(GRID.shape, "uint8")
    paths = [write(folder / name, flat, GRID, dtype="uint8") for name in ("ref.tif", "sheet 1.tif")]
    return plan_views(*map(describe, paths))


def table_of(pair: Any) -> TiePointTable:
    random = np.random.default_rng(4)
    reference_px = random.uniform((5, 5), (395, 290), (40, 2))
    target_px = reference_px + random.normal(0, 0.7, (40, 2))
    table = place(reference_px, target_px, np.tile(0.04 * np.eye(2), (40, 1, 1)), np.ones(40), pair)
    return replace(table, status=np.where(np.arange(40) == 3, "rejected", "matched").astype("<U8"))


def annotation(path: Path, pair: Any, **options: Any) -> dict[str, Any]:
    write_annotation(table_of(pair), path, pair.target.info.uri, GRID.shape, **options)
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def test_what_is_written_comes_back(pair: Any, tmp_path: Path) -> None:
    """Numbers come back bit by bit, and places are those of PROJ to 1e-9 degrees."""
    path = tmp_path / "a_iiif.json"
    table = table_of(pair)[table_of(pair).status != "rejected"]
    annotation(path, pair)
    points = read_point_file(path)
    assert np.array_equal(points.target, table.target_px)
    assert (points.shape, points.crs, points.reference_in) == (GRID.shape, CRS.from_epsg(4326), "map")
    proj = pyproj.Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True)
    assert points.reference == pytest.approx(np.column_stack(proj.transform(*table.xy.T)), abs=1e-9)
    back = read_tie_points(path, pair)
    assert np.array_equal(back.target_px, table.target_px)
    assert back.reference_px == pytest.approx(table.reference_px, abs=1e-6)
    (tmp_path / "b").mkdir()
    write_annotation(back, tmp_path / "b/c.json", pair.target.info.uri, GRID.shape)
    again = read_point_file(tmp_path / "b/c.json")
    assert again.reference == pytest.approx(points.reference, abs=1e-11)


def test_an_annotation_names_canvas_service_and_transformation(pair: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    shift = AffineCorrection("shift", np.array([[1.0, 0, 2], [0, 1, 3]]))
    made = annotation(path, pair, source=f"{SERVICE}/info.json", model=shift)
    assert (made["type"], made["motivation"], len(made["@context"])) == ("Annotation", "georeferencing", 2)
    assert made["target"]["source"] == {"id": SERVICE, "type": "ImageService3", "height": 300, "width": 400}
    assert 'points="0,0 400,0 400,300 0,300"' in made["target"]["selector"]["value"]
    assert made["body"]["transformation"] == {"type": "polynomial", "options": {"order": 1}}
    assert len(made["body"]["features"]) == 39
    bent = annotation(path, pair, source="https://example.org/canvas/1", model=shift @ shift.invert())
    assert bent["target"]["source"]["type"] == "Canvas"
    own = annotation(path, pair)
    assert own["target"]["source"]["id"].endswith("/sheet%201.tif")
    assert "transformation" not in own["body"]


def test_of_a_page_the_annotation_of_the_target_is_read(pair: Any, tmp_path: Path) -> None:
    one = annotation(tmp_path / "a.json", pair, source=SERVICE)
    other = json.loads(json.dumps(one).replace("sheet", "plan"))
    other["body"]["features"] = other["body"]["features"][:5]
    path = tmp_path / "page.json"
    path.write_text(json.dumps({"type": "AnnotationPage", "items": [one, other]}))
    assert len(read_point_file(path, target_name="scans/plan.tif").target) == 5
    with pytest.raises(
        InputError, match=r"holds 2 Georeference Annotations of https://example.org/iiif/sheet"
    ):
        read_point_file(path, target_name="map.tif")


def test_points_of_an_image_of_another_size_are_refused(pair: Any, tmp_path: Path) -> None:
    made = annotation(tmp_path / "a.json", pair)
    made["target"]["source"]["width"] = 800
    (tmp_path / "a.json").write_text(json.dumps(made))
    with pytest.raises(InputError, match="800 x 300 pixels"):
        read_tie_points(tmp_path / "a.json", pair)


@pytest.mark.parametrize(
    ("place_in", "value", "said"),
    [
        (("type",), "Note", "holds 0 Georeference Annotations at all"),
        (("body",), [], "no FeatureCollection"),
        (("body", "features"), {"0": 1}, "no FeatureCollection"),
        (("body", "features"), [], "no tie points"),
        (("body", "features", 1), 7, "feature 2 is no point with resourceCoords"),
        (("body", "features", 0, "properties"), {}, "feature 1 is no point"),
        (("body", "features", 0, "properties", "resourceCoords"), [1], "two numbers each"),
        (("body", "features", 0, "properties", "resourceCoords"), ["1", "2"], "two numbers each"),
        (("body", "features", 0, "properties", "resourceCoords"), [True, 2], "two numbers each"),
        (("body", "features", 0, "geometry", "coordinates"), 5, "feature 1 is no point"),
        (("body", "features", 0, "geometry", "type"), "Polygon", "two numbers each"),
        (("body", "features", 0, "geometry", "coordinates"), [41.5, 115.0], "latitude 115"),
    ],
)
def test_a_damaged_annotation_says_where(
    place_in: tuple[Any, ...], value: Any, said: str, pair: Any, tmp_path: Path
) -> None:
    path = tmp_path / "a.json"
    made = annotation(path, pair)
    part: Any = made
    for key in place_in[:-1]:
        part = part[key]
    part[place_in[-1]] = value
    path.write_text(json.dumps(made))
    with pytest.raises(InputError, match=said):
        read_point_file(path)


def test_a_cut_file_is_damaged(pair: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    annotation(path, pair)
    path.write_text(path.read_text()[:-200])
    with pytest.raises(InputError, match="no JSON, or damaged"):
        read_point_file(path)


def test_a_source_without_an_annotation_is_refused() -> None:
    with pytest.raises(SettingsError, match="give --write-iiif too"):
        Settings(iiif_source=SERVICE)
