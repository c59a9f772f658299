"""The dock with several layers, advanced choices and an earlier registration."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from osgeo import gdal
from test_move import plots
from test_window import PICTURES, keep_pictures, run_in_window


def mask(place: Path, raster: Path) -> Path:
    """Write a mask of a raster, the left half excluded, and return its path."""
    data = gdal.Open(str(raster))
    made = gdal.GetDriverByName("GTiff").Create(str(place), data.RasterXSize, data.RasterYSize, 1)
    made.SetGeoTransform(data.GetGeoTransform())
    made.SetProjection(data.GetProjection())
    values = np.ones((data.RasterYSize, data.RasterXSize), np.uint8)
    values[:, : data.RasterXSize // 2] = 0
    made.GetRasterBand(1).WriteArray(values)
    return place


@pytest.fixture(scope="module")
def places(sample: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return copies of the sample pair, a second target of the same name in another folder, and a mask."""
    folder = tmp_path_factory.mktemp("more")
    found = {"folder": str(folder)}
    for name, path in (("reference", sample[0]), ("target", sample[1]), ("other", sample[1])):
        (folder / name).mkdir()
        found[name] = str(folder / name / path.name)
        shutil.copy(path, found[name])
    found["drawn"] = str(plots(folder / "plots.gpkg", sample[0]))
    found["mask"] = str(mask(folder / "mask.tif", sample[0]))
    return found


@pytest.fixture(scope="module")
def seen(profile: Path, places: dict[str, str]) -> dict[str, Any]:
    """Do it in the window, and return what was seen."""
    folder = Path(places["folder"])
    found = run_in_window("more.py", profile, folder, places)
    if PICTURES:
        keep_pictures(folder, Path(PICTURES))
    return found


def registered(places: dict[str, str], name: str) -> Path:
    """Return the folder of a target's results; both have one file name."""
    folders = {"target": "landsat_b10_aligned", "other": "landsat_b10_aligned_2"}
    return Path(places["folder"]) / "all" / folders[name]


def test_advanced_choices_are_folded_away_and_every_button_has_a_tooltip(seen: dict[str, Any]) -> None:
    assert seen["collapsed"] is True
    assert seen["untold"] == []
    assert seen["toolbar"] is True
    assert seen["errors"] == []
    assert seen["modal"] == []
    assert max(seen["least"]) < 400  # it scrolls where the dock is small
    assert seen["least_width"] < 410  # and is not wider than a dock


def test_several_layers_are_aligned_with_the_choices(seen: dict[str, Any], places: dict[str, str]) -> None:
    assert seen["several"].count("✔") == 2
    assert {"1 of 2 · target: Matching", "2 of 2 · other: Matching"} <= set(seen["stages"])
    assert "target: The layers fit" in seen["several"]
    assert "other: The layers fit" in seen["several"]
    assert "Model: Affine" in seen["several"]
    like = gdal.Open(places["reference"])
    for name in ("target", "other"):
        made = gdal.Open(str(registered(places, name) / "landsat_b10_registered.tif"))
        assert made.GetGeoTransform() == like.GetGeoTransform()
        assert (made.RasterXSize, made.RasterYSize) == (like.RasterXSize, like.RasterYSize)
        report = (registered(places, name) / "report.json").read_text(encoding="utf-8")
        assert '"search_radius": 9' in report
        assert '"ref_mask"' in report
    assert {"target aligned", "other aligned"} <= set(seen["groups"])


def test_the_mask_keeps_tie_points_out(seen: dict[str, Any], places: dict[str, str]) -> None:
    table = (registered(places, "target") / "tiepoints.csv").read_text(encoding="utf-8").splitlines()
    cols = [float(line.split(",")[1]) for line in table[1:]]
    assert len(cols) > 50
    assert min(cols) > 300  # of 700; windows may reach into the mask


def test_the_correction_is_applied_to_other_bands(seen: dict[str, Any], places: dict[str, str]) -> None:
    assert "✔ other is corrected." in seen["applied"]
    assert "✔ plots is corrected." in seen["applied"]
    assert seen["groups"]["other aligned"][0] == "plots"  # vectors above rasters
    assert seen["groups"]["other aligned"].count("other") == 2
    place = registered(places, "other") / "landsat_b10_registered_2.tif"
    made, first = gdal.Open(str(place)), gdal.Open(str(place.with_name("landsat_b10_registered.tif")))
    assert np.array_equal(made.ReadAsArray(), first.ReadAsArray())  # the same band, corrected the same way


def test_an_earlier_registration_is_opened(seen: dict[str, Any], places: dict[str, str]) -> None:
    assert "is no folder of a finished registration" in seen["none"]
    assert seen["opened"].startswith('<b style="color: #116329">✔ The layers fit')
    assert "Model: Affine" in seen["opened"]
    assert "report.html" in seen["opened"]
    folder = registered(places, "target")
    wanted = [places["reference"], places["target"], str(folder / "landsat_b10_registered.tif")]
    wanted += [f"{folder / 'tiepoints.gpkg'}|layername={name}" for name in ("tie_points", "displacements")]
    assert set(wanted) <= set(seen["layers"])
    assert seen["points"] > 50


def test_a_new_project_begins_with_what_is_preset(seen: dict[str, Any]) -> None:
    assert seen["choices_after_clearing"] == [None, None, None]


def test_a_click_on_a_point_selects_its_row(seen: dict[str, Any]) -> None:
    assert seen["picked_off_m"] <= 10 * seen["pixel_m"]
    assert seen["in_sight"] is True
    assert seen["residual_in_sight"] is True
    assert seen["picked_on_the_small_map"] is True


def test_nothing_covers_what_is_compared_and_closing_ends_all(seen: dict[str, Any]) -> None:
    assert not {"Tie points", "Tie points being edited"} & set(seen["compared"])
    assert seen["edits"] is True
    assert seen["closed"] == [False, True, False]
    assert "Tie points" in seen["shown_after_closing"]
    assert "Tie points being edited" not in seen["shown_after_closing"]


def test_windows_have_odd_sides(seen: dict[str, Any]) -> None:
    assert seen["windows"] == [21, 23, 21, None, 79, None]


def test_the_help_needs_no_network(seen: dict[str, Any]) -> None:
    (page,) = seen["help"]
    assert page.endswith("pcwlad_geo_qgis/manual/index.html")
    text = Path(page.removeprefix("file://")).read_text(encoding="utf-8")
    assert "Align a layer" in text
    assert len(seen["algorithm_help"]) == 13
    for address in seen["algorithm_help"]:
        assert address.startswith(f"{page}#")
        assert f'id="{address.split("#")[1]}"' in text
