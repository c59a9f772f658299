"""The two jobs on small synthetic captures: what is applied lies where it should, bad captures are named."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

import pcwlad_geo as pg
from pcwlad_geo.errors import InputError, OutputError, RegistrationRejectedError
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs import applying_run
from pcwlad_geo.rigs.applying_run import RigApplied
from pcwlad_geo.rigs.parameters import CAPTURE
from tests.rigs import rigs
from tests.scenes import write as write_raster

RIG = rigs.lenses()
GOOD = {"GOOD_1": 40.0, "GOOD_2": 30.0, "GOOD_3": 58.0}


def written(path: Path, values: np.ndarray, **tags: str) -> None:
    rows, cols = values.shape
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(
            path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype=values.dtype.name
        ) as out,
    ):
        out.write(values, 1)
        out.update_tags(**tags)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of three good captures, and bad ones of each kind."""
    folder = tmp_path_factory.mktemp("frames")
    for number, (name, height) in enumerate(GOOD.items()):
        rigs.write(folder, name, RIG, rigs.flown(height), seed=number)
    rigs.write(folder, "BAD_blur", RIG, rigs.flown(40.0, motion_px=9.0))
    rigs.write(folder, "BAD_cover", RIG, rigs.flown(40.0, covered=RIG[1].name))
    rigs.write(folder, "BAD_panel", RIG, rigs.flown(1.0, panel=True))
    rigs.write(folder, "BAD_lens", RIG[:2], rigs.flown(40.0))
    write_raster(folder / "figure_A.png", np.full((90, 130), 9.0), None, driver="PNG", dtype="uint8")
    return folder


@pytest.fixture(scope="module")
def known(frames: Path) -> pg.Rig:
    return rigs.true_rig(RIG, frames, "GOOD_1")


@pytest.fixture(scope="module")
def applied(frames: Path, known: pg.Rig, tmp_path_factory: pytest.TempPathFactory) -> RigApplied:
    out = tmp_path_factory.mktemp("applied") / "out"
    return pg.rig_apply(known, [frames], out_dir=out, executor=InThisProcess())


def test_good_captures_are_corrected_and_bad_ones_are_named(applied: RigApplied) -> None:
    status = {each.name: each.status for each in applied.captures}
    assert {name for name, each in status.items() if each == "corrected"} == set(GOOD)
    reasons = {each.name: each.reason or "" for each in applied.captures}
    assert status["BAD_lens"] == "unusable"
    assert "missing" in reasons["BAD_lens"]
    assert "blurred" in reasons["BAD_blur"]
    assert RIG[1].name in reasons["BAD_cover"]
    assert status["BAD_panel"] == "rejected"
    assert "figure" not in status
    assert [(Path(file).name, reason[:10]) for file, reason in applied.unread] == [
        ("figure_A.png", "left aside")
    ]


def test_every_lens_is_read_where_it_sees_the_ground(applied: RigApplied, known: pg.Rig) -> None:
    for name, height in GOOD.items():
        raster = applied.out_dir / f"{name}.tif"
        errors = rigs.applied_errors(known, RIG, rigs.flown(height), rigs.ground(), raster)
        assert max(errors) < 0.12, name


def test_without_the_ground_of_the_capture_the_lenses_lie_apart(known: pg.Rig, tmp_path: Path) -> None:
    """The figure of the test before can fail: at the wrong distance it does."""
    raster = tmp_path / "level.tif"
    turns = "; ".join(" ".join(f"{v:.9f}" for v in each.rotation) for each in known.lenses)
    written(raster, np.ones((8, 8), np.uint8), RIG_INVERSE_DEPTH="2.5 0 0", RIG_ROTATIONS_RAD=turns)
    errors = rigs.applied_errors(known, RIG, rigs.flown(40.0), rigs.ground(), raster)
    assert max(errors) > 0.3


def test_distance_is_told_in_metres(applied: RigApplied) -> None:
    for each in applied.captures:
        if each.name in GOOD:
            assert each.distance_m == pytest.approx(GOOD[each.name], rel=0.15)


def test_rasters_hold_names_wavelengths_and_a_mask(applied: RigApplied, known: pg.Rig) -> None:
    with ignoring(NotGeoreferencedWarning), rasterio.open(applied.out_dir / "GOOD_2.tif") as dataset:
        assert dataset.descriptions == known.names
        assert dataset.nodata == 0
        assert dataset.tags(4 - 1, ns="IMAGERY")["CENTRAL_WAVELENGTH_UM"] == "0.668"
        assert dataset.tags()["CAMERA_MODEL"] == "pinhole, no distortion"
        values = dataset.read()
    cols, rows = known.crop()[2:]
    assert values.shape == (3, rows, cols)
    assert (values > 0).mean() > 0.98


def test_summary_has_a_line_for_each_capture(applied: RigApplied) -> None:
    with applied.summary.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == sorted(each.name for each in applied.captures)
    assert all(row["reason"] for row in rows if row["status"] != "corrected")


def test_what_is_done_is_not_done_again(
    applied: RigApplied, known: pg.Rig, frames: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {file.name: file.stat().st_mtime_ns for file in applied.out_dir.glob("*.tif")}
    good = [file for name in GOOD for file in sorted(frames.glob(f"{name}_*"))]
    monkeypatch.setattr("pcwlad_geo.rigs.applying_run.correct_capture", None)
    again = pg.rig_apply(known, good, out_dir=applied.out_dir, executor=InThisProcess())
    assert all(each.done_before for each in again.captures)
    assert {file.name: file.stat().st_mtime_ns for file in applied.out_dir.glob("*.tif")} == before


def test_captures_of_all_parts_of_a_long_flight_are_corrected(
    known: pg.Rig, frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The summary that is written after each part leaves the rasters of the next a place."""
    monkeypatch.setattr("pcwlad_geo.rigs.applying_run.available_cores", lambda: 1)
    one_by_one = replace(CAPTURE, captures_a_core=1)
    applied = partial(applying_run._apply, parameters=one_by_one)
    monkeypatch.setattr(applying_run, "_apply", applied)
    good = [file for name in GOOD for file in sorted(frames.glob(f"{name}_*"))]
    found = pg.rig_apply(known, good, out_dir=tmp_path, executor=InThisProcess())
    assert found.count("corrected") == len(GOOD) > 1


def test_another_rig_does_it_again(known: pg.Rig, frames: Path, tmp_path: Path) -> None:
    files = sorted(frames.glob("GOOD_1_*"))
    pg.rig_apply(known, files, out_dir=tmp_path, executor=InThisProcess())
    other = replace(known, drift_px=0.06)
    again = pg.rig_apply(other, files, out_dir=tmp_path, executor=InThisProcess())
    assert [each.done_before for each in again.captures] == [False]
    assert again.count("corrected") == 1


def test_files_of_others_are_not_replaced(known: pg.Rig, frames: Path, tmp_path: Path) -> None:
    (tmp_path / "GOOD_1.tif").write_bytes(b"mine")
    files = sorted(frames.glob("GOOD_1_*"))
    found = pg.rig_apply(known, files, out_dir=tmp_path, executor=InThisProcess())
    assert found.captures[0].status == "unusable"
    assert "exists" in (found.captures[0].reason or "")
    assert (tmp_path / "GOOD_1.tif").read_bytes() == b"mine"


def test_rig_json_goes_there_and_back(known: pg.Rig, tmp_path: Path) -> None:
    path = tmp_path / "RIG.json"
    known.write(path)
    again = pg.Rig.read(path)
    assert again.names == known.names
    assert again.crop() == known.crop()
    for one, other in zip(again.lenses, known.lenses, strict=True):
        assert one.lens.vector == pytest.approx(other.lens.vector, abs=0)
        assert one.baseline == pytest.approx(other.baseline, abs=0)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"kind": "pcwlad-geo rig", "schema_version": 1}', "\x00"])
def test_what_is_no_rig_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "RIG.json"
    path.write_text(text)
    with pytest.raises(InputError):
        pg.Rig.read(path)


def test_rig_of_another_camera_is_refused(known: pg.Rig, frames: Path, tmp_path: Path) -> None:
    first = known.lenses[0]
    other = replace(first, lens=replace(first.lens, shape=(480, 640)))
    with pytest.raises(InputError, match="px"):
        pg.rig_apply(replace(known, lenses=(other, *known.lenses[1:])), [frames], out_dir=tmp_path)
    named = replace(known, lenses=tuple(replace(each, name=f"X{each.name}") for each in known.lenses))
    with pytest.raises(InputError, match="no capture has the lenses"):
        pg.rig_apply(named, [frames], out_dir=tmp_path)


def test_mixed_cameras_and_too_few_lenses_are_refused(frames: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lenses in common"):
        pg.rig_learn(sorted(frames.glob("GOOD_?_1.tif")))
    big = rigs.made_rig(11, (120, 160))[:3]
    rigs.write(tmp_path, "BIG_1", big, rigs.flown(40.0))
    with pytest.raises(InputError, match="one camera"):
        pg.rig_learn([*sorted(frames.glob("GOOD_?_?.tif")), tmp_path])


def test_an_existing_rig_is_not_replaced(frames: Path, tmp_path: Path) -> None:
    path = tmp_path / "RIG.json"
    path.write_text("mine")
    with pytest.raises(OutputError, match="exists"):
        pg.rig_learn([frames], out=path)


def test_frames_of_nothing_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for lens in (1, 2):
        written(tmp_path / f"A_1_{lens}.tif", rng.integers(0, 255, (120, 160)).astype(np.uint8))
    with pytest.raises(RegistrationRejectedError, match="lenses show different ground"):
        pg.rig_learn([tmp_path], executor=InThisProcess())


@pytest.mark.slow
def test_a_rig_is_learned_from_captures_alone(frames: Path, tmp_path: Path) -> None:
    told: list[Event] = []
    good = [file for name in GOOD for file in sorted(frames.glob(f"{name}_*"))]
    path = tmp_path / "RIG.json"
    found = pg.rig_learn(good, out=path, executor=InThisProcess(), on_event=told.append)
    assert any(isinstance(each, Warned) and "off by" in each.message for each in told)
    assert json.loads(path.read_text())["reference"] == RIG[0].name
    out = pg.rig_apply(path, good, out_dir=tmp_path / "out", executor=InThisProcess())
    assert out.count("corrected") == 3
    for name, height in GOOD.items():
        raster = out.out_dir / f"{name}.tif"
        # the reference's own distortion moves the points that are compared, hardly their distances
        errors = rigs.applied_errors(found, RIG, rigs.flown(height), rigs.ground(), raster)
        assert max(errors) < 0.25, name
