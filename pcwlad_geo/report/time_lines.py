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
    first, last = (day.astype("datetime64[D]") for day in line.span)
    margin = (last - first) // 50 + np.timedelta64(1, "D")
    limits = float((first - margin).astype(int)), float((last + margin).astype(int))
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
        panel.x_ticks(day_ticks(first, last))
        panel.y_ticks()
        panel.frame("", f"{name}, px")
    return chart.svg()
