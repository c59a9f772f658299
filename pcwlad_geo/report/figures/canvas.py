"""What the figures have in common: size, colours, and the way into a PNG."""

from __future__ import annotations

import io
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

WIDTH_IN: Final = 8.5
DPI: Final = 95
COL_COLOUR, ROW_COLOUR, CHECK_COLOUR = "#0072b2", "#d55e00", "#cc79a7"
"""Of the axes and of check points: colour-blind readers tell them apart (Okabe and Ito 2008)."""
ARROW_COLOUR = "#003355"
"""Dark enough on a pale image."""
MOST_TICKS: Final = 4
"""Intervals between them, of one axis."""
COLOURS: Final = 256
"""Of a figure's PNG: a quarter of the size of all colours, and none is missed."""


def new_figure(height_in: float) -> Figure:
    """Return an empty figure as wide as the page; places are given by hand: a layout engine draws twice."""
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def frame_figure(shape: tuple[int, int], panels: int = 1, bar: bool = False) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels side by side, each the frame of an image to scale.

    Parameters
    ----------
    shape : (rows, cols)
        Of the image, px.
    panels : int
        How many.
    bar : bool
        Whether to leave room for a colour bar on the right.
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
    return figure, axes


def few_ticks(axes: Axes) -> None:
    """Let both axes have few ticks with small numbers: a tick takes as long to draw as a thousand points."""
    axes.tick_params(labelsize=8)
    axes.locator_params(nbins=MOST_TICKS)


def draw_backdrop(axes: Axes, image: NDArray[np.uint8] | None, shape: tuple[int, int]) -> None:
    """Draw an image below, pale, so that arrows stand out."""
    if image is not None:
        rows, cols = shape
        frame = (0, cols, rows, 0)
        axes.imshow(
            image, cmap="gray", vmin=-180, vmax=255, extent=frame, aspect="auto", interpolation="nearest"
        )


def add_bar(axes: Axes, shown: ScalarMappable, label: str, extend: str = "neither") -> None:
    """Draw the colour bar of a panel in the room on its right."""
    box = axes.get_position()
    figure = axes.get_figure(root=True)
    if figure is None:
        raise TypeError("the panel is of no figure")
    bar = figure.add_axes((box.x1 + 0.015, box.y0, 0.018, box.height))
    figure.colorbar(shown, cax=bar, extend=extend, ticks=MaxNLocator(MOST_TICKS)).set_label(label, fontsize=9)
    bar.tick_params(labelsize=8)


def to_png(figure: Figure) -> bytes:
    """Return a figure as a PNG."""
    raw, made = io.BytesIO(), io.BytesIO()
    figure.savefig(raw, format="rgba")
    drawn = Image.frombytes("RGBA", figure.canvas.get_width_height(), raw.getvalue()).convert("RGB")
    try:
        few = drawn.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    except ValueError as error:  # Pillow's word for memory that it does not get: the picture itself is ours
        raise MemoryError(str(error)) from error
    few.save(made, "png")
    return made.getvalue()
