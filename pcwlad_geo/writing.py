"""All files of a job: the report and its page, tie points, corrections, warped rasters."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from pathlib import Path
from typing import Any, NamedTuple

from pcwlad_geo import outputs
from pcwlad_geo.raster.output_format import files_of
from pcwlad_geo.raster.product import ProductBand
from pcwlad_geo.registration.progress import Event, EventCallback, Progress, Warned
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.report import page
from pcwlad_geo.report.pdf import to_pdf
from pcwlad_geo.report.precision import PrecisionMap, precision_of
from pcwlad_geo.report.summary import summarise, to_json


class Written(NamedTuple):
    """What was written."""

    kinds: list[str]
    warnings: tuple[str, ...]
    """What was found on the way; the report has them too."""


def write(
    registration: Registration,
    staged: Mapping[str, Path],
    places: Mapping[str, Path],
    elsewhere: Collection[str],
    bands: Mapping[ProductBand, Path],
    on_event: EventCallback,
) -> Written:
    """Write all files of a job, the report last.

    Parameters
    ----------
    registration : Registration
    staged : mapping
        Where each kind of file is written.
    places : mapping
        Where each will be in the end: what the files say of one another.
    elsewhere : collection
        Kinds that will not be in the output folder.
    bands : mapping
        Where the other bands of a product are written.
    on_event : callable
    """
    since = time.perf_counter()
    told: list[str] = []

    def tell(event: Event) -> None:
        if isinstance(event, Warned):
            told.append(event.message)
        on_event(event)

    if not outputs.corrects(registration):
        bands = {}
    grids = outputs.output_grids_of(registration, list(bands)) if registration.status == "registered" else []
    kinds = outputs.kinds(registration)
    total = len(kinds) + len(bands) + 1  # the report is one
    on_event(Progress("writing", 0, total))
    written = [*kinds, "report", *(["pdf"] if registration.settings.pdf else []), "numbers"]
    names = [
        *(staged[kind].name for kind in written if kind not in elsewhere),
        *(p.name for p in bands.values()),
    ]
    precision = precision_of(registration)
    summary = summarise(registration, sorted(names), precision, grids[0] if grids else None)
    gcps = staged["gcps"].name if "gcps" in kinds else None
    side = ThreadPoolExecutor(1)  # GDAL warps without Python's lock
    try:
        drawing = side.submit(copy_context().run, _draw, registration, summary, gcps, precision)
        writers = outputs.writers(registration, places, grids[0] if grids else None, tell)
        for done, kind in enumerate(kinds, start=1):
            writers[kind](staged[kind])
            on_event(Progress("writing", done, total))
        for done, (band, path) in enumerate(bands.items(), start=len(kinds) + 1):
            final_path = places["numbers"].with_name(path.name)
            outputs.write_band(registration, band, path, grids[done - len(kinds)], final_path, tell)
            on_event(Progress("writing", done, total))
        content, seconds_drawing = drawing.result()
    finally:
        side.shutdown(wait=False)  # what is interrupted here must not wait for a page that nobody will see
    seconds = registration.seconds | {"writing": time.perf_counter() - since, "report": seconds_drawing}
    summary["warnings"] = [*registration.warnings, *told]
    rasters = [staged["raster"]] if "raster" in kinds and "raster" not in elsewhere else []
    beside = [file.name for raster in (*rasters, *bands.values()) for file in files_of(raster)[1:]]
    summary["outputs"] = sorted([*names, *beside])
    content |= page.words(registration.status, summary) | {"seconds": _rounded(seconds)}
    staged["report"].write_text(page.on_screen(content), encoding="utf-8", newline="\n")
    if "pdf" in written:
        printing = time.perf_counter()
        staged["pdf"].write_bytes(to_pdf(page.on_paper(content)))
        seconds["pdf"] = time.perf_counter() - printing
    summary["seconds"] = _rounded(seconds)
    staged["numbers"].write_text(to_json(summary), encoding="utf-8", newline="\n")
    on_event(Progress("writing", total, total))
    return Written(written, tuple(told))


def _draw(
    registration: Registration, summary: Mapping[str, Any], gcps: str | None, precision: PrecisionMap | None
) -> tuple[dict[str, object], float]:
    """Return what the page is made from, and the seconds that this took, its libraries included."""
    since = time.perf_counter()
    content = page.compose(registration, summary, gcps, precision)
    return content, time.perf_counter() - since


def _rounded(seconds: Mapping[str, float]) -> dict[str, float]:
    return {stage: round(value, 3) for stage, value in seconds.items()}
