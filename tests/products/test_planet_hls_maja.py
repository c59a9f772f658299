"""Products of Planet, HLS and MAJA: as a folder, an archive and single files, with their masks.

All files are written by the tests from the published descriptions of the formats. See `delivered_files` for
what they cannot show.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.errors import InputError
from pcwlad_geo.job import match_files
from pcwlad_geo.multi.qa.bands import list_bands
from pcwlad_geo.multi.stack.inputs import listed
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product, native_px_m, no_product, of_one_product, stem_of
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import describe, file_name
from pcwlad_geo.registration import resolve
from tests.delivered_files import CLOUD, HLS, MAJA, PLANET, write_hls, write_maja, write_planet
from tests.product_files import packed

SMALL = {"template": 61, "window": 41, "features": 100}
Writer = Callable[..., Path]
EIGHT = ["coastal_blue", "blue", "green_i", "green", "yellow", "red", "rededge", "nir"]
ALL = [
    pytest.param(write_planet, EIGHT, "red", f"{PLANET}_3B_udm2_clip.tif", "UDM2", id="Planet"),
    pytest.param(write_hls, ["B04", "B09", "B10"], "B4", f"{HLS}.Fmask.tif", "Fmask", id="HLS"),
    pytest.param(write_maja, ["B4", "B8", "B8A"], "B04", f"{MAJA}_CLM_R1.tif", "CLM", id="MAJA"),
]


def product(path: Path) -> Product:
    found = find_product(path)
    assert found is not None
    return found


def names(found: Product) -> list[str]:
    return [band.name for band in found.bands]


@pytest.mark.parametrize(("write", "bands", "band", "mask", "kind"), ALL)
def test_a_folder_an_archive_and_the_metadata_are_one_product(
    write: Writer, bands: list[str], band: str, mask: str, kind: str, tmp_path: Path
) -> None:
    folder = write(tmp_path / "a b")
    metadata = next(folder.rglob("*metadata*.xml"), None) or next(folder.glob("*.xml"))
    for path in (folder, packed(folder, ".zip"), packed(folder, ".tar"), metadata):
        found = product(path)
        assert (names(found), found.missing) == (bands, ())
        assert found.mask is not None
        assert file_name(found.mask) == mask
        chosen = found.band(band)
        info = describe(chosen.opened_as(), band=chosen.number, mask=found.mask)
        assert info.mask_kind == kind
        assert info.nodata == {"Planet": 0, "HLS": -9999, "MAJA": -10000}[path_kind(found)]
    assert stem_of(folder) == folder.name


def path_kind(found: Product) -> str:
    return {"PlanetScope": "Planet"}.get(found.kind.split()[0], found.kind.split()[0])


@pytest.mark.parametrize(("write", "bands", "band", "mask", "kind"), ALL)
def test_a_single_image_brings_the_mask_beside_it(
    write: Writer, bands: list[str], band: str, mask: str, kind: str, tmp_path: Path
) -> None:
    """As of a raster, a number or no band chooses, and no other band is corrected."""
    whole = product(write(tmp_path))
    image = whole.band(band).uri
    inputs = resolve(image, image, Settings(), all_bands=True)
    assert file_name(str(inputs.settings.tgt_mask)) == mask
    assert inputs.tgt_bands.first == 1
    assert inputs.other_bands == ()
    named = resolve(image, image, Settings(ref_band=band, tgt_band=band))
    assert named.tgt_bands.first == whole.band(band).number
    with pytest.raises(InputError, match=r"has no band 99: it holds"):
        resolve(image, image, Settings(tgt_band=99))


@pytest.mark.parametrize(("write", "bands", "band", "mask", "kind"), ALL)
def test_it_registers_with_all_bands_and_without_the_clouds(
    write: Writer, bands: list[str], band: str, mask: str, kind: str, tmp_path: Path
) -> None:
    shift_px = (1.3, -0.8)
    reference, target = write(tmp_path / "ref"), write(tmp_path / "tgt", shift_px=shift_px)
    out = tmp_path / "out"
    found = pcwlad_geo.register(reference, target, ref_band=band, tgt_band=band, out_dir=out, **SMALL)
    assert found.status == "registered"
    assert found.target.mask_kind == kind
    points = found.tie_points.select("fit", "check", "unused")
    moved = np.median(points.target_px - points.reference_px, axis=0)
    assert moved == pytest.approx(shift_px, abs=0.1)
    rows, cols = CLOUD
    col, row = points.target_px.T
    assert not ((col > cols.start) & (col < cols.stop) & (row > rows.start) & (row < rows.stop)).any()
    made = sorted(path.name for path in out.glob("*_registered.tif"))
    files = {Path(file_name(held.uri)).stem for held in product(target).bands}
    assert made == sorted(f"{stem}_registered.tif" for stem in files)
    with rasterio.open(out / made[0]) as dataset:
        assert dataset.count == (8 if write is write_planet else 1)


def test_numbers_and_components_choose_bands_of_planets_file(tmp_path: Path) -> None:
    folder = write_planet(tmp_path)
    for choice, numbers in (("2,3,4", [2, 3, 4]), ("pca", [*range(1, 9)]), ("pca:red,nir", [6, 8]), (7, [7])):
        bands = resolve(folder, folder, Settings(ref_band=choice, tgt_band=choice)).tgt_bands
        assert [part.band for part in bands.parts] == numbers
        assert bands.principal == str(choice).startswith("pca")
    assert product(folder).band("B6").name == "red"


def test_of_several_images_reflectance_is_taken_and_a_named_one_kept(tmp_path: Path) -> None:
    folder = write_planet(tmp_path, image="AnalyticMS_SR_clip")
    write_planet(tmp_path, image="Visual_clip")
    write_planet(tmp_path, image="AnalyticMS_clip")
    found = product(folder)
    assert names(found) == ["blue", "green", "red", "nir"]
    assert Path(found.bands[0].uri).name == f"{PLANET}_3B_AnalyticMS_SR_clip.tif"
    visual = product(folder / "PSScene" / f"{PLANET}_3B_Visual_clip.tif")
    assert names(visual) == ["red", "green", "blue"]
    assert visual.bands[0].opened_as() == visual.bands[0].uri


@pytest.mark.parametrize(
    ("write", "removed", "band", "message"),
    [
        (write_planet, "_udm2_clip.tif", None, rf"no quality raster \({PLANET}_3B_udm2\.tif\)"),
        (write_hls, ".Fmask.tif", None, rf"no quality raster \({HLS}\.Fmask\.tif\)"),
        (write_maja, "_CLM_R1.tif", None, rf"no quality raster \(MASKS/{MAJA}_CLM_R1\.tif\)"),
        (write_hls, ".B10.tif", "B4", rf"lacks bands that its metadata list: {HLS}\.B10\.tif"),
        (write_maja, "_FRE_B8.tif", "B4", rf"lacks bands that its metadata list: {MAJA}_FRE_B8\.tif"),
        (write_maja, "_FRE_B4.tif", "B4", rf"band B04 of .* is missing: .* list {MAJA}_FRE_B4\.tif"),
        (write_hls, ".B10.tif", "B10", rf"band B10 of .* is missing: .* list {HLS}\.B10\.tif"),
    ],
)
def test_what_is_missing_is_named(
    write: Writer, removed: str, band: str | None, message: str, tmp_path: Path
) -> None:
    folder = write(tmp_path)
    next(path for path in folder.rglob("*") if path.name.endswith(removed)).unlink()
    if band is None:
        assert [note for note in product(folder).notes(masked=False) if re.search(message, note)]
        return
    with pytest.raises(InputError, match=message):
        resolve(folder, folder, Settings(ref_band="B04", tgt_band=band), all_bands=True)


@pytest.mark.parametrize("ending", ["", ".zip"])
@pytest.mark.parametrize(
    ("write", "kept", "message"),
    [
        (
            write_planet,
            "*.json",
            rf"parts of a scene of Planet without its image: add {PLANET}_3B_AnalyticMS",
        ),
        (write_hls, "*.xml", rf"parts of the HLS granule {HLS} without a band"),
        (write_maja, "*.xml", rf"holds no band of {MAJA}: add {MAJA}_FRE_B4\.tif"),
    ],
)
def test_parts_without_an_image_say_which_file_to_add(
    write: Writer, kept: str, message: str, ending: str, tmp_path: Path
) -> None:
    whole = write(tmp_path / "whole")
    folder = tmp_path / "part"
    folder.mkdir()
    for path in whole.rglob(kept):
        (folder / path.name).write_bytes(path.read_bytes())
    given = packed(folder, ending) if ending else folder
    with pytest.raises(InputError, match=message):
        resolve(given, given, Settings())


def test_folders_of_several_scenes_are_stacks(tmp_path: Path) -> None:
    """Each image has its own mask. Masks, angles and other bands of the granules are no images."""
    for day in ("20230615", "20230616"):
        write_planet(tmp_path / "planet", scene=f"{day}_153012_45_2486")
    folder = tmp_path / "planet/PSScene"
    assert find_product(folder) is None
    assert "2 scenes of Planet" in str(no_product(str(folder)))
    assert "2 scenes of Planet" in str(no_product(str(tmp_path / "planet")))  # the order as delivered
    images = list(listed([folder], 1))
    assert [(image.name, image.date) for image in images] == [
        (f"{day}_153012_45_2486_3B_AnalyticMS_SR_8b_clip", f"2023-06-{day[-2:]}")
        for day in ("20230615", "20230616")
    ]
    assert all(image.describe().mask_kind == "UDM2" for image in images)
    flat = tmp_path / "hls"
    flat.mkdir()
    for scene in (HLS, HLS.replace("2020222", "2020230")):
        for path in write_hls(tmp_path, scene=scene).iterdir():
            path.rename(flat / path.name)
    images = list(listed([flat], "B04"))
    assert [image.name[-3:] for image in images] == ["B04", "B04"]
    assert [image.date for image in images] == ["2020-08-09", "2020-08-17"]  # days 222 and 230 of a leap year
    assert all(image.describe().mask_kind == "Fmask" for image in images)


def test_quality_reports_take_all_bands_that_show_the_ground(tmp_path: Path) -> None:
    assert [band.name for band in list_bands([write_hls(tmp_path)])] == ["B04", "B10"]  # B09 shows cirrus
    assert [
        band.native_m
        for band in list_bands(
            [
                tmp_path / HLS,
            ]
        )
    ][1] == (100.0, 100.0)
    assert [band.name for band in list_bands([write_maja(tmp_path)])] == ["B4", "B8", "B8A"]
    planet = list_bands([write_planet(tmp_path / "p")])
    assert [(band.name, band.info.band) for band in planet] == [*zip(EIGHT, range(1, 9), strict=True)]


def test_names_tell_the_scene_and_the_recorded_pixels() -> None:
    assert of_one_product(f"a/{HLS}.B04.tif", f"a/{HLS}.B10.tif")
    assert not of_one_product(f"{HLS}.B04.tif", f"{HLS.replace('2020222', '2020230')}.B04.tif")
    assert of_one_product(f"{MAJA}_FRE_B4.tif", f"{MAJA}_FRE_B8A.tif")
    assert native_px_m(f"{HLS.replace('L30', 'S30')}.B01", None) == 60.0
    assert native_px_m(f"{HLS}.B04", None) is None
    assert native_px_m(f"{MAJA}_FRE_B8A", None) == 20.0


def test_zero_of_a_mask_of_flags_is_ground_though_declared_as_nodata(tmp_path: Path) -> None:
    folder = write_planet(tmp_path)
    found = product(folder)
    with rasterio.open(str(found.mask), "r+") as mask:
        mask.nodata = 0
    found_again = match_files(
        folder, folder, ref_band="red", tgt_band="nir", out_dir=tmp_path / "out", **SMALL
    )
    assert len(found_again.tie_points) > 30
