"""The pages of the documentation, and the blocks of code in them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
PAGES = [
    *sorted(REPOSITORY.glob("*.md")),
    *sorted(REPOSITORY.glob("*/README.md")),
    *sorted(DOCS.rglob("*.md")),
]
BLOCK = re.compile(
    r"(?P<before><!-- *(?P<mark>[^>]*?) *-->\n)?^(?P<indent> *)```(?P<language>[^\n]*)\n(?P<text>.*?)^ *```",
    re.S | re.M,
)


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block."""

    language: str
    text: str
    mark: str
    """The comment on the line before it."""


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page, in their order; not those that show a file."""
    found = BLOCK.finditer(page.read_text(encoding="utf-8"))
    all_blocks = [Block(each["language"], dedent(each["text"]), each["mark"] or "") for each in found]
    return [block for block in all_blocks if "--8<--" not in block.text]


def code_of(page: Path) -> str:
    """Return the Python code of a page."""
    return "\n".join(block.text for block in blocks(page) if block.language == "python")


def name_of(page: Path) -> str:
    """Return the name of a page as the tests show it."""
    return page.relative_to(REPOSITORY).as_posix()
