"""The check that an HDF4 file holds its values itself: its list of elements names those of other files."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import IO, Final

import numpy as np

from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.trust.local_files import OnDisk, Place

_ELEMENT: Final = np.dtype([("tag", ">u2"), ("ref", ">u2"), ("at", ">i4"), ("length", ">i4")])
"""An entry of the list of elements, which is all that the library finds."""
_SPECIAL: Final = 0xC000, 0x4000
"""Bits of a tag, and those of an element that is stored in a special way."""
_EXTERNAL: Final = 2
"""The special way of an element whose values lie in another file."""


def reason_against(file: Place) -> str | None:
    """Return why an HDF4 file must not be opened; None if all its values lie in the file itself.

    In an archive no file is opened.
    """
    if not isinstance(file, OnDisk) or file.within:
        return "HDF4 can hold values of any other file, and in an archive that is not checked (unpack it)"
    try:
        with file.path.open("rb") as opened:
            if any(way == _EXTERNAL for way in _special_ways(opened)):
                return "an array of it holds the values of another file"
    except (OSError, ValueError, struct.error) as error:
        return f"it is damaged, or no HDF4 file ({error})"
    return None


def _special_ways(opened: IO[bytes]) -> Iterator[int]:
    """Yield how each special element is stored; raises `ValueError` if the list of elements has no end."""
    place, count, visited = 4, 0, set()
    while place:
        visited.add(place)
        opened.seek(place)
        entries, place = struct.unpack(">hi", opened.read(6))
        count += entries
        if place in visited or entries < 0 or count > LIMITS.members:
            raise ValueError("its list of elements has no end, or is too long")
        elements = np.frombuffer(opened.read(_ELEMENT.itemsize * entries), _ELEMENT)
        bits, special = _SPECIAL
        for at in elements["at"][(elements["tag"] & bits) == special].tolist():
            opened.seek(at)
            yield struct.unpack(">h", opened.read(2))[0]
