"""A page as Chromium shows it."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S


@dataclass(frozen=True)
class Shown:
    """What became of a page once its scripts have run."""

    page: str
    complaints: bool
    """Whether there was anything on the console."""


def show(path: Path) -> Shown:
    """Open a page without a screen; skips the test where there is no Chromium."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium")
    arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom"]
    shown = subprocess.run(
        [browser, *arguments, f"--user-data-dir={path.parent / 'profile'}", path.as_uri()],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    return Shown(shown.stdout, "CONSOLE" in shown.stderr)
