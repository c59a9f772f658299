"""The tests of a module run on a mutant of it, in processes forked from one that has loaded the libraries."""

from __future__ import annotations

import compileall
import ctypes
import math
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

REPOSITORY: Final = Path(__file__).resolve().parents[1]
NEEDED: Final = ("pcwlad_geo", "tests", "pyproject.toml")
"""What the tests need of the repository."""
NOT_LOADED: Final = ("cacheprovider", "xdist", "hypothesispytest")
"""Plugins that these tests can do without: the last one takes longer to import than most of them run."""
SURVIVED: Final = 0
KILLED: Final = 1
HUNG: Final = 2
"""Exit statuses of a trial."""
_PR_SET_CHILD_SUBREAPER: Final = 36


@dataclass(frozen=True, slots=True)
class Limits:
    """How long the tests of a mutant may take."""

    wall_s: float
    """All of them, by the clock: for what waits in vain."""
    processor_s: float
    """Each process of them: what turns in circles is ended long before, however busy the machine is."""

    def impose(self) -> None:
        """Hold this process and those that it starts to the processor time."""
        most = math.ceil(self.processor_s)
        resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # which the signal would have written


@dataclass(frozen=True, slots=True)
class Bench:
    """A copy of the repository, in which one module is exchanged."""

    folder: Path
    module: str

    @classmethod
    def make(cls, folder: Path, module: str) -> Bench:
        """Copy what the tests need; all but the module is compiled ahead."""
        for name in NEEDED:
            source = REPOSITORY / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                folder.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, folder / name)
        compileall.compile_dir(folder / "pcwlad_geo", quiet=2)
        path = folder / module
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            compiled.unlink()
        return cls(folder, module)

    def start(self, source: str, tests: tuple[str, ...], limits: Limits) -> int:
        """Start a trial of the module with this source; return its process, whose status is the outcome."""
        (self.folder / self.module).write_text(source, encoding="utf-8")
        process = os.fork()
        if process == 0:
            status = HUNG
            try:
                status = self._trial(tests, limits)
            finally:
                os._exit(status)
        return process

    def _trial(self, tests: tuple[str, ...], limits: Limits) -> int:
        parent = os.getppid()
        os.setsid()
        with suppress(OSError, AttributeError):  # what tests leave behind becomes a child of this process
            ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        child = os.fork()
        if child == 0:
            status = KILLED
            try:
                limits.impose()
                status = SURVIVED if self._run_tests(tests) == 0 else KILLED
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(status)
        status = _wait(child, limits.wall_s, parent)
        _end_children()
        return status

    def _run_tests(self, tests: tuple[str, ...]) -> int:
        scratch = self.folder / "scratch"
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        os.environ.update(PYTHONPATH=str(self.folder), TMPDIR=str(scratch), PYTHONDONTWRITEBYTECODE="1")
        sys.dont_write_bytecode = True
        tempfile.tempdir = None
        sys.path.insert(0, str(self.folder))
        os.chdir(self.folder)
        nothing = os.open(os.devnull, os.O_RDWR)
        log = os.open(self.folder / "log.txt", os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o666)
        for number, target in enumerate((nothing, log, log)):
            os.dup2(target, number)
        plugins = [word for name in NOT_LOADED for word in ("-p", f"no:{name}")]
        plain = ["-x", "-q", *plugins, "--basetemp", str(scratch / "tests")]
        status = int(pytest.main([*plain, *tests]))
        sys.stdout.flush()
        return status


def _wait(child: int, limit_s: float, parent: int) -> int:
    """Wait for the tests until the limit, or until there is no one who waits for the outcome."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end and os.getppid() == parent:
        done, status = os.waitpid(child, os.WNOHANG)
        if done and os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU:
            return HUNG
        if done:
            return SURVIVED if status == 0 else KILLED
        time.sleep(0.01)
    return HUNG


def _end_children() -> None:
    """End all processes below this one, also those that were left by their own parents."""
    while children := _children(os.getpid()):
        for child in children:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        for child in children:
            with suppress(ChildProcessError):
                os.waitpid(child, 0)


def _children(parent: int) -> list[int]:
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # the name of the command, in parentheses, may hold spaces
            if int(entry.read_text().rpartition(")")[2].split()[1]) == parent:
                found.append(int(entry.parent.name))
    return found
