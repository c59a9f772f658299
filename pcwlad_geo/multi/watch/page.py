"""The files of a watch: findings in words, the page, the table and the numbers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import Final

import numpy as np

from pcwlad_geo.estimation.time_series import SERIES
from pcwlad_geo.multi.pages import write_texts
from pcwlad_geo.multi.watch.ground_motion import MotionRaster, page_data, write_motion
from pcwlad_geo.multi.watch.numbers import WatchNumbers
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.report.maps import motion_figure
from pcwlad_geo.report.page_templates import page_environment, page_script
from pcwlad_geo.report.time_lines import TimeLine, time_line_figure
from pcwlad_geo.text import csv_of

WATCH_FILES: Final = {
    "numbers": "watch.json",
    "table": "watch.csv",
    "report": "watch.html",
    "motion": "motion.tif",
}
"""File names of the outputs by kind."""
WATCH_COLUMNS: Final = (
    *("name", "series", "date", "shift_col_px", "shift_row_px", "sigma_px"),
    *("expected_col_px", "expected_row_px", "outlier"),
)
"""Columns of watch.csv."""


def write_results(out: OutputFolder, result: WatchNumbers, raster: MotionRaster | None) -> None:
    """Write the numbers, the table, the page and, where it is known, the raster of motion."""
    text = json.dumps(asdict(result), indent=1, allow_nan=False) + "\n"
    texts = {"table": csv_of(list(_rows(result))), "report": _page(result, raster), "numbers": text}
    with out.writing():
        if raster is not None:
            write_motion(raster, out.path(WATCH_FILES["motion"]))
        write_texts(out, WATCH_FILES, texts)
    out.commit()


def findings(result: WatchNumbers) -> Iterator[str]:
    """Yield a sentence for each thing that was found, outliers last."""
    for series in result.series:
        px_m = series.pixel_size_m
        for step in series.steps:
            size = _size(step.size_px, step.sigma_px, px_m)
            yield f"{series.name}: step of {size} at {step.date} ({step.image})"
        if drift := series.drift:
            yield f"{series.name}: drift of {_size(drift.px_per_year, drift.sigma_px, px_m)} a year"
        if season := series.season:
            yield f"{series.name}: yearly wave of {_size(season.amplitude_px, season.sigma_px, px_m)}"
    for region in result.motion.regions if result.motion else ():
        size = _size(region.velocity_px, region.sigma_px, result.motion.px_m if result.motion else None)
        where = f"x {region.x:.7g}, y {region.y:.7g}, {100 * region.share:.1f} % of what was tested"
        yield f"ground at {where}: moves by {size} a year"
    for offset in result.offsets:
        size = _size(offset.offset_px, offset.sigma_px, result.series[0].pixel_size_m)
        when = " and ".join(dict.fromkeys(offset.dates))
        yield f"{offset.second} lies {size} off {offset.first}, at their last dates ({when})"
    for series in result.series:
        if count := series.last_outliers:
            names = ", ".join(image.name for image in series.images[-count:])
            yield f"{series.name}: the last images deviate from the model: a step may begin there ({names})"
    for series in result.series:
        if series.outliers:
            names = ", ".join(f"{image.name} ({image.date})" for image in series.outliers)
            yield f"{series.name}: outliers: {names}"


def _size(size_px: tuple[float, float], sigma_px: float, px_m: float | None) -> str:
    metres = "" if px_m is None else f" ({px_m * float(np.hypot(*size_px)):.2f} m)"
    return f"({size_px[0]:+.3f}, {size_px[1]:+.3f}) ± {sigma_px:.3f} px{metres}"


def _page(result: WatchNumbers, raster: MotionRaster | None) -> str:
    """Return the page, which holds everything that it shows."""
    lines = []
    days = np.array([image.date for series in result.series for image in series.images], "datetime64[D]")
    for series in result.series:
        images = series.images
        line = TimeLine(
            np.array([image.date for image in images], "datetime64[D]"),
            np.array([image.shift_px for image in images]),
            np.array([image.sigma_px for image in images]),
            np.array([image.expected_px for image in images]),
            np.array([image.outlier for image in images]),
            [[image.name for image in images].index(step.image) for step in series.steps],
            (days.min(), days.max()),
        )
        lines.append((series, time_line_figure(line)))
    motion, data = None, None
    if raster is not None:
        shape = raster.frame.grid.shape
        motion, box = motion_figure(raster.velocity_px, raster.moving, raster.cell_px, shape)
        data = page_data(raster, box)
    events = len(result.motion.regions) if result.motion else 0
    for series in result.series:
        events += len(series.steps) + bool(series.drift) + bool(series.season) + bool(series.last_outliers)
    too_few = all(len(series.images) < SERIES.min_images for series in result.series)
    state = "bad" if result.passed is False else "caution" if events or too_few else "good"
    environment = page_environment("pcwlad_geo.multi")
    return environment.get_template("watch.html.j2").render(
        **page_script(environment, "watch.js"),
        result=result,
        lines=lines,
        motion=motion,
        data=data,
        findings=list(findings(result)),
        events=events,
        few=too_few,
        state=state,
    )


def _rows(result: WatchNumbers) -> Iterator[dict[str, object]]:
    for series in result.series:
        for image in series.images:
            numbers = [round(value, 6) for value in (*image.shift_px, image.sigma_px, *image.expected_px)]
            row = [image.name, series.name, image.date, *numbers, image.outlier]
            yield dict(zip(WATCH_COLUMNS, row, strict=True))
