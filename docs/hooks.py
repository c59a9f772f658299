"""What mkdocs does besides: CONTRIBUTING.md is a page, and the page of the API lists all public names."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
CODE_IN_TABLE = re.compile(r"`[^`\n]*\\\|[^`\n]*`")
"""Code hosts want a backslash before a bar in the code of a table; here it would be shown."""
FILE_AS_LABEL = re.compile(r"\[(?:docs/)?([\w/]+)\.md\]\(")
"""On a code host a page is a file, here it is a page."""


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:  # noqa: ANN401 -- types of mkdocs
    """Return the text of a page."""
    if page.file.src_uri == "contributing.md":
        markdown = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8").replace("](docs/", "](")
    if page.file.src_uri == "api.md":
        for kind, names in public_names().items():
            markdown = markdown.replace(f"<!-- {kind} -->", "\n".join(map(entry, names)))
    markdown = CODE_IN_TABLE.sub(lambda found: found[0].replace("\\|", "|"), markdown)
    return FILE_AS_LABEL.sub(r"[\1](", markdown)


def public_names() -> dict[str, list[str]]:
    """Return the names of `pcwlad_geo.__all__` by kind."""
    tree = ast.parse((REPOSITORY / "pcwlad_geo" / "__init__.pyi").read_text(encoding="utf-8"))
    (listed,) = (
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    )
    kinds: dict[str, list[str]] = {"functions": [], "classes": [], "errors": []}
    for name in ast.literal_eval(listed):
        if not name.startswith("_"):
            kind = "errors" if name.endswith("Error") else "classes" if name[0].isupper() else "functions"
            kinds[kind].append(name)
    return kinds


def entry(name: str) -> str:
    """Return what mkdocstrings makes the section of a name of."""
    return f"::: pcwlad_geo.{name}\n    options:\n      heading_level: 3\n"
