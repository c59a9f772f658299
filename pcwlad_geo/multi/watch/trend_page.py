"""The page of a trend: a chart of each series."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

from pcwlad_geo.multi.pages import environment
from pcwlad_geo.multi.watch.dates import seconds_of


@dataclass(frozen=True, slots=True)
class TrendLayout:
    """Sizes of the charts, CSS px, and what they mark."""

    width_px: float = 520.0
    height_px: float = 200.0
    margins_px: tuple[float, float, float, float] = (44.0, 10.0, 10.0, 24.0)
    """Left, right, top and bottom of the plot."""
    risen_factor: float = 1.5
    """Factor by which the latest CE90 must exceed the median of those before to be marked."""


TREND_LAYOUT: Final = TrendLayout()
"""The layout in use."""


@dataclass(frozen=True, slots=True)
class Moment:
    """The figures of one pair in one report."""

    date: str
    """ISO 8601: date of the images if their names contain it, else of the report."""
    dated_by: str
    """Origin of the date: `name` of the images, or report `file`."""
    report: str
    """Path of the report relative to the folder."""
    n: int
    mean_px: tuple[float, float]
    """Mean displacement before any correction (col, row), px of the target."""
    ce90_px: float | None
    """CE90 of the displacement (qa) or of the residual at check points (register), px of the target."""
    passed: bool | None
    """Whether the requirements of that report are met."""


@dataclass(frozen=True, slots=True)
class PairSeries:
    """One pair over time, sorted by date."""

    name: str
    kind: str
    """`qa`: displacements before any correction; `register`: CE90 after correction."""
    moments: tuple[Moment, ...]


@dataclass(frozen=True, slots=True)
class Trend:
    """The series of the reports below a folder."""

    folder: Path
    reports: int
    series: tuple[PairSeries, ...]
    skipped: tuple[str, ...]
    """Reports without figures: refused pairs, files of other programs."""
    paths: Mapping[str, Path]
    """Written files by kind."""


@dataclass(frozen=True, slots=True)
class Axis:
    """A linear scale from values to CSS px."""

    low: float
    high: float
    low_px: float
    high_px: float

    def __call__(self, value: float) -> float:
        """Return the position of a value, CSS px; the middle if the scale has no length."""
        if self.high == self.low:
            return (self.low_px + self.high_px) / 2
        share = (value - self.low) / (self.high - self.low)
        return round(self.low_px + share * (self.high_px - self.low_px), 1)


@dataclass(frozen=True, slots=True)
class Chart:
    """The chart of a series."""

    series: PairSeries
    lines: dict[str, list[tuple[float, float]]]
    """Points (x, y) of `ce90`, `col`, `row`, CSS px."""
    ce90_latest: float | None
    ce90_median: float | None
    risen: bool
    """Whether the latest CE90 is clearly above those before it."""

    @property
    def alt(self) -> str:
        """Description of the chart, as text."""
        first, last = self.series.moments[0], self.series.moments[-1]
        count = len(self.series.moments)
        ce90 = "not known" if self.ce90_latest is None else f"{self.ce90_latest:.2f} px"
        return (
            f"{self.series.name}: {count} dates, {first.date[:10]} to {last.date[:10]}, latest CE90 {ce90}, "
            f"latest mean {last.mean_px[0]:+.2f}, {last.mean_px[1]:+.2f} px"
        )


def render(result: Trend, layout: TrendLayout = TREND_LAYOUT) -> str:
    """Return the text of `trend.html`."""
    left_px, right_px, top_px, bottom_px = layout.margins_px
    right_px, bottom_px = layout.width_px - right_px, layout.height_px - bottom_px
    moments = [moment for series in result.series for moment in series.moments]
    times = [seconds_of(moment.date) for moment in moments]
    x = Axis(min(times), max(times), left_px, right_px)
    values = [value for moment in moments for value in (*moment.mean_px, moment.ce90_px or 0.0)]
    ticks = nice_ticks(min(0.0, *values), max(0.0, *values))
    y = Axis(ticks[0], ticks[-1], bottom_px, top_px)
    dates = sorted(moment.date[:10] for moment in moments)
    charts = [_chart(series, x, y, layout.risen_factor) for series in result.series]
    return (
        environment()
        .get_template("trend.html.j2")
        .render(
            result=result,
            charts=charts,
            risen=[chart for chart in charts if chart.risen],
            ticks=[(f"{tick:g}".replace("-", "−"), y(tick)) for tick in ticks],
            first=dates[0],
            last=dates[-1],
            size=(layout.width_px, layout.height_px),
            plot=(left_px, right_px, bottom_px),
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


def has_risen(values: Sequence[float], factor: float = TREND_LAYOUT.risen_factor) -> bool:
    """Whether the last value is above all before it, and `factor` times above their median."""
    if len(values) < 4:
        return False
    return values[-1] > max(*values[:-1], factor * median(values[:-1]))


def _chart(series: PairSeries, x: Axis, y: Axis, risen_factor: float) -> Chart:
    at = [(x(seconds_of(moment.date)), moment) for moment in series.moments]
    values = [moment.ce90_px for moment in series.moments if moment.ce90_px is not None]
    return Chart(
        series=series,
        lines={
            "ce90": [(place, y(moment.ce90_px)) for place, moment in at if moment.ce90_px is not None],
            "col": [(place, y(moment.mean_px[0])) for place, moment in at],
            "row": [(place, y(moment.mean_px[1])) for place, moment in at],
        },
        ce90_latest=series.moments[-1].ce90_px,
        ce90_median=median(values) if values else None,
        risen=has_risen(values, risen_factor),
    )
