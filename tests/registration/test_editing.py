"""Points switched off and added by a user: what is fitted, told and written is what is left on."""

from __future__ import annotations

import io
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import pcwlad_geo
from pcwlad_geo.cli.app import run
from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import prepare_pair
from pcwlad_geo.registration.editing import Editor
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
    pair = prepare_pair(folder.parent / "ref.tif", folder.parent / "tgt.tif", Settings(**SMALL))
    return Editor(pair, folder / "tiepoints.csv")


def test_a_point_that_is_off_does_not_count(folder: Path) -> None:
    editor = editor_of(folder)
    moved = np.flatnonzero(editor._roles == "fit")[::2].tolist()
    editor.table.target_px[moved] += 40.0
    on, off = (editor.try_model("shift", [*editor.off, *more]) for more in ([], moved))
    assert on.points == off.points + len(moved) == len(editor.table) - len(editor.off)
    assert on.rmse_px > 3.0
    assert off.rmse_px < 0.2
    assert np.hypot(*off.residual_px[moved].T) == pytest.approx(40 * np.sqrt(2), abs=0.3)


def test_models_are_told_by_the_check_points(folder: Path) -> None:
    editor = editor_of(folder)
    check, fitted = (np.flatnonzero(editor._roles == role) for role in ("check", "fit"))
    shift, spline = (editor.compare(model, editor.off) for model in ("shift", "tps"))
    for trial in (shift, spline):
        assert trial.checked == len(check) >= 10
        told = np.sqrt((trial.residual_px[check] ** 2).sum(axis=1).mean())
        assert trial.rmse_px == pytest.approx(told)
    longest = fitted[np.argsort(np.hypot(*shift.residual_px[fitted].T))[len(fitted) // 2 :]]
    chosen = editor.compare("shift", [*editor.off, *longest.tolist(), *check.tolist()])
    assert chosen.checked == len(check)
    assert chosen.rmse_px > 0.8 * shift.rmse_px
    with pytest.raises(InputError, match="no model magic"):
        editor.compare("magic", [])
    with pytest.raises(InputError, match="needs at least"):
        editor.compare("affine", range(len(editor.table) - 2))


def test_an_added_point_is_refined_to_the_true_displacement(folder: Path) -> None:
    editor = editor_of(folder)
    place_px = free_place(editor)
    reference_xy, target_xy = on_the_maps(place_px, place_px + SHIFT_PX + (1.4, -1.1))
    count = len(editor.table)
    assert editor.add(reference_xy, target_xy, radius_px=4.0)
    assert len(editor.table) == count + 1
    assert editor.table.displacement_px[-1] == pytest.approx(SHIFT_PX, abs=0.15)
    assert np.hypot(*(editor.table.reference_px[-1] - place_px)) <= 4.0


def test_points_of_a_hand_are_refined_and_those_that_contradict_are_named(folder: Path) -> None:
    editor = editor_of(folder)
    rng = np.random.default_rng(8)
    inside = np.flatnonzero((np.abs(editor.table.reference_px - 160) < 100).all(axis=1))
    rows = inside[rng.permutation(len(inside))[:9]].tolist()
    off = set(range(len(editor.table))) - set(rows)
    editor.table.target_px[rows] += rng.uniform(-3.0, 3.0, (len(rows), 2))
    assert editor.contradicting(off) == []  # no better than clicks, but none is wrong
    editor.table.target_px[rows[4]] += (60.0, -45.0)
    assert editor.contradicting(off) == [rows[4]]
    assert editor.contradicting({*off, *rows[:4]}) == []  # too few to tell
    count = len(editor.table)
    refined = [editor.improve(row, 6.0, off) for row in rows]
    assert refined == [row != rows[4] for row in rows]
    assert len(editor.table) == count + len(rows) - 1
    error_px = np.abs(editor.table.displacement_px[count:] - SHIFT_PX)
    assert error_px.max() < 0.3
    assert editor.contradicting(off | set(rows) - {rows[4]}) == [rows[4]]


def free_place(editor: Editor, apart_px: float = 4.5) -> NDArray[np.float64]:
    """Return a place (col, row) in the middle of the reference that is far from all tie points, px."""
    tree = cKDTree(editor.table.reference_px)
    places = np.stack(np.meshgrid(np.arange(130.5, 190), np.arange(130.5, 190)), axis=-1).reshape(-1, 2)
    return np.asarray(places[tree.query(places)[0] > apart_px][0])


def on_the_maps(*places_px: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Return where pixels (col, row) lie on the map."""
    return [tuple(xy) for xy in GRID.to_xy(np.array(places_px)).tolist()]


def test_a_point_is_never_put_onto_another(folder: Path) -> None:
    """Also where the nearest corners are taken: a place without a match of its own moves to none of them."""
    editor = editor_of(folder)
    there_px = editor.table.reference_px[40]
    count = len(editor.table)
    with pytest.raises(InputError, match="there is a tie point already"):
        editor.add(*on_the_maps(np.add(there_px, (1.5, -1.0)), there_px + SHIFT_PX))
    assert len(editor.table) == count
    for place_px in np.add(editor.table.reference_px[:count:9], (4.0, 0.0)):
        with suppress(InputError):
            editor.add(*on_the_maps(place_px, place_px + SHIFT_PX), radius_px=4.0)
    others, added = cKDTree(editor.table.reference_px[:count]), editor.table.reference_px[count:]
    assert len(added) > 3
    assert others.query(added, p=np.inf)[0].min() >= 2.9
    assert editor.add(*on_the_maps(there_px, there_px + SHIFT_PX), deleted=[40])  # that one was taken away


def test_a_point_moves_no_farther_than_the_radius(folder: Path) -> None:
    editor = editor_of(folder)
    place_px = free_place(editor)
    shown_px = place_px + SHIFT_PX + (9.0, 0.0)
    assert not editor.add(*on_the_maps(place_px, shown_px), radius_px=3.0)
    assert editor.table.target_px[-1] == pytest.approx(shown_px, abs=1e-6)
    assert editor.table.reference_px[-1] == pytest.approx(place_px, abs=1e-6)


def test_points_that_are_gone_are_not_written_and_sigmas_are_kept(folder: Path, tmp_path: Path) -> None:
    editor = editor_of(folder)
    count = len(editor.table)
    editor.save(tmp_path / "p.csv", off=[3], deleted=[1, 2])
    lines = [line.split(",") for line in (tmp_path / "p.csv").read_text().splitlines()[1:]]
    assert len(lines) == count - 2
    assert [line[-1] for line in lines[:2]] == ["matched", "rejected"]
    assert float(lines[1][11]) == pytest.approx(editor.table.sigma_px[3, 0], abs=1e-6)


def test_a_point_beyond_the_image_is_kept_as_shown(folder: Path) -> None:
    editor = editor_of(folder)
    shown_px = np.array([[-400.0, -400.0], [-398.0, -397.0]])
    assert not editor.add(*(tuple(xy) for xy in GRID.to_xy(shown_px).tolist()))
    assert editor.table.displacement_px[-1] == pytest.approx((2.0, 3.0))
    assert editor.table.sigma_px[-1] == pytest.approx((1.0, 1.0))


def test_a_place_in_the_target_may_be_a_pixel(folder: Path) -> None:
    editor, other = editor_of(folder), editor_of(folder)
    place_px = free_place(editor)
    shown_px = place_px + SHIFT_PX + (0.4, -0.3)
    reference_xy, target_xy = on_the_maps(place_px, shown_px)
    assert editor.add(reference_xy, None, target_px=(float(shown_px[0]), float(shown_px[1])))
    assert other.add(reference_xy, target_xy)
    assert editor.table.target_px[-1] == pytest.approx(other.table.target_px[-1], abs=1e-6)
    for nowhere in ((float("nan"), 1.0), (1.0,)):
        with pytest.raises(InputError, match="nowhere near"):
            editor.add(reference_xy, None, target_px=nowhere)


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
        {"do": "improve", "off": list(range(8, editor_of(folder).table.target_px.shape[0])), "radius_px": 4},
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
    improved = [event for event in events if event["event"] == "improved"]
    assert [event["row"] for event in improved] == list(range(8))
    assert sum(event["point"] is not None for event in improved) > 4
    assert by_kind["contradicting"]["rows"] == []
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
    editor, _ = _open(tmp_path)
    assert not editor._pair.settings.trust_vrt
    assert not editor._pair.settings.allow_remote
