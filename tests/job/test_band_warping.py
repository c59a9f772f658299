"""A finished registration, applied from its folder alone."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from pcwlad_geo import InputError, OutputError, RegistrationRejectedError, RequirementError, warp
from pcwlad_geo.cli.app import run
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.events import Event
from tests.registrations import Make

SPLINE = SplineCorrection(
    "tps", SplineGrid((0.0, 0.0), 200.0, (3, 2)), np.random.default_rng(1).uniform(-3, 3, (5, 6, 2))
)


def with_pixels(source: str, path: str, factor: int) -> Path:
    """Write a raster with pixels that are a factor larger."""
    with rasterio.open(source) as file:
        values = file.read(1).reshape(400 // factor, factor, 600 // factor, factor).mean(axis=(1, 3))
        place = file.transform
        profile = file.profile | {
            "height": values.shape[0],
            "width": values.shape[1],
            "transform": Affine(place.a * factor, 0, place.c, 0, place.e * factor, place.f),
        }
    with rasterio.open(path, "w", **profile) as file:
        file.write(values.astype(profile["dtype"]), 1)
    return Path(path)


@pytest.mark.parametrize("correction", [None, SPLINE], ids=["shift", "tps"])
@pytest.mark.parametrize("grid", ["reference", "target"])
def test_the_target_itself_becomes_the_registered_raster_again(
    make: Make, correction: Correction | None, grid: str
) -> None:
    folder = make(correction=correction, grid=grid, resampling="bilinear")
    shutil.copy("b10.tif", "again.tif")
    for name in ("b4.tif", "b10.tif"):  # the folder alone is enough, wherever it is
        Path(name).unlink()
    folder = folder.rename("elsewhere")
    (path,) = warp(folder, ["again.tif"], out_dir="warped")
    assert path == Path("warped/again_registered.tif")
    with rasterio.open(path) as ours, rasterio.open(folder / "b10_registered.tif") as first:
        assert (ours.shape, ours.transform, ours.crs) == (first.shape, first.transform, first.crs)
        np.testing.assert_array_equal(ours.read(), first.read())


def test_a_band_of_larger_pixels_moves_by_the_same_ground(make: Make) -> None:
    folder = make()  # a shift of (1.25, -0.5) px of 30 m
    with_pixels("b10.tif", "b10_60m.tif", 2)
    (path,) = warp(folder, ["b10_60m.tif"], grid="target", resampling="bilinear")
    with rasterio.open("b10_60m.tif") as before, rasterio.open(path) as after:
        assert after.transform == before.transform
        values, moved = before.read(1).astype(float), after.read(1).astype(float)
    # Of 60 m pixels that is (0.625, -0.25) px, and bilinear resampling the mean of four with these weights.
    part = values[9:20, 10:22]
    expected = 0.25 * (0.375 * part[:-1, :-1] + 0.625 * part[:-1, 1:])
    expected += 0.75 * (0.375 * part[1:, :-1] + 0.625 * part[1:, 1:])
    np.testing.assert_allclose(moved[10:20, 10:21], expected, atol=1.0)


def test_on_the_references_lattice_larger_pixels_share_its_corners(make: Make) -> None:
    folder = make()
    with_pixels("b10.tif", "b10_60m.tif", 2)
    (path,) = warp(folder, ["b10_60m.tif"])
    with rasterio.open(path) as after, rasterio.open("b4.tif") as reference:
        assert (after.transform.a, after.transform.e) == (60.0, -60.0)
        offset = (after.transform.c - reference.transform.c, after.transform.f - reference.transform.f)
    assert [value % 60 for value in offset] == [0.0, 0.0]


def test_bands_of_two_pixel_sizes_stack(make: Make) -> None:
    """As of Landsat: the corner of the 15 m band lies 7.5 m inside of that of the others."""
    folder = make()
    with rasterio.open("b10.tif") as file:
        profile = file.profile | {"height": 799, "width": 1199}
        profile |= {"transform": Affine(15, 0, 500007.5, 0, -15, 4599992.5)}
    with rasterio.open("b8.tif", "w", **profile) as file:
        file.write(np.full((1, 799, 1199), 7, np.uint16))
    with_pixels("b10.tif", "b10_120m.tif", 4)
    corners = set()
    for rasters, out_dir in ((["b8.tif"], "one"), (["b8.tif", "b10.tif", "b10_120m.tif"], "all")):
        for path in warp(folder, rasters, out_dir=out_dir):
            with rasterio.open(path) as made:
                assert made.transform.a in (15.0, 30.0, 120.0)
                assert made.transform.e == -made.transform.a
                corners.add((out_dir, *made.bounds))
    with rasterio.open(folder / "b10_registered.tif") as first:
        corners.add(("one", *first.bounds))
    assert len(corners) == 2


def test_folders_without_a_correction_are_told(make: Make, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent"):
        warp("absent", ["b10.tif"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty.*no finished registration.*pcwlad-geo register"):
        warp("empty", ["b10.tif"])
    folder = make("matched")
    with pytest.raises(InputError, match="tie points only"):
        warp(folder, ["b10.tif"])
    shutil.rmtree(folder)
    with pytest.raises(RegistrationRejectedError):
        make("rejected")
    with pytest.raises(InputError, match="refused"):
        warp("done", ["b10.tif"])


def test_a_registration_against_its_requirements_is_applied_only_where_it_was_kept(make: Make) -> None:
    require = ["points>=100000", "points>=10"]
    with pytest.raises(RequirementError):
        make(require=require)
    with pytest.raises(InputError, match=r"points >= 100000: not met.*--keep, or without") as caught:
        warp("done", ["b10.tif"], out_dir="warped")
    assert "points >= 10:" not in str(caught.value)
    assert not Path("warped").exists()
    with pytest.raises(RequirementError):
        make(require=require, keep=True, overwrite=True)
    (path,) = warp("done", ["b10.tif"], out_dir="warped")
    assert path.is_file()
    make(require=["points>=10"], overwrite=True)
    assert warp("done", ["b10.tif"], out_dir="warped", overwrite=True) == (path,)


def changed_grid(side: str, **changes: object) -> Callable[[dict[str, Any]], object]:
    """Return the function that changes the grid of a raster in a report."""
    return lambda report: report | {side: report[side] | changes}


DAMAGES: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda report: {"report": 1}, "not written by pcwlad-geo"),
    (lambda report: report | {"schema_version": 99}, "schema version 99"),
    (lambda report: report | {"model": {"name": "magic"}}, "damaged .model.forward: "),
    (lambda report: report | {"model": {"name": "x", "forward": {"type": "magic"}}}, "no correction model"),
    (lambda report: report | {"settings": {"window": 3}}, "damaged .window = 3: give an odd number"),
    (lambda report: report | {"settings": {"dem": [5]}}, "damaged .settings.dem: Input should be a valid"),
    (lambda report: report | {"target": {}}, "damaged"),
    (lambda report: report | {"model": None}, "damaged .model: "),
    (changed_grid("target", transform=[1, 1, 0, 1, 1, 0]), "without an inverse"),
    (changed_grid("target", transform=[0] * 6), "without an inverse"),
    (changed_grid("reference", transform=[float("nan")] * 6), "no finite number"),
    (changed_grid("reference", transform=[1e300, 0, 0, 0, -1e300, 0]), "at most 1e\\+10 are read"),
    (changed_grid("reference", shape=[10**9, 10**9]), "declares 1000000000 x 1000000000 pixels"),
    (changed_grid("target", shape=[0, 5]), "5 x 0 pixels"),
]


def test_a_foreign_or_damaged_report_is_told(make: Make) -> None:
    path = make() / "report.json"
    report = json.loads(path.read_text(encoding="utf-8"))
    for text, said in (*((json.dumps(change(report)), said) for change, said in DAMAGES), ("{", "no JSON")):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=said):
            warp("done", ["b10.tif"], out_dir="warped")
        assert not Path("warped").exists()


def test_rasters_that_cannot_be_warped_are_told_before_anything_is_written(make: Make) -> None:
    folder = make()
    with rasterio.open("b10.tif") as file:
        values, profile = file.read(), file.profile | {"crs": "EPSG:32634"}
    with rasterio.open("other.tif", "w", **profile) as file:
        file.write(values)
    for rasters, said in (
        (["b10.tif", "other.tif"], "EPSG:32634"),
        (["b10.tif", "absent.tif"], "absent.tif does not exist"),
        (["b10.tif", "./b10.tif"], "two outputs would be written"),
        ([], "at least one"),
    ):
        with pytest.raises((InputError, OutputError), match=said):
            warp(folder, rasters, out_dir="warped")
    assert not Path("warped").exists()


def test_results_are_replaced_only_when_asked(make: Make) -> None:
    folder = make()
    warp(folder, ["b10.tif"])
    with pytest.raises(OutputError, match="--overwrite"):
        warp(folder, ["b10.tif"])
    warp(folder, ["b10.tif"], overwrite=True)
    shutil.copy("b10.tif", "b_registered.tif")
    Path("b.tif").symlink_to("b_registered.tif")
    with pytest.raises(OutputError, match="is an input too"):
        warp(folder, ["b.tif"], overwrite=True)


def test_a_run_that_ends_early_leaves_nothing(make: Make) -> None:
    folder = make()

    def stop(event: Event) -> None:
        if getattr(event, "stage", "") == "warping":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warp(folder, ["b10.tif"], out_dir="new/warped", on_event=stop)
    assert not Path("new").exists()


def test_one_raster_goes_where_it_is_wanted(make: Make, tmp_path: Path) -> None:
    done = make()
    (before,) = warp(done, ["b10.tif"])
    place = tmp_path / "elsewhere" / "here.tif"
    assert warp(done, ["b10.tif"], output_raster=place) == (place,)
    assert place.read_bytes() == before.read_bytes()
    assert [path.name for path in place.parent.iterdir()] == ["here.tif"]
    with pytest.raises(OutputError, match="exists"):
        warp(done, ["b10.tif"], output_raster=place)
    warp(done, ["b10.tif"], output_raster=place, overwrite=True)


def test_several_rasters_do_not_go_to_one_file(make: Make, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="names one file, and there are 2 rasters: give --out-dir"):
        warp(make(), ["b10.tif", "b4.tif"], output_raster=tmp_path / "here.tif")
    assert not (tmp_path / "here.tif").exists()


def test_a_raster_is_not_warped_onto_itself(make: Make) -> None:
    done = make()
    with pytest.raises(OutputError, match="is an input too"):
        warp(done, ["b10.tif"], output_raster="b10.tif", overwrite=True)


def test_the_command_takes_the_place_of_its_raster(
    make: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "out" / "here.tif"
    assert run(["warp", str(make()), "b10.tif", "--output-raster", str(place)]) == 0
    assert capsys.readouterr().out == f"{place}\n"
    assert [path.name for path in place.parent.iterdir()] == ["here.tif"]
