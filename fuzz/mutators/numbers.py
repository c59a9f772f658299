"""Values that programs trip over."""

from __future__ import annotations

from random import Random
from typing import Final

INTEGERS: Final = (
    0, 1, 2, 3, 7, 8, 16, 31, 64, 100, 127, 128, 255, 256, 1000, 4095, 32767, 32768, 65535, 65536, 100_000,
    1_000_000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF, 1 << 32, 1 << 40, (1 << 63) - 1, (1 << 64) - 1,
)  # fmt: skip
FLOATS: Final = (
    0.0, -0.0, 1.0, -1.0, 0.5, 1e-300, 5e-324, 1e-12, 1e-9, 1e-3, 90.0, 90.5, -91.0, 179.9, 180.04, 360.0,
    1e5, 1e7, 1e9, 2147483648.0, 1e15, 1e38, 1e39, 1e300, 1.7976931348623157e308, float("inf"), float("-inf"),
    float("nan"),
)  # fmt: skip
WORDS: Final = (
    "", "0", "-0", "1", "-1", "2", "0.5", "1e-9", "1e-300", "1e9", "1e300", "1e308", "1e309", "-1e308",
    "nan", "NaN",
    "inf", "-inf", "65535", "65536", "2147483647", "2147483648", "-2147483648", "4294967296", "100000000",
    "9223372036854775808", "1" * 400, "0x10", "1,5", "1_000", "½", "٣", "1e", "--1", "true", "None", "?",
    "A" * 5000,
)  # fmt: skip


def integer(random: Random, near: int = 0) -> int:
    """Return an integer: one that programs trip over, one beside the present one, or any."""
    kind = random.random()
    if kind < 0.6:
        return random.choice(INTEGERS)
    if kind < 0.85:
        return max(0, near + random.choice((-2, -1, 1, 2, near, -near // 2, 8, -8)))
    return random.getrandbits(random.choice((4, 8, 16, 31, 32)))


def real(random: Random, near: float = 0.0) -> float:
    """Return a float: one that programs trip over, or one beside the present one."""
    if random.random() < 0.7:
        return random.choice(FLOATS) * random.choice((1.0, 1.0, 1.0, -1.0))
    return near * random.choice((-1.0, 0.0, 0.5, 1 + 1e-9, 1.001, 2.0, 1e3, 1e-3, 1e6, 1e-6, 1e12))


def word(random: Random, near: str = "0") -> str:
    """Return a number as text, or what stands where one should."""
    if random.random() < 0.75:
        return random.choice(WORDS)
    try:
        return repr(real(random, float(near)))
    except ValueError:
        return random.choice(WORDS)
