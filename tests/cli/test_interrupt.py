"""Interrupts in one process: what the main thread sees, what the watching threads do, what is put back."""

from __future__ import annotations

import _thread
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator

import pytest

from pcwlad_geo.cli import interrupts
from pcwlad_geo.cli.guard import SIGNALS
from pcwlad_geo.cli.interrupts import WATCHER, cancellable
from tests.patience import PATIENCE_S

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


@pytest.fixture(autouse=True)
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test is ended by force because the machine is slow."""
    monkeypatch.setattr(interrupts, "GRACE_S", PATIENCE_S)
    monkeypatch.setattr(interrupts, "CLEANING_S", PATIENCE_S)


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[object]]:
    """What happened at a forced end: what the clean-up appends, and the exit status."""
    happened: list[object] = []
    monkeypatch.setattr(os, "_exit", happened.append)
    return happened


@pytest.fixture
def standard_input() -> Iterator[int]:
    """A pipe in the place of standard input: its end to write to."""
    reader, writer = os.pipe()
    before = os.dup(0)
    os.dup2(reader, 0)
    os.close(reader)
    yield writer
    os.dup2(before, 0)
    os.close(before)


def watchers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == WATCHER]


def nothing() -> None:
    pytest.fail("nothing is to be ended by force")


@pytest.mark.parametrize("number", SIGNALS)
def test_an_interrupt_reaches_the_main_thread(number: int) -> None:
    with pytest.raises(KeyboardInterrupt), cancellable(nothing):
        os.kill(os.getpid(), number)


@pytest.mark.parametrize("first", SIGNALS)
@pytest.mark.parametrize("second", SIGNALS)
def test_a_second_interrupt_does_not_break_off_the_cleaning_up(first: int, second: int) -> None:
    cleaned = []
    with cancellable(nothing):
        try:
            os.kill(os.getpid(), first)
        except KeyboardInterrupt:
            assert [signal.getsignal(each) for each in SIGNALS] == [signal.SIG_IGN] * 2
            os.kill(os.getpid(), second)
            cleaned.append("all of it")
    assert cleaned == ["all of it"]


@pytest.mark.parametrize("interrupted", [False, True])
def test_everything_is_put_back(interrupted: bool) -> None:
    before = [signal.getsignal(each) for each in SIGNALS]
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    outer = signal.set_wakeup_fd(writer.fileno())
    try:
        with cancellable(nothing):
            (watcher,) = watchers()
            assert watcher.daemon
            if interrupted:
                with pytest.raises(KeyboardInterrupt):
                    os.kill(os.getpid(), signal.SIGINT)
        assert not watcher.is_alive()
    finally:
        assert signal.set_wakeup_fd(outer) == writer.fileno()
        reader.close()
        writer.close()
    assert [signal.getsignal(each) for each in SIGNALS] == before


def test_a_command_run_in_another_thread_leaves_the_signals_as_they_are() -> None:
    before, during = [signal.getsignal(each) for each in SIGNALS], []

    def command() -> None:
        with cancellable(nothing):
            during.extend([*(signal.getsignal(each) for each in SIGNALS), len(watchers())])

    thread = threading.Thread(target=command)
    thread.start()
    thread.join(PATIENCE_S)
    assert during == [*before, 0]


def test_a_main_thread_that_is_stuck_is_ended_after_its_grace(
    ended: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interrupts, "GRACE_S", 0.0)
    done = threading.Event()

    def clean() -> None:
        ended.append(threading.current_thread().daemon)

    def leave(status: int) -> None:
        ended.append(status)
        done.set()

    monkeypatch.setattr(os, "_exit", leave)
    with cancellable(clean):
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        assert done.wait(PATIENCE_S)  # the work that does not notice
    assert ended == [True, 130]


def watch(received: list[int], ended: list[object], *, finished: bool = False) -> None:
    """Let the watcher see these signals, after which no more can come."""
    reader, writer = socket.socketpair()
    writer.sendall(bytes(received))
    writer.close()
    done = threading.Event()
    if finished:
        done.set()
    interrupts._watch_signals(reader, done, lambda: ended.append("cleaned"))
    assert reader.fileno() == -1


@pytest.mark.parametrize(
    ("received", "forced"),
    [
        ([], False),
        ([signal.SIGUSR1], False),
        ([signal.SIGINT], True),
        ([signal.SIGTERM], True),
        ([signal.SIGUSR1, signal.SIGINT], True),
        ([signal.SIGINT, signal.SIGINT], True),
    ],
)
def test_the_watcher_ends_what_does_not_finish(
    received: list[int], forced: bool, ended: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interrupts, "GRACE_S", 0.0)
    watch(received, ended)
    assert ended == (["cleaned", 130] if forced else [])
    ended.clear()
    watch(received, ended, finished=True)
    assert ended == []


def test_the_process_does_not_end_before_it_is_cleaned_up(ended: list[object]) -> None:
    started = threading.Event()

    def clean() -> None:
        started.wait(0.2)  # nobody sets it: the cleaning up takes a while
        ended.append("cleaned")

    interrupts._end_process(clean)
    assert ended == ["cleaned", 130]


def test_cleaning_up_that_never_ends_is_not_waited_for(
    ended: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interrupts, "CLEANING_S", 0.0)
    over = threading.Event()
    interrupts._end_process(lambda: over.wait(PATIENCE_S) and None)
    assert ended == [130]
    over.set()


def test_the_end_of_standard_input_wakes_a_waiting_main_thread(standard_input: int) -> None:
    with cancellable(nothing, watch_stdin=True):
        assert [thread.daemon for thread in watchers()] == [True, True]
        os.write(standard_input, b"no end yet")
        # The interrupt may come as soon as standard input is closed, so both statements stand inside.
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012
            os.close(standard_input)
            threading.Event().wait(PATIENCE_S)


def test_standard_input_is_read_to_its_end_and_that_is_nothing_after_the_run(standard_input: int) -> None:
    os.write(standard_input, bytes(5000))
    os.close(standard_input)
    finished = threading.Event()
    finished.set()
    interrupts._watch_stdin(finished)
    assert os.read(0, 1) == b""


def test_the_main_thread_is_interrupted_where_threads_cannot_be_signalled(
    standard_input: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows."""
    interrupted: list[str] = []
    monkeypatch.delattr(signal, "pthread_kill")
    monkeypatch.setattr(_thread, "interrupt_main", lambda: interrupted.append("main"))
    os.close(standard_input)
    interrupts._watch_stdin(threading.Event())
    assert interrupted == ["main"]
