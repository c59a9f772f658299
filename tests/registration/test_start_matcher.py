"""Matchers of the user's own propose starts, of which nothing is believed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.run import register_pair
from tests.registration.test_pose import GRID, errors_px, pose_of
from tests.scenes import Array, render, write

FEW: dict[str, Any] = {"jobs": 1, "features": 300, "window": 81}

STAND_IN = """
import numpy as np
SEEN = []
def of_known_pose(reference, target):
    SEEN.append((reference, target))
    random = np.random.default_rng(0)
    rows, cols = reference.shape
    xy = random.uniform((0, 0), (cols, rows), (400, 2))
    moved = (xy + 0.5) @ np.array({linear}).T + {shift} - 0.5 + random.normal(0, 1.0, xy.shape)
    moved[:200] = random.uniform((0, 0), (cols, rows), (200, 2))  # as wrong as learned ones can be
    return xy, moved
def of_nothing(reference, target):
    return np.empty((0, 2)), []
def of_chance(reference, target):
    return np.random.default_rng(1).uniform(0, 300, (2, 500, 2))
def leaving(reference, target):
    raise GeneratorExit
def failing(reference, target):
    raise RuntimeError("no weights found")
def of_one_side(reference, target):
    return np.zeros((3, 2)), np.zeros((2, 2))
"""


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Array, Array]:
    """Return the name of a module with matchers, and the pose that one of them knows."""
    linear, shift = pose_of(150.0, 1.1)
    name = f"stand_in_{tmp_path.name.replace('-', '_')}"
    text = STAND_IN.format(linear=linear.tolist(), shift=shift.tolist())
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    return name, linear, shift


def pair(folder: Path, linear: Array, shift: Array, seed: int = 0) -> tuple[Path, Path]:
    values = render(GRID, "thermal", linear=linear, displacement_px=shift, seed=seed)
    return write(folder / "reference.tif", render(GRID), None), write(folder / "target.tif", values, None)


def test_a_proposed_pose_is_matched_to_a_fraction_of_a_pixel(
    tmp_path: Path, stand_in: tuple[str, Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    name, linear, shift = stand_in
    monkeypatch.setattr(
        "pcwlad_geo.registration.scene.starts.PoseStarts", lambda *_: pytest.fail("the proposal was enough")
    )
    files = pair(tmp_path, linear, shift)
    found = register_pair(*files, Settings(**FEW, start_matcher=f"{name}:of_known_pose"))
    assert found.status == "registered"
    assert np.sqrt((errors_px(found, linear, shift) ** 2).mean()) < 0.3
    assert found.prealignment.pose is not None
    assert found.prealignment.pose.rotation_deg == pytest.approx(150.0, abs=0.2)
    ((reference, target),) = sys.modules[name].SEEN
    for image in (reference, target):
        assert image.shape == GRID.shape
        assert image.dtype == np.float32
        assert image.min() == 0
        assert image.max() == 1


@pytest.mark.slow
def test_a_proposed_pose_of_another_scene_is_refused(
    tmp_path: Path, stand_in: tuple[str, Array, Array]
) -> None:
    name, linear, shift = stand_in
    files = pair(tmp_path, linear, shift, seed=9)
    found = register_pair(*files, Settings(**FEW, start_matcher=f"{name}:of_known_pose"))
    assert found.status == "rejected"


def test_proposals_that_agree_on_nothing_change_nothing(
    tmp_path: Path, stand_in: tuple[str, Array, Array]
) -> None:
    linear, shift = np.eye(2), np.array([3.0, -2.0])
    files = pair(tmp_path, linear, shift)
    few = {"jobs": 1, "features": 100, "window": 81, "model": "affine", "prealign": "search"}
    without = register_pair(*files, Settings.from_options(few))
    assert len(without.tie_points) > 50
    for matcher in ("of_nothing", "of_chance"):
        settings = Settings.from_options({**few, "start_matcher": f"{stand_in[0]}:{matcher}"})
        with_proposals = register_pair(*files, settings)
        np.testing.assert_array_equal(with_proposals.tie_points.target_px, without.tie_points.target_px)


@pytest.mark.parametrize(
    ("matcher", "message"),
    [
        ("failing", "no weights found"),
        ("leaving", "GeneratorExit"),
        ("of_one_side", "3 positions .* 2 in the target"),
    ],
)
def test_a_matcher_that_fails_is_named(
    matcher: str, message: str, tmp_path: Path, stand_in: tuple[str, Array, Array]
) -> None:
    files = pair(tmp_path, np.eye(2), np.zeros(2))
    with pytest.raises(InputError, match=message):
        register_pair(*files, Settings(jobs=1, start_matcher=f"{stand_in[0]}:{matcher}", prealign="search"))


@pytest.mark.parametrize("name", ["no_such_package.of_mine:match", "json:no_such_function", "json:__doc__"])
def test_a_matcher_that_is_not_there_is_told(name: str, tmp_path: Path) -> None:
    files = pair(tmp_path, np.eye(2), np.zeros(2))
    with pytest.raises(SettingsError, match=name.partition(":")[0]):
        register_pair(*files, Settings(jobs=1, start_matcher=name, prealign="search"))


@pytest.mark.parametrize("name", ["matcher", "my matcher:f", "../evil:f", 3])
def test_what_is_no_name_of_a_function_is_refused(name: object) -> None:
    with pytest.raises(SettingsError, match=r"package\.module:function"):
        Settings.from_options({"start_matcher": name})


@pytest.mark.parametrize("prealign", ["georef", "none"])
def test_no_matcher_is_asked_where_nothing_may_be_searched(prealign: str, tmp_path: Path) -> None:
    files = pair(tmp_path, np.eye(2), np.zeros(2))
    options = {"jobs": 1, "features": 100, "start_matcher": "no_such:f", "prealign": prealign}
    assert register_pair(*files, Settings.from_options(options)).status == "registered"
