"""Option values as text, of a command line, a config file or a table, to those of `Settings`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Final, Literal, get_args, get_origin, get_type_hints

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.registration.settings import BAND_NAME, Settings

SETTINGS: Final = tuple(field.name for field in fields(Settings))
"""Names of the options."""
RUNNING: Final = ("jobs", "scheduler", "allow_remote", "trust_vrt")
"""Those that say where a job runs and what it may open: its result does not depend on them, and a table of
pairs, which may be a stranger's, cannot set them."""
WORDS: Final = {"points": "auto", "search_radius": "auto", "jobs": "all"}
"""How None is spelled where it is a choice of its own."""


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
    if any(get_origin(kind) is tuple for kind in kinds):
        return _several(name, value)
    words = [word for kind in kinds - {hint} if get_origin(kind) is Literal for word in get_args(kind)]
    if value in words:
        return value
    if Sequence[str] in kinds:
        return value  # `Settings` reads them
    if bool in kinds:
        return _truth(name, value)
    if {float, Path} <= kinds:
        return _number_or_path(name, value)
    if Path in kinds:
        return _path(name, value)
    if {int, str} <= kinds and isinstance(value, str) and BAND_NAME.match(value):
        return value
    if int in kinds:
        words += [WORDS[name]] if name in WORDS else []
        return _number(name, value, int, " or ".join(["a whole number", *(f"'{word}'" for word in words)]))
    if float in kinds:
        return _number(name, value, float, "a number")
    return _checked(name, value, str, "text")


def _number(name: str, value: object, kind: type[int] | type[float], wanted: str) -> object:
    accepted = (str, int) if kind is int else (str, int, float)
    if isinstance(value, bool) or not isinstance(value, accepted):
        raise SettingsError(f"{name} = {value!r}: give {wanted}")
    try:
        return kind(value)
    except (ValueError, OverflowError):  # no number, or a whole one of hundreds of digits
        raise SettingsError(f"{name} = {value!r}: give {wanted}") from None


def _several(name: str, value: object) -> tuple[object, ...]:
    """Return values that are separated by blanks in text: creation options, or numbers."""
    values = value.split() if isinstance(value, str) else value
    if not isinstance(values, list | tuple):
        raise SettingsError(f"{name} = {value!r}: give a list, or values separated by blanks")
    if name == "co":
        return tuple(_checked(name, each, str, "KEY=VALUE") for each in values)
    return tuple(_number(name, each, float, "numbers") for each in values)


def _truth(name: str, value: object) -> bool:
    words = {"true": True, "false": False}
    if isinstance(value, str):
        value = words.get(value.lower(), value)
    if not isinstance(value, bool):
        raise SettingsError(f"{name} = {value!r}: give true or false")
    return value


def _number_or_path(name: str, value: object) -> object:
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return _path(name, value)
    return value if isinstance(value, Path) else _number(name, value, float, "a number or a file name")


def _path(name: str, value: object) -> Path | str:
    if isinstance(value, str) and (value.startswith("/vsi") or "://" in value):
        return value  # a Path would fold the slashes of a GDAL URI
    return value if isinstance(value, Path) else Path(_checked(name, value, str, "a file name"))


def _checked(name: str, value: object, kind: type[str], wanted: str) -> str:
    if not isinstance(value, kind):
        raise SettingsError(f"{name} = {value!r}: give {wanted}")
    return value
