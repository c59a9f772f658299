"""Text of strangers on a terminal: names and messages move no cursor and paint nothing."""

from __future__ import annotations

import unicodedata
from typing import Final

HIDDEN: Final = ("Cc", "Cs", "Zl", "Zp")
"""Unicode categories of control characters, of bytes that are no text, of line and paragraph separators."""
TURNING: Final = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of what follows: a name could be shown backwards."""


def visible(text: str) -> str:
    r"""Return a text with its control characters written as ``\x1b``, line breaks and tabs kept."""
    return "".join(_seen(each) for each in text)


def _seen(character: str) -> str:
    hidden = unicodedata.category(character) in HIDDEN or character in TURNING
    if character in "\n\t" or not hidden:
        return character
    return character.encode("unicode_escape").decode("ascii")


def one_line(message: object) -> str:
    """Return a message on one line, whatever line breaks and control characters it came with."""
    return visible(" ".join(str(message).split()))
