"""The dock, the editor of tie points, swipe and blink, in QGIS with a window on a virtual screen."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from osgeo import gdal, ogr, osr
from test_process import built, profile  # noqa: F401  # fixtures
from test_window import PICTURES, keep_pictures, run_in_window


def polygons(place: Path, raster: Path) -> Path:
    """Write a polygon with a hole over the middle of a raster, in another CRS, and return its path."""
    data = gdal.Open(str(raster))
    left, width, _, top, _, height = data.GetGeoTransform()
    here, there = osr.SpatialReference(), osr.SpatialReference()
    here.ImportFromEPSG(32633)
    there.ImportFromEPSG(3857)
    change = osr.CoordinateTransformation(here, there)
    source = ogr.GetDriverByName("GPKG").CreateDataSource(str(place))  # kept: its layers go with it
    layer = source.CreateLayer("area", there, ogr.wkbPolygon)
    polygon = ogr.Geometry(ogr.wkbPolygon)
    for low, high in ((0.2, 0.8), (0.45, 0.55)):
        ring = ogr.Geometry(ogr.wkbLinearRing)
        for across, down in ((low, low), (high, low), (high, high), (low, high), (low, low)):
            x = left + width * across * data.RasterXSize
            ring.AddPoint(*change.TransformPoint(x, top + height * down * data.RasterYSize)[:2])
        polygon.AddGeometry(ring)
    feature = ogr.Feature(layer.GetLayerDefn())
    feature.SetGeometry(polygon)
    layer.CreateFeature(feature)
    return place


@pytest.fixture(scope="module")
def seen(
    profile: Path,  # noqa: F811
    sample: tuple[Path, Path],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Any]:
    """Align the sample pair in the window, edit its points, and return what was seen."""
    folder = tmp_path_factory.mktemp("align")
    places = {}
    for name, path in zip(("reference", "target"), sample):
        places[name] = str(folder / path.name)
        shutil.copy(path, places[name])
    places["polygons"] = str(polygons(folder / "area.gpkg", sample[0]))
    found = run_in_window("align.py", profile, folder, places)
    if PICTURES:
        keep_pictures(folder, Path(PICTURES))
    return found


def test_the_dock_opens_for_the_layer_with_another_as_its_reference(seen: dict[str, Any]) -> None:
    assert seen["menu"] is True
    assert seen["preset"] == ["landsat_b10", "landsat_b4"]
    assert seen["modal"] == []


def test_the_dialog_presets_two_layers(seen: dict[str, Any]) -> None:
    assert sorted(seen["dialog"]) == ["landsat_b10", "landsat_b4"]


def test_the_result_has_the_name_of_the_layer_in_a_group_and_a_verdict_in_a_sentence(
    seen: dict[str, Any],
) -> None:
    assert seen["verdict"].startswith(
        "The layers fit well: 90 % of the common ground is expected to lie within 0."
    )
    assert "report.html" in seen["verdict"]
    assert set(seen["groups"]["landsat_b10 aligned"]) == {"landsat_b10", "Tie points", "Displacement"}
    assert seen["field"][0].startswith("matched: displacement × ")
    assert "landsat_b10_aligned" in seen["after"]


def test_the_table_is_that_of_the_georeferencer_sorted_by_residual(seen: dict[str, Any]) -> None:
    assert seen["columns"][:9] == [
        "Visible",
        "ID",
        "Source X",
        "Source Y",
        "Dest. X",
        "Dest. Y",
        "dX (pixels)",
        "dY (pixels)",
        "Residual (pixels)",
    ]
    assert seen["sorted"] == sorted(seen["sorted"], reverse=True)
    assert seen["sorted"][0] > 0
    assert seen["zoomed"][:2] == [True, True]
    assert seen["zoomed"][2] < 10_000


def test_points_go_off_and_come_back_and_models_tell_their_rmse(seen: dict[str, Any]) -> None:
    assert seen["points"] > 1000
    for model, seconds in seen["refit_s"]:
        print(f"refit and redraw of {seen['points']} points, {model}: {seconds:.2f} s")
    assert seen["off_after_undo"] == seen["off"] - 1
    assert seen["off_by_rectangle"] > seen["off_after_undo"]
    assert {"shift", "affine", "projective", "polynomial2", "tps"} <= set(seen["rmse"])
    assert seen["rmse"]["tps"] < seen["rmse"]["affine"] < 0.5


def test_an_added_point_is_refined_and_points_are_saved(
    seen: dict[str, Any], sample: tuple[Path, Path]
) -> None:
    assert seen["added"][0] < 1.0  # it was shown 1.5 px off
    assert 0 < seen["added"][1] < 1.0
    assert seen["again"].startswith("The layers fit")


def test_swipe_blink_and_arrows(seen: dict[str, Any]) -> None:
    assert seen["swipe"] > 100
    assert seen["blink"] == [False, True, True]
    assert "fit: residual × 25" in seen["legend"]


def test_extent_area_and_georeferencing_only(seen: dict[str, Any]) -> None:
    assert seen["limited"].startswith("The layers fit")
    assert seen["georeferenced"].endswith("landsat_b10_corrected.vrt")
    assert "same raster and band" in seen["refused"]
    assert 20 <= len(seen["limited_points"]) < seen["points"]


def test_cancelling_is_told(seen: dict[str, Any]) -> None:
    assert seen["cancelled"] == "Cancelled; nothing was written."
