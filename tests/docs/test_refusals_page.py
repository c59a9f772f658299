"""docs/howto/refused.md quotes the messages of the code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.docs.pages import DOCS, REPOSITORY

PAGE = DOCS / "howto" / "refused.md"
QUOTED = re.compile(r"^\| (?:[^|]*: )?`([^`|]+)` +\|", re.M)


def strings(package: Path) -> Iterator[str]:
    """Yield the texts of a package: whole literals, and the fixed parts of those with values in them."""
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_each_reason_of_the_page_is_one_that_the_code_gives() -> None:
    quoted = [text for text in QUOTED.findall(PAGE.read_text(encoding="utf-8")) if " " in text]
    assert len(quoted) > 20
    texts = "\n".join(strings(REPOSITORY / "pcwlad_geo"))
    assert [text for text in quoted if text not in texts] == []


def test_each_reason_of_the_verdict_is_on_the_page() -> None:
    """Of every function that returns a reason of the verdict, some words of each text stand on the page."""
    folder = REPOSITORY / "pcwlad_geo/registration"
    trees = [
        ast.parse((folder / name).read_text("utf-8")) for name in ("judge.py", "motions.py", "advice.py")
    ]
    nodes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    functions = {node.name: node for node in nodes}
    quoted = QUOTED.findall(PAGE.read_text(encoding="utf-8"))
    for name in ("_nothing_to_match", "_too_few", "_advice", "describe_motions", "motion_of_the_ground"):
        texts = [
            node.value
            for node in ast.walk(functions[name])
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        ]
        assert any(words in text for words in quoted for text in texts), name
