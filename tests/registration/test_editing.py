"""Points switched off and added by a user: what is fitted, told and written is what is left on."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.cli.app import run
from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.editing import Editor
from pcwlad_geo.registration.run import open_pair
from tests.registration.test_run import SHIFT_PX, SMALL, write_pair
from tests.scenes import make_grid

GRID = make_grid((320, 320))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A registered pair, displaced by `SHIFT_PX`."""
    place = tmp_path_factory.mktemp("edit")
    pair = write_pair(place, GRID, GRID)
    pcwlad_geo.register(pair.reference, pair.target, out_dir=place / "done", **SMALL)
    return place / "done"


def editor_of(folder: Path) -> Editor:
    pair = open_pair(folder.parent / "ref.tif", folder.parent / "tgt.tif", Settings(**SMALL))
    return Editor(pair, folder / "tiepoints.csv")


def test_a_point_that_is_off_does_not_count(folder: Path) -> None:
    editor = editor_of(folder)
    first = next(row for row in range(len(editor.table)) if row not in editor.off)
    editor.table.target_px[first] += 40.0
    on, off = (editor.try_model("shift", [*editor.off, *more]) for more in ([], [first]))
    assert on.points == off.points + 1 == len(editor.table) - len(editor.off)
    assert on.rmse_px > 3.0
    assert off.rmse_px < 0.2
    assert np.hypot(*off.residual_px[first]) == pytest.approx(40 * np.sqrt(2), abs=0.3)
    with pytest.raises(InputError, match="no model magic"):
        editor.compare("magic", [])
    with pytest.raises(InputError, match="needs at least"):
        editor.compare("affine", range(len(editor.table) - 2))


def test_an_added_point_is_refined_to_the_true_displacement(folder: Path) -> None:
    editor = editor_of(folder)
    shown_px = np.array([[160.5, 150.5], [160.5 + 6.0, 150.5 - 6.0]])
    reference_xy, target_xy = (tuple(xy) for xy in GRID.to_xy(shown_px).tolist())
    count = len(editor.table)
    assert editor.add(reference_xy, target_xy)
    assert len(editor.table) == count + 1
    assert editor.table.displacement_px[-1] == pytest.approx(SHIFT_PX, abs=0.15)
    assert np.abs(editor.table.reference_px[-1] - shown_px[0]).max() <= 48


def test_a_point_beyond_the_image_is_kept_as_shown(folder: Path) -> None:
    editor = editor_of(folder)
    shown_px = np.array([[-400.0, -400.0], [-398.0, -397.0]])
    assert not editor.add(*(tuple(xy) for xy in GRID.to_xy(shown_px).tolist()))
    assert editor.table.displacement_px[-1] == pytest.approx((2.0, 3.0))
    assert editor.table.sigma_px[-1] == pytest.approx((1.0, 1.0))


def test_a_point_nowhere_near_the_images_is_refused(folder: Path) -> None:
    editor = editor_of(folder)
    for place in (1e38, float("nan"), float("inf")):
        with pytest.raises(InputError, match="nowhere near the images"):
            editor.add((place, 0.0), (0.0, 0.0))


def test_a_program_is_answered(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    off = sorted({0, 1, *editor_of(folder).off})
    saved = tmp_path / "a b.points"
    requests: list[Any] = [
        {"do": "fit", "number": 1, "model": "affine", "off": off},
        {"do": "save", "number": 2, "path": str(saved), "off": off},
        {"do": "dance", "number": 3},
        {"do": "save", "number": 4, "path": str(saved), "off": [10**15]},
        "nonsense",
    ]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(map(json.dumps, requests)) + "\n"))
    assert run(["edit", str(folder)]) == 0
    events = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    by_kind = {event["event"]: event for event in events}
    assert by_kind["ready"]["points"] == by_kind["fit"]["points"] + len(off)
    assert by_kind["fit"]["rmse_px"] < 0.2
    assert len(by_kind["fit"]["residual_px"]) == by_kind["ready"]["points"]
    assert [event["number"] for event in events if event["event"] == "failed"] == [3, 4, None]
    rows = [line.split(",") for line in saved.read_text().splitlines() if line[0].isdigit()]
    assert [index for index, row in enumerate(rows) if row[4] == "0"] == off
    dx = np.array([float(row[5]) for row in rows])
    told = np.array(by_kind["fit"]["residual_px"])[:, 0]
    np.testing.assert_allclose(dx, -told, atol=2e-6)  # predicted less observed, as the Georeferencer has it


def test_lines_that_are_no_requests_are_answered_too(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    lines = [b'{"do": "\xff"}', b"\xff\xfe", b"[" * 100_000, b'{"do": "fit", "number": 5, "model": "affine"}']
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"\n".join(lines)), encoding="ascii"))
    assert run(["edit", str(folder)]) == 0
    events = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    told = [event["event"] for event in events if event["event"] != "model"]
    assert told == ["ready", "failed", "failed", "failed", "fit"]


def test_of_fits_that_wait_the_newest_is_answered(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fits = [{"do": "fit", "number": number, "model": "affine", "off": []} for number in range(400)]
    requests = [*fits, {"do": "save", "number": -1, "path": str(tmp_path / "a.points")}, fits[0]]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(map(json.dumps, requests)) + "\n"))
    assert run(["edit", str(folder)]) == 0
    events = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    answered = [event["number"] for event in events if event["event"] in ("fit", "saved")]
    assert answered[-3:] == [399, -1, 0]
    assert len(answered) < 200


def test_a_folder_without_a_registration_is_told(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["edit", str(tmp_path)]) == 2
    assert "no finished registration" in json.loads(capfd.readouterr().out)["message"]


def test_a_report_does_not_say_whom_to_trust(folder: Path, tmp_path: Path) -> None:
    from pcwlad_geo.cli.edit import _open

    report = json.loads((folder / "report.json").read_text())
    report["settings"]["trust_vrt"] = report["settings"]["allow_remote"] = True
    (tmp_path / "report.json").write_text(json.dumps(report))
    (tmp_path / "tiepoints.csv").write_bytes((folder / "tiepoints.csv").read_bytes())
    editor, _ = _open(tmp_path, {"trust_vrt": False, "allow_remote": False})
    assert not editor._pair.settings.trust_vrt
    assert not editor._pair.settings.allow_remote
