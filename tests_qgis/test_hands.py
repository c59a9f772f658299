"""The dock under hands that press twice, in the wrong order and midway."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from osgeo import gdal
from test_window import run_in_window

TURN_DEG = 25.0


def noise(place: Path, like: Path) -> Path:
    """Write noise in the place of a raster, and return its path."""
    gdal.Translate(str(place), str(like))
    made = gdal.Open(str(place), gdal.GA_Update)
    shape = made.RasterYSize, made.RasterXSize
    made.GetRasterBand(1).WriteArray(np.random.default_rng(1).integers(1, 9000, shape))
    return place


def photo(place: Path, raster: Path, side: int = 130) -> Path:
    """Write the middle of a raster, turned, with three bands and without a place, and return its path."""
    data = gdal.Open(str(raster))
    left, pixel, _, top, _, _ = data.GetGeoTransform()
    cos, sin = (pixel * each(math.radians(TURN_DEG)) for each in (math.cos, math.sin))
    made = gdal.GetDriverByName("MEM").Create("", side, side, 1, gdal.GDT_Float32)
    corner = [left + pixel * data.RasterXSize / 2, top - pixel * data.RasterYSize / 2]
    corner = [corner[0] - side / 2 * (cos + sin), corner[1] - side / 2 * (sin - cos)]
    made.SetGeoTransform((corner[0], cos, sin, corner[1], sin, -cos))
    made.SetProjection(data.GetProjection())
    gdal.ReprojectImage(data, made, None, None, gdal.GRA_Cubic)
    values = made.ReadAsArray()
    low, high = np.percentile(values, (1, 99))
    values = np.clip((values - low) / (high - low) * 254 + 1, 1, 255).astype(np.uint8)
    copy = gdal.GetDriverByName("MEM").Create("", side, side, 3)
    for band in (1, 2, 3):
        copy.GetRasterBand(band).WriteArray(values)
    gdal.GetDriverByName("PNG").CreateCopy(str(place), copy)
    return place


def points(place: Path, raster: Path, off_px: tuple[float, float] = (1.2, -0.7)) -> Path:
    """Write twelve points of the Georeferencer for a raster and return the path."""
    left, pixel, _, top, _, _ = gdal.Open(str(raster)).GetGeoTransform()
    lines = ["mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"]
    for col in (20, 70, 130, 180):
        for row in (30, 100, 170):
            x, y = left + col * pixel, top - row * pixel
            lines.append(f"{x},{y},{x + off_px[0] * pixel},{y - off_px[1] * pixel},1,0,0,0")
    place.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return place


@pytest.fixture(scope="module")
def seen(
    profile: Path, sample: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Any]:
    """Do it in the window, on so small rasters that nine runs take little, and return what was seen."""
    folder = tmp_path_factory.mktemp("hands")
    places = {name: str(folder / f"{name}.tif") for name in ("reference", "target")}
    for path, place in zip(sample, places.values()):
        gdal.Translate(place, str(path), srcWin=[250, 250, 200, 200])
    reference = Path(places["reference"])
    places["noise"] = str(noise(folder / "noise.tif", reference))
    places["points"] = str(points(folder / "by_hand.points", reference))
    places["photo"] = str(photo(folder / "photo.png", reference))
    places["package"] = str(folder / "package.gpkg")
    options = {"format": "GPKG", "outputType": gdal.GDT_Byte, "scaleParams": [[]]}
    gdal.Translate(places["package"], places["target"], **options)
    return run_in_window("hands.py", profile, folder, places)


def test_no_slot_raises_and_nothing_asks(seen: dict[str, Any]) -> None:
    assert seen["errors"] == []
    assert seen["modal"] == []


def test_without_an_engine_the_dock_says_so_when_it_opens_and_blames_nobody(seen: dict[str, Any]) -> None:
    text, offered = seen["no engine"]
    assert text.startswith("<b>No pcwlad-geo engine was found.")
    assert offered is True
    assert "✖" not in text


def test_the_dock_is_as_wide_as_its_forms_and_no_wider_than_a_small_screen(seen: dict[str, Any]) -> None:
    assert seen["width"][1] is False
    assert seen["fits"] >= 0
    assert seen["advanced fits"] >= 0
    assert seen["width"][0] <= 420
    assert max(seen["window"]) <= 1024
    assert seen["focus"] is True
    assert seen["toolbar"] != []


def test_all_pages_are_in_sight_and_empty_ones_say_what_to_do(seen: dict[str, Any]) -> None:
    assert seen["tabs in sight"] == [True] * 4
    assert seen["selected"] == []
    assert seen["empty page"] == [True, False]  # what to do is not grey
    assert [seen["without points"], seen["with points"], seen["without points again"]] == [True, False, True]


def test_one_run_at_a_time_whatever_is_pressed(seen: dict[str, Any]) -> None:
    assert seen["idle"]["run_box"] is False
    assert seen["more"] == []  # neither the pair itself, nor left for the next run
    assert seen["tasks"] == ["Executing “Register raster: target”"]
    assert seen["focus after"] is True
    assert seen["unfolded"] is True
    assert seen["running"] == [True, False, True]
    assert "The layers fit" in seen["aligned"]
    assert [told[:2] for told in seen["told"]] == [[True, False]] * len(seen["told"])
    assert any(stage for *_, stage in seen["told"])
    assert seen["again"][0].count("The layers fit") == 1
    assert seen["again"][1:] == [True, True]
    assert seen["folders"] == ["target_aligned", "target_aligned_2"]
    assert seen["groups"] == [["target aligned 2", True], ["target aligned", False]]
    text, folders, told = seen["while another runs"]
    assert text.count("The pair was refused") == 1
    assert folders == seen["folders"]
    assert told is True


def test_after_a_refusal_no_earlier_correction_is_offered_but_points_of_a_file(seen: dict[str, Any]) -> None:
    assert seen["before the refusal"]["given_button"] is False
    text, parts = seen["refused"]
    assert "The pair was refused, and nothing was corrected:</b>" in text
    assert parts["apply_box"] is False
    assert (parts["given_button"], parts["place_button"]) == (True, True)
    assert "The layers fit" in seen["by points"]


def test_a_target_without_a_place_is_shown_in_its_own_frame_with_its_points(seen: dict[str, Any]) -> None:
    assert "The layers fit well" in seen["unplaced"]
    assert seen["the small map has a CRS"] is True  # QGIS may crash in a map without
    assert seen["photo"][0] is True
    assert 40 < seen["photo"][1] < 700
    assert seen["picked in the photo"] < 6
    assert seen["the table stays"] is True
    assert seen["followed"] < 3
    count, off_px, told = seen["added"]
    assert count == 1, told
    assert off_px < 0.5  # refined or not


def test_the_verdict_is_in_sight_with_all_choices_open(seen: dict[str, Any]) -> None:
    shown_px, height_px = seen["verdict in sight"]
    assert shown_px > min(60, height_px - 1)  # lines of it, on a screen of 1024 x 740
    assert seen["verdict in the window"] >= 0


def test_warnings_of_the_engine_are_shown_and_no_displacement_from_a_frame_of_its_own(
    seen: dict[str, Any],
) -> None:
    assert "⚠ no georeferencing that the two share" in seen["unplaced"]
    assert "Median displacement" not in seen["unplaced"]
    assert "Median displacement" in seen["aligned"]
    assert "0.00 px (RMS)" not in seen["aligned"]


def test_an_added_row_is_in_sight_and_has_figures(seen: dict[str, Any]) -> None:
    in_sight, cells = seen["new row"]
    assert in_sight is True
    assert "nan" not in cells


def test_a_mask_of_the_result_stays_transparent(seen: dict[str, Any]) -> None:
    assert seen["alpha"] == 4


def test_files_that_name_others_are_asked_about_once(seen: dict[str, Any]) -> None:
    text, parts = seen["package"]
    assert text.startswith("<b>package:</b> ")
    assert "--" not in text
    assert parts["trust_button"] is True
    assert "The layers fit" in seen["trusted"][0]
    assert seen["trusted"][1]["trust_button"] is False
    assert "The layers fit" in seen["trusted again"]
    assert seen["edits the trusted"] is True


def test_edits_outlive_a_closed_dock_and_nothing_outlives_the_project(seen: dict[str, Any]) -> None:
    assert seen["edits"] == [True, True]
    assert seen["saved"] is False
    text, closed, parts, forgotten = seen["new project"]
    assert text == ""
    assert closed is True
    assert forgotten is True
    assert not any(parts.values())


def test_keys_and_menu_of_the_table(seen: dict[str, Any]) -> None:
    assert seen["keys"] == [
        [True, False],
        [False, False],
        [False, True],
        [False, False],
        [False, True],
        [False, False],
    ]
    assert seen["esc"] == [True, True, True]
    assert seen["menu"] == 5


def test_swipe_and_blink_end_with_their_page(seen: dict[str, Any]) -> None:
    assert seen["still compares"] == [False, False]


def test_what_is_shown_already_is_not_shown_twice(seen: dict[str, Any]) -> None:
    assert seen["opened"] == [0, 0]


def test_tie_points_look_as_those_of_the_toolbox(seen: dict[str, Any]) -> None:
    kind, labels = seen["legends"]
    assert kind == "categorizedSymbol"
    assert labels[0].startswith("rejected (arrows × ")


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour (#rrggbb), by WCAG 2."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear))


def test_verdicts_are_legible_on_light_and_dark_windows(seen: dict[str, Any]) -> None:
    grounds = []
    for ground, colours in seen["themes"].values():
        assert len(colours) == 4
        grounds.append(luminance(ground))
        for colour in colours:
            high, low = sorted((luminance(colour), luminance(ground)), reverse=True)
            assert (high + 0.05) / (low + 0.05) >= 4.5, (colour, ground)
    assert grounds[0] > 0.6
    assert grounds[1] < 0.1


def test_dialogs_are_not_clipped(seen: dict[str, Any]) -> None:
    assert seen["clipped"] == dict.fromkeys(seen["clipped"], 0)
