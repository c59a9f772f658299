"""Files of a user opened with care: no pipe is waited for, no endless file is read whole."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import TEXT_BYTES

_KINDS: Final = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise where a path leads to a pipe, a socket or a device: reading it may never end.

    Folders, and what is not there, are for others to tell.

    Raises
    ------
    InputError
        Then.
    """
    try:
        mode = os.stat(path).st_mode  # noqa: PTH116  # a GDAL URI is no path
    except (OSError, ValueError):
        return
    for is_kind, name in _KINDS:
        if is_kind(mode):
            raise InputError(f"{os.fspath(path)} is {name}, not a file: copy what it gives into a file")


def read_bytes(path: Path, most: int = TEXT_BYTES) -> bytes:
    """Read a small file whole.

    Raises
    ------
    InputError
        If it is no file, or larger than `most` bytes.
    OSError
        If it cannot be read.
    """
    check_regular(path)
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise InputError(f"{path} has more than {most} bytes, and at most so many are read: divide it")
    return data


def read_text(path: Path, *, encoding: str = "utf-8", errors: str = "strict") -> str:
    """Read a small text file whole, its line ends as they are in a text.

    Raises
    ------
    InputError
        If it is no file, or too large.
    OSError, UnicodeDecodeError
        If it cannot be read.
    """
    return read_bytes(path).decode(encoding, errors).replace("\r\n", "\n").replace("\r", "\n")
