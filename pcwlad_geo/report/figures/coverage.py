"""Where tie points are, square by square, and where none are."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from pcwlad_geo.report.coverage import Coverage
from pcwlad_geo.report.figures.canvas import add_bar, draw_backdrop, frame_figure, to_png

NOTHING, REJECTED_ONLY, NO_DATA = "#d55e00", "#f0c000", "0.75"


def coverage_figure(coverage: Coverage, backdrop: NDArray[np.uint8] | None = None) -> bytes:
    """Draw the number of tie points of each square, with marks on those that have none.

    Parameters
    ----------
    coverage : Coverage
    backdrop : (m, n) uint8 array, optional
        The reference image, of any size.

    Returns
    -------
    bytes
        A PNG.
    """
    rows, cols = coverage.shape_px
    figure, (axes,) = frame_figure(coverage.shape_px, bar=True)
    draw_backdrop(axes, backdrop, coverage.shape_px)
    counts = np.ma.masked_equal(coverage.kept, 0)
    most = max(int(coverage.kept.max()), 1)
    frame = (0, cols, rows, 0)
    shown = axes.imshow(
        counts,
        extent=frame,
        cmap="Blues",
        vmin=0,
        vmax=most,
        alpha=0.8,
        aspect="auto",
        interpolation="nearest",
    )
    _mark(axes, coverage)
    add_bar(axes, shown, "tie points")
    axes.set_xlabel("reference column, px", fontsize=9)
    axes.set_ylabel("reference row, px", fontsize=9)
    kinds = [
        Patch(facecolor=NOTHING, edgecolor="black", hatch="xx", label="none"),
        Patch(facecolor=REJECTED_ONLY, edgecolor="black", hatch="//", label="rejected only"),
        Patch(facecolor=NO_DATA, label="no data"),
    ]
    axes.legend(handles=kinds, loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, fontsize=9)
    return to_png(figure)


def _mark(axes: Axes, coverage: Coverage) -> None:
    """Fill the squares without tie points by kind; hatches tell them apart in print."""
    rows, cols = coverage.kept.shape
    height, width = coverage.shape_px[0] / rows, coverage.shape_px[1] / cols
    only_rejected = coverage.empty & (coverage.rejected > 0)
    kinds = [
        (coverage.empty & ~only_rejected, NOTHING, "xx"),
        (only_rejected, REJECTED_ONLY, "//"),
        (coverage.without_data, NO_DATA, ""),
    ]
    for where, colour, hatch in kinds:
        for row, col in np.argwhere(where):
            place = (col * width, row * height)
            axes.add_patch(
                Rectangle(place, width, height, fc=colour, ec="0.2", hatch=hatch, lw=0.3, alpha=0.75)
            )
