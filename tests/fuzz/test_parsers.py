"""The parsers' fuzzer: what it complains about, and a short run of it on each parser."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.targets import Target, complaint, targets
from pcwlad_geo.errors import InputError
from tests.patience import PATIENCE_S

SCRIPT = Path(__file__).resolve().parents[2] / "fuzz" / "parsers.py"


def raising(error: BaseException) -> Target:
    def parse(data: bytes) -> object:
        raise error

    return Target(parse, (b"",))


def test_only_errors_with_a_message_are_in_order() -> None:
    assert complaint(Target(len, (b"",)), b"x") is None
    assert complaint(raising(InputError("a.tif is no raster")), b"x") is None
    assert complaint(raising(InputError("")), b"x") == "InputError without a message"
    assert complaint(raising(KeyError("px")), b"x") == "KeyError: 'px'"
    assert complaint(raising(MemoryError()), b"x") == "MemoryError"


@pytest.mark.parametrize("name", targets())
def test_a_parser_understands_its_seeds(name: str) -> None:
    target = targets()[name]
    for data in target.seeds:
        assert complaint(target, data) is None


def test_the_command_runs_without_atheris() -> None:
    arguments = [sys.executable, str(SCRIPT), "--plain", "--count", "50", "--only", "requirement"]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "requirement" in done.stdout
    assert "50 inputs: no failure" in done.stdout
