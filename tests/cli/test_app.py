from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import pcwlad_geo
from pcwlad_geo.cli.app import ONE_PAIR, PROTOCOL, app, run
from pcwlad_geo.options import WORDS, Settings

NOT_ON_THE_COMMAND_LINE = {"tile_size"}


def visible_commands() -> Iterator[tuple[str, Any]]:
    """Yield the commands that users see, those of groups by two words."""
    for name, command in get_command(app).commands.items():
        for inner, each in getattr(command, "commands", {"": command}).items():
            if not each.hidden:
                yield f"{name} {inner}".strip(), each


def examples_of(shown: str) -> list[list[str]]:
    """Return the arguments of the examples of a help; a longer command would be wrapped, and not be one."""
    commands = [shlex.split(line) for line in shown.partition("Examples:")[2].splitlines() if line.strip()]
    assert all(words[0] == "pcwlad-geo" for words in commands)
    return [words[1:] for words in commands]


def parsed(words: list[str]) -> list[str]:
    """Let the command line take the arguments of a command, and return its names."""
    names, command, rest = [], get_command(app), words
    while hasattr(command, "commands"):
        name, *rest = rest
        names.append(name)
        command = command.commands[name]
    command.make_context(" ".join(names), rest)
    return names


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"pcwlad-geo {pcwlad_geo.__version__} (protocol {PROTOCOL})\n"


def test_no_arguments_show_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([]) == 0
    assert "register" in capsys.readouterr().out


def test_the_help_has_every_command_once_in_a_group_and_examples_that_can_be_run(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["--help"]) == 0
    shown = capsys.readouterr().out
    groups = shown.partition(f"{ONE_PAIR}:")[2].partition("Examples:")[0]
    listed = [line.split()[0] for line in groups.splitlines() if line.startswith("  ") and line.strip()]
    assert sorted(listed) == sorted({name.split()[0] for name, _ in visible_commands()})
    assert "..." not in groups
    examples = examples_of(shown)
    assert len(examples) > 3
    for words in examples:
        if words[-1] != "--help":
            parsed(words)


@pytest.mark.parametrize("name", [name for name, _ in visible_commands()])
def test_the_help_of_each_command_ends_with_examples_of_it_that_can_be_run(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*name.split(), "--help"]) == 0
    examples = examples_of(capsys.readouterr().out)
    assert examples
    for words in examples:
        assert " ".join(parsed(words)) == name


def test_shells_can_complete_commands_and_options() -> None:
    code = "import sys; sys.argv = ['pcwlad-geo']; from pcwlad_geo.__main__ import main; main()"

    def completed(words: str) -> list[str]:
        asked = {"_PCWLAD_GEO_COMPLETE": "complete_bash", "COMP_WORDS": words}
        asked["COMP_CWORD"] = str(words.count(" "))
        return subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, **asked},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()

    assert completed("pcwlad-geo pro") == ["prove"]
    assert "--search-radius" in completed("pcwlad-geo match --sea")


def test_the_help_of_batch_names_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["batch", "--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"--{name} " in shown for name in ("out-dir", "jobs", "scheduler", "progress", "overwrite"))


@pytest.mark.parametrize("command", ["register", "match"])
def test_help_names_every_setting_of_the_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command, "--help"]) == 0
    shown = capsys.readouterr().out
    names = {field.name for field in fields(Settings)} - NOT_ON_THE_COMMAND_LINE
    if command == "match":
        names -= {"model", "grid", "resampling", "write_sigma", "keep", "tie_points"}
        names -= {
            "write_displacement",
            "write_proj_grid",
            "write_stac",
            "displacement_spacing",
            "displacement_unit",
        }
        names -= {"like", "tr", "te", "t_srs", "of", "co"}
    missing = [name for name in names if not re.search(rf"--{name.replace('_', '-')}[ ,]", shown)]
    assert not missing


def test_words_stand_for_none() -> None:
    defaults = {field.name: field.default for field in fields(Settings)}
    assert all(defaults[name] is None for name in WORDS)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["register", "a.tif"], "TARGET"),
        (["register", "a.tif", "b.tif", "--method", "magic"], "oriented"),
        (["register", "a.tif", "b.tif", "--window", "wide"], "window = 'wide'"),
        (["register", "a.tif", "b.tif", "--points", "some"], "'all'"),
        (["register", "a.tif", "b.tif", "--search-radius", "-3"], "search_radius"),
        (["register", "a.tif", "b.tif", "--window", "80"], "odd"),
        (["register", "a.tif", "b.tif", "--config", "absent.toml"], "absent.toml"),
        (["register", "a.tif", "b.tif", "--colour"], "--colour"),
        (["match", "a.tif", "b.tif", "--model", "shift"], "--model"),
        (["regster", "a.tif", "b.tif"], "regster"),
    ],
)
def test_bad_arguments_are_one_line_and_status_2(
    arguments: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert said in err
    assert not list(tmp_path.iterdir())


def test_nothing_heavy_is_imported_before_a_command_runs() -> None:
    heavy = (
        "numpy",
        "scipy",
        "cv2",
        "numba",
        "rasterio",
        "pyproj",
        "shapely",
        "PIL",
        "jinja2",
        "rich",
    )
    heavy += ("dask", "distributed", "multiprocessing")
    code = (
        "import contextlib, io, sys\n"
        "from pcwlad_geo.cli.app import PROTOCOL, run\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as told:\n"
        "    for command in ([], ['register'], ['match'], ['batch']): run([*command, '--help'])\n"
        "    assert run(['match', sys.executable, 'gone.tif']) == 2\n"
        "assert 'gone.tif does not exist' in told.getvalue()\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "[]"
