"""What results need of the disk: to outlast a power failure, to be no one else's, to say what is wrong."""

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
"""This machine, as names of files have it."""
FOLDER_MODE: Final = 0o775
"""Of folders that are made, less what the user's umask forbids."""
_NO_SYNC: Final = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF, errno.EACCES}
"""What file systems say that cannot write out a folder at once."""


def absolute(path: str | os.PathLike[str]) -> Path:
    """Return a path from the root, without "." and ".."; a symbolic link stays one."""
    # resolve() would follow a folder that is a symbolic link, absolute() leaves "." and ".." in it.
    return Path(os.path.abspath(path))  # noqa: PTH100


def alive(process: int) -> bool:
    """Whether a process of this machine that is not this one runs."""
    if process == os.getpid() or sys.platform == "win32":
        return False  # a new run under an old number; on Windows a signal 0 would kill, and the lock tells
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def make_folders(folder: Path) -> list[Path]:
    """Make a folder and those above it; return the ones that were missing, outermost first."""
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
    """Remove those of some folders, outermost first, that hold nothing."""
    for folder in reversed(folders):
        with suppress(OSError):  # not empty: it serves its purpose
            folder.rmdir()


def seal(file: Path) -> None:
    """Write a finished file out to the disk, and take from others the right to write to it.

    Raises
    ------
    OSError
        If the disk fails.
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
    """Write the names in a folder out to the disk, where the system can.

    Raises
    ------
    OSError
        If the disk fails.
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
    """Turn what the disk, GDAL and SQLite say within the context into an `OutputError` that names the cause.

    Parameters
    ----------
    place : pathlib.Path
        Where the results were to be written.
    """
    try:
        yield
    except (OSError, MemoryError, sqlite3.Error, *GDAL_ERRORS) as error:
        raise output_error(place, error) from error


def output_error(place: Path, error: BaseException) -> OutputError:
    """Return the error that says why results cannot be written."""
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
    """Return the operating system's own error among an error and its causes."""
    current: BaseException | None = error
    while current is not None:
        if isinstance(current, OSError) and current.errno is not None and current.strerror:
            return current
        current = current.__cause__
    return None
