"""Graphs of the report as SVG: distributions and trends of residuals, profiles, candidate models."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.correction.jitter import Profile
from pcwlad_geo.report.charts import (
    AXES,
    CHART_WIDTH_PX,
    CHECK_COLOUR,
    COL_COLOUR,
    NORMAL,
    Box,
    Chart,
    Panel,
    span_of,
)
from pcwlad_geo.report.content import CandidateEntry, ProfilesEntry
from pcwlad_geo.report.maps import thin
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class GraphStyle:
    """How many marks and bins graphs have."""

    bars: int = 31
    """Number of bars of a histogram."""
    most_dots: int = 2000
    """Largest number of points of the scatter plot."""
    trend_bins: int = 12
    """Number of bins of a trend."""
    least_in_bin: int = 5
    """Least number of values in a bin for its mean to be drawn."""
    most_trend_dots: int = 1500
    """Largest number of points of a trend that are drawn; of more every n-th is."""


GRAPH_STYLE: Final = GraphStyle()
"""As pages draw them."""


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
    edges = np.linspace(-limit, limit, GRAPH_STYLE.bars + 1)
    counts, of_check = (
        np.histogram(np.clip(residuals, -limit, limit), edges)[0] for residuals in (values, check)
    )
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
    chart.legend(entries, box.x + box.width, box.y - 9)
    panel.x_ticks()
    panel.y_ticks()
    return panel


def _circle(chart: Chart, box: Box, table: TiePointTable, ce90_px: float, limit: float) -> None:
    fit, check = thin(table.select("fit"), GRAPH_STYLE.most_dots), table.select("check")
    panel = chart.panel(box, (-limit, limit), (limit, -limit))
    panel.across(0.0, "#999", 0.7)
    panel.up(0.0, "#999", 0.7)
    panel.dots(fit.residual_px, 1.2, "#8c8c8c")
    panel.rings(check.residual_px, 2.8, CHECK_COLOUR, 1.2)
    panel.circle(ce90_px, "#000")
    panel.x_ticks()
    panel.y_ticks()
    panel.frame("residual in column, px", "in row, px", f"CE90 {ce90_px:.3f} px")


def candidate_figure(candidates: Sequence[CandidateEntry]) -> str:
    """Return an SVG of the cross-validated RMSE of each model with two standard errors.

    Its rows are the `candidates` in their order, all with an RMSE.
    """
    count = len(candidates)
    chart = Chart(72.0 + 25.0 * count)
    rmse = np.array([candidate.rmse_px for candidate in candidates], dtype=float)
    error = 2 * np.array([candidate.rmse_standard_error_px or 0.0 for candidate in candidates], dtype=float)
    most = 1.05 * float((rmse + error).max()) or 1.0
    panel = chart.panel(Box(163.0, 9.0, 620.0, 25.0 * count), (0.0, most), (count - 0.5, -0.5))
    at = np.column_stack([rmse, np.arange(count, dtype=float)])
    is_chosen = np.array([candidate.chosen for candidate in candidates], dtype=bool)
    names = [f"{candidate.name} (chosen)" if candidate.chosen else candidate.name for candidate in candidates]
    panel.x_ticks(grid=True)
    panel.y_ticks([(float(row), name) for row, name in enumerate(names)], NORMAL)
    panel.error_bars(at, error, "#595959", upright=False)
    panel.dots(at[~is_chosen], 3.2, "#595959")
    panel.dots(at[is_chosen], 5.0, COL_COLOUR)
    panel.frame("cross-validated RMSE, target px")
    return chart.svg()


def profile_figure(profiles: ProfilesEntry) -> str:
    """Return an SVG of the profiles along columns, rows and heights, with bands; titles name the waves."""
    parts = [("target column, px", profiles.by_column, "column")]
    parts += [("target row, px", profiles.by_row, "row")]
    if profiles.by_height is not None and profiles.by_height.place:
        parts += [("height, m", profiles.by_height, "height")]
    chart = Chart(182.0 * len(parts) + 20.0)
    spans = [_mean_and_band(part) for _, part, _ in parts]
    limits = span_of(*(mean + sign * band for mean, band in spans for sign in (1, -1)))
    for number, ((label, part, along), (mean, band)) in enumerate(zip(parts, spans, strict=True)):
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
    mean, band = (np.array(values, dtype=float).reshape(-1, 2) for values in (part.mean_px, part.band_px))
    return mean, band


def wave_text(profiles: ProfilesEntry, along: str) -> str:
    """Return a description of the significant waves `along` the "column", "row" or "height"."""
    if along == "height":
        return "By height"
    waves = [wave for wave in profiles.waves if wave.along == along and wave.significant]
    if not waves:
        return f"Along the {along}s: no wave beyond chance"
    texts = (f"{wave.amplitude_px:.3f} px in {wave.of}, period {wave.period_px:.0f} px" for wave in waves)
    return f"Along the {along}s: jitter of " + "; ".join(texts)


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
    width = (CHART_WIDTH_PX - 74.0 - 8.0 - 22.0 * (len(against) - 1)) / len(against)
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
    every = math.ceil(len(places) / GRAPH_STYLE.most_trend_dots) or 1
    panel.dots(np.column_stack([places, values])[::every], 1.2, colour, 0.45)
    panel.across(0.0, "#666")
    middles, means, errors = bin_means(places, values, panel.x_limits)
    at = np.column_stack([middles, means])
    panel.error_bars(at, 2 * errors, "#000")
    panel.line(middles, means, "#000", 1.0)
    panel.dots(at, 1.8, "#000")


def bin_means(
    places: Float64, values: Float64, span: tuple[float, float], style: GraphStyle = GRAPH_STYLE
) -> tuple[Float64, Float64, Float64]:
    """Return the middles of the bins with enough values, the means, and their standard errors, (m,) arrays.

    The `span` of the (n,) `places`, px or metres, is divided into the bins of the `style`. The (n,)
    `values` may be NaN.
    """
    (low, high), bins = span, style.trend_bins
    finite = np.isfinite(places) & np.isfinite(values)
    places, values = places[finite], values[finite]
    index = np.clip(((places - low) * bins / (high - low)).astype(int), 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    enough = count >= style.least_in_bin
    safe = np.maximum(count, 1)
    mean = np.bincount(index, values, bins) / safe
    variance = np.bincount(index, (values - mean[index]) ** 2, bins) / np.maximum(count - 1, 1)
    middles = low + (np.arange(bins) + 0.5) * (high - low) / bins
    return middles[enough], mean[enough], np.sqrt(variance / safe)[enough]
