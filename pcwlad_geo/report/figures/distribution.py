"""How the residuals are distributed: a histogram per axis, and their ends with the circle of CE90."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.report.figures.canvas import (
    CHECK_COLOUR,
    COL_COLOUR,
    ROW_COLOUR,
    few_ticks,
    new_figure,
    to_png,
)
from pcwlad_geo.report.figures.displacements import thin

BINS = 31
MOST_POINTS = 2000

Array = NDArray[np.float64]


def distribution_figure(table: TiePointTable, ce90_px: float) -> bytes:
    """Draw the residuals of fit and check points.

    Parameters
    ----------
    table : TiePointTable
        With residuals.
    ce90_px : float
        The radius of the circle.

    Returns
    -------
    bytes
        A PNG.
    """
    figure = new_figure(3.1)
    places = [(0.065, 0.17, 0.26, 0.72), (0.385, 0.17, 0.26, 0.72), (0.735, 0.17, 0.2627, 0.72)]
    panels = [figure.add_axes(place) for place in places]
    both = table.select("fit", "check")
    shown = np.hypot(*both.residual_px.T)
    limit = max(1.05 * float(np.percentile(shown, 99)), 1.25 * ce90_px) or 1.0
    for axes, name, index, colour in zip(
        panels, ("column", "row"), (0, 1), (COL_COLOUR, ROW_COLOUR), strict=False
    ):
        _histogram(
            axes, both.residual_px[:, index], table.select("check").residual_px[:, index], limit, colour
        )
        axes.set_xlabel(f"residual in {name}, target px", fontsize=9)
    panels[0].set_ylabel("points", fontsize=9)
    _circle(panels[2], table, ce90_px, limit)
    for axes in panels:
        few_ticks(axes)
    return to_png(figure)


def _histogram(axes: Axes, values: Array, check: Array, limit: float, colour: str) -> None:
    """Draw bars of all points, what lies beyond in the outermost, and a line of zero and one of the mean."""
    edges = np.linspace(-limit, limit, BINS + 1)
    heights, _ = np.histogram(np.clip(values, -limit, limit), edges)
    axes.stairs(heights, edges, fill=True, color=colour, alpha=0.75, label="fit and check")
    if len(check):
        heights, _ = np.histogram(np.clip(check, -limit, limit), edges)
        axes.stairs(heights, edges, color="black", lw=1.1, label="check alone")
    axes.axvline(0, color="0.4", lw=0.8)
    axes.axvline(float(values.mean()), color="black", lw=1.0, ls="--", label="mean")
    axes.set_xlim(-limit, limit)
    axes.legend(frameon=False, fontsize=7, loc="upper right", handlelength=1.4, borderpad=0)
    axes.margins(y=0.28)


def _circle(axes: Axes, table: TiePointTable, ce90_px: float, limit: float) -> None:
    fit, check = thin(table.select("fit"), MOST_POINTS), table.select("check")
    axes.plot(*fit.residual_px.T, ".", color="0.55", ms=2.5)
    axes.plot(*check.residual_px.T, "o", ms=4, mfc="none", mec=CHECK_COLOUR, mew=1.2)
    axes.add_patch(Circle((0, 0), ce90_px, fill=False, color="black", lw=1.2))
    axes.axhline(0, color="0.6", lw=0.7)
    axes.axvline(0, color="0.6", lw=0.7)
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit))
    axes.set_title(f"CE90 {ce90_px:.3f} px", fontsize=10)
    axes.set_xlabel("residual in column, px", fontsize=9)
    axes.set_ylabel("in row, px", fontsize=9, labelpad=0)
