"""The site: built without a warning, asks no server for anything, and its API page has every public name."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pcwlad_geo
from tests.docs.pages import DOCS, REPOSITORY

for _library in ("mkdocs", "material", "mkdocstrings"):
    pytest.importorskip(_library, reason="the extra `docs` is not installed")

LOADED = re.compile(
    r"<(?:script|img|iframe)\b[^>]*\bsrc=\"(https?:|//)|<link\b[^>]*rel=\"?stylesheet[^>]*\bhref=\"(?:https?:|//)"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built anew."""
    folder = tmp_path_factory.mktemp("site")
    ended = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=REPOSITORY,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert "WARNING" not in ended.stderr
    return folder


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 25
    assert [page.name for page in pages if LOADED.search(page.read_text(encoding="utf-8"))] == []


def test_the_api_page_has_every_public_name(site: Path) -> None:
    page = (site / "api.html").read_text(encoding="utf-8")
    names = [name for name in pcwlad_geo.__all__ if not name.startswith("_")]
    assert [name for name in names if f'id="pcwlad_geo.{name}"' not in page] == []


def test_the_api_page_lists_each_name_once_below_what_it_is_about() -> None:
    page = (DOCS / "api.md").read_text("utf-8")
    parts = re.findall(r"^## (.+)\n(?:[^#]*\n)?Names: ((?:`\w+`,?\s?)+)", page, re.M)
    listed = [name for _, names in parts for name in re.findall(r"\w+", names)]
    assert sorted(listed) == sorted(name for name in pcwlad_geo.__all__ if not name.startswith("_"))
    assert len(parts) > 10


def test_the_first_page_says_what_to_use_when(site: Path) -> None:
    page = (site / "index.html").read_text(encoding="utf-8")
    assert "Ames Stereo Pipeline" in page
    assert 'href="accuracy.html#speed"' in page


def test_no_markdown_is_left_in_the_text(site: Path) -> None:
    """Lists, fences and includes that the site did not understand."""
    for page in site.rglob("*.html"):
        text = re.sub(r"<(pre|code|script)\b.*?</\1>", "", page.read_text(encoding="utf-8"), flags=re.S)
        assert not re.search(r"^(```|- |\| )|--8<--|\{ ?width=|<p>[-*] ", text, re.M), page.name


def test_bars_in_the_code_of_tables_are_bars(site: Path) -> None:
    page = (site / "options.html").read_text(encoding="utf-8")
    assert "--grid reference|reference-exact|target" in page
    assert "\\|" not in page
