"""Residuals against column and row: what a model leaves that depends on the place shows here."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.report.figures.canvas import COL_COLOUR, ROW_COLOUR, new_figure, to_png
from pcwlad_geo.report.figures.displacements import thin

BINS = 12
LEAST_IN_BIN = 5
MOST_POINTS = 1500

Array = NDArray[np.float64]


def trend_figure(table: TiePointTable, target_shape: tuple[int, int]) -> bytes:
    """Draw the residuals in column and in row against column and row, with the mean of each stretch.

    Parameters
    ----------
    table : TiePointTable
        With residuals.
    target_shape : (rows, cols)

    Returns
    -------
    bytes
        A PNG.
    """
    points = table.select("fit", "check")
    figure = new_figure(3.6)
    grid = figure.subplots(2, 2, sharex="col", sharey=True)
    figure.subplots_adjust(left=0.09, right=0.99, bottom=0.13, top=0.98, wspace=0.05, hspace=0.08)
    limit = float(np.percentile(np.abs(points.residual_px), 99)) * 1.1 or 1.0
    for across, (place, side) in enumerate((("column", target_shape[1]), ("row", target_shape[0]))):
        for down, (axis, colour) in enumerate((("column", COL_COLOUR), ("row", ROW_COLOUR))):
            axes = grid[down, across]
            _draw(axes, points, (across, down), side, colour)
            axes.set(xlim=(0, side), ylim=(-limit, limit))
            axes.tick_params(labelsize=8)
            if across == 0:
                axes.set_ylabel(f"in {axis}, px", fontsize=9)
        grid[1, across].set_xlabel(f"target {place}, px", fontsize=9)
    return to_png(figure)


def _draw(axes: Axes, points: TiePointTable, which: tuple[int, int], side: int, colour: str) -> None:
    place, axis = which
    shown = thin(points, MOST_POINTS)
    axes.plot(shown.target_px[:, place], shown.residual_px[:, axis], ".", color=colour, ms=2.5, alpha=0.45)
    axes.axhline(0, color="0.4", lw=0.8)
    middles, means, errors = stretch_means(points.target_px[:, place], points.residual_px[:, axis], side)
    axes.errorbar(middles, means, 2 * errors, fmt="-", marker="s", color="black", ms=3, lw=1, capsize=2)


def stretch_means(places: Array, values: Array, side: int) -> tuple[Array, Array, Array]:
    """Return middles, means and standard errors of the stretches of a side that hold enough values."""
    stretch = np.clip((places * BINS / side).astype(int), 0, BINS - 1)
    count = np.bincount(stretch, minlength=BINS)
    enough = count >= LEAST_IN_BIN
    safe = np.maximum(count, 1)
    mean = np.bincount(stretch, values, BINS) / safe
    variance = np.bincount(stretch, (values - mean[stretch]) ** 2, BINS) / np.maximum(count - 1, 1)
    middles = (np.arange(BINS) + 0.5) * side / BINS
    return middles[enough], mean[enough], np.sqrt(variance / safe)[enough]
