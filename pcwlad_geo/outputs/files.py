"""The files that a job may write, in one table: their names, when they are written, and what writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.outputs.bands import BandOutput, correction_of, orthorectify_band, warp_band
from pcwlad_geo.outputs.displacement_raster import write_displacement
from pcwlad_geo.outputs.geolayers import write_lon_lat
from pcwlad_geo.outputs.geometric_accuracy import GeometricAccuracy
from pcwlad_geo.outputs.map_raster import write_sigma
from pcwlad_geo.outputs.pair_item import write_item
from pcwlad_geo.outputs.proj_grid import write_proj_grid
from pcwlad_geo.raster import WGS84, Grid, OutputFormat, RpcModel, transform_xy, vrt
from pcwlad_geo.raster.rpc.files import to_gdal, write_rpc_text
from pcwlad_geo.raster.rpc.frame_camera import FrameCamera
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.format import PointRasters, TiePointFormat
from pcwlad_geo.tiepoints.geopackage import write_geopackage
from pcwlad_geo.tiepoints.iiif import write_annotation
from pcwlad_geo.tiepoints.readers import FORMATS

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.registration import Registration


def corrects(registration: Registration) -> bool:
    """Whether a finished job has corrected files."""
    is_accepted = registration.passed is not False or registration.settings.keep
    return registration.status == "registered" and is_accepted


@dataclass(frozen=True, slots=True, eq=False)
class Writing:
    """What the writers of a job's outputs need to know."""

    registration: Registration
    grid: Grid | None
    """Grid of the registered raster, if there is one."""
    places: Mapping[str, Path]
    """Final path of each kind, to which paths in the files are relative."""
    staged: Mapping[str, Path]
    """Where each kind is written now."""
    on_event: EventCallback
    bands: Mapping[str, Path]
    """Where the other bands of a product, by name, are written now."""
    accuracy: GeometricAccuracy | None
    """Errors of the registered raster, where its metadata tell them."""

    @property
    def format(self) -> OutputFormat:
        """The format of the corrected rasters, with the tags that tell their accuracy."""
        settings = self.registration.settings
        tags = self.accuracy.tags() if self.accuracy else {}
        return replace(OutputFormat.of(settings.of, settings.co), tags=tags)


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
    """Writes it to a path; None where another one writes it too, and for the reports, which come last."""

    def is_of(self, registration: Registration) -> bool:
        """Whether a finished job has it."""
        accepted = corrects(registration) or not self.when.corrected
        return accepted and self.when.holds(registration)


def _tiepoints(job: Writing, path: Path) -> None:
    write_csv(job.registration.tie_points, path)


def _geopackage(job: Writing, path: Path) -> None:
    write_geopackage(job.registration.tie_points, path, job.registration.target.grid)


def _corrected(job: Writing, path: Path) -> None:
    target, correction = job.registration.target, correction_of(job.registration)
    if not isinstance(correction, AffineCorrection):
        raise TypeError(f"{correction.name} corrections have no geotransform")
    grid = target.grid.in_turn_of(ground_grid(job.registration.reference.grid))
    vrt.write_corrected_vrt(path, target.uri, correction, grid, final_path=job.places["corrected"])


def _placed(job: Writing, path: Path) -> None:
    target = job.registration.target
    vrt.write_placed_vrt(path, target.uri, target.grid, final_path=job.places["placed"])


def _rpc(job: Writing, path: Path) -> None:
    rpc = to_gdal(_corrected_rpc(job.registration))
    vrt.write_rpc_vrt(path, job.registration.target.uri, rpc, final_path=job.places["rpc"])


def _camera_rpc(registration: Registration) -> RpcModel:
    """Return the camera of a photograph with fiducials as an RPC."""
    settings, points = registration.settings, registration.tie_points
    if settings.fiducials is None or settings.dem is None:
        raise TypeError("there are no fiducials and heights")
    points = points.select("matched", "fit", "check", "unused")
    lon_lat = transform_xy(points.xy, registration.reference.grid.crs, WGS84)
    camera, shape = FrameCamera.of_file(settings.fiducials), registration.target.grid.shape
    return camera.rpc(points.target_px, lon_lat, shape, settings.dem, settings.dem_vertical)


def _camera(job: Writing, path: Path) -> None:
    """Write the camera with the photograph, and as text: its pose is found once for both."""
    rpc, uri = _camera_rpc(job.registration), job.registration.target.uri
    vrt.write_rpc_vrt(path, uri, to_gdal(rpc), final_path=job.places["camera"])
    write_rpc_text(rpc, job.staged["camera_text"])


def _raster(job: Writing, path: Path) -> None:
    """Write the registered raster, orthorectified where the target has RPCs."""
    registration, grid = job.registration, job.grid
    if grid is None:
        raise TypeError(f"a pair that is {registration.status} has no registered raster")
    target, settings = registration.target, registration.settings
    how = BandOutput(grid, settings.resampling, job.format, job.places["raster"])
    if registration.rpc is not None:
        orthorectify_band(target.uri, path, registration.rpc.corrected_grid, how, job.on_event)
    else:
        warp_band(target.uri, path, correction_of(registration), target.grid, how, job.on_event)


def _sigma(job: Writing, path: Path) -> None:
    if job.registration.selection is None or job.grid is None:
        raise TypeError("a registration without a fit has no sigma")
    write_sigma(path, job.registration.selection, job.registration.target.grid, job.grid)


def _rpc_text(job: Writing, path: Path) -> None:
    write_rpc_text(_corrected_rpc(job.registration), path)


def _proj_grid(job: Writing, path: Path) -> None:
    write_proj_grid(path, correction_of(job.registration), job.registration.target.grid)


def _inverse_proj_grid(job: Writing, path: Path) -> None:
    write_proj_grid(path, correction_of(job.registration), job.registration.target.grid, is_inverse=True)


def _item(job: Writing, path: Path) -> None:
    write_item(path, job.registration, job.accuracy, job.places, job.staged["raster"], job.bands)


def _annotation(job: Writing, path: Path) -> None:
    registration = job.registration
    target, settings = registration.target, registration.settings
    write_annotation(
        registration.tie_points,
        path,
        target.uri,
        target.grid.shape,
        source=settings.iiif_source,
        model=registration.model,
    )


def _in_geotransform(registration: Registration) -> bool:
    is_affine = isinstance(registration.model, AffineCorrection)
    return is_affine and registration.target.on_map


def _is_swath(registration: Registration) -> bool:
    return registration.target.grid.swath_uri is not None


def _has_exact_rpc(registration: Registration) -> bool:
    return registration.rpc is not None and registration.rpc.original.shifts is None


def _lon_lat(job: Writing, path: Path) -> None:
    write_lon_lat(path, correction_of(job.registration), job.registration.target.grid)


_ALWAYS: Final = Condition("always", lambda job: True)
_PAGE: Final = Condition("unless `--no-report`", lambda job: not job.settings.no_report)
_PDF: Final = Condition("with `--pdf`", lambda job: job.settings.pdf)
_MATCHED: Final = Condition("unless the pair is refused", lambda job: job.status != "rejected")
_WITH_HEIGHTS: Final = Condition(
    "a target with RPCs, unless refused", lambda job: job.status != "rejected" and job.rpc is not None
)
_CORRECTED: Final = Condition("`register`", lambda job: True, corrected=True)
_SHIFTED: Final = Condition(
    "shift or affine, of a target with georeferencing", _in_geotransform, corrected=True
)
_SWATH: Final = Condition("a target with geolocation arrays", _is_swath, corrected=True)
_IF_PLACED: Final = Condition("with `--write-placed`", lambda job: job.settings.write_placed)
_FETCHED: Final = Condition(
    "a web map as reference", lambda job: job.fetched is not None and not job.fetched.uri.endswith(".vrt")
)
_TILES: Final = Condition(
    "tiles as reference", lambda job: job.fetched is not None and job.fetched.uri.endswith(".vrt")
)
_CAMERA: Final = Condition(
    "with `--fiducials`, unless refused",
    lambda job: job.settings.fiducials is not None and job.status != "rejected",
)
_RPC: Final = Condition("a target with RPCs", _has_exact_rpc, corrected=True)
_SIGMA: Final = Condition("with `--write-sigma`", lambda job: job.settings.write_sigma, corrected=True)
_FIELD: Final = Condition(
    "with `--write-displacement`", lambda job: job.settings.write_displacement, corrected=True
)
_GRID: Final = Condition("with `--write-proj-grid`", lambda job: job.settings.write_proj_grid, corrected=True)
_ANNOTATION: Final = Condition(
    "with `--write-iiif`, unless refused", lambda job: job.settings.write_iiif and job.status != "rejected"
)
_ITEM: Final = Condition("with `--write-stac`", lambda job: job.settings.write_stac, corrected=True)
OUTPUTS: Final = (
    Output("numbers", "report.json", _ALWAYS, "the report for programs, as report.schema.json describes it"),
    Output("report", "report.html", _PAGE, "the report: verdict, views, figures, statistics, advice"),
    Output("pdf", "report.pdf", _PDF, "the report as PDF"),
    Output(
        "tiepoints", "tiepoints.csv", _ALWAYS, "positions, displacement, sigma, residual, status", _tiepoints
    ),
    Output("geopackage", "tiepoints.gpkg", _PAGE, "the same for QGIS, styled by residual", _geopackage),
    Output(
        "annotation",
        "{stem}_iiif.json",
        _ANNOTATION,
        "the tie points as a Georeference Annotation of IIIF",
        _annotation,
    ),
    Output(
        "corrected", "{stem}_corrected.vrt", _SHIFTED, "the target with corrected georeferencing", _corrected
    ),
    Output(
        "lon_lat",
        "{stem}_lonlat.tif",
        _SWATH,
        "the corrected longitude and latitude of each pixel of the target",
        _lon_lat,
    ),
    Output("basemap", "basemap.tif", _FETCHED, "what was fetched of a web map"),
    Output("tiles", "reference.vrt", _TILES, "the tiles of the reference that show ground of the target"),
    Output("placed", "{stem}_placed.vrt", _IF_PLACED, "the target as `--place` puts it", _placed),
    Output("camera", "{stem}_camera.vrt", _CAMERA, "the photograph with its camera as an RPC", _camera),
    Output("camera_text", "{stem}_camera_RPC.TXT", _CAMERA, "the camera as an RPC"),
    Output("rpc", "{stem}_rpc.vrt", _RPC, "the original target with the corrected RPC", _rpc),
    Output("rpc_text", "{stem}_rpc_RPC.TXT", _RPC, "the corrected RPC as text", _rpc_text),
    Output(
        "raster", "{stem}_registered.{ending}", _CORRECTED, "the target warped onto the output grid", _raster
    ),
    Output(
        "sigma", "{stem}_sigma.tif", _SIGMA, "sigma of the correction, px, and where it extrapolates", _sigma
    ),
    Output(
        "displacement",
        "{stem}_displacement.tif",
        _FIELD,
        "the displacement field, its sigma and quality",
        lambda job, path: write_displacement(path, job.registration),
    ),
    Output("proj_grid", "{stem}_proj.tif", _GRID, "the correction as a grid of offsets for PROJ", _proj_grid),
    Output(
        "inverse_proj_grid",
        "{stem}_proj_inverse.tif",
        _GRID,
        "the same from where places belong, to warp rasters",
        _inverse_proj_grid,
    ),
    Output(
        "item", "{stem}_item.json", _ITEM, "a STAC item of the registered raster, with its accuracy", _item
    ),
)
"""The files that a job may write, besides those in formats of tie points and the other bands of a product."""
OUTPUT_NAMES: Final = {output.kind: output.name for output in OUTPUTS}
"""File names by kind."""


def outputs() -> tuple[Output, ...]:
    """Return all files that a job may write, besides the other bands of a product.

    Raises `InputError` if a format of tie points of another package has the name of another output.
    """
    formats = tuple(FORMATS.ask(_of_format, Output))
    kinds = [output.kind for output in (*OUTPUTS, *formats)]
    repeated = [kind for kind in kinds if kinds.count(kind) > 1]
    if repeated:
        raise InputError(f"two packages have an output called {repeated[0]}: uninstall one of them")
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
        target = target.as_in_file()  # as QGIS shows it
        with FORMATS.blamed(form):
            rasters = PointRasters(reference, target, target.on_map, job.places[form.name])
            write(registration.tie_points, path, rasters)

    when = _WITH_HEIGHTS if form.needs_heights else _MATCHED
    return Output(form.name, form.file_name, when, form.description, write_table)


def _corrected_rpc(registration: Registration) -> RpcModel:
    if registration.rpc is None:
        raise TypeError("the target has no RPC")
    return registration.rpc.corrected_grid.rpc
