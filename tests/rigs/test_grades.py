"""Captures and rigs have the grade of a registration, and panels and pictures of no lens are told by name."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

import pcwlad_geo as pg
from benchmarks.rig_scenes import Ground, write_capture
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.captures import Capture, find_frames, group
from pcwlad_geo.rigs.inspection import inspect
from pcwlad_geo.rigs.learning_run import _agreeing
from tests.rigs import rigs

RIG = rigs.lenses()
REAL = Path(os.environ.get("PCWLAD_GEO_TEST_DATA", "nowhere")) / "real"
needs_real = pytest.mark.skipif(not REAL.is_dir(), reason="PCWLAD_GEO_TEST_DATA has no folder real")


def captures_in(folder: Path) -> dict[str, Capture]:
    found, _ = group(find_frames([folder]))
    return {each.name: each for each in found}


def warned(events: list[Event]) -> str:
    return "\n".join(each.message for each in events if isinstance(each, Warned))


@pytest.mark.parametrize("defocus_px", [0.0, 1.2])
def test_a_panel_is_seen_by_its_code(tmp_path: Path, defocus_px: float) -> None:
    rigs.write(tmp_path, "PANEL_1", RIG, rigs.flown(1.0, panel=True, defocus_px=defocus_px))
    rigs.write(tmp_path, "FLIGHT_1", RIG, rigs.flown(40.0))
    found = captures_in(tmp_path)
    assert "panel" in (inspect(found["PANEL_1"])[0] or "")
    assert inspect(found["FLIGHT_1"])[0] is None


def test_a_panel_that_the_camera_tells_is_believed(tmp_path: Path) -> None:
    rigs.write(tmp_path, "A_1", RIG, rigs.flown(40.0))
    for file in tmp_path.iterdir():  # words of the same length, so that the file stays whole
        text = file.read_bytes().replace(b'd:RelativeAltitude="+40.00"', b'd:CalibrationPicture="0002"')
        file.write_bytes(text)
    assert "say" in (inspect(captures_in(tmp_path)["A_1"])[0] or "")


def test_a_rig_is_not_learned_from_a_panel(tmp_path: Path) -> None:
    rigs.write(tmp_path, "PANEL_1", RIG, rigs.flown(1.0, panel=True))
    with pytest.raises(RegistrationRejectedError, match="PANEL_1: left out: a calibration panel"):
        pg.rig_learn([tmp_path], executor=InThisProcess())


@pytest.mark.slow
def test_a_rig_is_learned_from_the_flight_beside_a_panel(tmp_path: Path) -> None:
    rigs.write(tmp_path, "A_1", RIG, rigs.flown(1.0, panel=True))
    rigs.write(tmp_path, "B_1", RIG, rigs.flown(40.0))
    told: list[Event] = []
    found = pg.rig_learn([tmp_path], executor=InThisProcess(), on_event=told.append)
    assert "A_1: left out: a calibration panel" in warned(told)
    assert found.captures == 1
    assert found.quality == "good"
    done = pg.rig_apply(found, [tmp_path], out_dir=tmp_path / "out", executor=InThisProcess())
    assert {each.name: each.status for each in done.captures} == {"A_1": "rejected", "B_1": "corrected"}
    assert "panel" in (done.captures[0].reason or "")


def test_the_minority_is_left_out_and_a_tie_is_refused(tmp_path: Path) -> None:
    for name in ("A_1", "B_1", "C_1"):
        rigs.write(tmp_path, name, RIG, rigs.flown(40.0))
    one, *others = captures_in(tmp_path).values()
    told: list[Event] = []
    assert _agreeing([one, *others], {one: "too near"}, told.append) == others
    assert "A_1: left out: too near" in warned(told)
    assert _agreeing([one, *others], dict.fromkeys(others, "too far"), told.append) == others
    assert "A_1: left out: it contradicts 2 others" in warned(told)
    with pytest.raises(RegistrationRejectedError, match="contradict each other"):
        _agreeing([one, others[0]], {one: "too near"}, told.append)
    with pytest.raises(RegistrationRejectedError, match="too near"):
        _agreeing([one], {one: "too near"}, told.append)


def test_a_colour_picture_beside_the_frames_of_a_capture_is_left_aside(tmp_path: Path) -> None:
    rigs.write(tmp_path, "IMG_1", RIG, rigs.flown(40.0))
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(
            tmp_path / "IMG_1_RGB.tif", "w", driver="GTiff", height=90, width=120, count=3, dtype="uint8"
        ) as out,
    ):
        out.write(np.full((3, 90, 120), 7, np.uint8))
    found, unread = group(find_frames([tmp_path]))
    assert [sorted(each.frames) for each in found] == [sorted(each.name for each in RIG)]
    assert [Path(file).name for file, _ in unread] == ["IMG_1_RGB.tif"]
    assert "left aside" in unread[0][1]


@pytest.mark.parametrize(
    ("relief_m", "times", "grade"),
    [
        pytest.param(1.0, 1, "good", marks=pytest.mark.slow),
        (4.0, 12, "good"),
        pytest.param(10.0, 12, "fair", marks=pytest.mark.slow),
        pytest.param(10.0, 30, "poor", marks=pytest.mark.slow),
        (10.0, 60, None),
    ],
)
def test_a_scene_of_depth_has_the_grade_of_its_true_errors(
    tmp_path: Path, relief_m: float, times: float, grade: str | None
) -> None:
    """The truth is that of the scene: no matcher is asked."""
    land, far = Ground.made(5, side=1536, relief_m=relief_m), rigs.with_longer_base(RIG, times)
    capture = rigs.flown(40.0)
    write_capture(tmp_path / "in", "S_1", far, capture, land, seed=1, height=True)
    known = rigs.true_rig(far, tmp_path / "in", "S_1")
    done = pg.rig_apply(known, [tmp_path / "in"], out_dir=tmp_path / "out", executor=InThisProcess())
    outcome = done.captures[0]
    assert outcome.quality == grade
    if grade is None:
        assert outcome.status == "rejected"
        assert "several depths" in (outcome.reason or "")
        return
    assert (outcome.reason is None) == (grade == "good")
    errors = rigs.applied_errors(known, far, capture, land, done.out_dir / "S_1.tif", 90.0)
    assert max(errors) < {"good": 0.5, "fair": 1.5, "poor": 9.0}[grade]
    assert max(errors) > {"good": 0.0, "fair": 0.5, "poor": 1.0}[grade]


@needs_real
def test_the_panel_of_a_real_folder_is_named_and_its_flight_is_not() -> None:
    found = captures_in(REAL / "rededge_folder")
    assert "RP02-1603036-SC" in (inspect(found["IMG_0000"])[0] or "")
    assert inspect(found["IMG_0001"])[0] is None


@needs_real
@pytest.mark.slow
def test_no_rig_is_learned_from_a_real_scene_of_depth() -> None:
    told: list[Event] = []
    with pytest.raises(RegistrationRejectedError, match="several depths"):
        pg.rig_learn([REAL / "sequoia_folder"], executor=InThisProcess(), on_event=told.append)
    assert "_RGB.JPG: left aside" in warned(told)
