"""Several bands as one image: its weights, its pixels, and the displacements that are measured with it."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

import pcwlad_geo
from pcwlad_geo.cli import edit
from pcwlad_geo.cli.app import run as main
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.job import match_files
from pcwlad_geo.multi.stack.inputs import StackInput, listed
from pcwlad_geo.option_text import to_setting
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import band_reading
from pcwlad_geo.raster import view as view_module
from pcwlad_geo.raster.bands import BandPart, Bands
from pcwlad_geo.raster.combined_bands import with_bands
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.view import View
from tests.product_files import SHIFT_M, write_landsat
from tests.scenes import make_grid, render, write

SMALL = {"template": 61, "window": 61, "features": 200}
MOVED_PX = (1.3, -0.7)
GRID = make_grid((300, 300))
Array = NDArray[np.float64]


def noisy(seed: int, noise: float, **how: object) -> Array:
    image = render(GRID, noise=0, **how)  # type: ignore[arg-type]
    return np.asarray(image + noise * np.random.default_rng(seed).standard_normal(image.shape))


def chosen(path: Path, choice: int | str) -> view_module.RasterInfo:
    bands = Bands.of_file(str(path), choice)
    assert bands is not None
    return with_bands(describe(path, band=bands.first), bands)


def values_of(info: view_module.RasterInfo) -> view_module.Patch:
    return View(info, info.grid, "none").read(Window.whole(info.grid.shape))


def errors_px(reference: Path, target: Path, folder: Path, **options: object) -> Array:
    found = match_files(reference, target, out_dir=folder, **SMALL, **options)  # type: ignore[arg-type]
    return np.asarray(found.tie_points.select("matched").displacement_px - MOVED_PX)


def test_no_band_dominates_the_mean(tmp_path: Path) -> None:
    """One band has a hundred times the contrast of another, and one nothing: it counts nothing."""
    red, thermal = render(GRID, "red"), render(GRID, "thermal")
    bands = np.stack([red, 100 * thermal + 7, np.full_like(red, 9), red])
    path = write(tmp_path / "a.tif", bands, GRID, dtype="float32")
    several = chosen(path, "1,2,3").several
    assert several is not None
    weights = np.array([part.weight for part in several.parts])
    assert weights @ weights == pytest.approx(1)
    assert weights[0] / weights[1] == pytest.approx(100, rel=0.2)
    assert weights[2] == 0
    found = values_of(chosen(path, "1,2,3"))
    assert np.allclose(found.values, np.tensordot(weights, bands[:3].astype("float32"), 1), rtol=1e-6)
    scaled = [np.corrcoef(found.values.ravel(), each.ravel())[0, 1] for each in (red, thermal)]
    assert scaled[0] == pytest.approx(scaled[1], abs=0.1)
    assert several.text == "mean of bands 1 to 3"
    assert chosen(path, "4").several is None


def test_a_pixel_counts_where_all_bands_do(tmp_path: Path) -> None:
    bands = np.stack([render(GRID, "red")] * 3).astype("uint16") + 10
    bands[0, 10:20, 5:9] = 0
    bands[2, 50:60, 70:90] = 0
    bands[1, 100, 100] = 0  # of a band that is not chosen
    path = write(tmp_path / "a.tif", bands, GRID, nodata=0)
    valid = values_of(chosen(path, "1,3")).valid
    assert np.array_equal(valid, (bands[0] > 0) & (bands[2] > 0))
    assert valid[100, 100]


def test_the_component_has_what_bands_share_and_leaves_out_those_that_tell_nothing(tmp_path: Path) -> None:
    """Inverted bands count with the other sign; constant and dead bands would spoil or hide everything."""
    scene = render(GRID, "red", noise=0)
    rng = np.random.default_rng(5)
    bands = np.stack(
        [
            sign * gain * scene + offset + gain * 20 * rng.standard_normal(scene.shape)
            for sign, gain, offset in ((1, 3, 0), (-1, 9, 5000), (1, 1, 300), (-1, 2, 900))
        ]
        + [np.full_like(scene, 77), np.zeros_like(scene)]
    )
    path = write(tmp_path / "a.tif", bands, GRID, dtype="float32", nodata=0)
    info = chosen(path, "pca")
    assert info.several is not None
    assert [part.band for part in info.several.parts] == [1, 2, 3, 4]
    signs = [np.sign(part.weight) for part in info.several.parts]
    assert signs in ([1, -1, 1, -1], [-1, 1, -1, 1])
    largest = max(info.several.parts, key=lambda part: abs(part.weight))
    assert largest.weight > 0
    found = values_of(info)
    alone = max(abs(np.corrcoef(scene.ravel(), band.ravel())[0, 1]) for band in bands[:4])
    assert abs(np.corrcoef(scene.ravel(), found.values.ravel())[0, 1]) > alone + 0.02
    assert found.valid.all()
    assert info.several.text == "first principal component of bands 1 to 4"


@pytest.mark.parametrize("choice", ["3,1,2", "pca"])
def test_windows_and_parts_agree_to_the_bit(
    choice: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bands = np.stack([render(GRID, band) for band in ("red", "thermal", "red")])
    path = write(
        tmp_path / "a.tif", bands, GRID, interleave="pixel", tiled=True, blockxsize=64, blockysize=64
    )
    info = chosen(path, choice)
    assert chosen(path, choice) == info
    for view in (View(info, info.grid, "none"), View(info, info.grid.scaled((75, 75)), "average")):
        whole = view.read(Window.whole(view.grid.shape))
        for window in (Window(7, 11, 50, 31), Window(40, 0, 35, 75)):
            part, here = view.read(window), window.slices_in(Window.whole(view.grid.shape))
            assert np.array_equal(part.values, whole.values[here])
            assert np.array_equal(part.valid, whole.valid[here])
        with monkeypatch.context() as patched:
            few = partial(band_reading.read_layers, max_values=10_000)  # eleven rows of the file at a time
            patched.setattr(band_reading, "read_layers", few)
            assert np.array_equal(view.read(Window.whole(view.grid.shape)).values, whole.values)


def test_types_differ_within_a_file(tmp_path: Path) -> None:
    bands = np.stack([render(GRID, "red"), render(GRID, "thermal")])
    one = write(tmp_path / "one.tif", bands[0], GRID, dtype="uint8")
    other = write(tmp_path / "other.tif", bands[1], GRID, dtype="float32")
    parts = (BandPart(str(one), 1), BandPart(str(other), 1))
    info = with_bands(describe(one), Bands(parts))
    assert info.dtype == "float32"
    assert info.several is not None
    assert info.several.text == "mean of one.tif, other.tif"
    weights = [part.weight for part in info.several.parts]
    expected = weights[0] * np.clip(np.rint(bands[0]), 1, 255) + weights[1] * bands[1].astype("float32")
    assert np.allclose(values_of(info).values, expected, rtol=1e-6)


def test_ranges_and_components_of_some_bands(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.stack([render(GRID, "red", seed=seed) for seed in range(6)]), GRID)
    for choice, numbers, text in (
        ("2-4", [2, 3, 4], "mean of bands 2 to 4"),
        ("4-2,6", [2, 3, 4, 6], "mean of bands 2, 3, 4, 6"),
        ("pca:1,3-4", [1, 3, 4], "first principal component of bands 1, 3, 4"),
    ):
        assert to_setting("ref_band", choice) == choice
        several = chosen(path, choice).several
        assert several is not None
        assert ([part.band for part in several.parts], several.text) == (numbers, text)
    assert to_setting("ref_band", " 3 ") == 3
    for wrong in ("1-", "-2", "1-2-3", "1,,2", "pca:", "mean:1,2", "1;2", "B2-B4"):
        with pytest.raises(SettingsError, match="ref_band"):
            Settings.from_options({"ref_band": to_setting("ref_band", wrong)})
    with pytest.raises(InputError, match="holds 6 bands, and band 7 was asked for"):
        chosen(path, "2-99999")


def test_bands_of_other_pixels_or_that_are_missing_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.stack([render(GRID)] * 2), GRID)
    with pytest.raises(InputError, match="holds 2 bands, and band 7 was asked for"):
        chosen(path, "1,7")
    coarse = make_grid((150, 150), pixel_m=60)
    other = write(tmp_path / "b.tif", render(coarse), coarse)
    with pytest.raises(InputError, match=r"b\.tif has other pixels than .*a\.tif"):
        with_bands(describe(path), Bands((BandPart(str(path), 1), BandPart(str(other), 1))))
    with pytest.raises(InputError, match="it is no product"):
        match_files(path, path, out_dir=tmp_path / "out", ref_band="B2,B3")


def test_the_mean_is_more_precise_than_a_band_and_the_component_where_contrasts_are_opposed(
    tmp_path: Path,
) -> None:
    """Each band has noise of its own, as strong as the structure; the target is clean."""
    target = write(tmp_path / "t.tif", render(GRID, displacement_px=MOVED_PX), GRID)
    bands = np.stack([noisy(seed, 60.0) for seed in range(4)])
    plain = write(tmp_path / "plain.tif", bands + 400, GRID, dtype="float32")
    opposed = write(tmp_path / "opposed.tif", bands * [[[1]], [[-1]], [[5]], [[-2]]], GRID, dtype="float32")
    of = {
        name: errors_px(path, target, tmp_path / name, ref_band=band)
        for name, path, band in (("one", plain, 1), ("mean", plain, "1,2,3,4"), ("pca", opposed, "pca"))
    }
    rmse = {name: float(np.sqrt((errors**2).mean())) for name, errors in of.items()}
    for name in ("mean", "pca"):
        assert len(of[name]) > len(of["one"])
        assert rmse[name] < 0.6 * rmse["one"]
        assert np.abs(np.median(of[name], axis=0)).max() < 0.05


def test_the_job_tells_the_bands_and_writes_all_of_them(tmp_path: Path) -> None:
    """The same from the command line, from a file of options, and with other processes."""
    reference = write(tmp_path / "r.tif", render(GRID), GRID)
    moved = [render(GRID, band, displacement_px=MOVED_PX) for band in ("red", "red", "thermal")]
    target = write(tmp_path / "t.tif", np.stack(moved), GRID)
    small = [item for name, value in SMALL.items() for item in (f"--{name}", str(value))]
    config = tmp_path / "options.toml"
    config.write_text('tgt-band = "1, 2"\ntile-size = 128\n')
    tiles = tmp_path / "tiles.toml"
    tiles.write_text("tile-size = 128\n")
    ways = {
        "shell": ["--tgt-band", "1,2", "--config", str(tiles), "--jobs", "1"],
        "file": ["--config", str(config), "--jobs", "2"],
    }
    for name, more in ways.items():
        assert main(["register", str(reference), str(target), "-o", str(tmp_path / name), *small, *more]) == 0
    tables = [(tmp_path / name / "tiepoints.csv").read_bytes() for name in ways]
    assert tables[0] == tables[1]
    columns, values = (",".join(map(str, each)) for each in zip(*SMALL.items(), strict=True))
    (tmp_path / "pairs.csv").write_text(f'reference,target,tgt_band,{columns}\nr.tif,t.tif,"1,2",{values}\n')
    assert main(["batch", str(tmp_path / "pairs.csv"), "-o", str(tmp_path / "batch")]) == 0
    of_batch = json.loads(next((tmp_path / "batch").rglob("report.json")).read_text())
    report = json.loads((tmp_path / "shell" / "report.json").read_text())
    assert report["settings"]["tgt_band"] == of_batch["settings"]["tgt_band"] == "1,2"
    assert report["target"]["weights"] == of_batch["target"]["weights"]
    assert report["target"]["matched"] == "mean of bands 1, 2"
    assert [(each["path"], each["band"]) for each in report["target"]["weights"]] == [
        (str(target), 1),
        (str(target), 2),
    ]
    assert (report["reference"]["matched"], report["reference"]["weights"]) == ("band 1", [])
    assert "mean of bands 1, 2" in (tmp_path / "shell" / "report.html").read_text()
    with rasterio.open(tmp_path / "shell" / "t_registered.tif") as written:
        assert written.count == 3


def test_bands_of_products_by_name(tmp_path: Path) -> None:
    """The files of a product are read together, all of its bands are corrected, and a change is seen."""
    reference = write_landsat(tmp_path / "ref")
    target = write_landsat(tmp_path / "tgt", shift_m=SHIFT_M)
    found = pcwlad_geo.register(
        reference, target, ref_band="B4,B10", tgt_band="B4,B10", out_dir=tmp_path / "out", **SMALL
    )
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["settings"]["tgt_band"] == "B4,B10"
    assert report["target"]["matched"].startswith("mean of LC08")
    moved = found.tie_points.select("fit", "check").displacement_px.mean(axis=0)
    assert moved == pytest.approx(np.array(SHIFT_M) / 30, abs=0.1)
    assert {path.name for path in (tmp_path / "out").glob("*_registered.tif")} >= {
        path.name.replace(".TIF", "_registered.tif") for path in target.glob("*_B*.TIF")
    }
    editor, _ = edit._open(tmp_path / "out")  # on the files that the report names
    assert len(editor.table) == len(found.tie_points)
    with pytest.raises(InputError, match="band pca of"):
        match_files(reference, target, ref_band="pca", tgt_band="B4", out_dir=tmp_path / "no")


def test_stacks_and_items_take_several_bands(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.stack([render(GRID)] * 3), GRID)
    assert [each.band for each in listed([path], "2,3")] == ["2,3"]
    assert StackInput(str(path), "2,3").describe().band == 2
    table = tmp_path / "list.csv"
    table.write_text('image,band\na.tif,"1,3"\na.tif,pca\n')
    assert [each.band for each in listed([table], 1)] == ["1,3", "pca"]
    item = {
        "id": "x",
        "properties": {"datetime": "2024-05-01T00:00:00Z"},
        "assets": {"image": {"href": "a.tif", "type": "image/tiff", "roles": ["data"]}},
    }
    (tmp_path / "x.json").write_text(json.dumps(item))
    assert [each.band for each in listed([tmp_path / "x.json"], "pca")] == ["pca"]
