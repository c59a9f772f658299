"""The output folder when the disk fails at any step, when it is broken off, and among files of others."""

from __future__ import annotations

import errno
import json
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from pcwlad_geo.errors import OutputError
from pcwlad_geo.staging import OutputFolder, abandon, place_file, stage_inside
from tests.patience import PATIENCE_S

posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX files and signals")
OLD = {"a.csv": "old a", "b.csv": "old b"}
NEW = {"a.csv": "new a", "c.csv": "new c"}


def report(*outputs: str) -> str:
    return json.dumps({"schema_version": 1, "versions": {"pcwlad-geo": "0.1.0"}, "outputs": list(outputs)})


def whole(files: dict[str, str]) -> dict[str, str]:
    return {**files, "report.json": report(*files, "report.json")}


def run(out_dir: Path, files: dict[str, str], *, overwrite: bool = False) -> None:
    with OutputFolder(out_dir, overwrite=overwrite) as folder:
        for name, text in whole(files).items():
            folder.path(name).write_text(text)
        folder.commit()


def content(folder: Path) -> dict[str, str]:
    """All files below a folder, hidden ones too."""
    return {
        str(file.relative_to(folder)): file.read_text()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


STEPS = {
    Path: ("write_text", "rename", "replace", "unlink", "mkdir", "rmdir", "chmod"),
    os: ("open", "write", "fsync", "link", "unlink", "rmdir"),
}
"""What changes the disk, by who does it."""


@contextmanager
def at_each_step(act: Callable[[int], None], *, before: bool = True) -> Iterator[list[str]]:
    """Act before or after each change to the disk, with its number from 1; yield those that were made."""
    made: list[str] = []
    inside = False

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def step(*arguments: Any, **keywords: Any) -> Any:
            nonlocal inside
            if inside:
                return function(*arguments, **keywords)
            inside = True
            try:
                made.append(name)
                number = len(made)
                if before:
                    act(number)
                result = function(*arguments, **keywords)
            finally:
                inside = False
            if not before:
                act(number)
            return result

        return step

    with pytest.MonkeyPatch.context() as patch:
        for owner, names in STEPS.items():
            for name in names:
                patch.setattr(owner, name, counted(name, getattr(owner, name)))
        yield made


@contextmanager
def failing(number: int, error: Callable[[], BaseException], *, for_ever: bool) -> Iterator[list[str]]:
    """Let the n-th change to the disk fail, or all from it on."""

    def act(now: int) -> None:
        if now == number or (for_ever and now > number):
            raise error()

    with at_each_step(act) as made:
        yield made


def number_of_steps(out_dir: Path) -> int:
    with at_each_step(lambda now: None) as made:
        run(out_dir, NEW, overwrite=True)
    return len(made)


@posix
@pytest.mark.parametrize("for_ever", [False, True])
def test_a_disk_that_fails_at_any_step_leaves_the_old_results_or_the_new(
    tmp_path: Path, for_ever: bool
) -> None:
    run(tmp_path / "count", OLD)
    for number in range(1, number_of_steps(tmp_path / "count") + 1):
        out_dir = tmp_path / f"{number}" / "out"
        run(out_dir, OLD)
        error: OutputError | None = None
        with failing(number, lambda: OSError(errno.EIO, os.strerror(errno.EIO)), for_ever=for_ever):
            try:
                run(out_dir, NEW, overwrite=True)
            except OutputError as caught:
                error = caught
        if error is not None:
            assert "Input/output error" in str(error)
            assert "\n" not in str(error)
        with suppress(OutputError), OutputFolder(out_dir):  # sweeps what could not be removed
            pass
        found = content(out_dir)
        assert found == whole(OLD if error else NEW), (number, error)
        left = [path for path in out_dir.parent.iterdir() if path.name != "out"]
        assert not left, number


def test_results_are_written_out_before_and_after_they_get_their_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out_dir, log = tmp_path / "out", []
    fsync, rename, replace = os.fsync, Path.rename, Path.replace

    def name_of(descriptor: int) -> str:
        inode = os.fstat(descriptor).st_ino
        found = [path.name for path in (tmp_path, *tmp_path.rglob("*")) if path.stat().st_ino == inode]
        return found[0]

    def noted_fsync(descriptor: int) -> None:
        log.append(f"fsync {name_of(descriptor)}")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "rename", lambda a, b: (log.append("rename"), rename(a, b))[1])
    monkeypatch.setattr(Path, "replace", lambda a, b: (log.append(f"replace {b.name}"), replace(a, b))[1])
    run(out_dir, OLD)
    at = log.index("rename")
    assert {"fsync a.csv", "fsync b.csv", "fsync report.json"} <= set(log[:at])
    if sys.platform != "win32":
        assert log[at - 1].startswith("fsync .out.stage-")  # the folder's own names
        assert log[at + 1 :] == [f"fsync {tmp_path.name}"]
    log.clear()
    run(out_dir, NEW, overwrite=True)
    first = log.index("replace report.json")
    assert {"fsync a.csv", "fsync c.csv", "fsync report.json", "fsync .journal.draft"} <= set(log[:first])
    if sys.platform != "win32":
        assert "fsync out" in log[log.index("replace c.csv") :]


@posix
@pytest.mark.parametrize("exists", [False, True])
def test_no_result_is_for_all_to_write(tmp_path: Path, exists: bool) -> None:
    before = os.umask(0)
    try:
        out_dir = tmp_path / "deep" / "out"
        if exists:
            out_dir.mkdir(parents=True, mode=0o755)
        run(out_dir, OLD)
        staged = tmp_path / "staged.csv"
        staged.write_text("x")
        place_file(staged, tmp_path / "other" / "single.csv")
    finally:
        os.umask(before)
    places = [out_dir, *out_dir.iterdir(), tmp_path / "other", tmp_path / "other" / "single.csv"]
    assert not [place for place in places if place.stat().st_mode & stat.S_IWOTH]
    assert stat.S_IMODE((out_dir / "a.csv").stat().st_mode) == 0o664  # the rest is as the user has it


# --- the lock --------------------------------------------------------------------------------------------


@posix
def test_a_lock_is_never_followed_or_truncated(tmp_path: Path) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("mine")
    link = tmp_path / ".out.lock"
    link.symlink_to(precious)
    with pytest.raises(OutputError, match=r"\.out\.lock is in the way and no lock of pcwlad-geo"):
        run(tmp_path / "out", OLD)
    assert precious.read_text() == "mine"
    assert link.is_symlink()
    link.unlink()
    link.symlink_to(tmp_path / "not there")
    with pytest.raises(OutputError, match="is in the way"):
        run(tmp_path / "out", OLD)
    assert not (tmp_path / "not there").exists()
    assert not (tmp_path / "out").exists()


@posix
@pytest.mark.parametrize("text", ["mine", "", "12 on host\n", "pcwlad-geo: process 12 on host\nand more"])
def test_a_file_of_the_user_in_the_place_of_the_lock_stays(tmp_path: Path, text: str) -> None:
    lock = tmp_path / ".out.lock"
    lock.write_text(text)
    with pytest.raises(OutputError, match="is in the way and no lock of pcwlad-geo"):
        run(tmp_path / "out", OLD)
    abandon(tmp_path / "out")
    assert content(tmp_path) == {".out.lock": text}


@posix
def test_a_pipe_in_the_place_of_the_lock_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / ".out.lock")
    with pytest.raises(OutputError, match="is in the way"):
        run(tmp_path / "out", OLD)
    assert (tmp_path / ".out.lock").is_fifo()


def test_a_lock_that_someone_else_has_put_there_meanwhile_stays(tmp_path: Path) -> None:
    lock = tmp_path / ".out.lock"
    with OutputFolder(tmp_path / "out"):
        lock.unlink()
        lock.write_text("mine")
    assert content(tmp_path) == {".out.lock": "mine"}


def ended_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait(PATIENCE_S)
    return process.pid


@posix
@pytest.mark.parametrize("locks", [True, False], ids=["with locks", "a file system without locks"])
def test_the_lock_of_a_dead_process_counts_for_nothing(
    tmp_path: Path, locks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pcwlad_geo.disk import HOST

    if not locks:
        import fcntl

        def unsupported(*arguments: object) -> None:
            raise OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))

        monkeypatch.setattr(fcntl, "flock", unsupported)
    lock = tmp_path / ".out.lock"
    lock.write_text(f"pcwlad-geo: process {ended_process()} on {HOST}\n")
    draft = tmp_path / f".out.lock-{HOST}-{ended_process()}-0011aabb"
    draft.write_text("")
    run(tmp_path / "out", OLD)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    if not locks:  # the process counts
        lock.write_text(f"pcwlad-geo: process {os.getppid()} on {HOST}\n")
        with pytest.raises(OutputError, match=f"another run \\(process {os.getppid()} on"):
            run(tmp_path / "out", NEW, overwrite=True)
        lock.write_text("pcwlad-geo: process 1 on elsewhere\n")
        with pytest.raises(OutputError, match=r"another run \(process 1 on elsewhere\)"):
            run(tmp_path / "out", NEW, overwrite=True)
        assert lock.exists()


@posix
def test_a_folder_and_a_link_to_it_have_one_lock(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "elsewhere").mkdir()
    link = tmp_path / "elsewhere" / "link"
    link.symlink_to(tmp_path / "real")
    with OutputFolder(tmp_path / "real"), pytest.raises(OutputError, match="another run"):
        run(link, OLD)
    run(link, OLD)
    assert link.is_symlink()
    assert content(tmp_path / "real") == whole(OLD)
    assert [path.name for path in link.parent.iterdir()] == ["link"]
    run(link, NEW, overwrite=True)
    assert content(tmp_path / "real") == whole(NEW)


@posix
def test_a_link_to_nothing_is_no_output_folder(tmp_path: Path) -> None:
    (tmp_path / "out").symlink_to(tmp_path / "gone")
    with pytest.raises(OutputError, match="is no folder"):
        run(tmp_path / "out", OLD)
    assert not (tmp_path / "gone").exists()


@posix
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_stages_of_other_users_are_not_acted_on(tmp_path: Path) -> None:
    """What lies in a folder for all may be meant to have the user's own files removed."""
    from pcwlad_geo.disk import HOST

    run(tmp_path / "out", OLD)
    stage = tmp_path / f".out.stage-{HOST}-{ended_process()}"
    stage.mkdir()
    (stage / ".old").mkdir()
    (stage / ".journal").write_text(json.dumps({"old": [], "new": ["a.csv"]}))
    os.chown(stage, 12345, 12345)
    link = tmp_path / "out" / f".stage-{HOST}-{ended_process()}"
    link.symlink_to(stage)
    with suppress(OutputError), OutputFolder(tmp_path / "out"):
        pass
    assert (tmp_path / "out" / "a.csv").read_text() == "old a"
    assert stage.is_dir()
    assert link.is_symlink()


# --- what goes while a job runs --------------------------------------------------------------------------


@pytest.mark.parametrize("exists", [False, True])
def test_a_stage_that_is_removed_meanwhile_is_one_clear_error(tmp_path: Path, exists: bool) -> None:
    out_dir = tmp_path / "out"
    if exists:
        run(out_dir, OLD)
    before = content(tmp_path)

    def job() -> None:
        with OutputFolder(out_dir, overwrite=True) as folder:
            folder.stage.rmdir()
            with folder.writing():
                folder.path("a.csv").write_text("new")
            folder.commit()

    with pytest.raises(OutputError, match=r"cannot write .*No such file or directory.*removed while"):
        job()
    assert content(tmp_path) == before


def test_a_file_that_is_removed_from_the_stage_is_missed(tmp_path: Path) -> None:
    def job() -> None:
        with OutputFolder(tmp_path / "out") as folder:
            for name, text in whole(OLD).items():
                folder.path(name).write_text(text)
            (folder.stage / "b.csv").unlink()
            folder.commit()

    with pytest.raises(OutputError, match=r"b\.csv was removed from .* while the job ran"):
        job()
    assert list(tmp_path.iterdir()) == []


def test_single_files_whose_stage_is_removed_are_one_clear_error(tmp_path: Path) -> None:
    def job() -> None:
        with stage_inside(tmp_path / "deep") as stage:
            stage.rmdir()
            (stage / "a.tif").write_text("x")

    with pytest.raises(OutputError, match=r"cannot write .*No such file or directory"):
        job()
    assert list(tmp_path.iterdir()) == []


@posix
def test_what_a_killed_run_left_of_a_single_file_is_swept(tmp_path: Path) -> None:
    staged = tmp_path / "staged.csv"
    from pcwlad_geo.disk import HOST

    left = tmp_path / f".final.csv.{HOST}-{ended_process()}"
    left.write_text("half")
    staged.write_text("y")
    place_file(staged, tmp_path / "final.csv")
    assert content(tmp_path) == {"final.csv": "y"}


# --- signals ---------------------------------------------------------------------------------------------

IN_CHILDREN = """
import os, signal, sys
from pathlib import Path
from contextlib import suppress
from pcwlad_geo.cli.interrupt import cancellable
from pcwlad_geo.errors import OutputError
from pcwlad_geo.staging import OutputFolder, abandon
from tests.test_output_folder_faults import NEW, OLD, at_each_step, content, run, whole

top, signals = Path(sys.argv[1]), [int(each) for each in sys.argv[2:]]

def in_child(work):
    child = os.fork()
    if not child:
        status = 0
        try:
            work()
        except KeyboardInterrupt:
            abandon(out_dir)
            status = 130
        os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

def next_run():  # without --overwrite
    with suppress(OutputError), OutputFolder(out_dir):
        pass

def signalled(now):
    if now - number in range(len(signals)):  # one after the other
        os.kill(os.getpid(), signals[now - number])

def job():
    with cancellable(lambda: abandon(out_dir)), at_each_step(signalled, before=False) as made:
        run(out_dir, NEW, overwrite=True)
    return made

def state():
    beside = [path.name for path in out_dir.parent.iterdir()]
    files = content(out_dir)
    return "old" if files == whole(OLD) else "new" if files == whole(NEW) else sorted(files), beside

def visible():
    return {name: text for name, text in content(out_dir).items() if not name.startswith(".")}

number, out_dir = 10_000, top / "count" / "out"
run(out_dir, OLD)
steps = len(job())
"""

AT_EACH_STEP = """
for number in range(1, steps + 1):
    out_dir = top / str(number) / "out"
    run(out_dir, OLD)
    status = in_child(job)
    if signals == [signal.SIGKILL]:
        if (out_dir / "report.json").exists() and visible() not in (whole(OLD), whole(NEW)):
            print(number, "report.json among files that are not its own", visible())
        next_run()
    found, beside = state()
    if found not in ("old", "new") or beside != ["out"] or status not in (130, -signal.SIGKILL):
        print(number, status, found, beside)
print(steps, "steps")
"""

WHILE_UNDOING = """
def stops_half_way():
    replace = Path.replace
    def until_c(source, target):
        if source.name == "c.csv":
            os.kill(os.getpid(), signal.SIGKILL)
        return replace(source, target)
    Path.replace = until_c
    run(out_dir, NEW, overwrite=True)

for number in range(1, steps + 1):
    out_dir = top / str(number) / "out"
    run(out_dir, OLD)
    in_child(stops_half_way)
    if (out_dir / "report.json").exists():
        print(number, "report.json before its files")
    def sweeping():
        with at_each_step(signalled, before=False):
            next_run()
    in_child(sweeping)
    next_run()
    if state() != ("old", ["out"]):
        print(number, state())
print(steps, "steps")
"""


def in_children(script: str, folder: Path, *signals: int) -> None:
    """Run a script whose children are ended at every step; what is wrong, it prints."""
    ended = subprocess.run(
        [sys.executable, "-c", IN_CHILDREN + script, str(folder), *(str(int(number)) for number in signals)],
        cwd=Path(__file__).resolve().parents[1],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert ended.stderr == ""
    assert ended.stdout.count("\n") == 1, ended.stdout
    assert int(ended.stdout.split()[0]) > 15


@posix
@pytest.mark.parametrize(
    "signals",
    [(signal.SIGTERM,), (signal.SIGINT, signal.SIGINT), (signal.SIGINT, signal.SIGTERM, signal.SIGTERM)],
    ids=["SIGTERM", "twice Ctrl-C", "Ctrl-C and SIGTERM twice"],
)
def test_signals_at_any_step_leave_the_old_results_or_the_new_and_nothing_else(
    tmp_path: Path, signals: tuple[signal.Signals, ...]
) -> None:
    in_children(AT_EACH_STEP, tmp_path, *signals)


@posix
def test_a_run_killed_at_any_step_is_done_or_undone_by_the_next(tmp_path: Path) -> None:
    in_children(AT_EACH_STEP, tmp_path, signal.SIGKILL)


@posix
def test_undoing_that_is_killed_at_any_step_is_done_again(tmp_path: Path) -> None:
    """What has been put back must not be taken for something new."""
    in_children(WHILE_UNDOING, tmp_path, signal.SIGKILL)
