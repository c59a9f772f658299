"""Options from a TOML file and the command line to `Settings` values."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from pcwlad_geo.cli.options import WORDS
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.registration.settings import Settings

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SETTINGS = tuple(field.name for field in fields(Settings))


def collect(given: Mapping[str, object], config: Path | None) -> dict[str, Any]:
    """Return the options for the API: the config file's, overruled by those of the command line.

    Parameters
    ----------
    given : mapping
        Option names (underscored) and values of the command line; None = not given. Names that are no
        field of `Settings` are left out.
    config : Path, optional
        TOML file.

    Raises
    ------
    SettingsError
        If the file cannot be read, names an option that does not exist, or a value has a wrong type.
    """
    values = read_config(config) if config else {}
    values |= {name: value for name, value in given.items() if name in SETTINGS and value is not None}
    return {name: to_setting(name, value) for name, value in values.items()}


def read_config(path: Path) -> dict[str, object]:
    """Read a TOML file of options; dashes in names become underscores."""
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"cannot read config file {path}: {error.strerror}") from error
    except ValueError as error:  # no TOML, or no UTF-8
        raise SettingsError(f"config file {path} is not valid TOML: {error}") from error
    values = {name.replace("-", "_"): value for name, value in values.items()}
    unknown = sorted(set(values) - set(SETTINGS))
    if unknown:
        raise SettingsError(
            f"config file {path} has unknown option '{unknown[0]}'; the options are {', '.join(SETTINGS)}"
        )
    return values


def to_setting(name: str, value: object) -> object:
    """Convert a value, text or not, to the type of a field of `Settings`.

    Raises
    ------
    SettingsError
        If it cannot be read as that type.
    """
    if name in WORDS and value == WORDS[name]:
        return None
    hint = get_type_hints(Settings)[name]
    kinds = set(get_args(hint)) | {hint}
    words = [word for kind in kinds - {hint} if get_origin(kind) is Literal for word in get_args(kind)]
    if value in words:
        return value
    if Path in kinds:
        return Path(_checked(name, value, str, "a file name") if not isinstance(value, Path) else value)
    if int in kinds:
        words += [WORDS[name]] if name in WORDS else []
        return _number(name, value, int, " or ".join(["a whole number", *(f"'{word}'" for word in words)]))
    if float in kinds:
        return _number(name, value, float, "a number")
    return _checked(name, value, str, "text")


def _number(name: str, value: object, kind: type[int] | type[float], wanted: str) -> object:
    if isinstance(value, str):
        try:
            return kind(value)
        except ValueError:
            raise SettingsError(f"{name} = {value!r}: give {wanted}") from None
    accepted = (int,) if kind is int else (int, float)
    if isinstance(value, bool) or not isinstance(value, accepted):
        raise SettingsError(f"{name} = {value!r}: give {wanted}")
    return kind(value)


def _checked(name: str, value: object, kind: type[str], wanted: str) -> str:
    if not isinstance(value, kind):
        raise SettingsError(f"{name} = {value!r}: give {wanted}")
    return value
