"""How good the correction is predicted to be, and where it goes beyond its tie points."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pcwlad_geo.report.precision import PrecisionMap

WIDTH_IN, DPI = 8.5, 110

Array = NDArray[np.float64]


def sigma_figure(precision: PrecisionMap, points_px: Array) -> bytes:
    """Draw the radial sigma of the correction on the target's frame, hatched where it extrapolates.

    Parameters
    ----------
    precision : PrecisionMap
    points_px : (n, 2) array of float
        Where the tie points of the fit are (col, row), target px.

    Returns
    -------
    bytes
        A PNG.
    """
    rows, cols = precision.target_shape
    height_in = min(max(WIDTH_IN * rows / cols, 3.0), 9.0)
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    frame = (0, cols, rows, 0)
    image = axes.imshow(np.hypot(*np.moveaxis(precision.sigma_px, 2, 0)), extent=frame, cmap="viridis")
    figure.colorbar(image, ax=axes, label="predicted sigma of the correction, target px", shrink=0.8)
    axes.plot(*points_px.T, ".", color="white", markersize=2.5, alpha=0.7)
    if precision.extrapolated.any() and min(precision.extrapolated.shape) > 1:
        axes.contourf(
            *np.moveaxis(precision.places_px, 2, 0),
            precision.extrapolated.astype(np.float64),
            levels=[0.5, 1.5],
            colors="none",
            hatches=["///"],
        )
    axes.set(xlim=(0, cols), ylim=(rows, 0), xlabel="target column, px", ylabel="target row, px")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
