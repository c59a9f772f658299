"""A lock that keeps two runs on one output folder apart; it ends with its process, however that ends.

The lock is a file that says which process holds it, and that process keeps it locked (`flock`). It is made in
one step with its content, never through a symbolic link; a file of anyone else is neither written to nor
removed.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcwlad_geo.disk import HOST, alive
from pcwlad_geo.errors import OutputError

_CONTENT: Final = re.compile(r"pcwlad-geo: process (?P<process>\d+) on (?P<host>\w+)\n")
_MOST_BYTES: Final = 512
"""A lock is shorter."""
_NEW_FILE: Final = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
# a pipe would be waited for
_OLD_FILE: Final = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
_HELD: Final = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


class FolderLock:
    """The lock of one output folder.

    Parameters
    ----------
    out_dir : pathlib.Path
        The folder, which need not exist. Of a symbolic link, the folder that it leads to is locked.
    """

    def __init__(self, out_dir: Path) -> None:
        self._out_dir = out_dir
        self._path = Path()
        self._descriptor: int | None = None

    def acquire(self) -> None:
        """Take the lock.

        Raises
        ------
        OutputError
            If another run holds it, or a file that is no lock of this program is in its place.
        OSError
            If it cannot be written.
        """
        beside, inside = lock_paths(self._out_dir)
        self._path = beside if os.access(beside.parent, os.W_OK | os.X_OK) else inside
        while self._descriptor is None:
            self._create()
            if self._descriptor is None:
                _remove_left(self._path, self._out_dir)

    def release(self) -> None:
        """Give the lock back; a file that has taken its place meanwhile stays."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is None:
            return
        ours = _is_still(descriptor, self._path)
        if sys.platform == "win32":  # which removes no file that is open
            os.close(descriptor)
        with suppress(OSError):
            if ours:
                self._path.unlink()
        if sys.platform != "win32":
            os.close(descriptor)

    def _create(self) -> None:
        """Make the lock, with its content and held, unless there is a file of its name."""
        # Under a name of its own first: a lock without content could be anyone's.
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
    """The process that a lock names."""

    process: int
    host: str

    @property
    def here(self) -> bool:
        """Whether it is of this machine."""
        return self.host == HOST


def lock_paths(out_dir: Path) -> tuple[Path, Path]:
    """Return where a folder's lock may be: beside it, and inside where that cannot be written to."""
    place = Path(os.path.realpath(out_dir)) if out_dir.is_dir() else out_dir
    return place.with_name(f".{place.name}.lock"), place / ".pcwlad-geo.lock"


def draft_prefix(lock: Path) -> str:
    """Return how the names begin under which this machine's processes make a lock."""
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
    """Give a draft its lock's name as well; False where there is such a file."""
    try:
        os.link(draft, lock, follow_symlinks=False)
    except FileExistsError:
        return False
    except (OSError, NotImplementedError):  # no hard links here: the next best is not quite at once
        if os.path.lexists(lock):
            return False
        with suppress(FileExistsError):  # Windows
            draft.rename(lock)
            return True
        return False
    return True


def _remove_left(path: Path, out_dir: Path) -> None:
    """Remove the lock of a process that has ended; raise where it runs, or where the file is no lock."""
    descriptor = _open_existing(path)
    if descriptor is None:
        if os.path.lexists(path):
            raise _foreign(path)
        return  # gone meanwhile
    try:
        holder = _holder(descriptor)
        if holder is None:
            raise _foreign(path)
        held = _lock(descriptor)
        if held is None:  # a file system without locks: as far as can be told from here
            held = not holder.here or alive(holder.process)
        if held:
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
    """Open a file that may be a lock; None where it is none or cannot be opened."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):  # Windows has no O_NOFOLLOW
            return None
        return os.open(path, _OLD_FILE)
    except OSError:
        return None


def _holder(descriptor: int) -> Holder | None:
    """Return whom the content of a file names; None where it is no lock."""
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        return None
    os.lseek(descriptor, 0, os.SEEK_SET)
    found = _CONTENT.fullmatch(os.read(descriptor, _MOST_BYTES).decode("utf-8", errors="replace"))
    return Holder(int(found["process"]), found["host"]) if found else None


def _is_still(descriptor: int, path: Path) -> bool:
    """Whether a path still leads to the file that is open."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False


def _lock(descriptor: int) -> bool | None:
    """Lock a file for this process; return whether another holds it, None where there are no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 1 << 20, os.SEEK_SET)  # a locked byte cannot be read: none of the content
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return True if error.errno in _HELD else None
    return False
