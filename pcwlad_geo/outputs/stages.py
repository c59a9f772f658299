"""Stages, the hidden folders that results wait in, and the lock that keeps two runs apart."""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import shutil
import stat
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import OutputError
from pcwlad_geo.outputs.places import HOST, alive, seal, sync_folder
from pcwlad_geo.text import read_json

_CONTENT: Final = re.compile(r"pcwlad-geo: process (?P<process>\d+) on (?P<host>\w+)\n")
_MAX_BYTES: Final = 512
"""A lock is shorter."""
_NEW_FILE: Final = os.O_RDWR | os.O_CREAT | os.O_EXCL  # which follows no symbolic link
# a pipe would be waited for
_OLD_FILE: Final = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
_HELD: Final = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


class FolderLock:
    """The lock of one output folder.

    Parameters
    ----------
    out_dir : pathlib.Path
        The folder, which need not exist. For a symbolic link its target is locked.
    """

    def __init__(self, out_dir: Path) -> None:
        self._out_dir = out_dir
        self._path: Path  # from acquire() on
        self._descriptor: int | None = None

    def acquire(self) -> None:
        """Acquire the lock.

        Raises `OutputError` if another run holds the lock, or another file has its name; `OSError` if the
        lock cannot be written.
        """
        outside, inside = lock_paths(self._out_dir)
        self._path = outside if os.access(outside.parent, os.W_OK | os.X_OK) else inside
        while self._descriptor is None:
            self._create()
            if self._descriptor is None:
                _remove_left(self._path, self._out_dir)

    def release(self) -> None:
        """Release the lock; a file that has replaced it meanwhile is kept."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is None:
            return
        ours = _is_still(descriptor, self._path)
        if sys.platform == "win32":  # which cannot remove an open file
            os.close(descriptor)
        with suppress(OSError):
            if ours:
                self._path.unlink()
        if sys.platform != "win32":
            os.close(descriptor)

    def _create(self) -> None:
        """Create the lock file, locked and with its content, unless a file of its name exists."""
        # Under a temporary name first: a lock without content could not be attributed to a process.
        draft = self._path.with_name(f"{draft_prefix(self._path)}{os.getpid()}-{secrets.token_hex(4)}")
        descriptor: int | None = None
        try:
            descriptor = os.open(draft, _NEW_FILE, 0o644)
            os.write(descriptor, f"pcwlad-geo: process {os.getpid()} on {HOST}\n".encode())
            _lock(descriptor)
            if _give_name(draft, self._path):
                self._descriptor, descriptor = descriptor, None
        finally:
            if descriptor is not None:
                os.close(descriptor)
            with suppress(OSError):
                draft.unlink()


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that a lock file names."""

    process: int
    host: str

    @property
    def here(self) -> bool:
        """Whether the process is on this machine."""
        return self.host == HOST


def lock_paths(out_dir: Path) -> tuple[Path, Path]:
    """Return where a folder's lock may be: beside it, and inside where that cannot be written to."""
    place = Path(os.path.realpath(out_dir))
    return place.with_name(f".{place.name}.lock"), place / ".pcwlad-geo.lock"


def draft_prefix(lock: Path) -> str:
    """Return the prefix of the temporary names under which processes of this machine create a lock."""
    return f"{lock.name}-{HOST}-"


def remove_own(lock: Path) -> None:
    """Remove a lock if this process has written it."""
    descriptor = _open_existing(lock)
    if descriptor is None:
        return
    try:
        if _holder(descriptor) == Holder(os.getpid(), HOST):
            with suppress(OSError):
                lock.unlink()
    finally:
        os.close(descriptor)


def _give_name(draft: Path, lock: Path) -> bool:
    """Link a draft to the name of its lock; return False if a file of that name exists."""
    try:
        os.link(draft, lock, follow_symlinks=False)
    except FileExistsError:
        return False
    except (OSError, NotImplementedError):  # no hard links here: the alternative is not atomic
        if os.path.lexists(lock):
            return False
        with suppress(FileExistsError):  # Windows
            draft.rename(lock)
            return True
        return False
    return True


def _remove_left(path: Path, out_dir: Path) -> None:
    """Remove the lock of a process that has ended; raise if it is running or the file is not a lock."""
    descriptor = _open_existing(path)
    if descriptor is None:
        if os.path.lexists(path):
            raise _foreign(path)
        return  # removed meanwhile
    try:
        holder = _holder(descriptor)
        if holder is None:
            raise _foreign(path)
        is_held = _lock(descriptor)
        if is_held is None:  # a file system without locks: decided by whether the process is running
            is_held = not holder.here or alive(holder.process)
        if is_held:
            raise OutputError(
                f"another run (process {holder.process} on {holder.host}) writes to {out_dir}: wait for its "
                f"end, or choose another output folder"
            )
        if _is_still(descriptor, path):
            path.unlink()
    finally:
        os.close(descriptor)


def _foreign(path: Path) -> OutputError:
    return OutputError(
        f"{path} is in the way and no lock of pcwlad-geo: move it, or choose another output folder"
    )


def _open_existing(path: Path) -> int | None:
    """Open a file that may be a lock; None if it is not one or cannot be opened."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):  # Windows has no O_NOFOLLOW
            return None
        return os.open(path, _OLD_FILE)
    except OSError:
        return None


def _holder(descriptor: int) -> Holder | None:
    """Return the process that the content of a file names; None if it is not a lock."""
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        return None
    match = _CONTENT.fullmatch(os.read(descriptor, _MAX_BYTES).decode("utf-8", errors="replace"))
    return Holder(int(match["process"]), match["host"]) if match else None


def _is_still(descriptor: int, path: Path) -> bool:
    """Whether a path still refers to the open file."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False


def _lock(descriptor: int) -> bool | None:
    """Lock a file for this process; return whether another holds it, None without support of locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 1 << 20, os.SEEK_SET)  # beyond the content, as a locked byte cannot be read
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return True if error.errno in _HELD else None
    return False


JOURNAL: Final = ".journal"
"""Name of the journal in a stage."""
OLD: Final = ".old"
"""Name of the subfolder of a stage that holds the replaced files."""
_discarding = threading.Lock()
"""Lock for removing stages, which two threads of a stuck run may do at the same time."""


def stage_of(out_dir: Path) -> Path:
    """Return the stage of this process: beside a folder that does not exist, inside one that does."""
    process = f"{HOST}-{os.getpid()}"
    inside, outside = stage_prefixes(out_dir)
    return Path(f"{inside if out_dir.is_dir() else outside}{process}")


def stage_prefixes(out_dir: Path) -> tuple[Path, Path]:
    """Return the prefixes of the stages inside and beside a folder; machine and process follow."""
    return out_dir / ".stage-", out_dir.with_name(f".{out_dir.name}.stage-")


def sweep(out_dir: Path) -> None:
    """Remove the stages of dead processes of this machine, and undo their unfinished moves."""
    for prefix in stage_prefixes(out_dir):
        for stage in of_dead_processes(prefix.parent, f"{prefix.name}{HOST}-"):
            if stage.is_dir():
                with undoing(stage):
                    discard(stage, out_dir)
    for lock in lock_paths(out_dir):
        for draft in of_dead_processes(lock.parent, draft_prefix(lock)):
            draft.unlink(missing_ok=True)


def of_dead_processes(folder: Path, start: str) -> list[Path]:
    """Return the entries of `folder` that are named after processes that have ended.

    Such a name is `start`, the number of the process, and anything after a hyphen.
    """
    if not folder.is_dir():
        return []
    entries = []
    for place in sorted(folder.iterdir()):
        process = place.name.removeprefix(start).partition("-")[0]
        dead = place.name.startswith(start) and process.isdecimal() and not alive(int(process))
        with suppress(FileNotFoundError):  # another run was quicker
            if dead and _own(place):
                entries.append(place)
    return entries


def _own(place: Path) -> bool:
    """Whether a file or folder belongs to this user: in shared folders others could imitate its name."""
    status = place.lstat()
    if stat.S_ISLNK(status.st_mode):
        return False
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def write_journal(stage: Path, out_dir: Path, *, old: Sequence[str], new: Sequence[str]) -> None:
    """Write the journal of the files that will be moved out of a folder and then into it.

    Raises `OSError` if the file system reports an error; then there is no journal. The files `old` are moved
    out, and then the files `new` in, in this order.
    """
    draft = stage / f"{JOURNAL}.draft"
    draft.write_text(json.dumps({"old": [*old], "new": [*new]}), encoding="utf-8")
    seal(draft)
    draft.replace(stage / JOURNAL)
    sync_folder(stage)
    sync_folder(out_dir)


def discard(stage: Path, out_dir: Path) -> None:
    """Undo the unfinished moves between `stage` and `out_dir`, then remove the stage.

    Raises `OSError` if it cannot be undone; the stage with the old files is then kept.
    """
    with _discarding:
        if (stage / JOURNAL).is_file() and _own(stage) and _own(stage / JOURNAL):
            _undo(stage, out_dir)
        shutil.rmtree(stage, ignore_errors=True)


def _undo(stage: Path, out_dir: Path) -> None:
    """Remove the new files and restore the old ones; may be interrupted and repeated."""
    steps = read_json(stage / JOURNAL)
    for name in reversed(plain_names(steps["new"])):
        if not os.path.lexists(stage / name) and os.path.lexists(out_dir / name):
            (out_dir / name).replace(stage / name)
    for name in reversed(plain_names(steps["old"])):
        if os.path.lexists(stage / OLD / name):
            (stage / OLD / name).replace(out_dir / name)
    sync_folder(out_dir)
    (stage / JOURNAL).unlink()  # first, as it recognises new files by their absence from the stage
    sync_folder(stage)


@contextmanager
def undoing(stage: Path) -> Iterator[None]:
    """Report the location of the earlier results if restoring them fails."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OutputError(
            f"cannot put the earlier results back: {reason}; they are in {stage / OLD}, and the next run "
            f"into that folder tries again"
        ) from error


def plain_names(names: object) -> list[str]:
    """Return the plain file names of a list, which stay in their folder and are not hidden."""
    candidates = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    return [
        name for name in candidates if name and not name.startswith(".") and not re.search(r"[/\\\0]", name)
    ]
