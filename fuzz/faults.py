"""Fault injection, as SQLite does it: the n-th open, write, rename, fsync ... of a run fails, for every n.

``python fuzz/faults.py [--every K]`` registers a small pair over an earlier result, again and again, each
time with another call that fails (fuzz/faults/shim.c, preloaded), once or from there on. After each run the
output folder must hold the old results or the new ones, and nothing else, at the latest once the next run has
swept; the exit status must be 0 or 2, and 2 with one line on standard error that names the cause; ``batch``
may say it in a warning about the pair. The tie points of ``register`` come from a file, as the matching
writes nothing, save where allocations fail. Needs a C compiler and Linux.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).resolve().parent
KINDS: Final = {"open": 1, "write": 2, "rename": 3, "fsync": 4, "remove": 5, "make": 6, "allocation": 7}
"""Kinds of calls, and their numbers in the shim."""
ERRORS: Final = {"write": errno.ENOSPC, "make": errno.ENOSPC, "allocation": errno.ENOMEM}
"""What they fail with; EIO the others."""
MIN_BYTES: Final = 1 << 16
"""Allocations count from this size on: smaller ones abort in the C++ of libraries, whatever calls them."""
ENDED_BY_GDAL: Final = (-signal.SIGABRT, -signal.SIGSEGV)
"""How GDAL ends the process in places where it lacks memory: CPLMalloc aborts, the writer of COGs (3.10) goes
on with nothing. There is no message then, and the old results must be there."""
HANG_S: Final = 120
PRELOADED: Final = "PCWLAD_GEO_FAULTS"
OPTIONS: Final = ("--features", "40", "--window", "41", "--template", "61", "--model", "shift")
RUNNING: Final = ("--jobs", "1", "--progress", "none")
LOADED: Final = (
    "pcwlad_geo.band_warping",
    "pcwlad_geo.multi.batch.run",
    "pcwlad_geo.cli.app",
    "pcwlad_geo.registration.run",
    "pcwlad_geo.multi.stack.run",
    "pcwlad_geo.report.maps",
    "pcwlad_geo.report.page",
    "pcwlad_geo.job",
    "pcwlad_geo.outputs.write",
    "pyogrio",
    "PIL.Image",
    "sqlite3",
)
"""What each run needs, imported once before the forks; nothing of it starts a thread."""
PAGES: Final = ("report.html.j2", "views.html.j2", "numbers.html.j2", "advice.html.j2", "base.html.j2")
"""Templates that each run needs, compiled once before the forks."""
COMMANDS: Final = ("register", "match", "warp", "batch", "stack")
UNUSABLE: Final = ": unusable: "
"""What ``batch`` writes between a pair and why it cannot be used."""


@dataclass(slots=True)
class Tried:
    """What became of the runs of one kind of fault."""

    command: str
    kind: str
    for_ever: bool
    calls: int
    """That the whole run makes."""
    numbers: list[int] = field(default_factory=list)
    statuses: dict[int, int] = field(default_factory=dict)
    swept: int = 0
    """Runs that left something for the next one to sweep."""
    violations: list[str] = field(default_factory=list)

    def row(self) -> str:
        """Return the line of the table."""
        ends = ", ".join(f"{count} x {status}" for status, count in sorted(self.statuses.items()))
        how = "from n on" if self.for_ever else "n-th"
        return (
            f"{self.command:<9}{self.kind:<11}{how:<10}{self.calls:>7}{len(self.numbers):>7}{self.swept:>7}"
            f"{len(self.violations):>11}  {ends}"
        )


HEADER: Final = "command  kind       fails       calls  tried  swept violations  exits"


@dataclass(frozen=True, slots=True)
class Job:
    """A command that replaces results."""

    arguments: list[str]
    matching: list[str]
    """The same command with its matching, where that can be left out: tie points of a file are as good."""
    old: Path
    """The folder as an earlier run has left it; copied for each run."""


@dataclass(frozen=True, slots=True)
class Ended:
    """The end of one run."""

    status: int
    calls: int
    said: str


def find_compiler() -> str | None:
    """Return a C compiler, if there is one and this is a system that can preload."""
    return shutil.which("cc") if sys.platform == "linux" else None


def build_shim(folder: Path) -> Path:
    """Compile the shim into a folder."""
    library = folder / "shim.so"
    source = HERE / "faults" / "shim.c"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    return library


def arm(kind: str, number: int, root: Path, *, for_ever: bool) -> None:
    """Let the n-th call of a kind below a root fail; 0: none, they are counted only."""
    library, code = ctypes.CDLL(None), ERRORS.get(kind, errno.EIO)
    below = f"{root}/".encode()
    library.faults_arm(
        KINDS[kind], ctypes.c_long(number), code, int(for_ever), ctypes.c_size_t(MIN_BYTES), below
    )


def disarm() -> int:
    """Count no more; return how many calls were counted."""
    library = ctypes.CDLL(None)
    count = int(library.faults_count())
    library.faults_arm(0, ctypes.c_long(0), 0, 0, ctypes.c_size_t(0), b"")
    return count


def run_forked(work: Callable[[], int], folder: Path, log: Path) -> tuple[int, str]:
    """Run something in a fork of this process; return its status (minus a signal) and its standard error."""
    child = os.fork()
    if not child:
        status = 70
        try:
            os.chdir(folder)
            os.setsid()
            output = os.open(log, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
            nothing = os.open(os.devnull, os.O_RDWR)
            for number, descriptor in ((0, nothing), (1, nothing), (2, output)):
                os.dup2(descriptor, number)
            status = work()
        finally:
            os._exit(status)
    until = time.monotonic() + HANG_S
    while time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), log.read_text(errors="replace")
        time.sleep(0.005)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -signal.SIGALRM, "hangs"


def run_command(
    arguments: Sequence[str], case: Path, kind: str | None = None, number: int = 0, *, for_ever: bool = False
) -> Ended:
    """Run the command line in a fork, with a fault or without."""
    counts, log = case.with_name("count"), case.with_name("said")

    def work() -> int:
        from pcwlad_geo.cli.app import run

        if kind is not None:
            arm(kind, number, case, for_ever=for_ever)
        try:
            return run(arguments)
        finally:
            if kind is not None:
                counts.write_text(str(disarm()))

    counts.unlink(missing_ok=True)
    status, said = run_forked(work, case, log)
    return Ended(status, int(counts.read_text()) if counts.exists() else 0, said)


def sweep(case: Path) -> None:
    """Do what the next run does before anything else."""

    def work() -> int:
        from pcwlad_geo.errors import OutputError
        from pcwlad_geo.outputs.folder import OutputFolder, stage_inside

        below = [each.relative_to(case) for each in case.rglob("*") if each.is_dir()]  # pairs of a batch, too
        for folder in [case / each for each in below if not any(name.startswith(".") for name in each.parts)]:
            for enter in (OutputFolder, stage_inside):
                with suppress(OutputError), enter(folder):
                    pass
        with stage_inside(case):
            pass
        return 0

    run_forked(work, case, case.with_name("said"))


def files_of(folder: Path) -> dict[str, bytes]:
    """Return all files below a folder, hidden ones too."""
    return {str(each.relative_to(folder)): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


def state_of(case: Path, old: Path) -> str:
    """Return "old", "new", or what is wrong with the results."""
    now, before = files_of(case), files_of(old)
    hidden = sorted(name for name in now if any(part.startswith(".") for part in Path(name).parts))
    hidden += [str(each.relative_to(case)) for each in case.rglob(".*") if each.is_dir()]
    if hidden:
        return f"left behind: {', '.join(hidden)}"
    if now == before:
        return "old"
    wrong = []
    for report in case.rglob("report.json"):
        listed = set(json.loads(report.read_text())["outputs"])
        there = {each.name for each in report.parent.iterdir()}
        if listed != there:
            wrong.append(f"report.json and its files differ: {sorted(listed ^ there)}")
    if set(now) ^ set(before):
        wrong.append(f"other files: {sorted(set(now) ^ set(before))}")
    return "; ".join(wrong) or "new"


def same_pixels(one: bytes, other: bytes) -> bool:
    """Return whether two files are rasters of the same pixels: blocks may be compressed in several ways."""
    import numpy as np
    import rasterio
    from rasterio.errors import RasterioIOError

    try:
        files = rasterio.MemoryFile(one), rasterio.MemoryFile(other)
        with files[0].open() as now, files[1].open() as before:
            return now.profile == before.profile and np.array_equal(now.read(), before.read())
    except (RasterioIOError, ValueError):
        return False


def damage_of(case: Path, undisturbed: dict[str, bytes]) -> str | None:
    """Say which files are not those of a run without a fault; files that hold the time are left out."""
    now = files_of(case)
    timed = ("report.json", "report.html", ".gpkg", "summary.csv")
    other = [name for name in now if not name.endswith(timed) and now[name] != undisturbed.get(name)]
    other = [name for name in other if not same_pixels(now[name], undisturbed.get(name, b""))]
    return f"damaged: {', '.join(sorted(other))}" if other else None


def told(command: str, said: str) -> list[str]:
    """Return the lines that tell why a command has ended; what ``batch`` says of its only pair is one."""
    lines = [line for line in said.splitlines() if not line.startswith("warning: ")]
    if command == "batch" and not lines:
        return [line.replace("warning: ", "error: ", 1) for line in said.splitlines() if UNUSABLE in line]
    return lines


def judge(ended: Ended, state: str, kind: str, command: str = "register") -> list[str]:
    """Return what is wrong with the end of a run."""
    wrong = [state] if state not in ("old", "new") else []
    if kind == "allocation" and ended.status in ENDED_BY_GDAL and state == "old":
        return wrong
    if ended.status not in (0, 2):
        wrong.append(f"exit status {ended.status}: {ended.said.strip()[:200]}")
    lines = told(command, ended.said)
    if ended.status == 2:
        # SQLite and libtiff do not pass the system's words on; the message then asks about the disk
        system = (os.strerror(ERRORS.get(kind, errno.EIO)).lower(), "is the disk full")
        causes = ("memory",) if kind == "allocation" else system
        if len(lines) != 1 or not lines[0].startswith("error: "):
            wrong.append(f"{len(lines)} lines: {ended.said.strip()[:300]}")
        elif not any(cause in lines[0].lower() for cause in causes):
            wrong.append(f"the cause is not named: {lines[0]}")
    elif ended.status == 0 and lines:
        wrong.append(f"says {ended.said.strip()[:200]}")
    if state == "old" and ended.status == 0:
        wrong.append("exit status 0 with the old results")
    return wrong


def numbers_to_try(calls: int, every: int) -> Iterator[int]:
    """Return the first ones, every K-th, and the last ones: where most happens."""
    kept = {1, 2, 3, *range(1, calls + 1, every), *range(calls - 2, calls + 1)}
    return iter(sorted(number for number in kept if 1 <= number <= calls))


def try_kind(command: str, job: Job, kind: str, folder: Path, every: int, *, for_ever: bool) -> Tried:
    """Let the calls of one kind fail, one after another."""
    case = folder / "case"
    arguments = job.matching if kind == "allocation" else job.arguments

    def fresh() -> None:
        shutil.rmtree(case, ignore_errors=True)
        shutil.copytree(job.old, case)

    fresh()
    whole = run_command(arguments, case, kind)
    tried = Tried(command, kind, for_ever, whole.calls)
    if whole.status or state_of(case, job.old) != "new":
        tried.violations.append(f"without a fault: {whole.status} {whole.said} {state_of(case, job.old)}")
        return tried
    undisturbed = files_of(case)
    for number in numbers_to_try(whole.calls, every):
        fresh()
        ended = run_command(arguments, case, kind, number, for_ever=for_ever)
        state = state_of(case, job.old)
        if state.startswith("left behind"):
            tried.swept += 1
            sweep(case)
            state = state_of(case, job.old)
        if state == "new":
            state = damage_of(case, undisturbed) or state
        tried.numbers.append(number)
        tried.statuses[ended.status] = tried.statuses.get(ended.status, 0) + 1
        tried.violations += [
            f"{command} {kind} {number}: {each}" for each in judge(ended, state, kind, command)
        ]
    return tried


def make_job(command: str, folder: Path) -> Job:
    """Write a pair and the results of an earlier run, and return the command that replaces them."""
    import numpy as np

    from tests.scenes import make_grid, render, write

    inputs, old, grid = folder / "inputs", folder / "old", make_grid((120, 120))
    for each in (inputs, old):
        each.mkdir(parents=True, exist_ok=True)
    reference = write(inputs / "b4.tif", render(grid), grid)
    target = write(inputs / "b10.tif", np.asarray(255 - render(grid, displacement_px=(1.3, -0.6))), grid)
    table = inputs / "pairs.csv"
    options = f"{reference},{target},shift,40,41,61\n"
    table.write_text(f"reference,target,model,features,window,template\n{options}")
    pair = [str(reference), str(target)]
    once = [*pair, *OPTIONS, *RUNNING]
    over = ["-o", "out", "--overwrite"]
    arguments = {
        "register": ["register", *once, *over],
        "match": ["match", *pair, *OPTIONS[:6], *RUNNING, *over],
        "warp": ["warp", str(folder / "registration"), str(target), *RUNNING[2:], *over],
        "batch": ["batch", str(table), *RUNNING, *over],
        "stack": ["stack", *pair, *OPTIONS, *RUNNING, *over],
    }
    if command == "warp":
        run_command(["register", *once, "-o", str(folder / "registration")], old)
    # a raster is warped to the same bytes again: the old one must be another
    another = ["--resampling", "nearest"] if command == "warp" else []
    first = run_command([*arguments[command], *another], old)
    if first.status:
        raise SystemExit(f"the pair cannot be prepared: {first.said}")
    if command != "register":
        return Job(arguments[command], arguments[command], old)
    points = Path(shutil.copy(old / "out" / "tiepoints.csv", inputs))
    return Job([*arguments[command], "--tie-points", str(points)], arguments[command], old)


def load_everything() -> None:
    """Import and compile what each run needs."""
    for name in LOADED:
        import_module(name)
    from pcwlad_geo.cli.app import run
    from pcwlad_geo.report.page_templates import page_environment

    with redirect_stderr(io.StringIO()):
        run(["register", "", ""])  # the options are described when a command is read first
    for page in PAGES:
        page_environment("pcwlad_geo.report").get_template(page)


@contextmanager
def work_folder() -> Iterator[Path]:
    """Give a folder for as long as the context lasts."""
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-faults-") as folder:
        yield Path(folder).resolve()


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the faults and print a table; 1 where something was violated."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--every", type=int, default=1, metavar="K", help="try every K-th call only")
    parser.add_argument("--command", action="append", choices=COMMANDS, help="register by default")
    parser.add_argument("--kind", action="append", choices=[*KINDS], help="all by default")
    parser.add_argument("--once", action="store_true", help="not the runs in which all later calls fail too")
    wanted = parser.parse_args(arguments)
    if find_compiler() is None:
        print("faults: no C compiler here, or not Linux: nothing was tried")
        return 0
    with work_folder() as folder:
        if PRELOADED not in os.environ:
            environment = {**os.environ, "LD_PRELOAD": str(build_shim(folder)), PRELOADED: "1"}
            places = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
            order = [sys.executable, __file__, *(sys.argv[1:] if arguments is None else arguments)]
            return subprocess.run(order, env={**environment, "PYTHONPATH": places}, check=False).returncode
        load_everything()
        print(HEADER, flush=True)
        violations: list[str] = []
        for command in wanted.command or ["register"]:
            job = make_job(command, folder / command)
            for kind in wanted.kind or KINDS:
                for for_ever in (False,) if wanted.once else (False, True):
                    tried = try_kind(command, job, kind, folder / command, wanted.every, for_ever=for_ever)
                    print(tried.row(), flush=True)
                    for violation in tried.violations:
                        print(f"  {violation}", flush=True)
                    violations += tried.violations
    print(f"{len(violations)} violations")
    return 1 if violations else 0


if __name__ == "__main__":
    sys.exit(main())
