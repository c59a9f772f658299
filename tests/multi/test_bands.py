"""Bands of a stack: found, named, refused where they make no sense."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.multi.qa.bands import (
    expand,
    find_band,
    list_bands,
    parse_bands,
    split_bands,
    with_native_px,
)
from pcwlad_geo.products.finding import native_px_m
from tests.scenes import make_grid, write


def raster(path: Path, count: int = 1, descriptions: tuple[str, ...] = (), pixel_m: float = 30.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, np.ones((count, 20, 20), np.uint16), make_grid((20, 20), pixel_m=pixel_m))
    if descriptions:
        with rasterio.open(path, "r+") as file:
            file.descriptions = descriptions
    return path


def names(*rasters: str | Path, bands: list[int] | None = None) -> list[str]:
    return [band.name for band in list_bands(rasters, bands)]


def test_a_raster_with_all_its_bands(tmp_path: Path) -> None:
    assert names(raster(tmp_path / "a.tif", 3)) == ["band 1", "band 2", "band 3"]
    assert names(raster(tmp_path / "b.tif", 2, ("B4", "B10"))) == ["B4", "B10"]


def test_an_alpha_band_is_no_band(tmp_path: Path) -> None:
    path = raster(tmp_path / "a.tif", 3)
    with rasterio.open(path, "r+") as file:
        file.colorinterp = (ColorInterp.gray, ColorInterp.undefined, ColorInterp.alpha)
    assert names(path) == ["band 1", "band 2"]


def test_bands_of_one_file_and_of_all(tmp_path: Path) -> None:
    five, two = raster(tmp_path / "five.tif", 5), raster(tmp_path / "two.tif", 2)
    assert names(f"{five}:2,4-5") == ["band 2", "band 4", "band 5"]
    assert names(f"{five}:3,5", two, bands=[1]) == ["five band 3", "five band 5", "two band 1"]


def test_a_file_whose_name_ends_like_bands_is_a_file(tmp_path: Path) -> None:
    odd = raster(tmp_path / "a.tif:2", 2)
    raster(tmp_path / "a.tif", 2)
    assert split_bands(odd) == (os.fspath(odd), None)
    assert split_bands("HDF4_SDS:UNKNOWN:x.hdf:5") == ("HDF4_SDS:UNKNOWN:x.hdf:5", None)
    assert split_bands("/vsis3/bucket/a.tif:1,2") == ("/vsis3/bucket/a.tif", [1, 2])


@pytest.mark.parametrize(
    ("stems", "expected"),
    [
        (
            ["LC08_L1TP_172083_20200101_20200823_02_T1_B4", "LC08_L1TP_172083_20200101_20200823_02_T1_B10"],
            ["B4", "B10"],
        ),
        (["landsat8_byte", "sentinel2_b432"], ["landsat8", "sentinel2"]),
        (["red", "red_edge"], ["red", "red_edge"]),
        (["x_red", "x_red_edge"], ["red", "red_edge"]),
    ],
)
def test_short_names_of_files(stems: list[str], expected: list[str], tmp_path: Path) -> None:
    assert names(*(raster(tmp_path / f"{stem}.tif") for stem in stems)) == expected


def test_names_are_unique_whatever_the_files_are_called(tmp_path: Path) -> None:
    paths = [raster(tmp_path / folder / "b4.tif") for folder in ("one", "two")]
    assert len(set(names(*paths))) == 2
    same = raster(tmp_path / "same.tif", 2, ("red", "red"))
    assert names(same) == ["same 1", "same 2"]


def test_finer_bands_come_first(tmp_path: Path) -> None:
    coarse, fine = raster(tmp_path / "coarse.tif"), raster(tmp_path / "fine.tif", pixel_m=10.0)
    assert names(coarse, fine) == ["fine", "coarse"]


def test_a_folder_is_its_rasters_but_quality_rasters(tmp_path: Path) -> None:
    for name in ("b.tif", "a.TIF", "x_BQA.tif", "x_QA_PIXEL.TIF"):
        raster(tmp_path / name)
    (tmp_path / "notes.txt").touch()
    assert [band.name for band in list_bands([tmp_path])] == ["a", "b"]
    assert [Path(wanted.uri).name for wanted in expand(tmp_path, [1])] == ["a.TIF", "b.tif"]


def test_what_is_no_stack_is_told(tmp_path: Path) -> None:
    one = raster(tmp_path / "one.tif")
    with pytest.raises(InputError, match="compares two bands or more, and there is 1"):
        list_bands([one])
    with pytest.raises(InputError, match=r"one\.tif, band 1 is there twice"):
        list_bands([one, one])
    with pytest.raises(InputError, match="empty name"):
        list_bands([one, ""])
    with pytest.raises(InputError, match="does not exist"):
        list_bands([one, tmp_path / "two.tif"])
    with pytest.raises(InputError, match="holds 1 band, and band 4 was asked for"):
        list_bands([f"{one}:1,4"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        list_bands([one, tmp_path / "empty"])


@pytest.mark.parametrize("text", ["", "?", "0", "2-", "-2", "3-1", "1,,2", "1-99999", "9" * 5000])
def test_bands_that_cannot_be_read(text: str) -> None:
    with pytest.raises(SettingsError, match="bands = "):
        parse_bands(text)


def test_finds_a_band_by_any_of_its_names(tmp_path: Path) -> None:
    stack = list_bands(
        [raster(tmp_path / "l8_sr.tif", 3, ("SR_B4", "SR_B5", "QA")), raster(tmp_path / "s2_B04.tif")]
    )
    for name, found in {
        "l8 SR_B4": "l8 SR_B4",
        "sr_b5": "l8 SR_B5",
        "B5": "l8 SR_B5",
        "l8_sr:3": "l8 QA",
        "l8_sr.tif:2": "l8 SR_B5",
        "s2": "s2",
        "s2_B04.tif": "s2",
        "b04": "s2",
    }.items():
        assert find_band(stack, name).name == found, name
    with pytest.raises(SettingsError, match="'B9' is none of the bands: give one of l8 SR_B4, "):
        find_band(stack, "B9")
    with pytest.raises(SettingsError, match="'l8_sr' is more than one band"):
        find_band(stack, "l8_sr")


def test_native_pixels_that_the_user_tells(tmp_path: Path) -> None:
    stack = list_bands([raster(tmp_path / "a.tif", 2, ("B4", "B10"))])
    own, told = (band.native_m for band in with_native_px(stack, ["B10=100"]))
    assert own == pytest.approx((30, 30), rel=1e-3)
    assert told == (100, 100)
    assert [band.native_m for band in with_native_px(stack, ["20"])] == [(20, 20), (20, 20)]
    assert [band.native_known for band in with_native_px(stack, ["B10=100"])] == [False, True]
    for text in ("B10", "B10=", "B10=-1", "B10=nan", "B10=inf", "=100m"):
        with pytest.raises(SettingsError, match="NAME=METRES"):
            with_native_px(stack, [text])
    with pytest.raises(SettingsError, match="'B7' is none of the bands"):
        with_native_px(stack, ["B7=100"])


@pytest.mark.parametrize(
    ("stem", "description", "native_m"),
    [
        ("LC08_L1TP_172083_20200101_20200823_02_T1_B4", None, 30.0),
        ("LC08_L1TP_172083_20200101_20200823_02_T1_B8", None, 15.0),
        ("LC09_L1TP_172083_20220101_20220823_02_T1_B10", None, 100.0),
        ("LC08_L2SP_172083_20200101_20200823_02_T1_ST_B10", None, 100.0),
        ("LC08_L2SP_172083_20200101_20200823_02_T1_SR_B6", None, 30.0),
        ("LE07_L1TP_172083_20000101_20200823_02_T1_B6_VCID_1", None, None),
        ("LT05_L1TP_172083_19900101_20200823_02_T1_B6", None, 120.0),
        ("T34HCH_20200101T081331_B8A", None, 20.0),
        ("T34HCH_20200101T081331_B02_10m", None, 10.0),
        ("T34HCH_20200101T081331_B01", None, 60.0),
        ("stack", "ST_B10", 100.0),
        ("stack", "SR_B4", None),
        ("B10", None, None),
    ],
)
def test_native_pixels_of_known_sensors(stem: str, description: str | None, native_m: float | None) -> None:
    assert native_px_m(stem, description) == native_m
