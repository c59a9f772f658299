"""The table of tie points in pixels of the two files and on the ground, and its computation."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.raster import Grid, RasterInfo, RpcGrid, ViewPair, at_mean_height, jacobian, map_px
from pcwlad_geo.raster.grid import metres_between
from pcwlad_geo.text import html_table
from pcwlad_geo.types import Bool, Float64, Index

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from typing_extensions import Self

Table = TypeVar("Table", bound="TiePointTable")


@dataclass(frozen=True, slots=True, eq=False)
class TiePointTable:
    """The content of `tiepoints.csv`: one row per tie point.

    Pixel coordinates are GDAL's (col, row), corner-based, of the ORIGINAL files.
    """

    reference_px: Float64
    """(n, 2) position in the reference file, reference px."""
    target_px: Float64
    """(n, 2) observed position in the target file, target px."""
    predicted_px: Float64
    """(n, 2) target position predicted by the original georeferencing for the reference point, target px."""
    xy: Float64
    """(n, 2) map coordinates (x, y) of the reference point in the reference CRS; (col, -row) without one."""
    displacement_m: Float64
    """(n, 2) displacement in metres along the reference CRS axes, y north; NaN without a CRS."""
    covariance_px2: Float64
    """(n, 2, 2) covariance of target_px, target px²."""
    score: Float64
    """(n,) match quality, 0 to 1."""
    residual_px: Float64
    """(n, 2) observed minus model, target px; NaN before a fit."""
    status: NDArray[np.str_]
    """(n,) fit, check, unused (too near to a check point, or of another depth), rejected; from `match`:
    matched, rejected."""
    crs: CRS | None
    """Reference CRS."""

    def __len__(self) -> int:
        return len(self.score)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.summary()}>"

    def _repr_html_(self) -> str:
        facts = {status: str(count) for status, count in self._statuses().items()}
        return html_table(type(self).__name__, {"tie points": str(len(self)), **facts})

    def to_records(self) -> NDArray[np.void]:
        """Return the rows as an (n,) structured array with the columns of `tiepoints.csv`.

        ``id`` counts from 1, ``status`` is text, the others are float64: pixels (col, row), corner-based,
        ``x`` and ``y`` map coordinates, ``d_x_m`` and ``d_y_m`` metres; NaN where not known.
        """
        columns = columns_of(self)
        kinds = [(name, values.dtype) for name, values in columns.items()]
        records = np.empty(len(self), dtype=kinds)
        for name, values in columns.items():
            records[name] = values
        return records

    def to_geodataframe(self) -> GeoDataFrame:
        """Return the rows as a GeoDataFrame of points at the map coordinates of the reference.

        The columns are those of `to_records`. Without a CRS the points lie in the pixel plane, y = -row, and
        the frame has none; a row without a place has no geometry.

        Raises
        ------
        InputError
            If GeoPandas is not installed.
        """
        try:
            import geopandas  # an optional dependency
        except ImportError as error:
            raise InputError(
                f"to_geodataframe needs GeoPandas: pip install 'pcwlad-geo[geopandas]' ({error})"
            ) from error
        has_place = np.isfinite(self.xy).all(axis=1)
        points = np.full(len(self), None, dtype=object)
        points[has_place] = shapely.points(self.xy[has_place])
        crs = None if self.crs is None else self.crs.to_wkt()
        return geopandas.GeoDataFrame(columns_of(self), geometry=points, crs=crs)

    def summary(self) -> str:
        """Return how many points of which status there are, on one line."""
        parts = ", ".join(f"{count} {status}" for status, count in self._statuses().items())
        return f"{len(self)} tie points" + (f" ({parts})" if parts else "")

    def _statuses(self) -> dict[str, int]:
        return {
            str(status): int(np.count_nonzero(self.status == status)) for status in np.unique(self.status)
        }

    @property
    def displacement_px(self) -> Float64:
        """(n, 2) observed minus predicted target position, target px."""
        return self.target_px - self.predicted_px

    @property
    def sigma_px(self) -> Float64:
        """(n, 2) standard deviation of target_px (col, row), target px."""
        return np.sqrt(np.diagonal(self.covariance_px2, axis1=1, axis2=2))

    @property
    def correlation(self) -> Float64:
        """(n,) correlation of the errors of target_px (col, row); 0 where one of them has none."""
        product = self.sigma_px.prod(axis=1)
        none = np.where(np.isnan(product), np.nan, 0.0)
        return np.asarray(np.divide(self.covariance_px2[:, 0, 1], product, out=none, where=product > 0))

    @property
    def placed(self) -> Self:
        """The rows with positions in both files and on the map, usable as ground control points."""
        places = np.column_stack([self.reference_px, self.target_px, self.xy])
        return self[np.asarray(np.isfinite(places).all(axis=1))]

    def select(self, *statuses: str) -> Self:
        """Return the rows whose status is one of `statuses`."""
        return self[np.isin(self.status, statuses)]

    def __getitem__(self, index: Bool | Index | slice) -> Self:
        values = {field.name: getattr(self, field.name) for field in fields(TiePointTable)}
        return replace(self, **{name: value[index] for name, value in values.items() if name != "crs"})


POINT_COLUMNS: Final = (
    *("id", "ref_col", "ref_row", "tgt_col", "tgt_row", "x", "y", "d_col", "d_row", "d_x_m", "d_y_m"),
    *("sigma_col", "sigma_row", "correlation", "score", "residual_col", "residual_row", "status"),
)
"""Of `tiepoints.csv`, in order."""
ENVI_ORIGIN_PX: Final = 1.0
"""ENVI counts from (1, 1) at the top-left corner of the first pixel, GDAL from (0, 0)."""


def columns_of(table: TiePointTable) -> dict[str, NDArray[np.generic]]:
    """Return the columns of the CSV, in order, each (n,): id from 1, status a string, the rest float64."""
    pairs = {
        ("ref_col", "ref_row"): table.reference_px,
        ("tgt_col", "tgt_row"): table.target_px,
        ("x", "y"): table.xy,
        ("d_col", "d_row"): table.displacement_px,
        ("d_x_m", "d_y_m"): table.displacement_m,
        ("sigma_col", "sigma_row"): table.sigma_px,
        ("residual_col", "residual_row"): table.residual_px,
    }
    columns: dict[str, NDArray[np.generic]] = {
        "id": np.arange(1, len(table) + 1),
        "correlation": table.correlation,
        "score": table.score,
        "status": table.status,
    }
    for names, values in pairs.items():
        columns |= {name: values[:, axis] for axis, name in enumerate(names)}
    return {name: columns[name] for name in POINT_COLUMNS}


def joined(table: Table, more: TiePointTable) -> Table:
    """Return the rows of one table and then those of another of the same pair."""
    names = [field.name for field in fields(TiePointTable) if field.name != "crs"]
    values = {name: np.concatenate([getattr(table, name), getattr(more, name)]) for name in names}
    return replace(table, **values)


def locate(
    points: TiePoints, pair: ViewPair, originals: tuple[RasterInfo, RasterInfo] | None = None
) -> TiePointTable:
    """Express tie points, in px of both views of a pair, in the original files and on the ground.

    The `originals` are reference and target with their own georeferencing, if the matching started from a
    better one. The status is ``matched``, residuals are NaN, and the covariance is in pixels of the target
    file.
    """
    target_view = pair.target
    reference_px = pair.reference.to_file_px(points.reference_xy_px)
    target_px = target_view.to_file_px(points.target_xy_px)
    scale = jacobian(points.target_xy_px, target_view.grid, at_mean_height(target_view.info.grid))
    if originals is not None:
        infos = zip((pair.reference, target_view), originals, strict=True)
        reference, target = (replace(view, info=info) for view, info in infos)
        pair = replace(pair, reference=reference, target=target)
    covariance_px2 = scale @ points.covariance_px2 @ scale.transpose(0, 2, 1)
    return place(reference_px, target_px, covariance_px2, points.score, pair)


def place(
    reference_px: Float64, target_px: Float64, covariance_px2: Float64, score: Float64, pair: ViewPair
) -> TiePointTable:
    """Build the table of tie points from (n, 2) positions in the two original files, px (col, row).

    They are `reference_px`, (n, 2), and `target_px`, (n, 2), with the (n, 2, 2) covariance `covariance_px2`
    of the latter and the (n,) `score`, match quality from 0 to 1. The status is ``matched``, residuals are
    NaN.
    """
    predicted_px = _in_turn(predict_target_px(reference_px, pair), target_px, pair.target.info.grid)
    count = len(score)
    return TiePointTable(
        reference_px=reference_px,
        target_px=target_px,
        predicted_px=predicted_px,
        xy=ground_xy(reference_px, pair),
        displacement_m=_displacement_m(predicted_px, target_px, pair),
        covariance_px2=covariance_px2,
        score=score,
        residual_px=np.full((count, 2), np.nan),
        status=np.full(count, "matched", dtype="<U8"),
        crs=pair.reference.info.grid.crs,
    )


def _in_turn(predicted_px: Float64, target_px: Float64, grid: Grid | RpcGrid) -> Float64:
    """Return (n, 2) predicted px, whole turns around the earth added, nearest the (n, 2) `target_px`."""
    turn_px = grid.turn_px if isinstance(grid, Grid) else None
    if turn_px is None:
        return predicted_px
    turns = np.rint((target_px - predicted_px) @ turn_px / (turn_px @ turn_px))
    return np.asarray(predicted_px + np.where(np.isfinite(turns), turns, 0.0)[:, None] * turn_px)


def predict_target_px(reference_px: Float64, pair: ViewPair) -> Float64:
    """Return the (n, 2) target px (col, row) that the georeferencing of `pair` predicts.

    The array `reference_px` (n, 2) holds px (col, row) of the reference file.
    """
    return predict_px(reference_px, pair.reference.info, pair.target.info)


def predict_px(reference_px: Float64, reference: RasterInfo, target: RasterInfo) -> Float64:
    """Map the (n, 2) `reference_px` (col, row) to the (n, 2) pixels of the same ground in the target.

    They are themselves if either file is not georeferenced, and NaN where the transformation between the CRSs
    is not defined.
    """
    if not (reference.georeferenced and target.georeferenced):
        return np.asarray(reference_px, dtype=np.float64)
    return map_px(reference_px, reference.grid, target.grid)


def overlap_middle_px(pair: ViewPair, target: RasterInfo) -> Float64:
    """Return the (2,) px (col, row) of `target` in the middle of the overlap of `pair`.

    It is the middle of the target where that point has no position in it.
    """
    box = pair.overlap
    middle_px = np.array([[box.col + box.cols / 2, box.row + box.rows / 2]])
    found_px = predict_target_px(pair.reference.to_file_px(middle_px), pair)[0]
    return np.asarray(found_px if np.isfinite(found_px).all() else target.grid.middle_px[0])


def ground_xy(reference_px: Float64, pair: ViewPair) -> Float64:
    """Map (n, 2) `reference_px` (col, row) to (n, 2) map coordinates (x, y) of the reference of `pair`.

    Without a CRS or a shared plane these are (col, -row).
    """
    grid = pair.reference.info.grid
    return grid.to_xy(reference_px) if grid.located else reference_px * [1.0, -1.0]


def _displacement_m(predicted_px: Float64, target_px: Float64, pair: ViewPair) -> Float64:
    crs = pair.reference.info.grid.crs
    if crs is None:
        return np.full(target_px.shape, np.nan)
    # the predicted pixels of a target without georeferencing are the reference's
    grid = pair.target.info.grid if pair.georeferenced else pair.reference.info.grid
    return metres_between(grid, predicted_px, target_px, crs)
