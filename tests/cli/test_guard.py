"""A library that crashes ends the command with one line and its exit status, not with a signal."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.process import Result

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no process watches over the work")
Cli = Callable[..., Result]
BOTH = ("register", "/vsimem/a.tif", "/vsimem/b.tif")  # whether GDAL knows them is the job's to say
CRASH = """
    import os
    os.kill(os.getpid(), {number})
"""
IN_A_THREAD = """
    import ctypes, threading
    thread = threading.Thread(target=ctypes.string_at, args=(0,))  # reads at address 0
    thread.start()
    thread.join()
"""


@pytest.mark.parametrize(
    ("work", "says"),
    [
        (
            CRASH.format(number=int(signal.SIGABRT)),
            "a library has crashed (SIGABRT), most likely on a damaged",
        ),
        (CRASH.format(number=int(signal.SIGKILL)), "killed (SIGKILL), as systems do where memory runs out"),
        (IN_A_THREAD, "a library has crashed (SIGSEGV), most likely on a damaged file"),
    ],
)
def test_a_crash_is_one_line_and_status_2(cli: Cli, work: str, says: str) -> None:
    result = cli(*BOTH, work=work)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("error: the work was lost: ")
    assert says in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_crash_is_an_event_of_the_protocol(cli: Cli) -> None:
    result = cli(*BOTH, "--progress", "json", work=IN_A_THREAD)
    (event,) = [json.loads(line) for line in result.stdout.splitlines()]
    assert (event["event"], event["exit_status"], result.returncode) == ("error", 2, 2)
    assert "SIGSEGV" in event["message"]


def test_a_signal_before_the_work_heeds_it_is_an_interrupt(cli: Cli) -> None:
    default = "signal.signal(signal.SIGTERM, signal.SIG_DFL); os.kill(os.getpid(), signal.SIGTERM)"
    result = cli(*BOTH, work=f"\n    import os, signal\n    {default}\n")
    assert (result.returncode, result.stderr) == (130, "error: interrupted\n")


def test_what_a_crash_leaves_is_swept_by_the_next_run(cli: Cli, tmp_path: Path) -> None:
    work = """
    import os
    from pcwlad_geo.outputs.folder import OutputFolder
    with OutputFolder(keywords["out_dir"], overwrite=True) as folder:
        (folder.stage / "half").touch()
        os.abort() if not keywords["overwrite"] else None
    """
    out = tmp_path / "out"
    assert cli(*BOTH, "-o", str(out), work=work).returncode == 2
    assert list(tmp_path.glob(".out.stage-*"))
    cli(*BOTH, "-o", str(out), "--overwrite", work=work)
    assert not list(tmp_path.glob(".out.stage-*"))
