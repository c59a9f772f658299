"""Trends: the figures of many reports over time, read and sorted."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

from pcwlad_geo.correction.error_statistics import UnitStatistics
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.multi.pages import write_texts
from pcwlad_geo.multi.qa.numbers import QaNumbers
from pcwlad_geo.multi.watch.dates import seconds_of, without_dates
from pcwlad_geo.multi.watch.trend_page import Moment, PairSeries, Trend, render
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.names import date_in
from pcwlad_geo.raster import file_name
from pcwlad_geo.report.read_figures import read_figures
from pcwlad_geo.text import csv_of, read_json, typed
from pcwlad_geo.types import PathLike

TREND_FILES: Final = {"numbers": "trend.json", "table": "trend.csv", "report": "trend.html"}
"""File names of the outputs in OUT_DIR."""
TREND_COLUMNS: Final = (
    *("series", "kind", "date", "dated_by", "report"),
    *("n", "mean_col_px", "mean_row_px", "ce90_px", "passed"),
)
"""Columns of trend.csv."""


@dataclass(frozen=True, slots=True)
class _ReadBand:
    """What is read back of a band of a qa.json."""

    name: str
    path: str


@dataclass(frozen=True, slots=True)
class _ReadBandPair:
    """What is read back of a pair of a qa.json."""

    reference: str
    target: str
    n: int
    passed: bool | None
    displacement: Mapping[str, UnitStatistics | None]


@dataclass(frozen=True, slots=True)
class _ReadQa:
    """What is read back of a qa.json."""

    created: str
    bands: tuple[_ReadBand, ...]
    pairs: tuple[_ReadBandPair, ...]


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
    moments_of: dict[tuple[str, str], list[Moment]] = {}
    skipped, count = [], 0
    for number, file in enumerate(files):
        on_event(Progress("reading", number, len(files)))
        moments = _moments(file, top)
        count += len(moments)
        check_count(str(top), count, LIMITS.trend_figures, "pairs in its reports")
        if not moments:
            skipped.append(str(file.relative_to(top)))
            on_event(Warned(f"{file} holds no figures: it is left out"))
        for kind, name, moment in moments:
            moments_of.setdefault((kind, name), []).append(moment)
    on_event(Progress("reading", len(files), len(files)))
    if not moments_of:
        raise InputError(
            f"{top} holds no report.json or qa.json with figures: give a folder of finished reports"
        )
    series = tuple(
        PairSeries(name, kind, tuple(sorted(moments, key=lambda figures: (figures.date, figures.report))))
        for (kind, name), moments in sorted(moments_of.items())
    )
    return _write(top, len(files) - len(skipped), series, skipped, trend_folder(top, out_dir), overwrite)


def trend_folder(folder: PathLike, out_dir: PathLike | None) -> Path:
    """Return the output folder: `out_dir`, or by default one named after `folder`."""
    if out_dir:
        return Path(out_dir)
    name = Path(os.path.abspath(folder)).name  # noqa: PTH100  # resolve() would follow a symbolic link
    return Path(f"{name or 'reports'}_trend")


def _moments(file: Path, top: Path) -> list[tuple[str, str, Moment]]:
    """Return kind, series and figures of the entries of a report; none of one that is damaged."""
    read = _of_qa if file.name == "qa.json" else _of_registration
    try:
        entries = list(read(file, str(file.relative_to(top))))
        for _, _, moment in entries:
            _check_moment(moment)
    except (InputError, OSError, ValueError, LookupError, OverflowError):
        return []
    return entries


def _check_moment(moment: Moment) -> None:
    """Raise `TypeError` or `ValueError` if a figure of a damaged report cannot be drawn."""
    numbers = [moment.n, *moment.mean_px, *([] if moment.ce90_px is None else [moment.ce90_px])]
    if not all(abs(number) <= LIMITS.coordinate for number in numbers):
        raise ValueError("a figure is not finite")
    seconds_of(moment.date)


def _of_qa(file: Path, name: str) -> Iterator[tuple[str, str, Moment]]:
    report = typed(read_json(file), _ReadQa, written=QaNumbers)
    stems = {band.name: Path(band.path).stem for band in report.bands}
    for pair in report.pairs:
        if (px := pair.displacement["px"]) is None:
            continue
        ends = [pair.reference, pair.target]
        date, by = _date([stems[ends[1]], stems[ends[0]]], file, report.created)
        moment = Moment(date, by, name, pair.n, (px.col.mean, px.row.mean), px.radial.ce90, pair.passed)
        yield "qa", " – ".join(map(without_dates, ends)), moment


def _of_registration(file: Path, name: str) -> Iterator[tuple[str, str, Moment]]:
    report = read_figures(file.parent)
    if report is None or report.displacement_px is None or report.status == "rejected":
        return
    sides = [side for side in (report.reference, report.target) if side is not None]
    stems = [Path(file_name(side.path)).stem for side in sides]
    names = [
        without_dates(stem) + (f" band {side.band}" if side.band_count > 1 else "")
        for stem, side in zip(stems, sides, strict=True)
    ]
    date, by = _date(stems[::-1], file, None)
    at = report.accuracy["check"]["px"] or report.accuracy["fit"]["px"]
    accepted = report.tie_points["total"] - report.tie_points["rejected"]
    mean_px = report.displacement_px.mean
    moment = Moment(date, by, name, accepted, mean_px, None if at is None else at.ce90, None)
    yield "register", " – ".join(names), moment


def _date(stems: Sequence[str], file: Path, created: str | None) -> tuple[str, str]:
    """Return the date of the images, or else of the report, and its origin."""
    for stem in stems:
        if date := date_in(stem):
            return date, "name"
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
    from pcwlad_geo.report.json_content import to_json, versions

    with OutputFolder(out_dir, overwrite=overwrite, results=TREND_FILES["numbers"]) as folder:
        paths = {kind: folder.final_path(name) for kind, name in TREND_FILES.items()}
        result = Trend(top, reports, series, tuple(skipped), paths)
        numbers = {
            "schema_version": 1,
            "kind": "trend",
            "folder": str(top),
            "reports": reports,
            "skipped": list(skipped),
            "series": series,
            "versions": versions(),
            "outputs": sorted(TREND_FILES.values()),
        }
        texts = {"table": _table(series), "report": render(result), "numbers": to_json(numbers)}
        with folder.writing():
            write_texts(folder, TREND_FILES, texts)
        folder.commit()
    return result


def _table(series: Sequence[PairSeries]) -> str:
    rows = [
        (
            pair_series.name,
            pair_series.kind,
            at.date,
            at.dated_by,
            at.report,
            at.n,
            *at.mean_px,
            at.ce90_px,
            at.passed,
        )
        for pair_series in series
        for at in pair_series.moments
    ]
    return csv_of([dict(zip(TREND_COLUMNS, row, strict=True)) for row in rows])
