"""The help in sections: commands by what they are for, options by what they change."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from typer.core import TyperCommand, TyperGroup

from pcwlad_geo.options import OPTIONS

ONE_PAIR: Final = "One pair"
"""Title of the commands for one pair."""
MANY: Final = "Many images"
"""Title of the commands for many images."""
AFTER: Final = "After a registration"
"""Title of the commands for a finished registration."""
RUNNING_SECTION: Final = "Running"
"""Title of the options that do not change the result."""
FIRST_OPTIONS: Final = {
    "ref_band": "Input",
    "method": "Matching",
    "model": "Correction and output raster",
    "prove": "Accuracy and report",
    "allow_remote": RUNNING_SECTION,
}
"""The first option of each section, in their order, and its title. The page of the options has the same."""


def section_of_options() -> Mapping[str, str]:
    """Return the title of the section of each option, by its name."""
    sections, title = {}, ""
    for name in OPTIONS:
        title = FIRST_OPTIONS.get(name, title)
        sections[name] = title
    return sections


class Commands(TyperGroup):
    """The commands, listed in sections."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  # of typer's own click
        """Write the commands: of the help of each what stands before details."""
        width = max(map(len, self.commands))
        for title in (ONE_PAIR, MANY, AFTER):
            lines = [
                (name.ljust(width), f"{re.split('[:;.]', command.help or '')[0]}.")
                for name, command in self.commands.items()
                if getattr(command, "rich_help_panel", "") == title and not command.hidden
            ]
            with formatter.section(title):
                formatter.write_dl(lines)


class Command(TyperCommand):
    """A command whose options are listed in sections."""

    def format_options(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  # of typer's own click
        """Write arguments and options, those of the command alone first."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
                title = getattr(parameter, "rich_help_panel", None) or usual
                sections.setdefault(title, []).append(record)
        for title, records in sections.items():
            with formatter.section(title):
                formatter.write_dl(records)
