"""The dock with engines that do not fit: it says so, and stays of use."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

import pytest
from conftest import engine_python
from test_engine import wheel
from test_window import PICTURES, keep_pictures, run_in_window

ENGINES = {
    "older": "echo pcwlad-geo 0.0.9",
    "ends with 1": "exit 1",
    "hangs": "sleep 600",
    # fits when it is asked, and does not work
    "changes": 'if [ "$*" != --version ]; then exit 1; fi; exec "{python}" -m pcwlad_geo --version',
    "missing": "",
}


@pytest.fixture(scope="module")
def seen(
    profile: Path,
    sample: tuple[Path, Path],
    quick_python: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Any]:
    """Try each engine, and return what was seen."""
    folder = tmp_path_factory.mktemp("trouble")
    engines = {}
    for name, script in ENGINES.items():
        path = folder / f"pcwlad-geo & {name}"
        engines[name] = str(path)
        if script:
            path.write_text("#!/bin/sh\n" + script.replace("{python}", engine_python()) + "\n")
            path.chmod(path.stat().st_mode | stat.S_IXUSR)
    places = {"reference": str(sample[0]), "target": str(sample[1]), "engines": engines}
    for name in ("empty", "index"):
        (folder / name).mkdir()
        places[name] = str(folder / name)
    places["wheel"], places["python"] = str(wheel(folder / "index")), quick_python
    found = run_in_window("trouble.py", profile, folder, places)
    if PICTURES:
        keep_pictures(folder, Path(PICTURES))
    return found


@pytest.mark.parametrize("name", ENGINES)
def test_an_engine_that_does_not_do_is_told_and_the_dock_goes_on(seen: dict[str, Any], name: str) -> None:
    assert seen[name]["ready"] is True
    assert seen[name]["cancel"] is False
    assert seen[name]["stage"] == ""
    told = {
        "older": "has version 0.0.9",
        "ends with 1": "(status 1)",
        "hangs": "Cancelled; nothing was written.",
        "changes": "The engine ended with status 1",
        "missing": "does not exist",
    }
    assert told[name] in seen[name]["verdict"]


def test_another_engine_is_offered(seen: dict[str, Any]) -> None:
    for name in ("older", "ends with 1", "missing"):
        assert seen[name]["offer"] == "Update engine"
    assert "No pcwlad-geo engine was found" in seen["none"]["verdict"]
    assert seen["none"]["offer"] == "Install engine"
    assert seen["modal"] == []


def test_the_engine_is_installed_from_the_dock_by_one_click(seen: dict[str, Any], profile: Path) -> None:
    assert seen["installing"] == [False, True]
    installed, aligned = seen["installed"]["said"][:2]
    assert installed == "The engine is installed: pcwlad-geo 0.1.0"
    assert aligned.startswith("The engine ended")  # it only says its version
    assert seen["installed"]["offered"] is False
    assert seen["percent"] > 5
    stages = ["Making the virtual environment", "Downloading and installing", "Starting the engine"]
    assert seen["stages"][-3:] == stages
    assert '<b style="color: #116329">✔ The engine is installed' in seen["from a wheel"]
    assert seen["cancelled"] == "Cancelled; nothing was written."
    engines = [each for each in profile.rglob("pcwlad_geo_engine*") if each.is_dir()]
    assert len(engines) == 1  # that of the wheel, and nothing of what was cancelled


def test_an_index_without_the_engine_is_told_and_another_source_stays_offered(seen: dict[str, Any]) -> None:
    verdict = seen["failed"]["verdict"]
    assert "The package index has no pcwlad-geo:</b> choose “From a wheel…”" in verdict
    bold, _, told = verdict.partition("</b>")
    assert "pip" not in bold
    assert len(bold) < 150
    assert "No matching distribution found for pcwlad-geo" in told
    assert seen["failed"]["offered"] is True


def test_no_text_shows_how_it_is_escaped(seen: dict[str, Any]) -> None:
    assert "&amp; older" in seen["older"]["verdict"]  # in rich text, which the label is told to show
    assert seen["rich"] is True
    assert seen["selectable"] is True
