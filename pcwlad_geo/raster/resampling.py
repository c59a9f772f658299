"""Averages and samples of pixels on other grids."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import csr_array

from pcwlad_geo.correction.dense import positions
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class NodeParameters:
    """The nodes between which positions are interpolated."""

    step_px: int = 16
    """Distance of the nodes."""
    max_error_px: float = 0.01
    """Error between nodes from which every position is mapped."""


NODES: Final = NodeParameters()
"""Those in use."""


def box_average(
    values: Float64, valid: Bool, row_edges: Float64, col_edges: Float64
) -> tuple[Float64, Float64]:
    """Average the valid pixels below each cell of a grid with the same axes, by area.

    The (rows, cols) `values` are finite everywhere, and `valid` is a (rows, cols) bool array. The (m + 1,)
    `row_edges` and (n + 1,) `col_edges` of the cells are corner-based rows and columns in px, increasing or
    decreasing. Return the (m, n) averages, 0 where nothing is valid, and the (m, n) valid share of each
    cell's area, 0 to 1.
    """
    row_weights = _overlaps(row_edges, values.shape[0])
    col_weights = _overlaps(col_edges, values.shape[1])

    def total(data: Float64) -> Float64:
        return np.asarray((col_weights @ (row_weights @ data).T).T)

    whole = bool(valid.all())  # the usual case, at half the cost
    fraction = (
        np.outer(row_weights.sum(axis=1), col_weights.sum(axis=1))
        if whole
        else total(valid.astype(np.float64))
    )
    return _divided(total(values if whole else np.where(valid, values, 0.0)), fraction), fraction


def block_mean(values: Float64, valid: Bool, factor: int) -> tuple[Float64, Float64]:
    """Average the valid pixels of blocks of `factor` x `factor` pixels: the (m, n) means and valid shares.

    The (rows, cols) `values` and their mask, the (rows, cols) `valid`, have whole blocks. A mean is 0 where
    nothing is valid.
    """
    if factor == 1:
        return np.where(valid, values, 0.0), valid.astype(np.float64)
    rows, cols = values.shape
    blocks = (rows // factor, factor, cols // factor, factor)
    fraction = valid.reshape(blocks).mean(axis=(1, 3))
    total = np.where(valid, values, 0.0).reshape(blocks).mean(axis=(1, 3))
    return _divided(total, fraction), fraction


def spline_samples(values: Float64, fraction: Float64, positions_rc: Float64) -> tuple[Float64, Float64]:
    """Interpolate by cubic B-spline, after filling invalid pixels from the nearest valid one.

    The (rows, cols) `values` have a valid share, the (rows, cols) `fraction`. Both are returned as (m, n)
    arrays at the (2, m, n) corner-based rows and columns `positions_rc`, px, the share interpolated linearly
    and 0 outside; NaN counts as far outside.
    """
    from scipy.ndimage import distance_transform_edt, map_coordinates  # slow to load, and seldom needed

    has_data = fraction > 0
    if not has_data.any():
        nothing = np.zeros(positions_rc.shape[1:])
        return nothing, nothing
    if not has_data.all():
        nearest = distance_transform_edt(~has_data, return_distances=False, return_indices=True)
        values = values[tuple(nearest)]
    indices = np.where(np.isfinite(positions_rc), positions_rc - 0.5, -1e6)
    samples = map_coordinates(values, indices, order=3, mode="nearest")
    return samples, map_coordinates(fraction, indices, order=1, mode="grid-constant", cval=0.0)


def sample_positions(window: Window, per_px: int, mapping: Callable[[Float64], Float64]) -> Float64:
    """Map the centres of the per_px x per_px cells of every pixel of a window.

    The mapping, of (n, 2) pixel coordinates (col, row) to (n, 2) others, NaN where undefined, is evaluated on
    nodes 16 px apart, whose positions do not depend on the window, and interpolated by a cubic spline: the
    curvature of map projections over 16 px is far below 0.001 px. Where that is not so (towards a limb, and
    at the cut of a map around the earth) every position is mapped. The result, (2, rows * per_px, cols *
    per_px), holds mapped rows and columns, px, corner-based.
    """
    rows = _cell_centres(window.row, window.rows, per_px)
    cols = _cell_centres(window.col, window.cols, per_px)
    row_nodes, col_nodes = _nodes(rows), _nodes(cols)
    at_nodes = _on_grid(mapping, row_nodes, col_nodes)
    if not np.isfinite(at_nodes).all():  # at the edge of where the projection is defined
        return _on_grid(mapping, rows, cols)
    from scipy.interpolate import RectBivariateSpline  # slow to load, and most pairs share a CRS

    splines = [RectBivariateSpline(row_nodes, col_nodes, part, s=0) for part in at_nodes]
    between = row_nodes[:-1] + NODES.step_px / 2, col_nodes[:-1] + NODES.step_px / 2
    off_px = np.abs([spline(*between) for spline in splines] - _on_grid(mapping, *between))
    if not off_px.max() <= NODES.max_error_px:
        return _on_grid(mapping, rows, cols)
    return np.stack([spline(rows, cols) for spline in splines])


def cell_means(samples: Float64, per_px: int) -> Float64:
    """Return the (rows, cols) means of the `per_px` x `per_px` samples of each pixel.

    The array `samples` has the shape (rows * per_px, cols * per_px); the unit is kept.
    """
    if per_px == 1:
        return samples
    rows, cols = samples.shape
    return np.asarray(samples.reshape(rows // per_px, per_px, cols // per_px, per_px).mean(axis=(1, 3)))


def _overlaps(edges: Float64, size: int) -> csr_array:
    """Return the sparse (cells, size) shares of each cell's length that lie on each of `size` pixels."""
    low = np.minimum(edges[:-1], edges[1:])
    high = np.maximum(edges[:-1], edges[1:])
    taps = int(np.ceil((high - low).max())) + 1
    pixel = np.floor(low).astype(np.int64)[:, None] + np.arange(taps)
    length = np.minimum(high[:, None], pixel + 1.0) - np.maximum(low[:, None], pixel)
    share = np.maximum(length, 0.0) / (high - low)[:, None]
    cell = np.broadcast_to(np.arange(len(low))[:, None], pixel.shape)
    inside = (share > 0) & (pixel >= 0) & (pixel < size)
    return csr_array((share[inside], (cell[inside], pixel[inside])), shape=(len(low), size))


def _divided(total: Float64, fraction: Float64) -> Float64:
    return np.divide(total, fraction, out=np.zeros_like(total), where=fraction > 1e-9)


def _cell_centres(first: int, count: int, per_px: int) -> Float64:
    return first + (np.arange(count * per_px) + 0.5) / per_px


def _nodes(positions: Float64) -> Float64:
    first = np.floor(positions[0] / NODES.step_px) - 1
    last = np.ceil(positions[-1] / NODES.step_px) + 1
    return np.arange(first, last + 1) * NODES.step_px


def _on_grid(mapping: Callable[[Float64], Float64], rows: Float64, cols: Float64) -> Float64:
    mapped = mapping(positions(cols, rows))
    return mapped[:, ::-1].T.reshape(2, len(rows), len(cols))
