"""Damage to the bytes of any file: flipped bits, holes, truncation, repetition."""

from __future__ import annotations

from random import Random


def flip_bits(random: Random, data: bytes) -> tuple[bytes, str]:
    """Flip some bits, half of the time near the start, where headers are."""
    if not data:
        return b"\0", "one byte instead of none"
    made = bytearray(data)
    reach = len(made) if random.random() < 0.5 else min(len(made), 512)
    places = [random.randrange(reach) for _ in range(random.choice((1, 1, 2, 4, 16)))]
    for place in places:
        made[place] ^= 1 << random.randrange(8)
    return bytes(made), f"bits flipped in {len(places)} bytes from {min(places)}"


def set_bytes(random: Random, data: bytes) -> tuple[bytes, str]:
    """Overwrite a run of bytes with one value or noise."""
    start, length = random.randrange(len(data) + 1), random.choice((1, 2, 4, 8, 64, 500))
    filling = random.choice((b"\0" * length, b"\xff" * length, random.randbytes(length)))
    return data[:start] + filling + data[start + length :], f"{length} bytes overwritten from {start}"


def truncate(random: Random, data: bytes) -> tuple[bytes, str]:
    """Cut the end off."""
    length = random.choice(
        (0, 1, 4, 8, random.randrange(len(data) + 1), max(0, len(data) - random.randrange(1, 40)))
    )
    return data[:length], f"truncated to {length} of {len(data)} bytes"


def remove_part(random: Random, data: bytes) -> tuple[bytes, str]:
    """Take a part out of the middle."""
    start, length = random.randrange(len(data) + 1), random.randrange(1, max(2, len(data) // 3))
    return data[:start] + data[start + length :], f"{length} bytes removed from {start}"


def repeat_part(random: Random, data: bytes) -> tuple[bytes, str]:
    """Insert a part of the file a second time."""
    start, length = random.randrange(len(data) + 1), random.randrange(1, 300)
    place = random.randrange(len(data) + 1)
    return data[:place] + data[start : start + length] + data[
        place:
    ], f"{length} bytes of {start} again at {place}"


def append_noise(random: Random, data: bytes) -> tuple[bytes, str]:
    """Add bytes to the end."""
    length = random.choice((1, 100, 4096))
    return data + random.randbytes(length), f"{length} bytes added to the end"


ALL = (flip_bits, flip_bits, set_bytes, truncate, remove_part, repeat_part, append_noise)


def damage(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage bytes in one of these ways."""
    return random.choice(ALL)(random, data)
