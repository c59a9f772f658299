"""Wrap the Markdown of the repository at 120 columns, or tell what is wider.

Paragraphs and list items with a line that is too wide are set anew; all others stay as they are. Tables,
code, headings and HTML are left alone, and links and code in a line are never broken::

    python docs/wrap_markdown.py [--check] [FILE...]

Without files it takes all Markdown files of the repository. With ``--check`` nothing is written, and the
exit status is 1 where a line is too wide.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

REPOSITORY: Final = Path(__file__).resolve().parents[1]
PLACES: Final = ("*.md", "docs/**/*.md", "*/README.md")
WIDTH: Final = 120
FENCE: Final = re.compile(r"^\s*(```|~~~)")
MARKER: Final = re.compile(r"^(\s*)([-*+]|\d+\.)(\s+)")
LEFT_ALONE: Final = re.compile(r"^\s*(\||#|<|>|!!!|\?\?\?|:::|--8<--|\[\^?[^\]]+\]:|---)")
TOKEN: Final = re.compile(r"(?:`[^`]*`|\]\([^)]*\)|[^\s`]|`)+")
"""What must stay on one line: words, code between backticks, the address of a link."""
STARTS_SOMETHING: Final = re.compile(r"^([-+*>|=]|#+|\d+[.)])$")
"""A word that would begin a list, a heading or a table if it stood at the start of a line."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Wrap the files, or with ``--check`` print what is too wide; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE")
    parser.add_argument("--check", action="store_true", help="write nothing; fail if a line is too wide")
    options = parser.parse_args(arguments)
    found = 0
    for path in options.files or markdown_files():
        text = path.read_text(encoding="utf-8")
        if options.check:
            wide = too_wide(text)
            found += len(wide)
            sys.stdout.writelines(f"{path}:{number}: {len(line)} columns\n" for number, line in wide)
        elif (wrapped := wrap(text)) != text:
            path.write_text(wrapped, encoding="utf-8")
    return 1 if found else 0


def markdown_files() -> list[Path]:
    """Return the Markdown files of the repository."""
    return sorted(path for pattern in PLACES for path in REPOSITORY.glob(pattern))


def too_wide(text: str) -> list[tuple[int, str]]:
    """Return number and text of the lines that are wider than 120 columns and could be broken."""
    return [
        (number, line)
        for number, line, may_wrap in _lines(text)
        if may_wrap and len(line) > WIDTH and len(_set(line)) > 1
    ]


def wrap(text: str) -> str:
    """Return the text with paragraphs and list items that are too wide set anew."""
    done: list[str] = []
    block: list[str] = []

    def close() -> None:
        wide = any(len(line) > WIDTH for line in block)
        done.extend(_set("\n".join(block)) if wide else block)
        block.clear()

    for _, line, may_wrap in _lines(text):
        if not may_wrap or not line.strip() or MARKER.match(line):
            close()
        if may_wrap and line.strip():
            block.append(line)
        else:
            done.append(line)
    close()
    return "\n".join(done) + "\n"


def _lines(text: str) -> Iterator[tuple[int, str, bool]]:
    """Yield number and text of each line, and whether it is a part of a paragraph or of a list item."""
    fence = ""
    for number, line in enumerate(text.splitlines(), 1):
        mark = FENCE.match(line)
        if mark and fence in ("", mark[1]):
            fence = "" if fence else mark[1]
            yield number, line, False
        else:
            yield number, line, not fence and not LEFT_ALONE.match(line)


def _set(block: str) -> list[str]:
    """Set a paragraph or a list item in lines of at most 120 columns, where its words allow it."""
    marker = MARKER.match(block)
    indent = len(marker[0]) if marker else len(block) - len(block.lstrip())
    first = marker[0] if marker else " " * indent
    lines = [first]
    for token in _tokens(block[indent:]):
        if lines[-1].strip() and lines[-1] != first and len(lines[-1]) + 1 + len(token) > WIDTH:
            lines.append(" " * indent)
        blank = "" if lines[-1] in (first, " " * indent) else " "
        lines[-1] += blank + token
    return lines


def _tokens(text: str) -> list[str]:
    tokens: list[str] = []
    for token in (" ".join(found.split()) for found in TOKEN.findall(text)):
        if tokens and STARTS_SOMETHING.match(token):
            tokens[-1] += f" {token}"
        else:
            tokens.append(token)
    return tokens


if __name__ == "__main__":
    sys.exit(main())
