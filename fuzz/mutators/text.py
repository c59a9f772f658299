"""Damage to text files: numbers, cells, lines, encodings. CSV, TOML, JSON, MTL, RPC, .points, world files."""

from __future__ import annotations

import re
from random import Random

from fuzz.mutators import raw
from fuzz.mutators.numbers import word

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]{2,}")
_STRANGE = ("\0", "\x1b[31m", "\r", "\ufeff", "\u202e", "é", "😀", "%s%n", "{0}", "${HOME}", "=1+1",
            "../" * 8, "..",
            "'", '"', ",", ";", "\t", "\\", "\n\n", "<", "&amp;", "&", "\x85", "\x0c")  # fmt: skip


def _decoded(data: bytes) -> str:
    return data.decode("latin-1")


def number(random: Random, data: bytes) -> tuple[bytes, str]:
    """Put another number in the place of one or a few."""
    found = list(_NUMBER.finditer(text := _decoded(data)))
    if not found:
        return raw.damage(random, data)
    done = []
    for match in sorted(random.sample(found, min(len(found), random.choice((1, 1, 1, 2, 5)))),
                        key=lambda each: -each.start()):  # fmt: skip
        new = word(random, match[0])
        text = text[: match.start()] + new + text[match.end() :]
        done.append(f"{match[0][:20]} is {new[:20]!r}")
    return text.encode("utf-8", "surrogateescape"), ", ".join(done)


def every_number(random: Random, data: bytes) -> tuple[bytes, str]:
    """Put the same number in the place of all of a kind: equal points, no area."""
    found = _NUMBER.findall(text := _decoded(data))
    if not found:
        return raw.damage(random, data)
    old, new = random.choice(found), word(random)[:40]
    return re.sub(
        rf"(?<![\w.]){re.escape(old)}(?![\w.])", lambda _: new, text
    ).encode(), f"every {old} is {new!r}"


def name(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage, exchange or repeat a word."""
    found = list(_NAME.finditer(text := _decoded(data)))
    if not found:
        return raw.damage(random, data)
    match, other = random.choice(found), random.choice(found)[0]
    new = random.choice((other, match[0].lower(), match[0] * 2, match[0][:-1], random.choice(_STRANGE), ""))
    return (text[: match.start()] + new + text[match.end() :]).encode(), f"word {match[0]} is {new!r}"


def lines(random: Random, data: bytes) -> tuple[bytes, str]:
    """Remove, repeat, exchange or join lines."""
    rows = _decoded(data).splitlines(keepends=True)
    if len(rows) < 2:
        return raw.damage(random, data)
    first, second = random.randrange(len(rows)), random.randrange(len(rows))
    kind = random.choice(("removed", "repeated", "exchanged", "joined", "cut", "many", "emptied"))
    if kind == "removed":
        del rows[first]
    elif kind == "repeated":
        rows.insert(second, rows[first])
    elif kind == "exchanged":
        rows[first], rows[second] = rows[second], rows[first]
    elif kind == "joined":
        rows[first] = rows[first].rstrip("\r\n")
    elif kind == "cut":
        rows[first] = rows[first][: random.randrange(len(rows[first]) + 1)]
    elif kind == "many":
        rows[first] *= random.choice((50, 2000))
    else:
        rows = rows[:1]
    return "".join(rows).encode("latin-1"), f"line {first + 1} {kind}"


def strange(random: Random, data: bytes) -> tuple[bytes, str]:
    """Insert what text should not hold: control characters, escapes, another encoding."""
    place, new = random.randrange(len(data) + 1), random.choice(_STRANGE)
    kind = random.random()
    if kind < 0.7:
        return data[:place] + new.encode() + data[place:], f"{new!r} at {place}"
    if kind < 0.8:
        return data.decode("latin-1").encode("utf-16"), "in UTF-16"
    if kind < 0.9:
        return data.replace(b"\n", b"\r"), "lines end with a carriage return"
    return data[:place] + b"\xff\xfe\xe9" + data[place:], f"no UTF-8 at {place}"


ALL = (number, number, number, every_number, name, lines, strange, raw.damage)


def damage(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage text in one of these ways."""
    return random.choice(ALL)(random, data)
