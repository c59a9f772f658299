"""Write the man page, made from the command line itself.

    python docs/make_man.py

It makes `docs/pcwlad-geo.1`, which the wheel installs as `share/man/man1/pcwlad-geo.1`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import typer
from typer.main import get_command

import pcwlad_geo
from pcwlad_geo.cli.app import HELP_EXAMPLES, app

PAGE: Final = Path(__file__).resolve().parent / "pcwlad-geo.1"
STATUSES: Final = {
    "0": "Done.",
    "1": "Unexpected; --debug shows where.",
    "2": "The input, the options, the output folder or the scheduler cannot be used.",
    "3": "The pair cannot be registered reliably; no corrected raster is written.",
    "4": "A requirement (--require) is not met.",
    "130": "Interrupted; nothing is left half-written.",
}


def escaped(text: str) -> str:
    """Return text as roff shows it, on one line."""
    line = " ".join(text.split())
    for character, name in {"\\": "\\e", "-": "\\-", "'": "\\(aq"}.items():
        line = line.replace(character, name)
    line = "".join(each if each.isascii() else f"\\[u{ord(each):04X}]" for each in line)
    return f"\\&{line}" if line.startswith(".") else line


def page() -> str:
    """Return the man page."""
    epilogs = [HELP_EXAMPLES, *(command.epilog for _, command in commands())]
    examples = [line.strip() for text in epilogs for line in text.splitlines() if line.startswith("  ")]
    lines = [
        f'.TH PCWLAD\\-GEO 1 "" "pcwlad\\-geo {pcwlad_geo.__version__}" "User commands"',
        ".SH NAME",
        escaped(f"pcwlad-geo - {(get_command(app).help or '').strip().rstrip('.').lower()}"),
        ".SH SYNOPSIS",
        ".B pcwlad\\-geo",
        ".I COMMAND ARGUMENTS",
        "[options]",
        ".SH COMMANDS",
        *(line for name, command in commands() for line in section(name, command)),
        ".SH EXIT STATUS",
        *(line for status, text in STATUSES.items() for line in (".TP", status, escaped(text))),
        ".SH EXAMPLES",
        ".nf",
        *map(escaped, dict.fromkeys(examples)),
        ".fi",
        ".SH SEE ALSO",
        "gdalwarp(1), gdalinfo(1)",
    ]
    return "\n".join(lines) + "\n"


def commands() -> Iterator[tuple[str, Any]]:
    """Yield the commands that users see, those of groups by two words."""
    for name, command in get_command(app).commands.items():
        for inner, each in getattr(command, "commands", {"": command}).items():
            if not each.hidden:
                yield f"{name} {inner}".strip(), each


def section(name: str, command: Any) -> Iterator[str]:  # noqa: ANN401 -- of typer's own click
    """Yield the lines on a command and its options."""
    context = typer.Context(command, info_name=f"pcwlad-geo {name}")
    usage = " ".join(command.collect_usage_pieces(context)).replace("[OPTIONS]", "").strip()
    yield from (f".SS {escaped(f'{name} {usage}')}", escaped(command.help or ""))
    for parameter in command.params:
        record = parameter.get_help_record(context)
        if record and not getattr(parameter, "hidden", False):
            yield from (".TP", f".B {escaped(record[0])}", escaped(re.sub(r"\s+", " ", record[1])))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
