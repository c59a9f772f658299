"""The outputs of a job, in one table: what each is called, when it is written, and what writes it."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.correction.dense import Lattice
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import Event, EventCallback, Progress, Warned
from pcwlad_geo.execution.runner import one_library_thread
from pcwlad_geo.limits import check_grid
from pcwlad_geo.products.product import ProductBand
from pcwlad_geo.raster import vrt, warping
from pcwlad_geo.raster.gdal import small_block_cache
from pcwlad_geo.raster.grid import Grid, jacobian, map_px, metres_between
from pcwlad_geo.raster.matching_grid import grid_on_plane_of
from pcwlad_geo.raster.output_format import OutputFormat, files_of, write_cog
from pcwlad_geo.raster.output_grid import check_covered, corrected_outline, output_grids
from pcwlad_geo.raster.rpc import ortho as rpc_warping
from pcwlad_geo.raster.rpc.files import to_gdal, write_rpc_text
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.writing import scratch_folder, sink
from pcwlad_geo.registration import requested_grid
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.format import PointRasters, TiePointFormat
from pcwlad_geo.tiepoints.geopackage import write_geopackage
from pcwlad_geo.tiepoints.readers import FORMATS
from pcwlad_geo.types import Float64, Index

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.correction.selection import Selection
    from pcwlad_geo.registration import Registration
    from pcwlad_geo.report.content import Report
    from pcwlad_geo.report.page import Drawings
    from pcwlad_geo.tiepoints.table import TiePointTable


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
    write_csv(job.registration.tie_points, path)


def _geopackage(job: Writing, path: Path) -> None:
    write_geopackage(job.registration.tie_points, path, job.registration.target.grid)


def _corrected(job: Writing, path: Path) -> None:
    target, correction = job.registration.target, _correction(job.registration)
    if not isinstance(correction, AffineCorrection):
        raise TypeError(f"{correction.name} corrections have no geotransform")
    grid = target.grid.in_turn_of(ground_grid(job.registration.reference.grid))
    vrt.write_corrected_vrt(path, target.uri, correction, grid, final_path=job.places["corrected"])


def _rpc(job: Writing, path: Path) -> None:
    rpc = to_gdal(_corrected_rpc(job.registration))
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
    write_sigma(path, job.registration.selection, job.registration.target.grid, job.grid)


def _rpc_text(job: Writing, path: Path) -> None:
    write_rpc_text(_corrected_rpc(job.registration), path)


def _in_geotransform(registration: Registration) -> bool:
    is_affine = isinstance(registration.correction, AffineCorrection)
    return registration.rpc is None and is_affine and registration.target.georeferenced


_ALWAYS: Final = Condition("always", lambda job: True)
_PAGE: Final = Condition("unless `--no-report`", lambda job: not job.settings.no_report)
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
    Output("report", "report.html", _PAGE, "the report: verdict, views, figures, statistics, advice"),
    Output("pdf", "report.pdf", _PDF, "the report as PDF"),
    Output(
        "tiepoints", "tiepoints.csv", _ALWAYS, "positions, displacement, sigma, residual, status", _tiepoints
    ),
    Output("geopackage", "tiepoints.gpkg", _PAGE, "the same for QGIS, styled by residual", _geopackage),
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
        lambda job, path: write_displacement(path, job.registration),
    ),
)
"""The files that a job may write, besides those in formats of tie points and the other bands of a product."""
NAMES: Final = {output.kind: output.name for output in OUTPUTS}
"""File names by kind."""


def outputs() -> tuple[Output, ...]:
    """Return all files that a job may write, besides the other bands of a product.

    Raises `InputError` if a format of tie points of another package has the name of another output.
    """
    formats = tuple(FORMATS.ask(_of_format, Output))
    kinds = [output.kind for output in (*OUTPUTS, *formats)]
    twice = [kind for kind in kinds if kinds.count(kind) > 1]
    if twice:
        raise InputError(f"two packages have an output called {twice[0]}: uninstall one of them")
    after = next(place for place, output in enumerate(OUTPUTS) if output.kind == "corrected")
    return (*OUTPUTS[:after], *formats, *OUTPUTS[after:])


def _of_format(form: TiePointFormat) -> Output | None:
    """Return the output in a format of tie points; None for a format that is only read."""
    write = form.write
    if write is None:
        return None

    def write_table(job: Writing, path: Path) -> None:
        registration = job.registration
        reference, target = registration.reference, registration.target
        on_map = target.georeferenced and registration.rpc is None
        with FORMATS.blamed(form):
            rasters = PointRasters(reference, target, on_map, job.places[form.name])
            write(registration.tie_points, path, rasters)

    return Output(form.name, form.file_name, _MATCHED, form.description, write_table)


@one_library_thread()
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
        job = Writing(registration, grids[0] if grids else None, places, tell)
        for done, _ in enumerate(_write_files(job, staged, bands, grids), start=1):
            on_event(Progress("writing", done, total))
        report, drawings, seconds_drawing = drawing.result()
    finally:
        side.shutdown(wait=False)  # an interrupt must not wait for a page that is discarded
    seconds = registration.seconds | {"writing": time.perf_counter() - since, "report": seconds_drawing}
    rasters = [staged["raster"]] if "raster" in written and "raster" not in elsewhere else []
    attached = [file.name for raster in (*rasters, *bands.values()) for file in files_of(raster)[1:]]
    files, warnings = tuple(sorted([*names, *attached])), (*registration.warnings, *messages)
    _write_report(replace(report, warnings=warnings, outputs=files), drawings, staged, seconds)
    on_event(Progress("writing", total, total))
    return written, tuple(messages)


def _write_files(
    job: Writing, staged: Mapping[str, Path], bands: Mapping[ProductBand, Path], grids: Sequence[Grid]
) -> Iterator[Path]:
    """Write all files but the reports; yield each that is done."""
    registration, settings = job.registration, job.registration.settings
    for output in outputs():
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
    report: Report, drawings: Drawings | None, staged: Mapping[str, Path], seconds: dict[str, float]
) -> None:
    """Write the report's numbers, with the `seconds` spent, and its page where there are drawings for it."""
    from pcwlad_geo.report.content import SECONDS_DIGITS, rounded, to_json

    report = replace(report, seconds=rounded(seconds, SECONDS_DIGITS))
    if drawings is not None:
        seconds = seconds | _write_page(report, drawings, staged)
        report = replace(report, seconds=rounded(seconds, SECONDS_DIGITS))
    staged["numbers"].write_text(to_json(report), encoding="utf-8", newline="\n")


def _write_page(report: Report, drawings: Drawings, staged: Mapping[str, Path]) -> dict[str, float]:
    """Write the report's page, as PDF too where that is wanted; return the seconds that the PDF took."""
    from pcwlad_geo.report.page import report_page, to_pdf

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
    from pcwlad_geo.report.content import summarise
    from pcwlad_geo.report.statistics import precision_of

    since = time.perf_counter()
    precision = precision_of(registration)
    report = summarise(registration, names, precision, grids[0] if grids else None)
    drawings = None
    if not registration.settings.no_report:
        from pcwlad_geo.report.page import compose

        drawings = compose(registration, report, gcps, precision)
    return report, drawings, time.perf_counter() - since


def _corrected_rpc(registration: Registration) -> RpcModel:
    if registration.rpc is None:
        raise TypeError("the target has no RPC")
    return registration.rpc.corrected_grid.rpc


def _correction(registration: Registration) -> Correction:
    if registration.correction is None:
        raise TypeError(f"a pair that is {registration.status} has no correction")
    return registration.correction


MAX_PX: Final = 1000
"""Longer side of the sigma raster, px: sigma varies only on the scale of the tie point spacing."""
BLOCK_PX: Final = 512
"""Side of the blocks in which a raster is computed, which limits the memory."""
NODES: Final = 128
"""Largest number of nodes along an axis between which the covariance of the correction is interpolated."""
SHARE_OF_WINDOW: Final = 0.25
"""Spacing of the displacement field in matching windows: two of its places share most of their pixels."""


class Layer(NamedTuple):
    """A band of such a raster."""

    description: str
    unit: str
    long_name: str = ""
    """Tag of the band, from which programs that read netCDF tell the components of a vector."""


Values = Callable[[Float64], Float64]
"""Maps (n, 2) positions (col, row) of a raster, px, to the (n, bands) values there; NaN where unknown."""

SIGMA_LAYERS: Final = (
    Layer("sigma along column", "px"),
    Layer("sigma along row", "px"),
    Layer("1 beyond the tie points, 0 among them", ""),
)
"""Bands of the sigma raster."""


def write_sigma(path: Path, precision: Selection, target_grid: Grid, grid: Grid) -> None:
    """Write the sigma of a correction over the registered raster.

    Three bands of float32: sigma along the target's columns and rows, target px, and 1 where the correction
    extrapolates. A pixel covers a square of the registered raster's pixels. If either grid has no CRS, the
    pixels of the registered raster, on `grid`, are the predicted ones of `target_grid`.
    """
    factor = -(-max(grid.shape) // MAX_PX)
    places = _Places.every(factor, grid, target_grid)

    def values(centres: Float64) -> Float64:
        at_px = places.predicted_px(centres)
        found = np.full((len(at_px), 3), np.nan)
        known = np.isfinite(at_px).all(axis=1)
        found[known, :2] = precision.sigma(at_px[known])
        found[known, 2] = precision.extrapolated(at_px[known])
        return found

    write_map(path, places, SIGMA_LAYERS, values, block_px=MAX_PX)


@dataclass(frozen=True, slots=True)
class _Places:
    """Squares of a grid's pixels, and where the target's georeferencing predicts their middles."""

    grid: Grid
    """Its pixels are the squares."""
    side_px: int
    """Side of a square in pixels of the grid that is divided."""
    target_grid: Grid
    located: bool
    """Whether the divided grid has map coordinates."""
    placed: bool
    """Whether both have; otherwise pixels of the divided grid are the predicted ones."""

    @classmethod
    def every(cls, side_px: int, grid: Grid, target_grid: Grid) -> _Places:
        """Divide a grid into squares, from its first pixel on; the last ones may reach beyond it."""
        shape = (-(-grid.shape[0] // side_px), -(-grid.shape[1] // side_px))
        coarse = grid.resampled_grid(((side_px, 0.0), (0.0, side_px)), (0.0, 0.0), shape)
        return cls(coarse, side_px, target_grid, grid.located, grid.located and target_grid.located)

    @property
    def transform(self) -> Affine:
        """The geotransform to write; without map coordinates that of the pixel plane, y = -row."""
        return self.grid.transform if self.located else Affine.scale(self.side_px, -self.side_px)

    def predicted_px(self, centres: Float64) -> Float64:
        """Map (n, 2) positions (col, row) of the raster to predicted target px; NaN where there is none."""
        return map_px(centres, self.grid, self.target_grid) if self.placed else centres * self.side_px


def write_map(
    path: Path,
    places: _Places,
    layers: Sequence[Layer],
    values: Values,
    *,
    block_px: int = BLOCK_PX,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write a float32 COG with NaN for nodata, block by block: the memory does not grow with the raster.

    The `values` compute the bands, described by the `layers`, at the middles of pixels.
    """
    rows, cols = places.grid.shape
    profile = {"driver": "GTiff", "dtype": "float32", "nodata": np.nan, "count": len(layers)}
    profile |= {"height": rows, "width": cols, "tiled": True, "bigtiff": "IF_SAFER"}
    profile |= {"crs": places.grid.crs, "transform": places.transform}
    with scratch_folder(path) as scratch, small_block_cache():
        with sink(scratch / "pixels.tif", profile) as file:
            for row in range(0, rows, block_px):
                for col in range(0, cols, block_px):
                    shape = min(block_px, rows - row), min(block_px, cols - col)
                    down, across = np.indices(shape)
                    first = np.stack([across + col, down + row], axis=-1).reshape(-1, 2)
                    centres = first.astype(np.float64) + 0.5
                    block = values(centres).T.reshape(len(layers), *shape)
                    file.write(
                        block.astype(np.float32), window=((row, row + shape[0]), (col, col + shape[1]))
                    )
            for band, layer in enumerate(layers, start=1):
                file.set_band_description(band, layer.description)
                file.set_band_unit(band, layer.unit)
                if layer.long_name:
                    file.update_tags(band, long_name=layer.long_name)
            file.update_tags(**(tags or {}))
        write_cog(scratch / "pixels.tif", path)


OUTSIDE, EXTRAPOLATED, MODELLED, MEASURED = range(4)
"""The values of the quality band: no data; the model, beyond the tie points; the model, among them; measured
by tie points of this pixel."""
FIELD_BANDS: Final = ("dx", "dy", "sigma_x", "sigma_y")
"""Descriptions of the first four bands."""
LONG_NAMES: Final[Mapping[str, Mapping[str, str]]] = {
    "px": {},  # dy is down, and arrows that others draw of components point up
    "m": {"dx": "u-component of displacement", "dy": "v-component of displacement"},
}
"""By unit."""
QUALITY: Final = "quality: 0 none, 1 model beyond the tie points, 2 model, 3 measured"
"""Description of the last band of the displacement raster."""
UNITS: Final = {"px": "px", "m": "metre"}
"""By unit; PROJ knows no other word."""
TAGS: Final[Mapping[str, Mapping[str, str]]] = {
    "px": {
        "DISPLACEMENT": "observed minus predicted position in the target, target px: dx along columns, dy "
        "along rows (down); predicted by the original georeferencing"
    },
    "m": {
        "DISPLACEMENT": "where the target's original georeferencing shows the ground, less where it is: "
        "metres along the axes of the CRS, dy north",
        "TYPE": "HORIZONTAL_OFFSET",  # for PROJ
    },
}
"""Tags of the file, by unit."""


def write_displacement(path: Path, registration: Registration) -> None:
    """Write the displacement field of the target on the reference's grid.

    Five bands of float32: dx, dy, sigma_x and sigma_y in target px (with y down) or in metres along the axes
    of the reference CRS (y north), and the quality. A pixel covers a square of the reference's pixels, from
    its first one on; its values hold at its middle. With ``--points dense`` a pixel with tie points of its
    own has their mean displacement, which is brought to the middle by the slope of the model, and their mean
    covariance; elsewhere it has that of the model. Raises `InputError` where metres are wanted and not known.
    """
    if registration.selection is None or registration.correction is None:
        raise TypeError("a registration without a fit has no displacement field")
    reference = ground_grid(registration.reference.grid)
    field = _Field.of(registration, reference)
    rows, cols = field.places.grid.shape
    check_grid("the displacement field", (cols, rows))
    unit = registration.settings.displacement_unit
    layers = (
        *(Layer(name, UNITS[unit], LONG_NAMES[unit].get(name, "")) for name in FIELD_BANDS),
        Layer(QUALITY, ""),
    )
    write_map(path, field.places, layers, field.values, tags=TAGS[unit])


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """The displacement anywhere on the reference, and how well it is known."""

    places: _Places
    correction: Correction
    precision: Selection
    covariance: _Interpolated
    measured: _Measured
    metres: _Metres | None
    """None for px."""

    @classmethod
    def of(cls, registration: Registration, reference: Grid) -> _Field:
        """Return the field that a finished registration has found."""
        selection, correction = registration.selection, registration.correction
        if selection is None or correction is None:
            raise TypeError("there is no correction")
        target, settings = registration.target, registration.settings
        side = settings.displacement_spacing or _spacing_px(selection, reference, target.grid)
        places = _Places.every(side, reference, target.grid)
        own = target.grid if places.placed else reference
        metres = None
        if settings.displacement_unit == "m":
            if reference.crs is None:
                raise InputError("a displacement in metres needs a CRS: leave out --displacement-unit m")
            metres = _Metres(own, reference.crs)
        statuses = ("fit", "check", "unused") if settings.points == "dense" else ()
        measured = _Measured.of(registration.tie_points.select(*statuses), places)
        covariance = _Interpolated.of(selection, target.grid.shape)
        return cls(places, correction, selection, covariance, measured, metres)

    def values(self, centres: Float64) -> Float64:
        """Return (n, 5) dx, dy, sigma_x, sigma_y and quality at (n, 2) positions of the raster."""
        found = np.full((len(centres), 5), np.nan)
        found[:, 4] = OUTSIDE
        predicted = self.places.predicted_px(centres)
        predicted[~np.isfinite(predicted).all(axis=1)] = np.nan
        observed = self.correction.forward(predicted)
        own, offset, covariance = self.measured.at(centres)
        observed[own] += offset
        rows, cols = self.places.target_grid.shape
        with np.errstate(invalid="ignore"):
            observable = ((observed >= 0) & (observed <= [cols, rows])).all(axis=1)
        spread = np.empty((len(centres), 2, 2))
        spread[observable] = self.covariance.at(predicted[observable])
        spread[own] = covariance
        quality = np.full(len(centres), MODELLED)
        quality[observable] = np.where(
            self.precision.extrapolated(predicted[observable]), EXTRAPOLATED, MODELLED
        )
        quality[own] = MEASURED
        predicted, observed, spread = (each[observable] for each in (predicted, observed, spread))
        moved = observed - predicted
        if self.metres is not None:
            moved, spread = self.metres.of(predicted, observed, spread)
        sigma = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
        found[observable] = np.column_stack([moved, sigma, quality[observable]])
        return found


def _spacing_px(selection: Selection, reference: Grid, target: Grid) -> int:
    """Return the default spacing: a quarter of the matching window, or of the points' spacing without one."""
    window_px = selection.footprint_px or selection.fit.support.reach_px
    placed = reference.located and target.located
    scale = jacobian(target.middle_px, at_mean_height(target), reference)[0] if placed else np.eye(2)
    size = float(np.sqrt(abs(np.linalg.det(scale)))) if np.isfinite(scale).all() else 1.0
    return max(1, round(SHARE_OF_WINDOW * window_px * size))


@dataclass(frozen=True, slots=True, eq=False)
class _Interpolated:
    """The covariance of a correction, interpolated between nodes: it varies as slowly as the points lie."""

    lattice: Lattice
    values_px2: Float64

    @classmethod
    def of(cls, precision: Selection, shape: tuple[int, int]) -> _Interpolated:
        """Compute the covariance at nodes over a target of `shape` (rows, columns)."""
        high = np.array(shape[::-1], dtype=np.float64)
        lattice = Lattice.over(np.zeros(2), high, max(float(high.max()) / (NODES - 1), 1.0))
        values = precision.covariance(lattice.nodes_px())
        return cls(lattice, values.reshape(*lattice.shape, 2, 2))

    def at(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance at the (n, 2) predicted target px, px²."""
        (left, top), (down, across) = self.lattice.origin_px, np.subtract(self.lattice.shape, 1)
        far = left + across * self.lattice.step_px[0], top + down * self.lattice.step_px[1]
        return self.lattice.interpolated(self.values_px2, np.clip(at_px, (left, top), far))


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """The pixels of the raster with tie points of their own."""

    columns: int
    """Columns of the raster."""
    pixel: Index
    """(m,) indices of these pixels, row by row, ascending."""
    residual_px: Float64
    """(m, 2) mean of the residuals of their points, weighted by precision, target px."""
    covariance_px2: Float64
    """(m, 2, 2) mean of the covariances: points so near to each other share their windows."""

    @classmethod
    def of(cls, points: TiePointTable, places: _Places) -> _Measured:
        """Gather tie points by the pixel in which they lie."""
        rows, cols = places.grid.shape
        at_px = places.grid.to_px(points.xy) if places.placed else points.reference_px / places.side_px
        with np.errstate(invalid="ignore"):
            inside = ((at_px >= 0) & (at_px < [cols, rows])).all(axis=1)
        col, row = at_px[inside].astype(np.intp).T
        pixel, which = np.unique(row * cols + col, return_inverse=True)
        residual, covariance = points.residual_px[inside], points.covariance_px2[inside]
        variance = np.trace(covariance, axis1=1, axis2=2)
        weight = 1.0 / np.maximum(variance, 1e-3 * float(np.median(variance)) if len(variance) else 1.0)
        total = np.bincount(which, weight, len(pixel))

        def mean(values: Float64) -> Float64:
            flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
            sums = [np.bincount(which, weight * column, len(pixel)) / total for column in flat.T]
            return np.stack(sums, axis=-1).reshape(len(pixel), *values.shape[1:])

        return cls(cols, pixel, mean(residual), mean(covariance))

    def at(self, centres: Float64) -> tuple[Index, Float64, Float64]:
        """Return which of (n, 2) pixel centres have points, and the m residuals and covariances of these."""
        col, row = np.floor(centres).astype(np.intp).T
        wanted = row * self.columns + col
        place = np.searchsorted(self.pixel, wanted)
        place[place == len(self.pixel)] = 0
        own = np.flatnonzero(self.pixel[place] == wanted) if len(self.pixel) else np.empty(0, np.intp)
        return own, self.residual_px[place[own]], self.covariance_px2[place[own]]


@dataclass(frozen=True, slots=True)
class _Metres:
    """The conversion of displacements from target px to metres along the axes of the reference CRS."""

    own: Grid
    """The grid of the predicted and observed px."""
    crs: CRS

    def of(
        self, predicted_px: Float64, observed_px: Float64, covariance_px2: Float64
    ) -> tuple[Float64, Float64]:
        """Return (n, 2) displacements (x, y) and their (n, 2, 2) covariances, metres and m²."""
        level, crs = at_mean_height(self.own), self.crs
        steps = [
            metres_between(level, observed_px - half, observed_px + half, crs)
            for half in np.array([[0.5, 0.0], [0.0, 0.5]])
        ]
        per_px = np.stack(steps, axis=2)
        covariance = per_px @ covariance_px2 @ per_px.transpose(0, 2, 1)
        return metres_between(self.own, predicted_px, observed_px, crs), covariance
