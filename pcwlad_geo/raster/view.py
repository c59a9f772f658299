"""One band seen on a grid: read by windows, resampled at most once from the original, with validity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import UNREAD_PARTS
from pcwlad_geo.raster.gdal import GDAL_ERRORS
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.masks import valid_in_file, valid_in_mask_file
from pcwlad_geo.raster.resample import block_mean, box_average, cell_means, sample_positions, spline_samples
from pcwlad_geo.raster.rpc_grid import RpcGrid, levelled, positions_on
from pcwlad_geo.raster.source import RasterInfo, open_raster
from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]
Resampling = Literal["none", "nearest", "average", "cubic"]

LEAST_VALID_AVERAGE = 0.5
"""An averaged pixel is valid where at least this share of its area is."""
LEAST_VALID_CUBIC = 0.9
"""An interpolated pixel is valid where at least this share of the pixels around it is."""

_MOST_PX_AT_ONCE = 1 << 23  # of the file or of samples: 64 MB as float64
_LEAST_PART_PX = 32  # smaller parts of what cannot be read are not tried
_SPLINE_REACH_PX = 16  # the prefilter's impulse response falls to 1e-9 within this distance


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A window of a view."""

    values: NDArray[np.float32] | Array
    """(rows, cols): float32 where that holds the band's values exactly, else float64; 0 where not valid."""
    valid: NDArray[np.bool_]
    """(rows, cols): False on nodata, NaN, masked pixels, and outside the raster."""


@dataclass(frozen=True, slots=True)
class View:
    """One band seen on a grid, which may be the file's own; picklable, holds no open file.

    A pixel is valid where the file's nodata value, masks and alpha band and the user's mask file all say
    so and its value is finite; an averaged one where half of its area is valid (the mean is that of
    the valid part), an interpolated one where 90 % of the pixels around it are.
    """

    info: RasterInfo
    grid: Grid
    """The grid of the view's pixels; in the file's own coordinates where nothing is georeferenced."""
    resampling: Resampling
    """none: own pixels; nearest: own pixels, axes flipped; average: coarser, same axes; cubic: any other."""

    def read(self, window: Window) -> Patch:
        """Read a window of the view; it may stick out of the raster.

        Raises
        ------
        InputError
            If the file cannot be read there (truncated, corrupt).
        """
        return _patch(self.info.dtype, *_read(self, window, None))

    def read_decimated(self, max_side_px: int) -> tuple[Patch, tuple[float, float]]:
        """Look at the whole view, averaged to at most so many pixels a side, from overviews if there are any.

        Parts of the file that cannot be read are not valid.

        Returns
        -------
        patch : Patch
        factor_xy : tuple of float
            View pixels per pixel of the patch (columns, rows): view px = patch px · factor.

        Raises
        ------
        InputError
            If nothing of the file can be read (truncated, corrupt).
        """
        rows, cols = self.grid.shape
        factor = max(1.0, max(rows, cols) / max_side_px)
        shape = (max(1, round(rows / factor)), max(1, round(cols / factor)))
        coarse, overview = self, None
        if shape != self.grid.shape:
            resampling: Resampling = "cubic" if self.resampling == "cubic" else "average"
            coarse = View(self.info, self.grid.scaled(shape), resampling)
            overview = _overview_for(self.info, file_px_per_px(coarse).min())
        try:
            values, valid = _read(coarse, Window.whole(shape), overview)
        except InputError:
            values, valid = _read_what_can_be(coarse, Window.whole(shape), overview, _Tries())
            if not valid.any():
                raise
        return _patch(self.info.dtype, values, valid), (cols / shape[1], rows / shape[0])

    def to_file_px(self, view_px: Array) -> Array:
        """Map (n, 2) view px (col, row) to those of the original file; NaN where impossible."""
        return map_px(view_px, self.grid, self.info.grid)

    def from_file_px(self, file_px: Array) -> Array:
        """Map (n, 2) px (col, row) of the original file to those of the view; NaN where impossible."""
        return map_px(file_px, self.info.grid, self.grid)


def _read(view: View, window: Window, overview: int | None) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
    """Read a window, in parts where the file's pixels below it would not fit into memory."""
    if view.resampling in ("none", "nearest"):
        return _read_own(view, window)
    source = _at_overview(view, overview)
    step = file_px_per_px(source)
    if window.rows * window.cols * np.prod(step + 1) > _MOST_PX_AT_ONCE and max(window.shape) > 1:
        return _joined([_read(view, half, overview) for half in window.halves()], window)
    if view.resampling == "average":
        return _read_averaged(source, window, overview)
    return _read_interpolated(source, window, overview, step)


@dataclass(slots=True)
class _Tries:
    """Counts the parts of a file that could not be read."""

    failed: int = 0


def _read_what_can_be(
    view: View, window: Window, overview: int | None, tries: _Tries
) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
    """Read a window by ever smaller parts; the smallest that cannot be read are not valid."""
    try:
        return _read(view, window, overview)
    except InputError:
        tries.failed += 1
        if tries.failed > UNREAD_PARTS:  # each is opened anew: all of a large file would take hours
            raise
        if max(window.shape) <= _LEAST_PART_PX:
            return np.zeros(window.shape, view.info.dtype), np.zeros(window.shape, bool)
    return _joined([_read_what_can_be(view, half, overview, tries) for half in window.halves()], window)


def _joined(
    halves: list[tuple[NDArray[np.generic], NDArray[np.bool_]]], window: Window
) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
    axis = 0 if window.rows >= window.cols else 1
    return (
        np.concatenate([values for values, _ in halves], axis),
        np.concatenate([valid for _, valid in halves], axis),
    )


def _read_own(view: View, window: Window) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
    """Read own pixels, in the order of the view's axes."""
    corners = np.array([[window.col, window.row], [window.col_stop, window.row_stop]], dtype=np.float64)
    first, last = np.rint(view.to_file_px(corners)).astype(int)
    (col, row), (col_stop, row_stop) = np.minimum(first, last).tolist(), np.maximum(first, last).tolist()
    values, valid = _read_file(view.info, Window.from_bounds(row, col, row_stop, col_stop), None)
    order = tuple(slice(None, None, -1 if falls else 1) for falls in (last < first)[::-1].tolist())
    return values[order], valid[order]


def _read_averaged(source: View, window: Window, overview: int | None) -> tuple[Array, NDArray[np.bool_]]:
    """Average the file's pixels by area, on a grid with the same axes."""
    steps = np.arange(max(window.shape) + 1)
    cells = np.column_stack([window.col + steps, window.row + steps]).astype(np.float64)
    edges = source.to_file_px(cells)
    col_edges, row_edges = edges[: window.cols + 1, 0], edges[: window.rows + 1, 1]
    inside = Window.from_bounds(
        int(np.floor(row_edges.min())),
        int(np.floor(col_edges.min())),
        int(np.ceil(row_edges.max())),
        int(np.ceil(col_edges.max())),
    ).clipped(source.info.grid.shape)
    if inside.empty:
        return np.zeros(window.shape), np.zeros(window.shape, dtype=bool)
    values, valid = _read_file(source.info, inside, overview)
    average, fraction = box_average(
        values.astype(np.float64), valid, row_edges - inside.row, col_edges - inside.col
    )
    return average, fraction >= LEAST_VALID_AVERAGE - 1e-9


def _read_interpolated(
    source: View, window: Window, overview: int | None, step: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Sample the file by spline; where it is finer, average block means below and several samples a pixel."""
    factor = max(1, int(step.min() // 2))
    per_px = max(1, int(np.ceil(step.max() / factor - 0.25)))
    positions = _positions(source, window, per_px)
    needed = _around(positions, factor, source.info.grid.shape)
    if needed.empty:
        return np.zeros(window.shape), np.zeros(window.shape, dtype=bool)
    values, valid = _read_file(source.info, needed, overview)
    means, fraction = block_mean(values.astype(np.float64), valid, factor)
    origin_rc = np.array([needed.row, needed.col])[:, None, None]
    samples, shares = spline_samples(means, fraction, (positions - origin_rc) / factor)
    return cell_means(samples, per_px), cell_means(shares, per_px) >= LEAST_VALID_CUBIC


def _positions(source: View, window: Window, per_px: int) -> Array:
    """Return where the samples of a window lie in the file: (2, rows, cols), rows and columns."""
    if isinstance(source.info.grid, RpcGrid):
        return positions_on(source.info.grid, source.grid, window, per_px)
    return sample_positions(window, per_px, source.to_file_px)


def _around(positions_rc: Array, factor: int, shape: tuple[int, int]) -> Window:
    """Return the window of the file that spline samples need, in whole blocks from the file's origin."""
    rows, cols = (part[np.isfinite(part)] for part in positions_rc)
    if rows.size == 0 or cols.size == 0:
        return Window(0, 0, 0, 0)
    bounds = np.array([[rows.min(), cols.min()], [rows.max(), cols.max()]]) / factor
    low = np.maximum(np.floor(bounds[0]) - _SPLINE_REACH_PX, 0).astype(int)
    blocks = -(-np.array(shape) // factor)
    high = np.minimum(np.ceil(bounds[1]) + _SPLINE_REACH_PX, blocks).astype(int)
    row, col, row_stop, col_stop = (np.concatenate([low, high]) * factor).tolist()
    return Window.from_bounds(row, col, row_stop, col_stop)


def _read_file(
    info: RasterInfo, window: Window, overview: int | None
) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
    """Read own pixels in the band's dtype, with their validity; what is outside is not valid."""
    inside = window.clipped(info.grid.shape)
    values = np.zeros(window.shape, dtype=info.dtype)
    valid = np.zeros(window.shape, dtype=bool)
    if inside.empty:
        return values, valid
    file_window = FileWindow(inside.col, inside.row, inside.cols, inside.rows)
    options = {} if overview is None else {"OVERVIEW_LEVEL": overview}
    here = inside.slices_in(window)
    with open_raster(info.uri, **options) as dataset:
        try:
            values[here] = dataset.read(info.band, window=file_window)
            valid[here] = valid_in_file(dataset, info.band, values[here], file_window)
        except GDAL_ERRORS as error:
            raise InputError(
                f"{info.uri}: band {info.band} cannot be read at rows {inside.row} to {inside.row_stop}, "
                f"columns {inside.col} to {inside.col_stop}: the file may be truncated or corrupt"
            ) from error
    valid[here] &= valid_in_mask_file(info, inside)
    values[~valid] = 0
    return values, valid


def _overview_for(info: RasterInfo, step_px: float) -> int | None:
    """Choose the coarsest overview that is at least twice as fine as what is wanted."""
    if info.mask_grid is not None and not (info.georeferenced and info.mask_grid.crs is not None):
        return None  # a mask without a place of its own has the original's pixels
    with open_raster(info.uri) as dataset:
        factors = dataset.overviews(info.band)
    fine_enough = [level for level, factor in enumerate(factors) if factor <= step_px / 2]
    return max(fine_enough, default=None, key=lambda level: factors[level])


def _at_overview(view: View, overview: int | None) -> View:
    """Return the view with the file's grid replaced by that of one of its overviews."""
    if overview is None:
        return view
    with open_raster(view.info.uri, OVERVIEW_LEVEL=overview) as dataset:
        shape = dataset.shape
    return replace(view, info=replace(view.info, grid=view.info.grid.scaled(shape)))


def file_px_per_px(view: View) -> Array:
    """(2,): how far a step of one view pixel along columns and rows goes in the file, file px."""
    rows, cols = view.grid.shape
    matrix = jacobian(np.array([[cols / 2, rows / 2]]), view.grid, levelled(view.info.grid))[0]
    lengths = np.hypot(matrix[0], matrix[1])
    # Outside the projection's domain there is nothing to read: any finite step will do.
    return np.asarray(np.where(np.isfinite(lengths), lengths, 1.0))


def _patch(dtype: str, values: NDArray[np.generic], valid: NDArray[np.bool_]) -> Patch:
    """Return values in the float type that holds a band's values without loss, 0 where not valid."""
    kept = np.where(valid, values, 0)
    if dtype in ("uint8", "int8", "uint16", "int16", "float16", "float32"):
        return Patch(kept.astype(np.float32), valid)
    return Patch(kept.astype(np.float64), valid)
