"""The files of a finished job, by kind: which there are, and what writes each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.rpc_model import RpcModel
from pcwlad_geo.raster import (
    gcp_files,
    geopackage,
    rpc_files,
    rpc_warping,
    sigma_raster,
    tie_point_csv,
    vrt,
    warping,
)
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import check_covered, corrected_outline, output_grids
from pcwlad_geo.raster.product import ProductBand
from pcwlad_geo.raster.rpc_view import ground_grid
from pcwlad_geo.raster.shared_plane import grid_beside
from pcwlad_geo.raster.source import describe
from pcwlad_geo.registration.output_wishes import requested_grid
from pcwlad_geo.registration.progress import EventCallback, Progress, Warned
from pcwlad_geo.registration.result import Registration


def kinds(registration: Registration) -> list[str]:
    """Return the kinds of output that a job of this end has, without its report.

    A target with RPC has that corrected, not a geotransform; models beyond affine have neither. Where a
    requirement is not met, the corrected files are written on request only.
    """
    found = ["tiepoints", "geopackage"]
    if registration.status != "rejected":
        found += ["points", "envi", "gcps"]
    if not corrects(registration):
        return found
    if registration.rpc is not None:
        found += ["rpc", "rpc_text"]
    elif isinstance(registration.correction, AffineCorrection) and registration.target.georeferenced:
        found.append("corrected")
    return [*found, "raster", *(["sigma"] if registration.settings.write_sigma else [])]


def output_grids_of(registration: Registration, bands: Sequence[ProductBand]) -> list[Grid]:
    """Return the grids of the registered raster and of other bands of its product, which share an extent.

    Raises
    ------
    InputError
        If the grid that the user asks for shows nothing of the corrected target.
    """
    reference, target = ground_grid(registration.reference.grid), registration.target.grid
    request = requested_grid(registration.settings)
    if registration.rpc is not None:
        corrected = registration.rpc.corrected_grid
        grids = rpc_warping.requested_ortho_grids(reference, corrected, request, [corrected])
        outline_xy = corrected.to_xy(corrected.boundary_px())
    else:
        correction = _correction(registration)
        rasters = [target, *(grid_beside(describe(band.opened_as()), target) for band in bands)]
        grids = output_grids(reference, target, correction, request, rasters)
        outline_xy = corrected_outline(target, correction)
    for grid in grids if request.needs_ground or request.fixed(reference) else ():
        check_covered(grid, outline_xy, target.crs)
    return grids


def corrects(registration: Registration) -> bool:
    """Whether a job of this end has corrected files."""
    wanted = registration.passed is not False or registration.settings.keep
    return registration.status == "registered" and wanted


def writers(
    registration: Registration, places: Mapping[str, Path], grid: Grid | None, on_event: EventCallback
) -> dict[str, Callable[[Path], None]]:
    """Return what writes each kind of output to a path.

    `places` says where the files will live in the end: what they point to is relative to that. `grid` is that
    of the registered raster, None where there is none.
    """
    table, target, reference = registration.tie_points, registration.target, registration.reference
    on_ground = target.georeferenced and registration.rpc is None

    def write_corrected(path: Path) -> None:
        correction = _correction(registration)
        if not isinstance(correction, AffineCorrection):
            raise TypeError(f"{correction.name} corrections have no geotransform")
        vrt.write_corrected_vrt(path, target.uri, correction, target.grid, final_path=places["corrected"])

    def write_raster(path: Path) -> None:
        if grid is None:
            raise TypeError(f"a pair that is {registration.status} has no registered raster")

        def progress(done: int, total: int) -> None:
            on_event(Progress("warping", done, total))

        settings = registration.settings
        resampling, made = settings.resampling, OutputFormat.of(settings.of, settings.co)
        if registration.rpc is not None:
            corrected = registration.rpc.corrected_grid
            warning = rpc_warping.orthorectify(
                target.uri, path, corrected, grid, resampling, made=made, progress=progress
            )
        else:
            correction = _correction(registration)
            warning = warping.warp(
                target.uri,
                path,
                correction,
                grid,
                resampling,
                target_grid=target.grid,
                made=made,
                final_path=places["raster"],
                progress=progress,
            )
        if warning is not None:
            on_event(Warned(warning))

    def write_sigma(path: Path) -> None:
        if registration.selection is None or grid is None:
            raise TypeError("a registration without a fit has no sigma")
        sigma_raster.write(path, registration.selection, target.grid, grid)

    return {
        "tiepoints": lambda path: tie_point_csv.write(table, path),
        "geopackage": lambda path: geopackage.write(table, path, target.grid),
        "points": lambda path: gcp_files.write_points(table, path, on_ground, target.grid),
        "envi": lambda path: gcp_files.write_envi(table, path, reference.uri, target.uri),
        "gcps": lambda path: vrt.write_gcps_vrt(
            path, target.uri, table, table.crs, final_path=places["gcps"]
        ),
        "corrected": write_corrected,
        "rpc": lambda path: vrt.write_rpc_vrt(
            path, target.uri, rpc_files.to_gdal(_corrected_rpc(registration)), final_path=places["rpc"]
        ),
        "rpc_text": lambda path: rpc_files.write_rpc_text(_corrected_rpc(registration), path),
        "raster": write_raster,
        "sigma": write_sigma,
    }


def write_band(
    registration: Registration,
    band: ProductBand,
    path: Path,
    grid: Grid,
    final_path: Path,
    on_event: EventCallback,
) -> None:
    """Write another band of the target's product, corrected as the target is."""
    settings, target = registration.settings, registration.target.grid
    made = OutputFormat.of(settings.of, settings.co)
    how = BandOutput(grid, settings.resampling, made, final_path)
    warp_band(band.opened_as(), path, _correction(registration), target, how, on_event)


@dataclass(frozen=True, slots=True)
class BandOutput:
    """How a band is written."""

    grid: Grid
    resampling: str
    made: OutputFormat
    final_path: Path
    """Where it will live."""


def warp_band(
    source: str,
    path: Path,
    correction: Correction,
    target_grid: Grid,
    how: BandOutput,
    on_event: EventCallback,
) -> None:
    """Warp a raster of the target's geometry by the correction of the target.

    Parameters
    ----------
    source : str
        Path or GDAL URI.
    path : pathlib.Path
        The file to write.
    correction : Correction
    target_grid : Grid
        Of the registered target.
    how : BandOutput
    on_event : callable
        Receives `Progress` events, and a warning where parts of the raster cannot be read.
    """
    warning = warping.warp(
        source,
        path,
        correction,
        how.grid,
        how.resampling,
        target_grid=target_grid,
        made=how.made,
        final_path=how.final_path,
        progress=lambda done, total: on_event(Progress("warping", done, total)),
    )
    if warning is not None:
        on_event(Warned(warning))


def _corrected_rpc(registration: Registration) -> RpcModel:
    if registration.rpc is None:
        raise TypeError("the target has no RPC")
    return registration.rpc.corrected_grid.rpc


def _correction(registration: Registration) -> Correction:
    if registration.correction is None:
        raise TypeError(f"a pair that is {registration.status} has no correction")
    return registration.correction
