"""Stacks of whole products: their bands, masks and pixel sizes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from pcwlad_geo.cli.app import run as run_command
from pcwlad_geo.multi.stack.run import stack
from pcwlad_geo.raster.masks import accepted
from tests.product_files import BEFORE_COLLECTIONS, write_landsat

FAST: Any = {"window": 41, "template": 61, "features": 100, "jobs": 1, "no_report": True}


def reports(out: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted(out.glob("pairs/*/report.json"))]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A renamed scene of before the Collections, with a cloud."""
    return write_landsat(
        tmp_path_factory.mktemp("scene"),
        name="crop",
        collection=None,
        quality_values=BEFORE_COLLECTIONS,
        cloud=(slice(60, 130), slice(40, 110)),
        bands=("B4", "B8", "B9", "B10"),
    )


def test_a_product_without_a_band_is_all_that_show_the_ground(scene: Path, tmp_path: Path) -> None:
    with rasterio.open(scene / "crop_B4.TIF") as file:
        assert file.tags(ns="IMD")  # GDAL reads the MTL, and would write it beside every output
        bounds = file.bounds
    out = tmp_path / "out"
    found = stack([scene], out_dir=out, **FAST)
    assert [image.name for image in found.images] == ["crop_B4", "crop_B8", "crop_B10"]
    assert not [path for path in out.rglob("*") if path.suffix.upper() == ".IMD"]
    for name, size_m in (("B4", 30.0), ("B8", 15.0), ("B10", 30.0)):
        with rasterio.open(out / f"crop_{name}_registered.tif") as file:
            assert (file.transform.a, file.bounds, file.nodata) == (size_m, bounds, 0)
    for report in reports(out):
        assert {report[side]["mask_kind"] for side in ("reference", "target")} == {"BQA"}
    for image in found.images:
        assert np.abs(image.shift_px).max() < (0.35 if image.name == "crop_B8" else 0.1)


def test_one_grid_for_all_where_it_is_asked_for(scene: Path, tmp_path: Path) -> None:
    arguments = ["stack", str(scene), "-o", str(tmp_path / "out"), "--progress", "none"]
    arguments += ["--window", "41", "--template", "61", "--features", "60", "--jobs", "1", "--no-report"]
    assert run_command([*arguments, "--like", str(scene / "crop_B4.TIF")]) == 0
    with rasterio.open(tmp_path / "out/crop_B8_registered.tif") as file:
        assert file.res == (30.0, 30.0)


@pytest.mark.slow
def test_a_real_folder_of_the_older_layout(shared_data: Path, tmp_path: Path) -> None:
    """Bands under clouds follow the ground: with the clouds masked, B10 lies (0.06, -0.04) px off the visible
    ones (phase correlation). No such thermal band is called good.
    """
    folder = shared_data / "real" / "landsat_clouds"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    with rasterio.open(folder / "l8_BQA.tif") as quality, rasterio.open(folder / "l8_B10.tif") as thermal:
        clear, kelvin = accepted("BQA", quality.read()), thermal.read(1)
        bounds = quality.bounds
    assert np.percentile(kelvin[clear], 25) > np.percentile(kelvin[~clear], 75)  # clouds are cold
    found = stack([folder], out_dir=tmp_path / "out", window=61, features=400, jobs=1)
    assert [image.name for image in found.images] == [f"l8_B{number}" for number in (1, 2, 4, 5, 8, 10)]
    assert not [path for path in (tmp_path / "out").rglob("*") if path.suffix.upper() == ".IMD"]
    assert {report["target"]["mask_kind"] for report in reports(tmp_path / "out")} == {"BQA"}
    with rasterio.open(tmp_path / "out/l8_B8_registered.tif") as file:
        assert (file.res, file.bounds) == ((15.0, 15.0), bounds)
    for image in found.images:
        assert np.hypot(*image.shift_px) < 0.3, image.name
    thermal = found.images[-1]
    assert np.hypot(*(np.array(thermal.shift_px) - (0.06, -0.04))) < 0.3
    assert thermal.quality.grade != "good"
    numbers = json.loads((tmp_path / "out/stack.json").read_text())
    assert numbers["quality"]["grade"] != "good"
    assert numbers["images"][-1]["quality"]["grade"] == thermal.quality.grade
