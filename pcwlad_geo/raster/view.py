"""One band, or several as one image, on a grid: read by windows, resampled at most once, with validity."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.band_reading import read_window
from pcwlad_geo.raster.grid import Grid, Window, jacobian, map_px
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.resampling import block_mean, box_average, cell_means, sample_positions, spline_samples
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height, positions_on
from pcwlad_geo.raster.source import RasterInfo, bands_of
from pcwlad_geo.types import Bool, Float32, Float64

ViewResampling = Literal["none", "nearest", "average", "cubic"]


@dataclass(frozen=True, slots=True)
class ViewParameters:
    """How a view is read."""

    min_valid_average: float = 0.5
    """Least share of valid area from which an averaged pixel is valid."""
    min_valid_cubic: float = 0.9
    """Least share of valid neighbouring pixels from which an interpolated pixel is valid."""
    max_px_at_once: int = 1 << 23
    """Largest number of pixels, of the file or of samples, at a time: 64 MB as float64."""
    min_part_px: int = 32
    """Largest side of an unreadable part that is not divided further."""
    spline_reach_px: int = 16
    """Distance within which the impulse response of the spline's prefilter falls to 1e-9."""


VIEWS: Final = ViewParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """The pixels of a window of a view."""

    values: Float32 | Float64
    """(rows, cols) values: float32 where that is exact for the band, else float64; 0 where not valid."""
    valid: Bool
    """(rows, cols) validity: False on nodata, NaN and masked pixels, and outside the raster."""


@dataclass(frozen=True, slots=True)
class View:
    """One band on a grid, which may be the file's own; picklable, holds no open file.

    A pixel is valid where its value is finite and the file's nodata value, masks and alpha band, the user's
    mask file and areas, and the raster's collar and fills all allow it. An averaged pixel is valid where half
    of its area is (the mean is that of the valid part), an interpolated one where 90 % of the pixels around
    it are.
    """

    info: RasterInfo
    grid: Grid
    """The grid of the view's pixels; in the file's own coordinates where nothing is georeferenced."""
    resampling: ViewResampling
    """How the pixels are made. none: own pixels; nearest: own pixels with flipped axes; average: a coarser
    grid with the same axes; cubic: any other grid."""

    def read(self, window: Window) -> Patch:
        """Read a window of the view, which may extend beyond the raster.

        Raises `InputError` if the file cannot be read there (truncated, corrupt).
        """
        return _patch(self.info.dtype, *_read(self, window, None))

    def read_decimated(self, max_side_px: int) -> tuple[Patch, tuple[float, float]]:
        """Read the whole view, averaged to at most `max_side_px` pixels a side, from overviews if possible.

        Unreadable parts of the file are not valid. The second result is by how much (columns, rows) px of the
        patch are multiplied for those of the view. Raises `InputError` if nothing of the file can be read
        (truncated, corrupt).
        """
        rows, cols = self.grid.shape
        factor = max(1.0, max(rows, cols) / max_side_px)
        shape = (max(1, round(rows / factor)), max(1, round(cols / factor)))
        coarse, overview = self, None
        if shape != self.grid.shape:
            resampling: ViewResampling = "cubic" if self.resampling == "cubic" else "average"
            coarse = View(self.info, self.grid.scaled(shape), resampling)
            overview = _overview_for(self.info, file_px_per_px(coarse).min())
        try:
            values, valid = _read(coarse, Window.whole(shape), overview)
        except InputError:
            values, valid = _read_what_can_be(coarse, Window.whole(shape), overview, itertools.count(1))
            if not valid.any():
                raise
        return _patch(self.info.dtype, values, valid), (cols / shape[1], rows / shape[0])

    def reduced(self, factor: float) -> Patch:
        """Read the whole view as `read_decimated` does, `factor` of its px along a pixel."""
        return self.read_decimated(max(1, round(max(self.grid.shape) / factor)))[0]

    def to_file_px(self, view_px: Float64) -> Float64:
        """Map (n, 2) pixels `view_px` (col, row) to (n, 2) pixels of the file; NaN where undefined."""
        if self.resampling == "none":  # the way over the ground and back fails where heights are missing
            return view_px
        if self._same_axes:
            return self.info.grid.in_turn_of(self.grid).to_px(self.grid.to_xy(view_px))
        return map_px(view_px, self.grid, self.info.grid)

    def from_file_px(self, file_px: Float64) -> Float64:
        """Map (n, 2) pixels `file_px` (col, row) of the file to (n, 2) view pixels; NaN where undefined."""
        if self.resampling == "none":
            return file_px
        if self._same_axes:
            return self.grid.to_px(self.info.grid.in_turn_of(self.grid).to_xy(file_px))
        return map_px(file_px, self.info.grid, self.grid)

    @property
    def _same_axes(self) -> bool:
        """Whether all of the view lies in one turn around the earth of its file's own longitudes."""
        return self.resampling in ("nearest", "average") and self.grid.turn_px is not None


def _read(view: View, window: Window, overview: int | None) -> tuple[NDArray[np.generic], Bool]:
    """Read a window, in parts where the file's pixels below it would not fit into memory."""
    if view.resampling in ("none", "nearest"):
        return _read_own(view, window)
    source = _at_overview(view, overview)
    step = file_px_per_px(source)
    if window.rows * window.cols * np.prod(step + 1) > VIEWS.max_px_at_once and max(window.shape) > 1:
        return _joined([_read(view, half, overview) for half in window.halves()], window)
    if view.resampling == "average":
        return _read_averaged(source, window, overview)
    return _read_interpolated(source, window, overview, step)


def _read_what_can_be(
    view: View, window: Window, overview: int | None, failures: Iterator[int]
) -> tuple[NDArray[np.generic], Bool]:
    """Read a window by ever smaller parts; the smallest unreadable parts are not valid.

    The `failures` number the parts that cannot be read.
    """
    try:
        return _read(view, window, overview)
    except InputError:
        # each part opens the file again: all of a large one would take hours
        if next(failures) > LIMITS.unread_parts:
            raise
        if max(window.shape) <= VIEWS.min_part_px:
            return np.zeros(window.shape, view.info.dtype), np.zeros(window.shape, bool)
    return _joined([_read_what_can_be(view, half, overview, failures) for half in window.halves()], window)


def _joined(
    halves: list[tuple[NDArray[np.generic], Bool]], window: Window
) -> tuple[NDArray[np.generic], Bool]:
    axis = 0 if window.rows >= window.cols else 1
    return (
        np.concatenate([values for values, _ in halves], axis),
        np.concatenate([valid for _, valid in halves], axis),
    )


def _read_own(view: View, window: Window) -> tuple[NDArray[np.generic], Bool]:
    """Read own pixels, in the order of the view's axes."""
    corners = np.array([[window.col, window.row], [window.col_stop, window.row_stop]], dtype=np.float64)
    first, last = np.rint(view.to_file_px(corners)).astype(int)
    (col, row), (col_stop, row_stop) = np.minimum(first, last).tolist(), np.maximum(first, last).tolist()
    values, valid = read_window(view.info, Window.from_bounds(row, col, row_stop, col_stop), None)
    order = tuple(slice(None, None, -1 if falls else 1) for falls in (last < first)[::-1].tolist())
    return values[order], valid[order]


def _read_averaged(source: View, window: Window, overview: int | None) -> tuple[Float64, Bool]:
    """Average the file's pixels by area, on a grid with the same axes."""
    steps = np.arange(max(window.shape) + 1)
    cells = np.column_stack([window.col + steps, window.row + steps]).astype(np.float64)
    edges = source.to_file_px(cells)
    col_edges, row_edges = edges[: window.cols + 1, 0], edges[: window.rows + 1, 1]
    low, high = ((pick(col_edges), pick(row_edges)) for pick in (np.min, np.max))
    inside = Window.around(np.array(low), np.array(high)).clipped(source.info.grid.shape)
    if inside.empty:
        return np.zeros(window.shape), np.zeros(window.shape, dtype=bool)
    values, valid = read_window(source.info, inside, overview)
    average, fraction = box_average(
        values.astype(np.float64), valid, row_edges - inside.row, col_edges - inside.col
    )
    return average, fraction >= VIEWS.min_valid_average - 1e-9


def _read_interpolated(
    source: View, window: Window, overview: int | None, step: Float64
) -> tuple[Float64, Bool]:
    """Sample the file by spline; where it is finer, use block means and average several samples per pixel."""
    factor = max(1, int(step.min() // 2))
    per_px = max(1, int(np.ceil(step.max() / factor - 0.25)))
    positions = _positions(source, window, per_px)
    needed = _around(positions, factor, source.info.grid.shape)
    if needed.empty:
        return np.zeros(window.shape), np.zeros(window.shape, dtype=bool)
    if needed.area_px2 > 2 * VIEWS.max_px_at_once and max(window.shape) > 1:  # from both ends of the earth
        halves = [_read_interpolated(source, half, overview, step) for half in window.halves()]
        axis = 0 if window.rows >= window.cols else 1
        (first, valid), (second, also) = halves
        return np.concatenate([first, second], axis), np.concatenate([valid, also], axis)
    values, valid = read_window(source.info, needed, overview)
    means, fraction = block_mean(values.astype(np.float64), valid, factor)
    origin_rc = np.array([needed.row, needed.col])[:, None, None]
    samples, shares = spline_samples(means, fraction, (positions - origin_rc) / factor)
    return cell_means(samples, per_px), cell_means(shares, per_px) >= VIEWS.min_valid_cubic


def _positions(source: View, window: Window, per_px: int) -> Float64:
    """Return the (2, rows, cols) positions (row, col) in the file of the samples of a window."""
    if isinstance(source.info.grid, RpcGrid):
        return positions_on(source.info.grid, source.grid, window, per_px)
    return sample_positions(window, per_px, source.to_file_px)


def _around(positions_rc: Float64, factor: int, shape: tuple[int, int]) -> Window:
    """Return the window of the file needed for spline samples, in whole blocks from the file's origin."""
    rows, cols = (part[np.isfinite(part)] for part in positions_rc)
    if rows.size == 0 or cols.size == 0:
        return Window(0, 0, 0, 0)
    bounds = np.array([[rows.min(), cols.min()], [rows.max(), cols.max()]]) / factor
    low = np.maximum(np.floor(bounds[0]) - VIEWS.spline_reach_px, 0).astype(int)
    blocks = -(-np.array(shape) // factor)
    high = np.minimum(np.ceil(bounds[1]) + VIEWS.spline_reach_px, blocks).astype(int)
    row, col, row_stop, col_stop = (np.concatenate([low, high]) * factor).tolist()
    return Window.from_bounds(row, col, row_stop, col_stop)


def _overview_for(info: RasterInfo, step_px: float) -> int | None:
    """Choose the coarsest overview that is at least twice as fine as the requested pixels."""
    if info.mask_grid is not None and not (info.georeferenced and info.mask_grid.crs is not None):
        return None  # a mask without georeferencing has the original's pixels
    overviews = []
    for part in {part.path: part for part in bands_of(info).parts}.values():
        with open_raster(part.path) as dataset:
            overviews.append(dataset.overviews(part.band))
    factors = overviews[0] if all(listed == overviews[0] for listed in overviews) else []
    fine_enough = [level for level, factor in enumerate(factors) if factor <= step_px / 2]
    return max(fine_enough, default=None, key=lambda level: factors[level])


def _at_overview(view: View, overview: int | None) -> View:
    """Return the view with the file's grid replaced by that of one of its overviews."""
    if overview is None:
        return view
    with open_raster(view.info.uri, OVERVIEW_LEVEL=overview) as dataset:
        shape = dataset.shape
    return replace(view, info=replace(view.info, grid=view.info.grid.scaled(shape)))


def file_px_per_px(view: View) -> Float64:
    """Return the (2,) lengths in file px of one view pixel along columns and rows.

    They are those in the middle, or typical ones of the view where the middle is unlike it, as a pole is.
    """
    file_grid = at_mean_height(view.info.grid)
    at_px = np.concatenate([view.grid.middle_px, view.grid.lattice_px(5)])
    lengths = np.linalg.norm(jacobian(at_px, view.grid, file_grid), axis=1)
    finite = np.isfinite(lengths).all(axis=1)
    if not finite.any():  # outside the projection's domain nothing is read
        return np.ones(2)
    typical, middle = np.median(lengths[finite], axis=0), lengths[0]
    is_typical = finite[0] and bool((np.maximum(middle, typical) <= 2 * np.minimum(middle, typical)).all())
    return np.asarray(middle if is_typical else typical)


def _patch(dtype: str, values: NDArray[np.generic], valid: Bool) -> Patch:
    """Return values in the float type that holds a band's values without loss, 0 where not valid."""
    is_single = dtype in ("uint8", "int8", "uint16", "int16", "float16", "float32")
    known: Float32 | Float64 = values.astype(np.float32) if is_single else values.astype(np.float64)
    known[~valid] = 0
    return Patch(known, valid)
