"""The fuzzer on the real command line, and chaos, both small."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.results import complaints, content_of
from tests.patience import PATIENCE_S

FUZZ = Path(__file__).resolve().parents[2] / "fuzz"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the fork server needs Linux")


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )


@pytest.mark.slow
def test_the_same_ends_whatever_the_jobs() -> None:
    tables = []
    for jobs in ("1", "2"):
        done = python(str(FUZZ / "run.py"), "--count", "12", "--seed", "7", "--jobs", jobs, "--no-kept")
        assert "12 inputs" in done.stdout, done.stderr
        tables.append(re.findall(r"^ +\d+  .*$", done.stdout, re.MULTILINE))
    assert tables[0] == tables[1]
    assert any("exit 2" in line for line in tables[0])


@pytest.mark.slow
def test_killed_batches_end_as_undisturbed_ones() -> None:
    done = python(str(FUZZ / "chaos.py"), "--pairs", "3", "--kills", "5", "--seed", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 kills" in done.stdout
    assert "0 files differ, 0 hidden files left" in done.stdout


def test_results_are_compared_without_their_times(tmp_path: Path) -> None:
    for name, seconds, warning in (
        ("a", 1.5, []),
        ("b", 2.5, ["a worker process was lost (killed): its task is done"]),
    ):
        pair = tmp_path / name / "t_registered"
        pair.mkdir(parents=True)
        (pair / "t.tif").write_bytes(b"pixels")
        report = {"outputs": ["t.tif"], "seconds": {"reading": seconds}, "warnings": warning}
        (pair / "report.json").write_text(str(report).replace("'", '"'))
        (pair / "report.html").write_text(f"<dt>seconds, reading</dt><dd>{seconds}</dd>")
        (tmp_path / name / "summary.csv").write_text(f"line,status,seconds\n2,registered,{seconds}\n")
    assert content_of(tmp_path / "a") == content_of(tmp_path / "b")
    assert complaints(tmp_path / "a") == []
    (tmp_path / "b" / "t_registered" / "t.tif").write_bytes(b"others")
    assert content_of(tmp_path / "a") != content_of(tmp_path / "b")
    (tmp_path / "b" / "t_registered" / "t.tif").unlink()
    assert complaints(tmp_path / "b") == ["t_registered: t.tif is missing"]
