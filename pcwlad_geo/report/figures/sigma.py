"""How good the correction is predicted to be, and where it goes beyond its tie points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.report.figures.canvas import add_bar, frame_figure, to_png
from pcwlad_geo.report.precision import PrecisionMap

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
    figure, (axes,) = frame_figure(precision.target_shape, bar=True)
    frame = (0, cols, rows, 0)
    sigma = np.hypot(*np.moveaxis(precision.sigma_px, 2, 0))
    image = axes.imshow(sigma, extent=frame, cmap="viridis", aspect="auto")
    add_bar(axes, image, "predicted sigma, target px")
    axes.plot(*points_px.T, ".", color="white", markersize=2.5, alpha=0.7)
    if precision.extrapolated.any() and min(precision.extrapolated.shape) > 1:
        axes.contourf(
            *np.moveaxis(precision.places_px, 2, 0),
            precision.extrapolated.astype(np.float64),
            levels=[0.5, 1.5],
            colors="none",
            hatches=["///"],
        )
    axes.set(xlim=(0, cols), ylim=(rows, 0))
    axes.set_xlabel("target column, px", fontsize=9)
    axes.set_ylabel("target row, px", fontsize=9)
    return to_png(figure)
