"""What the speed benchmark measures: processes with all that they start, and points against a truth."""

from __future__ import annotations

import math
import subprocess
import sys
import textwrap
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.speed_studies import processes, truth
from benchmarks.speed_studies.limits import checks_of_scenes
from benchmarks.speed_studies.processes import Measured, measure
from benchmarks.speed_studies.scene_files import displacement_px
from benchmarks.speed_studies.whole_scenes import ALL, AROSICS, MATCH, Results, Run
from benchmarks.timing import cheapest

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")

BUSY = "import time\nwhile time.process_time() < 0.4: pass\n"


def python(code: str) -> Measured:
    return measure([sys.executable, "-c", textwrap.dedent(code)])


def test_cpu_time_of_a_child_and_of_an_orphan_is_counted() -> None:
    alone = python(BUSY)
    child = python(f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {BUSY!r}])")
    # this one leaves its child behind, and ends at once
    orphan = python(
        f"import subprocess, sys, os\nsubprocess.Popen([sys.executable, '-c', {BUSY!r}])\nos._exit(0)"
    )
    assert min(alone.cpu_s, child.cpu_s, orphan.cpu_s) >= 0.4


def test_other_children_of_this_process_are_left_alone() -> None:
    code = f"{BUSY}block = bytearray(b'x') * 300_000_000\nprint('ready', flush=True)\ninput()"
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert other.stdout is not None
    assert other.stdout.readline() == b"ready\n"
    run = python("import time\ntime.sleep(0.5)")
    assert run.peak_mb < 200
    assert run.cpu_s < 0.4
    other.communicate(b"\n")
    assert other.returncode == 0


def test_memory_that_processes_share_is_counted_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ready, seen = tmp_path / "ready", tmp_path / "seen"
    code = f"""
        import os, pathlib, time
        block = bytearray(b'x') * 200_000_000
        if os.fork() == 0:
            own = bytearray(b'y') * 100_000_000
            pathlib.Path({str(ready)!r}).touch()
            while not os.path.exists({str(seen)!r}):
                time.sleep(0.01)
            os._exit(0)
        os.wait()
    """
    measured, memory_of = Counter[int](), processes._pss_bytes

    def count(pid: int) -> int:
        measured[pid] += ready.exists()
        if len(measured) == 2 and min(measured.values()) == 2:  # both have been seen once, at one time
            seen.touch()
        return 0 if seen.exists() else memory_of(pid)  # while they end, the sum is of no one time

    monkeypatch.setattr(processes, "_pss_bytes", count)
    assert 295 < python(code).peak_mb < 360


def test_status_and_output_are_handed_over() -> None:
    run = python("import sys\nprint('out')\nsys.exit('refused')")
    assert (run.status, run.output, run.reason) == (1, "out\n", "refused")
    assert python("import os\nos.kill(os.getpid(), 9)").status == -9


def test_points_are_judged_by_the_truth() -> None:
    reference = np.array([[100.0, 100.0], [900.0, 100.0], [910.0, 110.0], [1023.9, 1024.0]])
    error = np.array([[0.3, 0.4], [0.0, 0.0], [0.9, 1.2], [-0.5, 0.0]])
    found = displacement_px(reference) + error
    judged = truth.score(reference, found, 1024)
    assert (judged.points, judged.correct, judged.cells) == (4, 3, 3)
    assert judged.rmse_px == pytest.approx(math.sqrt((0.25 + 0.0 + 0.25) / 3))


def test_rejected_points_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "tiepoints.csv"
    path.write_text(
        "status,ref_col,ref_row,tgt_col,tgt_row\nmatched,1,2,1.5,1\nrejected,0,0,9,9\nunused,3,4,3,4\n"
    )
    positions, displacement = truth.read_tie_points(path)
    np.testing.assert_array_equal(positions, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(displacement, [[0.5, -1.0], [0, 0]])


def test_arosics_shifts_are_turned_into_displacements(tmp_path: Path) -> None:
    path = tmp_path / "arosics.csv"
    # the target must move 5 m west and 10 m south: what it shows lies half a pixel right, one pixel up
    path.write_text("X_MAP,Y_MAP,X_SHIFT_M,Y_SHIFT_M\n412190,5278200,-5,-10\n")
    positions, displacement = truth.read_arosics(path)
    np.testing.assert_allclose(positions, [[1.0, 2.0]])
    np.testing.assert_allclose(displacement, [[0.5, -1.0]])


def test_cheapest_takes_the_least_of_warm_rounds_in_turn() -> None:
    order: list[str] = []
    costs = cheapest([lambda: order.append("a"), lambda: order.append("b")], 2)
    assert order == ["a", "b"] * 3
    assert all(0 <= cost.cpu_s < math.inf for cost in costs)


def run_of(mode: str, side_px: int, wall_s: float, rmse_px: float = 0.1, points: int = 20000) -> Run:
    cost = Measured(wall_s, 2 * wall_s, 900.0, 0, "", "")
    return Run(mode, side_px, cost, truth.PointScore(points, points, 64, rmse_px), wall_s - 1.0)


def test_limits_are_ratios_of_medians_in_one_run() -> None:
    runs = [run_of(MATCH, 4096, wall) for wall in (12.0, 9.0, 30.0)]
    runs += [run_of(AROSICS, 4096, wall, rmse_px=0.2) for wall in (17.0, 21.0, 15.0)]
    runs += [run_of(ALL, 2048, 10.0), run_of(ALL, 4096, 48.0)]
    checks = {check.what: check for check in checks_of_scenes(Results(runs), bank_wall_s=10.0)}
    assert checks["match 1000, 4096²: wall time / AROSICS' call"].value == "0.750"
    assert checks["match 1000, 4096²: RMSE / AROSICS'"].value == "0.500"
    assert not checks["match all, 4096²: wall time / bare filter bank"].holds
    exponent = checks["match all, 2048² to 4096²: exponent of CPU time by area"]
    assert exponent.value == f"{math.log(4.8) / math.log(4):.3f}"
    assert not exponent.holds


def test_a_mode_without_points_gives_no_check() -> None:
    refused = Run(MATCH, 4096, Measured(1, 1, 1, 2, "", "no such option"), None, math.nan)
    assert list(checks_of_scenes(Results([refused]), 10.0)) == []
