"""The geolocation of a time series: what the images of a finished stack do over time, and the ground below.

A stack gives every date a displacement with its sigma. Here the dates of one sensor are a series, in which
steps, drifts, seasons and outliers are sought; what the tie points of all pairs have beside that is motion of
the ground. What all images share, the frame itself, cannot be seen.

Read on in the order of the work: the images (`dated_images`), their `series`, the ground (`ground_motion`),
the corrected images (`collection`), the `requirements`, and the files (`page`). Of reports of single pairs,
`trend` shows what they say over time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Warned, ignore
from pcwlad_geo.multi.stack.finished import described_again, read_stack
from pcwlad_geo.multi.stack.numbers import STACK_FILE, StackRequirement
from pcwlad_geo.multi.watch.collection import write_corrected
from pcwlad_geo.multi.watch.dated_images import dated_images, position_covariance
from pcwlad_geo.multi.watch.ground_motion import moving_ground
from pcwlad_geo.multi.watch.numbers import WatchNumbers
from pcwlad_geo.multi.watch.page import WATCH_FILES, write_results
from pcwlad_geo.multi.watch.requirements import judge_watch
from pcwlad_geo.multi.watch.series import images_by_series, offsets_of, series_of
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.finding import products_found_once
from pcwlad_geo.raster import Trust, trusting
from pcwlad_geo.requirements import all_met, parse_requirements
from pcwlad_geo.types import PathLike


@checked()
@products_found_once()
def watch(
    stack: PathLike,
    *,
    out_dir: PathLike | None = None,
    require: Sequence[str] = (),
    apply: bool = False,
    overwrite: bool = False,
    allow_remote: bool = False,
    trust_vrt: bool = False,
    on_event: EventCallback = ignore,
) -> WatchNumbers:
    """Tell what the images of a finished stack, and the ground below them, do over time.

    Parameters
    ----------
    stack : path
        Output folder of `stack`, which gave its images dates.
    out_dir : path, optional
        Output folder; ``<name of the stack>_watch`` in the working folder by default.
    require : sequence of str
        Requirements such as ``step<0.2px``; see `pcwlad_geo.requirements`.
    apply : bool
        Write the images on the grid of the stack that the stack itself has not written, as COG.
    overwrite : bool
        Replace an earlier result in `out_dir`.
    allow_remote, trust_vrt : bool
        What the images may make GDAL open, as in `Settings`.
    on_event : callable
        Receives `Progress` and `Warned` events.

    Returns
    -------
    WatchNumbers

    Raises
    ------
    InputError
        If the folder holds no stack, or fewer than two of its images have dates.
    OutputError
        If the results cannot be written, or would replace other files.
    """
    requirements = parse_requirements(require, "watch")
    folder, place = Path(stack), watch_folder(stack, out_dir)
    if place.resolve() == folder.resolve():
        raise InputError(f"{place} is the folder of the stack itself: give another output folder")
    source = folder / STACK_FILE
    finished = read_stack(folder)
    warnings: list[str] = []

    def warn(message: str) -> None:
        warnings.append(message)
        on_event(Warned(message))

    dated, undated, refused = dated_images(finished, source)
    covariance = position_covariance(finished)
    series = tuple(series_of(name, images, covariance) for name, images in images_by_series(dated).items())
    offsets = offsets_of(series)
    out_folder = OutputFolder(place, overwrite=overwrite, results=WATCH_FILES["numbers"], inputs=[source])
    with out_folder as out, trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        infos = described_again(finished)
        motion, raster, corrected = None, None, None
        with _warning_of(warn, "the motion of the ground is not known"):
            motion, raster = moving_ground(finished, folder, dated, infos, on_event)
        with nullcontext() if apply else _warning_of(warn, "there is no collection of the corrected images"):
            corrected = write_corrected(out, finished, folder, infos, series, apply, on_event)
        results = judge_watch(series, offsets, motion, requirements)
        for names_left, why in ((undated, "have no date"), (refused, "were refused by the stack")):
            if names_left:
                warn(f"in no series, as they {why}: {', '.join(names_left)}")
        names = {name for kind, name in WATCH_FILES.items() if kind != "motion" or raster}
        watched = WatchNumbers(
            schema_version=1,
            stack=str(folder),
            datum=finished.datum,
            series=series,
            offsets=offsets,
            motion=motion,
            corrected=corrected,
            undated=undated,
            refused=refused,
            requirements=tuple(map(StackRequirement.of, results)),
            passed=all_met(results),
            warnings=tuple(warnings),
            outputs=tuple(sorted({*names, *(path.name for path in out.stage.iterdir())})),
        )
        write_results(out, watched, raster)
    return watched


@contextmanager
def _warning_of(warn: Callable[[str], None], what: str) -> Iterator[None]:
    """Make a warning of an `InputError`."""
    try:
        yield
    except InputError as error:
        warn(f"{what}: {error}")


def watch_folder(stack: PathLike, out_dir: PathLike | None) -> Path:
    """Return the output folder: `out_dir`, or by default one named after the `stack`."""
    return Path(out_dir) if out_dir else Path(f"{Path(stack).resolve().name}_watch")
