"""Damage to the structure of a TIFF: its directories, their entries, and the values that these point to."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from random import Random
from typing import Final

from fuzz.mutators import raw, text
from fuzz.mutators.numbers import integer, real

SIZES: Final = {
    1: 1,
    2: 1,
    3: 2,
    4: 4,
    5: 8,
    6: 1,
    7: 1,
    8: 2,
    9: 4,
    10: 8,
    11: 4,
    12: 8,
    13: 4,
    16: 8,
    17: 8,
    18: 8,
}
"""Bytes of a value by type."""
_FORMATS: Final = {
    1: "B",
    3: "H",
    4: "I",
    8: "h",
    9: "i",
    11: "f",
    12: "d",
    13: "I",
    16: "Q",
    17: "q",
    18: "Q",
}
NAMES: Final = {
    254: "NewSubfileType", 256: "ImageWidth", 257: "ImageLength", 258: "BitsPerSample", 259: "Compression",
    262: "Photometric", 273: "StripOffsets", 277: "SamplesPerPixel", 278: "RowsPerStrip",
    279: "StripByteCounts",
    284: "PlanarConfig", 317: "Predictor", 320: "ColorMap", 322: "TileWidth", 323: "TileLength",
    324: "TileOffsets", 325: "TileByteCounts", 330: "SubIFDs", 338: "ExtraSamples", 339: "SampleFormat",
    33550: "ModelPixelScale", 33922: "ModelTiepoint", 34264: "ModelTransformation", 34735: "GeoKeyDirectory",
    34736: "GeoDoubleParams", 34737: "GeoAsciiParams", 42112: "GDAL_METADATA", 42113: "GDAL_NODATA",
    50844: "RPCCoefficient",
}  # fmt: skip
COMPRESSIONS: Final = (
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    8,
    32773,
    32946,
    34661,
    34712,
    34887,
    34925,
    50000,
    50001,
    50002,
    65535,
)
_DIMENSIONS: Final = (256, 257, 278, 322, 323)


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of a directory, as it stands in the file."""

    at: int
    """Its offset."""
    tag: int
    kind: int
    count: int
    values_at: int
    """Offset of its values, in the entry or elsewhere."""

    @property
    def name(self) -> str:
        """What the tag is called."""
        return NAMES.get(self.tag, f"tag {self.tag}")

    @property
    def end(self) -> int:
        """Offset of what follows the values."""
        return self.values_at + self.count * SIZES.get(self.kind, 1)


@dataclass(frozen=True, slots=True)
class Layout:
    """The directories of a little-endian TIFF or BigTIFF."""

    big: bool
    directories: tuple[tuple[int, tuple[Entry, ...]], ...]
    """Offset and entries of each."""

    @property
    def entries(self) -> list[Entry]:
        """All entries."""
        return [entry for _, entries in self.directories for entry in entries]

    @property
    def size(self) -> int:
        """Bytes of an entry."""
        return 20 if self.big else 12

    def links(self) -> list[int]:
        """Return where the offsets of directories stand."""
        head = 8 if self.big else 2
        ends = [at + head + self.size * len(entries) for at, entries in self.directories]
        return [8 if self.big else 4, *ends]


def layout(data: bytes) -> Layout | None:
    """Return the directories that can be followed; None where there is none."""
    if data[:4] not in (b"II*\0", b"II+\0"):
        return None
    big = data[2:3] == b"+"
    offset, head, size = ("Q", 8, 20) if big else ("I", 2, 12)
    found: list[tuple[int, tuple[Entry, ...]]] = []
    try:
        (at,) = struct.unpack_from("<" + offset, data, 8 if big else 4)
        while 0 < at < len(data) and len(found) < 20 and at not in [each for each, _ in found]:
            (count,) = struct.unpack_from("<Q" if big else "<H", data, at)
            entries = tuple(_entry(data, at + head + size * index, big) for index in range(min(count, 200)))
            found.append((at, entries))
            (at,) = struct.unpack_from("<" + offset, data, at + head + size * count)
    except (struct.error, OverflowError):  # the count of a damaged directory
        pass
    return Layout(big, tuple(found)) if any(entries for _, entries in found) else None


def _entry(data: bytes, at: int, big: bool) -> Entry:
    tag, kind, count = struct.unpack_from("<HHQ" if big else "<HHI", data, at)
    room, field = (8, at + 12) if big else (4, at + 8)
    inside = count * SIZES.get(kind, 1) <= room
    return Entry(
        at, tag, kind, count, field if inside else struct.unpack_from("<Q" if big else "<I", data, field)[0]
    )


def _put(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :] if 0 <= at <= len(data) - len(new) else data


def value(random: Random, data: bytes, found: Layout) -> tuple[bytes, str]:
    """Change one or all values of an entry."""
    entry = random.choice([each for each in found.entries if each.tag in NAMES] or found.entries)
    return _value_of(random, data, entry)


def _value_of(random: Random, data: bytes, entry: Entry) -> tuple[bytes, str]:
    if entry.tag in (34737, 42112, 42113):
        content, did = text.damage(random, data[entry.values_at : entry.end])
        content = content[: entry.end - entry.values_at].ljust(entry.end - entry.values_at, b"\0")
        return _put(data, entry.values_at, content), f"{entry.name}: {did}"
    letter = _FORMATS.get(entry.kind, "B")
    size = SIZES.get(entry.kind, 1)
    whole = random.random() < 0.2
    indices = range(min(entry.count, 500)) if whole else [random.randrange(max(1, min(entry.count, 500)))]
    new: float = 0
    for index in indices:
        at = entry.values_at + index * size
        if at + size > len(data) or at < 0:
            break
        (old,) = struct.unpack_from("<" + letter, data, at)
        if index == indices[0]:
            new = _new_value(random, entry, old, letter)
        data = _put(data, at, _packed(letter, size, new))
    return data, f"{entry.name}[{'all' if whole else indices[0]}] is {new}"


def _new_value(random: Random, entry: Entry, old: float, letter: str) -> float:
    if entry.tag == 259:
        return random.choice(COMPRESSIONS)
    return real(random, old) if letter in "fd" else integer(random, int(old))


def _packed(letter: str, size: int, number: float) -> bytes:
    if letter in "fd":
        try:
            return struct.pack("<" + letter, number)
        except OverflowError:
            return struct.pack("<" + letter, float("inf"))
    return (int(number) % (1 << 8 * size)).to_bytes(size, "little")


def dimensions(random: Random, data: bytes, found: Layout) -> tuple[bytes, str]:
    """Say that the image, its strips or its tiles have another size."""
    entries = [each for each in found.entries if each.tag in _DIMENSIONS]
    return _value_of(random, data, random.choice(entries)) if entries else value(random, data, found)


def sparse(random: Random, data: bytes, found: Layout) -> tuple[bytes, str]:
    """Make the image huge, its blocks absent: nothing of it is in the file."""
    side = random.choice((5_000, 30_000, 100_000, 300_000, 1_000_000, 0x7FFFFFFF))
    for entry in found.entries:
        if entry.tag in (256, 257, 322, 323, 278):
            new = side if entry.tag in (256, 257) else random.choice((16, 256, 4096, side))
            size = SIZES.get(entry.kind, 1)
            data = _put(data, entry.at + 2, struct.pack("<H", 4))  # LONG: a SHORT could not hold it
            data = _put(data, entry.values_at, new.to_bytes(4, "little")) if size <= 4 else data
        if entry.tag in (273, 279, 324, 325):
            data = _put(data, entry.values_at, bytes(max(0, min(entry.end, len(data)) - entry.values_at)))
    return data, f"sparse, {side} px a side"


def field(random: Random, data: bytes, found: Layout) -> tuple[bytes, str]:
    """Change the tag, type, count or offset of an entry."""
    entry = random.choice(found.entries)
    kind = random.choice(("tag", "type", "count", "offset"))
    if kind == "tag":
        new = random.choice((*NAMES, 0, 65535, 347, 37724, entry.tag + 1))
        return _put(data, entry.at, struct.pack("<H", new & 0xFFFF)), f"{entry.name} is tag {new}"
    if kind == "type":
        new = random.choice((*SIZES, 0, 14, 99, 65535))
        return _put(data, entry.at + 2, struct.pack("<H", new)), f"{entry.name} has type {new}"
    size = 8 if found.big else 4
    new = integer(random, entry.count if kind == "count" else entry.values_at) % (1 << 8 * size)
    at = entry.at + 4 + (0 if kind == "count" else size)
    return _put(data, at, new.to_bytes(size, "little")), f"{entry.name} has {kind} {new}"


def entries(random: Random, data: bytes, found: Layout) -> tuple[bytes, str]:
    """Remove, repeat or exchange entries of a directory."""
    at, inside = random.choice([each for each in found.directories if each[1]])
    first, second = random.choice(inside), random.choice(inside)
    one = data[first.at : first.at + found.size]
    kind = random.choice(("removed", "repeated", "exchanged", "fewer", "more"))
    if kind in ("fewer", "more"):
        count = integer(random, len(inside)) if kind == "more" else random.randrange(len(inside) + 1)
        width = 8 if found.big else 2
        return _put(
            data, at, (count % (1 << 8 * width)).to_bytes(width, "little")
        ), f"directory of {count} entries"
    if kind == "removed":
        return _put(data, first.at, struct.pack("<H", 65000)), f"{first.name} removed"
    if kind == "exchanged":
        data = _put(data, first.at, data[second.at : second.at + found.size])
    return _put(data, second.at, one), f"{first.name} {kind} at {second.name}"


def links(random: Random, data: bytes, found: Layout) -> tuple[bytes, str]:
    """Point the chain of directories elsewhere: to itself, beyond the end, into pixels."""
    at = random.choice(found.links())
    new = random.choice((0, found.directories[0][0], found.directories[-1][0], len(data) - 4, 8,
                         random.randrange(len(data)), 0xFFFFFFF0))  # fmt: skip
    return _put(data, at, new.to_bytes(8 if found.big else 4, "little")), f"directory offset {new}"


def geography(random: Random, data: bytes, found: Layout) -> tuple[bytes, str]:
    """Change the georeferencing, the control points, the RPCs or the metadata."""
    wanted = [each for each in found.entries if each.tag >= 33000]
    return _value_of(random, data, random.choice(wanted)) if wanted else value(random, data, found)


ALL = (value, value, dimensions, sparse, field, entries, links, geography, geography)


def damage(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage the structure of a TIFF in one of these ways; of what is none, the bytes."""
    found = layout(data)
    if found is None:
        return raw.damage(random, data)
    return random.choice(ALL)(random, data, found)
