"""What the pages refer to is there: files, headings, public names; and what is said twice agrees."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import pcwlad_geo
from tests.docs.pages import DOCS, PAGES, REPOSITORY, name_of

LINK = re.compile(r"\]\(([^)\s]+)\)")
TERM = re.compile(r"^\| ([^|]+?) \|")
LIST_ITEM = re.compile(r"^\s*([-*+]|\d+\.) ")


def prose(page: Path) -> str:
    """Return a page without what stands before its title, and without its fenced blocks."""
    text = re.sub(r"\A---\n.*?\n---\n", "", page.read_text(encoding="utf-8"), flags=re.S)
    return re.sub(r"^ *```.*?^ *```", "", text, flags=re.S | re.M)


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings, as code hosts and mkdocs make them."""
    titles = re.findall(r"^#+ +(.*)$", prose(page), re.M)
    slugs = [re.sub(r"[^\w\s-]", "", title.lower().replace("`", "")).strip() for title in titles]
    return {re.sub(r"\s+", "-", slug) for slug in slugs}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    dead = []
    for link in LINK.findall(prose(page)):
        if re.match(r"https?:|mailto:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if target.name == "contributing.md":
            target = REPOSITORY / "CONTRIBUTING.md"
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dead.append(link)
    assert dead == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_lists_begin_after_an_empty_line(page: Path) -> None:
    """Without one, the site shows them as a paragraph."""
    wrong = []
    for paragraph in re.split(r"\n[ \t]*\n", prose(page)):
        lines = [line for line in paragraph.splitlines() if line.strip() and not line.startswith("#")]
        items = [LIST_ITEM.match(line) is not None for line in lines]
        if any(items) and not items[0]:
            wrong.append(lines[items.index(True)])
    assert wrong == []


def test_no_page_of_the_site_leaves_the_folder_of_the_site() -> None:
    pages = [page for page in PAGES if page.is_relative_to(DOCS)]
    assert [
        name_of(page) for page in pages for link in LINK.findall(prose(page)) if outside(page, link)
    ] == []


def outside(page: Path, link: str) -> bool:
    """Return whether a link leads to a file out of ``docs``."""
    return not re.match(r"https?:|#", link) and not (page.parent / link).resolve().is_relative_to(DOCS)


def test_the_glossary_has_each_term_once() -> None:
    rows = [TERM.match(line) for line in (DOCS / "glossary.md").read_text(encoding="utf-8").splitlines()]
    terms = [row[1] for row in rows if row and row[1] not in ("term", "---")]
    assert len(terms) > 60
    assert sorted(terms) == sorted(set(terms))


def test_the_citation_is_of_this_version() -> None:
    text = (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {pcwlad_geo.__version__}\n" in text


def test_the_architecture_names_the_folders_that_are_there() -> None:
    page = (DOCS / "development" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("## The rooms")[2].partition("\n## ")[0]
    rooms = {path.parent.name for path in (REPOSITORY / "pcwlad_geo").glob("*/__init__.py")}
    assert {name for name in rooms if f"`{name}/`" not in table} == set()
