"""The jobs: run, then write the folder. What the command line and the Python API share."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.rpc_model import RpcModel
from pcwlad_geo.errors import OutputError, RegistrationRejectedError
from pcwlad_geo.raster import gcp_files, geopackage, rpc_files, rpc_warping, tie_point_csv, vrt, warping
from pcwlad_geo.registration import settings as s
from pcwlad_geo.registration.progress import EventCallback, Progress, ignore
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.runners import open_runner
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.registration.tasks import Runner
from pcwlad_geo.report.summary import summarise, to_json
from pcwlad_geo.staging import OutputFolder, place_file

if TYPE_CHECKING:
    from typing_extensions import Unpack

PathLike = str | os.PathLike[str]
Job = Literal["registered", "matched"]

NAMES = {
    "numbers": "report.json",
    "report": "report.html",
    "tiepoints": "tiepoints.csv",
    "geopackage": "tiepoints.gpkg",
    "points": "{name}.points",
    "gcps": "{stem}_gcps.vrt",
    "envi": "{stem}.pts",
    "corrected": "{stem}_corrected.vrt",
    "rpc": "{stem}_rpc.vrt",
    "rpc_text": "{stem}_rpc_RPC.TXT",
    "raster": "{stem}_registered.tif",
}
"""File names of the outputs in OUT_DIR; name and stem are the target's."""
CORRECTED = ("corrected", "rpc", "rpc_text", "raster")
"""Those that need a correction."""


class Options(TypedDict, total=False):
    """The fields of `Settings`, as keywords."""

    ref_band: int
    tgt_band: int
    ref_mask: Path | None
    tgt_mask: Path | None
    dem: Path | None
    dem_vertical: float | Path | None
    method: s.Method
    points: int | Literal["all"] | None
    features: int
    keypoints: s.Keypoints
    template: int
    window: int
    search_radius: int | None
    ssim_min: float
    iterations: int
    consensus: s.Consensus
    prealign: s.Prealign
    model: s.Model
    grid: s.OutputGrid
    resampling: s.Resampling
    tile_size: int
    jobs: int | None
    scheduler: str | None


def register(
    reference: PathLike,
    target: PathLike,
    *,
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    output_raster: PathLike | None = None,
    output_tiepoints: PathLike | None = None,
    output_report: PathLike | None = None,
    output_points: PathLike | None = None,
    **options: Unpack[Options],
) -> Registration:
    """Register the target to the reference and write tie points, corrected raster and report.

    Parameters
    ----------
    reference : path
        Raster that stays.
    target : path
        Raster that moves.
    out_dir : path, optional
        Output folder; ``<target stem>_registered`` in the working folder by default.
    overwrite : bool
        Replace the results of an earlier run in `out_dir`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the job.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = `jobs` processes, or the workers of `scheduler`.
    output_raster, output_tiepoints, output_report, output_points : path, optional
        Write the registered raster, the tie points CSV, the report page, the QGIS points there instead of
        into `out_dir`.
    **options
        The fields of `Settings`.

    Returns
    -------
    Registration
        Its tie points are in pixels (col, row) of the original files, corner-based.

    Raises
    ------
    InputError
        If a raster or an option cannot be used; nothing is written.
    OutputError
        If the results cannot be written; nothing is left half-written.
    ExecutionError
        If what the job runs on cannot be used or is lost; nothing is written.
    RegistrationRejectedError
        If the pair cannot be registered reliably; the report is written, a registered raster is not.
    """
    places = output_paths(
        target,
        "registered",
        out_dir=out_dir,
        output_raster=output_raster,
        output_tiepoints=output_tiepoints,
        output_report=output_report,
        output_points=output_points,
    )
    settings = Settings.from_options(options)
    job = partial(_run, reference, target, settings, on_event, executor)
    return _run_and_write(job, (reference, target), settings, places, overwrite, on_event)


def match(
    reference: PathLike,
    target: PathLike,
    *,
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    output_tiepoints: PathLike | None = None,
    output_report: PathLike | None = None,
    output_points: PathLike | None = None,
    **options: Unpack[Options],
) -> Registration:
    """Match the target to the reference and write the tie points and a report; nothing is fitted or warped.

    Parameters, errors and result are those of `register`; `out_dir` is ``<target stem>_matched`` by default,
    and the result has no correction.
    """
    places = output_paths(
        target,
        "matched",
        out_dir=out_dir,
        output_tiepoints=output_tiepoints,
        output_report=output_report,
        output_points=output_points,
    )
    settings = Settings.from_options(options)
    job = partial(_run, reference, target, settings, on_event, executor, match_only=True)
    return _run_and_write(job, (reference, target), settings, places, overwrite, on_event)


def output_paths(
    target: PathLike,
    job: Job,
    *,
    out_dir: PathLike | None = None,
    output_raster: PathLike | None = None,
    output_tiepoints: PathLike | None = None,
    output_report: PathLike | None = None,
    output_points: PathLike | None = None,
) -> dict[str, Path]:
    """Return where each kind of output goes that a job may write.

    Parameters
    ----------
    target : path
        Path or GDAL URI of the target.
    job : {"registered", "matched"}
        Ending of the default output folder.
    out_dir, output_raster, output_tiepoints, output_report, output_points : path, optional
        As `register` takes them.
    """
    # A URI's name may be none for a file, "." and "/" have none, and results do not hide behind a dot.
    name = re.sub(r'[<>:"/\\|?*]+', "_", Path(target).name).lstrip(".") or "raster"
    stem = Path(name).stem
    folder = Path(out_dir) if out_dir else Path(f"{stem}_{job}")
    kinds = [kind for kind in NAMES if job == "registered" or kind not in CORRECTED]
    paths = {kind: folder / NAMES[kind].format(name=name, stem=stem) for kind in kinds}
    elsewhere = {
        "raster": output_raster,
        "tiepoints": output_tiepoints,
        "report": output_report,
        "points": output_points,
    }
    return paths | {kind: Path(path) for kind, path in elsewhere.items() if path}


def _run(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    on_event: EventCallback,
    executor: Executor | Runner | None,
    match_only: bool = False,
) -> Registration:
    """Run a job where its settings say, or on what the caller gives."""
    with open_runner(settings, executor, on_event) as runner:
        from pcwlad_geo.registration.run import run  # slow to load: the workers start meanwhile

        return run(reference, target, settings, on_event=on_event, runner=runner, match_only=match_only)


def _run_and_write(
    job: Callable[[], Registration],
    inputs: tuple[PathLike, PathLike],
    settings: Settings,
    places: Mapping[str, Path],
    overwrite: bool,
    on_event: EventCallback,
) -> Registration:
    """Check the outputs, run the job, write its files beside their places, then put them there at once."""
    out_dir = places["numbers"].parent
    inside = output_paths(inputs[1], "registered", out_dir=out_dir)
    elsewhere = {kind: path for kind, path in places.items() if path != inside[kind]}
    options = (settings.ref_mask, settings.tgt_mask, settings.dem, settings.dem_vertical)
    files = [option for option in options if isinstance(option, Path)]
    _check_places(places, elsewhere, [*inputs, *files], overwrite)
    with OutputFolder(out_dir, overwrite=overwrite) as folder:
        staged = {
            kind: folder.stage / inside[kind].name if kind in elsewhere else folder.path(inside[kind].name)
            for kind in places
        }
        registration = job()
        for kind in _write(registration, staged, places, elsewhere, on_event):
            if kind in elsewhere:
                place_file(staged[kind], elsewhere[kind], overwrite=overwrite)
        folder.commit()
    if registration.status == "rejected":
        message = f"{registration.reason} (report: {places['report']})"
        raise RegistrationRejectedError(message, registration, out_dir)
    return registration


def _check_places(
    places: Mapping[str, Path],
    elsewhere: Mapping[str, Path],
    inputs: Iterable[PathLike | None],
    overwrite: bool,
) -> None:
    """Raise where an output would replace an input, or a file that may not be replaced."""
    files = [Path(file) for file in inputs if file is not None and Path(file).exists()]
    for place in places.values():
        if place.exists() and any(place.samefile(file) for file in files):
            raise OutputError(f"the output {place} is an input too: choose another output folder or name")
    for place in elsewhere.values():
        if place.exists() and not overwrite:
            raise OutputError(f"{place} exists: give --overwrite to replace it, or another name")


def _write(
    registration: Registration,
    staged: Mapping[str, Path],
    places: Mapping[str, Path],
    elsewhere: Collection[str],
    on_event: EventCallback,
) -> list[str]:
    """Write all files of a job, the report last, and return their kinds."""
    from pcwlad_geo.report.page import render  # slow to load: the figures' library

    since = time.perf_counter()
    writers = _writers(registration, places, on_event)
    kinds = _kinds(registration)
    total = len(kinds) + 1  # the report is one
    for done, kind in enumerate(kinds):
        on_event(Progress("writing", done, total))
        writers[kind](staged[kind])
    on_event(Progress("writing", len(kinds), total))
    seconds = registration.seconds | {"writing": time.perf_counter() - since}
    written = [*kinds, "report", "numbers"]
    names = sorted(staged[kind].name for kind in written if kind not in elsewhere)
    summary = summarise(replace(registration, seconds=seconds), names)
    page = render(registration, summary, staged["gcps"].name if "gcps" in kinds else None)
    staged["report"].write_text(page, encoding="utf-8", newline="\n")
    staged["numbers"].write_text(to_json(summary), encoding="utf-8", newline="\n")
    on_event(Progress("writing", total, total))
    return written


def _kinds(registration: Registration) -> list[str]:
    """Return the kinds of output that a job of this end has, without its report."""
    kinds = ["tiepoints", "geopackage"]
    if registration.status != "rejected":
        kinds += ["points", "envi", "gcps"]
    if registration.status == "registered" and registration.rpc is not None:
        kinds += ["rpc", "rpc_text", "raster"]
    elif registration.status == "registered":
        kinds += ["corrected", "raster"] if registration.target.georeferenced else ["raster"]
    return kinds


def _writers(
    registration: Registration, places: Mapping[str, Path], on_event: EventCallback
) -> dict[str, Callable[[Path], None]]:
    """Return what writes each kind of output to a path."""
    table, target, reference = registration.tie_points, registration.target, registration.reference
    on_ground = target.georeferenced and registration.rpc is None

    def write_corrected(path: Path) -> None:
        vrt.write_corrected_vrt(
            path, target.uri, _correction(registration), target.grid, final_path=places["corrected"]
        )

    def write_raster(path: Path) -> None:
        def progress(done: int, total: int) -> None:
            on_event(Progress("warping", done, total))

        if registration.rpc is not None:
            corrected = registration.rpc.corrected_grid
            ortho = rpc_warping.ortho_grid(reference.grid, corrected)
            resampling = registration.settings.resampling
            rpc_warping.orthorectify(target.uri, path, corrected, ortho, resampling, progress=progress)
            return
        correction = _correction(registration)
        grid = warping.output_grid(reference.grid, target.grid, correction, registration.settings.grid)
        warping.warp(
            target.uri,
            path,
            correction,
            grid,
            registration.settings.resampling,
            progress=progress,
        )

    return {
        "tiepoints": lambda path: tie_point_csv.write(table, path),
        "geopackage": lambda path: geopackage.write(table, path),
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
    }


def _corrected_rpc(registration: Registration) -> RpcModel:
    if registration.rpc is None:
        raise TypeError("the target has no RPC")
    return registration.rpc.corrected_grid.rpc


def _correction(registration: Registration) -> AffineCorrection:
    if not isinstance(registration.correction, AffineCorrection):
        raise TypeError(f"{registration.correction!r} is no affine correction")
    return registration.correction
