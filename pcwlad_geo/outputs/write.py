"""The outputs of a job, in one table: what each is called, when it is written, and what writes it."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.events import Event, EventCallback, Progress, Warned
from pcwlad_geo.outputs import maps
from pcwlad_geo.products import ProductBand
from pcwlad_geo.raster import vrt, warping
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.matching_grid import grid_on_plane_of
from pcwlad_geo.raster.output_format import OutputFormat, files_of
from pcwlad_geo.raster.output_grid import check_covered, corrected_outline, output_grids
from pcwlad_geo.raster.rpc import files as rpc_files
from pcwlad_geo.raster.rpc import ortho as rpc_warping
from pcwlad_geo.raster.rpc.grid import RpcGrid
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.rpc.view import ground_grid
from pcwlad_geo.raster.source import describe
from pcwlad_geo.registration.inputs import requested_grid
from pcwlad_geo.report.rendering import to_pdf
from pcwlad_geo.tiepoints import writers

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.registration.result import Registration
    from pcwlad_geo.report.content import Report
    from pcwlad_geo.report.page import Drawings
    from pcwlad_geo.report.statistics import PrecisionMap


def corrects(registration: Registration) -> bool:
    """Whether a finished job has corrected files."""
    wanted = registration.passed is not False or registration.settings.keep
    return registration.status == "registered" and wanted


def output_grids_of(registration: Registration, bands: Sequence[ProductBand]) -> list[Grid]:
    """Return the grids of the registered raster and then of other `bands` of its product, with one extent.

    Raises `InputError` if the requested grid does not overlap the corrected target.
    """
    reference, target = ground_grid(registration.reference.grid), registration.target.grid
    request = requested_grid(registration.settings)
    if registration.rpc is not None:
        corrected = registration.rpc.corrected_grid
        grids = rpc_warping.requested_ortho_grids(reference, corrected, request, [corrected])
        outline_xy = corrected.to_xy(corrected.boundary_px())
    else:
        correction = _correction(registration)
        rasters = [target, *(grid_on_plane_of(describe(band.opened_as()), target) for band in bands)]
        grids = output_grids(reference, target, correction, request, rasters)
        outline_xy = corrected_outline(target, correction)
    for grid in grids if request.needs_ground or request.fixed(reference) else ():
        check_covered(grid, outline_xy, target.crs)
    return grids


@dataclass(frozen=True, slots=True)
class BandOutput:
    """Grid, resampling and format with which a band is written."""

    grid: Grid
    resampling: str
    fmt: OutputFormat
    final_path: Path
    """Final path of the file."""


def warp_band(
    source: str,
    path: Path,
    correction: Correction,
    target_grid: Grid,
    how: BandOutput,
    on_event: EventCallback,
) -> None:
    """Warp the raster `source`, of the geometry of `target_grid`, to `path` by the target's `correction`."""
    warning = warping.warp(
        source,
        path,
        correction,
        how.grid,
        how.resampling,
        target_grid=target_grid,
        fmt=how.fmt,
        final_path=how.final_path,
        progress=lambda done, total: on_event(Progress("warping", done, total)),
    )
    if warning is not None:
        on_event(Warned(warning))


def orthorectify_band(
    source: str, path: Path, corrected: RpcGrid, how: BandOutput, on_event: EventCallback
) -> None:
    """Orthorectify the raster `source` by its `corrected` RPC to `path`."""
    warning = rpc_warping.orthorectify(
        source,
        path,
        corrected,
        how.grid,
        how.resampling,
        fmt=how.fmt,
        progress=lambda done, total: on_event(Progress("warping", done, total)),
    )
    if warning is not None:
        on_event(Warned(warning))


@dataclass(frozen=True, slots=True, eq=False)
class Writing:
    """What the writers of a job's outputs need to know."""

    registration: Registration
    grid: Grid | None
    """Grid of the registered raster, if there is one."""
    places: Mapping[str, Path]
    """Final path of each kind, to which paths in the files are relative."""
    on_event: EventCallback


class Condition(NamedTuple):
    """When a file is written."""

    words: str
    """For the reader."""
    holds: Callable[[Registration], bool]
    corrected: bool = False
    """Whether it takes, besides, a correction that the user accepts (see `corrects`)."""


class Output(NamedTuple):
    """A file that a job writes."""

    kind: str
    name: str
    """Its name in the output folder; name and stem are the target's, the ending is that of the format."""
    when: Condition
    description: str
    """What it holds, for the reader."""
    write: Callable[[Writing, Path], None] | None = None
    """Writes it to a path; None for the reports, which come last."""

    def is_of(self, registration: Registration) -> bool:
        """Whether a finished job has it."""
        accepted = corrects(registration) or not self.when.corrected
        return accepted and self.when.holds(registration)


def _tiepoints(job: Writing, path: Path) -> None:
    writers.write_csv(job.registration.tie_points, path)


def _geopackage(job: Writing, path: Path) -> None:
    writers.write_geopackage(job.registration.tie_points, path, job.registration.target.grid)


def _points(job: Writing, path: Path) -> None:
    target = job.registration.target
    on_ground = target.georeferenced and job.registration.rpc is None
    writers.write_points(job.registration.tie_points, path, on_ground, target.grid)


def _gcps(job: Writing, path: Path) -> None:
    table = job.registration.tie_points
    uri = job.registration.target.uri
    writers.write_gcps_vrt(path, uri, table, table.crs, final_path=job.places["gcps"])


def _envi(job: Writing, path: Path) -> None:
    registration = job.registration
    writers.write_envi(registration.tie_points, path, registration.reference.uri, registration.target.uri)


def _corrected(job: Writing, path: Path) -> None:
    target, correction = job.registration.target, _correction(job.registration)
    if not isinstance(correction, AffineCorrection):
        raise TypeError(f"{correction.name} corrections have no geotransform")
    vrt.write_corrected_vrt(path, target.uri, correction, target.grid, final_path=job.places["corrected"])


def _rpc(job: Writing, path: Path) -> None:
    rpc = rpc_files.to_gdal(_corrected_rpc(job.registration))
    vrt.write_rpc_vrt(path, job.registration.target.uri, rpc, final_path=job.places["rpc"])


def _raster(job: Writing, path: Path) -> None:
    """Write the registered raster, orthorectified where the target has RPCs."""
    registration, grid = job.registration, job.grid
    if grid is None:
        raise TypeError(f"a pair that is {registration.status} has no registered raster")
    target, settings = registration.target, registration.settings
    fmt = OutputFormat.of(settings.of, settings.co)
    how = BandOutput(grid, settings.resampling, fmt, job.places["raster"])
    if registration.rpc is not None:
        orthorectify_band(target.uri, path, registration.rpc.corrected_grid, how, job.on_event)
    else:
        warp_band(target.uri, path, _correction(registration), target.grid, how, job.on_event)


def _sigma(job: Writing, path: Path) -> None:
    if job.registration.selection is None or job.grid is None:
        raise TypeError("a registration without a fit has no sigma")
    maps.write_sigma(path, job.registration.selection, job.registration.target.grid, job.grid)


def _displacement(job: Writing, path: Path) -> None:
    maps.write_displacement(path, job.registration)


def _rpc_text(job: Writing, path: Path) -> None:
    rpc_files.write_rpc_text(_corrected_rpc(job.registration), path)


def _in_geotransform(registration: Registration) -> bool:
    is_affine = isinstance(registration.correction, AffineCorrection)
    return registration.rpc is None and is_affine and registration.target.georeferenced


_ALWAYS: Final = Condition("always", lambda job: True)
_PDF: Final = Condition("with `--pdf`", lambda job: job.settings.pdf)
_MATCHED: Final = Condition("unless the pair is refused", lambda job: job.status != "rejected")
_CORRECTED: Final = Condition("`register`", lambda job: True, corrected=True)
_SHIFTED: Final = Condition(
    "shift or affine, of a target with georeferencing", _in_geotransform, corrected=True
)
_RPC: Final = Condition("a target with RPCs", lambda job: job.rpc is not None, corrected=True)
_SIGMA: Final = Condition("with `--write-sigma`", lambda job: job.settings.write_sigma, corrected=True)
_FIELD: Final = Condition(
    "with `--write-displacement`", lambda job: job.settings.write_displacement, corrected=True
)
OUTPUTS: Final = (
    Output("numbers", "report.json", _ALWAYS, "the report for programs, as report.schema.json describes it"),
    Output("report", "report.html", _ALWAYS, "the report: verdict, views, figures, statistics, advice"),
    Output("pdf", "report.pdf", _PDF, "the report as PDF"),
    Output(
        "tiepoints", "tiepoints.csv", _ALWAYS, "positions, displacement, sigma, residual, status", _tiepoints
    ),
    Output("geopackage", "tiepoints.gpkg", _ALWAYS, "the same for QGIS, styled by residual", _geopackage),
    Output("points", "{name}.points", _MATCHED, "tie points for the QGIS Georeferencer", _points),
    Output(
        "gcps", "{stem}_gcps.vrt", _MATCHED, "the target with the tie points as GCPs, for `gdalwarp`", _gcps
    ),
    Output("envi", "{stem}.pts", _MATCHED, "tie points for ENVI (image to image)", _envi),
    Output(
        "corrected", "{stem}_corrected.vrt", _SHIFTED, "the target with corrected georeferencing", _corrected
    ),
    Output("rpc", "{stem}_rpc.vrt", _RPC, "the original target with the corrected RPC", _rpc),
    Output("rpc_text", "{stem}_rpc_RPC.TXT", _RPC, "the corrected RPC as text", _rpc_text),
    Output(
        "raster", "{stem}_registered.{ending}", _CORRECTED, "the target warped onto the output grid", _raster
    ),
    Output("sigma", "{stem}_sigma.tif", _SIGMA, "the predicted sigma of the correction", _sigma),
    Output(
        "displacement",
        "{stem}_displacement.tif",
        _FIELD,
        "the displacement field, its sigma and quality",
        _displacement,
    ),
)
"""All files that a job may write, besides the other bands of a product."""
NAMES: Final = {output.kind: output.name for output in OUTPUTS}
"""File names by kind."""


def write(
    registration: Registration,
    staged: Mapping[str, Path],
    places: Mapping[str, Path],
    elsewhere: Collection[str],
    bands: Mapping[ProductBand, Path],
    on_event: EventCallback,
) -> tuple[list[str], tuple[str, ...]]:
    """Write all files of a job, the report last; return their kinds, and the warnings of the writing.

    Each kind of file is written to its path in `staged` now and refers to others by their final `places`. The
    kinds `elsewhere` end outside the output folder. Each other band of a product is written to its path in
    `bands`.
    """
    # inside: slow to load, which the job may have done meanwhile
    from pcwlad_geo.report.statistics import precision_of
    from pcwlad_geo.report.summary import summarise

    since = time.perf_counter()
    told: list[str] = []

    def tell(event: Event) -> None:
        if isinstance(event, Warned):
            told.append(event.message)
        on_event(event)

    if not corrects(registration):
        bands = {}
    grids = output_grids_of(registration, list(bands)) if registration.status == "registered" else []
    written = [output.kind for output in OUTPUTS if output.is_of(registration)]
    total = sum(output.write is not None for output in OUTPUTS if output.kind in written) + len(bands) + 1
    on_event(Progress("writing", 0, total))
    names = [
        *(staged[kind].name for kind in written if kind not in elsewhere),
        *(p.name for p in bands.values()),
    ]
    precision = precision_of(registration)
    report = summarise(registration, sorted(names), precision, grids[0] if grids else None)
    gcps = staged["gcps"].name if "gcps" in written else None
    side = ThreadPoolExecutor(1)  # GDAL warps without Python's lock
    try:
        drawing = side.submit(copy_context().run, _draw, registration, report, gcps, precision)
        job = Writing(registration, grids[0] if grids else None, places, tell)
        for done, _ in enumerate(_write_files(job, staged, bands, grids), start=1):
            on_event(Progress("writing", done, total))
        drawings, seconds_drawing = drawing.result()
    finally:
        side.shutdown(wait=False)  # an interrupt must not wait for a page that is discarded
    seconds = registration.seconds | {"writing": time.perf_counter() - since, "report": seconds_drawing}
    rasters = [staged["raster"]] if "raster" in written and "raster" not in elsewhere else []
    beside = [file.name for raster in (*rasters, *bands.values()) for file in files_of(raster)[1:]]
    outputs, warnings = tuple(sorted([*names, *beside])), (*registration.warnings, *told)
    _write_report(replace(report, warnings=warnings, outputs=outputs), drawings, staged, seconds)
    on_event(Progress("writing", total, total))
    return written, tuple(told)


def _write_files(
    job: Writing, staged: Mapping[str, Path], bands: Mapping[ProductBand, Path], grids: Sequence[Grid]
) -> Iterator[Path]:
    """Write all files but the reports; yield each that is done."""
    registration, settings = job.registration, job.registration.settings
    for output in OUTPUTS:
        if output.write is not None and output.is_of(registration):
            output.write(job, staged[output.kind])
            yield staged[output.kind]
    fmt = OutputFormat.of(settings.of, settings.co)
    for (band, path), grid in zip(bands.items(), grids[1:], strict=True):
        how = BandOutput(grid, settings.resampling, fmt, job.places["numbers"].with_name(path.name))
        correction, target = _correction(registration), registration.target.grid
        warp_band(band.opened_as(), path, correction, target, how, job.on_event)
        yield path


def _write_report(
    report: Report, drawings: Drawings, staged: Mapping[str, Path], seconds: dict[str, float]
) -> None:
    """Write the report's page, as PDF too where that is wanted, and its numbers, with the `seconds` spent."""
    from pcwlad_geo.report.content import rounded, to_json
    from pcwlad_geo.report.page import on_paper, on_screen
    from pcwlad_geo.report.summary import SECONDS_DIGITS

    report = replace(report, seconds=rounded(seconds, SECONDS_DIGITS))
    staged["report"].write_text(on_screen(report, drawings), encoding="utf-8", newline="\n")
    if report.settings.pdf:
        since = time.perf_counter()
        staged["pdf"].write_bytes(to_pdf(on_paper(report, drawings)))
        seconds = seconds | {"pdf": time.perf_counter() - since}
        report = replace(report, seconds=rounded(seconds, SECONDS_DIGITS))
    staged["numbers"].write_text(to_json(report), encoding="utf-8", newline="\n")


def _draw(
    registration: Registration, report: Report, gcps: str | None, precision: PrecisionMap | None
) -> tuple[Drawings, float]:
    """Return the drawings of the page, and the seconds they took, including the loading of libraries."""
    from pcwlad_geo.report.figures import close_fonts
    from pcwlad_geo.report.page import compose

    since = time.perf_counter()
    drawings = compose(registration, report, gcps, precision)
    close_fonts()  # those of this thread, which ends here
    return drawings, time.perf_counter() - since


def _corrected_rpc(registration: Registration) -> RpcModel:
    if registration.rpc is None:
        raise TypeError("the target has no RPC")
    return registration.rpc.corrected_grid.rpc


def _correction(registration: Registration) -> Correction:
    if registration.correction is None:
        raise TypeError(f"a pair that is {registration.status} has no correction")
    return registration.correction
