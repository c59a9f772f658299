"""The page “Place” in QGIS with a window on a virtual screen: by hand, by keys, by pairs, and snapped."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from osgeo import gdal
from test_window import PICTURES, keep_pictures, run_in_window

SIZE = (300, 260)


def truth_of(raster: Path) -> tuple[float, ...]:
    """Return the geotransform of a part of a raster: turned by 12 degrees, pixels of 33 m."""
    x, step, _, y, _, _ = gdal.Open(str(raster)).GetGeoTransform()
    cos, sin = (33.0 * part for part in (math.cos(math.radians(12)), math.sin(math.radians(12))))
    return (x + 220 * step, cos, sin, y - 260 * step, sin, -cos)


@pytest.fixture(scope="module")
def places(sample: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The reference, a turned part of the target without georeferencing, its truth, and mere noise."""
    folder = tmp_path_factory.mktemp("place")
    reference = Path(shutil.copy(sample[0], folder / "b4.tif"))
    truth, source = truth_of(sample[1]), gdal.Open(str(sample[1]))
    memory = gdal.GetDriverByName("MEM")
    part = memory.Create("", *SIZE, 1, gdal.GDT_UInt16)
    part.SetGeoTransform(truth)
    part.SetProjection(source.GetProjection())
    gdal.ReprojectImage(source, part, None, None, gdal.GRA_Cubic)
    bare = memory.Create("", *SIZE, 1, gdal.GDT_UInt16)
    bare.WriteArray(part.ReadAsArray())
    gdal.GetDriverByName("PNG").CreateCopy(str(folder / "target.png"), bare)
    shutil.copy(reference, folder / "noise.tif")
    noise = gdal.Open(str(folder / "noise.tif"), gdal.GA_Update)
    noise.WriteArray(np.random.default_rng(5).integers(1, 20000, (noise.RasterYSize, noise.RasterXSize)))
    noise.FlushCache()
    return {
        "reference": str(reference),
        "target": str(folder / "target.png"),
        "other": str(folder / "noise.tif"),
        "truth": list(truth),
    }


@pytest.fixture(scope="module")
def seen(places: dict[str, Any], profile: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Place the target in the window, and return what was seen."""
    folder = tmp_path_factory.mktemp("window")
    found = run_in_window("place.py", profile, folder, places)
    if PICTURES:
        keep_pictures(folder, Path(PICTURES))
    return found


def test_the_layer_follows_the_mouse(seen: dict[str, Any]) -> None:
    unit = seen["unit"]
    assert seen["errors"] == []
    assert seen["modal"] == []
    halfway, end = seen["dragged"]  # moved as it is dragged, not after
    assert halfway[:2] == pytest.approx([50 * unit, -20 * unit], abs=unit)
    assert end == pytest.approx([100 * unit, -40 * unit, 0, 1], abs=unit)
    assert seen["turned"][2] == pytest.approx(90, abs=1)  # from east to north
    assert seen["turned"][:2] == pytest.approx(end[:2], abs=1e-3)  # about its middle
    (with_alt, stood), (without, zoomed) = seen["wheel"]
    assert with_alt == pytest.approx(1.02)
    assert stood == 1
    assert without == pytest.approx(1.02)
    assert zoomed != 1  # the map's own wheel


def test_what_is_typed_counts_and_every_step_is_taken_back(seen: dict[str, Any]) -> None:
    assert seen["typed"][2:] == pytest.approx([10, 1.5], abs=1e-6)
    # scale, angle, wheel, turn, drag
    assert [round(figures[2]) for figures in seen["undone"]] == [10, 90, 90, 0, 0]
    assert seen["undone"][-1] == pytest.approx([0, 0, 0, 1], abs=1e-6)
    assert seen["redone"] == pytest.approx(seen["typed"], abs=1e-6)


def test_keys_step_and_take_back(seen: dict[str, Any]) -> None:
    unit = seen["keys_unit"]
    assert seen["stepped"] == pytest.approx([unit, 10 * unit], abs=0.01)
    assert seen["taken_back"] == pytest.approx([0] * 4, abs=0.01)
    assert seen["escaped"] == pytest.approx([0] * 4, abs=0.01)
    assert seen["map_stood"] is True


def test_pairs_of_places_put_the_layer(seen: dict[str, Any], places: dict[str, Any]) -> None:
    assert "Click a place of the layer" in seen["pairs_hint"]
    one, two, three = seen["pairs_off"]  # screen pixels
    assert one[0] < 2 < one[1]
    assert max(two) < 4  # a similarity is the truth
    assert max(three[:3]) < 1.5
    assert three[3] < 3
    truth, unit = places["truth"], seen["keys_unit"]
    assert seen["where"][1] == pytest.approx(truth[1], abs=4 * unit / 230)
    assert seen["where"][2] == pytest.approx(truth[2], abs=4 * unit / 190)
    x, y = (seen["where"][k] + seen["where"][k + 1] * 150 + seen["where"][k + 2] * 130 for k in (0, 3))
    expected = [truth[k] + truth[k + 1] * 150 + truth[k + 2] * 130 for k in (0, 3)]
    assert [x, y] == pytest.approx(expected, abs=3 * unit)
    scale = math.hypot(*seen["where_3857"][1::3]) / math.hypot(*seen["where"][1::3])
    assert 1.3 < scale < 1.7  # Web Mercator at 47 degrees


def test_what_is_placed_stays_and_is_saved(seen: dict[str, Any], places: dict[str, Any]) -> None:
    assert seen["shown"] == ["b4"]  # the layer itself is hidden meanwhile
    assert seen["away"] == [False, True]
    assert "target" in seen["shown_away"]
    assert "Choose the layer" in seen["no_layer"][0]
    assert seen["come_back"] is True
    assert (seen["other_tool"], seen["tool_again"]) == (False, True)
    path = Path(places["target"]).with_name("target_placed.vrt")
    assert str(path) in seen["saved"]
    assert gdal.Open(str(path)).GetGeoTransform() == pytest.approx(seen["where"], rel=1e-9)
    assert gdal.Open(str(path)).GetSpatialRef().GetAuthorityCode(None) == "32633"
    assert 'relativeToVRT="1">target.png<' in path.read_text(encoding="utf-8")
    assert "EPSG:32633" in seen["saved_crs"]


def test_a_refusal_leaves_the_layer_where_it_was_put(seen: dict[str, Any]) -> None:
    assert seen["while_it_runs"] == [False, True]
    assert "✖" in seen["refusal"]
    assert "report" in seen["refusal"].lower()
    assert seen["stays"] == [True, True]


def test_snap_finds_the_truth_from_there(seen: dict[str, Any], places: dict[str, Any]) -> None:
    assert "Cancelled" in seen["cancelled"]
    assert seen["ghost_stays"] is True
    assert "✔ The layers fit" in seen["snapped"]
    assert seen["page"] == 0
    assert Path(seen["after"]).is_file()
    assert "Choose the layer" in seen["after_removal"]
