"""The page of a trend: a chart of each series."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from pcwlad_geo.multi.pages import environment
from pcwlad_geo.report.charts import span_of
from pcwlad_geo.report.time_lines import ErrorLine, error_line_figure


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
class Chart:
    """The chart of a series."""

    series: PairSeries
    picture: str
    """An SVG."""
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


def render(result: Trend) -> str:
    """Return the text of `trend.html`."""
    moments = [moment for series in result.series for moment in series.moments]
    days = np.array([moment.date[:10] for moment in moments], "datetime64[D]")
    values = np.array([value for moment in moments for value in (*moment.mean_px, moment.ce90_px or 0.0)])
    span, limits_px = (days.min(), days.max()), span_of(np.append(values, 0.0))
    charts = [_chart(series, span, limits_px) for series in result.series]
    return (
        environment()
        .get_template("trend.html.j2")
        .render(
            result=result,
            charts=charts,
            risen=[chart for chart in charts if chart.risen],
            first=str(days.min()),
            last=str(days.max()),
            dated_by_file=any(moment.dated_by == "file" for moment in moments),
        )
    )


def has_risen(values: Sequence[float], factor: float = 1.5) -> bool:
    """Whether the last value is above all before it, and `factor` times above their median."""
    if len(values) < 4:
        return False
    return values[-1] > max(*values[:-1], factor * median(values[:-1]))


def _chart(
    series: PairSeries, span: tuple[np.datetime64, np.datetime64], limits_px: tuple[float, float]
) -> Chart:
    moments = series.moments
    values = [moment.ce90_px for moment in moments if moment.ce90_px is not None]
    line = ErrorLine(
        np.array([moment.date[:10] for moment in moments], "datetime64[D]"),
        np.array([moment.mean_px for moment in moments]),
        np.array([moment.ce90_px for moment in moments], np.float64),
        span,
        limits_px,
    )
    return Chart(
        series=series,
        picture=error_line_figure(line),
        ce90_latest=moments[-1].ce90_px,
        ce90_median=median(values) if values else None,
        risen=has_risen(values),
    )
