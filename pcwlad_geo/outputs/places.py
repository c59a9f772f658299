"""What results need of the disk: folders, complete files, and messages of its errors."""

from __future__ import annotations

import errno
import os
import re
import socket
import sqlite3
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import OutputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause

HOST: Final = re.sub(r"[^A-Za-z0-9]+", "_", socket.gethostname()) or "host"
"""Name of this machine as used in file names."""
FOLDER_MODE: Final = 0o775
"""Permissions of new folders, further restricted by the user's umask."""
_NO_SYNC: Final = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF, errno.EACCES}
"""Errors of file systems that cannot synchronise a folder."""


def absolute(path: str | os.PathLike[str]) -> Path:
    """Return an absolute path without "." and ".."; symbolic links are not resolved."""
    # resolve() would follow symbolic links, absolute() keeps "." and "..".
    return Path(os.path.abspath(path))  # noqa: PTH100


def alive(process: int) -> bool:
    """Whether a process of this machine, other than this one, is running."""
    if process == os.getpid() or sys.platform == "win32":
        return False  # the number was reused; on Windows signal 0 would kill, and the lock decides
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def make_folders(folder: Path) -> list[Path]:
    """Make a folder and its parents, and return those that were missing, outermost first."""
    made: list[Path] = []
    try:
        for place in [each for each in (folder, *folder.parents) if not each.exists()][::-1]:
            made.append(place)
            place.mkdir(FOLDER_MODE, exist_ok=True)
    except BaseException:
        remove_empty(made)
        raise
    return made


def remove_empty(folders: list[Path]) -> None:
    """Remove the empty ones of the given folders, which are listed outermost first."""
    for folder in reversed(folders):
        with suppress(OSError):  # not empty: it is in use
            folder.rmdir()


def seal(file: Path) -> None:
    """Synchronise a finished file to the disk, and remove write permission for others.

    Raises `OSError` if the file system reports an error.
    """
    mode = stat.S_IMODE(file.stat().st_mode)
    if mode & stat.S_IWOTH:
        file.chmod(mode & ~stat.S_IWOTH)
    descriptor = os.open(file, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Synchronise the entries of a folder to the disk, where the system supports it.

    Raises `OSError` if the file system reports an error.
    """
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise
    finally:
        os.close(descriptor)


@contextmanager
def disk_errors(place: Path) -> Iterator[None]:
    """Convert errors of the disk, GDAL and SQLite within the context to an `OutputError` with the cause.

    Results are written to `place`.
    """
    try:
        yield
    except (OSError, MemoryError, sqlite3.Error, *GDAL_ERRORS) as error:
        raise output_error(place, error) from error


def output_error(place: Path, error: BaseException) -> OutputError:
    """Return the error that says why results cannot be written to `place`, with `error` as its cause."""
    if isinstance(error, MemoryError):
        return OutputError(
            f"cannot write {place}: there is not enough memory; end other programs, or give --jobs 1"
        )
    system = _errors_of_system(error)
    reason = system.strerror if system else root_cause(error)
    if system is not None and system.errno == errno.ENOENT:
        reason = f"{reason} (was it removed while the job ran?)"
    return OutputError(f"cannot write {place}: {reason}")


def _errors_of_system(error: BaseException) -> OSError | None:
    """Return the operating system's error among an error and its causes; None without one."""
    current: BaseException | None = error
    while current is not None:
        if isinstance(current, OSError) and current.errno is not None and current.strerror:
            return current
        current = current.__cause__
    return None
