"""The writing of a job's outputs: all files, the report last."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pcwlad_geo.events import Event, EventCallback, Progress, Warned
from pcwlad_geo.execution.runner import one_library_thread
from pcwlad_geo.outputs.bands import BandOutput, correction_of, output_grids_of, warp_band
from pcwlad_geo.outputs.files import Writing, corrects, outputs
from pcwlad_geo.outputs.geometric_accuracy import GeometricAccuracy
from pcwlad_geo.products.product import ProductBand
from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.output_format import files_of

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.registration import Registration
    from pcwlad_geo.report.content import Report
    from pcwlad_geo.report.page import Drawings


class Written(NamedTuple):
    """What a job has written."""

    kinds: list[str]
    warnings: tuple[str, ...]
    """Of the writing."""
    report: Report
    """The content of report.json."""


@one_library_thread()
def write(
    registration: Registration,
    staged: Mapping[str, Path],
    places: Mapping[str, Path],
    elsewhere: Collection[str],
    bands: Mapping[ProductBand, Path],
    on_event: EventCallback,
) -> Written:
    """Write all files of a job, the report last.

    Each kind of file is written to its path in `staged` now and refers to others by their final `places`. The
    kinds `elsewhere` end outside the output folder. Each other band of a product is written to its path in
    `bands`.
    """
    since = time.perf_counter()
    messages: list[str] = []

    def tell(event: Event) -> None:
        if isinstance(event, Warned):
            messages.append(event.message)
        on_event(event)

    if not corrects(registration):
        bands = {}
    grids = output_grids_of(registration, list(bands)) if registration.status == "registered" else []
    table = outputs()
    written = [output.kind for output in table if output.is_of(registration)]
    total = sum(output.write is not None for output in table if output.kind in written) + len(bands) + 1
    on_event(Progress("writing", 0, total))
    names = [
        *(staged[kind].name for kind in written if kind not in elsewhere),
        *(p.name for p in bands.values()),
    ]
    gcps = staged["gcps"].name if "gcps" in written else None
    side = ThreadPoolExecutor(1)  # GDAL warps without Python's lock
    try:
        drawing = side.submit(copy_context().run, _draw, registration, sorted(names), grids, gcps)
        grid = grids[0] if grids else None
        in_stac = grid is not None and registration.settings.write_stac
        accuracy = GeometricAccuracy.of(registration, grid.crs) if grid and in_stac else None
        by_name = {band.name: path for band, path in bands.items()}
        job = Writing(registration, grid, places, staged, tell, by_name, accuracy)
        for count, _ in enumerate(_write_files(job, bands, grids), start=1):
            on_event(Progress("writing", count, total))
        report, drawings, seconds_drawing = drawing.result()
    finally:
        side.shutdown(wait=False)  # an interrupt must not wait for a page that is discarded
    seconds = registration.seconds | {"writing": time.perf_counter() - since, "report": seconds_drawing}
    rasters = [staged["raster"]] if "raster" in written and "raster" not in elsewhere else []
    attached = [file.name for raster in (*rasters, *bands.values()) for file in files_of(raster)[1:]]
    files, warnings = tuple(sorted([*names, *attached])), (*registration.warnings, *messages)
    report = replace(report, warnings=warnings, outputs=files)
    report = _write_report(report, drawings, staged, seconds)
    on_event(Progress("writing", total, total))
    return Written(written, tuple(messages), report)


def _write_files(job: Writing, bands: Mapping[ProductBand, Path], grids: Sequence[Grid]) -> Iterator[Path]:
    """Write all files but the reports; yield each that is done."""
    registration, resampling = job.registration, job.registration.settings.resampling
    for (band, path), grid in zip(bands.items(), grids[1:], strict=True):
        how = BandOutput(grid, resampling, job.format, job.places["numbers"].with_name(path.name))
        correction, target = correction_of(registration), registration.target.grid
        warp_band(band.opened_as(), path, correction, target, how, job.on_event)
        yield path
    for output in outputs():  # the item of all rasters is the last
        if output.write is not None and output.is_of(registration):
            output.write(job, job.staged[output.kind])
            yield job.staged[output.kind]


def _write_report(
    report: Report, drawings: Drawings | None, staged: Mapping[str, Path], seconds: dict[str, float]
) -> Report:
    """Write the numbers of a report, and its page where there are drawings; return it with the `seconds`."""
    from pcwlad_geo.report.json_content import SECONDS_DIGITS, rounded, to_json

    report = replace(report, seconds=rounded(seconds, SECONDS_DIGITS))
    if drawings is not None:
        seconds = seconds | _write_page(report, drawings, staged)
        report = replace(report, seconds=rounded(seconds, SECONDS_DIGITS))
    staged["numbers"].write_text(to_json(report), encoding="utf-8", newline="\n")
    return report


def _write_page(report: Report, drawings: Drawings, staged: Mapping[str, Path]) -> dict[str, float]:
    """Write the report's page, as PDF too where that is wanted; return the seconds that the PDF took."""
    from pcwlad_geo.report.page import report_page
    from pcwlad_geo.report.pdf import to_pdf

    staged["report"].write_text(report_page(report, drawings), encoding="utf-8", newline="\n")
    if not report.settings.pdf:
        return {}
    since = time.perf_counter()
    staged["pdf"].write_bytes(to_pdf(report_page(report, drawings, paper=True)))
    return {"pdf": time.perf_counter() - since}


def _draw(
    registration: Registration, names: Sequence[str], grids: Sequence[Grid], gcps: str | None
) -> tuple[Report, Drawings | None, float]:
    """Return the report, the drawings of its page, and the seconds they took, with the loading of libraries.

    The output files have the `names`, the raster is on the first of the `grids`; `gcps` is that with GCPs.
    There are no drawings where no page is wanted.
    """
    # inside: slow to load, which the job may have done meanwhile
    from pcwlad_geo.report.statistics import precision_of
    from pcwlad_geo.report.summary import summarise

    since = time.perf_counter()
    precision = precision_of(registration)
    report = summarise(registration, names, precision, grids[0] if grids else None)
    drawings = None
    if not registration.settings.no_report:
        from pcwlad_geo.report.page import compose

        pair = replace(registration, reference=registration.fetched or registration.reference)
        drawings = compose(pair, report, gcps, precision)
    return report, drawings, time.perf_counter() - since
