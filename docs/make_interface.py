"""Write the page of the public interface, made from the code.

    python docs/make_interface.py

A test compares `docs/development/interface.md` with the code. Whoever removes a name, an option, a file or
a status sees it there first.
"""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parent))

from make_man import STATUSES, commands

import pcwlad_geo
from pcwlad_geo.outputs.files import outputs
from pcwlad_geo.tiepoints.table import POINT_COLUMNS

DOCS: Final = Path(__file__).resolve().parent
PAGE: Final = DOCS / "development" / "interface.md"
TEXT: Final = """# The public interface

[Versions](../contributing.md#versions) are about the names on this page. A major version may break them. A
minor version adds to them. A patch changes none. Everything else may change at any time. A script makes this
page from the code (`python docs/make_interface.py`), and a test compares the two.

## Python

These are the names of `pcwlad_geo.__all__`, with the parameters of functions.
[API](../api.md) describes them.

{names}

## Command line

{commands}

`--progress json` writes one object a line. Its `event` is `progress`, `warning`, `result`, `error` or
`cancelled`. [The QGIS plugin](../qgis.md) reads these lines. `pcwlad-geo --version` prints the number of this
protocol.

## Exit statuses

{statuses}

## Files of a pair

[What a job writes](../outputs.md) explains each file.

{files}

{columns}

## Schemas

{schemas}
"""


def code(names: Iterable[str]) -> str:
    """Return names as code, one after the other."""
    return ", ".join(f"`{name}`" for name in names)


def table(header: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return rows as a table of two columns."""
    cells = (f"| {first} | {second} |" for first, second in rows)
    return "\n".join([f"| {header.replace(', ', ' | ')} |", "|---|---|", *cells])


def names() -> Iterator[tuple[str, str]]:
    """Yield the classes, the errors, and each function with the names of its parameters."""
    public = {name: getattr(pcwlad_geo, name) for name in pcwlad_geo.__all__}
    functions = {name: each for name, each in public.items() if inspect.isfunction(each)}
    others = [name for name in public if name not in functions]
    yield "classes and types", code(name for name in others if name[0] != "_" and not name.endswith("Error"))
    yield "errors", code(name for name in others if name.endswith("Error"))
    for name, function in functions.items():
        yield f"`{name}`", code(inspect.signature(function).parameters)


def file_name(template: str) -> str:
    """Return the name of an output of any target."""
    return template.format(name="<target file name>", stem="<target>", ending="tif")


def options() -> Iterator[tuple[str, str]]:
    """Yield each command with its arguments and options."""
    for name, command in commands():
        arguments = [each.metavar for each in command.params if not each.opts[0].startswith("-")]
        flags = [flag for each in command.params for flag in each.opts if flag.startswith("-")]
        yield f"`{' '.join([name, *arguments])}`", code(flags)


def schemas() -> Iterator[tuple[str, str]]:
    """Yield each schema, with the entries that are always there."""
    for path in sorted(DOCS.glob("*.schema.json")):
        yield (
            f"[`{path.name}`](../{path.name})",
            code(json.loads(path.read_text(encoding="utf-8")).get("required", ())),
        )


def page() -> str:
    """Return the page."""
    return TEXT.format(
        names=table("name, parameters", names()),
        commands=table("command, options", options()),
        statuses=table("status, meaning", STATUSES.items()),
        files=table("file, when", ((f"`{file_name(each.name)}`", each.when.words) for each in outputs())),
        columns=table("file, columns", [("`tiepoints.csv`", code(POINT_COLUMNS))]),
        schemas=table("schema, entries that are always there", schemas()),
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
