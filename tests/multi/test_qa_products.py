"""Quality reports of whole products: bands, masks and native pixels as the product has them."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.cli.app import run as main
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.multi.qa.bands import expand, find_band, list_bands, split_bands
from pcwlad_geo.multi.qa.run import qa_folder
from tests.multi.measured_bands import schema_file
from tests.product_files import LANDSAT, SAFE, packed, write_landsat, write_safe

SMALL: Any = {"template": 61, "window": 41, "features": 100, "jobs": 1}


@pytest.fixture(scope="module")
def landsat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """B4, B8 (15 m) and B10, with a cloud."""
    cloud = (slice(60, 130), slice(40, 110))
    return write_landsat(tmp_path_factory.mktemp("landsat"), cloud=cloud)


@pytest.fixture(scope="module")
def safe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """B04, B05 and B01, of 10, 20 and 60 m."""
    return write_safe(tmp_path_factory.mktemp("sentinel"))


def test_a_landsat_folder_is_a_stack(landsat: Path) -> None:
    bands = list_bands([landsat])
    assert [band.name for band in bands] == ["B8", "B4", "B10"]  # the finest first
    assert [band.native_m for band in bands] == [(15.0, 15.0), (30.0, 30.0), (100.0, 100.0)]
    assert all(band.native_known for band in bands)
    assert {Path(str(band.info.mask_uri)).name for band in bands} == {f"{LANDSAT}_QA_PIXEL.TIF"}
    assert all(band.info.mask_kind == "QA_PIXEL" for band in bands)
    assert find_band(bands, "b04").name == "B4"
    assert [band.name for band in list_bands([packed(landsat, ".tar")])] == ["B8", "B4", "B10"]


def test_a_safe_is_a_stack_packed_or_not(safe: Path) -> None:
    given = [safe, safe / "MTD_MSIL2A.xml", packed(safe, ".zip")]
    for path in given:
        bands = list_bands([path])
        assert [band.name for band in bands] == ["B04", "B05", "B01"]
        for band, size_m in zip(bands, (10.0, 20.0, 60.0), strict=True):
            assert band.px_m == pytest.approx((size_m, size_m), rel=1e-3)
        assert [band.native_m for band in bands] == [(10.0, 10.0), (20.0, 20.0), (60.0, 60.0)]
        assert all(band.info.nodata == 0 for band in bands)  # although the files do not say so
        assert find_band(bands, "B4").name == "B04"
        assert "vrt:" not in bands[0].where
        assert qa_folder([path], None) == Path(f"{SAFE.removesuffix('.SAFE')}_qa")


def test_bands_of_a_product_are_chosen_by_name(landsat: Path, safe: Path) -> None:
    assert split_bands(f"{landsat}:B4,B10") == (str(landsat), ["B4", "B10"])
    assert [band.name for band in list_bands([f"{landsat}:B10,B4"])] == ["B10", "B4"]
    assert [band.name for band in list_bands([landsat], ["B4", "B8"])] == ["B8", "B4"]
    both = list_bands([f"{landsat}:B4", f"{safe}:B04"])
    assert [band.name for band in both] == ["S2B B04", "LC08 B4"]


def test_what_cannot_be_used_is_told(landsat: Path, safe: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"band B3 of .* is missing: it holds B4, B8, B10"):
        list_bands([f"{landsat}:B3,B4"])
    with pytest.raises(InputError, match="say which band by name"):
        list_bands([landsat], [4, 10])
    plain = next(landsat.glob("*_B4.TIF"))
    with pytest.raises(InputError, match="is the file of one band of a product"):
        list_bands([f"{plain}:B4,B5"])
    incomplete = write_landsat(tmp_path)
    next(incomplete.glob("*_B10.TIF")).unlink()
    with pytest.raises(InputError, match=r"lacks bands that its metadata list: B10; complete it, or name"):
        list_bands([incomplete])
    assert len(list_bands([f"{incomplete}:B4,B8"])) == 2


def test_cirrus_bands_are_left_out_unless_named(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path, bands=("B4", "B9", "B10"))
    found = expand(scene)
    assert [wanted.name for wanted in found] == ["B4", "B10"]
    assert "B9" in found[0].notes[0]
    assert "cirrus" in found[0].notes[0]
    assert [wanted.name for wanted in expand(f"{scene}:B4,B9")] == ["B4", "B9"]
    older = write_landsat(tmp_path, name=LANDSAT.replace("LC08", "LE07"), bands=("B4", "B9"))
    assert [wanted.name for wanted in expand(older)] == ["B4", "B9"]


def test_a_mask_of_the_user_replaces_the_product_s(landsat: Path, tmp_path: Path) -> None:
    with rasterio.open(next(landsat.glob("*_B4.TIF"))) as file:
        profile = file.profile | {"dtype": "uint8", "nodata": None}
    mask = tmp_path / "mask.tif"
    with rasterio.open(mask, "w", **profile) as file:
        file.write(np.ones(file.shape, "uint8"), 1)
    assert {band.info.mask_uri for band in list_bands([landsat], mask=mask)} == {str(mask)}
    bare = write_landsat(tmp_path)
    next(bare.glob("*QA_PIXEL*")).unlink()
    assert f"has no quality raster ({bare.name}_QA_PIXEL.TIF)" in list_bands([bare])[0].notes[0]


def test_qa_of_a_landsat_product_against_a_band(
    landsat: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["qa", str(landsat), "--against", "B4", "--preset", "landsat-oli", "--preset", "landsat-tirs"]
    arguments += ["--template", "61", "--window", "41", "--features", "100", "--jobs", "1"]
    assert main([*arguments, "--progress", "none"]) == 0
    report = json.loads(Path(f"{LANDSAT}_qa/qa.json").read_text(encoding="utf-8"))
    jsonschema.validate(report, json.loads(schema_file().read_text(encoding="utf-8")))
    assert report["against"] == "B4"
    assert [pair["name"] for pair in report["pairs"]] == ["B4 – B8", "B4 – B10"]
    assert [each["judged"] for each in report["requirements"]] == [1, 1]  # no pair of two thermal bands
    thermal = report["pairs"][1]
    assert thermal["native_px_m"] == [100.0, 100.0]
    native, px = thermal["displacement"]["native_px"], thermal["displacement"]["px"]
    assert native["radial"]["ce90"] == pytest.approx(0.3 * px["radial"]["ce90"], rel=1e-3)
    assert all(band["product"] == str(landsat) for band in report["bands"])
    assert all(band["mask"].endswith("QA_PIXEL.TIF") for band in report["bands"])
    assert abs(px["col"]["mean"]) < 0.05
    assert abs(px["row"]["mean"]) < 0.05


def test_qa_of_a_safe_compares_bands_of_three_pixel_sizes(safe: Path, tmp_path: Path) -> None:
    events: list[Event] = []
    result = pcwlad_geo.qa(safe, out_dir=tmp_path / "out", on_event=events.append, **SMALL)
    names = ["B04", "B05", "B01"]
    assert [(pair.reference.name, pair.target.name) for pair in result.pairs] == [*combinations(names, 2)]
    for pair, size_m in zip(result.pairs, (20.0, 60.0, 60.0), strict=True):
        assert pair.target.px_m == pytest.approx((size_m, size_m), rel=1e-3)
        assert pair.status == "measured", pair.reason
        m = pair.statistics["m"]
        assert m is not None
        assert np.hypot(m.col.mean, m.row.mean) < 0.1 * pair.target.px_m[0]  # type: ignore[index]
    assert not [each for each in events if isinstance(each, Warned) and "quality raster" in each.message]


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"tie_points": "points.csv"}, "tie_points is for register"),
        ({"dem": "dem.tif"}, "dem is for images of Sentinel-1, and there is none"),
        ({"tgt_mask": "mask.tif"}, "tgt_mask is for a single pair: give mask"),
        ({"ref_band": 2}, "ref_band is for a single pair: give bands"),
    ],
)
def test_options_of_pairs_are_refused(option: dict[str, Any], message: str, landsat: Path) -> None:
    with pytest.raises(SettingsError, match=message):
        pcwlad_geo.qa(landsat, **option)
