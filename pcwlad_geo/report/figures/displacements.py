"""Where the tie points lie, which way they moved, and how well the model explains it."""

from __future__ import annotations

import io
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pcwlad_geo.raster.tie_point_table import TiePointTable

MOST_ARROWS = 1500
"""More cannot be told apart on the page; every n-th is drawn beyond."""
TYPICAL_LENGTH = 0.06
"""Length of a typical arrow, as a part of the figure's longer side."""
WIDTH_IN, DPI = 8.5, 110

Array = NDArray[np.float64]


def displacement_figure(table: TiePointTable, reference_shape: tuple[int, int]) -> bytes:
    """Draw the displacement arrows on the reference image's frame.

    Parameters
    ----------
    table : TiePointTable
        Rejected points are drawn as grey crosses, the others as arrows coloured by their residual (by
        status alone where there is no model); check points carry a ring.
    reference_shape : (rows, cols)
        Size of the reference image, px.

    Returns
    -------
    bytes
        A PNG.
    """
    rows, cols = reference_shape
    height_in = min(max(WIDTH_IN * rows / cols, 3.0), 9.0)
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    kept = _thin(table.select("fit", "check", "unused", "matched"))
    _draw_rejected(axes, _thin(table.select("rejected")).reference_px)
    if len(kept):
        _draw_arrows(figure, axes, kept, max(rows, cols))
    axes.set(xlim=(0, cols), ylim=(rows, 0), aspect="equal")
    axes.set(xlabel="reference column, px", ylabel="reference row, px")
    axes.set_title(" ", fontsize=14)  # room for the key arrow
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower left", ncols=3, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _draw_rejected(axes: Axes, position: Array) -> None:
    if len(position):
        axes.plot(*position.T, "x", color="0.6", markersize=3.5, markeredgewidth=0.8, label="rejected")


def _draw_arrows(figure: Figure, axes: Axes, kept: TiePointTable, side_px: int) -> None:
    displacement = kept.displacement_px
    residual = np.hypot(*kept.residual_px.T)
    typical = float(np.median(np.hypot(*displacement.T)))
    key_px = nice_number(typical or 1.0)
    arrows = axes.quiver(
        *kept.reference_px.T,
        *displacement.T,
        *([residual] if np.isfinite(residual).any() else []),
        angles="xy",  # rows grow downwards
        scale_units="xy",
        scale=(typical or 1.0) / (TYPICAL_LENGTH * side_px),
        width=0.0022,
        cmap="viridis",
    )
    if np.isfinite(residual).any():
        arrows.set_clim(0, float(np.nanpercentile(residual, 98)) or 1.0)
        figure.colorbar(arrows, ax=axes, label="residual of the model, target px", shrink=0.8, extend="max")
    axes.quiverkey(arrows, 0.9, 1.03, key_px, f"{key_px:g} target px", labelpos="E")
    check = kept.select("check")
    if len(check):
        axes.plot(*check.reference_px.T, "o", markersize=4, mfc="none", mec="tab:red", label="check point")


def _thin(table: TiePointTable) -> TiePointTable:
    return table[:: math.ceil(len(table) / MOST_ARROWS) or 1]


def nice_number(value: float) -> float:
    """Return the 1, 2 or 5 times a power of ten nearest below a positive value."""
    power = float(10.0 ** math.floor(math.log10(value)))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))
