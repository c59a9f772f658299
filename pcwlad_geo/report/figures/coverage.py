"""Where tie points are, square by square, and why there are none elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from pcwlad_geo.report.figures.canvas import add_bar, draw_backdrop, frame_figure, to_png


@dataclass(frozen=True, slots=True)
class Kind:
    """Squares without tie points that are drawn alike."""

    label: str
    meaning: str
    """What it tells, and what helps."""
    reasons: tuple[str, ...]
    colour: str
    hatch: str


KINDS: Final = (
    Kind(
        "no data",
        "one of the two has no data there (nodata, masked, outside): nothing can be matched",
        ("reference_without_data", "target_without_data"),
        "0.75",
        "",
    ),
    Kind(
        "at an edge",
        "too near to an edge or to masked pixels: a smaller --window and --template reach further",
        ("edge", "not_comparable"),
        "0.88",
        "..",
    ),
    Kind("unreadable", "the file is damaged there", ("unread",), "0.35", "oo"),
    Kind(
        "not asked for",
        "no window was laid there, as enough points were found elsewhere: --points all asks for more",
        ("not_asked", "unknown"),
        "#ffffff",
        "",
    ),
    Kind(
        "no structure",
        "flat ground, such as water: another band or date may show more",
        ("no_texture",),
        "#e8d9a8",
        "",
    ),
    Kind(
        "beyond the search",
        "most best matches lie on the border of the search: the displacement may be larger (raise "
        "--search-radius), or clouds hide the ground",
        ("at_search_border",),
        "#f0e442",
        "//",
    ),
    Kind(
        "no match",
        "what is seen is too different, or repeats: clouds, change, another kind of band",
        ("not_similar", "not_converged", "directions_disagree"),
        "#e69f00",
        "xx",
    ),
    Kind(
        "rejected",
        "there were matches, but they contradict their neighbours: clouds, water, moving things",
        ("rejected",),
        "#d55e00",
        "\\\\",
    ),
)
"""Colours that colour-blind readers tell apart, and hatches for print."""


def missing_kinds(coverage: Mapping[str, Any]) -> list[tuple[Kind, int]]:
    """Return the kinds of squares without tie points that occur, and how many there are.

    Parameters
    ----------
    coverage : mapping
        As in the summary.
    """
    counts = coverage["without_points"]
    found = [(kind, sum(counts.get(reason, 0) for reason in kind.reasons)) for kind in KINDS]
    return [(kind, count) for kind, count in found if count]


def coverage_figure(
    coverage: Mapping[str, Any], shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Draw the number of tie points of each square, and why there are none.

    Parameters
    ----------
    coverage : mapping
        As in the summary.
    shape : (rows, cols)
        Of the reference.
    backdrop : (m, n) uint8 array, optional
        The reference image, of any size.

    Returns
    -------
    bytes
        A PNG.
    """
    figure, (axes,) = frame_figure(shape, bar=True)
    draw_backdrop(axes, backdrop, shape)
    counts = np.ma.masked_equal(np.array(coverage["points"]), 0)
    shown = axes.imshow(
        counts,
        extent=(0, shape[1], shape[0], 0),
        cmap="Blues",
        vmin=0,
        vmax=max(int(counts.max() or 0), 1) if counts.count() else 1,
        alpha=0.8,
        aspect="auto",
        interpolation="nearest",
    )
    kinds = missing_kinds(coverage)
    for kind, _ in kinds:
        _mark(axes, np.isin(np.array(coverage["reason"], dtype=object), kind.reasons), shape, kind)
    add_bar(axes, shown, "tie points")
    axes.set_xlabel("reference column, px", fontsize=9)
    axes.set_ylabel("reference row, px", fontsize=9)
    patches = [
        Patch(facecolor=kind.colour, edgecolor="0.2", hatch=kind.hatch, lw=0.3, label=kind.label)
        for kind, _ in kinds
    ]
    if patches:
        figure.legend(
            handles=patches, loc="upper center", ncols=4, columnspacing=1.2, frameon=False, fontsize=8
        )
    return to_png(figure)


def _mark(axes: Axes, where: NDArray[np.bool_], shape: tuple[int, int], kind: Kind) -> None:
    """Fill squares; hatches tell the kinds apart in print."""
    height, width = shape[0] / where.shape[0], shape[1] / where.shape[1]
    for row, col in np.argwhere(where):
        square = Rectangle((col * width, row * height), width, height, fc=kind.colour, ec="0.2", alpha=0.8)
        square.set(hatch=kind.hatch, linewidth=0.3)
        axes.add_patch(square)
