"""Options of the command line and of a TOML file, and their conversion to values of `Settings`."""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.limits import OPTIONS_BYTES
from pcwlad_geo.options import OPTIONS, SETTINGS, Option, Settings, to_setting
from pcwlad_geo.text import read_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def collect(given: Mapping[str, object], config: Path | None) -> dict[str, Any]:
    """Return the options for the API: those of the config file, replaced by those of the command line.

    Raises `SettingsError` if the file cannot be read, names an option that does not exist, or a value has a
    wrong type.

    Parameters
    ----------
    given : mapping
        Option names (with underscores) and values of the command line; None, or an empty list or tuple for a
        repeatable option, if not given. Names that are not fields of `Settings` are ignored.
    config : Path, optional
        TOML file of options.
    """
    values = read_config(config) if config else {}
    values |= {name: value for name, value in given.items() if name in SETTINGS and _is_given(value)}
    return {name: to_setting(name, value) for name, value in values.items()}


def _is_given(value: object) -> bool:
    # Click gives () for a repeatable option that was not given.
    return not (value is None or (isinstance(value, list | tuple) and not value))


def read_config(path: Path) -> dict[str, object]:
    """Read a TOML file of options; hyphens in names become underscores.

    Raises `SettingsError` if the file cannot be read or is not valid TOML.
    """
    try:
        values = tomllib.loads(read_text(path, most=OPTIONS_BYTES))
    except OSError as error:
        raise SettingsError(f"cannot read config file {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, or nested too deeply
        raise SettingsError(f"config file {path} is not valid TOML: {error}") from error
    values = {name.replace("-", "_"): value for name, value in values.items()}
    if "start_matcher" in values:
        raise SettingsError(
            f"config file {path}: start_matcher runs code, which no file may name: give --start-matcher"
        )
    unknown = sorted(set(values) - set(SETTINGS))
    if unknown:
        raise SettingsError(
            f"config file {path} has unknown option '{unknown[0]}'; the options are {', '.join(SETTINGS)}"
        )
    return values


ProgressStyle = Literal["auto", "bar", "json", "none"]

_DEFAULTS = {field.name: field.default for field in fields(Settings)}
_HINTS = get_type_hints(Settings)
_BEFORE = "progress"
"""The options of `Settings` stand before this one in the help."""

Reference = Annotated[
    str, typer.Argument(metavar="REFERENCE", help="Raster that stays, or a product.", show_default=False)
]
Target = Annotated[
    str, typer.Argument(metavar="TARGET", help="Raster that moves, or a product.", show_default=False)
]


def takes_settings(command: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a decorator that gives a command all options of `Settings` that are meant for it.

    The decorated function declares its own options only; it finds all values in ``context.params``. One that
    declares no `progress` is given that and the other options of `RUN_OPTIONS`, as the last ones.

    Parameters
    ----------
    command : str
        Name of the command, as `Option.commands` has it.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        hints = get_type_hints(function, include_extras=True)
        own = [
            each.replace(annotation=hints[each.name])
            for each in inspect.signature(function).parameters.values()
        ]
        names = [each.name for each in own]
        run = [] if _BEFORE in names else RUN_OPTIONS
        given = [
            inspect.Parameter(name, _KIND, default=None, annotation=_annotation(name, option))
            for name, option in OPTIONS.items()
            if command in option.commands and name not in names
        ]
        place = len(own) if run else names.index(_BEFORE)

        @functools.wraps(function)
        def decorated(**values: object) -> None:
            function(**{name: values[name] for name in names})

        parameters = [*own[:place], *given, *own[place:], *run]
        decorated.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        decorated.__annotations__ = {each.name: each.annotation for each in parameters}
        return decorated

    return decorate


_KIND = inspect.Parameter.POSITIONAL_OR_KEYWORD


def _annotation(name: str, option: Option) -> object:
    """Return the type of an option on the command line, with its help."""
    help_text, default = option.help, _DEFAULTS[name]
    shown = option.none_word if default is None else default
    if shown is not None and shown is not False and shown != ():
        help_text += f"  [default: {shown}]"
    flag = "--" + name.replace("_", "-")
    how = typer.Option(flag, help=help_text, metavar=option.metavar, show_default=False)
    return Annotated[_type_of(name, option) | None, how]


def _type_of(name: str, option: Option) -> Any:  # noqa: ANN401  # of any type
    """Return what typer reads a value as: text where it may be a word as well as a number, or a file."""
    hint = _HINTS[name]
    if name in ("co", "require"):
        return list[str]
    if get_origin(hint) is Literal:
        return hint
    kinds = [kind for kind in get_args(hint) or (hint,) if kind is not type(None)]
    simple = len(kinds) == 1 and kinds[0] is not Path and option.none_word is None
    return kinds[0] if simple else str


OutDir = Annotated[
    Path | None,
    typer.Option("-o", "--out-dir", metavar="OUT_DIR", help="Output folder.", show_default=False),
]
OutputRaster = Annotated[
    Path | None,
    typer.Option("--output-raster", metavar="FILE", help="Registered raster, here instead."),
]
OutputTiepoints = Annotated[
    Path | None,
    typer.Option("--output-tiepoints", metavar="FILE", help="Tie points CSV, here instead."),
]
OutputReport = Annotated[
    Path | None, typer.Option("--output-report", metavar="FILE", help="Report page, here instead.")
]
OutputPoints = Annotated[
    Path | None,
    typer.Option("--output-points", metavar="FILE", help="QGIS Georeferencer points, here instead."),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the results of an earlier run in OUT_DIR.")
]
ProgressOption = Annotated[
    ProgressStyle,
    typer.Option("--progress", help="auto: a bar on a terminal; json: one object a line on standard output."),
]
WatchStdin = Annotated[bool, typer.Option("--watch-stdin", help="Cancel the run when standard input ends.")]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE.toml", help="Options by name; the command line wins."),
]
Debug = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of an error, and what libraries write meanwhile.")
]
RUN_OPTIONS = [
    inspect.Parameter(name, _KIND, default=default, annotation=annotation)
    for name, default, annotation in (
        ("progress", "auto", ProgressOption),
        ("watch_stdin", False, WatchStdin),
        ("config", None, Config),
        ("overwrite", False, Overwrite),
        ("debug", False, Debug),
    )
]
"""Options of the commands that do many images: how a run is followed, and what it may replace."""
