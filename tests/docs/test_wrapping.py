"""Markdown is wrapped at 120 columns: tables, code, headings and single long links excepted."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def load(path: Path) -> ModuleType:
    """Import a script that lies outside of the package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


wrapping = load(REPOSITORY / "docs" / "wrap_markdown.py")
FILES = wrapping.markdown_files()


def test_all_files_are_looked_at() -> None:
    names = {path.relative_to(REPOSITORY).as_posix() for path in FILES}
    assert {"README.md", "CHANGELOG.md", "docs/method.md", "benchmarks/README.md"} <= names


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_no_line_is_too_wide(path: Path) -> None:
    assert wrapping.too_wide(path.read_text(encoding="utf-8")) == []


def test_a_wide_paragraph_is_told_and_set_anew() -> None:
    text = "word " * 40 + "\n\n- " + "item " * 40 + "\n"
    assert [number for number, _ in wrapping.too_wide(text)] == [1, 3]
    lines = wrapping.wrap(text).splitlines()
    assert max(map(len, lines)) <= 120
    assert lines[lines.index("") + 1].startswith("- item")
    assert lines[-1].startswith("  item")
    assert "".join(lines).split() != []
    assert "".join(wrapping.wrap(text).split()) == "".join(text.split())


def test_what_cannot_be_broken_stays() -> None:
    link = f"[x](https://example.org/{'a' * 150})"
    fenced = f"```\n{'code ' * 40}\n```"
    table = f"| {'cell ' * 40}|"
    assert wrapping.too_wide("\n".join([link, fenced, table])) == []


def test_a_wrapped_line_never_begins_a_list() -> None:
    text = "a - b " * 50
    assert not [line for line in wrapping.wrap(text).splitlines() if line.startswith("-")]
