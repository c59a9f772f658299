"""A process with all libraries loaded, and a fork of it for each command: a start takes milliseconds.

The fork does what the console script does, `pcwlad_geo.__main__.main`, with standard streams, working folder
and temporary folder of its own. Threads do not survive a fork and the locks that they hold do, so the warm-up
must leave the server with one thread: see `warm_up`.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import gc
import io
import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from pathlib import Path
from typing import Any, Final, NoReturn

from fuzz.kept import SEEDS
from fuzz.orders import CASE, Limits, Order, Outcome
from fuzz.recipes import REQUESTS

LOOK_EVERY_S: Final = 0.05
"""How often the memory of a command is looked at."""
SAY_WHERE_S: Final = 0.5
"""How long a command that hangs may take to say where."""
MAX_FILE_BYTES: Final = 1 << 30
"""Of a file that a command writes: the disk belongs to others too."""
_PAGE: Final = os.sysconf("SC_PAGE_SIZE")
_BECOME_PARENT_OF_ORPHANS: Final = 36  # PR_SET_CHILD_SUBREAPER


def serve() -> None:
    """Answer orders, a line of JSON each on standard input, until its end."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    _adopt_orphans()
    figures = warm_up()
    answers.write(json.dumps({"threads": len(list(Path("/proc/self/task").iterdir()))}) + "\n")
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        order = Order.from_json(line)
        answers.write(json.dumps(run(order, figures).to_json()) + "\n")


def warm_up() -> str:
    """Do each kind of job once, so that forks find all loaded; return a figure to show instead of others.

    Nothing is warped to a file: GDAL's writers start threads that stay.
    """
    sys.path[:] = [each for each in sys.path if each not in ("", str(Path(__file__).parent))]
    import cv2

    cv2.setNumThreads(1)
    import pcwlad_geo
    import pcwlad_geo.__main__
    import pcwlad_geo.band_warping
    import pcwlad_geo.cli.app
    import pcwlad_geo.multi.batch.run
    import pcwlad_geo.multi.watch.trend
    from pcwlad_geo.report import page

    with contextlib.redirect_stdout(io.StringIO()):  # what the command line itself loads
        for command in ("register", "match", "warp", "qa", "batch"):
            pcwlad_geo.cli.app.app([command, "--help"], standalone_mode=False)
    kept: dict[str, Any] = {}
    figures_of = page._figures

    def keep(*arguments: Any) -> dict[str, str | None]:
        kept.update(figures_of(*arguments))
        return figures_of(*arguments)

    page._figures = keep
    options: Any = {"features": 40, "window": 41, "template": 61, "jobs": 1}
    with tempfile.TemporaryDirectory() as place:
        for name in ("ref.tif", "strip.tif", "rpc.tif", "dem.tif", "qgis.points"):
            shutil.copy(SEEDS / name, place)
        pair = [str(Path(place) / name) for name in ("ref.tif", "strip.tif")]
        with contextlib.suppress(pcwlad_geo.RequirementError):
            pcwlad_geo.register(*pair, out_dir=Path(place) / "a", require=["points>=100000"], **options)
        pcwlad_geo.match(pair[0], Path(place) / "rpc.tif",
                         dem=Path(place) / "dem.tif",
                         dem_vertical=45.0, prealign="search", **options)  # fmt: skip
        pcwlad_geo.qa(pair, out_dir=Path(place) / "c", **options)
    page._figures = figures_of
    figure = kept["coverage"]
    if not isinstance(figure, str):
        raise TypeError("the warm-up has drawn no figure")
    return figure


def run(order: Order, figure: str) -> Outcome:
    """Run a command in a fork and wait for its end, bounded in time and memory."""
    since = time.monotonic()
    process = os.fork()
    if process == 0:
        _be_the_command(order, figure)
    ended = _watch(process, order.limits)
    _, status, used = os.wait4(process, 0)
    left = _end_orphans()
    code = os.waitstatus_to_exitcode(status)
    return Outcome(
        status=code if code >= 0 else None,
        signal=-code if code < 0 and ended is None else None,
        ended=ended,
        seconds=round(time.monotonic() - since, 3),
        peak_mb=used.ru_maxrss // 1024,
        processes_left=left,
    )


def _watch(process: int, limits: Limits) -> str | None:
    """Wait for the end of a process; end it where it exceeds a limit, and return which."""
    handle = os.pidfd_open(process)
    until = time.monotonic() + limits.seconds
    try:
        while not select.select([handle], [], [], LOOK_EVERY_S)[0]:
            if _memory_mb(process) > limits.memory_mb:
                return _end(process, handle, "memory")
            if time.monotonic() > until:
                return _end(process, handle, "hang")
    finally:
        os.close(handle)
    return None


def _memory_mb(process: int) -> int:
    try:
        resident = Path(f"/proc/{process}/statm").read_text().split()[1]
    except (OSError, IndexError):
        return 0
    return int(resident) * _PAGE >> 20


def _end(process: int, handle: int, why: str) -> str:
    os.kill(process, signal.SIGUSR1)  # faulthandler writes where it is
    select.select([handle], [], [], SAY_WHERE_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
    return why


def _adopt_orphans() -> None:
    """Become the parent of processes whose own has ended, to notice what a command leaves behind."""
    import ctypes

    ctypes.CDLL(None).prctl(_BECOME_PARENT_OF_ORPHANS, 1, 0, 0, 0)


def _end_orphans() -> int:
    """End processes that a command has left; return how many were still there a moment after its end."""
    left = 0
    for attempt in range(100):
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        if not children:
            return left
        for child in map(int, children):
            if os.waitpid(child, os.WNOHANG)[0]:
                continue
            if attempt > 20:  # workers end when they notice that their parent has
                left += attempt == 21
                os.kill(child, signal.SIGKILL)
        time.sleep(0.02)
    return left


def _be_the_command(order: Order, figure: str) -> NoReturn:
    """Be the command line in a fork: what this returns from is the end of the process."""
    status = 1
    try:
        _settle(order)
        if not order.figures:
            _show_instead(figure)
        status = _main(order.argv)
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(BaseException):
            threading._shutdown()  # type: ignore[attr-defined]
            atexit._run_exitfuncs()
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _settle(order: Order) -> None:
    folder = Path(order.folder)
    os.setsid()
    os.chdir(folder / CASE)
    asked = folder / CASE / REQUESTS
    given = os.open(asked if asked.is_file() else os.devnull, os.O_RDONLY)
    os.dup2(given, 0)
    for number, name in ((1, "stdout"), (2, "stderr")):
        made = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        os.dup2(made, number)
        os.close(made)
    where = (folder / "where").open("w")
    faulthandler.enable(where, all_threads=True)
    faulthandler.register(signal.SIGUSR1, where, all_threads=True)
    sys.stdin = io.TextIOWrapper(io.FileIO(0, closefd=False), encoding="utf-8")
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), encoding="utf-8")
    sys.stderr = io.TextIOWrapper(
        io.FileIO(2, "w", closefd=False), encoding="utf-8", errors="backslashreplace", line_buffering=True
    )
    os.environ["TMPDIR"] = str(folder / "tmp")
    tempfile.tempdir = None
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_FILE_BYTES, MAX_FILE_BYTES))


def _show_instead(figure: str) -> None:
    from pcwlad_geo.report import page

    shown: dict[str, str | None] = dict.fromkeys(page.OPTIONAL)
    page._figures = lambda *_: {**shown, "displacements": figure, "coverage": figure}  # type: ignore[assignment]


def _main(argv: tuple[str, ...]) -> int:
    from pcwlad_geo.__main__ import main

    sys.argv = ["pcwlad-geo", *argv]
    try:
        main()
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        print(end.code, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    serve()
