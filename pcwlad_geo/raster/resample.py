"""Resampling of arrays with validity: area averages, block means and spline samples.

Values and valid fractions travel together, so that what is not valid never has a share in what is.
Every result depends on its place in the raster only, not on the window that was asked for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.sparse import csr_array

from pcwlad_geo.raster.windows import Window

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]
_NODE_STEP_PX = 16
_FAR_OUTSIDE_PX = -1e6


def box_average(values: Array, valid: Bool, row_edges: Array, col_edges: Array) -> tuple[Array, Array]:
    """Average the valid pixels below each cell of a grid with the same axes, by area.

    Parameters
    ----------
    values : (rows, cols) array
        Finite everywhere.
    valid : (rows, cols) bool array
    row_edges : (m + 1,) array
        Where the cells begin and end, corner-based rows of the array, rising or falling.
    col_edges : (n + 1,) array

    Returns
    -------
    average : (m, n) array
        0 where nothing is valid.
    fraction : (m, n) array
        The valid share of each cell's area, 0 to 1.
    """
    row_weights = _overlaps(row_edges, values.shape[0])
    col_weights = _overlaps(col_edges, values.shape[1])

    def total(data: Array) -> Array:
        return np.asarray((col_weights @ (row_weights @ data).T).T)

    whole = bool(valid.all())  # the usual case, at half the cost
    fraction = (
        np.outer(row_weights.sum(axis=1), col_weights.sum(axis=1))
        if whole
        else total(valid.astype(np.float64))
    )
    return _divided(total(values if whole else np.where(valid, values, 0.0)), fraction), fraction


def block_mean(values: Array, valid: Bool, factor: int) -> tuple[Array, Array]:
    """Average blocks of factor x factor pixels: means (0 where nothing is valid) and valid fractions.

    The shape of `values` must be a multiple of the factor.
    """
    if factor == 1:
        return np.where(valid, values, 0.0), valid.astype(np.float64)
    rows, cols = values.shape
    blocks = (rows // factor, factor, cols // factor, factor)
    fraction = valid.reshape(blocks).mean(axis=(1, 3))
    total = np.where(valid, values, 0.0).reshape(blocks).mean(axis=(1, 3))
    return _divided(total, fraction), fraction


def spline_samples(values: Array, fraction: Array, positions_rc: Array) -> tuple[Array, Array]:
    """Interpolate by cubic B-spline; what is not valid is filled from the nearest valid pixel first.

    Parameters
    ----------
    values : (rows, cols) array
    fraction : (rows, cols) array
        Valid share of each pixel, 0 to 1.
    positions_rc : (2, m, n) array
        Corner-based rows and columns; NaN counts as far outside.

    Returns
    -------
    samples : (m, n) array
    fraction : (m, n) array
        The valid fraction there, interpolated linearly, 0 outside.
    """
    known = fraction > 0
    if not known.any():
        nothing = np.zeros(positions_rc.shape[1:])
        return nothing, nothing
    if not known.all():
        nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
        values = values[tuple(nearest)]
    indices = np.where(np.isfinite(positions_rc), positions_rc - 0.5, _FAR_OUTSIDE_PX)
    samples = map_coordinates(values, indices, order=3, mode="nearest")
    return samples, map_coordinates(fraction, indices, order=1, mode="grid-constant", cval=0.0)


def sample_positions(window: Window, per_px: int, mapping: Callable[[Array], Array]) -> Array:
    """Map the centres of per_px x per_px cells of every pixel of a window.

    The mapping is evaluated on nodes 16 px apart that do not depend on the window, and interpolated by a
    cubic spline: the curvature of map projections over such a distance is far below a thousandth of a pixel.

    Parameters
    ----------
    window : Window
    per_px : int
    mapping : callable
        (n, 2) pixel coordinates (col, row) to (n, 2) others (col, row), NaN where impossible.

    Returns
    -------
    (2, rows * per_px, cols * per_px) array
        Rows and columns, corner-based.
    """
    rows = _cell_centres(window.row, window.rows, per_px)
    cols = _cell_centres(window.col, window.cols, per_px)
    row_nodes, col_nodes = _nodes(rows), _nodes(cols)
    at_nodes = _on_grid(mapping, row_nodes, col_nodes)
    if not np.isfinite(at_nodes).all():  # at the edge of where the projection is defined
        return _on_grid(mapping, rows, cols)
    from scipy.interpolate import RectBivariateSpline  # slow to load, and most pairs share a CRS

    return np.stack([RectBivariateSpline(row_nodes, col_nodes, part, s=0)(rows, cols) for part in at_nodes])


def cell_means(samples: Array, per_px: int) -> Array:
    """Average the per_px x per_px samples of each pixel."""
    if per_px == 1:
        return samples
    rows, cols = samples.shape
    return np.asarray(samples.reshape(rows // per_px, per_px, cols // per_px, per_px).mean(axis=(1, 3)))


def _overlaps(edges: Array, size: int) -> csr_array:
    """Sparse (cells, size): the share of each cell's length that lies on each of `size` unit pixels."""
    low = np.minimum(edges[:-1], edges[1:])
    high = np.maximum(edges[:-1], edges[1:])
    taps = int(np.ceil((high - low).max())) + 1
    pixel = np.floor(low).astype(np.int64)[:, None] + np.arange(taps)
    length = np.minimum(high[:, None], pixel + 1.0) - np.maximum(low[:, None], pixel)
    share = np.maximum(length, 0.0) / (high - low)[:, None]
    cell = np.broadcast_to(np.arange(len(low))[:, None], pixel.shape)
    kept = (share > 0) & (pixel >= 0) & (pixel < size)
    return csr_array((share[kept], (cell[kept], pixel[kept])), shape=(len(low), size))


def _divided(total: Array, fraction: Array) -> Array:
    return np.divide(total, fraction, out=np.zeros_like(total), where=fraction > 1e-9)


def _cell_centres(first: int, count: int, per_px: int) -> Array:
    return first + (np.arange(count * per_px) + 0.5) / per_px


def _nodes(positions: Array) -> Array:
    first = np.floor(positions[0] / _NODE_STEP_PX) - 1
    last = np.ceil(positions[-1] / _NODE_STEP_PX) + 1
    return np.arange(first, last + 1) * _NODE_STEP_PX


def _on_grid(mapping: Callable[[Array], Array], rows: Array, cols: Array) -> Array:
    col, row = np.meshgrid(cols, rows)
    mapped = mapping(np.column_stack([col.ravel(), row.ravel()]))
    return mapped[:, ::-1].T.reshape(2, len(rows), len(cols))
