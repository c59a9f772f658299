"""Where the correction leaves residuals, enlarged to be seen."""

from __future__ import annotations

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.report.figures.canvas import CHECK_COLOUR, add_bar, draw_backdrop, frame_figure, to_png
from pcwlad_geo.report.figures.displacements import draw_arrows, thin
from pcwlad_geo.report.statistics import KEPT

MOST_ARROWS = 500


def residual_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Draw the residual arrows on a scale of their own, coloured by length.

    Parameters
    ----------
    table : TiePointTable
        Check points carry a ring, rejected ones are crosses.
    reference_shape : (rows, cols)
    backdrop : (m, n) uint8 array, optional
        The reference image, of any size.

    Returns
    -------
    bytes
        A PNG.
    """
    figure, (axes,) = frame_figure(reference_shape, bar=True)
    draw_backdrop(axes, backdrop, reference_shape)
    kept, rejected = thin(table.select(*KEPT), MOST_ARROWS), thin(table.select("rejected"), MOST_ARROWS)
    check = table.select("check")
    length = np.hypot(*kept.residual_px.T)
    marks: list[Line2D] = []
    if len(rejected):
        marks += axes.plot(*rejected.reference_px.T, "x", color="0.35", ms=3.5, mew=0.8, label="rejected")
    if np.isfinite(length).any():
        side = max(reference_shape)
        arrows = draw_arrows(axes, kept.reference_px, kept.residual_px, kept.residual_px, side, length)
        arrows.set_clim(0, float(np.nanpercentile(length, 98)) or 1.0)
        add_bar(axes, arrows, "residual, target px", extend="max")
    if len(check):
        ring = {"ms": 6, "mfc": "none", "mec": CHECK_COLOUR, "mew": 1.3}
        marks += axes.plot(*check.reference_px.T, "o", label="check point", **ring)  # type: ignore[arg-type]
    axes.set_title("residual, enlarged", fontsize=10, loc="left")
    axes.set_xlabel("reference column, px", fontsize=9, loc="left")
    axes.set_ylabel("reference row, px", fontsize=9)
    if marks:
        axes.legend(
            handles=marks, loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False, fontsize=9
        )
    return to_png(figure)
