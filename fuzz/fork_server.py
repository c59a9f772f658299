"""A fork server as its client sees it, and a case run by one."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Final

from fuzz.cases import Case
from fuzz.judge import Failure, judge
from fuzz.orders import CASE, Limits, Order, Outcome

REPOSITORY: Final = Path(__file__).resolve().parents[1]
_POOLS: Final = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "GDAL_NUM")
MAX_SAID: Final = 20_000
"""Characters of each stream that are kept."""


class ForkServer:
    """Runs commands one after another; a context manager.

    Parameters
    ----------
    place : pathlib.Path
        An empty folder of its own.
    module : str
        What it is, when it is run.
    """

    def __init__(self, place: Path, module: str = "fuzz.server") -> None:
        self._place = place
        threads = {f"{pool}_THREADS": "1" for pool in _POOLS}
        paths = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
        self._process = subprocess.Popen(
            [sys.executable, "-m", module],
            cwd=REPOSITORY,
            env={**os.environ, **threads, "PYTHONPATH": paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.threads = 0
        """Threads of the server when it is warm; more than one may hold locks that its forks wait for."""

    def __enter__(self) -> ForkServer:
        self.threads = json.loads(self._read())["threads"]
        if self.threads != 1:
            raise RuntimeError(f"the fork server has {self.threads} threads after its warm-up, not one")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        if kind is not None:
            self._process.terminate()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def run(self, case: Case, limits: Limits) -> tuple[Outcome, list[Failure]]:
        """Run a case in a fresh folder, and judge it."""
        folder = self._place / "run"
        shutil.rmtree(folder, ignore_errors=True)
        lay_out(case, folder)
        if self._process.stdin is None:
            raise RuntimeError("the fork server was started without a pipe")
        self._process.stdin.write(Order(str(folder), case.argv, case.figures, limits).to_json() + "\n")
        self._process.stdin.flush()
        outcome = replace(Outcome(**json.loads(self._read())), **_said(folder))
        failures = judge(case, outcome, folder)
        shutil.rmtree(folder, ignore_errors=True)
        return outcome, failures

    def _read(self) -> str:
        line = self._process.stdout.readline() if self._process.stdout else ""
        if not line:
            raise RuntimeError(f"the fork server has ended with status {self._process.wait()}")
        return line


def lay_out(case: Case, folder: Path) -> None:
    """Write the files of a case into the folder of a run."""
    put_files(case, folder / CASE)
    (folder / "tmp").mkdir()


def put_files(case: Case, inside: Path) -> None:
    """Write the files of a case into a folder, and what stands in the place of a file."""
    inside.mkdir(parents=True, exist_ok=True)
    for name, data in case.files.items():
        path = inside / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    for name, kind in case.places.items():
        path = inside / name
        path.parent.mkdir(parents=True, exist_ok=True)
        put_in_place(path, kind)


def put_in_place(path: Path, kind: str) -> None:
    """Put something else in the place of a file: one of `fuzz.cases.PLACES`."""
    if path.exists() or path.is_symlink():
        return
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "empty":
        path.touch()
    elif kind == "link to itself":
        path.symlink_to(path.name)
    elif kind == "link to nothing":
        path.symlink_to("nothing")
    elif kind == "link to /dev/zero":
        path.symlink_to("/dev/zero")
    elif kind == "socket":
        before = Path.cwd()
        os.chdir(path.parent)  # the address of a socket is short
        try:
            with socket.socket(socket.AF_UNIX) as made:
                made.bind(path.name)
        finally:
            os.chdir(before)


def _said(folder: Path) -> dict[str, str]:
    said = {}
    for name in ("stdout", "stderr", "where"):
        file = folder / name
        text = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
        said[name] = text[:MAX_SAID]
    return said
