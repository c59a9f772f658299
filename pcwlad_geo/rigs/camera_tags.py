"""The tags of a frame as its camera wrote them, byte for byte: directories of a TIFF, segments of a JPEG.

GDAL reads EXIF, but writes none to a TIFF. So the directories are read here, and written with other pixels.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.jpeg_segments import segments

ByteOrder = Literal["<", ">"]
SIZES: Final = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
"""Bytes of a value by the type of its tag (TIFF 6.0)."""
POINTERS: Final = (34665, 34853, 40965)
"""Tags that point to the directories of EXIF, of GPS, and of interoperability."""
XMP_TAG: Final = 700
"""XMP packet of a TIFF."""
_OF_PIXELS: Final = frozenset(
    {*range(254, 260), 262, 266, 273, *range(277, 280), 284, 317, *range(322, 326), 330, *range(338, 342)}
    | {347, *range(512, 515), *range(530, 533), 33550, 33922, 34264, *range(34735, 34738), 42112, 42113}
    | {51008, 51009, 51022}
)
"""Tags of pixels, thumbnails, georeferencing, and of corrections that an undistorted frame needs no more."""
EXIF_HEAD: Final = b"Exif\0\0"
"""First bytes of the segment of a JPEG that holds EXIF."""
XMP_HEAD: Final = b"http://ns.adobe.com/xap/1.0/\0"
"""First bytes of the segment of a JPEG that holds XMP."""
_ICC_HEAD: Final = b"ICC_PROFILE\0"
_APP1: Final = 0xE1
_APP2: Final = 0xE2


@dataclass(frozen=True, slots=True)
class Tag:
    """A tag: its type, the number of its values, and their bytes."""

    kind: int
    count: int
    data: bytes

    def in_order(self, order: ByteOrder, other: ByteOrder) -> Tag:
        """Return the tag, whose bytes are in one order, with its bytes in the `other`."""
        unit = 4 if self.kind in (5, 10) else SIZES[self.kind]
        if order == other or unit == 1:
            return self
        return Tag(self.kind, self.count, np.frombuffer(self.data, f"u{unit}").byteswap().tobytes())


@dataclass(slots=True)
class Directory:
    """The tags of a directory by their numbers, and the directories that some of them point to."""

    order: ByteOrder
    tags: dict[int, Tag] = field(default_factory=dict)
    below: dict[int, Directory] = field(default_factory=dict)

    def set(self, number: int, kind: int, code: str, *values: int) -> None:
        """Set a tag of a type to `values`, of which `code` is the letter of `struct`."""
        data = struct.pack(f"{self.order}{len(values)}{code}", *values)
        self.tags[number] = Tag(kind, len(data) // SIZES[kind], data)

    def set_ratio(self, number: int, value: float) -> None:
        """Set a tag to a positive fraction."""
        scale = 10 ** max(0, 9 - len(str(int(value))))
        self.set(number, 5, "I", round(value * scale), scale)

    def packed(self, start: int) -> bytes:
        """Return the directory, and what it points to, as they lie from the byte `start` on."""
        numbers = sorted(self.tags.keys() | self.below.keys())
        body, place = b"", start + 6 + 12 * len(numbers)
        entries = []
        for number in numbers:
            tag = self.tags.get(number)
            if number in self.below:
                entries.append(struct.pack(f"{self.order}HHII", number, 4, 1, place + len(body)))
                body += self.below[number].packed(place + len(body))
            elif tag is not None and len(tag.data) <= 4:
                entries.append(
                    struct.pack(f"{self.order}HHI", number, tag.kind, tag.count) + tag.data.ljust(4, b"\0")
                )
            elif tag is not None:
                entries.append(
                    struct.pack(f"{self.order}HHII", number, tag.kind, tag.count, place + len(body))
                )
                body += tag.data + b"\0" * (len(tag.data) % 2)
        count, end = struct.pack(f"{self.order}H", len(numbers)), struct.pack(f"{self.order}I", 0)
        return count + b"".join(entries) + end + body


def tags_of_tiff(block: bytes) -> Directory:
    """Return the tags of a TIFF, or of the EXIF of a JPEG.

    Raises `InputError` if they cannot be read.
    """
    order: ByteOrder | None = {b"II*\0": "<", b"MM\0*": ">"}.get(block[:4])  # type: ignore[assignment]
    if order is None or len(block) < 8:
        raise InputError("its tags cannot be copied: they are not of a TIFF with offsets of 32 bits")
    budget = [2 * len(block)]
    return _directory(block, order, struct.unpack_from(f"{order}I", block, 4)[0], budget)


def _directory(block: bytes, order: ByteOrder, place: int, budget: list[int], depth: int = 0) -> Directory:
    """Return a directory; `budget` is the number of bytes that all tags may still have together."""
    directory = Directory(order)
    count = struct.unpack_from(f"{order}H", block, place)[0] if place + 2 <= len(block) else 0
    for start in range(place + 2, min(place + 2 + 12 * count, len(block) - 11), 12):
        number, kind, values, offset = struct.unpack_from(f"{order}HHII", block, start)
        if number in POINTERS:
            if depth < 2:
                directory.below[number] = _directory(block, order, offset, budget, depth + 1)
            continue
        size = SIZES.get(kind, 0) * values
        first = start + 8 if size <= 4 else offset
        budget[0] -= size
        if budget[0] < 0:
            raise InputError("its tags cannot be copied: they are longer than the file, which may be damaged")
        if 0 < size <= len(block) - first:
            directory.tags[number] = Tag(kind, values, block[first : first + size])
    return directory


def tiff_of(directory: Directory, planes: NDArray[np.generic]) -> bytes:
    """Return a TIFF of the (bands, rows, cols) `planes` with the tags of a `directory`."""
    bands, rows, cols = planes.shape
    values = np.moveaxis(planes, 0, 2)
    values = values.astype(values.dtype.newbyteorder(directory.order))
    kind = {"u": 1, "i": 2, "f": 3}[values.dtype.kind]
    tags = {number: tag for number, tag in directory.tags.items() if number not in _OF_PIXELS}
    whole = Directory(directory.order, tags, directory.below)
    for number, value in (
        (254, 0), (256, cols), (257, rows), (259, 1), (262, 2 if bands == 3 else 1), (273, 0), (277, bands),
        (278, rows), (279, values.nbytes), (284, 1),
    ):  # fmt: skip
        whole.set(number, 4, "I", value)
    whole.set(258, 3, "H", *[8 * values.dtype.itemsize] * bands)
    whole.set(339, 3, "H", *[kind] * bands)
    place = 8 + len(whole.packed(8))
    whole.set(273, 4, "I", place)
    head = (b"II*\0" if directory.order == "<" else b"MM\0*") + struct.pack(f"{directory.order}I", 8)
    return head + whole.packed(8) + values.tobytes()


def exif_of_jpeg(directory: Directory) -> bytes:
    """Return the tags of a `directory` as the EXIF segment of a JPEG."""
    head = (b"II*\0" if directory.order == "<" else b"MM\0*") + struct.pack(f"{directory.order}I", 8)
    return EXIF_HEAD + head + directory.packed(8)


def tags_of_jpeg(block: bytes) -> tuple[Directory, bytes]:
    """Return the EXIF tags and the colour profile of a JPEG; raises `InputError` if they cannot be read."""
    exif, profile = Directory("<"), b""
    for marker, content in segments(block):
        if marker == _APP1 and content.startswith(EXIF_HEAD):
            exif = tags_of_tiff(content[len(EXIF_HEAD) :])
        elif marker == _APP2 and content.startswith(_ICC_HEAD):
            profile += content[len(_ICC_HEAD) + 2 :]
    return exif, profile


def with_segments(jpeg: bytes, contents: Mapping[bytes, int]) -> bytes:
    """Return a JPEG with segments (their contents, and their markers) behind its first one.

    Raises `InputError` if one is longer than a segment can be.
    """
    first = 4 + struct.unpack_from(">H", jpeg, 4)[0]
    added = b""
    for content, marker in contents.items():
        if len(content) > 0xFFFF - 2:
            raise InputError("its tags are longer than a JPEG can hold: give frames as TIFF")
        added += struct.pack(">BBH", 0xFF, marker, len(content) + 2) + content
    return jpeg[:first] + added + jpeg[first:]
