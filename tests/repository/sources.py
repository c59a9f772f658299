"""The modules of the package, each parsed once in a process."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "pcwlad_geo"
SOURCES = {
    ".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
"""The file of each module."""


@cache
def text_of(module: str) -> str:
    """Return the source of a module."""
    return SOURCES[module].read_text(encoding="utf-8")


@cache
def parsed(module: str) -> ast.Module:
    """Return the syntax tree of a module, which nobody may change."""
    return ast.parse(text_of(module))
