"""What results need of the disk: folders, complete files, and messages of its errors."""

from __future__ import annotations

import errno
import os
import re
import socket
import sqlite3
import stat
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import OutputError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause
from pcwlad_geo.types import PathLike

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


def check_outputs(
    places: Sequence[Path], inputs: Iterable[PathLike | None] = (), *, overwrite: bool = True
) -> None:
    """Check every path that a command will write, before any work.

    The `inputs` are the files that are read; names that are no files, such as URIs of GDAL, and None are
    passed over. Files that exist may be replaced if `overwrite`. Raises `OutputError` if no file can have
    such a name, two outputs have one path (also where names that differ in case alone are one), an output is
    an input under whatever name, or what lies there may not be replaced.
    """
    read = {(about.st_dev, about.st_ino) for about in map(_about, inputs) if about is not None}
    names: dict[str, Path] = {}
    for place in places:
        check_name(place)
        other = names.setdefault(os.path.realpath(place).casefold(), place)
        if other is not place:
            raise OutputError(f"two outputs would be written to {place}: give them different names")
        about = _about(place)
        if about is not None and (about.st_dev, about.st_ino) in read:
            raise OutputError(f"the output {place} is an input too: choose another output folder or name")
        check_replaceable(place)
        if not overwrite and os.path.lexists(place):
            raise OutputError(f"{place} exists: give --overwrite to replace it, or another name")


def check_replaceable(place: Path) -> None:
    """Raise `OutputError` if something other than a regular file lies at a path: that is never replaced."""
    about = _about(place)
    if about is not None and not stat.S_ISREG(about.st_mode):
        kind = "a folder" if stat.S_ISDIR(about.st_mode) else "a device, a pipe or a socket"
        raise OutputError(f"{place} is {kind}, and only files are replaced: choose another name")


def check_name(place: Path) -> None:
    """Raise `OutputError` if no file can have the name of a path, or GDAL cannot make such a file."""
    try:
        sizes = [len(part.encode()) for part in place.parts]
    except UnicodeEncodeError as error:
        raise OutputError(
            f"the output {str(place)!r} has a name that is not UTF-8, which GDAL needs: rename the input, "
            "or give another folder (-o)"
        ) from error
    if "\0" in str(place):
        raise OutputError(f"the output {str(place)!r} has a NUL character in its name: give another name")
    if max(sizes, default=0) > LIMITS.name_bytes:
        raise OutputError(
            f"the output {place} has a name of {max(sizes)} bytes, and at most {LIMITS.name_bytes} "
            "are possible: give the input a shorter name, or another folder (-o)"
        )


def _about(path: PathLike | None) -> os.stat_result | None:
    """Return what the system knows of the file that a path leads to; None where there is none."""
    with suppress(OSError, ValueError):  # a GDAL URI may hold what no path can
        return None if path is None else os.stat(path)  # noqa: PTH116
    return None


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
    return not _is_zombie(process)


def _is_zombie(process: int) -> bool:
    """Whether a process has ended and its parent has not asked for its status, as happens in containers."""
    try:
        status = Path(f"/proc/{process}/stat").read_bytes()
    except OSError:  # another system than Linux, or it has ended meanwhile
        return False
    return status.rpartition(b")")[2].split()[:1] == [b"Z"]


def make_folders(folder: Path) -> list[Path]:
    """Make a folder and its parents, and return those that were missing, outermost first."""
    created: list[Path] = []
    try:
        for place in [parent for parent in (folder, *folder.parents) if not parent.exists()][::-1]:
            created.append(place)
            place.mkdir(FOLDER_MODE, exist_ok=True)
    except BaseException:
        remove_empty(created)
        raise
    return created


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
