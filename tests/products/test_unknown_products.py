"""What is said of a path that stands for no product."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.qa.bands import RequestedBand, expand
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product, no_product
from pcwlad_geo.registration import resolve


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("LC81980302020222LGN00_B4.TIF", "before the Collections without its bands and its MTL file"),
        ("LT51980301999222FUI00_MTL.txt", "a Landsat scene of before the Collections"),
        ("LC08_CU_003008_20200809_20210504_02_SR_B4.TIF", "a Landsat analysis-ready tile"),
        ("T32TQM_20230809T100559_B04_10m.jp2", "band files of Sentinel-2 outside of their product"),
        ("R10m", "band files of Sentinel-2 outside of their product"),
        ("b4.tif", "neither a Landsat scene nor a Sentinel-1 or Sentinel-2 product: give a raster file"),
    ],
)
@pytest.mark.parametrize("band", [1, "B4"])
def test_a_folder_is_told_by_what_it_holds(name: str, said: str, band: int | str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    assert find_product(tmp_path) is None
    with pytest.raises(InputError, match=said) as caught:
        resolve(tmp_path, "b10.tif", Settings(ref_band=band))
    assert "number" not in str(caught.value)
    if name.casefold().endswith((".tif", ".jp2")):  # a quality report takes the rasters of a folder
        assert expand(tmp_path, [1]) == [RequestedBand(str(tmp_path / name), 1, None)]
        return
    with pytest.raises(InputError, match=said):
        expand(tmp_path, None, None)


def test_another_collection_is_named(tmp_path: Path) -> None:
    (tmp_path / "LC08_L1TP_198030_20180809_20280918_03_T1_B4.TIF").touch()
    with pytest.raises(InputError, match=r"another collection \(LC08_L1TP_198030_20180809_20280918_03_T1\)"):
        resolve(tmp_path, "b10.tif", Settings(ref_band="B4"))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("LC81980302020222LGN00_B4.TIF", "the file of one band of a product"),
        ("LT05_L1TP_198030_19990810_20200907_02_T1_B4.TIF", "the file of one band of a product"),
        ("T32TQM_20230809T100559_B04.jp2", "the file of one band of a product"),
        ("stack.tif", "give the number of a band, from 1"),
    ],
)
def test_a_band_by_name_of_a_file(name: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    with pytest.raises(InputError, match=said):
        resolve("b4.tif", tmp_path / name, Settings(tgt_band="B10"))


def test_what_may_be_a_raster_is_left_to_those_that_open_it() -> None:
    assert no_product("stack.tif") is None
    assert no_product("/vsicurl/https://x/y.tif") is None


@pytest.mark.parametrize("named", ["", "manifest.safe"])
def test_sentinel_1_in_the_layout_of_a_public_bucket(named: str, tmp_path: Path) -> None:
    (tmp_path / "scene" / "measurement").mkdir(parents=True)
    for band in ("hh", "hv"):
        (tmp_path / "scene" / "measurement" / f"ew-{band}.tiff").touch()
    listed = (
        f'<fileLocation href="./measurement/s1a-ew-grd-{band}-2022-046117-001.tiff"/>'
        for band in ("hh", "hv")
    )
    (tmp_path / "scene" / "manifest.safe").write_text(f"<x>{''.join(listed)}</x>")
    product = find_product(tmp_path / "scene" / named)
    assert product is not None
    assert product.kind == "Sentinel-1 GRD"
    assert [band.name for band in product.bands] == ["HV", "HH"]
    assert Path(product.band("HH").uri).name == "ew-hh.tiff"
    assert product.missing == ()
    (tmp_path / "scene" / "measurement" / "ew-hv.tiff").unlink()
    rest = find_product(tmp_path / "scene" / named)
    assert rest is not None
    assert rest.missing == ("HV",)
