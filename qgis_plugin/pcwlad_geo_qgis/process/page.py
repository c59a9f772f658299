"""The report page of a pair in the language of QGIS: known texts of it, also in its figures."""

from __future__ import annotations

import base64
import re
from contextlib import suppress
from functools import cache
from html import escape, unescape
from pathlib import Path

from ..page_sentences import LANGUAGE, PAGE
from ..sentences import SENTENCES, pattern
from ..text import tr

PARTS = re.compile(r"(<(style|script|code|pre)\b.*?</\2>|<[^>]*>)", re.DOTALL)
"""Tags, and what is no text."""
READ = re.compile(r'\b(alt|aria-label)="([^"]*)"')
FIGURE = re.compile(r"(data:image/svg\+xml;base64,)([\w+/=]+)")
WORD = re.compile("[A-Za-z]{2}")
LEAST = 7
"""Characters of a text that is looked for within others."""


def translate(path: Path) -> None:
    """Write a page in the language of QGIS; one that cannot be read stays as it is."""
    if tr(LANGUAGE) != LANGUAGE:
        with suppress(OSError, UnicodeError):
            path.write_text(translated(path.read_text(encoding="utf-8")), encoding="utf-8")


def translated(page: str) -> str:
    """Return a page, or a figure, in the language of QGIS."""
    parts = PARTS.split(page)  # text, tag, the name of what is left out, text, …
    for place in range(0, len(parts), 3):
        parts[place] = _spoken(parts[place])
    for place in range(1, len(parts), 3):
        tag = FIGURE.sub(lambda match: match[1] + _figure(match[2]), parts[place])
        tag = READ.sub(lambda match: f'{match[1]}="{_spoken(match[2])}"', tag)
        parts[place] = tag.replace(f'lang="{LANGUAGE}"', f'lang="{tr(LANGUAGE)}"')
    return "".join(part for place, part in enumerate(parts) if place % 3 < 2)


def _figure(data: str) -> str:
    return base64.b64encode(translated(base64.b64decode(data).decode("utf-8")).encode()).decode()


def _spoken(text: str) -> str:
    """Return a text of HTML with the space around it."""
    if not WORD.search(text):
        return text
    before, after = (" " if text[place].isspace() else "" for place in (0, -1))
    return before + escape(text_of(" ".join(unescape(text).split()))) + after


@cache
def text_of(text: str) -> str:
    """Return a text in the language of QGIS: as a whole, with its values, or the parts that are known."""
    if (whole := _whole(text)) is not None:
        return whole
    if (whole := _whole(text[:1].lower() + text[1:])) is not None:
        return whole[:1].upper() + whole[1:]
    for sentence, part in INNER:
        text = part.sub(lambda match, sentence=sentence: _filled(sentence, match), text)
    return text


def _whole(text: str) -> str | None:
    if text in WHOLE:
        return tr(text)
    matches = ((sentence, whole.fullmatch(text)) for sentence, whole in PATTERNS)
    return next((_filled(sentence, match) for sentence, match in matches if match), None)


def _filled(sentence: str, match: re.Match[str]) -> str:
    return tr(sentence).format(*map(text_of, match.groups()))


WHOLE = {sentence for sentence in PAGE if "{}" not in sentence}
_LONGEST = sorted((*PAGE, *SENTENCES), key=len, reverse=True)  # some are parts of others
PATTERNS = [
    (sentence, re.compile("(.+?)".join(map(re.escape, sentence.split("{}")))))
    for sentence in _LONGEST
    if "{}" in sentence and sentence in PAGE
]
INNER = [(sentence, pattern(sentence)) for sentence in _LONGEST if len(sentence) >= LEAST and " " in sentence]
