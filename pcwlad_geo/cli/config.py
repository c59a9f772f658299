"""Options from a TOML file and the command line to `Settings` values."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.input_files import read_text
from pcwlad_geo.registration.option_values import SETTINGS, to_setting

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def collect(given: Mapping[str, object], config: Path | None) -> dict[str, Any]:
    """Return the options for the API: the config file's, overruled by those of the command line.

    Parameters
    ----------
    given : mapping
        Option names (underscored) and values of the command line; None, or for an option that may be
        repeated an empty list or tuple = not given. Names that are no field of `Settings` are left out.
    config : Path, optional
        TOML file.

    Raises
    ------
    SettingsError
        If the file cannot be read, names an option that does not exist, or a value has a wrong type.
    """
    values = read_config(config) if config else {}
    values |= {name: value for name, value in given.items() if name in SETTINGS and _is_given(value)}
    return {name: to_setting(name, value) for name, value in values.items()}


def _is_given(value: object) -> bool:
    # Click says () of an option that may be repeated and was not given.
    return not (value is None or (isinstance(value, list | tuple) and not value))


def read_config(path: Path) -> dict[str, object]:
    """Read a TOML file of options; dashes in names become underscores."""
    try:
        values = tomllib.loads(read_text(path))
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
