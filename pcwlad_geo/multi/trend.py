"""Trends: the figures of many reports over time, read, sorted and drawn on one page."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from statistics import median
from typing import Any, Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore
from pcwlad_geo.limits import COORDINATE, TREND_FIGURES, check_count
from pcwlad_geo.multi.pages import environment
from pcwlad_geo.multi.qa_result import QaNumbers
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.raster.file_tree import file_name
from pcwlad_geo.report.content import Report
from pcwlad_geo.text import csv_of, mismatch, read_json
from pcwlad_geo.types import PathLike

NAMES: Final = {"numbers": "trend.json", "table": "trend.csv", "report": "trend.html"}
"""File names of the outputs in OUT_DIR."""
COLUMNS: Final = (
    *("series", "kind", "date", "dated_by", "report"),
    *("n", "mean_col_px", "mean_row_px", "ce90_px", "passed"),
)
"""Columns of trend.csv."""
_DAMAGED: Final = (InputError, OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError)
"""What a damaged report raises."""
_DATE: Final = re.compile(
    r"(?<!\d)((?:19|20)\d\d)(-?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])(?:T\d{6})?(?!\d)"
)
_ANY_DATE: Final = re.compile(
    r"(?:^|[_\-. ])(?:(?:19|20)\d{6}(?:T\d{6})?|(?:19|20)\d\d-\d\d-\d\d)(?=$|[_\-. ])"
)


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


def trend(
    folder: PathLike,
    *,
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
) -> Trend:
    """Write a page with CE90 and mean displacement over time from the reports below a folder.

    Raises `InputError` if there is no such folder, or no report with figures in it, and `OutputError` if the
    page cannot be written.

    Parameters
    ----------
    folder : path
        Every `report.json` and `qa.json` in it, and in folders below, is read.
    out_dir : path, optional
        Output folder; ``<name of the folder>_trend`` in the working folder by default.
    overwrite : bool
        Replace an earlier trend in `out_dir`.
    on_event : callable
        Receives `Progress` and `Warned` events.
    """
    top = Path(folder)
    if not top.is_dir():
        raise InputError(f"{top} is no folder: give the one that holds the reports")
    files = sorted(
        file
        for name in ("report.json", "qa.json")
        for file in top.rglob(name)
        # not those of a run in progress
        if not any(part.startswith(".") for part in file.relative_to(top).parts)
    )
    found: dict[tuple[str, str], list[Moment]] = {}
    skipped, held = [], 0
    for number, file in enumerate(files):
        on_event(Progress("reading", number, len(files)))
        moments = _moments(file, top)
        held += len(moments)
        check_count(str(top), held, TREND_FIGURES, "pairs in its reports")
        if not moments:
            skipped.append(str(file.relative_to(top)))
            on_event(Warned(f"{file} holds no figures: it is left out"))
        for kind, name, moment in moments:
            found.setdefault((kind, name), []).append(moment)
    on_event(Progress("reading", len(files), len(files)))
    if not found:
        raise InputError(
            f"{top} holds no report.json or qa.json with figures: give a folder of finished reports"
        )
    series = tuple(
        PairSeries(name, kind, tuple(sorted(moments, key=lambda each: (each.date, each.report))))
        for (kind, name), moments in sorted(found.items())
    )
    return _write(top, len(files) - len(skipped), series, skipped, trend_folder(top, out_dir), overwrite)


def trend_folder(folder: PathLike, out_dir: PathLike | None) -> Path:
    """Return the output folder: `out_dir`, or by default one named after `folder`."""
    if out_dir:
        return Path(out_dir)
    name = Path(os.path.abspath(folder)).name  # noqa: PTH100  # resolve() would follow a symbolic link
    return Path(f"{name or 'reports'}_trend")


def date_in(name: str) -> str | None:
    """Return the first date in a file name, ISO 8601: acquisition dates precede processing dates."""
    match = _DATE.search(name)
    return f"{match[1]}-{match[3]}-{match[4]}" if match else None


def without_dates(name: str) -> str:
    """Return a name without its dates, which is the same for a band on every date."""
    return _ANY_DATE.sub("", name).strip("_-. ") or name


def _moments(file: Path, top: Path) -> list[tuple[str, str, Moment]]:
    """Return kind, series and figures of the entries of a report."""
    try:
        report = read_json(file)
        if not isinstance(report, dict) or "pcwlad-geo" not in report["versions"]:
            return []
        if (wrong := mismatch(report, QaNumbers if file.name == "qa.json" else Report)) is not None:
            raise ValueError(wrong)
        entries = list((_of_qa if file.name == "qa.json" else _of_registration)(report, file, top))
        for _, _, moment in entries:
            _check_moment(moment)
    except _DAMAGED:  # of another program, too
        return []
    return entries


def _check_moment(moment: Moment) -> None:
    """Raise `TypeError` or `ValueError` if a figure of a damaged report cannot be drawn."""
    numbers = [moment.n, *moment.mean_px, *([] if moment.ce90_px is None else [moment.ce90_px])]
    if not all(abs(number) <= COORDINATE for number in numbers):
        raise ValueError("a figure is not finite")
    seconds_of(moment.date)


def _of_qa(report: Mapping[str, Any], file: Path, top: Path) -> Iterator[tuple[str, str, Moment]]:
    stems = {band["name"]: Path(band["path"]).stem for band in report["bands"]}
    for pair in report["pairs"]:
        px = pair["displacement"]["px"]
        if px is None:
            continue
        ends = [pair["reference"], pair["target"]]
        date, by = _date([stems[ends[1]], stems[ends[0]]], file, report["created"])
        mean = (px["col"]["mean"], px["row"]["mean"])
        moment = Moment(
            date, by, str(file.relative_to(top)), pair["n"], mean, px["radial"]["ce90"], pair["passed"]
        )
        yield "qa", " – ".join(map(without_dates, ends)), moment


def _of_registration(report: Mapping[str, Any], file: Path, top: Path) -> Iterator[tuple[str, str, Moment]]:
    if report["displacement_px"] is None or report["status"] == "rejected":
        return
    ends = [report["reference"], report["target"]]
    stems = [Path(file_name(end["path"])).stem for end in ends]
    names = [
        without_dates(stem) + (f" band {end['band']}" if end["band_count"] > 1 else "")
        for stem, end in zip(stems, ends, strict=True)
    ]
    date, by = _date(stems[::-1], file, None)
    accuracy = report["accuracy"]
    at = accuracy["check"]["px"] or accuracy["fit"]["px"]
    mean = tuple(report["displacement_px"]["mean"])
    counts = report["tie_points"]
    kept = counts["total"] - counts["rejected"]
    moment = Moment(date, by, str(file.relative_to(top)), kept, mean, at["ce90"] if at else None, None)
    yield "register", " – ".join(names), moment


def _date(stems: Sequence[str], file: Path, created: str | None) -> tuple[str, str]:
    """Return the date of the images, or else of the report, and its origin."""
    for stem in stems:
        if found := date_in(stem):
            return found, "name"
    if created:
        return created, "file"
    written = datetime.fromtimestamp(file.stat().st_mtime, timezone.utc)
    return written.isoformat(timespec="seconds"), "file"


def _write(
    top: Path,
    reports: int,
    series: tuple[PairSeries, ...],
    skipped: Sequence[str],
    out_dir: Path,
    overwrite: bool,
) -> Trend:
    from pcwlad_geo.report.content import to_json, versions

    with OutputFolder(out_dir, overwrite=overwrite, results=NAMES["numbers"]) as folder:
        paths = {kind: folder.final_path(name) for kind, name in NAMES.items()}
        found = Trend(top, reports, series, tuple(skipped), paths)
        numbers = {
            "schema_version": 1,
            "kind": "trend",
            "folder": str(top),
            "reports": reports,
            "skipped": list(skipped),
            "series": series,
            "versions": versions(),
            "outputs": sorted(NAMES.values()),
        }
        texts = {"table": _table(series), "report": render(found), "numbers": to_json(numbers)}
        with folder.writing():
            for kind, text in texts.items():
                place = folder.path(NAMES[kind])
                place.write_text(text, encoding="utf-8", errors="backslashreplace", newline="")
        folder.commit()
    return found


def _table(series: Sequence[PairSeries]) -> str:
    rows = [
        (each.name, each.kind, at.date, at.dated_by, at.report, at.n, *at.mean_px, at.ce90_px, at.passed)
        for each in series
        for at in each.moments
    ]
    return csv_of([dict(zip(COLUMNS, row, strict=True)) for row in rows])


WIDTH_PX: Final = 520.0
"""Width of a chart, CSS px."""
HEIGHT_PX: Final = 200.0
"""Height of a chart, CSS px."""
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 44.0, 10.0, 10.0, 24.0
"""Margins of the plot, CSS px."""
RISEN_FACTOR: Final = 1.5
"""Factor by which the latest CE90 must exceed the median of those before to be marked."""


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


def render(found: Trend) -> str:
    """Return the text of `trend.html`."""
    moments = [moment for series in found.series for moment in series.moments]
    times = [seconds_of(moment.date) for moment in moments]
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
    """Whether the last value is above all before it, and `RISEN_FACTOR` times above their median."""
    if len(values) < 4:
        return False
    return values[-1] > max(*values[:-1], RISEN_FACTOR * median(values[:-1]))


def _chart(series: PairSeries, x: Axis, y: Axis) -> Chart:
    at = [(x(seconds_of(moment.date)), moment) for moment in series.moments]
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


def seconds_of(date: str) -> float:
    """Return an ISO 8601 date or time in seconds since 1970; a date without a time is midnight UTC.

    Raises `ValueError` if it is none.
    """
    parsed = datetime.fromisoformat(date)
    return (parsed if parsed.tzinfo else parsed.replace(tzinfo=timezone.utc)).timestamp()
