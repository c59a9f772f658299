"""Text from untrusted sources: reading of files, cells of spreadsheets, lines of a terminal."""

from __future__ import annotations

import csv
import html
import io
import json
import math
import os
import re
import stat
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.limits import LIMITS

if TYPE_CHECKING:
    from pydantic import ValidationError

T = TypeVar("T")

_SPECIAL_FILES: Final = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)

_SIDECARS: Final = (".txt", ".xml", ".imd", ".rpb", ".rpc", ".pvl", ".eph", ".att", ".pass")
"""Endings of metadata that GDAL looks for in the folder of a raster, some whatever the raster is called."""
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")  # full-width ones count too
HIDDEN: Final = ("Cc", "Cs", "Zl", "Zp")
"""Unicode categories of control characters, bytes that are no text, and line and paragraph separators."""
_PART: Final = re.compile(r"(?P<file>.+\.jpe?g):(?P<part>visible|thermal)", re.IGNORECASE | re.DOTALL)
TURNING: Final = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that reverse the direction of the text after them, which could show a name backwards."""


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise `InputError` if a path is a pipe, a socket or a device, as reading it may never end.

    Folders and missing files are not checked here.
    """
    try:
        mode = os.stat(path).st_mode  # noqa: PTH116  # a GDAL URI is no path
    except (OSError, ValueError):
        return
    for is_kind, name in _SPECIAL_FILES:
        if is_kind(mode):
            raise InputError(f"{os.fspath(path)} is {name}, not a file: copy what it gives into a file")


def is_uri(name: str) -> bool:
    """Whether a name may be a GDAL URI, so that only GDAL knows what it names."""
    return ":" in name or name.startswith(("/vsi", "<"))


def part_of_jpeg(name: str) -> tuple[str, str] | None:
    """Return file and part of ``shot.jpg:visible``; None of other names, and of a file that is so called."""
    match = _PART.fullmatch(name)
    if match is None or os.path.exists(name):  # noqa: PTH110
        return None
    return match["file"], match["part"].lower()


def check_exists(name: str) -> None:
    """Raise `InputError` if a name that can only be a path names nothing."""
    name = (part_of_jpeg(name) or (name,))[0]
    if not (is_uri(name) or os.path.exists(name)):  # noqa: PTH110  # it may be no valid path
        raise InputError(f"{name} does not exist: check the path")


def check_sidecars(path: str | os.PathLike[str]) -> None:
    """Raise `InputError` where a pipe, a socket or a device lies beside a raster, and GDAL would open it.

    GDAL looks for georeferencing, RPCs, overviews and metadata beside a raster, by its name or by their own.
    """
    try:
        folder, name = os.path.split(os.path.abspath(path))  # noqa: PTH100  # a GDAL URI is no path
        changed_ns = os.stat(folder).st_mtime_ns  # noqa: PTH116
        special = _no_regular_files(folder, changed_ns)
    except (OSError, ValueError):
        return
    stem = name.lower().partition(".")[0] or name.lower()
    for other in special:
        if other.lower().startswith(stem) or other.lower().endswith(_SIDECARS):
            check_regular(Path(folder, other))


@lru_cache(maxsize=64)
def _no_regular_files(folder: str, _: int) -> tuple[str, ...]:
    """Return the names of what is neither a file nor a folder in a folder."""
    with os.scandir(folder) as entries:
        return tuple(entry.name for entry in entries if not (entry.is_file() or entry.is_dir()))


def read_bytes(path: Path, most: int = LIMITS.text_bytes) -> bytes:
    """Read the whole file `path` of at most `most` bytes.

    Raises `InputError` if it is no regular file, or larger than `most` bytes, and `OSError` if it cannot be
    read.
    """
    check_regular(path)
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise InputError(f"{path} has more than {most} bytes, and at most so many are read: divide it")
    return data


def read_text(
    path: Path, *, most: int = LIMITS.text_bytes, encoding: str = "utf-8", errors: str = "strict"
) -> str:
    r"""Read the whole text file `path` with all line ends as ``\n``; `encoding` and `errors` are as Python's.

    Raises `InputError` if it is no regular file, or larger than `most` bytes, and `OSError` or
    `UnicodeDecodeError` if it cannot be read or decoded.
    """
    return read_bytes(path, most).decode(encoding, errors).replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path) -> Any:  # noqa: ANN401  # of any structure
    """Read a JSON file of at most `text_bytes``, which may be of any program and damaged.

    Raises `InputError` if it is no regular file, or larger, `OSError` if it cannot be read, and `ValueError`
    if it is no JSON in UTF-8, or not as `parse_json` takes it.
    """
    return parse_json(read_text(path))


def mismatch(value: object, kind: type) -> str | None:
    """Return what in a JSON value is not of the type whose values were written so; None if all is.

    The published schemas are made of the same types. Keys may be missing, as a later version may add some.
    """
    from pydantic import ValidationError  # slow to load, and for what is read back only

    try:
        text = json.dumps(value, ensure_ascii=False).encode("utf-8", "replace")  # names may be no text
        _adapter(kind).validate_json(text, strict=True)
    except ValidationError as error:
        return next((reason for reason, is_missing in _reasons(error) if not is_missing), None)
    except SettingsError as error:
        return str(error)
    return None


def typed(value: object, kind: type[T], written: type | None = None) -> T:
    """Return a JSON value as a `kind`, a dataclass for example; keys that this has no field for are ignored.

    Raises `ValueError` if the value is not of that type, or has what the type that it was `written` as does
    not allow (see `mismatch`).
    """
    from pydantic import ValidationError

    if written is not None and (wrong := mismatch(value, written)) is not None:
        raise ValueError(wrong)
    try:
        result: T = _adapter(cast(type, kind)).validate_python(value)
    except ValidationError as error:
        raise ValueError(next(reason for reason, _ in _reasons(error))) from error
    except SettingsError as error:
        raise ValueError(str(error)) from error
    return result


def _reasons(error: ValidationError) -> Iterator[tuple[str, bool]]:
    """Yield what is wrong with each value, and whether it is only a key that is missing."""
    for wrong in error.errors(include_url=False, include_input=False, include_context=False):
        # without the names that pydantic gives to the branches of a union, and without our classes
        place = [str(part) for part in wrong["loc"] if "[" not in str(part)]
        is_missing = wrong["type"] == "missing" and not isinstance(wrong["loc"][-1], int)
        reason = re.sub(r" or an instance of \w+$", "", wrong["msg"])
        yield f"{'.'.join(place)}: {reason}".removeprefix(": "), is_missing


@lru_cache(maxsize=16)
def _adapter(kind: type) -> Any:  # noqa: ANN401
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def whole(text: str, digits: int = 9) -> int | None:
    """Return the whole number that a text is; None if it is not of digits alone, or of more than `digits`."""
    text = text.strip()
    return int(text) if text.isdecimal() and len(text) <= digits else None


def csv_of(rows: Sequence[Mapping[str, object]]) -> str:
    """Return the CSV text of one or more `rows`, their names as header; True and False are yes and no."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        words = {name: {True: "yes", False: "no"}[value] if isinstance(value, bool) else value
                 for name, value in row.items()}  # fmt: skip
        writer.writerow({name: cell(value) for name, value in words.items()})
    return text.getvalue()


def parse_json(text: str) -> Any:  # noqa: ANN401  # of any structure
    """Return the value of a JSON text, in which numbers are finite and little is nested.

    Raises `ValueError` if it is no JSON, holds NaN, an infinite number or a whole one of more than
    `json_digits`` digits, or is nested deeper than `json_depth``.
    """
    try:
        content = json.loads(text, parse_constant=_finite, parse_float=_finite, parse_int=_whole)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    level = [content]
    for _ in range(LIMITS.json_depth):
        level = [
            inner for container in level for inner in _inside(container) if isinstance(inner, dict | list)
        ]
        if not level:
            return content
    raise ValueError("nested too deeply")


def plain(value: object) -> object:
    """Return a value in JSON types: of NaN None, of paths text, of arrays lists, of dataclasses dicts."""
    if hasattr(value, "tolist"):  # of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if not is_dataclass(value):
        return value
    content: dict[str, object] = {}
    for field in fields(value):
        item = plain(getattr(value, field.name))
        content |= item if "inline" in field.metadata and isinstance(item, dict) else {field.name: item}
    return content


def _inside(value: object) -> Iterable[object]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is no finite number")
    return number


def _whole(text: str) -> int:
    if len(text) > LIMITS.json_digits:
        raise ValueError(f"a number has {len(text)} digits")
    return int(text)


def cell(value: T) -> T | str:
    """Return a value for a CSV file, with an apostrophe before text that begins like a formula.

    File names, names of bands and messages may come from an untrusted source. With the apostrophe, which it
    shows or hides, a spreadsheet does not evaluate them. Numbers are returned unchanged.
    """
    if isinstance(value, str) and value.lstrip(" ").startswith(_FORMULA):
        return f"'{value}"
    return value


def visible(text: str) -> str:
    r"""Return a text with its control characters written like ``\x1b``, except line breaks and tabs."""
    return "".join(
        character.encode("unicode_escape").decode("ascii")
        if character not in "\n\t" and (unicodedata.category(character) in HIDDEN or character in TURNING)
        else character
        for character in text
    )


def one_line(message: object) -> str:
    """Return a message on one line, whatever line breaks and control characters it came with."""
    return visible(joined(message))


def joined(message: object) -> str:
    """Return a message with each run of spaces and line breaks replaced by a space."""
    return " ".join(str(message).split())


class Shown:
    """What prints as its class and some facts on a line, and in a notebook as a table of them."""

    __slots__ = ()

    def _facts(self) -> dict[str, str]:
        """Return the facts of either by name."""
        raise NotImplementedError

    def _more(self) -> dict[str, str]:
        """Return those of the table only, which come last and replace others."""
        return {}

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {one_line(', '.join(self._facts().values()))}>"

    def _repr_html_(self) -> str:
        return html_table(type(self).__name__, self._facts() | self._more())


def html_table(title: str, facts: Mapping[str, str]) -> str:
    """Return a small table for a notebook; all text is escaped.

    The `facts` are names and values, a row each.
    """
    rows = "".join(
        f"<tr><th style='text-align:left'>{_escaped(name)}</th>"
        f"<td style='text-align:left'>{_escaped(value)}</td></tr>"
        for name, value in facts.items()
    )
    return f"<table><caption>{_escaped(title)}</caption><tbody>{rows}</tbody></table>"


def _escaped(text: str) -> str:
    return html.escape(one_line(text))


def write_lines(path: Path, lines: list[str]) -> None:
    """Write lines of text as UTF-8, with the line ends of Unix."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
