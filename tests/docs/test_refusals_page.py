"""docs/howto/refused.md quotes the messages of the code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tests.docs.pages import DOCS
from tests.repository.sources import SOURCES, parsed

PAGE = DOCS / "howto" / "refused.md"
QUOTED = re.compile(r"^\| (?:[^|]*: )?`([^`|]+)` +\|", re.M)


def strings() -> Iterator[str]:
    """Yield the texts of the package: whole literals, and the fixed parts of those with values in them."""
    for module in SOURCES:
        for node in ast.walk(parsed(module)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_each_reason_of_the_page_is_one_that_the_code_gives() -> None:
    quoted = [text for text in QUOTED.findall(PAGE.read_text(encoding="utf-8")) if " " in text]
    assert len(quoted) > 20
    texts = "\n".join(strings())
    assert [text for text in quoted if text not in texts] == []


def test_each_reason_of_the_verdict_is_on_the_page() -> None:
    """Of every function that returns a reason of the verdict, some words of each text stand on the page."""
    trees = [parsed(f"pcwlad_geo.registration.{name}") for name in ("judge", "motions", "advice")]
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
