"""Residuals against column, row and height: what a model leaves that depends on the place shows here."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.report.figures.canvas import COL_COLOUR, ROW_COLOUR, few_ticks, new_figure, to_png

BINS = 12
LEAST_IN_BIN = 5
MOST_POINTS = 1500

Array = NDArray[np.float64]


def trend_figure(
    table: TiePointTable, target_shape: tuple[int, int], heights_m: Array | None = None
) -> bytes:
    """Draw the residuals in column and in row against the place, with the mean of each stretch.

    Parameters
    ----------
    table : TiePointTable
        Fit and check points, with residuals.
    target_shape : (rows, cols)
    heights_m : (n,) array, optional
        Of the ground at the points, where an elevation model tells them; NaN where it does not.

    Returns
    -------
    bytes
        A PNG.
    """
    rows, cols = target_shape
    against = [("target column, px", table.target_px[:, 0], (0.0, float(cols)))]
    against += [("target row, px", table.target_px[:, 1], (0.0, float(rows)))]
    if heights_m is not None and np.isfinite(heights_m).any():
        low, high = float(np.nanmin(heights_m)), float(np.nanmax(heights_m))
        against += [("height, m", heights_m, (low, max(high, low + 1.0)))]
    figure = new_figure(3.6)
    grid = figure.subplots(2, len(against), sharex="col", sharey=True)
    figure.subplots_adjust(left=0.09, right=0.99, bottom=0.13, top=0.98, wspace=0.12, hspace=0.08)
    limit = float(np.percentile(np.abs(table.residual_px), 99)) * 1.1 or 1.0
    for across, (name, places, span) in enumerate(against):
        for down, colour in enumerate((COL_COLOUR, ROW_COLOUR)):
            axes = grid[down, across]
            _draw(axes, places, table.residual_px[:, down], span, colour)
            axes.set(xlim=span, ylim=(-limit, limit))
            few_ticks(axes)
        grid[1, across].set_xlabel(name, fontsize=9)
    for down, name in enumerate(("in column, px", "in row, px")):
        grid[down, 0].set_ylabel(name, fontsize=9)
    return to_png(figure)


def _draw(axes: Axes, places: Array, values: Array, span: tuple[float, float], colour: str) -> None:
    every = max(1, -(-len(places) // MOST_POINTS))
    axes.plot(places[::every], values[::every], ".", color=colour, ms=2.5, alpha=0.45)
    axes.axhline(0, color="0.4", lw=0.8)
    middles, means, errors = stretch_means(places, values, span)
    axes.errorbar(middles, means, 2 * errors, fmt="-", marker="s", color="black", ms=3, lw=1, capsize=2)


def stretch_means(places: Array, values: Array, span: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Return middles, means and standard errors of the stretches of a span that hold enough values."""
    low, high = span
    known = np.isfinite(places) & np.isfinite(values)
    places, values = places[known], values[known]
    stretch = np.clip(((places - low) * BINS / (high - low)).astype(int), 0, BINS - 1)
    count = np.bincount(stretch, minlength=BINS)
    enough = count >= LEAST_IN_BIN
    safe = np.maximum(count, 1)
    mean = np.bincount(stretch, values, BINS) / safe
    variance = np.bincount(stretch, (values - mean[stretch]) ** 2, BINS) / np.maximum(count - 1, 1)
    middles = low + (np.arange(BINS) + 0.5) * (high - low) / BINS
    return middles[enough], mean[enough], np.sqrt(variance / safe)[enough]
