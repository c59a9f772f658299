"""How the figures of many reports went over time: read, put in order, drawn on one page."""

from __future__ import annotations

import csv
import io
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.csv_cells import cell
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.source import file_name
from pcwlad_geo.registration.progress import EventCallback, Progress, Warned, ignore
from pcwlad_geo.staging import OutputFolder

PathLike = str | os.PathLike[str]

NAMES: Final = {"numbers": "trend.json", "table": "trend.csv", "report": "trend.html"}
"""File names of the outputs in OUT_DIR."""
SCHEMA_VERSION: Final = 1
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
    """ISO 8601: of the images where their names tell, else when the report was written."""
    dated_by: str
    """`name` or `file`."""
    report: str
    """Path below the folder."""
    n: int
    mean_px: tuple[float, float]
    """Displacement as found, (col, row), px of the target."""
    ce90_px: float | None
    """Of the displacement (qa), or of the residual at check points (register)."""
    passed: bool | None
    """Against the requirements of that report."""


@dataclass(frozen=True, slots=True)
class Series:
    """One pair over time, in the order of the dates."""

    name: str
    kind: str
    """`qa`: displacements as found; `register`: CE90 after correction."""
    moments: tuple[Moment, ...]


@dataclass(frozen=True, slots=True)
class Trend:
    """What was found below a folder."""

    folder: Path
    reports: int
    series: tuple[Series, ...]
    skipped: tuple[str, ...]
    """Reports that hold no figures: refused pairs, files of other programs."""
    paths: Mapping[str, Path]
    """Files written, by what they are."""


def trend(
    folder: PathLike,
    *,
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
) -> Trend:
    """Write a page of how CE90 and mean displacement went over the reports below a folder.

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

    Raises
    ------
    InputError
        If there is no such folder, or no report with figures in it.
    OutputError
        If the page cannot be written.
    """
    top = Path(folder)
    if not top.is_dir():
        raise InputError(f"{top} is no folder: give the one that holds the reports")
    files = sorted(
        file for name in ("report.json", "qa.json") for file in top.rglob(name) if _is_plain(file, top)
    )
    found: dict[tuple[str, str], list[Moment]] = {}
    skipped = []
    for number, file in enumerate(files):
        on_event(Progress("reading", number, len(files)))
        moments = _moments(file, top)
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
        Series(name, kind, tuple(sorted(moments, key=lambda each: (each.date, each.report))))
        for (kind, name), moments in sorted(found.items())
    )
    return _write(top, len(files) - len(skipped), series, skipped, trend_folder(top, out_dir), overwrite)


def trend_folder(folder: PathLike, out_dir: PathLike | None) -> Path:
    """Return the output folder."""
    if out_dir:
        return Path(out_dir)
    name = Path(os.path.abspath(folder)).name  # noqa: PTH100  # resolve() would follow a symbolic link
    return Path(f"{name or 'reports'}_trend")


def date_in(name: str) -> str | None:
    """Return the first date in a file name, ISO 8601: an acquisition comes before a processing date."""
    match = _DATE.search(name)
    return f"{match[1]}-{match[3]}-{match[4]}" if match else None


def without_dates(name: str) -> str:
    """Return a name that the same band has on every date."""
    return _ANY_DATE.sub("", name).strip("_-. ") or name


def _is_plain(file: Path, top: Path) -> bool:
    """Whether a file is no part of a run that is still being written."""
    return not any(part.startswith(".") for part in file.relative_to(top).parts)


def _moments(file: Path, top: Path) -> list[tuple[str, str, Moment]]:
    """Return kind, series and figures of what a report holds."""
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(report, dict) or "pcwlad-geo" not in report["versions"]:
            return []
        return list((_of_qa if file.name == "qa.json" else _of_registration)(report, file, top))
    except (OSError, ValueError, KeyError, TypeError):  # of another program, or damaged
        return []


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
    """Return the date of the images, else of the report."""
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
    series: tuple[Series, ...],
    skipped: Sequence[str],
    out_dir: Path,
    overwrite: bool,
) -> Trend:
    from pcwlad_geo.report.summary import plain, to_json, versions  # slow to load
    from pcwlad_geo.stacks.trend_page import render

    with OutputFolder(out_dir, overwrite=overwrite, results=NAMES["numbers"]) as folder:
        paths = {kind: folder.final_path(name) for kind, name in NAMES.items()}
        found = Trend(top, reports, series, tuple(skipped), paths)
        numbers = {
            "schema_version": SCHEMA_VERSION,
            "kind": "trend",
            "folder": str(top),
            "reports": reports,
            "skipped": list(skipped),
            "series": [plain(asdict(each)) for each in series],
            "versions": versions(),
            "outputs": sorted(NAMES.values()),
        }
        texts = {"table": _table(series), "report": render(found), "numbers": to_json(numbers)}
        with folder.writing():
            for kind, text in texts.items():
                folder.path(NAMES[kind]).write_text(text, encoding="utf-8", newline="")
        folder.commit()
    return found


def _table(series: Sequence[Series]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        [
            "series",
            "kind",
            "date",
            "dated_by",
            "report",
            "n",
            "mean_col_px",
            "mean_row_px",
            "ce90_px",
            "passed",
        ]
    )
    words = {None: "", True: "yes", False: "no"}
    for each in series:
        for at in each.moments:
            writer.writerow(
                [
                    *map(cell, (each.name, each.kind, at.date, at.dated_by, at.report)),
                    at.n,
                    *at.mean_px,
                    at.ce90_px,
                    words[at.passed],
                ]
            )
    return text.getvalue()
