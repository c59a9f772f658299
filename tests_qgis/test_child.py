"""The child process and the protocol, with stand-ins for the engine."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import textwrap
import threading
import time
import uuid
from pathlib import Path
from typing import Any

import pytest
from conftest import PATIENCE_S, Feedback
from pcwlad_geo_qgis import text
from pcwlad_geo_qgis.process import child, page
from pcwlad_geo_qgis.process.engine import Engine
from pcwlad_geo_qgis.process.protocol import RunError, _Conversation, run_engine

SHARES = {"matching": (10.0, 60.0)}


def stand_in(tmp_path: Path, source: str) -> Engine:
    """Return an engine that is a Python script."""
    script = tmp_path / "engine.py"
    script.write_text("import json, os, subprocess, sys, time\n" + textwrap.dedent(source), encoding="utf-8")
    return Engine((sys.executable, str(script)), "test")


def processes(mark: str) -> list[int]:
    """Return the processes, zombies aside, that have a mark in their environment."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit() and mark.encode() in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:
            pass
    return found


def count_until(mark: str, wanted: int, limit_s: float = PATIENCE_S) -> int:
    """Wait until there are so many processes with a mark, or more of some; return how many there are."""
    end = time.monotonic() + limit_s
    while True:
        count = len(processes(mark))
        if count == wanted or count > wanted > 0 or time.monotonic() > end:
            return count
        time.sleep(0.02)


@pytest.fixture
def mark(monkeypatch: pytest.MonkeyPatch) -> str:
    """Mark the environment of the processes that a test starts."""
    value = uuid.uuid4().hex
    monkeypatch.setenv("TEST_MARK", value)
    return value


def test_the_environment_of_qgis_stays_with_qgis(monkeypatch: pytest.MonkeyPatch) -> None:
    dropped = [
        "PYTHONHOME",
        "PYTHONPATH",
        "GDAL_DATA",
        "PROJ_LIB",
        "PROJ_DATA",
        "QT_PLUGIN_PATH",
        "QGIS_PREFIX_PATH",
    ]
    dropped += ["CONDA_PREFIX", "LD_LIBRARY_PATH", "LD_PRELOAD", "DYLD_LIBRARY_PATH", "VIRTUAL_ENV"]
    for name in dropped:
        monkeypatch.setenv(name, "from QGIS")
    monkeypatch.setenv("OF_THE_USER", "kept")
    environment = child.child_environment()
    assert not set(dropped) & set(environment)
    assert "from QGIS" not in environment.values()
    assert environment["OF_THE_USER"] == "kept"
    assert environment["PYTHONNOUSERSITE"] == environment["PYTHONUNBUFFERED"] == "1"


def test_events_become_progress_warnings_and_the_result(tmp_path: Path) -> None:
    engine = stand_in(
        tmp_path,
        """
        print(json.dumps({"event": "progress", "stage": "matching", "done": 1, "total": 2}))
        print("a stray line")
        print(json.dumps({"event": "progress", "stage": "another", "done": 1, "total": 2}))
        print(json.dumps({"event": "warning", "message": "Überlappung"}))
        print("auf stderr: ü", file=sys.stderr)
        print(json.dumps({"event": "result", "arguments": sys.argv[1:], "stdin": sys.stdin.fileno()}))
        """,
    )
    feedback = Feedback()
    result = run_engine(engine, ["register", "ä b.tif"], feedback, tmp_path, SHARES)
    assert result["arguments"] == ["register", "ä b.tif", "--progress", "json", "--watch-stdin"]
    assert 35.0 in feedback.percent
    assert feedback.warnings == ["Überlappung"]
    assert {"a stray line", "auf stderr: ü", "another"} <= set(feedback.lines)


@pytest.mark.parametrize(("command", "spoken"), [("register", "Zahlen"), ("stack", "Numbers")])
def test_pages_of_a_pair_are_written_in_the_language_of_qgis(
    command: str, spoken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    german = {"en": "de", "Numbers": "Zahlen"}
    monkeypatch.setattr(text._Language, "translate", staticmethod(lambda said: german.get(said, said)))
    page.text_of.cache_clear()
    for name in ("a.html", "b.html"):
        (tmp_path / name).write_text("<h2>Numbers</h2>", encoding="utf-8")
    source = 'print(json.dumps({"event": "result", "paths": {"report": "a.html", "table": "a.csv"}}))'
    run_engine(stand_in(tmp_path, source), [command], Feedback(), tmp_path)
    source = 'print(json.dumps({"event": "error", "message": "no (report: b.html)", "exit_status": 3}))'
    with pytest.raises(RunError):
        run_engine(stand_in(tmp_path, source), [command], Feedback(), tmp_path)
    said = [(tmp_path / name).read_text(encoding="utf-8") for name in ("a.html", "b.html")]
    assert said == [f"<h2>{spoken}</h2>"] * 2
    page.text_of.cache_clear()


def seen_while_waiting(tmp_path: Path, first: dict[str, Any], then: dict[str, Any], to: float) -> Feedback:
    """Run an engine that tells of progress twice, again once the bar has moved between 45 and `to`."""
    engine = stand_in(
        tmp_path,
        f"""
        print(json.dumps({{"event": "progress", **{first!r}}}))
        while not os.path.exists("moved"):
            time.sleep(0.01)
        print(json.dumps({{"event": "progress", **{then!r}}}))
        print(json.dumps({{"event": "result"}}))
        """,
    )
    feedback = Feedback()

    def on_progress(percent: float) -> None:
        if sum(45.0 < each < to for each in feedback.percent) >= 5:
            (tmp_path / "moved").touch()

    feedback.progressChanged.connect(on_progress)
    run_engine(engine, [], feedback, tmp_path)
    return feedback


def test_the_bar_goes_on_while_a_stage_says_nothing_and_not_too_far(tmp_path: Path) -> None:
    begun, ended = ({"stage": "refining", "done": done, "total": 2} for done in (0, 2))
    feedback = seen_while_waiting(tmp_path, begun, ended, 60.0)
    assert "Refining" in feedback.lines
    assert feedback.percent == sorted(feedback.percent)
    assert not [each for each in feedback.percent if 60.0 <= each < 75.0]
    assert feedback.percent[-1] == 75.0


def test_refining_begins_where_matching_ends(tmp_path: Path) -> None:
    matched = {"stage": "matching", "done": 1, "total": 1}
    feedback = seen_while_waiting(tmp_path, matched, {"stage": "refining", "done": 0, "total": 2}, 75.0)
    assert feedback.lines.count("Refining") == 1
    assert feedback.percent == sorted(feedback.percent)
    assert feedback.percent[-1] < 75.0


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ('print(json.dumps({"event": "error", "message": "no overlap", "exit_status": 2}))', "^no overlap$"),
        (
            'print(json.dumps({"event": "error", "message": "12 points agree", "exit_status": 3}))',
            "refused, and nothing was corrected: 12 points agree",
        ),
        (
            '[print(f"line {i}", file=sys.stderr) for i in range(30)]; sys.exit(7)',
            r"status 7 and without a result\.\nIts last lines:\nline 10\n(line \d+\n){18}line 29$",
        ),
        (
            'print("Traceback", file=sys.stderr)\n'
            'print(json.dumps({"event": "error", "message": "unexpected KeyError", "exit_status": 1}))',
            "^unexpected KeyError\nIts last lines:\nTraceback$",
        ),
    ],
)
def test_errors_say_what_the_engine_said(tmp_path: Path, source: str, said: str) -> None:
    with pytest.raises(RunError, match=said):
        run_engine(stand_in(tmp_path, source), [], Feedback(), tmp_path, SHARES)


def test_an_engine_that_does_not_start_is_told(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="does not start"):
        run_engine(Engine((str(tmp_path / "none"),), "test"), [], Feedback(), tmp_path, SHARES)


def test_cancelling_closes_standard_input(tmp_path: Path, mark: str) -> None:
    engine = stand_in(
        tmp_path,
        """
        print("ready", file=sys.stderr, flush=True)
        sys.stdin.read()
        print(json.dumps({"event": "cancelled"}))
        """,
    )
    feedback = Feedback()
    feedback.on_console = lambda line: feedback.cancel()
    assert run_engine(engine, [], feedback, tmp_path, SHARES) is None
    assert processes(mark) in ([], [os.getpid()])


def test_an_engine_that_does_not_listen_is_killed_with_its_children(
    tmp_path: Path, mark: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = stand_in(
        tmp_path,
        """
        said = "import sys, time; print('ready', file=sys.stderr, flush=True); time.sleep(36_000)"
        subprocess.Popen([sys.executable, "-c", said])  # both are there once it speaks
        time.sleep(36_000)
        """,
    )
    feedback = Feedback()
    seen: list[int] = []

    def cancel(line: str) -> None:
        seen.append(len(processes(mark)))
        feedback.cancel()

    feedback.on_console = cancel
    shorter = lambda *given, **named: child.follow(*given, **named, grace_s=0.3)  # noqa: E731
    monkeypatch.setattr("pcwlad_geo_qgis.process.protocol.follow", shorter)
    assert run_engine(engine, [], feedback, tmp_path, SHARES) is None
    assert seen == [2]
    assert count_until(mark, 0) == 0


def test_a_grandchild_that_keeps_the_pipes_open_does_not_hold_the_user_up(tmp_path: Path, mark: str) -> None:
    engine = stand_in(
        tmp_path,
        """
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(36_000)"])
        print(json.dumps({"event": "result", "status": "registered"}))
        """,
    )
    result: list[object] = []
    thread = threading.Thread(
        target=lambda: result.append(run_engine(engine, [], Feedback(), tmp_path, SHARES)), daemon=True
    )
    thread.start()
    thread.join(PATIENCE_S)
    left = processes(mark)
    for process in left:
        os.kill(process, signal.SIGKILL)
    assert left == []
    assert result == [{"event": "result", "status": "registered"}]


def test_a_line_that_comes_as_the_reader_ends_is_not_lost(tmp_path: Path) -> None:
    lines: queue.Queue[tuple[object, str]] = queue.Queue()
    seen: list[str] = []

    class Reader:
        """Reads its last line, and ends, while it is asked whether it has."""

        asked = 0

        def is_alive(self) -> bool:
            self.asked += 1
            if self.asked == 1:
                lines.put((seen.append, "the last line"))
            return False

    ended = subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE)
    ended.wait()
    child._hand_over(ended, [Reader()], lines, Feedback(), 0.0, lambda: None)  # type: ignore[list-item, arg-type]
    ended.stdin.close()  # type: ignore[union-attr]
    assert seen == ["the last line"]


def test_the_bar_moves_within_a_stage_of_which_there_is_no_news() -> None:
    feedback = Feedback()
    said = _Conversation(feedback, SHARES)
    said.on_out('{"event": "progress", "stage": "matching", "done": 0, "total": 1}')
    for _ in range(200):
        said.on_wait()
    assert feedback.percent == sorted(feedback.percent)
    assert sum(10 < percent < 60 for percent in feedback.percent) >= 100
    assert feedback.percent[-1] > 35
