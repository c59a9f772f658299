"""The output grid and format that are asked for: through the job, from its folder, and refused in time."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import rasterio
from affine import Affine

import pcwlad_geo
from pcwlad_geo import InputError, OutputError, warp
from pcwlad_geo import job as workflow
from pcwlad_geo.cli.app import run as main
from pcwlad_geo.correction.models import ProjectiveCorrection
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.multi.batch.table import read_pairs
from pcwlad_geo.option_text import to_setting
from pcwlad_geo.raster import Grid, map_px
from pcwlad_geo.registration import Inputs, Registration
from tests.registrations import make_registration, of_files, write_pair
from tests.scenes import CRS_OF_SCENE, ORIGIN_XY_M, make_grid, render, write

Make = Callable[..., Path]
SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "report.schema.json"
LIKE = {"crs": "EPSG:3035", "transform": Affine(25, 0, 4_680_000, 0, -25, 2_080_000), "shape": (300, 310)}


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Write the output folder of a registration made by hand: a shift of (1.25, -0.5) px of 30 m."""
    monkeypatch.chdir(tmp_path)
    write_pair(tmp_path)
    calls: list[object] = []

    def make_it(**options: object) -> Path:
        def finish(inputs: Inputs, **_: object) -> Registration:
            calls.append(inputs.settings)
            made = of_files(make_registration(), Path(inputs.reference), Path(inputs.target))
            return replace(made, settings=inputs.settings)

        monkeypatch.setattr("pcwlad_geo.registration.register_inputs", finish)
        workflow.register("b4.tif", "b10.tif", out_dir="done", **options)  # type: ignore[arg-type]
        return Path("done")

    make_it.calls = calls  # type: ignore[attr-defined]
    return make_it


def write_like(path: str = "like.tif", **changes: object) -> Path:
    wanted: dict[str, Any] = LIKE | changes
    rows, cols = wanted["shape"]
    profile = {"driver": "GTiff", "count": 1, "dtype": "uint8", "height": rows, "width": cols}
    with rasterio.open(path, "w", crs=wanted["crs"], transform=wanted["transform"], **profile) as file:
        file.write(np.ones((1, rows, cols), np.uint8))
    return Path(path)


def grid_of(path: Path | str) -> Grid:
    with rasterio.open(path) as file:
        return Grid(file.shape, file.transform, file.crs)


def centre_like() -> Path:
    """Write a raster in another CRS that lies about the middle of the target."""
    middle = map_px(np.array([[300.0, 200.0]]), grid_of("b4.tif"), Grid((1, 1), Affine.identity(),
                    rasterio.crs.CRS.from_epsg(3035)))[0]  # fmt: skip
    return write_like(transform=Affine(25, 0, round(middle[0]) - 4000, 0, -25, round(middle[1]) + 4000))


def test_like_gives_exactly_that_grid_to_all_and_is_remembered(make: Make) -> None:
    like = centre_like()
    wanted = grid_of(like)
    folder = make(like=like)
    assert grid_of(folder / "b10_registered.tif") == wanted
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    jsonschema.validate(report, json.loads(SCHEMA.read_text(encoding="utf-8")))
    assert report["output_grid"] == {
        "shape": list(wanted.shape), "transform": list(wanted.transform)[:6],
        "crs": "EPSG:3035", "swath": None,
    }  # fmt: skip
    like.unlink()
    (again,) = warp(folder, ["b10.tif"])
    with rasterio.open(again) as ours, rasterio.open(folder / "b10_registered.tif") as first:
        assert (ours.transform, ours.crs, ours.shape) == (first.transform, first.crs, first.shape)
        np.testing.assert_array_equal(ours.read(), first.read())
    (own,) = warp(folder, ["b10.tif"], grid="reference", out_dir="own")
    assert grid_of(own).transform.a == 30.0


def test_reference_exact(make: Make) -> None:
    folder = make(grid="reference-exact")
    assert grid_of(folder / "b10_registered.tif") == grid_of("b4.tif")
    (path,) = warp(folder, ["b10.tif"])
    assert grid_of(path) == grid_of("b4.tif")


def test_extent_and_pixel_size_are_those_of_gdalwarp(make: Make) -> None:
    folder = make(tr=(20.0, 25.0), te=(500_100.0, 4_590_000.0, 503_110.0, 4_592_010.0))
    grid = grid_of(folder / "b10_registered.tif")
    assert grid.transform == Affine(20, 0, 500_100, 0, -25, 4_592_010)
    assert grid.shape == (80, 151)  # 80.4 and 150.5 pixels
    (path,) = warp(folder, ["b10.tif"])
    assert grid_of(path) == grid
    (path,) = warp(folder, ["b10.tif"], tr=(50.0, 50.0), t_srs="EPSG:32633", overwrite=True)
    assert grid_of(path).transform.a == 50.0


def test_formats_run_through_register_and_warp(make: Make) -> None:
    folder = make(of="ENVI", co=("INTERLEAVE=BIL",))
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    names = {path.name for path in folder.iterdir()}
    assert {"b10_registered.dat", "b10_registered.hdr"} <= names
    assert "b10_registered.tif" not in names
    assert set(report["outputs"]) | {"report.json"} == names
    (path,) = warp(folder, ["b10.tif"])
    assert path == Path("b10_registered.dat")
    with rasterio.open(path) as ours, rasterio.open(folder / path.name) as first:
        assert (ours.driver, ours.crs) == ("ENVI", first.crs)
        np.testing.assert_array_equal(ours.read(), first.read())
    place = Path("elsewhere") / "x.bin"
    warp(folder, ["b10.tif"], output_raster=place)
    assert grid_of(place) == grid_of(path)  # its header went with it
    make(of="ENVI", overwrite=True)
    make(overwrite=True)  # no header of the earlier run stays behind
    assert not list(folder.glob("*.hdr"))
    (path,) = warp(folder, ["b10.tif"], of="GTiff", co=["COMPRESS=PACKBITS"])
    with rasterio.open(path) as file:
        assert file.profile["compress"] == "packbits"


def test_a_vrt_of_a_finished_registration(make: Make) -> None:
    folder = make(of="VRT", model="shift")
    (path,) = warp(folder, ["b10.tif"], of="COG")
    with rasterio.open(folder / "b10_registered.vrt") as text, rasterio.open(path) as pixels:
        np.testing.assert_array_equal(text.read(), pixels.read())
    report = folder / "report.json"
    content = json.loads(report.read_text(encoding="utf-8"))
    content["model"] = ProjectiveCorrection("projective", np.eye(3)).to_dict()
    report.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(SettingsError, match="a VRT cannot hold the projective correction"):
        warp(folder, ["b10.tif"], of="VRT", out_dir="other")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"like": "like.tif", "tr": (30.0, 30.0)}, "tr and like contradict"),
        ({"like": "like.tif", "grid": "reference-exact"}, "two whole grids"),
        (
            {"grid": "reference-exact", "te": (0.0, 0.0, 1.0, 1.0)},
            "te and grid = 'reference-exact' contradict",
        ),
        ({"grid": "target", "t_srs": "EPSG:3035"}, "t_srs and grid = 'target'"),
        ({"tr": (30.0, 0.0)}, "give two positive numbers"),
        ({"tr": (30.0,)}, "give two positive numbers"),
        ({"te": (5.0, 0.0, 1.0, 1.0)}, "the smaller ones first"),
        ({"te": (0.0, 0.0, float("nan"), 1.0)}, "x_min y_min x_max y_max"),
        ({"co": ("COMPRESS",)}, "KEY=VALUE"),
        ({"of": "VRT", "model": "tps"}, "a VRT cannot hold the model tps"),
        ({"of": "VRT", "co": ("A=B",)}, "takes no creation options"),
        ({"t_srs": "EPSG:1"}, r"t_srs = 'EPSG:1': give a CRS"),
        ({"t_srs": "[" * 100_000}, "give a CRS such as"),
        ({"of": "GTif"}, r"of = 'GTif': GDAL cannot write"),
        ({"co": ("COMPRESS=X",)}, "co = COMPRESS=X: GDAL's COG says"),
        ({"like": "absent.tif"}, "absent.tif does not exist"),
        ({"te": (600_000.0, 4_700_000.0, 601_000.0, 4_701_000.0)}, "shows nothing of the target"),
        ({"t_srs": "EPSG:3035", "te": (0.0, 0.0, 1000.0, 1000.0)}, r"shows nothing.*in EPSG:3035"),
    ],
)
def test_what_cannot_be_had_is_told_before_the_matching(
    make: Make, options: dict[str, Any], said: str
) -> None:
    write_like()
    with pytest.raises(InputError, match=said):
        make(**options)
    assert make.calls == []  # type: ignore[attr-defined]
    assert not Path("done").exists()


def test_a_grid_beside_the_corrected_target_is_refused_after_the_matching(make: Make) -> None:
    """Near enough that the target might have turned out to lie there."""
    with pytest.raises(InputError, match=r"shows nothing of the target.*change --te"):
        make(te=(518_100.0, 4_590_000.0, 519_000.0, 4_591_000.0))
    assert len(make.calls) == 1  # type: ignore[attr-defined]
    assert not Path("done").exists()


def test_rasters_without_georeferencing_have_no_such_grid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_pair(tmp_path, georeferenced=False)
    with pytest.raises(
        InputError, match=r"b4.tif has no georeferencing .* which --like, --tr, --te and --t-srs"
    ):
        workflow.register("b4.tif", "b10.tif", out_dir="done", tr=(30.0, 30.0))


def test_warp_checks_before_it_writes(make: Make) -> None:
    folder = make()
    for options, said in (
        ({"of": "NONE"}, "of = 'NONE'"),
        ({"like": "b4.tif", "tr": (3.0, 3.0)}, "contradict"),
        ({"te": (0.0, 0.0, 100.0, 100.0)}, "shows nothing of the target"),
        ({"co": ["WRONG=1"]}, "does not support creation option WRONG"),
    ):
        with pytest.raises((InputError, OutputError), match=said):
            warp(folder, ["b10.tif"], out_dir="warped", **options)  # type: ignore[arg-type]
    assert not Path("warped").exists()


def test_the_command_lines_take_them(make: Make, capsys: pytest.CaptureFixture[str]) -> None:
    folder = make()
    te = ["--te", "500100", "4590000", "503110", "4592010"]
    arguments = ["warp", str(folder), "b10.tif", *te, "--tr", "20", "25", "--of", "GTiff"]
    assert main([*arguments, "--co", "COMPRESS=LZW", "--co", "TILED=NO", "--progress", "none"]) == 0
    assert grid_of("b10_registered.tif").transform == Affine(20, 0, 500_100, 0, -25, 4_592_010)
    assert main(["register", "b4.tif", "b10.tif", "--like", "b4.tif", *te, "--progress", "none"]) == 2
    assert "te and like contradict each other" in capsys.readouterr().err


def test_values_as_text_are_those_of_a_table_and_of_a_config_file(tmp_path: Path) -> None:
    assert to_setting("tr", "30 20.5") == (30.0, 20.5)
    assert to_setting("tr", [30, 20.5]) == (30.0, 20.5)
    assert to_setting("te", "-10 0 10 20") == (-10.0, 0.0, 10.0, 20.0)
    assert to_setting("co", "COMPRESS=LZW TILED=NO") == ("COMPRESS=LZW", "TILED=NO")
    assert to_setting("co", ["COMPRESS=LZW"]) == ("COMPRESS=LZW",)
    with pytest.raises(SettingsError, match="tr = 'wide': give numbers"):
        to_setting("tr", "wide tall")
    (tmp_path / "pairs.csv").write_text(
        "reference,target,like,tr,co\na.tif,b.tif,grids/g.tif,,COMPRESS=LZW\na.tif,b.tif,,30 30,\n"
    )
    first, second = read_pairs(tmp_path / "pairs.csv", tmp_path, {"of": "GTiff"})
    assert first.settings.like == tmp_path / "grids/g.tif"
    assert (first.settings.of, first.settings.co) == ("GTiff", ("COMPRESS=LZW",))
    assert second.settings.tr == (30.0, 30.0)


def test_a_registered_raster_on_a_grid_that_is_asked_for_fits_the_truth(tmp_path: Path) -> None:
    """Matched, corrected and warped onto another grid in one resampling: all lies where it should."""
    reference, shift_px = make_grid((200, 200)), (3.3, -2.6)
    write(tmp_path / "ref.tif", render(reference), reference)
    write(tmp_path / "tgt.tif", render(reference, displacement_px=shift_px), reference)
    like = Grid(
        (130, 140),
        Affine(27.0, 0.0, ORIGIN_XY_M[0] + 1003.5, 0.0, -27.0, ORIGIN_XY_M[1] - 998.0),
        CRS_OF_SCENE,
    )
    write(tmp_path / "like.tif", np.ones(like.shape), like)
    pcwlad_geo.register(
        tmp_path / "ref.tif", tmp_path / "tgt.tif", out_dir=tmp_path / "out", like=tmp_path / "like.tif",
        template=61, window=41, features=60,
    )  # fmt: skip
    with rasterio.open(tmp_path / "out" / "tgt_registered.tif") as file:
        assert (file.shape, file.transform, file.crs) == (like.shape, like.transform, like.crs)
        seen = file.read(1).astype(float)[8:-8, 8:-8] / 200
    truth = render(like, noise=0.0)
    along = np.stack([part[8:-8, 8:-8].ravel() for part in np.gradient(truth)[::-1]], axis=1)
    off_px = np.linalg.lstsq(along, (truth[8:-8, 8:-8] - seen).ravel(), rcond=None)[0]
    assert np.abs(off_px).max() < 0.05
