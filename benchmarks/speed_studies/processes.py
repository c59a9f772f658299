"""Run a command as its own process and measure it with all that it starts. Linux only.

CPU time is what the kernel accounts to each process at its end; processes that outlive their parent are
waited for as well. Memory is the largest sum, over the processes alive at a time, of their proportional set
sizes (PSS: what they share is counted once).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

PR_SET_CHILD_SUBREAPER: Final = 36
INTERVAL_S: Final = 0.05
SHARE_OF_A_CORE: Final = 0.03
"""The kernel walks all pages for a PSS: no oftener than this lets it."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What a command cost."""

    wall_s: float
    cpu_s: float
    """User and system time of all its processes."""
    peak_mb: float
    """Largest sum of PSS, 10^6 bytes."""
    status: int
    """Exit status; negative: the signal that ended it."""
    output: str
    """Standard output."""
    errors: str
    """Standard error."""

    @property
    def reason(self) -> str:
        """The last line that a failed command wrote."""
        lines = (self.errors or self.output).strip().splitlines()
        return lines[-1] if lines else f"exit status {self.status}"


def measure(
    command: Sequence[str], *, environment: Mapping[str, str] | None = None, folder: Path | None = None
) -> Measured:
    """Run a command to its end; this process may start nothing else meanwhile.

    Parameters
    ----------
    command : sequence of str
    environment : mapping, optional
        Environment variables that differ from this process's own.
    folder : pathlib.Path, optional
        Working folder.
    """
    others = frozenset(_children(os.getpid()))
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors, _adopting_orphans():
        begun = time.perf_counter()
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=errors,
            cwd=folder,
            env=os.environ | dict(environment or {}),
        )
        with _Sampler(others) as sampler:
            _, status, usage = os.wait4(process.pid, 0)
            wall_s = time.perf_counter() - begun
            cpu_s = usage.ru_utime + usage.ru_stime + sum(_orphans(others))
        process.returncode = os.waitstatus_to_exitcode(status)
        texts = []
        for file in (output, errors):
            file.seek(0)
            texts.append(file.read().decode(errors="replace"))
    return Measured(wall_s, cpu_s, sampler.peak_bytes / 1e6, process.returncode, texts[0], texts[1])


@contextlib.contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Let this process and all that it starts use so many of its cores."""
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(usable)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, usable)


@contextlib.contextmanager
def _adopting_orphans() -> Iterator[None]:
    """Be the parent of descendants whose own parent ends."""
    control = ctypes.CDLL(None, use_errno=True).prctl
    if control(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "orphans cannot be waited for")
    try:
        yield
    finally:
        control(PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


def _orphans(others: frozenset[int]) -> Iterator[float]:
    """Wait for the processes that the command left behind; yields the CPU time of each."""
    while left := set(_children(os.getpid())) - others:
        for pid in left:
            _, _, usage = os.wait4(pid, 0)
            yield usage.ru_utime + usage.ru_stime


@dataclass(slots=True)
class _Sampler:
    """Watches the memory of all descendants of this process but `others`, in a thread."""

    others: frozenset[int]
    peak_bytes: int = 0
    _done: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    def __enter__(self) -> _Sampler:
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        if self._thread is not None:
            self._thread.join()

    def _watch(self) -> None:
        pause_s = INTERVAL_S
        while not self._done.wait(pause_s):
            begun = time.thread_time()
            tree = list(_descendants(set(_children(os.getpid())) - self.others))
            # a sum of PSS is never above the sum of RSS, which costs the kernel nothing
            if sum(map(_rss_bytes, tree)) > self.peak_bytes:
                self.peak_bytes = max(self.peak_bytes, sum(map(_pss_bytes, tree)))
            pause_s = max(INTERVAL_S, (time.thread_time() - begun) / SHARE_OF_A_CORE)


def resident_mb(pid: int) -> float:
    """Return the memory that a process holds, 10^6 bytes."""
    return _rss_bytes(pid) / 1e6


def _children(pid: int) -> Iterator[int]:
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # the thread, or the process, has just ended
            yield from map(int, children.read_text().split())


def _descendants(pids: Iterable[int]) -> Iterator[int]:
    """Yield the processes and all that they started."""
    for pid in pids:
        yield pid
        yield from _descendants(_children(pid))


def _rss_bytes(pid: int) -> int:
    with contextlib.suppress(OSError, IndexError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def _pss_bytes(pid: int) -> int:
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) * 1024
    return 0
