"""The processes of a command: a tree below its first one, as /proc shows it. Linux only."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True, slots=True)
class Usage:
    """What a tree of processes holds at a moment."""

    memory_mb: float
    """Resident memory of the first process: that of forks is mostly the same pages."""
    files: int
    """Open files of the first process."""
    processes: int


def descendants(process: int) -> list[int]:
    """Return the processes below one, at any depth."""
    found: list[int] = []
    todo = [process]
    while todo:
        for task in _listed(Path(f"/proc/{todo.pop()}/task")):
            with suppress(OSError):
                children = [int(each) for each in (task / "children").read_text().split()]
                found += children
                todo += children
    return found


def usage(process: int) -> Usage | None:
    """Return what a process and those below it hold; None where it has ended."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return None
    files = len(_listed(Path(f"/proc/{process}/fd")))
    return Usage(pages * _PAGE / 2**20, files, 1 + len(descendants(process)))


def still_alive(processes: list[int], patience_s: float) -> list[int]:
    """Return those of some processes that have not ended after a while."""
    until = time.monotonic() + patience_s
    while True:
        left = [each for each in processes if _is_alive(each)]
        if not left or time.monotonic() > until:
            return left
        time.sleep(0.05)


def _is_alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def _listed(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []
