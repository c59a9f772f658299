"""What each change runs and what each night: the mark `gate` is given to slow tests that each change runs."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S

TESTS = Path(__file__).resolve().parents[1]
REPOSITORY = TESTS.parent
GATES = {
    "a real pair of two sensors": "job/test_real_data.py::test_landsat_and_sentinel_forward_and_backward",
    "a stack that refuses an image": "multi/test_grades.py::"
    "test_a_refused_image_has_no_raster_and_the_run_says_so",
    "a real block of images with RPCs": "job/test_real_data.py::"
    "test_orthoimages_of_a_block_over_a_coarse_dem_lie_on_each_other",
    "the quality of real bands": "multi/test_qa.py::test_real_bands",
    "a job that is killed": "execution/test_faults.py::"
    "test_a_killed_job_leaves_nothing_under_a_final_name_and_can_be_started_again",
    "files that made stacks, rigs and edits fail": "fuzz/test_hostile_capabilities.py::"
    "test_hostile_capabilities_end_with_a_sentence",
    "small cases of the field": "fuzz/test_field_cases.py::test_the_field_is_met",
    "notebooks": "docs/test_notebooks.py::test_a_notebook_runs",
    "a cluster": "execution/test_faults.py::test_a_cluster_gives_the_same_points",
}
"""What a change may break that no quick test covers from end to end, and the slow test of it."""
GATE, SLOW = "pytest.mark.gate", ("pytest.mark.slow", "slow")


def marked() -> dict[str, list[str]]:
    """Return the decorators of each test that is marked `gate`, or some of whose cases are."""
    found = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        if path == Path(__file__) or GATE not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                decorators = [ast.unparse(each) for each in node.decorator_list]
                if any(GATE in each for each in decorators):
                    found[f"{path.relative_to(TESTS).as_posix()}::{node.name}"] = decorators
        assert text.count(GATE) == sum(
            name.startswith(f"{path.relative_to(TESTS).as_posix()}:") for name in found
        )
    return found


def test_the_mark_of_a_gate_is_given_to_slow_tests_alone() -> None:
    assert [name for name, decorators in marked().items() if not set(decorators) & set(SLOW)] == []


def test_each_capability_has_a_slow_test_that_each_change_runs() -> None:
    assert set(marked()) == set(GATES.values())


def test_each_mark_says_who_runs_it(pytestconfig: pytest.Config) -> None:
    marks = {line.partition(":")[0]: line for line in pytestconfig.getini("markers")}
    assert "`.ci/run nightly`" in marks["slow"]
    assert "`.ci/run`" in marks["gate"]


@pytest.mark.skipif(os.name == "nt" or shutil.which("bash") is None, reason="the script is one of bash")
@pytest.mark.parametrize("words", [["nightly", "nightly"], ["night"], ["nightly 2"], [""]])
def test_a_run_of_neither_kind_is_refused(words: list[str]) -> None:
    ended = subprocess.run(
        ["bash", str(REPOSITORY / ".ci" / "run"), *words],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", "usage: .ci/run [nightly]\n")
