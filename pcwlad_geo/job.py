"""The jobs on one pair: the four steps of `registration.run`, then the output folder."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.arguments import checked
from pcwlad_geo.basemaps.composed import compose
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError
from pcwlad_geo.events import Event, EventCallback, Progress, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.execution.workers import open_runner
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.files import OUTPUT_NAMES
from pcwlad_geo.outputs.folder import OutputFolder, place_output
from pcwlad_geo.outputs.write import Written, write
from pcwlad_geo.pair_job import JOB_OF, Command, OutputPlaces, PairJob, output_folder
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster import check_unchanged, trusting
from pcwlad_geo.raster.scratch import file_of
from pcwlad_geo.registration import check_output, resolve
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.text import joined
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from rasterio.io import DatasetReader
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options
    from pcwlad_geo.products.product import ProductBand
    from pcwlad_geo.registration import Registration
    from pcwlad_geo.report.content import Report


@dataclass(frozen=True, slots=True, eq=False)
class WrittenPair:
    """A pair that was registered or matched, and whose outputs are written."""

    registration: Registration
    report: Report
    """The content of its report.json."""
    folder: Path
    paths: Mapping[str, Path]
    """The files written, by kind, without the other bands of a product."""

    def accepted(self) -> Registration:
        """Return the registration; raises `RequirementError` if it does not meet a requirement."""
        if self.registration.passed is False:
            message = f"{self.registration.missed} (report: {self.page})"
            raise RequirementError(message, self.registration, self.folder)
        return self.registration

    @property
    def page(self) -> Path:
        """The report that a person reads: the page, or the numbers where there is none."""
        return self.paths.get("report", self.paths["numbers"])


@checked("reference", "target")
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
    """Register files, write tie points, corrected raster and report, and return the result.

    Parameters and errors are those of `pcwlad_geo.register`, but that the folder is always written, and that
    `jobs` processes run the tiles unless `executor` does.
    """
    places: OutputPlaces = {
        "out_dir": out_dir,
        "output_raster": output_raster,
        "output_tiepoints": output_tiepoints,
        "output_report": output_report,
        "output_points": output_points,
    }
    names, settings = (file_of(reference), file_of(target)), Settings.from_options(options)
    written = write_pair(
        "register", names, settings, places, overwrite=overwrite, on_event=on_event, executor=executor
    )
    return written.accepted()


@checked("reference", "target")
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
    names, settings = (file_of(reference), file_of(target)), Settings.from_options(options)
    written = write_pair(
        "match",
        names,
        settings,
        places,
        overwrite=overwrite,
        on_event=on_event,
        executor=executor,
    )
    return written.accepted()


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
    registration: Registration,
    reference: str,
    target: str,
    *,
    out_dir: Path,
    overwrite: bool,
    **options: Unpack[Options],
) -> Registration:
    """Write the results of a pair that `match_elsewhere` has matched, as `match_files` does."""
    names, settings = (reference, target), Settings.from_options(options)
    places: OutputPlaces = {"out_dir": out_dir}
    return write_pair(
        "match", names, settings, places, overwrite=overwrite, registration=registration
    ).accepted()


def open_job_runner(
    settings: Settings, executor: Executor | Runner | None, on_event: EventCallback
) -> AbstractContextManager[Runner]:
    """Open what runs the tiles of a job, or of many: the caller's executor, a cluster, or own processes.

    `scheduler` and `jobs` of the settings choose it where there is no executor; a runner is open already, and
    stays so. Warnings about it go to `on_event`. Raises `ExecutionError` if the scheduler cannot be used.
    """
    return open_runner(executor, on_event, jobs=settings.jobs, scheduler=settings.scheduler)


def open_pair_runner(
    settings: Settings, executor: Executor | Runner | None, on_event: EventCallback
) -> AbstractContextManager[Runner]:
    """Open what runs the tiles of a pair: points of a file leave workers nothing to do."""
    return open_job_runner(settings, InThisProcess() if settings.tie_points else executor, on_event)


def write_pair(
    command: Command,
    names: tuple[str, str],
    settings: Settings,
    places: OutputPlaces,
    *,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    registration: Registration | None = None,
) -> WrittenPair:
    """Check the outputs, run a job, write its files beside their places, then put them there at once.

    Reference and target go by their `names`; a `registration` that is there already is only written. Errors
    are those of `register`, but a requirement that is not met is no error here.
    """
    requirements = parse_requirements(settings.require, command)
    out_dir = output_folder(names[1], JOB_OF[command], places.get("out_dir"))
    places = {**places, "out_dir": out_dir}
    with (
        warnings.catch_warnings(),
        trusting(settings.trust),
        unpacked(names, out_dir, overwrite=overwrite) as (reference, target),
    ):
        # Filters belong to the process, and rasterio swaps them: this one is set before there are threads,
        # and without the lock of `ignoring`, for which these would wait.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        job = PairJob.of(command, (reference, target), settings, places, overwrite=overwrite)
        job.check_outputs()
        with (
            OutputFolder(job.folder, overwrite=overwrite, inputs=job.files) as folder,
            trusting(replace(settings.trust, composed=str(folder.path(OUTPUT_NAMES["tiles"])))),
        ):
            staged = {
                kind: folder.stage / place.name if kind in job.elsewhere else folder.path(place.name)
                for kind, place in job.inside.items()
            }
            bands = job.band_paths(folder)
            if job.composed and registration is None:
                job = _with_reference(job, staged[job.composed], on_event)
            if registration is None:
                registration = _run(job, executor, on_event if settings.no_report else _preloading(on_event))
            read_from = registration.inputs
            if job.composed:
                registration = registration.fetched_to(job.places[job.composed])
            # inside: slow to load, which `_preloading` may have done
            from pcwlad_geo.pair_requirements import judge_requirements

            judged = judge_requirements(registration, requirements)
            registration = replace(registration, decision=replace(registration.decision, requirements=judged))
            with folder.writing():
                written = write(registration, staged, job.places, job.elsewhere, bands, on_event)
            check_unchanged(file.identity for file in read_from)
            for kind in written.kinds:
                if kind in job.elsewhere:
                    place_output(kind, staged[kind], job.elsewhere[kind], overwrite=overwrite)
            folder.commit()
    return _reliable(_at_places(job, registration, written, bands))


def _with_reference(job: PairJob, path: Path, on_event: EventCallback) -> PairJob:
    """Compose the reference of a job from a web map or tiles; return the job with the file instead."""
    settings = compose(job.names[0], job.composed, job.inputs, path, on_event)
    inputs = resolve(str(path), job.names[1], settings, all_bands=job.command == "register")
    if job.command == "register":
        check_output(inputs)
    return replace(job, inputs=inputs)


def _at_places(
    job: PairJob, registration: Registration, written: Written, bands: Mapping[ProductBand, Path]
) -> WrittenPair:
    """Return a pair with its files, and the warnings of their writing."""
    paths = {kind: job.places[kind] for kind in written.kinds}
    bands_by_kind = {f"raster {band.name}": job.folder / path.name for band, path in bands.items()}
    registration = replace(
        registration,
        warnings=registration.warnings + written.warnings,
        outputs=paths | (bands_by_kind if "raster" in paths else {}),
    )
    return WrittenPair(registration, written.report, job.folder, paths)


def _reliable(pair: WrittenPair) -> WrittenPair:
    """Return a pair; raise `RegistrationRejectedError` where it was rejected."""
    if pair.registration.status == "rejected":
        message = f"{pair.registration.reason} (report: {pair.page})"
        raise RegistrationRejectedError(message, pair.registration, pair.folder)
    return pair


def _run(job: PairJob, executor: Executor | Runner | None, on_event: EventCallback) -> Registration:
    """Run a job where its settings say, or on the executor of the caller."""
    settings = job.settings
    with open_pair_runner(settings, executor, on_event) as runner:
        from pcwlad_geo.registration import register_inputs  # slow to load

        return register_inputs(
            job.inputs, on_event=on_event, runner=runner, match_only=job.command == "match"
        )


def _preloading(on_event: EventCallback) -> EventCallback:
    """Return a callback that passes events on, and loads the modules of the page once the matching begins."""
    threads: list[Thread] = []

    def load() -> None:
        with suppress(Exception):  # the writing raises it again
            import_module("pcwlad_geo.report.page").page_template()

    def receive(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "matching" and not threads:
            threads.append(Thread(target=load))
            threads[0].start()
        on_event(event)

    return receive
