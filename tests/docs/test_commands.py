"""The commands and the code of the pages: parsed by the real command line, or run on the sample data."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import rasterio
import typer
from rasterio.windows import Window
from typer.main import get_command

from docs.make_examples import differ
from pcwlad_geo.cli.app import app
from tests.docs.pages import DOCS, PAGES, REPOSITORY, blocks, code_of, name_of

PLACEHOLDERS = re.compile(r"\[-o OUT_DIR\]|…|\|")
"""What synopses have and shells have not."""
SHELL_PAGES = [page for page in PAGES if any(block.language == "sh" for block in blocks(page))]
RUN_PAGES = [page for page in PAGES if any(block.mark == "run" for block in blocks(page))]
OWN_TESTS = {"docs/python.md", "docs/howto/watch.md"}
"""Pages whose code `test_python_page` (with the libraries there are) and `test_watch_catalogue` run."""


PYTHON_PAGES = [page for page in PAGES if name_of(page) not in OWN_TESTS and code_of(page)]
BEGINNINGS = {"README.md": "docs/tutorial/python.md"}
"""Pages with whose code another page begins, which runs it."""
ROOTS = (REPOSITORY, REPOSITORY / "tests", REPOSITORY / "benchmarks")
NOT_FOR_USERS: set[str] = set()
QUICK = {"docs/coordinates.md", "sample_data/README.md"}
"""Pages whose code needs a few seconds; the code of the others registers images."""
CORNER_PX = 220
"""Columns and rows of the sample pair that the pages get: the gallery's first example registers all of it."""


def commands(page: Path) -> Iterator[list[str]]:
    """Yield the arguments of each ``pcwlad-geo`` command of a page."""
    for block in blocks(page):
        if block.language != "sh":
            continue
        text = PLACEHOLDERS.sub("", block.text.replace("\\\n", " "))
        for line in text.splitlines():
            words = shlex.split(line, comments=True)
            for place, word in enumerate(words):
                if Path(word).name == "pcwlad-geo":
                    yield until_the_next(words[place + 1 :])
                    break


def until_the_next(words: list[str]) -> list[str]:
    """Return the words of one command: those before a shell's operator."""
    ends = [place for place, word in enumerate(words) if word in ("&&", "||", "|", ";", ">", "echo")]
    return words[: min(ends, default=len(words))]


def parse(arguments: list[str]) -> None:
    """Let the real command line parse a command without running it."""
    group = get_command(app)
    context = group.make_context("pcwlad-geo", list(arguments))
    rest = [*context._protected_args, *context.args] if hasattr(context, "_protected_args") else context.args
    _, command, rest = group.resolve_command(context, rest)
    assert command is not None
    command.make_context(command.name, rest, parent=context)


def test_there_are_commands_to_look_at() -> None:
    assert sum(1 for page in SHELL_PAGES for _ in commands(page)) > 35
    assert len(RUN_PAGES) >= 2
    assert len(PYTHON_PAGES) >= 4


@pytest.mark.parametrize("page", SHELL_PAGES, ids=name_of)
def test_each_command_is_one_that_the_command_line_takes(page: Path) -> None:
    for arguments in commands(page):
        try:
            parse(arguments)
        except typer.TyperException as error:
            pytest.fail(f"pcwlad-geo {shlex.join(arguments)}: {error.format_message()}")


def test_a_wrong_option_would_be_found() -> None:
    with pytest.raises(typer.TyperException):
        parse(["register", "a.tif", "b.tif", "--no-such-option"])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_each_script_that_a_page_runs_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"(?:python3? |`|\./)((?:[\w.]+/)+[\w.]+\.py|tests_qgis/run|\.ci/run)\b", text)
    assert [
        name
        for name in named
        if name != "docs/gallery/NAME.py" and not any((place / name).is_file() for place in ROOTS)
    ] == []


def test_each_option_of_register_is_explained() -> None:
    _, command, _ = get_command(app).resolve_command(typer.Context(get_command(app)), ["register"])
    assert command is not None
    names = {name for each in command.params for name in each.opts if name.startswith("--")}
    text = "".join(
        (DOCS / name).read_text(encoding="utf-8") for name in ("options.md", "method.md", "qgis.md")
    )
    unexplained = {name for name in names if not re.search(rf"`{name}\b", text)}
    assert unexplained <= NOT_FOR_USERS, sorted(unexplained - NOT_FOR_USERS)


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the sample data, with the upper left corner of its images for the images."""
    folder = tmp_path_factory.mktemp("sample data")
    for file in (REPOSITORY / "sample_data").iterdir():
        if file.suffix == ".tif":
            with rasterio.open(file) as whole:
                profile = {**whole.profile, "width": CORNER_PX, "height": CORNER_PX}
                with rasterio.open(folder / file.name, "w", **profile) as corner:
                    corner.write(whole.read(window=Window(0, 0, CORNER_PX, CORNER_PX)))
        elif file.suffix != ".xml":  # statistics of the whole images
            (folder / file.name).symlink_to(file)
    return folder


@pytest.fixture
def workplace(tmp_path: Path, samples: Path) -> tuple[Path, dict[str, str]]:
    """A folder with the sample data; an environment whose ``pcwlad-geo`` and ``python`` are these."""
    (tmp_path / "bin").mkdir()
    for name, words in (("pcwlad-geo", "-m pcwlad_geo"), ("python", "")):
        script = tmp_path / "bin" / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n')
        script.chmod(0o755)
    place = tmp_path / "here"
    place.mkdir()
    (place / "sample_data").symlink_to(samples)
    paths = os.pathsep.join(
        [str(REPOSITORY), str(REPOSITORY / "sample_data"), os.environ.get("PYTHONPATH", "")]
    )
    path = os.pathsep.join([str(tmp_path / "bin"), os.environ["PATH"]])
    return place, {**os.environ, "PYTHONPATH": paths, "PATH": path}


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN_PAGES, ids=name_of)
def test_the_commands_of_a_page_run_one_after_the_other(
    page: Path, workplace: tuple[Path, dict[str, str]]
) -> None:
    place, environment = workplace
    script = "\n".join(block.text for block in blocks(page) if block.mark == "run")
    ended = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("page", BEGINNINGS)
def test_the_code_of_a_page_is_the_beginning_of_another(page: str) -> None:
    assert REPOSITORY / page in PYTHON_PAGES
    assert REPOSITORY / BEGINNINGS[page] in RUN_BY_ITSELF
    assert code_of(REPOSITORY / BEGINNINGS[page]).startswith(code_of(REPOSITORY / page))


RUN_ELSEWHERE = {"docs/howto/cubes.md"}
"""Pages whose blocks run on files that a test of their own makes."""
RUN_BY_ITSELF = [page for page in PYTHON_PAGES if name_of(page) not in {*BEGINNINGS, *RUN_ELSEWHERE}]


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=() if name_of(page) in QUICK else pytest.mark.slow) for page in RUN_BY_ITSELF],
    ids=[name_of(page) for page in RUN_BY_ITSELF],
)
def test_the_code_of_a_page_runs(page: Path, workplace: tuple[Path, dict[str, str]]) -> None:
    place, environment = workplace
    script = place / "page.py"
    script.write_text(code_of(page))
    ended = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:__main__", script.name],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr


def shown(page: str) -> str:
    """Return what a page shows of registering the sample pair."""
    (block,) = (
        each for each in blocks(DOCS / page) if each.language == "text" and "uality: good" in each.text
    )
    return block.text


def test_two_pages_say_the_same_of_the_sample_pair() -> None:
    numbers = re.compile(r"\d+\.\d+|\d{3,}")
    assert numbers.findall(shown("qgis.md")) != []
    assert set(numbers.findall(shown("qgis.md"))) <= set(numbers.findall(shown("tutorial/shell.md")))


@pytest.mark.slow
def test_registering_the_sample_pair_prints_what_the_tutorial_says(tmp_path: Path) -> None:
    """As closely as libraries and types of CPU let it."""
    pair = [str(REPOSITORY / "sample_data" / f"landsat_{band}.tif") for band in ("b4", "b10")]
    command = [sys.executable, "-m", "pcwlad_geo", "register", *pair, "--progress", "none"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert not differ(shown("tutorial/shell.md").strip(), ended.stdout.strip())


def test_what_the_worked_example_prints_is_what_it_says(workplace: tuple[Path, dict[str, str]]) -> None:
    """Each ``print(...)  # value`` of coordinates.md, to the last digit; numpy pads as its version likes."""
    place, environment = workplace
    code = next(
        block.text for block in blocks(REPOSITORY / "docs" / "coordinates.md") if block.language == "python"
    )
    said = [line.partition("  # ")[2] for line in code.splitlines() if line.startswith("print(")]
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=place, env=environment, capture_output=True, text=True, check=True
    )
    assert [line.replace(" ", "") for line in ended.stdout.splitlines()] == [
        line.replace(" ", "") for line in said
    ]
