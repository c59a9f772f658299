"""Pixel windows, and grids: the geotransform and CRS that map pixel to map coordinates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.raster.crs import displacement_m, in_turn, transform_xy, turn_of
from pcwlad_geo.types import Float64

if TYPE_CHECKING:
    from typing_extensions import Self


PixelMapping = Callable[[Float64], Float64]
"""A function of (n, 2) pixels (col, row) to others, such as that of a correction."""


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of whole pixels; it may extend beyond the raster."""

    row: int
    """First row; negative above the raster."""
    col: int
    """First column; negative left of the raster."""
    rows: int
    cols: int

    @property
    def row_stop(self) -> int:
        """The first row below the window."""
        return self.row + self.rows

    @property
    def col_stop(self) -> int:
        """The first column right of the window."""
        return self.col + self.cols

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.rows, self.cols

    @property
    def area_px2(self) -> int:
        """Number of pixels."""
        return self.rows * self.cols

    @property
    def empty(self) -> bool:
        """Whether the window holds no pixel."""
        return self.rows <= 0 or self.cols <= 0

    @staticmethod
    def from_bounds(row: int, col: int, row_stop: int, col_stop: int) -> Window:
        """Return the window from `row` and `col` to, exclusive, `row_stop` and `col_stop`.

        If a stop is before the start, the window is empty.
        """
        return Window(row, col, max(0, row_stop - row), max(0, col_stop - col))

    @staticmethod
    def around(low_xy: Float64, high_xy: Float64) -> Window:
        """Return the window of whole pixels from the (2,) corner `low_xy` (col, row) to `high_xy`."""
        low, high = np.floor(low_xy).astype(int), np.ceil(high_xy).astype(int)
        return Window.from_bounds(int(low[1]), int(low[0]), int(high[1]), int(high[0]))

    @staticmethod
    def whole(shape: tuple[int, int]) -> Window:
        """Return the window of a whole raster of (rows, columns)."""
        return Window(0, 0, *shape)

    @staticmethod
    def spread(shape: tuple[int, int], side_px: int, across: int) -> list[Window]:
        """Return windows spread evenly over a raster, `across` along each axis, fewer where it is small.

        They have `side_px`, or less where a side of the raster has less.
        """
        rows, cols = min(shape[0], side_px), min(shape[1], side_px)
        first_rows, first_cols = (
            np.unique(np.linspace(0, size - side, across).astype(int)).tolist()
            for size, side in zip(shape, (rows, cols), strict=True)
        )
        return [Window(row, col, rows, cols) for row in first_rows for col in first_cols]

    def intersection(self, other: Window) -> Window:
        """Return the intersection of two windows; empty where they do not meet."""
        return Window.from_bounds(
            max(self.row, other.row),
            max(self.col, other.col),
            min(self.row_stop, other.row_stop),
            min(self.col_stop, other.col_stop),
        )

    def clipped(self, shape: tuple[int, int]) -> Window:
        """Return the part inside a raster of (rows, columns)."""
        return self.intersection(Window.whole(shape))

    def padded(self, margin_px: int) -> Window:
        """Return the window grown by a margin on all sides; it may extend beyond the raster."""
        return Window(
            self.row - margin_px, self.col - margin_px, self.rows + 2 * margin_px, self.cols + 2 * margin_px
        )

    def moved(self, rows: int, cols: int) -> Window:
        """Return the window moved down by `rows` and right by `cols` pixels."""
        return Window(self.row + rows, self.col + cols, self.rows, self.cols)

    def slices_in(self, outer: Window) -> tuple[slice, slice]:
        """Return the slices (rows, columns) of this window in an array that holds the outer one."""
        row, col = self.row - outer.row, self.col - outer.col
        return slice(row, row + self.rows), slice(col, col + self.cols)

    def halves(self) -> tuple[Window, Window]:
        """Return two windows that make up this one, cut across its longer side."""
        if self.rows >= self.cols:
            half = self.rows // 2
            return (
                Window(self.row, self.col, half, self.cols),
                Window(self.row + half, self.col, self.rows - half, self.cols),
            )
        half = self.cols // 2
        return (
            Window(self.row, self.col, self.rows, half),
            Window(self.row, self.col + half, self.rows, self.cols - half),
        )


@dataclass(frozen=True, slots=True)
class Grid:
    """The position of the pixels of a raster: shape, geotransform and CRS."""

    shape: tuple[int, int]
    """Rows, columns."""
    transform: Affine
    """Geotransform: (col, row), corner-based, to (x, y). Identity without georeferencing."""
    crs: CRS | None
    """Coordinate reference system of x, y; None also for a plane of unknown units."""
    by_hand: bool = field(default=False, compare=False, kw_only=True)
    """Whether the user placed the pixels so (`placed.by_hand`), whatever the file says."""

    @property
    def located(self) -> bool:
        """Whether the pixels have map coordinates: in a CRS, or in a plane shared with another raster."""
        return self.crs is not None or self.transform != Affine.identity()

    def has_plane_of(self, other: Grid) -> bool:
        """Whether nothing but the geotransforms of this grid and another says where their pixels lie."""
        return type(self) is Grid and type(other) is Grid and self.crs == other.crs

    @property
    def middle_px(self) -> Float64:
        """The middle of the raster as a (1, 2) array (col, row), px."""
        return np.array([[self.shape[1] / 2, self.shape[0] / 2]])

    def lattice_px(self, points_per_side: int) -> Float64:
        """Return (n, 2) pixels (col, row) spread evenly over the raster, `points_per_side` ** 2 of them."""
        rows, cols = self.shape
        return positions(np.linspace(0, cols, points_per_side), np.linspace(0, rows, points_per_side))

    def to_xy(self, pixel_xy_px: Float64) -> Float64:
        """Map (n, 2) pixel coordinates `pixel_xy_px` (col, row) to (n, 2) map coordinates (x, y)."""
        return apply(self.transform, pixel_xy_px)

    def to_px(self, xy: Float64) -> Float64:
        """Map (n, 2) map coordinates `xy` (x, y) to (n, 2) pixel coordinates (col, row)."""
        return apply_inverse(self.transform, xy)

    @property
    def swath_uri(self) -> str | None:
        """Path or GDAL URI of the raster whose geolocation arrays place the pixels, if any do."""
        return None

    def within_scans(self, at_px: Float64) -> Float64:
        """Return (n, 2) pixels near `at_px` around which the grid is smooth: none at the ends of scans."""
        return at_px

    def observed_px(self, xy: Float64, forward: PixelMapping) -> Float64:
        """Map (n, 2) map coordinates `xy` to (n, 2) pixels that show them: `forward` of the predicted."""
        return forward(self.to_px(xy))

    def corrected_xy(self, at_px: Float64, inverse: PixelMapping) -> Float64:
        """Map (n, 2) pixels `at_px` to the (n, 2) map coordinates they show, by their `inverse`."""
        return self.to_xy(inverse(at_px))

    @property
    def turn(self) -> float:
        """Map units of one turn around the earth, see `turn_of`; infinite where x does not count turns."""
        return turn_of(self.crs)

    @property
    def turn_px(self) -> Float64 | None:
        """Pixels (col, row), (2,), of one turn around the earth; None where x does not count turns."""
        return inverse(linear_part(self.transform)) @ [self.turn, 0.0] if np.isfinite(self.turn) else None

    def in_turn(self, xy: Float64) -> Float64:
        """Return the (n, 2) map coordinates `xy` in the turn around the earth that is nearest the middle."""
        return in_turn(xy, apply(self.transform, self.middle_px)[0, 0], self.turn)

    def in_turn_of(self, other: Grid) -> Self:
        """Return this grid with whole turns around the earth added, nearest another with the same turn."""
        middle = apply(self.transform, self.middle_px)
        x = float((other.in_turn(middle) - middle)[0, 0]) if self.turn == other.turn else 0.0
        a, b, c, d, e, f = tuple(self.transform)[:6]
        return replace(self, transform=Affine(a, b, c + x, d, e, f)) if x else self

    def part(self, origin_px: tuple[float, float], shape: tuple[int, int]) -> Self:
        """Return the grid of the same pixels from `origin_px` (col, row) on, with `shape` (rows, columns)."""
        return self.resampled_grid(((1.0, 0.0), (0.0, 1.0)), origin_px, shape)

    def scaled(self, shape: tuple[int, int]) -> Self:
        """Return the grid of the same extent with another shape (rows, columns)."""
        factors = (self.shape[1] / shape[1], self.shape[0] / shape[0])
        return self.resampled_grid(((factors[0], 0.0), (0.0, factors[1])), (0.0, 0.0), shape)

    def resampled_grid(
        self,
        linear: tuple[tuple[float, float], tuple[float, float]],
        origin_px: tuple[float, float],
        shape: tuple[int, int],
    ) -> Self:
        """Return the grid of `shape` (rows, columns) whose pixel p is `linear` · p + `origin_px` in this one.

        All pixel coordinates are (col, row).
        """
        return replace(self, shape=shape, transform=composed(self.transform, linear, origin_px))

    def boundary_px(self, points_per_side: int = 32) -> Float64:
        """Return (n, 2) points (col, row) around the outer edge of the pixels, px, in order, not closed."""
        rows, cols = self.shape
        corners = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], dtype=np.float64)
        steps = np.linspace(0, 1, points_per_side, endpoint=False)[:, None]
        sides = [a + (b - a) * steps for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        return np.concatenate(sides)


@dataclass(frozen=True, slots=True)
class TiltedGrid(Grid):
    """A grid of a plane seen from the side: what its geotransform gives is put into perspective."""

    about: tuple[float, float]
    """Map coordinates (x, y) that the perspective leaves where they are."""
    tilt: tuple[float, float]
    """Change of the scale along x and y there, a map unit."""

    def to_xy(self, pixel_xy_px: Float64) -> Float64:
        """Map (n, 2) `pixel_xy_px` (col, row) to (n, 2) map coordinates (x, y); NaN beyond the horizon."""
        return self._tilted(apply(self.transform, pixel_xy_px), 1.0)

    def to_px(self, xy: Float64) -> Float64:
        """Map (n, 2) map coordinates `xy` to (n, 2) pixels (col, row); NaN beyond the horizon."""
        return apply_inverse(self.transform, self._tilted(np.asarray(xy, dtype=np.float64), -1.0))

    def _tilted(self, xy: Float64, sign: float) -> Float64:
        away = xy - np.array(self.about)
        w = 1.0 + sign * (away @ np.array(self.tilt))
        return np.asarray(np.array(self.about) + away / np.where(w > 0, w, np.nan)[:, None])


def linear_part(transform: Affine) -> Float64:
    """Return the (2, 2) linear part of a geotransform: map units (x, y) per pixel (col, row)."""
    return np.array([[transform.a, transform.b], [transform.d, transform.e]])


def is_invertible(matrix: Float64) -> bool:
    """Return whether the (2, 2) `matrix` is finite and maps no direction to nothing, whatever its unit."""
    largest = np.abs(matrix).max()
    if not 0.0 < largest < np.inf:
        return False
    return bool(np.linalg.det(matrix / largest) != 0.0)  # squares of huge numbers are infinite


def apply(transform: Affine, points_xy: Float64) -> Float64:
    """Map (n, 2) points `points_xy` by the affine `transform`, usually px to map units, to (n, 2) points."""
    return _algebraic(transform)(points_xy)


def apply_inverse(transform: Affine, points_xy: Float64) -> Float64:
    """Map (n, 2) points `points_xy`, usually map units, by the inverse of `transform` to (n, 2) points."""
    return _algebraic(transform).apply_inverse(points_xy)


def _algebraic(transform: Affine) -> AffineTransform:
    return AffineTransform.from_parts(linear_part(transform), np.array([transform.c, transform.f]))


def composed(
    transform: Affine, linear: tuple[tuple[float, float], tuple[float, float]], origin_px: tuple[float, float]
) -> Affine:
    """Return the transform of pixels p that are pixels `linear` · p + `origin_px` of the given `transform`.

    All pixel coordinates are (col, row).
    """
    a, b, d, e = (linear_part(transform) @ np.array(linear)).ravel().tolist()
    x, y = apply(transform, np.array([origin_px], dtype=np.float64))[0].tolist()
    return Affine(a, b, x, d, e, y)


def map_px(points_px: Float64, from_grid: Grid, to_grid: Grid) -> Float64:
    """Map the (n, 2) `points_px` of one grid to the (n, 2) pixels of the same ground in another.

    They are (col, row), corner-based; NaN where the transformation between the CRSs is not defined, and of
    the turns around the earth in that which is nearest the middle of `to_grid`. Raises `InputError` if no
    transformation exists between the CRSs, or only one grid has a CRS.
    """
    points_px = np.asarray(points_px, dtype=np.float64)
    if from_grid.has_plane_of(to_grid) and from_grid.transform == to_grid.transform:
        return points_px
    xy = transform_xy(from_grid.to_xy(points_px), from_grid.crs, to_grid.crs)
    return to_grid.to_px(to_grid.in_turn(xy))


def metres_between(grid: Grid, from_px: Float64, to_px: Float64, crs: CRS) -> Float64:
    """Return the (n, 2) metres along the axes of a CRS from the (n, 2) px `from_px` to (n, 2) `to_px`."""
    from_xy, to_xy = (transform_xy(grid.to_xy(px), grid.crs, crs) for px in (from_px, to_px))
    return displacement_m(from_xy, to_xy, crs)


def jacobian(points_px: Float64, from_grid: Grid, to_grid: Grid) -> Float64:
    """Return the (n, 2, 2) Jacobian of `map_px` at the (n, 2) `points_px`, by differences over one pixel.

    Element [i, j] is the derivative of coordinate i in `to_grid` by coordinate j in `from_grid`, px per px,
    in the order (col, row); NaN where `map_px` is. Errors are those of `map_px`.
    """
    points_px = np.asarray(points_px, dtype=np.float64)
    steps = np.array([[0.5, 0.0], [0.0, 0.5]])
    sides = [
        map_px(points_px + step, from_grid, to_grid) - map_px(points_px - step, from_grid, to_grid)
        for step in steps
    ]
    slopes, turn_px = np.stack(sides, axis=2), to_grid.turn_px
    if turn_px is not None:  # a step from one end of the earth to the other is short
        turns = np.rint(np.einsum("i,nij->nj", turn_px / (turn_px @ turn_px), slopes))
        slopes -= turn_px[:, None] * turns[:, None, :]
    return slopes


def pixel_size_m(grid: Grid, at_px: tuple[float, float] | Float64) -> tuple[float, float] | None:
    """Measure the ground length of one pixel along the column and the row axis.

    Metres are returned, None without a CRS. The scale of a map varies, so they hold at `at_px`, a (2,)
    position (col, row).
    """
    sizes = pixel_sizes_m(grid, np.asarray(at_px, dtype=np.float64).reshape(1, 2))
    return None if sizes is None else (float(sizes[0, 0]), float(sizes[0, 1]))


def pixel_sizes_m(grid: Grid, at_px: Float64) -> Float64 | None:
    """Return the (n, 2) sizes of the pixels of a grid at the (n, 2) `at_px` (col, row), see `pixel_size_m`.

    They are metres per step of one column and of one row; None without a CRS.
    """
    if grid.crs is None:
        return None
    at_px = np.asarray(at_px, dtype=np.float64)
    sides = []
    for step in np.array([[0.5, 0.0], [0.0, 0.5]]):
        across = displacement_m(grid.to_xy(at_px - step), grid.to_xy(at_px + step), grid.crs)
        sides.append(np.hypot(across[:, 0], across[:, 1]))
    return np.column_stack(sides)


def middle_pixel_size_m(grid: Grid) -> tuple[float, float] | None:
    """Return the pixel size in the middle of a grid, metres (column, row), see `pixel_size_m`."""
    return pixel_size_m(grid, grid.middle_px)
