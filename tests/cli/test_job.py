"""Exit statuses, the JSON protocol and cancellation, with a stand-in for the work itself."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pcwlad_geo
from tests.cli.process import Result, command, environment
from tests.execution.calls import wait_for_end
from tests.patience import PATIENCE_S

Cli = Callable[..., Result]

DONE = """
    from pcwlad_geo.events import Progress, Warned
    on_event(Warned("two\\nlines"))
    on_event(Progress("matching", 1, 2))
    axes = made(mean=[1.0, 2.0], median=[1.25, -0.5], std=[0.1, 0.1])
    figures = made(n=40, rmse=0.1234, ce90=0.2)
    nothing = {"all": None, "fit": None, "check": None}
    pose = None
    passed, requirements = None, ()
    return made(
        status="registered", reference=made(basemap=None), warnings=["two lines"], displacement_px=axes,
        displacement_m=None,
        quality=None, passed=passed, requirements=requirements, model=None, prealignment=made(pose=pose),
        tie_points={"total": 130, "fit": 80, "check": 40, "unused": 0, "rejected": 10},
        accuracy={"fit": {"px": None, "m": None}, "check": {"px": figures, "m": None}},
        statistics=made(before=nothing, after=nothing))
"""
POSED = DONE.replace("pose = None", "pose = made(scale=[0.2, -0.21], rotation_deg=12.3)")
SLOW = """
    import time
    from pcwlad_geo.events import Progress
    try:
        on_event(Progress("matching", 0, 2))
        time.sleep(36_000)
    finally:
        Path("cleaned").touch()
"""
STUCK = """
    import ctypes
    from pcwlad_geo.events import Progress
    on_event(Progress("matching", 0, 2))
    while True:
        ctypes.CDLL(None).usleep(60_000_000)  # goes on after a signal's handler, as native code does
"""
WITH_WORKERS = """
    import ctypes, time
    from pcwlad_geo.events import Progress
    from pcwlad_geo.execution.workers import open_runner
    def begin(event):
        if not event.done:
            return
        ids = [child.process.pid for child in runner._processes._all]
        Path("workers").write_text(" ".join(map(str, ids)))
        on_event(event)
        if "stuck" in keywords["out_dir"].name:
            while True:
                ctypes.CDLL(None).usleep(60_000_000)
    with open_runner(None, on_event, jobs=2) as runner:
        runner.run_jobs(time.sleep, [(0.0,), (3600.0,)], "matching", begin)
"""
BOTH = ("register", "/vsimem/a.tif", "/vsimem/b.tif")  # whether GDAL knows them is the job's to say


def events(result: Result) -> list[dict[str, Any]]:
    """Read the protocol: every line of standard output must be strict JSON."""
    return [
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
        for line in result.stdout.splitlines()
    ]


def test_success_prints_a_summary(cli: Cli) -> None:
    result = cli(*BOTH, work=DONE)
    assert result.returncode == 0
    assert "120 tie points (10 rejected)" in result.stdout
    assert "40 check points: RMSE 0.123 px, CE90 0.200 px" in result.stdout
    assert "+1.250 px in column, -0.500 px in row" in result.stdout
    assert str(Path("b_registered", "report.html")) in result.stdout
    assert result.stderr == "warning: two lines\n"


@pytest.mark.parametrize("style", [(), ("--progress", "bar")])
def test_few_of_many_warnings_that_differ_in_names_only(cli: Cli, style: tuple[str, ...]) -> None:
    warning = '    on_event(Warned("two\\nlines"))\n'
    many = "".join(f"    on_event(Warned('IMG_{n}: {n} px of c:/a/{n}.tif are dark'))\n" for n in range(9))
    work = DONE.replace(warning, many)
    assert work != DONE
    shown = [line for line in cli(*BOTH, *style, work=work).stderr.splitlines() if "dark" in line]
    assert [line.split(":")[1] for line in shown[:3]] == [" IMG_0", " IMG_1", " IMG_2"]
    assert shown[3:] == ["warning: 6 more of these: … … px of … are dark"]
    assert (
        sum(event["event"] == "warning" for event in events(cli(*BOTH, "--progress", "json", work=work))) == 9
    )


def test_a_pose_of_another_scale_is_printed_instead_of_a_displacement(cli: Cli) -> None:
    printed = cli(*BOTH, work=POSED).stdout
    assert "found at scale 0.200 x 0.210, rotation 12.3 degrees\n" in printed
    assert "median displacement" not in printed


def test_a_requirement_that_is_not_met_is_a_result_with_status_4(cli: Cli) -> None:
    message = "CE90 <= 0.1 px: not met (0.2 px)"
    missed = f'passed, requirements = False, [made(met=False, message="{message}", caveat=None)]'
    work = DONE.replace("passed, requirements = None, ()", missed)
    result = cli(*BOTH, "--require", "CE90<=0.1px", work=work)
    assert result.returncode == 4
    assert "CE90 <= 0.1 px: not met (0.2 px)\nFAILED: no corrected raster is written" in result.stdout
    *_, ended = events(cli(*BOTH, "--require", "CE90<=0.1px", "--progress", "json", work=work))
    assert (ended["event"], ended["status"], ended["passed"], ended["exit_status"]) == (
        "result",
        "registered",
        False,
        4,
    )
    assert ended["requirements"][0]["met"] is False
    assert set(ended["paths"]) == {"numbers", "report"}


def test_bar_goes_to_standard_error(cli: Cli) -> None:
    result = cli(*BOTH, "--progress", "bar", work=DONE)
    assert result.returncode == 0
    assert "matching" in result.stderr
    assert "warning: two lines" in result.stderr
    assert "matching" not in result.stdout


def test_json_events(cli: Cli, tmp_path: Path) -> None:
    result = cli(*BOTH, "--progress", "json", "-o", "here", work=DONE)
    assert result.returncode == 0
    warned, progressed, ended = events(result)
    assert warned == {"event": "warning", "message": "two\nlines"}
    assert progressed == {"event": "progress", "stage": "matching", "done": 1, "total": 2}
    assert ended["event"] == "result"
    assert ended["paths"]["report"] == str(tmp_path / "here" / "report.html")
    assert ended["tie_points"]["fit"] == 80


def test_stray_prints_cannot_corrupt_the_protocol(cli: Cli) -> None:
    noise = """
    import os, sys
    print("from python")
    os.write(1, b"from C\\n")
    os.system("echo from a child")
    """
    result = cli(*BOTH, "--progress", "json", work=noise + DONE)
    assert [event["event"] for event in events(result)] == ["warning", "progress", "result"]
    for text in ("from python", "from C", "from a child"):
        assert text in result.stderr


@pytest.mark.parametrize(
    ("raised", "status", "said"),
    [
        ("InputError('no such band:\\n  7')", 2, "error: no such band: 7\n"),
        ("OutputError('disk full')", 2, "error: disk full\n"),
        ("RegistrationRejectedError('too few')", 3, "error: too few\n"),
        ("ValueError('odd')", 1, "error: unexpected ValueError: odd (--debug shows where)\n"),
        (
            "MemoryError()",
            2,
            "error: this needs more memory than there is (none left): give --jobs 1, a smaller --window or "
            "--search-radius, or smaller rasters\n",
        ),
    ],
)
def test_errors_are_one_line_and_have_their_status(
    cli: Cli, cli_here: Cli, raised: str, status: int, said: str
) -> None:
    name = raised.split("(")[0]
    home = "pcwlad_geo" if name in pcwlad_geo.__all__ else "builtins"
    work = f"from {home} import {name}\nraise {raised}"
    result = cli_here(*BOTH, work=work)
    assert (result.returncode, result.stdout, result.stderr) == (status, "", said)
    debug = cli_here(*BOTH, "--debug", work=work)
    assert debug.returncode == status
    assert "Traceback" in debug.stderr
    (event,) = events(cli(*BOTH, "--progress", "json", work=work))
    assert (event["event"], event["exit_status"]) == ("error", status)
    assert "\n" not in event["message"]


def test_rejection_says_where_its_report_is(cli: Cli) -> None:
    work = """
    from pcwlad_geo.errors import RegistrationRejectedError
    raise RegistrationRejectedError("no", out_dir=Path("b_registered"))
    """
    (event,) = events(cli(*BOTH, "--progress", "json", work=work))
    assert event["status"] == "rejected"
    assert event["out_dir"].endswith("b_registered")


def start(tmp_path: Path, work: str, *arguments: str) -> subprocess.Popen[str]:
    """Start the command line in a process group of its own and wait for its first event."""
    process = subprocess.Popen(
        [*command(work), *BOTH, "--progress", "json", *arguments],
        cwd=tmp_path,
        env=environment(tmp_path),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["event"] == "progress"
    return process


def end(process: subprocess.Popen[str]) -> tuple[list[str], str]:
    """Wait for the end; return the events' names and standard error."""
    out, err = process.communicate(timeout=PATIENCE_S)
    return [json.loads(line)["event"] for line in out.splitlines()], err


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_cancels(tmp_path: Path, number: int) -> None:
    process = start(tmp_path, SLOW)
    os.killpg(process.pid, number)
    names, err = end(process)
    assert process.returncode == 130
    assert names == ["cancelled"]
    assert "Traceback" not in err
    assert (tmp_path / "cleaned").exists()


def test_an_error_of_the_removal_after_an_interrupt_is_told(cli: Cli) -> None:
    work = """
    import pcwlad_geo.outputs.folder as folder
    def fail(path):
        raise RuntimeError("not removed")
    folder.abandon = fail
    raise KeyboardInterrupt
    """
    ended = cli(*BOTH, work=work)
    assert ended.returncode == 1
    assert "unexpected RuntimeError: not removed" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_native_code_cannot_put_the_end_off(tmp_path: Path) -> None:
    """The native code itself never ends."""
    process = start(tmp_path, STUCK)
    os.killpg(process.pid, signal.SIGINT)
    names, _ = end(process)
    assert process.returncode == 130
    assert names == ["cancelled"]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_forced_end_leaves_nothing_half_written(tmp_path: Path) -> None:
    work = """
    from pcwlad_geo.outputs.folder import OutputFolder
    with OutputFolder("b_registered") as folder:
        (folder.stage / "half.tif").touch()
    """
    stuck = "\n".join(["", *(f"    {line}" for line in STUCK.splitlines())])
    process = start(tmp_path, work + stuck)
    assert {path.name[:14] for path in tmp_path.iterdir()} == {".b_registered."}
    process.send_signal(signal.SIGINT)
    end(process)
    assert process.returncode == 130
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("folder", ["waiting", "stuck"])
def test_no_worker_is_left_behind(folder: str, number: int, tmp_path: Path) -> None:
    process = start(tmp_path, WITH_WORKERS, "-o", folder)
    workers = [int(worker) for worker in (tmp_path / "workers").read_text().split()]
    assert len(workers) == 2
    process.send_signal(number)
    names, err = end(process)
    assert process.returncode == (-9 if number == signal.SIGKILL else 130)
    assert (names[-1:], err) == ([] if number == signal.SIGKILL else ["cancelled"], "")
    wait_for_end(workers)


def test_the_end_of_standard_input_cancels(tmp_path: Path) -> None:
    process = start(tmp_path, SLOW, "--watch-stdin")
    assert process.stdin is not None
    process.stdin.close()
    process.stdin = None
    names, _ = end(process)
    assert process.returncode == 130
    assert names == ["cancelled"]
    assert (tmp_path / "cleaned").exists()


def test_standard_input_that_ends_is_nothing_without_the_option(cli: Cli) -> None:
    assert cli(*BOTH, work=DONE).returncode == 0


def test_a_reader_that_goes_away_cancels(tmp_path: Path) -> None:
    work = """
    import time
    from pcwlad_geo.events import Progress
    while True:
        on_event(Progress("matching", 0, 600))
        time.sleep(0.05)
    """
    process = start(tmp_path, work)
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
