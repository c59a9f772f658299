"""The table of pairs: one line each, with the options that are the pair's own."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.input_files import check_regular
from pcwlad_geo.limits import BATCH_ROWS, check_count
from pcwlad_geo.registration.option_values import RUNNING, SETTINGS, to_setting
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.workflow import output_folder

PLACES: Final = ("output_raster", "output_tiepoints", "output_report", "output_points")
COLUMNS: Final = (
    "reference",
    "target",
    "out_dir",
    *PLACES,
    *(name for name in SETTINGS if name not in RUNNING),
)

PathLike = str | os.PathLike[str]


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """A line of the table: what to register, and how."""

    line: int
    """Of the file, from 1."""
    reference: str
    target: str
    """Absolute paths, or GDAL URIs."""
    out_dir: Path
    settings: Settings
    places: Mapping[str, Path]
    """`output_raster` and the like, where given."""

    @property
    def name(self) -> str:
        """How messages call it."""
        return f"{Path(self.target).name} (line {self.line})"


def read_pairs(table: PathLike, out_dir: PathLike, options: Mapping[str, Any]) -> list[Pair]:
    """Read and check the whole table before any work is done.

    Parameters
    ----------
    table : path
        CSV with a header: `reference` and `target`, and any of the other `COLUMNS`. An empty cell is the
        default. Relative paths start from the folder of the table; outputs lie below it, or below `out_dir`.
    out_dir : path
        Where pairs without an `out_dir` of their own get theirs: ``<target stem>_registered``, with a
        number where that is taken.
    options : mapping
        Fields of `Settings` that hold where a line says nothing.

    Raises
    ------
    InputError
        If the table cannot be read, a column is unknown, a value makes no sense, two pairs have the same
        `out_dir`, an output lies elsewhere, or there is no pair.
    """
    path = Path(table)
    check_regular(path)
    rows = list(islice(_rows(path), BATCH_ROWS + 1))
    check_count(str(path), len(rows), BATCH_ROWS, "pairs")
    if not rows:
        raise InputError(f"{path} holds no pairs: give a line for each, below the header")
    folder = Path(os.path.abspath(path)).parent  # noqa: PTH100  # resolve() would follow a symbolic link
    _check_places(path, rows, folder, Path(out_dir))
    given = _given_folders(path, rows, folder)
    taken = {_key(place) for place in given.values()}
    pairs = []
    for line, cells in rows:
        place = given.get(line) or _free(Path(out_dir) / _default_folder(cells["target"]), taken)
        taken.add(_key(place))
        try:
            pairs.append(_pair(line, cells, folder, place, options))
        except SettingsError as error:
            raise InputError(f"{path}, line {line}: {error}") from error
    return pairs


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Give the number and the cells that are not empty of each line that is not."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, skipinitialspace=True)
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
        if name in RUNNING:
            raise InputError(f"{path}: '{name}' is the same for all pairs: give it to batch, not in a column")
        if name not in COLUMNS:
            raise InputError(f"{path} has unknown column '{name}'; the columns are {', '.join(COLUMNS)}")
        if columns.count(name) > 1:
            raise InputError(f"{path} has column '{name}' twice")
    for name in ("reference", "target"):
        if name not in columns:
            raise InputError(f"{path} has no column '{name}'")
    return columns


def _check_places(path: Path, rows: list[tuple[int, dict[str, str]]], folder: Path, out_dir: Path) -> None:
    """Raise where a table, which may be a stranger's, names outputs outside its own folder and OUT_DIR."""
    allowed = (folder.resolve(), out_dir.resolve())
    for line, cells in rows:
        for name in ("out_dir", *PLACES):
            place = (folder / cells[name]).resolve() if name in cells else allowed[0]
            if not any(place.is_relative_to(own) for own in allowed):
                raise InputError(
                    f"{path}, line {line}: {name} {cells[name]} is neither below the table's folder {folder} "
                    f"nor below OUT_DIR ({out_dir}): give a folder above it by -o, or another place"
                )


def _given_folders(path: Path, rows: list[tuple[int, dict[str, str]]], folder: Path) -> dict[int, Path]:
    """Return the output folders that the table names, by line."""
    given: dict[int, Path] = {}
    lines: dict[str, int] = {}
    for line, cells in rows:
        if "out_dir" not in cells:
            continue
        given[line] = folder / cells["out_dir"]
        other = lines.setdefault(_key(given[line]), line)
        if other != line:
            raise InputError(f"{path}: lines {other} and {line} have the same out_dir {cells['out_dir']}")
    return given


def _pair(
    line: int, cells: Mapping[str, str], folder: Path, out_dir: Path, options: Mapping[str, Any]
) -> Pair:
    own = {name: to_setting(name, value) for name, value in cells.items() if name in SETTINGS}
    own |= {name: folder / value for name, value in own.items() if isinstance(value, Path)}
    settings = Settings.from_options({**options, **own})
    parse_requirements(settings.require, "register")
    return Pair(
        line,
        _located(cells["reference"], folder),
        _located(cells["target"], folder),
        out_dir,
        settings,
        {name: folder / cells[name] for name in PLACES if name in cells},
    )


def _located(name: str, folder: Path) -> str:
    """Return a path from the table's folder; what is a GDAL URI stays as it is."""
    path = folder / name
    return name if ":" in name and not path.exists() else str(path)


def _default_folder(target: str) -> Path:
    return output_folder(target, "registered")


def _free(folder: Path, taken: set[str]) -> Path:
    """Return the folder, or the first one numbered from 2 that is not taken."""
    number, free = 1, folder
    while _key(free) in taken:
        number += 1
        free = folder.with_name(f"{folder.name}_{number}")
    return free


def _key(folder: Path) -> str:
    """Return a text that two names of a folder share, also where capitals do not count."""
    return os.path.normcase(os.path.abspath(folder)).casefold()  # noqa: PTH100
