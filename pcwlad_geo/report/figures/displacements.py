"""Displacements before the correction and residuals after it, on one scale."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.quiver import Quiver
from numpy.typing import NDArray

from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.report.figures.canvas import ARROW_COLOUR, WIDTH_IN, draw_backdrop, frame_figure, to_png
from pcwlad_geo.report.statistics import KEPT

MOST_ARROWS = 400
"""More cannot be told apart on the page; every n-th is drawn beyond."""
TYPICAL_LENGTH = 0.05
"""Length of a typical arrow, as a part of the frame's longer side."""
KEY_HEIGHT_IN = 0.12
"""Of the scale arrow above the figure's lower edge."""

Array = NDArray[np.float64]


def displacement_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Draw the displacement arrows on the reference image's frame, and beside them the residuals if any.

    Parameters
    ----------
    table : TiePointTable
        Rejected points are left out.
    reference_shape : (rows, cols)
        Size of the reference image, px.
    backdrop : (m, n) uint8 array, optional
        The reference image, of any size.

    Returns
    -------
    bytes
        A PNG.
    """
    kept = thin(table.select(*KEPT), MOST_ARROWS)
    corrected = bool(np.isfinite(kept.residual_px).any())
    drawn = [("before: displacement", kept.displacement_px)]
    drawn += [("after: residual, same scale", kept.residual_px)] if corrected else []
    figure, panels = frame_figure(reference_shape, panels=len(drawn))
    for axes, (title, arrows) in zip(panels, drawn, strict=True):
        draw_backdrop(axes, backdrop, reference_shape)
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel("reference column, px", fontsize=9)
        if len(kept):
            draw_arrows(axes, kept.reference_px, arrows, kept.displacement_px, max(reference_shape))
    panels[0].set_ylabel("reference row, px", fontsize=9)
    return to_png(figure)


def draw_arrows(
    axes: Axes, at_px: Array, arrows_px: Array, scale_of_px: Array, side_px: int, colours: Array | None = None
) -> Quiver:
    """Draw arrows and a key, rows downwards, the typical one of `scale_of_px` of the typical length."""
    lengths = np.hypot(*scale_of_px.T)
    typical = float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else 0.0
    key_px = nice_number(typical or 1.0)
    style: dict[str, Any] = {"color": ARROW_COLOUR} if colours is None else {}
    arrows = axes.quiver(
        *at_px.T,
        *arrows_px.T,
        *([] if colours is None else [colours]),
        angles="xy",  # rows grow downwards
        scale_units="xy",
        scale=(typical or 1.0) / (TYPICAL_LENGTH * side_px),
        units="inches",
        width=0.022,
        cmap="viridis",
        **style,
    )
    at_in = axes.get_position().x1 * WIDTH_IN - 0.05, KEY_HEIGHT_IN
    words = f"{key_px:g} target px"
    font = {"size": 9}
    axes.quiverkey(arrows, *at_in, key_px, words, coordinates="inches", labelpos="W", fontproperties=font)
    return arrows


def thin(table: TiePointTable, most: int) -> TiePointTable:
    """Return every n-th point, so that there are no more than so many."""
    return table[:: math.ceil(len(table) / most) or 1]


def nice_number(value: float) -> float:
    """Return the 1, 2 or 5 times a power of ten nearest below a positive value."""
    power = float(10.0 ** math.floor(math.log10(value)))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))
