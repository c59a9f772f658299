"""docs/development/robustness.md: each test that it names is there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
PAGE = TESTS.parent / "docs" / "development" / "robustness.md"
NODE_ID = re.compile(r"`([\w/]+\.py)::(\w+)`")


def functions(file: Path) -> set[str]:
    """Return the tests of a file; none where it is not there."""
    if not file.is_file():
        return set()
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_every_row_names_a_test_that_is_there() -> None:
    cases_only = PAGE.read_text(encoding="utf-8").partition("## Measured at large")[0]
    rows = [line for line in cases_only.splitlines() if line.startswith("|")]
    cases = [row for row in rows if not row.startswith(("|---", "| case |"))]
    assert len(cases) > 40
    assert [row for row in cases if not NODE_ID.search(row)] == []
    named = NODE_ID.findall("\n".join(cases))
    assert [f"{file}::{test}" for file, test in named if test not in functions(TESTS / file)] == []
