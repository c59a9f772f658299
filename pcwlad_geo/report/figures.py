"""Figures of the report: maps of displacements, residuals and sigma, distributions, all as PNG."""

from __future__ import annotations

import io
import math
from typing import Any, Final

import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.quiver import Quiver
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from pcwlad_geo.report.statistics import KEPT, PrecisionMap
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64

WIDTH_IN: Final = 8.5
"""Width of all figures in inches."""
DPI: Final = 95
"""Resolution of all figures in dots per inch."""
COL_COLOUR, ROW_COLOUR, CHECK_COLOUR = "#0072b2", "#d55e00", "#cc79a7"
"""Colours of both axes and of check points, distinguishable with colour blindness (Okabe and Ito 2008)."""
ARROW_COLOUR = "#003355"
"""Colour of arrows, dark enough on a pale image."""
MAX_TICKS: Final = 4
"""Largest number of intervals between the ticks of an axis."""
TITLE_Y: Final = 1.0
"""Place of a title, in heights of its panel, which matplotlib would look for by drawing all labels twice."""
COLOURS: Final = 256
"""Number of colours of a PNG, which makes it a quarter of the size without visible loss."""


def new_figure(height_in: float) -> Figure:
    """Return an empty figure of the page's width, without a layout engine, which would draw it twice."""
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def close_fonts() -> None:
    """Close the fonts that matplotlib keeps open, two files and 9 MB, for each thread that has drawn."""
    kept = getattr(font_manager, "_get_font", None)  # private, as there is no public way
    getattr(kept, "cache_clear", lambda: None)()


def frame_figure(
    shape: tuple[int, int],
    backdrop: NDArray[np.uint8] | None = None,
    *,
    of: str = "reference",
    panels: int = 1,
    bar: bool = False,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels side by side, each the labelled frame of an image to scale.

    Parameters
    ----------
    shape : (rows, cols)
        Size of the image, px.
    backdrop : (m, n) array of uint8, optional
        Grey values of the image, of any size, drawn pale.
    of : str
        Name of the image.
    panels : int
        Number of panels.
    bar : bool
        Whether space is left for a colour bar on the right.
    """
    left, right, top, bottom, gap = 0.75, 1.15 if bar else 0.15, 0.45, 0.75, 0.65
    room = (WIDTH_IN - left - right - gap * (panels - 1)) / panels
    rows, cols = shape
    height = min(max(room * rows / cols, 0.8), 5.2)
    width = min(room, height * cols / rows)
    full = height + top + bottom
    left += (room - width) * panels / 2  # in the middle of the page
    figure = new_figure(full)
    axes = [
        figure.add_axes(
            ((left + each * (width + gap)) / WIDTH_IN, bottom / full, width / WIDTH_IN, height / full),
            xlim=(0, cols),
            ylim=(rows, 0),
        )
        for each in range(panels)
    ]
    for each in axes:
        few_ticks(each)
        each.set_xlabel(f"{of} column, px", fontsize=9)
        if backdrop is not None:
            style: dict[str, Any] = {"cmap": "gray", "vmin": -180, "vmax": 255, "interpolation": "nearest"}
            each.imshow(backdrop, extent=(0, cols, rows, 0), aspect="auto", **style)
    axes[0].set_ylabel(f"{of} row, px", fontsize=9)
    return figure, axes


def few_ticks(axes: Axes) -> None:
    """Limit the ticks of both axes: a tick takes as long to draw as a thousand points."""
    axes.tick_params(labelsize=8)
    axes.locator_params(nbins=MAX_TICKS)


def add_bar(axes: Axes, shown: ScalarMappable, label: str, extend: str = "neither") -> None:
    """Draw the colour bar of `shown` with a `label` right of the panel `axes`; `extend` as in matplotlib."""
    box = axes.get_position()
    figure = axes.get_figure(root=True)
    if figure is None:
        raise TypeError("the panel is of no figure")
    bar = figure.add_axes((box.x1 + 0.015, box.y0, 0.018, box.height))
    figure.colorbar(shown, cax=bar, extend=extend, ticks=MaxNLocator(MAX_TICKS)).set_label(label, fontsize=9)
    bar.tick_params(labelsize=8)


def to_png(figure: Figure) -> bytes:
    """Return a figure as a PNG."""
    raw, encoded = io.BytesIO(), io.BytesIO()
    figure.savefig(raw, format="rgba")
    drawn = Image.frombytes("RGBA", figure.canvas.get_width_height(), raw.getvalue()).convert("RGB")
    try:
        few = drawn.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    except ValueError as error:  # Pillow's error for a lack of memory; the picture itself is valid
        raise MemoryError(str(error)) from error
    few.save(encoded, "png")
    return encoded.getvalue()


MAX_ARROWS = 400
"""Largest number of arrows; of more points every n-th is drawn."""
TYPICAL_LENGTH = 0.05
"""Length of a typical arrow, as a part of the frame's longer side."""
KEY_HEIGHT_IN = 0.12
"""Height of the scale arrow above the figure's lower edge."""


def displacement_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Return a PNG of the displacements as arrows on the reference, and beside them of the residuals.

    Parameters
    ----------
    table : TiePointTable
        Rejected points are left out.
    reference_shape : (rows, cols)
        Size of the reference image, px.
    backdrop : (m, n) array of uint8, optional
        Grey values of the reference image, of any size.
    """
    kept = thin(table.select(*KEPT), MAX_ARROWS)
    corrected = bool(np.isfinite(kept.residual_px).any())
    drawn = [("before: displacement", kept.displacement_px)]
    drawn += [("after: residual, same scale", kept.residual_px)] if corrected else []
    figure, panels = frame_figure(reference_shape, backdrop, panels=len(drawn))
    for axes, (title, arrows) in zip(panels, drawn, strict=True):
        axes.set_title(title, fontsize=10, loc="left", y=TITLE_Y)
        if len(kept):
            draw_arrows(axes, kept.reference_px, arrows, kept.displacement_px, max(reference_shape))
    return to_png(figure)


def draw_arrows(
    axes: Axes,
    at_px: Float64,
    arrows_px: Float64,
    scale_of_px: Float64,
    side_px: int,
    colours: Float64 | None = None,
) -> Quiver:
    """Draw arrows and their key, rows downwards.

    Parameters
    ----------
    at_px : (n, 2) array
        Start points (col, row), px of the frame.
    arrows_px : (n, 2) array
        Displacements (col, row), target px.
    scale_of_px : (m, 2) array
        Displacements (col, row), target px, whose median length is drawn with `TYPICAL_LENGTH`.
    side_px : int
        Longer side of the frame, px.
    colours : (n,) array, optional
        Values that are shown by colour.
    """
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
    """Return every n-th point of `table`, with the smallest n that gives at most `most` points."""
    return table[:: math.ceil(len(table) / most) or 1]


def nice_number(value: float) -> float:
    """Return the largest number of 1, 2 or 5 times a power of ten that is not above a positive value."""
    power = float(10.0 ** math.floor(math.log10(value)))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


MAX_RESIDUALS = 500
"""Largest number of residuals that are drawn as arrows."""


def residual_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Return a PNG of the residuals as arrows on their own scale, coloured by length.

    Parameters
    ----------
    table : TiePointTable
        Check points are marked by a ring, rejected points by a cross.
    reference_shape : (rows, cols)
        Size of the reference image, px.
    backdrop : (m, n) array of uint8, optional
        Grey values of the reference image, of any size.
    """
    figure, (axes,) = frame_figure(reference_shape, backdrop, bar=True)
    kept, rejected = (
        thin(table.select(*KEPT), MAX_RESIDUALS),
        thin(table.select("rejected"), MAX_RESIDUALS),
    )
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
    axes.set_title("residual, enlarged", fontsize=10, loc="left", y=TITLE_Y)
    axes.set_xlabel("reference column, px", fontsize=9, loc="left")
    if marks:
        axes.legend(
            handles=marks, loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False, fontsize=9
        )
    return to_png(figure)


def sigma_figure(precision: PrecisionMap, points_px: Float64) -> bytes:
    """Return a PNG of the radial sigma of the correction on the target, hatched where it extrapolates.

    Parameters
    ----------
    precision : PrecisionMap
        Sigma on a lattice over the target.
    points_px : (n, 2) array
        Positions of the tie points of the fit (col, row), target px.
    """
    rows, cols = precision.target_shape
    figure, (axes,) = frame_figure(precision.target_shape, of="target", bar=True)
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
    return to_png(figure)


BINS = 31
"""Number of bars of a histogram."""
MAX_POINTS = 2000
"""Largest number of points of the scatter plot."""


def distribution_figure(table: TiePointTable, ce90_px: float) -> bytes:
    """Return a PNG of the residuals of fit and check points.

    Parameters
    ----------
    table : TiePointTable
        Tie points with residuals.
    ce90_px : float
        Radius of the circle, target px.
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


def _histogram(axes: Axes, values: Float64, check: Float64, limit: float, colour: str) -> None:
    """Draw a histogram, values beyond the limit in the outermost bars, with lines at zero and the mean."""
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
    fit, check = thin(table.select("fit"), MAX_POINTS), table.select("check")
    axes.plot(*fit.residual_px.T, ".", color="0.55", ms=2.5)
    axes.plot(*check.residual_px.T, "o", ms=4, mfc="none", mec=CHECK_COLOUR, mew=1.2)
    axes.add_patch(Circle((0, 0), ce90_px, fill=False, color="black", lw=1.2))
    axes.axhline(0, color="0.6", lw=0.7)
    axes.axvline(0, color="0.6", lw=0.7)
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit))
    axes.set_title(f"CE90 {ce90_px:.3f} px", fontsize=10, y=TITLE_Y)
    axes.set_xlabel("residual in column, px", fontsize=9)
    axes.set_ylabel("in row, px", fontsize=9, labelpad=0)
