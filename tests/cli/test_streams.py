"""Standard error is the command's own: what libraries write there does not reach the user."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.cli.process import Result

Cli = Callable[..., Result]
BOTH = ("register", "/vsimem/a.tif", "/vsimem/b.tif")  # whether GDAL knows them is the job's to say

TALK = """
    import logging, os, subprocess, sys, warnings
    from pcwlad_geo.errors import InputError
    from pcwlad_geo.events import Warned
    from pcwlad_geo.execution.workers import open_runner
    warnings.simplefilter("default")
    warnings.warn("a warning of a library")
    logging.getLogger("library").warning("a log line of a library")
    sys.stderr.write("words of a library without an end of line")
    os.write(2, b"words of a C library\\n")
    subprocess.run("echo words of a program of a library >&2", shell=True)
    on_event(Warned("our own"))
    with open_runner(None, on_event, jobs=2) as runner:
        runner.run_jobs(os.write, [(2, b"words of a worker\\n")] * 4, "matching")
    raise InputError("no such band")
"""
TALKERS = ("warning", "log line", "words", "C library", "program", "worker")
LATE = """
    import logging, threading
    def load():
        threading.main_thread().join()  # the run has ended, and so has the command
        logging.getLogger("library").warning("a late log line")
    threading.Thread(target=load).start()
    raise ValueError("odd")
"""


def _lines(result: Result) -> list[str]:
    return [line for line in result.stderr.splitlines() if line]  # a bar leaves an empty one


@pytest.mark.parametrize("progress", ["none", "bar", "json"])
def test_libraries_do_not_talk_to_the_user(cli: Cli, progress: str) -> None:
    result = cli(*BOTH, "--progress", progress, work=TALK)
    own = ["warning: our own"] * (progress != "json") + ["error: no such band"]
    assert (result.returncode, _lines(result)) == (2, own)


def test_debug_lets_libraries_talk(cli: Cli) -> None:
    said = cli(*BOTH, "--debug", work=TALK).stderr
    assert [
        talker for talker in TALKERS if f"{talker} of a" not in said and f"of a {talker}" not in said
    ] == []
    assert "Traceback" in said
    assert "error: no such band\n" in said


def test_what_outlives_the_run_is_as_silent(cli: Cli) -> None:
    assert cli(*BOTH, work=LATE).stderr == "error: unexpected ValueError: odd (--debug shows where)\n"
