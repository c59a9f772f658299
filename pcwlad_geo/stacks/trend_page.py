"""The trend's page: a small chart a pair, one scale for all, and the numbers below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from statistics import median
from typing import Final

from pcwlad_geo.stacks.page import environment
from pcwlad_geo.stacks.trend import Moment, Series, Trend

WIDTH_PX: Final = 520.0
HEIGHT_PX: Final = 200.0
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 44.0, 10.0, 10.0, 24.0
"""Margins of the plot, CSS px."""
ENOUGH: Final = 4
"""Dates from which on the latest is compared with those before."""
RISEN: Final = 1.5
"""The latest CE90 is worth a note where it is above all before it and this times their median."""


@dataclass(frozen=True, slots=True)
class Axis:
    """A linear scale from values to CSS px."""

    low: float
    high: float
    low_px: float
    high_px: float

    def __call__(self, value: float) -> float:
        """Return where a value lies; in the middle where the scale has no length."""
        if self.high == self.low:
            return (self.low_px + self.high_px) / 2
        share = (value - self.low) / (self.high - self.low)
        return round(self.low_px + share * (self.high_px - self.low_px), 1)


@dataclass(frozen=True, slots=True)
class Chart:
    """A series, drawn."""

    series: Series
    lines: dict[str, list[tuple[float, float]]]
    """Points (x, y) of `ce90`, `col`, `row`, CSS px."""
    ce90_latest: float | None
    ce90_median: float | None
    risen: bool
    """Whether the latest CE90 is well above those before it."""

    @property
    def alt(self) -> str:
        """What the chart shows, in words."""
        first, last = self.series.moments[0], self.series.moments[-1]
        count = len(self.series.moments)
        ce90 = "not known" if self.ce90_latest is None else f"{self.ce90_latest:.2f} px"
        return (
            f"{self.series.name}: {count} dates, {first.date[:10]} to {last.date[:10]}, latest CE90 {ce90}, "
            f"latest mean {last.mean_px[0]:+.2f}, {last.mean_px[1]:+.2f} px"
        )


def render(found: Trend) -> str:
    """Return the text of `trend.html`."""
    moments = [moment for series in found.series for moment in series.moments]
    times = [_time(moment) for moment in moments]
    x = Axis(min(times), max(times), LEFT_PX, WIDTH_PX - RIGHT_PX)
    values = [value for moment in moments for value in (*moment.mean_px, moment.ce90_px or 0.0)]
    ticks = nice_ticks(min(0.0, *values), max(0.0, *values))
    y = Axis(ticks[0], ticks[-1], HEIGHT_PX - BOTTOM_PX, TOP_PX)
    dates = sorted(moment.date[:10] for moment in moments)
    charts = [_chart(series, x, y) for series in found.series]
    return (
        environment()
        .get_template("trend.html.j2")
        .render(
            found=found,
            charts=charts,
            risen=[chart for chart in charts if chart.risen],
            ticks=[(f"{tick:g}".replace("-", "−"), y(tick)) for tick in ticks],
            first=dates[0],
            last=dates[-1],
            size=(WIDTH_PX, HEIGHT_PX),
            plot=(LEFT_PX, WIDTH_PX - RIGHT_PX, HEIGHT_PX - BOTTOM_PX),
            dated_by_file=any(moment.dated_by == "file" for moment in moments),
        )
    )


def nice_ticks(low: float, high: float) -> list[float]:
    """Return four to eight round values from at or below `low` to at or above `high`."""
    span = max(high - low, 0.1)
    rough = span / 5
    power = 10 ** math.floor(math.log10(rough))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(factor * power - rough))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    last = max(last, first + 1)
    return [round(number * step, 6) for number in range(first, last + 1)]


def has_risen(values: Sequence[float]) -> bool:
    """Whether the last value is above all before it, and well above their median."""
    if len(values) < ENOUGH:
        return False
    return values[-1] > max(*values[:-1], RISEN * median(values[:-1]))


def _chart(series: Series, x: Axis, y: Axis) -> Chart:
    at = [(x(_time(moment)), moment) for moment in series.moments]
    known = [moment.ce90_px for moment in series.moments if moment.ce90_px is not None]
    return Chart(
        series=series,
        lines={
            "ce90": [(place, y(moment.ce90_px)) for place, moment in at if moment.ce90_px is not None],
            "col": [(place, y(moment.mean_px[0])) for place, moment in at],
            "row": [(place, y(moment.mean_px[1])) for place, moment in at],
        },
        ce90_latest=series.moments[-1].ce90_px,
        ce90_median=median(known) if known else None,
        risen=has_risen(known),
    )


def _time(moment: Moment) -> float:
    """Return seconds; a date without a time is its midnight in UTC."""
    parsed = datetime.fromisoformat(moment.date)
    return (parsed if parsed.tzinfo else parsed.replace(tzinfo=timezone.utc)).timestamp()
