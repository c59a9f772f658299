"""The table of a batch: pairs of rasters, their options and their places."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.multi.batch.flight import Photo
from pcwlad_geo.option_text import to_setting
from pcwlad_geo.options import NOT_IN_TABLES, OUTPUT_OPTIONS, RUNNING, SETTINGS, Settings
from pcwlad_geo.pair_job import output_folder
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.text import part_of_jpeg, read_text
from pcwlad_geo.types import PathLike

PAIR_COLUMNS: Final = (
    "reference",
    "target",
    "out_dir",
    *OUTPUT_OPTIONS,
    *(name for name in SETTINGS if name not in NOT_IN_TABLES),
)
"""All columns that a table may have."""


@dataclass(frozen=True, slots=True, eq=False)
class BatchPair:
    """A line of the table: the pair to register, and its options."""

    line: int
    """Number of the line in the file, from 1."""
    reference: str
    target: str
    """Absolute path or GDAL URI, as that of the reference."""
    out_dir: Path
    settings: Settings
    places: Mapping[str, Path]
    """Paths of single outputs by column, for those given."""

    @property
    def name(self) -> str:
        """Name of the pair in messages."""
        return f"{Path(self.target).name} (line {self.line})"


def read_pairs(table: PathLike, out_dir: PathLike, options: Mapping[str, Any]) -> list[BatchPair]:
    """Read and check the whole table before any work is done.

    It is CSV with a header: `reference` and `target`, and any of the other `PAIR_COLUMNS`. An empty cell
    means the field of `options`, or the default. Relative paths refer to the folder of the table; outputs
    must be below it, or `out_dir`, where pairs without a folder get ``<target stem>_registered``, with a
    number if that name is taken. Raises `InputError` if the table cannot be read, a column is unknown, a
    value is invalid, two pairs have the same `out_dir`, an output is elsewhere, or there is no pair.
    """
    path = Path(table)
    rows = list(islice(_rows(path), LIMITS.batch_rows + 1))
    check_count(str(path), len(rows), LIMITS.batch_rows, "pairs")
    if not rows:
        raise InputError(f"{path} holds no pairs: give a line for each, below the header")
    folder = Path(os.path.abspath(path)).parent  # noqa: PTH100  # resolve() would follow a symbolic link
    _check_places(path, rows, folder, Path(out_dir))
    folders = _given_folders(path, rows, folder)
    keys = {_key(place) for place in folders.values()}
    numbers: dict[str, int] = {}
    pairs = []
    for line, cells in rows:
        place = folders.get(line) or _free(
            Path(out_dir) / output_folder(cells["target"], "registered"), keys, numbers
        )
        keys.add(_key(place))
        try:
            pairs.append(_pair(line, cells, folder, place, options))
        except SettingsError as error:
            raise InputError(f"{path}, line {line}: {error}") from error
    return pairs


def pairs_of_photos(
    photos: Sequence[Photo], out_dir: PathLike, options: Mapping[str, Any]
) -> list[BatchPair]:
    """Return the pairs of the photographs of a flight index, as `read_pairs` does those of a table."""
    keys: set[str] = set()
    numbers: dict[str, int] = {}
    settings = Settings.from_options({"prealign": "search", **options})
    parse_requirements(settings.require, "register")
    pairs = []
    for photo in photos:
        place = _free(Path(out_dir) / output_folder(photo.path, "registered"), keys, numbers)
        keys.add(_key(place))
        around = replace(settings, extent=photo.extent) if photo.extent else settings
        pairs.append(BatchPair(photo.line, photo.reference, photo.path, place, around, {}))
    return pairs


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the number and the nonempty cells of each nonempty line."""
    try:
        reader = csv.reader(io.StringIO(read_text(path, encoding="utf-8-sig")), skipinitialspace=True)
        columns = _columns(path, next(reader, []))
        for values in reader:
            values = [value.strip() for value in values]
            if not any(values):
                continue
            if len(values) > len(columns):
                raise InputError(
                    f"{path}, line {reader.line_num} has {len(values)} cells for {len(columns)} columns: "
                    "put values that hold a comma in quotes"
                )
            cells = {name: value for name, value in zip(columns, values, strict=False) if value}
            for name in ("reference", "target"):
                if name not in cells:
                    raise InputError(f"{path}, line {reader.line_num} has no {name}")
            yield reader.line_num, cells
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is no CSV table in UTF-8: {error}") from error


def _columns(path: Path, header: list[str]) -> list[str]:
    columns = [name.strip().replace("-", "_") for name in header]
    if len(columns) == 1 and ";" in columns[0]:
        raise InputError(f"{path} is separated by semicolons: save it with commas")
    for name in columns:
        if name in NOT_IN_TABLES and name not in RUNNING:
            raise InputError(
                f"{path}: '{name}' runs code, which no table may name: register such pairs alone"
            )
        if name in RUNNING:
            raise InputError(f"{path}: '{name}' is the same for all pairs: give it to batch, not in a column")
        if name not in PAIR_COLUMNS:
            raise InputError(f"{path} has unknown column '{name}'; the columns are {', '.join(PAIR_COLUMNS)}")
        if columns.count(name) > 1:
            raise InputError(f"{path} has column '{name}' twice")
    for name in ("reference", "target"):
        if name not in columns:
            raise InputError(f"{path} has no column '{name}'")
    return columns


def _check_places(path: Path, rows: list[tuple[int, dict[str, str]]], folder: Path, out_dir: Path) -> None:
    """Raise if a table, which may be untrusted, names outputs outside of its own folder and OUT_DIR."""
    allowed = (folder.resolve(), out_dir.resolve())
    for line, cells in rows:
        for name in ("out_dir", *OUTPUT_OPTIONS):
            place = (folder / cells[name]).resolve() if name in cells else allowed[0]
            if not any(place.is_relative_to(parent) for parent in allowed):
                raise InputError(
                    f"{path}, line {line}: {name} {cells[name]} is neither below the table's folder {folder} "
                    f"nor below OUT_DIR ({out_dir}): give a folder above it by -o, or another place"
                )


def _given_folders(path: Path, rows: list[tuple[int, dict[str, str]]], folder: Path) -> dict[int, Path]:
    """Return the output folders that the table names, by line."""
    folders: dict[int, Path] = {}
    lines: dict[str, int] = {}
    for line, cells in rows:
        if "out_dir" not in cells:
            continue
        folders[line] = folder / cells["out_dir"]
        other = lines.setdefault(_key(folders[line]), line)
        if other != line:
            raise InputError(f"{path}: lines {other} and {line} have the same out_dir {cells['out_dir']}")
    return folders


def _pair(
    line: int, cells: Mapping[str, str], folder: Path, out_dir: Path, options: Mapping[str, Any]
) -> BatchPair:
    row_options = {name: to_setting(name, value) for name, value in cells.items() if name in SETTINGS}
    row_options |= {name: folder / value for name, value in row_options.items() if isinstance(value, Path)}
    settings = Settings.from_options({**options, **row_options})
    parse_requirements(settings.require, "register")
    return BatchPair(
        line,
        _located(cells["reference"], folder),
        _located(cells["target"], folder),
        out_dir,
        settings,
        {name: folder / cells[name] for name in OUTPUT_OPTIONS if name in cells},
    )


def _located(name: str, folder: Path) -> str:
    """Return a path relative to the table's folder as absolute; GDAL URIs are unchanged."""
    path = folder / name
    is_path = ":" not in name or path.exists() or part_of_jpeg(name)
    return str(path) if is_path else name


def _free(folder: Path, keys: set[str], numbers: dict[str, int]) -> Path:
    """Return the folder, or the first one numbered from 2 that is not taken.

    All up to `numbers` of a folder's key are known to be taken, so that many lines of one target need no more
    than linear time; it is brought up to date.
    """
    key, free = _key(folder), folder
    number = numbers.get(key, 1)
    while number > 1 or _key(free) in keys:
        number += 1
        free = folder.with_name(f"{folder.name}_{number}")
        if _key(free) not in keys:
            break
    numbers[key] = number
    return free


def _key(folder: Path) -> str:
    """Return a key that is equal for two names of one folder, also where case is not significant."""
    return os.path.normcase(os.path.abspath(folder)).casefold()  # noqa: PTH100
