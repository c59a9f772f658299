"""A finished registration, read from its output folder, so that its correction can be applied again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from pcwlad_geo.correction.error_statistics import Accuracy
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.precision import Precision
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.limits import check_geotransform, check_shape
from pcwlad_geo.options import Resampling, Settings
from pcwlad_geo.raster import (
    Dem,
    FileIdentity,
    Grid,
    GridRequest,
    OutputFormat,
    describe,
    is_folder,
)
from pcwlad_geo.raster.grid import is_invertible, linear_part
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.registration import (
    CorrectedRpc,
    Registration,
    RpcRegistration,
    requested_grid,
)
from pcwlad_geo.registration.inputs import grid_request
from pcwlad_geo.report.content import SCHEMA_VERSION, GridEntry, QualityEntry, Report, RpcEntry
from pcwlad_geo.report.correction_file import (
    CorrectionFile,
    CorrectionModelEntry,
    OutputEntry,
    correction_file,
    is_correction_file,
)
from pcwlad_geo.report.json_content import filled
from pcwlad_geo.report.read_figures import (
    REPORT_FILE,
    ReadRequirement,
)
from pcwlad_geo.text import joined, mismatch, read_json, typed


@dataclass(frozen=True, slots=True)
class ReadRaster(GridEntry):
    """The raster of an input as a report.json has it."""

    path: str
    """Path or GDAL URI."""
    ground: GridEntry | None = None
    """The grid onto which a reference with RPC is orthorectified; None for any other."""


@dataclass(frozen=True, slots=True)
class ReadReport:
    """What is read back of the report.json of a finished registration."""

    reference: ReadRaster
    target: ReadRaster
    settings: Settings
    model: CorrectionModelEntry
    accuracy: Mapping[str, Mapping[str, Accuracy | None]] = field(default_factory=dict)
    quality: QualityEntry | None = None
    passed: bool | None = None
    requirements: tuple[ReadRequirement, ...] = ()
    output_grid: GridEntry | None = None
    rpc: RpcEntry | None = None
    inputs: tuple[FileIdentity, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FinishedRegistration:
    """The result of an earlier `pcwlad-geo register`."""

    correction: Correction
    """Maps predicted to observed pixels of `target_grid`."""
    reference_grid: Grid
    target_grid: Grid
    request: GridRequest
    """The output grid that was requested."""
    fmt: OutputFormat
    """The format of the registered raster."""
    resampling: str
    rpc: CorrectedRpc | None = None
    """RPCs of a target with one, by which other images taken with it are corrected."""
    inputs: tuple[FileIdentity, ...] = ()
    """Identities of the input files; empty in reports of earlier versions."""
    precision: Precision | None = None
    """Of a saved correction that holds it; that of a folder follows from its tie points."""


def read_registration(folder: str | os.PathLike[str]) -> FinishedRegistration:
    """Read a registration from its output folder, from its report.json, or from a saved correction.

    Raises `InputError` if there is no report.json of a finished registration, or the registration does not
    meet its requirements and was made without `keep`.
    """
    path, saved = read_saved(folder)
    return of_file(path, saved) if isinstance(saved, CorrectionFile) else of_report(path, saved)


def read_saved(folder: str | os.PathLike[str]) -> tuple[Path, CorrectionFile | ReadReport]:
    """Read a saved correction, or the report.json of a folder; the path is that of the file.

    Raises `InputError` if it is neither, damaged, or of a pair that was not registered.
    """
    path = Path(folder)
    path = path / REPORT_FILE if is_folder(path) else path
    content = _content(path)
    if is_correction_file(content):
        return path, correction_file(path, content)
    try:
        return path, typed(content, ReadReport)
    except ValueError as error:
        raise InputError(f"{path} is damaged ({joined(error)}): register the pair again") from error


def of_report(path: Path, report: ReadReport) -> FinishedRegistration:
    """Return the registration that a report.json tells of.

    Raises `InputError` if it is damaged, or does not meet its requirements and was made without `keep`.
    """
    settings = report.settings
    _check_requirements(path, report)
    try:
        return FinishedRegistration(
            correction=report.model.correction(),
            reference_grid=_grid(path, report.reference.ground or report.reference),
            target_grid=replace(_grid(path, report.target), by_hand=settings.place is not None),
            request=_request(path, report),
            fmt=OutputFormat.of(settings.of, settings.co),
            resampling=settings.resampling,
            rpc=_rpc(report.rpc, report.target, settings) if report.rpc else None,
            inputs=report.inputs,
        )
    except (TypeError, ValueError, OverflowError, CRSError, SettingsError) as error:
        raise InputError(
            f"{path} is damaged ({type(error).__name__}: {joined(error)}): register the pair again"
        ) from error


def of_file(path: Path, file: CorrectionFile) -> FinishedRegistration:
    """Return what a saved correction says of its pair.

    Raises `InputError` if it belongs to none, as one made by hand, or is damaged.
    """
    output, rpc = file.output, file.rpc
    if file.reference is None or file.target is None or output is None:
        raise InputError(
            f"{path} holds a correction made by hand, which belongs to no target: compose it with a fitted "
            "one (shift @ correction), or warp in Python with like=reference"
        )
    try:
        crs = None if output.t_srs is None else CRS.from_string(output.t_srs)
        like = None if output.like is None else _grid(path, output.like)
        return FinishedRegistration(
            correction=file.model.correction(),
            reference_grid=_grid(path, file.reference),
            target_grid=_grid(path, file.target),
            request=GridRequest(output.grid, like, output.tr, output.te, crs),
            fmt=OutputFormat.of(output.of, output.co),
            resampling=output.resampling,
            rpc=None if rpc is None else filled(CorrectedRpc, rpc, shape=file.target.shape),
            inputs=file.inputs,
            precision=None if file.sigma is None else file.sigma.lattice(),
        )
    except (TypeError, ValueError, CRSError, SettingsError) as error:
        raise InputError(f"{path} is damaged ({joined(error)}): save the correction again") from error


def output_of(registration: FinishedRegistration) -> OutputEntry:
    """Return how rasters are warped by a registration, as its file has it."""
    request, fmt = registration.request, registration.fmt
    return OutputEntry(
        grid=request.mode,
        like=None if request.like is None else grid_entry(request.like),
        tr=request.pixel_size,
        te=request.extent,
        t_srs=None if request.crs is None else request.crs.to_wkt(),
        of=fmt.driver,
        co=tuple(f"{name}={value}" for name, value in fmt.options.items()),
        resampling=cast(Resampling, registration.resampling),
    )


def grid_entry(grid: Grid) -> GridEntry:
    """Return a grid as JSON files have it."""
    crs = None if grid.crs is None else grid.crs.to_wkt()
    return GridEntry(grid.shape, tuple(grid.transform)[:6], crs, swath=grid.swath_uri)


def finished(registration: Registration) -> FinishedRegistration:
    """Return what `read_registration` reads, from a registration in memory.

    Raises `InputError` if it holds no correction.
    """
    settings, rpc = registration.settings, registration.rpc
    if registration.model is None:
        raise InputError(f"a pair that is {registration.status} has no correction: fit one first")
    return FinishedRegistration(
        correction=registration.model,
        reference_grid=ground_grid(registration.reference.grid),
        target_grid=registration.target.grid,
        request=requested_grid(settings),
        fmt=OutputFormat.of(settings.of, settings.co),
        resampling=settings.resampling,
        rpc=None if rpc is None else _corrected_rpc(rpc, registration),
        inputs=tuple(file.identity for file in registration.inputs),
    )


def _corrected_rpc(rpc: RpcRegistration, registration: Registration) -> CorrectedRpc:
    heights, settings = rpc.original.heights, registration.settings
    dem, above = heights if isinstance(heights, Dem) else None, settings.dem_vertical
    return CorrectedRpc(
        original=rpc.original.rpc,
        corrected=rpc.corrected_grid.rpc,
        shape=registration.target.grid.shape,
        dem=dem.uri if dem else None,
        dem_vertical=(os.fspath(above) if isinstance(above, Path) else above) if dem else None,
        height_m=None if isinstance(heights, Dem) else heights.height_m,
        trusted=settings.trust_rpc,
    )


def _content(path: Path) -> Mapping[str, Any]:
    """Return the content of the report.json of a registration."""
    try:
        report = read_json(path)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}), so this is no finished registration: give the output "
            "folder of pcwlad-geo register"
        ) from error
    except ValueError as error:
        raise InputError(
            f"{path} is no JSON, or cut off ({error}): save the correction again, or give the output folder "
            "of pcwlad-geo register"
        ) from error
    if is_correction_file(report):
        return report  # type: ignore[no-any-return]  # a dict
    if not isinstance(report, dict) or not {"schema_version", "status", "model"} <= report.keys():
        raise InputError(
            f"{path} was not written by pcwlad-geo: give the output folder of pcwlad-geo register"
        )
    if report["schema_version"] != SCHEMA_VERSION:
        raise InputError(
            f"{path} has schema version {report['schema_version']}, this version reads {SCHEMA_VERSION}: "
            "register the pair again"
        )
    if (wrong := mismatch(report, Report)) is not None:
        raise InputError(f"{path} is damaged ({wrong}): register the pair again")
    if report["status"] != "registered":
        reason = {"rejected": "the pair was refused", "matched": "it has tie points only"}
        raise InputError(
            f"{path.parent} holds no correction: {reason.get(report['status'], report['status'])}; "
            "give the output folder of pcwlad-geo register"
        )
    return report


def _check_requirements(path: Path, report: ReadReport) -> None:
    """Raise if the registration has no corrected raster because it does not meet its requirements."""
    if report.passed is not False or report.settings.keep:
        return
    missed = "; ".join(requirement.message for requirement in report.requirements if not requirement.met)
    raise InputError(
        f"{path.parent} holds a registration that does not meet its requirements: {missed}; register the "
        "pair again with --keep, or without that requirement"
    )


def _request(path: Path, report: ReadReport) -> GridRequest:
    """Return the requested output grid; a raster that defined it is not needed again."""
    settings = report.settings
    if settings.like is not None and report.output_grid is not None:
        return GridRequest(like=_grid(path, report.output_grid))
    return grid_request(settings.grid, None, settings.tr, settings.te, settings.t_srs)


def _rpc(rpc: RpcEntry, target: ReadRaster, settings: Settings) -> CorrectedRpc:
    if rpc.corrected is None:
        raise ValueError("it has no corrected RPC")
    return CorrectedRpc(
        original=rpc.original,
        corrected=rpc.corrected,
        shape=target.shape,
        dem=rpc.dem,
        dem_vertical=rpc.dem_vertical,
        height_m=rpc.height_m,
        trusted=settings.trust_rpc,
    )


def _grid(path: Path, raster: GridEntry) -> Grid:
    """Return the grid that a report gives, which is bounded as one that a raster gives."""
    (rows, cols), place = raster.shape, Affine(*raster.transform)
    if min(rows, cols) < 1 or not is_invertible(linear_part(place)):
        raise ValueError(f"a raster of {cols} x {rows} pixels, or a geotransform without an inverse")
    check_shape(str(path), (rows, cols), 1)
    check_geotransform(str(path), raster.transform, (rows, cols))
    if raster.swath is not None:
        grid = describe(raster.swath, part=True).grid
        if grid.shape == (rows, cols):
            return grid
        raise ValueError(f"{raster.swath} has another size now")
    return Grid((rows, cols), place, None if raster.crs is None else CRS.from_string(raster.crs))
