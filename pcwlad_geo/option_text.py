"""Values of options that are given as text: of the command line, of files of options, of tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args, get_origin

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.options import BAND_PATTERN, HINTS, WORDS


def to_setting(name: str, value: object) -> object:
    """Convert `value`, a text or not, to the type of the field `name` of `Settings`.

    Raises `SettingsError` if it cannot be converted.
    """
    hint = HINTS[name]
    kinds = set(get_args(hint)) | {hint}
    words = [word for kind in kinds - {hint} if get_origin(kind) is Literal for word in get_args(kind)]
    if name in WORDS and value == WORDS[name]:
        return None
    if any(get_origin(kind) is tuple for kind in kinds):
        return _several(name, value)
    if value in words or Sequence[str] in kinds:  # `Settings` converts the latter
        return value
    if bool in kinds and isinstance(value, str):
        return {"true": True, "false": False}.get(value.lower(), value)  # `Settings` refuses others
    if bool in kinds:
        return value
    if {float, Path} <= kinds:
        return _number_or_path(name, value)
    if Path in kinds:
        return _path(name, value)
    if {int, str} <= kinds and isinstance(value, str) and not value.strip().isdecimal():
        text = value.replace(" ", "")
        if BAND_PATTERN.match(text):
            return text
    if int in kinds:
        words += [WORDS[name]] if name in WORDS else []
        return _number(name, value, int, " or ".join(["a whole number", *(f"'{word}'" for word in words)]))
    if float in kinds:
        return _number(name, value, float, "a number")
    return _text(name, value, "text")


def _number(name: str, value: object, kind: type[int] | type[float], expected: str) -> object:
    accepted = (str, int) if kind is int else (str, int, float)
    try:
        if isinstance(value, accepted) and not isinstance(value, bool):
            return kind(value)
    except (ValueError, OverflowError):  # not a number, or an integer of hundreds of digits
        pass
    raise SettingsError(f"{name} = {value!r}: give {expected}")


def _several(name: str, value: object) -> tuple[object, ...]:
    """Return values that are separated in a text: creation options by blanks, numbers by commas too."""
    text = value if name == "co" or not isinstance(value, str) else value.replace(",", " ")
    values = text.split() if isinstance(text, str) else text
    if not isinstance(values, list | tuple):
        raise SettingsError(f"{name} = {value!r}: give a list, or values separated by blanks")
    if name == "co":
        return tuple(_text(name, item, "KEY=VALUE") for item in values)
    return tuple(_number(name, item, float, "numbers") for item in values)


def _number_or_path(name: str, value: object) -> object:
    try:
        return value if isinstance(value, Path) else _number(name, value, float, "a number or a file name")
    except SettingsError:
        if isinstance(value, str):
            return _path(name, value)
        raise


def _path(name: str, value: object) -> Path | str:
    if isinstance(value, str) and (value.startswith("/vsi") or "://" in value):
        return value  # a Path would merge the slashes of a GDAL URI
    return value if isinstance(value, Path) else Path(_text(name, value, "a file name"))


def _text(name: str, value: object, expected: str) -> str:
    if not isinstance(value, str):
        raise SettingsError(f"{name} = {value!r}: give {expected}")
    return value
