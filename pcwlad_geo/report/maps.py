"""Maps of the report as SVG: displacements, residuals, sigma and coverage on the frame of an image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.report.charts import (
    CHART_WIDTH_PX,
    CHECK_COLOUR,
    SMALL,
    Box,
    Chart,
    Hatch,
    Panel,
    coloured,
    shades,
    text_width,
)
from pcwlad_geo.report.content import CoverageEntry
from pcwlad_geo.report.statistics import KEPT, PrecisionMap
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class MapStyle:
    """Layout of maps in CSS px, and how many marks they have."""

    margins: tuple[float, float, float, float] = (72.0, 43.0, 14.0, 72.0)
    """Space around the panels: left, top, right, bottom."""
    gap: float = 62.0
    """Space between two panels."""
    bar: float = 110.0
    """Space on the right for a colour bar, instead of the margin."""
    heights: tuple[float, float] = (77.0, 500.0)
    """Least and largest height of a panel."""
    paleness: float = 180.0
    """Added to the grey values of an image behind marks, before they are brought into range again."""
    most_arrows: int = 400
    """Largest number of displacements that are drawn; of more points every n-th is."""
    most_residuals: int = 500
    """Largest number of residuals that are drawn."""
    typical_arrow: float = 0.05
    """Length of a typical arrow, as a share of the frame's longer side."""


ARROW_COLOUR: Final = "#003355"
"""Colour of arrows, dark enough on a pale image."""
MAP_STYLE: Final = MapStyle()
"""As pages draw them."""


def frame_panels(
    shape: tuple[int, int],
    backdrop: NDArray[np.uint8] | None = None,
    *,
    image: str = "reference",
    panels: int = 1,
    bar: bool = False,
    style: MapStyle = MAP_STYLE,
) -> tuple[Chart, list[Panel]]:
    """Return a chart with `panels` side by side, each the labelled frame of an image to scale.

    The labels call it `image`, and it has the `shape` (rows, cols). The `backdrop`, an (m, n) array
    of its grey values at any resolution, is drawn pale. Space is left for a colour `bar` on the right.
    """
    rows, cols = shape
    x_margin, top, right, bottom = style.margins
    room = (CHART_WIDTH_PX - x_margin - (style.bar if bar else right) - style.gap * (panels - 1)) / panels
    least, most = style.heights
    height = min(max(room * rows / cols, least), most)
    width = min(room, height * cols / rows)
    x = x_margin + (room - width) * panels / 2  # in the middle of the page
    chart = Chart(height + top + bottom)
    boxes = [Box(x + number * (width + style.gap), top, width, height) for number in range(panels)]
    frames = [chart.panel(box, (0.0, float(cols)), (float(rows), 0.0)) for box in boxes]
    for panel in frames:
        if backdrop is not None:
            pale = (backdrop.astype(np.float32) + style.paleness) * (255.0 / (255.0 + style.paleness))
            panel.picture(pale.astype(np.uint8), smooth=True)
        panel.x_ticks()
        panel.y_ticks()
        panel.frame(f"{image} column, px", f"{image} row, px" if panel is frames[0] else "")
    return chart, frames


def displacement_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> str:
    """Return an SVG of the displacements as arrows on the reference, and of the residuals in a second panel.

    Rejected points are left out. For the (rows, cols) of the reference and the (m, n) `backdrop` see
    `frame_panels`.
    """
    points = thin(table.select(*KEPT), MAP_STYLE.most_arrows)
    corrected = bool(np.isfinite(points.residual_px).any())
    drawn = [("before: displacement", points.displacement_px)]
    drawn += [("after: residual, same scale", points.residual_px)] if corrected else []
    chart, panels = frame_panels(reference_shape, backdrop, panels=len(drawn))
    for panel, (title, arrows) in zip(panels, drawn, strict=True):
        panel.frame(title=title)
        if len(points):
            draw_arrows(panel, points.reference_px, arrows, points.displacement_px, max(reference_shape))
    return chart.svg()


def draw_arrows(
    panel: Panel,
    at_px: Float64,
    arrows_px: Float64,
    scale_of_px: Float64,
    side_px: int,
    colours: Sequence[str] = (ARROW_COLOUR,),
) -> None:
    """Draw arrows and their key, rows downwards.

    The (n, 2) displacements `arrows_px` (col, row), target px, start at the (n, 2) `at_px` of a frame whose
    longer side is `side_px`. The median length of the (m, 2) `scale_of_px` is drawn as a typical arrow.
    """
    lengths = np.hypot(*scale_of_px.T)
    typical = float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else 0.0
    key_px = nice_number(typical or 1.0)
    scale = MAP_STYLE.typical_arrow * side_px / (typical or 1.0)
    panel.arrows(at_px, at_px + scale * arrows_px, colours)
    box = panel.box
    x = box.x + box.width - key_px * scale * box.width / abs(panel.x_limits[1] - panel.x_limits[0])
    below = box.y + box.height + 54
    foot = np.array([[x, below], [box.x + box.width, below]])
    panel.chart.whole().arrows(foot[:1], foot[1:], (ARROW_COLOUR,))
    panel.chart.text(x - 7, below + 4, f"{key_px:g} target px", anchor="end")


def thin(table: TiePointTable, most: int) -> TiePointTable:
    """Return every n-th point of `table`, with the smallest n that gives at most `most` points."""
    return table[:: math.ceil(len(table) / most) or 1]


def nice_number(value: float) -> float:
    """Return the largest number of 1, 2 or 5 times a power of ten that is not above a positive value."""
    power = float(10.0 ** math.floor(math.log10(value)))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


def residual_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> str:
    """Return an SVG of the residuals as arrows on their own scale, coloured by length.

    Check points are marked by a ring, rejected points by a cross. For the (rows, cols) of the reference and
    the (m, n) `backdrop` see `frame_panels`.
    """
    chart, (panel,) = frame_panels(reference_shape, backdrop, bar=True)
    points, rejected = (
        thin(table.select(*names), MAP_STYLE.most_residuals) for names in (KEPT, ("rejected",))
    )
    check = table.select("check")
    length = np.hypot(*points.residual_px.T)
    marks = []
    panel.crosses(rejected.reference_px, 2.5, "#595959")
    if len(rejected):
        marks.append(('<path d="M-3-3L3 3M-3 3L3-3" stroke="#595959"/>', "rejected"))
    if np.isfinite(length).any():
        most = float(np.nanpercentile(length, 98)) or 1.0
        colours = shades(length, most, "viridis")
        draw_arrows(
            panel, points.reference_px, points.residual_px, points.residual_px, max(reference_shape), colours
        )
        panel.bar("viridis", most, "residual, target px")
    panel.rings(check.reference_px, 4.0, CHECK_COLOUR)
    if len(check):
        ring = f'<circle r="4" fill="none" stroke="{CHECK_COLOUR}" stroke-width="1.3"/>'
        marks.append((ring, "check point"))
    panel.frame(title="residual, enlarged")
    chart.legend(marks, panel.box.x + panel.box.width, panel.box.y - 8)
    return chart.svg()


def sigma_figure(precision: PrecisionMap, points_px: Float64) -> str:
    """Return an SVG of the radial sigma of the correction on the target, hatched where it extrapolates.

    The (n, 2) `points_px` (col, row), target px, are the tie points of the fit.
    """
    chart, (panel,) = frame_panels(precision.target_shape, image="target", bar=True)
    sigma = np.hypot(*np.moveaxis(precision.sigma_px, 2, 0))
    low, high = float(np.nanmin(sigma)), float(np.nanmax(sigma))
    high = high if high > low else low + (abs(low) or 1.0) * 1e-3
    panel.picture(coloured(sigma, low, high, "viridis"))
    panel.bar("viridis", high, "predicted sigma, target px", low)
    panel.dots(points_px, 1.2, "#fff", 0.7)
    if precision.extrapolated.any():
        panel.squares(precision.extrapolated, "", hatch="//")
    panel.frame()
    return chart.svg()


@dataclass(frozen=True, slots=True)
class GapStyle:
    """A class of squares without tie points, drawn in one style."""

    label: str
    meaning: str
    """Explanation for the reader, with advice."""
    reasons: tuple[str, ...]
    colour: str
    hatch: Hatch


GAP_STYLES: Final = (
    GapStyle(
        "no data",
        "one of the two has no data there (nodata, masked, outside): nothing can be matched",
        ("reference_without_data", "target_without_data"),
        "#bfbfbf",
        "",
    ),
    GapStyle(
        "at an edge",
        "too near to an edge or to masked pixels: a smaller --window and --template reach further",
        ("edge", "not_comparable"),
        "#e0e0e0",
        "..",
    ),
    GapStyle("unreadable", "the file is damaged there", ("unread",), "#595959", "oo"),
    GapStyle(
        "not asked for",
        "no window was laid there, as enough points were found elsewhere: --points all asks for more",
        ("not_asked", "unknown"),
        "#ffffff",
        "",
    ),
    GapStyle(
        "no structure",
        "flat ground, such as water: another band or date may show more",
        ("no_texture",),
        "#e8d9a8",
        "",
    ),
    GapStyle(
        "beyond the search",
        "most best matches lie on the border of the search: the displacement may be larger (raise "
        "--search-radius), or clouds hide the ground",
        ("at_search_border",),
        "#f0e442",
        "//",
    ),
    GapStyle(
        "no match",
        "what is seen is too different, or repeats: clouds, change, another kind of band",
        ("not_similar", "not_converged", "directions_disagree"),
        "#e69f00",
        "xx",
    ),
    GapStyle(
        "rejected",
        "there were matches, but they contradict their neighbours: clouds, water, moving things",
        ("rejected",),
        "#d55e00",
        "\\\\",
    ),
)
"""Classes with colours that are distinguishable with colour blindness, and hatches for print."""


def missing_kinds(coverage: CoverageEntry) -> list[tuple[GapStyle, int]]:
    """Return the kinds of squares without tie points that occur, and their numbers."""
    counts = coverage.without_points
    counted = [(kind, sum(counts.get(reason, 0) for reason in kind.reasons)) for kind in GAP_STYLES]
    return [(kind, count) for kind, count in counted if count]


def coverage_figure(
    coverage: CoverageEntry, shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> str:
    """Return an SVG of the number of tie points of each square, and the reasons where there are none.

    For the shape (rows, cols) of the reference and the (m, n) `backdrop` see `frame_panels`.
    """
    chart, (panel,) = frame_panels(shape, backdrop, bar=True)
    counts = np.array(coverage.points)
    most = max(int(counts.max()), 1)
    tints = coloured(counts.astype(np.float64), 0, most, "blues")
    panel.picture(np.dstack([tints, np.where(counts > 0, 204, 0).astype(np.uint8)]))
    reasons = np.array(coverage.reason, dtype=object)
    entries = []
    for kind, _ in missing_kinds(coverage):
        panel.squares(np.isin(reasons, kind.reasons), kind.colour, 0.8, kind.hatch)
        patch = '<rect x="-9" y="-5" width="18" height="10"'
        mark = f'{patch} fill="{kind.colour}" stroke="#333" stroke-width=".5"/>'
        if kind.hatch:
            mark += f'{patch} fill="{chart.hatch(kind.hatch)}"/>'
        entries.append((mark, kind.label))
    panel.bar("blues", float(most), "tie points")
    panel.frame()
    for line, first in enumerate(range(0, len(entries), 4)):
        line_entries = entries[first : first + 4]
        wide = sum(text_width(text, SMALL) + 38 for _, text in line_entries)
        chart.legend(line_entries, (CHART_WIDTH_PX + wide) / 2, 15.0 + 16 * line)
    return chart.svg()


def motion_figure(
    velocity_px: Float64, regions: NDArray[np.integer[Any]], cell_px: float, shape: tuple[int, int]
) -> tuple[str, tuple[float, float, float, float]]:
    """Return an SVG of the speed of the ground, with arrows where it moves, and the box of the map in it.

    The box is (left, top, width, height) in shares of the picture. The (rows, cols, 2) `velocity_px` (col,
    row), px a year, are those of square cells, and the (rows, cols) `regions` are above 0 where they move;
    the frame has the `shape` (rows, cols).
    """
    chart, (panel,) = frame_panels(shape, image="frame", bar=True)
    box = panel.box
    cells = Box(
        box.x,
        box.y,
        box.width * regions.shape[1] * cell_px / shape[1],
        box.height * regions.shape[0] * cell_px / shape[0],
    )
    speed = np.hypot(*np.moveaxis(velocity_px, 2, 0))
    finite = np.isfinite(speed)
    most = float(speed[finite].max(initial=0.0)) or 1.0
    grey = np.full(3, 230, np.uint8)
    map_panel = chart.panel(cells, (0.0, regions.shape[1] * cell_px), (regions.shape[0] * cell_px, 0.0))
    map_panel.picture(np.where(finite[..., None], coloured(speed, 0.0, most, "heat"), grey))
    row, col = np.nonzero(regions)
    if len(row):
        at = np.asarray(np.column_stack([col, row]) + 0.5, np.float64) * cell_px
        moving = velocity_px[row, col]
        draw_arrows(panel, at, moving, moving, max(shape))
    panel.bar("heat", most, "speed, px of the frame a year")
    panel.frame(title="motion of the ground; grey: too few images tell")
    height = chart.height
    return chart.svg(), (
        box.x / CHART_WIDTH_PX,
        box.y / height,
        box.width / CHART_WIDTH_PX,
        box.height / height,
    )
