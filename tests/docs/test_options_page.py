"""The page of the options knows every option of the commands, by its name."""

from __future__ import annotations

import re
from pathlib import Path

from pcwlad_geo.cli.sections import section_of_options
from pcwlad_geo.options import OPTIONS

PAGES = Path(__file__).resolve().parents[2] / "docs"


def test_every_option_is_on_the_page_and_no_other() -> None:
    text = (PAGES / "options.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\|(.*?)\|", text.replace(r"\|", " or "), flags=re.MULTILINE)
    there = {name for row in rows for name in re.findall(r"--([a-z-]+[a-z])", row)}
    known = {name.replace("_", "-") for name, option in OPTIONS.items() if option.commands}
    assert known - there == set()
    of_the_command_line = {"output-raster", "output-tiepoints", "output-report", "output-points", "overwrite"}
    of_the_command_line |= {"progress", "config", "watch-stdin", "debug", "help"}
    assert there - known == of_the_command_line


def test_the_page_and_the_help_have_the_same_sections() -> None:
    text = (PAGES / "options.md").read_text(encoding="utf-8")
    for name, title in section_of_options().items():
        if OPTIONS[name].commands:
            section = text.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
            assert f"`--{name.replace('_', '-')}" in section, name
