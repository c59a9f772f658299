"""Tie point files of QGIS, ENVI, GDAL and our own, read as they are; nothing is laid on a pair yet."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.input_files import check_regular, read_bytes
from pcwlad_geo.limits import POINTS, check_coordinates, check_count
from pcwlad_geo.raster.boundary import LIBRARY_ERRORS
from pcwlad_geo.raster.source import open_own_raster, open_raster
from pcwlad_geo.raster.vrt_names import gcps_alone

Array = NDArray[np.float64]

CRS_LINE: Final = "#CRS:"
_HEAD_BYTES: Final = 65536
# ENVI counts from (1, 1) at the top-left corner of the first pixel, GDAL from (0, 0).
_ENVI_ORIGIN_PX: Final = 1.0
_ENVI_SIDE: Final = re.compile(r"(base|warp|map|image)(?:\s+image)?\s*\(([^)]*)\)", re.IGNORECASE)
_ENVI_FILE: Final = re.compile(r";\s*(base|warp) file\s*:\s*(.*\S)", re.IGNORECASE)
_QGIS_SOURCE: Final = (("sourcex", "sourcey"), ("pixelx", "pixely"))
_OWN: Final = ("ref_col", "ref_row", "tgt_col", "tgt_row")


@dataclass(frozen=True, slots=True, eq=False)
class PointFile:
    """What a file of tie points says."""

    reference: Array
    """(n, 2): px (col, row) of the reference, or map coordinates (x, y)."""
    target: Array
    """(n, 2): px (col, row) of the target, or its layer coordinates (x, y) as QGIS has them."""
    enabled: NDArray[np.bool_]
    """(n,) False where the file switches a point off."""
    reference_in: Literal["px", "map"]
    target_in: Literal["px", "layer"]
    crs: CRS | None = None
    """Of map coordinates, where the file says."""
    sigma_px: Array | None = None
    """(n, 2) where the file says, NaN where a cell is empty."""
    score: Array | None = None
    """(n,) where the file says."""
    xy: Array | None = None
    """(n, 2) map coordinates besides the pixels, to check them by."""
    displacement_px: Array | None = None
    """(n, 2) displacements besides the pixels, to check them by."""
    shape: tuple[int, int] | None = None
    """Rows, columns of the raster that carries the points."""


def read_point_file(path: Path | str, *, reference_name: str = "", target_name: str = "") -> PointFile:
    """Read tie points; the format is told by the content.

    - `tiepoints.csv`, or any CSV with the columns ref_col, ref_row, tgt_col, tgt_row (GDAL's px);
    - QGIS Georeferencer `.points`: columns by name (sourceX or pixelX), commas or tabs, `enable` or not;
    - ENVI `.pts`, image to image or image to map: the header's line "Base Image (x,y), Warp Image (x,y)"
      says which comes first; without it the base does;
    - a raster with ground control points.

    Parameters
    ----------
    path : path
        The file, or a GDAL URI.
    reference_name, target_name : str
        File names of the rasters: an ENVI file that names them the other way round is turned.

    Raises
    ------
    InputError
        If it is none of these, a cell is no number, or there is no point.
    """
    path = str(path)
    text = _text_of(Path(path))
    if text is None:
        points = _read_gcps(path)
    else:
        lines = text.splitlines()
        first = next((line for line in lines if line.strip() and not line.startswith("#")), "").lower()
        if "mapx" in first:
            points = _read_qgis(path, lines)
        elif all(name in first for name in _OWN):
            points = _read_csv(path, lines)
        elif first.lstrip().startswith(";") or _only_numbers(first, 4):
            points = _read_envi(path, lines, reference_name, target_name)
        elif first.lstrip().startswith("<"):
            points = _read_gcps(path)
        else:
            raise _unknown(path)
    if len(points.reference) == 0:
        raise InputError(f"{path} holds no tie points: give a file with some")
    finite = np.isfinite(np.column_stack([points.reference, points.target])).all(axis=1)
    if not finite.all():
        raise InputError(f"{path}: {(~finite).sum()} of {finite.size} points lack a coordinate: remove them")
    check_coordinates(path, np.concatenate([points.reference, points.target]).ravel().tolist())
    return points


def _text_of(path: Path) -> str | None:
    """Return the content of a text file; None where it is none."""
    try:
        check_regular(path)
        data = read_bytes(path) if path.is_file() and _may_be_text(path) else None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    if data is None or b"\0" in data[:_HEAD_BYTES]:
        return None
    for encoding in ("utf-8-sig", "latin-1"):  # file names in headers may be of any
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return None


def _may_be_text(path: Path) -> bool:
    with path.open("rb") as file:  # a raster may be large
        return b"\0" not in file.read(_HEAD_BYTES)


def _unknown(path: str) -> InputError:
    return InputError(
        f"{path} is no file of tie points: give a tiepoints.csv (columns {', '.join(_OWN)}), a QGIS .points "
        "file, an ENVI .pts file or a raster with ground control points"
    )


def _only_numbers(line: str, least: int) -> bool:
    cells = line.split()
    return len(cells) >= least and all(re.fullmatch(r"[-+.\deE]+", cell) for cell in cells)


def _read_csv(path: str, lines: Sequence[str]) -> PointFile:
    table = _Table.read(path, lines)
    sides = {name: table.pair(f"{name}_col", f"{name}_row") for name in ("ref", "tgt")}
    return PointFile(
        sides["ref"],
        sides["tgt"],
        np.array([text != "rejected" for text in table.texts("status")]),
        "px",
        "px",
        sigma_px=table.sigmas(),
        score=table.numbers("score") if "score" in table.columns else None,
        xy=table.pair("x", "y", optional=True),
        displacement_px=table.pair("d_col", "d_row", optional=True),
    )


def _read_qgis(path: str, lines: Sequence[str]) -> PointFile:
    crs = _crs_of(path, next((line for line in lines if line.startswith(CRS_LINE)), CRS_LINE))
    body = [line for line in lines if not line.startswith("#")]
    table = _Table.read(path, body)
    source = next((pair for pair in _QGIS_SOURCE if set(pair) <= set(table.columns)), None)
    if source is None or "mapy" not in table.columns:
        raise InputError(
            f"{path} has the columns {', '.join(table.columns)}: a .points file of the QGIS Georeferencer "
            "has mapX, mapY and sourceX, sourceY (or pixelX, pixelY)"
        )
    enabled = np.ones(len(table.rows), bool)
    if "enable" in table.columns:
        enabled = table.numbers("enable") != 0  # an empty cell is NaN, which is not 0
    return PointFile(table.pair("mapx", "mapy"), table.pair(*source), enabled, "map", "layer", crs)


def _crs_of(path: str, line: str) -> CRS | None:
    text = line.removeprefix(CRS_LINE).strip()
    if not text:
        return None
    try:
        return CRS.from_user_input(text)
    except LIBRARY_ERRORS as error:
        raise InputError(f"{path}: the CRS in its first line is not understood: {text[:80]}") from error


def _read_envi(path: str, lines: Sequence[str], reference_name: str, target_name: str) -> PointFile:
    comments = [line.strip() for line in lines if line.lstrip().startswith(";")]
    sides = next((found for line in comments if len(found := _ENVI_SIDE.findall(line)) == 2), None)
    names = [side.lower() for side, _ in sides] if sides else ["base", "warp"]
    widths = [3 if "elev" in axes.lower() else 2 for _, axes in sides] if sides else [2, 2]
    if sorted(names) not in (["base", "warp"], ["image", "map"], ["map", "warp"]):
        raise InputError(f"{path}: cannot tell base and warp columns from its header '{' '.join(names)}'")
    rows = np.array(list(_envi_rows(path, lines, sum(widths)))).reshape(-1, sum(widths))
    halves = dict(zip(names, (rows[:, :2], rows[:, widths[0] : widths[0] + 2]), strict=True))
    enabled = np.ones(len(rows), bool)
    if "map" in halves:
        image = halves["image"] if "image" in halves else halves["warp"]
        return PointFile(halves["map"], image - _ENVI_ORIGIN_PX, enabled, "map", "px")
    base, warp = halves["base"] - _ENVI_ORIGIN_PX, halves["warp"] - _ENVI_ORIGIN_PX
    files = {which.lower(): _name(name) for line in comments for which, name in _ENVI_FILE.findall(line)}
    ours = _name(reference_name), _name(target_name)
    if ours[0] != ours[1] and (files.get("warp"), files.get("base")) == ours:
        base, warp = warp, base
    return PointFile(base, warp, enabled, "px", "px")


def _envi_rows(path: str, lines: Sequence[str], width: int) -> Iterator[list[float]]:
    check_count(path, len(lines), 2 * POINTS, "lines")  # with comments
    for number, line in enumerate(lines, start=1):
        cells = line.replace(",", " ").split()
        if not cells or cells[0].startswith(";"):
            continue
        if len(cells) != width:
            raise InputError(f"{path}, line {number} has {len(cells)} columns, not {width}")
        yield [_number(path, number, "a coordinate", cell) for cell in cells]


def _name(path: str) -> str:
    return path.replace("\\", "/").rsplit("/", 1)[-1].casefold()


def _read_gcps(path: str) -> PointFile:
    """Read the ground control points of a raster: pixel and line are those of the target."""
    bare = gcps_alone(Path(path))
    try:
        # its pixels are not wanted: what they are made of is not opened
        with open_own_raster(bare) if bare else open_raster(path) as dataset:
            gcps, crs = dataset.gcps
            shape = dataset.shape
    except TrustError:
        raise
    except InputError as error:
        raise (_unknown(path) if Path(path).is_file() else error) from error
    if not gcps:
        raise InputError(f"{path} is a raster without ground control points: give one that has some")
    return PointFile(
        np.array([[gcp.x, gcp.y] for gcp in gcps], dtype=np.float64),
        np.array([[gcp.col, gcp.row] for gcp in gcps], dtype=np.float64),
        np.ones(len(gcps), bool),
        "map",
        "px",
        crs,
        shape=shape,
    )


@dataclass(frozen=True, slots=True)
class _Table:
    """A table with a header, its names in small letters."""

    path: str
    columns: tuple[str, ...]
    rows: list[tuple[int, dict[str, str]]]
    """Line number and cells by column."""

    @staticmethod
    def read(path: str, lines: Sequence[str]) -> _Table:
        header = next(line for line in lines if line.strip())
        delimiter = "\t" if "\t" in header else "," if "," in header else ";"
        reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
        columns: tuple[str, ...] = ()
        rows: list[tuple[int, dict[str, str]]] = []
        try:
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue
                if not columns:
                    columns = tuple(cell.strip().lower() for cell in cells)
                    continue
                check_count(path, len(rows) + 1, POINTS, "points")
                rows.append((reader.line_num, dict(zip(columns, cells, strict=False))))
        except csv.Error as error:
            raise InputError(f"{path} cannot be read as a table: {error}") from error
        return _Table(path, columns, rows)

    def texts(self, column: str) -> list[str]:
        return [row.get(column, "").strip() for _, row in self.rows]

    def numbers(self, column: str) -> Array:
        values = [
            _number(self.path, line, column, row.get(column, "").strip() or "nan") for line, row in self.rows
        ]
        return np.array(values, dtype=np.float64)

    def sigmas(self) -> Array:
        """Return sigma_col and sigma_row; NaN where a cell is empty, none of them is 0 or less."""
        sigma_px = self.pair("sigma_col", "sigma_row", optional=True)
        for column, values in zip(("sigma_col", "sigma_row"), sigma_px.T, strict=True):
            if column in self.columns:
                texts = self.texts(column)
                for (line, _), text, value in zip(self.rows, texts, values, strict=True):
                    check_sigma(self.path, line, column, text, value)
        return sigma_px

    def pair(self, first: str, second: str, *, optional: bool = False) -> Array:
        if optional and not {first, second} <= set(self.columns):
            return np.full((len(self.rows), 2), np.nan)
        return np.column_stack([self.numbers(first), self.numbers(second)])


def _number(path: str, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f"{path}, line {line}: {name} is '{text}', not a number") from error
    return value if math.isfinite(value) else math.nan


def check_sigma(path: Path | str, line: int, column: str, text: str, value: float) -> None:
    """Raise where a cell that is not empty is no positive number.

    Raises
    ------
    InputError
        Then.
    """
    if text and not (math.isfinite(value) and value > 0.0):
        raise InputError(
            f"{path}, line {line}: {column} is '{text}': give a positive number, or leave it empty"
        )


def swapped(points: PointFile, side: Literal["reference", "target"]) -> PointFile:
    """Return the points with x and y of one side exchanged."""
    if side == "reference":
        return replace(points, reference=points.reference[:, ::-1])
    return replace(points, target=points.target[:, ::-1])
