"""The folders of the tests are those of the package, and of the folders beside it."""

from __future__ import annotations

from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
REPOSITORY = TESTS.parent
OF_MODULES = {
    "api",  # api.py and what the package exports
    "job",  # job.py, pair_job.py, band_warping.py, vector_warping.py and shifting.py: whole jobs
    "common",  # limits, options, requirements, text, solving
}
"""Modules that lie on top of the package have a folder too."""
OF_TESTS = {"repository", "oracles"}


def folders(of: Path) -> set[str]:
    return {path.name for path in of.iterdir() if path.is_dir() and any(path.rglob("*.py"))}


def test_no_test_lies_on_top() -> None:
    assert sorted(path.name for path in TESTS.glob("test_*.py")) == []


def test_folders_of_tests_are_rooms() -> None:
    rooms = folders(REPOSITORY / "pcwlad_geo") | OF_MODULES
    beside = folders(REPOSITORY) - {"tests", "pcwlad_geo"}
    assert sorted(folders(TESTS) - rooms - beside - OF_TESTS) == []


def test_every_room_has_tests() -> None:
    assert sorted(folders(REPOSITORY / "pcwlad_geo") - folders(TESTS)) == []
