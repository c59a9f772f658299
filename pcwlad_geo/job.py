"""The jobs: the four steps of `registration.run`, then the folder. The command line and Python share them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, Literal, TypedDict, get_args

from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.arguments import checked, fits, shown
from pcwlad_geo.correction import Effort
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo.events import Event, EventCallback, Progress, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.execution.workers import open_runner
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder, place_file, place_with_files
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.outputs.write import outputs, write
from pcwlad_geo.products.finding import products_found_once as products_found_once
from pcwlad_geo.products.finding import stem_of
from pcwlad_geo.raster.arrays import file_of
from pcwlad_geo.raster.file_tree import file_name, plain_name
from pcwlad_geo.raster.identity import check_unchanged
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.trust.permissions import trusting
from pcwlad_geo.registration import check_output, resolve
from pcwlad_geo.registration.inputs import band_file
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.text import joined
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from rasterio.io import DatasetReader
    from typing_extensions import Unpack

    from pcwlad_geo.correction.proof_result import Proof
    from pcwlad_geo.options import Options
    from pcwlad_geo.products.product import ProductBand
    from pcwlad_geo.registration import Registration

Job = Literal["registered", "matched"]


class OutputPlaces(TypedDict, total=False):
    """Where outputs go, as keywords."""

    out_dir: PathLike | None
    output_raster: PathLike | None
    output_tiepoints: PathLike | None
    output_report: PathLike | None
    output_points: PathLike | None


@dataclass(frozen=True, slots=True)
class _Job:
    """What is registered or matched, and what is written."""

    command: Literal["register", "match"]
    inputs: tuple[str, str]
    """Reference and target: paths, GDAL URIs or products."""
    settings: Settings
    places: Mapping[str, Path]
    """Where each kind of output goes."""
    overwrite: bool


@checked("reference", "target")
@products_found_once()
def register(
    reference: PathLike | DatasetReader,
    target: PathLike | DatasetReader,
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
    reference : path or rasterio dataset
        Raster that stays, or a product with `ref_band` the name of a band.
    target : path or rasterio dataset
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
        Its tie points are in pixels (col, row) of the original files, corner-based; its `outputs` are the
        files written, by kind.

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
    places: OutputPlaces = {
        "out_dir": out_dir,
        "output_raster": output_raster,
        "output_tiepoints": output_tiepoints,
        "output_report": output_report,
        "output_points": output_points,
    }
    job = _job("register", (file_of(reference), file_of(target)), overwrite, places, options)
    return _run_and_write(job, executor, on_event)


@checked("reference", "target")
@products_found_once()
def match_files(
    reference: PathLike | DatasetReader,
    target: PathLike | DatasetReader,
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
    places: OutputPlaces = {
        "out_dir": out_dir,
        "output_tiepoints": output_tiepoints,
        "output_report": output_report,
        "output_points": output_points,
    }
    job = _job("match", (file_of(reference), file_of(target)), overwrite, places, options)
    return _run_and_write(job, executor, on_event)


def match_elsewhere(inputs: tuple[str, str], settings: Settings, place: Path) -> Registration | str:
    """Match a pair for `write_match` in another process; a string says why it cannot be matched.

    Nothing is written to `place`, which that process may not share with this one.
    """
    from pcwlad_geo.registration import register_pair  # slow to load, and workers may be started before

    try:
        with trusting(settings.trust):
            return register_pair(*inputs, settings, runner=InThisProcess(), match_only=True)
    except InputError as error:
        return joined(error)


def write_match(
    found: Registration,
    reference: str,
    target: str,
    *,
    out_dir: Path,
    overwrite: bool,
    **options: Unpack[Options],
) -> Registration:
    """Write the results of a pair that `match_elsewhere` has matched, as `match_files` does."""
    job = _job("match", (reference, target), overwrite, {"out_dir": out_dir}, options)
    return _run_and_write(job, None, ignore, found)


def _job(
    command: Literal["register", "match"],
    inputs: tuple[str, str],
    overwrite: bool,
    places: OutputPlaces,
    options: Options,
) -> _Job:
    settings = Settings.from_options(options)
    if settings.no_report and places.get("output_report") is not None:
        raise SettingsError("output_report names a page that no_report leaves out: give one of them")
    kind: Job = "registered" if command == "register" else "matched"
    paths = output_paths(inputs[1], kind, tgt_band=settings.tgt_band, of=settings.of, **places)
    return _Job(command, inputs, settings, paths, overwrite)


def output_paths(
    target: PathLike, job: Job, *, tgt_band: int | str = 1, of: str = "COG", **places: Unpack[OutputPlaces]
) -> dict[str, Path]:
    """Return where each kind of output goes that a job may write.

    The default folder ends with the name of the `job`; files of a product are named after its band
    `tgt_band`, and the registered raster has the format `of`. The `places` are `out_dir` and the paths of
    single outputs, as `register` takes them.
    """
    name = plain_name(file_name(band_file(target, tgt_band)))
    stem = Path(name).stem
    given: dict[str, Any] = {**places}
    folder = output_folder(target, job, given.pop("out_dir", None))
    ending = OutputFormat(of).extension
    paths = {
        output.kind: folder / output.name.format(name=name, stem=stem, ending=ending)
        for output in outputs()
        if job == "registered" or not output.when.corrected
    }
    return paths | {name.removeprefix("output_"): Path(path) for name, path in given.items() if path}


def output_folder(target: PathLike, job: Job | Literal["proof"], out_dir: PathLike | None = None) -> Path:
    """Return `out_dir`, or the default output folder of a job, in the working folder."""
    return Path(out_dir or f"{plain_name(stem_of(target))}_{job}")


def open_job_runner(
    settings: Settings, executor: Executor | Runner | None, on_event: EventCallback
) -> AbstractContextManager[Runner]:
    """Open what runs the tiles of a job, or of many: the caller's executor, a cluster, or own processes.

    `scheduler` and `jobs` of the settings choose it where there is no executor; a runner is open already, and
    stays so. Warnings about it go to `on_event`. Raises `ExecutionError` if the scheduler cannot be used.
    """
    return open_runner(executor, on_event, jobs=settings.jobs, scheduler=settings.scheduler)


def _run_and_write(
    job: _Job, executor: Executor | Runner | None, on_event: EventCallback, found: Registration | None = None
) -> Registration:
    """Check the outputs, run the job, write its files beside their places, then put them there at once.

    A registration that is `found` already is only written.
    """
    requirements = parse_requirements(job.settings.require, job.command)
    with warnings.catch_warnings(), trusting(job.settings.trust):
        # Filters belong to the process, and rasterio swaps them: this one is set before there are threads,
        # and without the lock of `ignoring`, for which these would wait.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        inside, elsewhere = _check_outputs(job)
        place = job.places["numbers"].parent
        with OutputFolder(place, overwrite=job.overwrite, inputs=_files_of(job)) as folder:
            staged = {
                kind: folder.stage / inside[kind].name
                if kind in elsewhere
                else folder.path(inside[kind].name)
                for kind in job.places
            }
            bands = _band_paths(job, folder)
            tell = on_event if job.settings.no_report else _preloading(on_event)
            registration = found or _run(job, executor, tell)
            # inside: slow to load, which `_preloading` may have done
            from pcwlad_geo.report.statistics import judge_requirements

            judged = judge_requirements(registration, requirements)
            registration = replace(registration, decision=replace(registration.decision, requirements=judged))
            with folder.writing():
                kinds, messages = write(registration, staged, job.places, elsewhere, bands, on_event)
            check_unchanged(file.identity for file in registration.inputs)
            for kind in kinds:
                if kind in elsewhere:
                    put = place_with_files if kind == "raster" else place_file
                    put(staged[kind], elsewhere[kind], overwrite=job.overwrite)
            folder.commit()
    outputs = {kind: job.places[kind] for kind in kinds} | {
        f"raster {band.name}": job.places["numbers"].with_name(path.name)
        for band, path in bands.items()
        if "raster" in kinds
    }
    messages = registration.warnings + messages
    return _accepted(replace(registration, warnings=messages, outputs=outputs), job.places)


def _check_outputs(job: _Job) -> tuple[dict[str, Path], dict[str, Path]]:
    """Raise where an output cannot be made; return where each would be in the folder, and those elsewhere."""
    if job.settings.pdf:
        from pcwlad_geo.report.page import check_pdf

        check_pdf()
    inside = output_paths(
        job.inputs[1],
        "registered",
        tgt_band=job.settings.tgt_band,
        of=job.settings.of,
        out_dir=job.places["numbers"].parent,
    )
    elsewhere = {kind: path for kind, path in job.places.items() if path != inside[kind]}
    check_outputs([*job.places.values()], _files_of(job))
    check_outputs([*elsewhere.values()], overwrite=job.overwrite)
    OutputFormat.of(job.settings.of, job.settings.co)
    if "raster" in job.places:
        check_output(*job.inputs, job.settings)
    return inside, elsewhere


def _files_of(job: _Job) -> list[PathLike | None]:
    """Return the files that a job reads, and what else its inputs are named by."""
    return [*job.inputs, *job.settings.files]


def _band_paths(job: _Job, folder: OutputFolder) -> dict[ProductBand, Path]:
    """Return where the other bands of the target's product are written."""
    extension = OutputFormat.of(job.settings.of, job.settings.co).extension
    resolved = resolve(*job.inputs, job.settings, all_bands="raster" in job.places)
    return {
        band: folder.path(plain_name(f"{Path(file_name(band.uri)).stem}_registered.{extension}"))
        for band in resolved.other_bands
    }


def _run(job: _Job, executor: Executor | Runner | None, on_event: EventCallback) -> Registration:
    """Run a job where its settings say, or on what the caller gives."""
    settings = job.settings
    # points of a file leave workers nothing to do
    with open_job_runner(settings, InThisProcess() if settings.tie_points else executor, on_event) as runner:
        from pcwlad_geo.registration import register_pair  # slow to load

        match_only = job.command == "match"
        return register_pair(*job.inputs, settings, on_event=on_event, runner=runner, match_only=match_only)


def _accepted(registration: Registration, places: Mapping[str, Path]) -> Registration:
    """Raise where the pair was rejected or a requirement is not met; return the registration otherwise."""
    out_dir = places["numbers"].parent
    report = places["numbers" if registration.settings.no_report else "report"]
    if registration.status == "rejected":
        message = f"{registration.reason} (report: {report})"
        raise RegistrationRejectedError(message, registration, out_dir)
    if registration.passed is False:
        missed = "; ".join(each.text for each in registration.requirements if not each.met)
        raise RequirementError(f"{missed} (report: {report})", registration, out_dir)
    return registration


def _preloading(on_event: EventCallback) -> EventCallback:
    """Return what passes events on, and loads what comes after the matching once that has begun."""
    threads: list[Thread] = []

    def load() -> None:
        with suppress(Exception):  # whoever needs it will say it
            import_module("pcwlad_geo.report.page").page_template()

    def tell(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "matching" and not threads:
            threads.append(Thread(target=load))
            threads[0].start()
        on_event(event)

    return tell


PROOF_NAMES: Final = {"numbers": "proof.json", "report": "proof.html"}
"""File names of a proof."""


@checked("reference", "target", "effort")
@products_found_once()
def prove(
    reference: PathLike | DatasetReader,
    target: PathLike | DatasetReader,
    *,
    effort: Effort = "quick",
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    **options: Unpack[Options],
) -> Proof:
    """Measure the tool's own error on a pair, and write `proof.json` and `proof.html`.

    The target is moved by known amounts, by a resampling that adds no bias of its own, with fresh noise of
    the level of each image, and matched again at tie points of the pair. Structure that lies elsewhere in the
    other band cannot be seen by this.

    Parameters
    ----------
    reference, target : path or rasterio dataset
        As for `register`.
    effort : {"quick", "full"}
        quick: a sample of the points; full: more points and moves, and how much a part of the pair tolerates.
    out_dir : path, optional
        Output folder; ``<target stem>_proof`` in the working folder by default.
    overwrite : bool
        Replace the results of an earlier run in `out_dir`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the job.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles of the matching; None = `jobs` processes, or the workers of `scheduler`.
    **options
        The fields of `Settings` that concern the matching, and `model`.

    Returns
    -------
    Proof
        Errors in target px (col, row).

    Raises
    ------
    InputError
        If a raster or an option cannot be used, or too few tie points are matched; nothing is written.
    OutputError
        If the results cannot be written.
    ExecutionError
        If what the matching runs on cannot be used or is lost.
    RegistrationRejectedError
        If the pair cannot be matched reliably; nothing is written.
    """
    inputs, settings = (file_of(reference), file_of(target)), Settings.from_options(options)
    if not fits(effort, Effort):
        raise SettingsError(f"effort = {shown(effort)}: give one of {', '.join(get_args(Effort))}")
    place = OutputFolder(
        output_folder(inputs[1], "proof", out_dir),
        overwrite=overwrite,
        results=PROOF_NAMES["numbers"],
        inputs=[*inputs, *settings.files],
    )
    with trusting(settings.trust), place as folder, open_job_runner(settings, executor, on_event) as runner:
        from pcwlad_geo.registration import prove_pair  # slow to load
        from pcwlad_geo.report.content import proof_numbers, to_json
        from pcwlad_geo.report.page import proof_page

        registration, proof = prove_pair(*inputs, settings, effort, on_event=on_event, runner=runner)
        with folder.writing():
            content = proof_numbers(registration, proof, sorted(PROOF_NAMES.values()))
            texts = {"report": proof_page(registration, proof), "numbers": to_json(content)}
            for kind, text in texts.items():
                folder.path(PROOF_NAMES[kind]).write_text(text, encoding="utf-8", newline="")
        check_unchanged(file.identity for file in registration.inputs)
        folder.commit()
    return proof
