"""Pictures of tie points and corrections, by Matplotlib, which is loaded when one is drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.report.maps import nice_number
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True)
class PlotStyle:
    """How pictures look."""

    typical_arrow: float = 0.04
    """Length at which a typical arrow is drawn, as a share of the longer side."""
    most_arrows: int = 1500
    """Largest number of arrows; of more points some are drawn."""
    lattice: int = 24
    """Number of arrows of a correction along the longer side."""
    backdrop_px: int = 1200
    """Longer side of the backdrop at most, px."""
    clipped: tuple[float, float] = (2.0, 98.0)
    """Percentiles of the grey values that become black and white."""
    paleness: float = 0.6
    """Opacity of the backdrop."""


STYLE: Final = PlotStyle()
"""That in use."""


def new_axes(ax: Axes | None) -> Axes:
    """Return axes to draw in.

    Raises `InputError` if Matplotlib is not installed.
    """
    if ax is not None:
        return ax
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise InputError(f"plot needs Matplotlib: pip install 'pcwlad-geo[plot]' ({error})") from error
    _, axes = pyplot.subplots(figsize=(7, 6), layout="constrained")
    return axes


def plot_arrows(
    points: TiePointTable, backdrop: Raster | None, *, ax: Axes | None = None, scale: float | None = None
) -> Axes:
    """Draw the displacements of tie points at their reference positions, over the reference."""
    ax, arrows_px = new_axes(ax), points.displacement_px
    rows, cols = _shape(points, backdrop)
    if backdrop is not None:
        draw_backdrop(ax, backdrop)
    used = points.status != "rejected"
    matches = np.flatnonzero(used & np.isfinite(arrows_px).all(axis=1))
    rows_drawn = matches[:: max(1, -(-len(matches) // STYLE.most_arrows))]
    draw_arrows(ax, points.reference_px[rows_drawn], arrows_px[rows_drawn], max(rows, cols), "tab:red", scale)
    rejected = points.reference_px[~used]
    if len(rejected):
        ax.plot(*rejected.T, "x", color="tab:blue", markersize=4, label=f"{len(rejected)} rejected")
        ax.legend(loc="lower right")
    ax.set_title(f"displacement, {len(matches)} tie points", loc="left")
    label_pixels(ax, (rows, cols), "reference")
    return ax


def plot_lattice(
    ax: Axes,
    shape: tuple[int, int],
    forward: Callable[[Float64], Float64],
    sigma: Callable[[Float64], Float64],
) -> None:
    """Draw the displacement of a correction on a lattice over a target of (rows, cols), and its sigma below.

    Both functions take (n, 2) predicted px (col, row) and return (n, 2) px.
    """
    rows, cols = shape
    counts = [max(3, round(STYLE.lattice * side / max(shape))) for side in (cols, rows)]
    axes = [(np.arange(n) + 0.5) * side / n for n, side in zip(counts, (cols, rows), strict=True)]
    at_px = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    arrows_px = forward(at_px) - at_px
    sigma_px = np.hypot(*sigma(at_px).T).reshape(counts[::-1])
    if sigma_px.any():
        image = ax.imshow(
            sigma_px, cmap="YlOrBr", extent=(0, cols, rows, 0), interpolation="bilinear", vmin=0
        )
        ax.figure.colorbar(image, ax=ax, label="sigma, px", shrink=0.8)
    draw_arrows(ax, at_px, arrows_px, max(shape), "black")


def draw_arrows(
    ax: Axes, at_px: Float64, arrows_px: Float64, side_px: int, color: str, scale: float | None = None
) -> None:
    """Draw the (n, 2) `arrows_px` at the (n, 2) `at_px` (col, row), longer than they are, and their key."""
    finite = np.isfinite(arrows_px).all(axis=1)
    typical = float(np.median(np.hypot(*arrows_px[finite].T))) if finite.any() else 0.0
    scale = scale or nice_number(STYLE.typical_arrow * side_px / (typical or 1.0))
    look: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1 / scale, "width": 0.003}
    quiver = ax.quiver(*at_px[finite].T, *arrows_px[finite].T, color=color, **look)
    key_px = nice_number(typical or 1.0)
    ax.quiverkey(quiver, 0.9, 1.03, key_px, f"{key_px:g} px, drawn x {scale:g}", labelpos="W")


def draw_backdrop(ax: Axes, raster: Raster) -> None:
    """Draw the first band of a raster in grey, in its pixels."""
    rows, cols = raster.shape
    values = raster.array if raster.array.ndim == 2 else raster.array[0]
    step = max(1, -(-max(rows, cols) // STYLE.backdrop_px))
    pixels: Any = np.ma.masked_invalid(np.ma.asarray(values)[::step, ::step].astype(np.float64))
    if pixels.count() == 0:
        return
    low, high = np.percentile(pixels.compressed(), STYLE.clipped)
    ax.imshow(pixels, cmap="gray", vmin=low, vmax=high, alpha=STYLE.paleness, extent=(0, cols, rows, 0))


def label_pixels(ax: Axes, shape: tuple[int, int], name: str) -> None:
    """Give axes the extent and the labels of the pixels of a raster of (rows, cols)."""
    ax.set_xlim(0, shape[1])
    ax.set_ylim(shape[0], 0)
    ax.set_aspect("equal")
    ax.set_xlabel(f"{name} column, px")
    ax.set_ylabel(f"{name} row, px")


def _shape(points: TiePointTable, backdrop: Raster | None) -> tuple[int, int]:
    if backdrop is not None:
        return backdrop.shape
    cols, rows = points.reference_px.max(axis=0, initial=1.0)
    return int(np.ceil(rows)), int(np.ceil(cols))
