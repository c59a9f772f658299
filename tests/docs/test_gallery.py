"""The gallery: each script is short, runs, and writes its picture; the page shows each with its code."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from PIL import Image

from tests.docs.pages import DOCS, REPOSITORY

GALLERY = DOCS / "gallery"
SCRIPTS = sorted(path for path in GALLERY.glob("*.py") if path.name != "scene.py")
PAGE = (DOCS / "gallery.md").read_text(encoding="utf-8")
MOST_BYTES, MOST_LINES = 150_000, 40


def test_there_are_at_least_eight() -> None:
    assert len(SCRIPTS) >= 8
    assert {path.stem for path in SCRIPTS} == {path.stem for path in (GALLERY / "images").glob("*.png")}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_an_example_is_short_and_shown_with_its_picture(script: Path) -> None:
    assert len(script.read_text(encoding="utf-8").splitlines()) <= MOST_LINES
    assert (GALLERY / "images" / f"{script.stem}.png").stat().st_size < MOST_BYTES
    assert f"](gallery/images/{script.stem}.png)" in PAGE
    assert f'--8<-- "gallery/{script.name}"' in PAGE


def run_by_itself(script: Path, picture: Path) -> None:
    paths = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    ended = subprocess.run(
        [sys.executable, str(script), str(picture)],
        env={**os.environ, "PYTHONPATH": paths},
        cwd=picture.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_an_example_makes_its_picture(script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All in this process, which has the libraries, but the one whose workers import it."""
    picture = tmp_path / "picture.png"
    if 'if __name__ == "__main__":' in script.read_text(encoding="utf-8"):
        run_by_itself(script, picture)
    else:
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(GALLERY)
        monkeypatch.setattr(sys, "argv", [str(script), str(picture)])
        with warnings.catch_warnings():  # which a script may set
            runpy.run_path(str(script), run_name="__main__")
    assert picture.stat().st_size < MOST_BYTES
    with Image.open(picture) as made, Image.open(GALLERY / "images" / f"{script.stem}.png") as kept:
        assert len(made.convert("RGB").getcolors(maxcolors=1 << 24) or []) > 2
        assert abs(made.height - kept.height) <= 0.05 * kept.height  # titles may differ in their last digits
