"""What mkdocs does besides: a file and a table of the repository go into pages, names get docstrings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
CODE_IN_TABLE = re.compile(r"`[^`\n]*\\\|[^`\n]*`")
"""Code hosts want a backslash before a bar in the code of a table; here it would be shown."""
FILE_AS_LABEL = re.compile(r"\[(?:docs/)?([\w/]+)\.md\]\(")
"""On a code host a page is a file, here it is a page."""

NAMES = re.compile(r"Names: ((?:`\w+`,?\s?)+)")
"""Public names of one part of the page of the API."""

WHOLE = re.compile(r"<code>(?=(?:--|&lt;)[^<]{1,42}</code>)")
"""A name of an option or a file that fits on a line."""


def on_page_content(html: str, **_: Any) -> str:  # noqa: ANN401 -- types of mkdocs
    """Return the content of a page, in which short names of options and files stay on one line."""
    return WHOLE.sub('<code class="whole">', html)


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:  # noqa: ANN401 -- types of mkdocs
    """Return the text of a page."""
    if page.file.src_uri == "contributing.md":
        markdown = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8").replace("](docs/", "](")
    if page.file.src_uri == "api.md":
        markdown = NAMES.sub(lambda line: "\n".join(map(entry, re.findall(r"\w+", line[1]))) + "\n", markdown)
    if page.file.src_uri == "index.md":
        markdown = markdown.replace("<!-- what to use when -->", section_of_readme("What to use when"))
    markdown = CODE_IN_TABLE.sub(lambda found: found[0].replace("\\|", "|"), markdown)
    return FILE_AS_LABEL.sub(r"[\1](", markdown)


def section_of_readme(title: str) -> str:
    """Return the text below a heading of the README, with links that hold among the pages."""
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    return text.partition(f"\n## {title}\n")[2].partition("\n## ")[0].strip().replace("](docs/", "](")


def entry(name: str) -> str:
    """Return what mkdocstrings makes the section of a name of."""
    return f"::: pcwlad_geo.{name}\n    options:\n      heading_level: 3\n"
