"""The segments of a JPEG, which hold what its camera wrote."""

from __future__ import annotations

import struct
from collections.abc import Iterator


def segments(block: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the markers and the contents of the segments before the pixels of a JPEG."""
    place = 2
    while place + 4 <= len(block) and block[place] == 0xFF and block[place + 1] != 0xDA:
        size = struct.unpack_from(">H", block, place + 2)[0]
        yield block[place + 1], block[place + 4 : place + 2 + size]
        place += 2 + max(size, 2)
