"""Figures of a time series as SVG: displacements by date, with a model and its steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.report.charts import (
    AXES,
    CHECK_COLOUR,
    Box,
    Chart,
    day_ticks,
    span_of,
)
from pcwlad_geo.types import Bool, Float64


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
    limits = _day_limits(line.span)
    good, size = ~line.outliers, 2.4 if len(days) <= 100 else 1.5
    for axis, (name, colour) in enumerate(AXES):
        low, high = span_of(line.expected_px[:, axis], line.moved_px[good, axis])
        panel = chart.panel(Box(76.0, 14.0 + 168.0 * axis, 730.0, 142.0), limits, (low, high))
        places = np.column_stack([days, np.clip(line.moved_px[:, axis], low, high)])
        panel.across(0.0, "#999")
        panel.error_bars(places[good], line.sigma_px[good], "#bfbfbf")
        panel.dots(places[good], size, colour)
        panel.rings(places[~good], size + 1.2, "#000", 1.0)
        for begin, end in pairwise([0, *line.steps, len(days)]):
            panel.line(days[begin:end], line.expected_px[begin:end, axis], "#000")
        for at in line.steps:
            panel.up(float(days[at]), CHECK_COLOUR, 1.5, "5 3")
        panel.x_ticks(day_ticks(*line.span))
        panel.y_ticks()
        panel.frame("", f"{name}, px")
    return chart.svg()


@dataclass(frozen=True, slots=True, eq=False)
class ErrorLine:
    """The errors of a pair in n reports, as they are drawn."""

    days: NDArray[np.datetime64]
    mean_px: Float64
    """(n, 2) mean displacements (col, row)."""
    ce90_px: Float64
    """(n,) CE90; NaN where it is not known."""
    span: tuple[np.datetime64, np.datetime64]
    """First and last day that are shown."""
    limits_px: tuple[float, float]
    """Lowest and highest error that are shown."""


def error_line_figure(line: ErrorLine) -> str:
    """Return an SVG of CE90 and of the mean displacement in columns and rows by date."""
    chart = Chart(236.0)
    panel = chart.panel(Box(76.0, 26.0, 730.0, 172.0), _day_limits(line.span), line.limits_px)
    panel.across(0.0, "#999")
    days, entries = line.days.astype("datetime64[D]").astype(float), []
    names = ("CE90", CHECK_COLOUR), *((f"mean, {name}", colour) for name, colour in AXES)
    for (name, colour), dash, values in zip(
        names, ("", "7 4", "2 3"), (line.ce90_px, *line.mean_px.T), strict=True
    ):
        panel.line(days, values, colour, 2.0, dash)
        panel.dots(np.column_stack([days, values]), 3.0, colour)
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        entries.append((f'<path d="M-8 0H8" stroke="{colour}" stroke-width="2"{dashes}/>', name))
    chart.legend(entries, 806.0, 14.0)
    panel.x_ticks(day_ticks(*line.span))
    panel.y_ticks()
    panel.frame("", "px of the target")
    return chart.svg()


def _day_limits(span: tuple[np.datetime64, np.datetime64]) -> tuple[float, float]:
    """Return the limits of an axis, in days since 1970, with a margin on both sides."""
    first, last = (day.astype("datetime64[D]") for day in span)
    margin = (last - first) // 50 + np.timedelta64(1, "D")
    return float((first - margin).astype(int)), float((last + margin).astype(int))
