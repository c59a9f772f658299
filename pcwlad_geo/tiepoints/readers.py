"""Readers of tie point files of QGIS, ENVI, GDAL and this program, and their application to a pair."""

from __future__ import annotations

import csv
import math
import re
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.limits import POINTS, SIGMA_PX, check_coordinates, check_count
from pcwlad_geo.raster.crs import name_of, transform_xy
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.rpc.grid import RpcGrid
from pcwlad_geo.raster.source import RasterInfo, open_raster, open_written_raster
from pcwlad_geo.raster.trust import gcps_only
from pcwlad_geo.text import check_regular, read_bytes
from pcwlad_geo.tiepoints.table import (
    COLUMNS,
    ENVI_ORIGIN_PX,
    TiePointTable,
    ground_xy,
    place,
    predict_target_px,
)
from pcwlad_geo.types import Bool, Float64

CRS_LINE: Final = "#CRS:"
"""Beginning of the line of a `.points` file that holds the CRS."""
_HEAD_BYTES: Final = 65536
_ENVI_SIDE: Final = re.compile(r"(base|warp|map|image)(?:\s+image)?\s*\(([^()]*)\)", re.IGNORECASE)
_ENVI_FILE: Final = re.compile(r";\s*(base|warp) file\s*:\s*(.*\S)", re.IGNORECASE)
_QGIS_SOURCE: Final = (("sourcex", "sourcey"), ("pixelx", "pixely"))
_OWN: Final = ("ref_col", "ref_row", "tgt_col", "tgt_row")
_SQLITE: Final = b"SQLite format 3\0"


@dataclass(frozen=True, slots=True, eq=False)
class PointFile:
    """The content of a file of tie points."""

    reference: Float64
    """(n, 2): px (col, row) of the reference, or map coordinates (x, y)."""
    target: Float64
    """(n, 2): px (col, row) of the target, or its layer coordinates (x, y) in QGIS."""
    enabled: Bool
    """(n,): False where the file disables a point."""
    reference_in: Literal["px", "map"]
    target_in: Literal["px", "layer"]
    crs: CRS | None = None
    """CRS of map coordinates, if the file states it."""
    sigma_px: Float64 | None = None
    """(n, 2) standard deviations (col, row), px, if the file states them; NaN for empty cells."""
    correlation: Float64 | None = None
    """(n,) correlations of the errors along columns and rows, if the file states them."""
    score: Float64 | None = None
    """(n,) scores, if the file states them."""
    xy: Float64 | None = None
    """(n, 2) map coordinates (x, y) given besides the pixels, for a consistency check."""
    displacement_px: Float64 | None = None
    """(n, 2) displacements (col, row), px, given besides the pixels, for a consistency check."""
    shape: tuple[int, int] | None = None
    """Rows, columns of the raster that holds the points."""
    status: NDArray[np.str_] | None = None
    """(n,) statuses, if the file states them."""


def read_point_file(path: Path | str, *, reference_name: str = "", target_name: str = "") -> PointFile:
    """Read a file of tie points; its format is recognised by its content.

    - `tiepoints.csv`, or any CSV with the columns ref_col, ref_row, tgt_col, tgt_row (GDAL's px);
    - `tiepoints.gpkg`: the layer tie_points, with the same columns;
    - QGIS Georeferencer `.points`: columns by name (sourceX or pixelX), commas or tabs, `enable` or not;
    - ENVI `.pts`, image to image or image to map: the header's line "Base Image (x,y), Warp Image (x,y)"
      gives the order; without it the base comes first;
    - a raster with ground control points.

    Raises `InputError` if the format is none of these, a cell is not a number, or there is no point.

    Parameters
    ----------
    path : path
        The file, or a GDAL URI.
    reference_name, target_name : str
        File names of the rasters: an ENVI file that names them in reverse order is swapped.
    """
    path = str(path)
    text = _text_of(Path(path))
    if text is None:
        points = _read_geopackage(path) if _head_of(Path(path)).startswith(_SQLITE) else _read_gcps(path)
    else:
        lines = text.splitlines()
        first = next((line for line in lines if line.strip() and not line.startswith("#")), "").lower()
        if "mapx" in first:
            points = _read_qgis(path, lines)
        elif all(name in first for name in _OWN):
            points = _own_columns(_Table.read(path, lines))
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
    """Return the content of a text file; None for a file of another kind."""
    try:
        check_regular(path)
        # a raster may be large
        data = read_bytes(path) if path.is_file() and b"\0" not in _head_of(path) else None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    if data is None or b"\0" in data[:_HEAD_BYTES]:
        return None
    for encoding in ("utf-8-sig", "latin-1"):  # file names in headers may have any encoding
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return None


def _head_of(path: Path) -> bytes:
    """Return the first bytes of a file; none of what is no file."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


def _unknown(path: str) -> InputError:
    return InputError(
        f"{path} is no file of tie points: give a tiepoints.csv (columns {', '.join(_OWN)}), a "
        "tiepoints.gpkg, a QGIS .points file, an ENVI .pts file or a raster with ground control points"
    )


def _only_numbers(line: str, least: int) -> bool:
    cells = line.split()
    return len(cells) >= least and all(re.fullmatch(r"[-+.\deE]+", cell) for cell in cells)


def _read_geopackage(path: str) -> PointFile:
    """Read the columns of the layer tie_points, without its geometries."""
    names = ", ".join(f'"{name}"' for name in COLUMNS)
    try:
        with closing(sqlite3.connect(f"{Path(path).absolute().as_uri()}?mode=ro", uri=True)) as database:
            cells = database.execute(f"SELECT {names} FROM tie_points").fetchmany(POINTS + 1)
    except sqlite3.Error as error:
        raise InputError(f"{path} holds no layer tie_points as pcwlad-geo writes it: {error}") from error
    check_count(path, len(cells), POINTS, "points")
    rows = [
        (number, {name: "" if cell is None else str(cell) for name, cell in zip(COLUMNS, row, strict=True)})
        for number, row in enumerate(cells, start=1)
    ]
    return _own_columns(_Table(path, COLUMNS, rows))


def _own_columns(table: _Table) -> PointFile:
    statuses = table.texts("status")
    sides = {name: table.pair(f"{name}_col", f"{name}_row") for name in ("ref", "tgt")}
    return PointFile(
        sides["ref"],
        sides["tgt"],
        np.array([text != "rejected" for text in statuses]),
        "px",
        "px",
        sigma_px=table.sigmas(),
        correlation=table.correlations(),
        score=table.numbers("score") if "score" in table.columns else None,
        xy=table.pair("x", "y", optional=True),
        displacement_px=table.pair("d_col", "d_row", optional=True),
        status=np.array(statuses, dtype="<U8") if "status" in table.columns else None,
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
        return PointFile(halves["map"], image - ENVI_ORIGIN_PX, enabled, "map", "px")
    base, warp = halves["base"] - ENVI_ORIGIN_PX, halves["warp"] - ENVI_ORIGIN_PX
    files = {which.lower(): _name(name) for line in comments for which, name in _ENVI_FILE.findall(line)}
    ours = _name(reference_name), _name(target_name)
    if ours[0] != ours[1] and (files.get("warp"), files.get("base")) == ours:
        base, warp = warp, base
    return PointFile(base, warp, enabled, "px", "px")


def _envi_rows(path: str, lines: Sequence[str], width: int) -> Iterator[list[float]]:
    check_count(path, len(lines), 2 * POINTS, "lines")  # including comments
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
    bare = gcps_only(Path(path))
    try:
        # the pixels are not needed, so the sources of a VRT are not opened
        with open_written_raster(bare) if bare else open_raster(path) as dataset:
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


MOST_CORRELATED: Final = 0.999999
"""Largest correlation that is taken: at 1 no error would be left across."""


@dataclass(frozen=True, slots=True)
class _Table:
    """A table with a header, its column names in lower case."""

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

    def numbers(self, column: str) -> Float64:
        values = [
            _number(self.path, line, column, row.get(column, "").strip() or "nan") for line, row in self.rows
        ]
        return np.array(values, dtype=np.float64)

    def sigmas(self) -> Float64:
        """Return (n, 2) sigma_col and sigma_row, px, all positive; NaN for empty cells."""
        sigma_px = self.pair("sigma_col", "sigma_row", optional=True)
        for column, values in zip(("sigma_col", "sigma_row"), sigma_px.T, strict=True):
            if column in self.columns:
                texts = self.texts(column)
                for (line, _), text, value in zip(self.rows, texts, values, strict=True):
                    check_sigma(self.path, line, column, text, value)
        return sigma_px

    def correlations(self) -> Float64 | None:
        """Return (n,) correlations, 0 for empty cells; None without that column."""
        if "correlation" not in self.columns:
            return None
        values = np.nan_to_num(self.numbers("correlation"))
        if (np.abs(values) > 1).any():
            line = self.rows[int(np.argmax(np.abs(values)))][0]
            raise InputError(f"{self.path}, line {line}: correlation lies beyond -1 to 1: correct it")
        return np.clip(values, -MOST_CORRELATED, MOST_CORRELATED)

    def pair(self, first: str, second: str, *, optional: bool = False) -> Float64:
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
    """Check that a cell with a standard deviation is empty or a positive number within `SIGMA_PX`.

    Raises `InputError`, with the path, line and column, if the cell is neither; `value` is NaN for an empty
    one.
    """
    least, most = SIGMA_PX
    if text and not least <= value <= most:
        raise InputError(
            f"{path}, line {line}: {column} is '{text}': give a positive number from {least:g} to {most:g} "
            "px, or leave it empty"
        )


def swapped(points: PointFile, side: Literal["reference", "target"]) -> PointFile:
    """Return `points` with x and y of one `side` exchanged."""
    if side == "reference":
        return replace(points, reference=points.reference[:, ::-1])
    return replace(points, target=points.target[:, ::-1])


MARGIN: Final = 0.1
"""Distance outside the raster, as a share of its size, at which points still count as on it."""
OTHER_PX: Final = 0.5
"""Tolerated difference of redundant columns, px; a larger one indicates other rasters."""


def read_tie_points(path: Path | str, pair: ViewPair, *, as_stated: bool = False) -> TiePointTable:
    """Read a file of tie points for a pair, in one of the formats of `read_point_file`.

    Map coordinates without a CRS are taken to be in the reference's. The statuses of the table are those that
    the file states if `as_stated`, or else ``matched``, ``rejected`` where it disables a point; the
    covariance is NaN without a sigma in the file, the score 1 without one. Raises `InputError` if the file
    cannot be read, or most points are outside a raster, as with swapped columns, another CRS or other
    rasters.
    """
    reference, target = pair.reference.info, pair.target.info
    points = read_point_file(path, reference_name=reference.uri, target_name=target.uri)
    if points.shape is not None and points.shape != target.grid.shape:
        raise InputError(
            f"{path} has {points.shape[1]} x {points.shape[0]} pixels and {target.uri} "
            f"{target.grid.shape[1]} x {target.grid.shape[0]}: its control points are of another raster"
        )
    reference_px = _on_raster(path, points, "reference", reference)
    target_px = _on_raster(path, points, "target", target)
    _check_against_itself(path, points, reference_px, target_px, pair)
    count = len(reference_px)
    sigma_px = np.full((count, 2), np.nan) if points.sigma_px is None else points.sigma_px
    covariance_px2 = sigma_px[:, :, None] * sigma_px[:, None, :]
    correlation = np.zeros(count) if points.correlation is None else points.correlation
    covariance_px2[:, [0, 1], [1, 0]] *= correlation[:, None]
    score = np.ones(count) if points.score is None else np.nan_to_num(points.score, nan=1.0)
    table = place(reference_px, target_px, covariance_px2, score, pair)
    if not np.isfinite(table.predicted_px).all():
        if isinstance(target.grid, RpcGrid):
            raise InputError(f"{path}: some points lie where the DEM has no height: remove them")
        raise InputError(
            f"{path}: some points lie where {name_of(reference.grid.crs)} cannot be transformed to "
            f"{name_of(target.grid.crs)}: remove them"
        )
    status = np.where(points.enabled, "matched", "rejected").astype("<U8")
    return replace(table, status=points.status if as_stated and points.status is not None else status)


def _on_raster(
    path: Path | str, points: PointFile, side: Literal["reference", "target"], info: RasterInfo
) -> Float64:
    """Return (n, 2) px (col, row) of a raster; raise if most of the points are outside of it."""
    readings = _readings(points, side, info)
    for found_px in readings:
        if _inside(found_px, info):
            return found_px
    exchanged = any(_inside(found_px, info) for found_px in _readings(swapped(points, side), side, info))
    values = points.reference if side == "reference" else points.target
    low, high = values.min(axis=0), values.max(axis=0)
    given = f" ({name_of(points.crs)} by its first line)" if points.crs is not None else ""
    raise InputError(
        f"{path}: most of the {side} positions, x {low[0]:.10g} to {high[0]:.10g} and y {low[1]:.10g} to "
        f"{high[1]:.10g}{given}, lie outside of {info.uri}: "
        + (
            "its columns x and y look exchanged: exchange them"
            if exchanged
            else "the file is of other rasters, in another CRS, or its columns are exchanged"
        )
    )


def _readings(points: PointFile, side: Literal["reference", "target"], info: RasterInfo) -> list[Float64]:
    """Return the possible (n, 2) px of one side of the points, the most likely interpretation first."""
    if side == "reference":
        if points.reference_in == "px":
            return [points.reference]
        return [_from_map(points, info)]
    if points.target_in == "px":
        return [points.target]
    # QGIS: layer coordinates of a georeferenced source, (col, -row) of any other, and of either by
    # programs that do not distinguish them.
    # A source with an RPC has no layer coordinates.
    plane = points.target * [1.0, -1.0]
    on_map = info.georeferenced and not isinstance(info.grid, RpcGrid)
    return [info.grid.to_px(points.target), plane] if on_map else [plane]


def _from_map(points: PointFile, info: RasterInfo) -> Float64:
    if not info.georeferenced:
        if points.crs is not None:
            raise InputError(
                f"the tie points are in {name_of(points.crs)}, and {info.uri} has no georeferencing: give "
                "the raster they were taken on, or georeference it"
            )
        return points.reference * [1.0, -1.0]
    return info.grid.to_px(transform_xy(points.reference, points.crs or info.grid.crs, info.grid.crs))


def _inside(px: Float64, info: RasterInfo) -> bool:
    size = np.array(info.grid.shape[::-1], dtype=np.float64)
    inside = ((px >= -MARGIN * size) & (px <= (1 + MARGIN) * size)).all(axis=1)
    return bool(inside.mean() >= 0.5)


def _check_against_itself(
    path: Path | str, points: PointFile, reference_px: Float64, target_px: Float64, pair: ViewPair
) -> None:
    """Raise if redundant columns contradict each other for this pair."""
    with np.errstate(over="ignore", invalid="ignore"):  # 1e308 contradicts like any other number
        if points.xy is not None:
            grid = pair.reference.info.grid
            difference = points.xy - ground_xy(reference_px, pair)
            in_px = np.asarray(grid.to_px(points.xy) - reference_px) if grid.located else difference
            _check_same(path, in_px, "x, y and ref_col, ref_row", pair.reference.info)
        if points.displacement_px is not None:
            difference = target_px - points.displacement_px - predict_target_px(reference_px, pair)
            _check_same(path, difference, "d_col, d_row and tgt_col, tgt_row", pair.target.info)


def _check_same(path: Path | str, difference_px: Float64, columns: str, info: RasterInfo) -> None:
    size_px = np.linalg.norm(difference_px, axis=1)
    size_px = size_px[np.isfinite(size_px)]
    if len(size_px) and np.median(size_px) > OTHER_PX:
        raise InputError(
            f"{path}: its columns {columns} differ by {np.median(size_px):.1f} px on {info.uri}: columns "
            "are exchanged, or the file is of another raster or CRS; give the pair it was made from, or "
            "leave out the columns that do not hold"
        )
