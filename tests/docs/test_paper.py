"""The paper: its form, its references, and that it says no figure that the documentation has not."""

from __future__ import annotations

import importlib.util
import re
from types import ModuleType

import pytest
import yaml

from tests.docs.pages import DOCS, REPOSITORY

PAPER = REPOSITORY / "paper"
TEXT = (PAPER / "paper.md").read_text(encoding="utf-8")
ACCURACY = (DOCS / "accuracy.md").read_text(encoding="utf-8")
ENTRIES = dict(
    re.findall(r"^@\w+\{(\w+),\n(.*?)^\}", (PAPER / "paper.bib").read_text(encoding="utf-8"), re.M | re.S)
)
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:–\d+)?(?![\w])")
SECTIONS = ["Summary", "Statement of need", "State of the field", "What is new", "Accuracy measured here"]
SECTIONS += ["Acknowledgements", "References"]


def figures() -> ModuleType:
    """Import the script that makes the figures."""
    spec = importlib.util.spec_from_file_location("make_figures", PAPER / "make_figures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_has_the_form_of_the_journal() -> None:
    head = yaml.safe_load(TEXT.split("---\n")[1])
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= head.keys()
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert [each["name"] for each in head["authors"]] == [each["name"] for each in citation["authors"]]
    assert (PAPER / head["bibliography"]).is_file()
    assert re.findall(r"^# (.+)$", TEXT, re.M) == SECTIONS
    assert len(TEXT.split()) < 1500


def test_each_reference_is_cited_and_each_citation_is_there() -> None:
    cited = set(re.findall(r"@(\w+\d{4})", TEXT.split("---\n", 2)[2]))
    assert cited == ENTRIES.keys()
    for name, entry in ENTRIES.items():
        assert all(re.search(rf"^  {field} *= ", entry, re.M) for field in ("author", "title", "year")), name
        where = re.search(
            r"^  (?:doi *= \{10\.\d{4,5}/\S+\}|eprint *= \{\d{4}\.\d{5}\}|journal *= )", entry, re.M
        )
        assert where is not None, name


def measured() -> list[tuple[str, str]]:
    """Return each command of the paper, with the text that stands below it."""
    section = TEXT.partition("# Accuracy measured here")[2].partition("What it does not do")[0]
    parts = re.split(r"<!-- figures: (.*?) -->", section)
    return list(zip(parts[1::2], parts[2::2], strict=True))


def test_there_are_figures() -> None:
    assert len(measured()) >= 4


@pytest.mark.parametrize(("command", "text"), measured(), ids=lambda value: value[:40])
def test_every_number_stands_below_the_same_command_in_the_documentation(command: str, text: str) -> None:
    marked = f"<!-- figures: {command} -->"
    assert marked in ACCURACY
    there = ACCURACY.partition(marked)[2].partition("<!-- figures:")[0]
    said = re.sub(r"!\[.*?\]\(.*?\)", "", text, flags=re.S)
    numbers = NUMBER.findall(re.sub(r"`.*?`|Landsat 8|@\w+", "", said))
    assert numbers != [] or command == "python benchmarks/accuracy.py"
    assert [each for each in numbers if each not in there] == []


README = re.split(r"<!-- figures: (.*?) -->", (REPOSITORY / "README.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("command", "text"), list(zip(README[1::2], README[2::2], strict=True)))
def test_every_number_of_the_readme_stands_below_a_command_that_prints_it(command: str, text: str) -> None:
    parts = re.split(r"<!-- figures: (.*?) -->", ACCURACY)
    program, _, studies = command.partition(" --study ")
    there = "".join(
        below
        for mark, below in zip(parts[1::2], parts[2::2], strict=True)
        if mark == command
        or (studies and mark.startswith(program) and studies in mark.split(" --study ")[-1])
    )
    numbers = NUMBER.findall(re.sub(r"\[.*?\]\(.*?\).*|`.*?`|Landsat 8", "", text.partition("\n## ")[0]))
    assert numbers != []
    assert [each for each in numbers if each not in there] == []


def test_outside_of_that_section_no_error_is_claimed() -> None:
    before = TEXT.partition("# Accuracy measured here")[0]
    assert re.findall(r"\d\.\d+ ?px", before) == []


def test_the_pictures_are_there_and_few() -> None:
    named = re.findall(r"!\[[^\]]*\]\((\S+)\)", TEXT)
    assert sorted(named) == sorted(path.name for path in PAPER.glob("*.png"))
    assert len(named) <= 2
    assert all((PAPER / name).stat().st_size < 500_000 for name in named)


def test_the_picture_of_speeds_is_drawn_from_the_table() -> None:
    module = figures()
    speeds = module.Speeds(ACCURACY)
    row = (
        next(line for line in ACCURACY.splitlines() if line.startswith("| AROSICS |"))
        .strip("| ")
        .split(" | ")
    )
    assert speeds.sizes(module.w.AROSICS) == [512, 1024, 2048, 4096]
    assert [speeds.cpu_s(module.w.AROSICS, side) for side in (512, 4096)] == [float(row[1]), float(row[4])]
    assert speeds.rmse_px(module.w.AROSICS, 4096) == float(row[-1])
    assert all(speeds.sizes(name) for name in module.ROWS.values())
