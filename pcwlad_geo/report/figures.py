"""Figures of the report: maps, distributions, coverage, candidate models and trends, all as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.jitter import Profile
from pcwlad_geo.correction.proof_result import LOCKING_PX, Proof, Sensitivity
from pcwlad_geo.report.charts import (
    LARGE,
    NORMAL,
    SMALL,
    WIDTH_PX,
    Box,
    Chart,
    Hatch,
    Panel,
    coloured,
    day_ticks,
    shades,
    text_width,
)
from pcwlad_geo.report.content import CandidateEntry, CoverageEntry, ProfilesEntry
from pcwlad_geo.report.statistics import KEPT, PrecisionMap
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64

COL_COLOUR, ROW_COLOUR, CHECK_COLOUR = "#0072b2", "#d55e00", "#cc79a7"
"""Colours of both axes and of check points, distinguishable with colour blindness (Okabe and Ito 2008)."""
AXES: Final = (("column", COL_COLOUR), ("row", ROW_COLOUR))
"""Names and colours of both axes."""
ARROW_COLOUR = "#003355"
"""Colour of arrows, dark enough on a pale image."""
PALE: Final = 180.0
"""Added to the grey values of an image behind marks, before they are brought into range again."""
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX, GAP_PX = 72.0, 14.0, 43.0, 72.0, 62.0
"""Space around panels that show an image, and between them."""
BAR_PX: Final = 110.0
"""Space at the right for a colour bar."""
LEAST_SIDE_PX, MOST_SIDE_PX = 77.0, 500.0
"""Least and largest height of such a panel."""


def frame_panels(
    shape: tuple[int, int],
    backdrop: NDArray[np.uint8] | None = None,
    *,
    of: str = "reference",
    panels: int = 1,
    bar: bool = False,
) -> tuple[Chart, list[Panel]]:
    """Return a chart with `panels` side by side, each the labelled frame of an image to scale.

    The image is called `of` in the labels and has the `shape` (rows, cols). The `backdrop`, an (m, n) array
    of its grey values at any resolution, is drawn pale. Space is left for a colour `bar` on the right.
    """
    rows, cols = shape
    room = (WIDTH_PX - LEFT_PX - (BAR_PX if bar else RIGHT_PX) - GAP_PX * (panels - 1)) / panels
    height = min(max(room * rows / cols, LEAST_SIDE_PX), MOST_SIDE_PX)
    width = min(room, height * cols / rows)
    left = LEFT_PX + (room - width) * panels / 2  # in the middle of the page
    chart = Chart(height + TOP_PX + BOTTOM_PX)
    boxes = [Box(left + number * (width + GAP_PX), TOP_PX, width, height) for number in range(panels)]
    made = [chart.panel(box, (0.0, float(cols)), (float(rows), 0.0)) for box in boxes]
    for panel in made:
        if backdrop is not None:
            pale = (backdrop.astype(np.float32) + PALE) * (255.0 / (255.0 + PALE))
            panel.picture(pale.astype(np.uint8), smooth=True)
        panel.x_ticks()
        panel.y_ticks()
        panel.frame(f"{of} column, px", f"{of} row, px" if panel is made[0] else "")
    return chart, made


MAX_ARROWS = 400
"""Largest number of arrows; of more points every n-th is drawn."""
TYPICAL_LENGTH = 0.05
"""Length of a typical arrow, as a part of the frame's longer side."""


def displacement_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> str:
    """Return an SVG of the displacements as arrows on the reference, and of the residuals in a second panel.

    Rejected points are left out. For the (rows, cols) of the reference and the (m, n) `backdrop` see
    `frame_panels`.
    """
    kept = thin(table.select(*KEPT), MAX_ARROWS)
    corrected = bool(np.isfinite(kept.residual_px).any())
    drawn = [("before: displacement", kept.displacement_px)]
    drawn += [("after: residual, same scale", kept.residual_px)] if corrected else []
    chart, panels = frame_panels(reference_shape, backdrop, panels=len(drawn))
    for panel, (title, arrows) in zip(panels, drawn, strict=True):
        panel.frame(title=title)
        if len(kept):
            draw_arrows(panel, kept.reference_px, arrows, kept.displacement_px, max(reference_shape))
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
    longer side is `side_px`. The median length of the (m, 2) `scale_of_px` is drawn with `TYPICAL_LENGTH`.
    """
    lengths = np.hypot(*scale_of_px.T)
    typical = float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else 0.0
    key_px = nice_number(typical or 1.0)
    scale = TYPICAL_LENGTH * side_px / (typical or 1.0)
    panel.arrows(at_px, at_px + scale * arrows_px, colours)
    box = panel.box
    x = box.left + box.width - key_px * scale * box.width / abs(panel.x_limits[1] - panel.x_limits[0])
    below = box.top + box.height + 54
    foot = np.array([[x, below], [box.left + box.width, below]])
    panel.chart.whole().arrows(foot[:1], foot[1:], (ARROW_COLOUR,))
    panel.chart.text(x - 7, below + 4, f"{key_px:g} target px", anchor="end")


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
) -> str:
    """Return an SVG of the residuals as arrows on their own scale, coloured by length.

    Check points are marked by a ring, rejected points by a cross. For the (rows, cols) of the reference and
    the (m, n) `backdrop` see `frame_panels`.
    """
    chart, (panel,) = frame_panels(reference_shape, backdrop, bar=True)
    kept, rejected = (thin(table.select(*KEPT), MAX_RESIDUALS), thin(table.select("rejected"), MAX_RESIDUALS))
    check = table.select("check")
    length = np.hypot(*kept.residual_px.T)
    marks = []
    panel.crosses(rejected.reference_px, 2.5, "#595959")
    if len(rejected):
        marks.append(('<path d="M-3-3L3 3M-3 3L3-3" stroke="#595959"/>', "rejected"))
    if np.isfinite(length).any():
        most = float(np.nanpercentile(length, 98)) or 1.0
        colours = shades(length, most, "viridis")
        draw_arrows(
            panel, kept.reference_px, kept.residual_px, kept.residual_px, max(reference_shape), colours
        )
        panel.bar("viridis", most, "residual, target px")
    panel.rings(check.reference_px, 4.0, CHECK_COLOUR)
    if len(check):
        ring = f'<circle r="4" fill="none" stroke="{CHECK_COLOUR}" stroke-width="1.3"/>'
        marks.append((ring, "check point"))
    panel.frame(title="residual, enlarged")
    chart.legend(marks, panel.box.left + panel.box.width, panel.box.top - 8)
    return chart.svg()


def sigma_figure(precision: PrecisionMap, points_px: Float64) -> str:
    """Return an SVG of the radial sigma of the correction on the target, hatched where it extrapolates.

    The (n, 2) `points_px` (col, row), target px, are the tie points of the fit.
    """
    chart, (panel,) = frame_panels(precision.target_shape, of="target", bar=True)
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


BINS: Final = 31
"""Number of bars of a histogram."""
MAX_POINTS: Final = 2000
"""Largest number of points of the scatter plot."""


def distribution_figure(table: TiePointTable, ce90_px: float) -> str:
    """Return an SVG of the residuals of fit and check points, with a circle of the radius `ce90_px`."""
    chart = Chart(298.0)
    both, check = (table.select(*names).residual_px for names in (("fit", "check"), ("check",)))
    limit = max(1.05 * float(np.percentile(np.hypot(*both.T), 99)), 1.25 * ce90_px) or 1.0
    for axis, (name, colour) in enumerate(AXES):
        box = Box(54.0 + 262.0 * axis, 30.0, 212.0, 214.0)
        panel = _histogram(chart, box, both[:, axis], check[:, axis], limit, colour)
        panel.frame(f"residual in {name}, target px", "" if axis else "points")
    _circle(chart, Box(600.0, 30.0, 214.0, 214.0), table, ce90_px, limit)
    return chart.svg()


def _histogram(chart: Chart, box: Box, values: Float64, check: Float64, limit: float, colour: str) -> Panel:
    """Draw a histogram, values beyond the limit in the outermost bars, with lines at zero and the mean."""
    edges = np.linspace(-limit, limit, BINS + 1)
    counts, of_check = (np.histogram(np.clip(each, -limit, limit), edges)[0] for each in (values, check))
    panel = chart.panel(box, (-limit, limit), (0.0, 1.28 * float(max(counts.max(), 1))))
    steps = np.repeat(edges, 2)
    panel.area(steps, np.r_[0, np.repeat(counts, 2), 0], colour, 0.75)
    if len(check):
        panel.line(steps, np.r_[0, np.repeat(of_check, 2), 0].astype(np.float64), "#000", 1.1)
    panel.up(0.0, "#666")
    panel.up(float(values.mean()), "#000", 1.0, "5 3")
    marks = [f'<rect x="-7" y="-4" width="14" height="8" fill="{colour}" opacity=".75"/>']
    entries = [(marks[0], "fit and check")]
    if len(check):
        entries.append(('<path d="M-7 0H7" stroke="#000" stroke-width="1.1"/>', "check"))
    entries.append(('<path d="M-7 0H7" stroke="#000" stroke-dasharray="5 3"/>', "mean"))
    chart.legend(entries, box.left + box.width, box.top - 9)
    panel.x_ticks()
    panel.y_ticks()
    return panel


def _circle(chart: Chart, box: Box, table: TiePointTable, ce90_px: float, limit: float) -> None:
    fit, check = thin(table.select("fit"), MAX_POINTS), table.select("check")
    panel = chart.panel(box, (-limit, limit), (limit, -limit))
    panel.across(0.0, "#999", 0.7)
    panel.up(0.0, "#999", 0.7)
    panel.dots(fit.residual_px, 1.2, "#8c8c8c")
    panel.rings(check.residual_px, 2.8, CHECK_COLOUR, 1.2)
    panel.circle(ce90_px, "#000")
    panel.x_ticks()
    panel.y_ticks()
    panel.frame("residual in column, px", "in row, px", f"CE90 {ce90_px:.3f} px")


@dataclass(frozen=True, slots=True)
class GapStyle:
    """A class of squares without tie points, drawn in one style."""

    label: str
    meaning: str
    """Explanation for the reader, with advice."""
    reasons: tuple[str, ...]
    colour: str
    hatch: Hatch


KINDS: Final = (
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
    found = [(kind, sum(counts.get(reason, 0) for reason in kind.reasons)) for kind in KINDS]
    return [(kind, count) for kind, count in found if count]


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
        some = entries[first : first + 4]
        wide = sum(text_width(text, SMALL) + 38 for _, text in some)
        chart.legend(some, (WIDTH_PX + wide) / 2, 15.0 + 16 * line)
    return chart.svg()


def candidate_figure(candidates: Sequence[CandidateEntry]) -> str:
    """Return an SVG of the cross-validated RMSE of each model with two standard errors.

    Its rows are the `candidates` in their order, all with an RMSE.
    """
    count = len(candidates)
    chart = Chart(72.0 + 25.0 * count)
    rmse = np.array([each.rmse_px for each in candidates], dtype=float)
    error = 2 * np.array([each.rmse_standard_error_px or 0.0 for each in candidates], dtype=float)
    most = 1.05 * float((rmse + error).max()) or 1.0
    panel = chart.panel(Box(163.0, 9.0, 620.0, 25.0 * count), (0.0, most), (count - 0.5, -0.5))
    at = np.column_stack([rmse, np.arange(count, dtype=float)])
    chosen = np.array([each.chosen for each in candidates], dtype=bool)
    names = [f"{each.name} (chosen)" if each.chosen else each.name for each in candidates]
    panel.x_ticks(grid=True)
    panel.y_ticks([(float(row), name) for row, name in enumerate(names)], NORMAL)
    panel.error_bars(at, error, "#595959", upright=False)
    panel.dots(at[~chosen], 3.2, "#595959")
    panel.dots(at[chosen], 5.0, COL_COLOUR)
    panel.frame("cross-validated RMSE, target px")
    return chart.svg()


def profile_figure(profiles: ProfilesEntry) -> str:
    """Return an SVG of the profiles along columns, rows and heights, with bands; titles name the waves."""
    named = [("target column, px", profiles.by_column, "column")]
    named += [("target row, px", profiles.by_row, "row")]
    if profiles.by_height is not None and profiles.by_height.place:
        named += [("height, m", profiles.by_height, "height")]
    chart = Chart(182.0 * len(named) + 20.0)
    spans = [_mean_and_band(part) for _, part, _ in named]
    limits = _span_of(*(mean + sign * band for mean, band in spans for sign in (1, -1)))
    for number, ((label, part, along), (mean, band)) in enumerate(zip(named, spans, strict=True)):
        place = np.array(part.place, dtype=float)
        across = (float(place.min()), float(place.max())) if len(place) > 1 else (0.0, 1.0)
        panel = chart.panel(Box(76.0, 32.0 + 182.0 * number, 730.0, 108.0), across, limits)
        for axis, (_, colour) in enumerate(AXES):
            around = np.r_[(mean - band)[:, axis], (mean + band)[::-1, axis]]
            panel.area(np.r_[place, place[::-1]], around, colour, 0.2)
            panel.line(place, mean[:, axis], colour)
        panel.across(0.0, "#666")
        panel.x_ticks()
        panel.y_ticks()
        panel.frame(label, "displ., px", wave_text(profiles, along))
    entries = [
        (f'<path d="M-8 0H8" stroke="{colour}" stroke-width="1.6"/>', f"in {name}") for name, colour in AXES
    ]
    chart.legend(entries, 806.0, 14.0)
    return chart.svg()


def _mean_and_band(part: Profile) -> tuple[Float64, Float64]:
    """Return the (n, 2) means of a profile and the halves of their bands."""
    mean, band = (np.array(each, dtype=float).reshape(-1, 2) for each in (part.mean_px, part.band_px))
    return mean, band


def wave_text(profiles: ProfilesEntry, along: str) -> str:
    """Return a description of the significant waves `along` the "column", "row" or "height"."""
    if along == "height":
        return "By height"
    found = [each for each in profiles.waves if each.along == along and each.significant]
    if not found:
        return f"Along the {along}s: no wave beyond chance"
    waves = (f"{each.amplitude_px:.3f} px in {each.of}, period {each.period_px:.0f} px" for each in found)
    return f"Along the {along}s: jitter of " + "; ".join(waves)


TREND_BINS: Final = 12
"""Number of bins of a trend."""
MIN_IN_BIN = 5
"""Least number of values in a bin for its mean to be drawn."""
TREND_POINTS: Final = 1500
"""Largest number of points that are drawn; of more every n-th is."""


def trend_figure(
    table: TiePointTable, target_shape: tuple[int, int], heights_m: Float64 | None = None
) -> str:
    """Return an SVG of the residuals in column and in row against position, with the means of bins.

    The table holds fit and check points of a target of the `target_shape` (rows, cols). The (n,) `heights_m`
    of the ground at the points, from the elevation model, are NaN where unknown.
    """
    rows, cols = target_shape
    against = [("target column, px", table.target_px[:, 0], (0.0, float(cols)))]
    against += [("target row, px", table.target_px[:, 1], (0.0, float(rows)))]
    if heights_m is not None and np.isfinite(heights_m).any():
        low, high = float(np.nanmin(heights_m)), float(np.nanmax(heights_m))
        against += [("height, m", heights_m, (low, max(high, low + 1.0)))]
    chart = Chart(346.0)
    limit = float(np.percentile(np.abs(table.residual_px), 99)) * 1.1 or 1.0
    width = (WIDTH_PX - 74.0 - 8.0 - 22.0 * (len(against) - 1)) / len(against)
    for across, (label, places, span) in enumerate(against):
        for down, (name, colour) in enumerate(AXES):
            box = Box(74.0 + across * (width + 22.0), 8.0 + 148.0 * down, width, 138.0)
            panel = chart.panel(box, span, (-limit, limit))
            _trend(panel, places, table.residual_px[:, down], colour)
            if down:
                panel.x_ticks()
            if not across:
                panel.y_ticks()
            panel.frame(label if down else "", "" if across else f"in {name}, px")
    return chart.svg()


def _trend(panel: Panel, places: Float64, values: Float64, colour: str) -> None:
    every = math.ceil(len(places) / TREND_POINTS) or 1
    panel.dots(np.column_stack([places, values])[::every], 1.2, colour, 0.45)
    panel.across(0.0, "#666")
    middles, means, errors = bin_means(places, values, panel.x_limits)
    at = np.column_stack([middles, means])
    panel.error_bars(at, 2 * errors, "#000")
    panel.line(middles, means, "#000", 1.0)
    panel.dots(at, 1.8, "#000")


def bin_means(
    places: Float64, values: Float64, span: tuple[float, float]
) -> tuple[Float64, Float64, Float64]:
    """Return the middles of the bins with enough values, the means, and their standard errors, (m,) arrays.

    The `span` of the (n,) `places`, px or metres, is divided into `TREND_BINS` bins. The (n,) `values` may be
    NaN.
    """
    low, high = span
    known = np.isfinite(places) & np.isfinite(values)
    places, values = places[known], values[known]
    index = np.clip(((places - low) * TREND_BINS / (high - low)).astype(int), 0, TREND_BINS - 1)
    count = np.bincount(index, minlength=TREND_BINS)
    enough = count >= MIN_IN_BIN
    safe = np.maximum(count, 1)
    mean = np.bincount(index, values, TREND_BINS) / safe
    variance = np.bincount(index, (values - mean[index]) ** 2, TREND_BINS) / np.maximum(count - 1, 1)
    middles = low + (np.arange(TREND_BINS) + 0.5) * (high - low) / TREND_BINS
    return middles[enough], mean[enough], np.sqrt(variance / safe)[enough]


def errors_figure(proof: Proof) -> str:
    """Return an SVG of the errors as a point cloud with the circle of CE90, and the mean error by phase."""
    chart = Chart(307.0)
    errors = np.array([error for point in proof.map for error in point.errors_px]).reshape(-1, 2)
    limit = max(float(np.percentile(np.abs(errors), 99)) * 1.1, 1.2 * proof.ce90_px)
    cloud = chart.panel(Box(70.0, 31.0, 224.0, 224.0), (-limit, limit), (limit, -limit))
    cloud.dots(errors, 1.2, "#737373")
    cloud.circle(proof.ce90_px, CHECK_COLOUR, 1.8)
    cloud.crosses(np.array([proof.bias_px]), 4.5, "#000", 2.0)
    cloud.frame("column, target px", "row, target px", f"errors; 90 % within {proof.ce90_px:.3f} px")
    phase = np.array([entry.phase for entry in proof.phases], dtype=float)
    means = np.array([entry.mean_px for entry in proof.phases], dtype=float).reshape(-1, 2)
    span = max(1.4 * float(np.abs(means).max(initial=0.0)), LOCKING_PX)
    along = chart.panel(Box(400.0, 31.0, 400.0, 224.0), (0.0, 1.0), (-span, span))
    edge = LOCKING_PX / 2
    along.area(np.array([0.0, 1, 1, 0]), np.array([-edge, -edge, edge, edge]), "#e6e6e6")
    along.across(0.0, "#808080")
    for axis, (_, colour) in enumerate(AXES):
        along.line(phase, means[:, axis], colour, 1.5)
        along.dots(np.column_stack([phase, means[:, axis]]), 2.4, colour)
    title = "mean error along a pixel; a wave is pixel locking"
    along.frame("fraction of the displacement, px", title=title)
    marks = [(f'<path d="M-8 0H8" stroke="{colour}" stroke-width="1.6"/>', name) for name, colour in AXES]
    chart.legend(marks, 792.0, 46.0)
    for panel in (cloud, along):
        panel.x_ticks()
        panel.y_ticks()
    return chart.svg()


def places_figure(proof: Proof, shape: tuple[int, int], backdrop: NDArray[np.uint8] | None) -> str:
    """Return an SVG of the error of each point on the reference, of `shape` (rows, cols).

    The `backdrop` has its grey values, an (m, n) array of any size.
    """
    chart, (panel,) = frame_panels(shape, backdrop, bar=True)
    at = np.array([point.reference_px for point in proof.map], dtype=float).reshape(-1, 2)
    rmse = np.array([np.sqrt(np.mean(np.sum(np.square(point.errors_px), axis=1))) for point in proof.map])
    most = float(np.percentile(rmse, 98)) or 1.0
    colours = np.array(shades(rmse, most, "viridis"))
    panel.dots(at, 3.6, "#fff")
    for colour in np.unique(colours).tolist():
        panel.dots(at[colours == colour], 3.1, colour)
    panel.bar("viridis", most, "error of one match, RMS, target px")
    panel.frame(title="where the matching errs")
    return chart.svg()


OUTCOMES: Final = {"correct": ROW_COLOUR, "refused": "#000", "incorrect": CHECK_COLOUR}
"""Colour of each outcome of a trial; refused ones are crosses, incorrect ones crosses in a ring."""
LEVEL_AXES: Final = {
    "displacement": "displacement, px",
    "rotation": "rotation, degrees",
    "noise": "noise, standard deviations",
    "clouds": "clouds, share of the target",
}
"""Labels of the levels of each difficulty."""


def trials_figure(found: Sensitivity) -> str:
    """Return an SVG of the number of tie points of a part of the pair by the level of each difficulty."""
    chart = Chart(221.0)
    every = [each.points for limit in found.limits for each in limit.trials]
    most = max(found.points, *every, 1)
    for number, limit in enumerate(found.limits):
        levels = np.array([each.level for each in limit.trials], dtype=float)
        points = np.array([each.points for each in limit.trials], dtype=float)
        box = Box(66.0 + 190.0 * number, 31.0, 160.0, 137.0)
        panel = chart.panel(box, (0.0, 1.08 * float(levels[-1])), (0.0, 1.1 * most))
        if limit.failed is not None:
            right = 2 * float(levels[-1])
            ends = np.array([limit.failed, right, right, limit.failed])
            panel.area(ends, np.array([0.0, 0, 2 * most, 2 * most]), "#e6e6e6")
        panel.across(found.points, "#808080", 0.8, "1 3")
        panel.line(levels, points, "#b3b3b3", 1.0)
        for outcome, colour in OUTCOMES.items():
            some = np.array([each.outcome == outcome for each in limit.trials], dtype=bool)
            at = np.column_stack([levels, points])[some]
            if outcome == "correct":
                panel.dots(at, 3.5, colour)
            else:
                panel.crosses(at, 3.5, colour, 2.0)
            if outcome == "incorrect":
                panel.rings(at, 6.0, colour)
        panel.x_ticks()
        if not number:
            panel.y_ticks()
        panel.frame(LEVEL_AXES[limit.name], "" if number else "tie points")
    text = "what a part of the pair tolerates (dot: right, x: refused, x in a ring: wrong; dots: as it lies)"
    chart.text(66.0, 20.0, text, LARGE)
    return chart.svg()


@dataclass(frozen=True, slots=True, eq=False)
class TimeLine:
    """A time series of n displacements, as it is drawn."""

    days: NDArray[np.datetime64]
    moved_px: Float64
    """(n, 2) displacements (col, row)."""
    sigma_px: Float64
    """(n,) their standard deviations along an axis."""
    expected_px: Float64
    """(n, 2) displacements that the model predicts; NaN where there is no model."""
    outliers: Bool
    """(n,) displacements that it does not explain; drawn hollow, and at the edge if they lie outside."""
    steps: Sequence[int]
    """Number of the first image after each step."""
    span: tuple[np.datetime64, np.datetime64]
    """First and last day that are shown."""


def time_line_figure(line: TimeLine) -> str:
    """Return an SVG of a series, columns above rows, with its model and its steps."""
    chart = Chart(374.0)
    days = line.days.astype("datetime64[D]").astype(float)
    first, last = (day.astype("datetime64[D]") for day in line.span)
    margin = (last - first) // 50 + np.timedelta64(1, "D")
    limits = float((first - margin).astype(int)), float((last + margin).astype(int))
    good, size = ~line.outliers, 2.4 if len(days) <= 100 else 1.5
    for axis, (name, colour) in enumerate(AXES):
        low, high = _span_of(line.expected_px[:, axis], line.moved_px[good, axis])
        panel = chart.panel(Box(76.0, 14.0 + 168.0 * axis, 730.0, 142.0), limits, (low, high))
        shown = np.column_stack([days, np.clip(line.moved_px[:, axis], low, high)])
        panel.across(0.0, "#999")
        panel.error_bars(shown[good], line.sigma_px[good], "#bfbfbf")
        panel.dots(shown[good], size, colour)
        panel.rings(shown[~good], size + 1.2, "#000", 1.0)
        for begin, end in pairwise([0, *line.steps, len(days)]):
            panel.line(days[begin:end], line.expected_px[begin:end, axis], "#000")
        for at in line.steps:
            panel.up(float(days[at]), CHECK_COLOUR, 1.5, "5 3")
        panel.x_ticks(day_ticks(first, last))
        panel.y_ticks()
        panel.frame("", f"{name}, px")
    return chart.svg()


def _span_of(*values: Float64) -> tuple[float, float]:
    """Return the limits of an axis that shows all finite values."""
    every = np.concatenate(values)
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    margin = 0.12 * max(high - low, 0.05)
    return low - margin, high + margin


def motion_figure(
    velocity_px: Float64, regions: NDArray[np.integer[Any]], cell_px: float, shape: tuple[int, int]
) -> tuple[str, tuple[float, float, float, float]]:
    """Return an SVG of the speed of the ground, with arrows where it moves, and the box of the map in it.

    The box is (left, top, width, height) in shares of the picture. The (rows, cols, 2) `velocity_px` (col,
    row), px a year, are those of square cells, and the (rows, cols) `regions` are above 0 where they move;
    the frame has the `shape` (rows, cols).
    """
    chart, (panel,) = frame_panels(shape, of="frame", bar=True)
    box = panel.box
    cells = Box(
        box.left,
        box.top,
        box.width * regions.shape[1] * cell_px / shape[1],
        box.height * regions.shape[0] * cell_px / shape[0],
    )
    speed = np.hypot(*np.moveaxis(velocity_px, 2, 0))
    known = np.isfinite(speed)
    most = float(speed[known].max(initial=0.0)) or 1.0
    grey = np.full(3, 230, np.uint8)
    map_panel = chart.panel(cells, (0.0, regions.shape[1] * cell_px), (regions.shape[0] * cell_px, 0.0))
    map_panel.picture(np.where(known[..., None], coloured(speed, 0.0, most, "heat"), grey))
    row, col = np.nonzero(regions)
    if len(row):
        at = np.asarray(np.column_stack([col, row]) + 0.5, np.float64) * cell_px
        moving = velocity_px[row, col]
        draw_arrows(panel, at, moving, moving, max(shape))
    panel.bar("heat", most, "speed, px of the frame a year")
    panel.frame(title="motion of the ground; grey: too few images tell")
    height = chart.height
    return chart.svg(), (box.left / WIDTH_PX, box.top / height, box.width / WIDTH_PX, box.height / height)
