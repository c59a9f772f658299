"""The command line as a fixture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.process import Result, run_cli


@pytest.fixture
def cli(tmp_path: Path) -> Callable[..., Result]:
    """Run the command line in an empty working folder."""

    def run(*arguments: str | Path, work: str | None = None) -> Result:
        return run_cli(tmp_path, arguments, work)

    return run
