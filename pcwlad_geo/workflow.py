"""The jobs: run, then write the folder. What the command line and the Python API share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Literal, TypedDict

from pcwlad_geo.errors import OutputError, RegistrationRejectedError, RequirementError
from pcwlad_geo.limits import NAME_BYTES
from pcwlad_geo.output_names import CORRECTED, NAMES
from pcwlad_geo.raster.identity import check_unchanged
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.products import stem_of
from pcwlad_geo.raster.source import file_name, plain_name
from pcwlad_geo.raster.trust import trusting
from pcwlad_geo.registration import settings as s
from pcwlad_geo.registration.forecast import likely_tiles
from pcwlad_geo.registration.inputs import band_file, resolve
from pcwlad_geo.registration.output_wishes import check_output
from pcwlad_geo.registration.progress import Event, EventCallback, Progress, ignore
from pcwlad_geo.registration.runners import open_runner
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.registration.tasks import InThisProcess, Runner
from pcwlad_geo.report.pdf import check_pdf
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.staging import OutputFolder, place_file, place_with_files

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.registration.result import Registration

PathLike = str | os.PathLike[str]
Job = Literal["registered", "matched"]


class Options(TypedDict, total=False):
    """The fields of `Settings`, as keywords."""

    ref_band: int | str
    tgt_band: int | str
    ref_mask: Path | str | None
    tgt_mask: Path | str | None
    tie_points: Path | str | None
    dem: Path | str | None
    dem_vertical: float | Path | str | None
    trust_rpc: bool
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
    like: Path | str | None
    tr: tuple[float, float] | None
    te: tuple[float, float, float, float] | None
    t_srs: str | None
    of: str
    co: tuple[str, ...]
    resampling: s.Resampling
    write_sigma: bool
    pdf: bool
    require: str | Sequence[str]
    keep: bool
    tile_size: int
    allow_remote: bool
    trust_vrt: bool
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
        Raster that stays, or a product with `ref_band` the name of a band.
    target : path
        Raster that moves, or a product: all its bands are corrected as `tgt_band` is.
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
    RequirementError
        If a requirement (`require`) is not met; the report is written, corrected files only with `keep`.
    """
    settings = Settings.from_options(options)
    places = output_paths(
        target,
        "registered",
        tgt_band=settings.tgt_band,
        of=settings.of,
        out_dir=out_dir,
        output_raster=output_raster,
        output_tiepoints=output_tiepoints,
        output_report=output_report,
        output_points=output_points,
    )
    job = partial(_run, reference, target, settings, executor)
    with trusting(settings.trust):
        return _run_and_write(job, "register", (reference, target), settings, places, overwrite, on_event)


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
    settings = Settings.from_options(options)
    places = output_paths(
        target,
        "matched",
        tgt_band=settings.tgt_band,
        out_dir=out_dir,
        output_tiepoints=output_tiepoints,
        output_report=output_report,
        output_points=output_points,
    )
    job = partial(_run, reference, target, settings, executor, match_only=True)
    with trusting(settings.trust):
        return _run_and_write(job, "match", (reference, target), settings, places, overwrite, on_event)


def output_paths(
    target: PathLike,
    job: Job,
    *,
    tgt_band: int | str = 1,
    of: str = "COG",
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
        Path or GDAL URI of the target, or a product.
    job : {"registered", "matched"}
        Ending of the default output folder.
    tgt_band : int or str
        Band of the target: the files are named after that of a product.
    of : str
        Format of the registered raster.
    out_dir, output_raster, output_tiepoints, output_report, output_points : path, optional
        As `register` takes them.
    """
    name = plain_name(file_name(band_file(target, tgt_band)))
    stem = Path(name).stem
    folder = Path(out_dir) if out_dir else output_folder(target, job)
    kinds = [kind for kind in NAMES if job == "registered" or kind not in CORRECTED]
    ending = OutputFormat(of).extension
    paths = {kind: folder / NAMES[kind].format(name=name, stem=stem, ending=ending) for kind in kinds}
    elsewhere = {
        "raster": output_raster,
        "tiepoints": output_tiepoints,
        "report": output_report,
        "points": output_points,
    }
    return paths | {kind: Path(path) for kind, path in elsewhere.items() if path}


def output_folder(target: PathLike, job: Job) -> Path:
    """Return the default output folder of a job, in the working folder."""
    return Path(f"{plain_name(stem_of(target))}_{job}")


def _run(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    executor: Executor | Runner | None,
    on_event: EventCallback,
    match_only: bool = False,
) -> Registration:
    """Run a job where its settings say, or on what the caller gives."""
    # points of a file leave workers nothing to do
    with open_runner(settings, InThisProcess() if settings.tie_points else executor, on_event) as runner:
        runner.expect(likely_tiles(reference, target, settings))
        from pcwlad_geo.registration.run import run  # slow to load; workers may be loading it too

        return run(reference, target, settings, on_event=on_event, runner=runner, match_only=match_only)


def _run_and_write(
    job: Callable[[EventCallback], Registration],
    command: Literal["register", "match"],
    inputs: tuple[PathLike, PathLike],
    settings: Settings,
    places: Mapping[str, Path],
    overwrite: bool,
    on_event: EventCallback,
) -> Registration:
    """Check the outputs, run the job, write its files beside their places, then put them there at once."""
    requirements = parse_requirements(settings.require, command)
    if settings.pdf:
        check_pdf()
    out_dir = places["numbers"].parent
    inside = output_paths(
        inputs[1], "registered", tgt_band=settings.tgt_band, of=settings.of, out_dir=out_dir
    )
    elsewhere = {kind: path for kind, path in places.items() if path != inside[kind]}
    _check_places(places, elsewhere, [*inputs, *settings.files], overwrite)
    made = OutputFormat.of(settings.of, settings.co)
    if "raster" in places:
        check_output(*inputs, settings)
    with OutputFolder(out_dir, overwrite=overwrite) as folder:
        staged = {
            kind: folder.stage / inside[kind].name if kind in elsewhere else folder.path(inside[kind].name)
            for kind in places
        }
        bands = {
            band: folder.path(plain_name(f"{Path(file_name(band.uri)).stem}_registered.{made.extension}"))
            for band in resolve(*inputs, settings, all_bands="raster" in places).other_bands
        }
        registration = job(_preloading(on_event))
        # inside: slow to load, which `_preloading` may have done
        from pcwlad_geo.report.requirements import judge_requirements
        from pcwlad_geo.writing import write

        registration = replace(registration, requirements=judge_requirements(registration, requirements))
        with folder.writing():
            written = write(registration, staged, places, elsewhere, bands, on_event)
        registration = replace(registration, warnings=registration.warnings + written.warnings)
        check_unchanged(file.identity for file in registration.inputs)
        for kind in written.kinds:
            if kind in elsewhere:
                put = place_with_files if kind == "raster" else place_file
                put(staged[kind], elsewhere[kind], overwrite=overwrite)
        folder.commit()
    if registration.status == "rejected":
        message = f"{registration.reason} (report: {places['report']})"
        raise RegistrationRejectedError(message, registration, out_dir)
    if registration.passed is False:
        missed = "; ".join(each.text for each in registration.requirements if not each.met)
        raise RequirementError(f"{missed} (report: {places['report']})", registration, out_dir)
    return registration


def _preloading(on_event: EventCallback) -> EventCallback:
    """Return what passes events on, and loads what comes after the matching once that has begun."""
    threads: list[Thread] = []

    def load() -> None:
        with suppress(Exception):  # whoever needs it will say it
            import_module("pcwlad_geo.registration.kernels").load_own_kernel()
            import_module("pcwlad_geo.writing")

    def tell(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "matching" and not threads:
            threads.append(Thread(target=load))
            threads[0].start()
        on_event(event)

    return tell


def _check_name(place: Path) -> None:
    """Raise where no file of this name can be made, or GDAL cannot make it."""
    try:
        sizes = [len(part.encode()) for part in place.parts]
    except UnicodeEncodeError as error:
        raise OutputError(
            f"the output {str(place)!r} has a name that is not UTF-8, which GDAL needs: rename the target, "
            "or give another folder (-o)"
        ) from error
    if max(sizes) > NAME_BYTES:
        raise OutputError(
            f"the output {place} has a name of {max(sizes)} bytes, and at most {NAME_BYTES} are possible: "
            "give the target a shorter name, or another folder (-o)"
        )


def _check_places(
    places: Mapping[str, Path],
    elsewhere: Mapping[str, Path],
    inputs: Iterable[PathLike | None],
    overwrite: bool,
) -> None:
    """Raise where an output would replace an input, or a file that may not be replaced."""
    for place in places.values():
        _check_name(place)
    files = [Path(file) for file in inputs if file is not None and Path(file).exists()]
    for place in places.values():
        if place.exists() and any(place.samefile(file) for file in files):
            raise OutputError(f"the output {place} is an input too: choose another output folder or name")
    for place in elsewhere.values():
        if place.exists() and not overwrite:
            raise OutputError(f"{place} exists: give --overwrite to replace it, or another name")
