"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real image pairs; the test is skipped where they are not."""
    folder = Path(os.environ.get("PCWLAD_GEO_TEST_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real image pairs in {folder} (set PCWLAD_GEO_TEST_DATA)")
    return folder
