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

from pcwlad_geo.cli.sections import RUNNING_SECTION, section_of_options
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.option_text import to_setting
from pcwlad_geo.options import OPTIONS, SETTINGS, Option, Settings
from pcwlad_geo.text import read_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def examples(*commands: str) -> str:
    """Return the end of a help: commands that can be run. The first line keeps the others as they are."""
    return "\n".join(["\b", "Examples:", *(f"  pcwlad-geo {command}" for command in commands)])


def collect(options: Mapping[str, object], config: Path | None) -> dict[str, Any]:
    """Return the options for the API: those of the config file, replaced by those of the command line.

    The names of those `options` have underscores; values are None, or an empty list or tuple for a repeatable
    option, where they are not. Names that are not fields of `Settings` are ignored. Raises `SettingsError` if
    the file, which is TOML, cannot be read, names an option that does not exist, or a value has a wrong type.
    """
    values = read_config(config) if config else {}
    absent: tuple[object, ...] = (None, (), [])  # Click gives () for a repeatable option that was not given
    values |= {name: value for name, value in options.items() if name in SETTINGS and value not in absent}
    return {name: to_setting(name, value) for name, value in values.items()}


def checked_options(params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options for the API in the parameters of a command, see `collect`.

    An invalid value is reported here, before the large libraries are loaded.
    """
    options = collect(params, params["config"])
    Settings.from_options(options)
    return options


def read_config(path: Path) -> dict[str, object]:
    """Read a TOML file of options; hyphens in names become underscores.

    Raises `SettingsError` if the file cannot be read or is not valid TOML.
    """
    try:
        values = tomllib.loads(read_text(path, most=LIMITS.options_bytes))
    except OSError as error:
        raise SettingsError(f"cannot read config file {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, or nested too deeply
        raise SettingsError(f"config file {path} is not valid TOML: {error}") from error
    values = {name.replace("-", "_"): value for name, value in values.items()}
    for name in {"start_matcher", "sign"} & set(values):
        raise SettingsError(
            f"config file {path}: {name} runs code, which no file may name: give --{name.replace('_', '-')}"
        )
    unknown = sorted(set(values) - set(SETTINGS))
    if unknown:
        raise SettingsError(
            f"config file {path} has unknown option '{unknown[0]}'; the options are {', '.join(SETTINGS)}"
        )
    return values


def option(*flags: str, **how: Any) -> Any:  # noqa: ANN401  # as typer's
    """Return an option of a command, whose default is shown where its help says so, or `show_default`."""
    return typer.Option(*flags, **{"show_default": False, **how})


def argument(metavar: str, text: str) -> Any:  # noqa: ANN401  # as typer's
    """Return an argument of a command, with its help."""
    return typer.Argument(metavar=metavar, help=text, show_default=False)


ProgressStyle = Literal["auto", "bar", "json", "none"]

_KIND = inspect.Parameter.POSITIONAL_OR_KEYWORD
ALSO = {"ref_band": ("--ref-asset",), "tgt_band": ("--tgt-asset",)}
"""Further flags of options: the bands of a STAC item are its assets."""
_DEFAULTS = {field.name: field.default for field in fields(Settings)}
_HINTS = get_type_hints(Settings)
_SECTIONS = section_of_options()

Reference = Annotated[str, argument("REFERENCE", "Raster that stays, or a product.")]
Target = Annotated[str, argument("TARGET", "Raster that moves, or a product.")]


def takes_settings(command: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a decorator that gives a command all options of `Settings` that are meant for it.

    The decorated function declares its own options only; it finds all values in ``context.params``. One that
    declares no `progress` is given that and the other options of `RUN_OPTIONS`, as the last ones. The
    `command` is named as `Option.commands` has it.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        # not get_type_hints: that of Python 3.10 hides the flags of what is None by default in an Optional
        parameters_declared = list(inspect.signature(function, eval_str=True).parameters.values())
        names = [parameter.name for parameter in parameters_declared]
        run = [] if "progress" in names else RUN_OPTIONS
        settings = [
            inspect.Parameter(name, _KIND, default=None, annotation=_annotation(name, option))
            for name, option in OPTIONS.items()
            if command in option.commands and name not in names
        ]

        @functools.wraps(function)
        def decorated(**values: object) -> None:
            function(**{name: values[name] for name in names})

        parameters = [*parameters_declared, *settings, *run]
        decorated.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        decorated.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return decorated

    return decorate


def _annotation(name: str, option: Option) -> object:
    """Return the type of an option on the command line, with its help."""
    help_text, default = option.help, _DEFAULTS[name]
    text = option.none_word if default is None else default
    if text is not None and text is not False and text != ():
        help_text += f"  [default: {text}]"
    flags = ["--" + name.replace("_", "-"), *ALSO.get(name, ())]
    how = typer.Option(
        *flags, help=help_text, metavar=option.metavar, show_default=False, rich_help_panel=_SECTIONS[name]
    )
    return Annotated[_type_of(name, option) | None, how]


def _type_of(name: str, option: Option) -> Any:  # noqa: ANN401  # of any type
    """Return what typer reads a value as: text where it may be a word as well as a number, or a file."""
    hint = _HINTS[name]
    if name in ("co", "require"):
        return list[str]
    if name == "place":  # one value with commas, as GDAL and QGIS print a geotransform
        return str
    if get_origin(hint) is Literal:
        return hint
    kinds = [kind for kind in get_args(hint) or (hint,) if kind is not type(None)]
    simple = len(kinds) == 1 and kinds[0] is not Path and option.none_word is None
    return kinds[0] if simple else str


OutDir = Annotated[
    Path | None,
    option(
        "-o",
        "--out-dir",
        help="Output folder.  [default: named after the input, in the working folder]",
        metavar="OUT_DIR",
    ),
]
OutputRaster = Annotated[
    Path | None, option(help="Write the registered raster to this file.", metavar="FILE")
]
OutputTiepoints = Annotated[
    Path | None, option(help="Write the CSV of the tie points to this file.", metavar="FILE")
]
OutputReport = Annotated[Path | None, option(help="Write the report page to this file.", metavar="FILE")]
OutputPoints = Annotated[
    Path | None, option(help="Write the points for the QGIS Georeferencer to this file.", metavar="FILE")
]
Overwrite = Annotated[
    bool,
    option(
        "--overwrite",
        help="Replace the results of an earlier run in OUT_DIR.",
        rich_help_panel=RUNNING_SECTION,
    ),
]
ProgressOption = Annotated[
    ProgressStyle,
    option(
        "--progress",
        help="auto: a bar on a terminal; json: one object a line on standard output.",
        show_default=True,
        rich_help_panel=RUNNING_SECTION,
    ),
]
WatchStdin = Annotated[
    bool,
    option("--watch-stdin", help="Cancel the run when standard input ends.", rich_help_panel=RUNNING_SECTION),
]
Config = Annotated[
    Path | None,
    option(
        "--config",
        help="Options by name; the command line wins.",
        metavar="FILE.toml",
        rich_help_panel=RUNNING_SECTION,
    ),
]
Debug = Annotated[
    bool,
    option(
        "--debug",
        help="Show the traceback of an error, and what libraries write meanwhile.",
        rich_help_panel=RUNNING_SECTION,
    ),
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
