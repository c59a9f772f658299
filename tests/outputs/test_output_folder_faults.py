"""The output folder when the disk fails at any step, when it is broken off, and among files of others."""

from __future__ import annotations

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from pcwlad_geo.errors import OutputError
from pcwlad_geo.outputs import stages as stage_folders
from pcwlad_geo.outputs.folder import OutputFolder, abandon, place_file, stage_inside
from pcwlad_geo.outputs.places import HOST
from pcwlad_geo.outputs.stages import discard
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
        # for certain, before any file is moved
        noted = log[log.index("replace .journal") + 1 : first]
        assert [line.partition("-")[0] for line in noted] == ["fsync .stage", "fsync out"]
        placed = [line.partition("-")[0] for line in log[log.index("replace c.csv") :]]
        assert placed == ["replace c.csv", "replace report.json", "fsync out", "fsync .stage"]


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
@pytest.mark.parametrize(
    "data", [b"mine", b"", b"12 on host\n", b"pcwlad-geo: process 12 on host\nand more", b"\xff\xfe\x00"]
)
def test_a_file_of_the_user_in_the_place_of_the_lock_stays(tmp_path: Path, data: bytes) -> None:
    lock = tmp_path / ".out.lock"
    lock.write_bytes(data)
    with pytest.raises(OutputError, match="is in the way and no lock of pcwlad-geo"):
        run(tmp_path / "out", OLD)
    abandon(tmp_path / "out")
    assert list(tmp_path.iterdir()) == [lock]
    assert lock.read_bytes() == data


@posix
@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_what_takes_the_place_of_a_lock_while_it_is_looked_at_is_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    lock, precious = tmp_path / ".out.lock", tmp_path / "precious.txt"
    for file in (lock, precious):
        file.write_text(f"pcwlad-geo: process {ended_process()} on {HOST}\n")
    before = precious.read_text()
    lstat, opened = Path.lstat, os.open

    def exchanged(path: Path) -> os.stat_result:
        status = lstat(path)
        if path == lock and stat.S_ISREG(status.st_mode):
            lock.unlink()
            if kind == "link":
                lock.symlink_to(precious)
            elif kind == "pipe":
                os.mkfifo(lock)
            else:
                lock.mkdir()
        return status

    def watched(path: Any, flags: int, *arguments: Any, **keywords: Any) -> int:
        if Path(path) == lock:
            assert kind != "link" or flags & os.O_NOFOLLOW, "it would be followed"
            assert kind != "pipe" or flags & os.O_NONBLOCK, "it would be waited for"
        return opened(path, flags, *arguments, **keywords)

    monkeypatch.setattr(Path, "lstat", exchanged)
    monkeypatch.setattr(os, "open", watched)
    with pytest.raises(OutputError, match="is in the way and no lock of pcwlad-geo"):
        run(tmp_path / "out", OLD)
    assert precious.read_text() == before
    assert os.path.lexists(lock)


@posix
def test_everyone_may_read_who_holds_a_lock_and_no_one_else_change_it(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        with OutputFolder(tmp_path / "out"):
            assert stat.S_IMODE((tmp_path / ".out.lock").stat().st_mode) == 0o644
    finally:
        os.umask(before)


@posix
def test_no_file_stays_open(tmp_path: Path) -> None:
    """A batch goes through thousands of folders."""
    before = len([*Path("/dev/fd").iterdir()])
    run(tmp_path / "out", OLD)
    with OutputFolder(tmp_path / "new"):
        with pytest.raises(OutputError, match="another run"):
            run(tmp_path / "new", NEW)
        abandon(tmp_path / "new")
    assert len([*Path("/dev/fd").iterdir()]) <= before


@posix
def test_where_nothing_can_be_made_beside_a_folder_its_lock_is_inside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever runs this: permissions do not bind everyone."""
    monkeypatch.setattr(
        os, "access", lambda place, mode: (Path(place), mode) != (tmp_path, os.W_OK | os.X_OK)
    )
    (tmp_path / "out").mkdir()
    with OutputFolder(tmp_path / "out") as folder:
        assert [path.name for path in tmp_path.iterdir()] == ["out"]
        with pytest.raises(OutputError, match="another run"):
            run(tmp_path / "out", OLD)
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
            ".pcwlad-geo.lock",
            folder.stage.name,
        ]
    run(tmp_path / "out", OLD)
    assert content(tmp_path / "out") == whole(OLD)


@posix
@pytest.mark.parametrize("error", [OSError(errno.EPERM, "no links"), NotImplementedError("no links")])
def test_a_file_system_without_hard_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def unsupported(*arguments: object, **keywords: object) -> None:
        raise error

    monkeypatch.setattr(os, "link", unsupported)
    with OutputFolder(tmp_path / "out"):
        held = (tmp_path / ".out.lock").read_text()
        with pytest.raises(OutputError, match="another run"):
            run(tmp_path / "out", OLD)
        assert (tmp_path / ".out.lock").read_text() == held
    run(tmp_path / "out", OLD)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@posix
def test_a_lock_that_is_given_back_just_now_is_taken_without_overwriting_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, rename, asked = os.link, Path.rename, []

    def in_the_way_at_first(*arguments: Any, **keywords: Any) -> None:
        asked.append(arguments)
        if len(asked) == 1:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        link(*arguments, **keywords)

    def over_nothing(source: Path, target: Path) -> Path:
        assert target.name != ".out.lock", "what is there by then would be lost"
        return rename(source, target)

    monkeypatch.setattr(os, "link", in_the_way_at_first)
    monkeypatch.setattr(Path, "rename", over_nothing)
    run(tmp_path / "out", OLD)
    assert len(asked) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@posix
def test_the_lock_of_a_dead_process_may_go_while_it_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another run sweeps it, too."""
    import fcntl

    lock = tmp_path / ".out.lock"
    lock.write_text(f"pcwlad-geo: process {ended_process()} on {HOST}\n")
    dead, flock = lock.stat().st_ino, fcntl.flock

    def other_is_quicker(descriptor: int, how: int) -> None:
        flock(descriptor, how)
        if os.fstat(descriptor).st_ino == dead:
            lock.unlink()

    monkeypatch.setattr(fcntl, "flock", other_is_quicker)
    run(tmp_path / "out", OLD)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@posix
def test_the_lock_of_another_machine_counts_as_long_as_it_is_held(tmp_path: Path) -> None:
    import fcntl

    lock = tmp_path / ".out.lock"
    lock.write_text("pcwlad-geo: process 1 on elsewhere\n")
    with lock.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(OutputError, match=r"another run \(process 1 on elsewhere\)"):
            run(tmp_path / "out", OLD)
    run(tmp_path / "out", OLD)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_lock_that_someone_has_removed_is_not_missed(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "out") as folder:
        (tmp_path / ".out.lock").unlink()
        folder.path("a.csv").write_text("1")
        folder.commit()
    assert content(tmp_path) == {"out/a.csv": "1"}


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
        elsewhere = ended_process()  # here: that says nothing of another machine
        lock.write_text(f"pcwlad-geo: process {elsewhere} on elsewhere\n")
        with pytest.raises(OutputError, match=f"another run \\(process {elsewhere} on elsewhere\\)"):
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


@posix
def test_stages_and_drafts_of_other_users_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever runs this: files are not given away, the user is another."""
    process = ended_process()
    left = [tmp_path / f".out.stage-{HOST}-{process}", tmp_path / f".out.lock-{HOST}-{process}-0011aabb"]
    left[0].mkdir()
    left[1].touch()
    with monkeypatch.context() as other:
        other.setattr(os, "geteuid", lambda: 12345)
        run(tmp_path / "out", OLD)
    assert all(place.exists() for place in left)
    run(tmp_path / "out", NEW, overwrite=True)
    assert not any(place.exists() for place in left)


# --- undoing ---------------------------------------------------------------------------------------------


def half_placed(out_dir: Path, journal: str | None = None) -> Path:
    """Return the stage of a process that has ended while it replaced files: a.csv and c.csv are new."""
    stage = out_dir / f".stage-{HOST}-{ended_process()}"
    (stage / ".old").mkdir(parents=True)
    for name, text in whole(OLD).items():
        (stage / ".old" / name).write_text(text)
    for name, text in NEW.items():
        (out_dir / name).write_text(text)
    (stage / "report.json").write_text(report(*NEW, "report.json"))
    names = {"old": ["report.json", *OLD], "new": [*NEW, "report.json"]}
    (stage / ".journal").write_text(json.dumps(names) if journal is None else journal)
    return stage


@posix
@pytest.mark.parametrize("gone", [(), ("a.csv",), ("a.csv", "c.csv")])
def test_what_is_half_placed_is_undone_whatever_of_it_is_removed(
    tmp_path: Path, gone: tuple[str, ...]
) -> None:
    half_placed(tmp_path / "out")
    for name in gone:
        (tmp_path / "out" / name).unlink()
    with pytest.raises(OutputError, match="holds results"):  # again: they are back
        run(tmp_path / "out", NEW)
    assert content(tmp_path / "out") == whole(OLD)


@posix
@pytest.mark.parametrize(
    ("journal", "reason"),
    [
        ('{"old": [', "Expecting value: line 1 column 10"),
        ('{"old": []}', "'new'"),
        ('["old", "new"]', "list indices must be integers or slices, not str"),
    ],
)
def test_a_journal_that_is_damaged_is_told_and_the_old_results_stay(
    tmp_path: Path, journal: str, reason: str
) -> None:
    stage = half_placed(tmp_path / "out", journal)
    with pytest.raises(OutputError, match="cannot put the earlier results back") as caught:
        run(tmp_path / "out", NEW, overwrite=True)
    assert f": {reason}" in str(caught.value)
    assert f"they are in {stage / '.old'}, and the next run" in str(caught.value)
    assert content(stage / ".old") == whole(OLD)


@posix
@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(errno.EIO, "Input/output error", "b.csv"), "Input/output error"),
        (OSError("the disk was pulled out"), "the disk was pulled out"),
    ],
)
def test_old_results_that_cannot_be_put_back_are_told_in_plain_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: OSError, reason: str
) -> None:
    def fail(source: Path, target: Path) -> Path:
        raise error

    stage = half_placed(tmp_path / "out")
    with monkeypatch.context() as disk:
        disk.setattr(Path, "replace", fail)
        with pytest.raises(OutputError, match=f"cannot put the earlier results back: {reason}; they are in"):
            run(tmp_path / "out", NEW, overwrite=True)
    assert content(stage / ".old") == whole(OLD)
    with pytest.raises(OutputError, match="holds results"):
        run(tmp_path / "out", NEW)
    assert content(tmp_path / "out") == whole(OLD)


@posix
def test_what_is_undone_is_written_out_before_its_journal_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk may lose its power between any two steps."""
    log: list[tuple[Path, bool]] = []
    stage = half_placed(tmp_path / "out")
    monkeypatch.setattr(
        stage_folders, "sync_folder", lambda folder: log.append((folder, (stage / ".journal").exists()))
    )
    discard(stage, tmp_path / "out")
    assert log == [(tmp_path / "out", True), (stage, False)]
    assert content(tmp_path / "out") == whole(OLD)


@posix
def test_a_stage_is_undone_by_one_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that is stuck, and who gives it up from outside."""
    stage = half_placed(tmp_path / "out")
    other = threading.Thread(target=discard, args=(stage, tmp_path / "out"))
    replace = Path.replace

    def slow(source: Path, target: Path) -> Path:
        if other.ident is None:
            other.start()
            other.join(0.3)
            assert other.is_alive()
        return replace(source, target)

    monkeypatch.setattr(Path, "replace", slow)
    discard(stage, tmp_path / "out")
    other.join(PATIENCE_S)
    assert content(tmp_path / "out") == whole(OLD)


@posix
def test_what_two_runs_sweep_at_once_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    process = ended_process()
    draft, single = f".out.lock-{HOST}-{process}-0011aabb", f".out.csv.{HOST}-{process}"
    staged = tmp_path / "staged.csv"
    unlink, alive = Path.unlink, stage_folders.alive

    def place_both() -> None:
        for name in (draft, single):
            (tmp_path / name).touch()
        staged.write_text("x")
        with OutputFolder(tmp_path / "out"):
            pass
        place_file(staged, tmp_path / "out.csv", overwrite=True)
        assert [file.name for file in tmp_path.iterdir()] == ["out.csv"]

    def too_late(path: Path, missing_ok: bool = False) -> None:
        if str(process) in path.name:
            unlink(path)
        unlink(path, missing_ok)

    def sees_it_go(number: int) -> bool:
        for name in (draft, single):
            unlink(tmp_path / name, missing_ok=True)
        return alive(number)

    with monkeypatch.context() as other:
        other.setattr(Path, "unlink", too_late)
        place_both()
    monkeypatch.setattr(stage_folders, "alive", sees_it_go)
    place_both()


@posix
def test_what_is_abandoned_on_a_failing_disk_is_left_to_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: object, **keywords: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    out_dir = tmp_path / "out"
    run(out_dir, OLD)
    with OutputFolder(out_dir, overwrite=True) as folder:
        stage_folders.write_journal(folder.stage, out_dir, old=[], new=[])
        for owner, name in ((Path, "unlink"), (stage_folders, "sync_folder")):
            with monkeypatch.context() as disk:
                disk.setattr(owner, name, fail)
                abandon(out_dir)
        assert not (tmp_path / ".out.lock").exists()
    assert content(tmp_path) == {f"out/{name}": text for name, text in whole(OLD).items()}


def test_drafts_of_a_lock_are_abandoned_by_two_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unlink = Path.unlink

    def too_late(path: Path, missing_ok: bool = False) -> None:
        unlink(path)
        unlink(path, missing_ok)

    for twice in (False, True):
        draft = tmp_path / f".out.lock-{HOST}-{os.getpid()}-0011aabb"
        draft.touch()
        with monkeypatch.context() as other:
            if twice:
                other.setattr(Path, "unlink", too_late)
            abandon(tmp_path / "out")
        assert not draft.exists()


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


def test_a_file_that_comes_into_the_folder_meanwhile_stays(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    run(out_dir, OLD)
    with OutputFolder(out_dir, overwrite=True) as folder:
        for name, text in whole(NEW).items():
            folder.path(name).write_text(text)
        (out_dir / "c.csv").write_text("mine")
        with pytest.raises(OutputError, match=r"c\.csv is in the way and not from an earlier run"):
            folder.commit()
    assert content(out_dir) == {**whole(OLD), "c.csv": "mine"}


def test_results_that_come_into_the_folder_meanwhile_need_overwrite(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    out_dir.mkdir()
    with OutputFolder(out_dir) as folder:
        for name, text in whole(NEW).items():
            folder.path(name).write_text(text)
        for name, text in whole(OLD).items():
            (out_dir / name).write_text(text)
        with pytest.raises(OutputError, match=r"a\.csv is in the way"):
            folder.commit()
    assert content(out_dir) == whole(OLD)


@posix
def test_an_empty_folder_that_is_made_meanwhile_stays_as_it_is(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    with OutputFolder(out_dir) as folder:
        folder.path("a.csv").write_text("1")
        out_dir.mkdir(0o700)
        folder.commit()
    assert stat.S_IMODE(out_dir.stat().st_mode) == 0o700
    assert content(tmp_path) == {"out/a.csv": "1"}


@posix
def test_earlier_results_that_are_links_to_nothing_by_now_are_replaced(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    run(out_dir, OLD)
    (out_dir / "b.csv").unlink()
    (out_dir / "b.csv").symlink_to(tmp_path / "gone")
    run(out_dir, NEW, overwrite=True)
    assert sorted(path.name for path in out_dir.iterdir()) == sorted(whole(NEW))


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
from pcwlad_geo.cli.interrupts import cancellable
from pcwlad_geo.errors import OutputError
from pcwlad_geo.outputs.folder import OutputFolder, abandon
from tests.outputs.test_output_folder_faults import NEW, OLD, at_each_step, content, run, whole

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
        cwd=Path(__file__).resolve().parents[2],
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
    [
        pytest.param([signal.SIGTERM], id="SIGTERM", marks=pytest.mark.slow),
        pytest.param([signal.SIGINT, signal.SIGINT], id="twice Ctrl-C", marks=pytest.mark.slow),
        pytest.param([signal.SIGINT, signal.SIGTERM, signal.SIGTERM], id="Ctrl-C and SIGTERM twice"),
    ],
)
def test_signals_at_any_step_leave_the_old_results_or_the_new_and_nothing_else(
    tmp_path: Path, signals: list[signal.Signals]
) -> None:
    in_children(AT_EACH_STEP, tmp_path, *signals)


@posix
def test_a_run_killed_at_any_step_is_done_or_undone_by_the_next(tmp_path: Path) -> None:
    in_children(AT_EACH_STEP, tmp_path, signal.SIGKILL)


@posix
def test_undoing_that_is_killed_at_any_step_is_done_again(tmp_path: Path) -> None:
    """What has been put back must not be taken for something new."""
    in_children(WHILE_UNDOING, tmp_path, signal.SIGKILL)
