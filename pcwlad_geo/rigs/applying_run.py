"""The job that applies a rig to many captures."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.execution.workers import available_cores, open_runner
from pcwlad_geo.outputs.folder import lock_folder, place_file, stage_inside
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.raster import Trust, open_raster, plain_name, trusting
from pcwlad_geo.report.json_content import filled
from pcwlad_geo.rigs.applying import CaptureOutcome, correct_capture
from pcwlad_geo.rigs.capture_raster import CAPTURE_TAG, CaptureTask
from pcwlad_geo.rigs.captures import Capture, find_frames, group, thermal_note
from pcwlad_geo.rigs.learning_run import checked_jobs
from pcwlad_geo.rigs.parameters import CAPTURE, CaptureParameters
from pcwlad_geo.rigs.rig import Rig
from pcwlad_geo.rigs.split import SCRIPT_NAME, Program, SplitPlan, is_corrected, split_plan
from pcwlad_geo.text import csv_of, joined, read_json, typed
from pcwlad_geo.types import PathLike

SUMMARY: Final = "summary.csv"
"""A line for each capture."""
APPLIED_FILE: Final = "rig_apply.json"
"""The same with what is needed to go on where a run was stopped."""


@dataclass(frozen=True, slots=True, eq=False)
class RigApplied:
    """What became of all captures."""

    captures: tuple[CaptureOutcome, ...]
    """By name."""
    out_dir: Path
    unread: tuple[tuple[str, str], ...]
    """Files that are no frames, and why."""
    next_step: str | None = None
    """What is to be typed for the program that takes the frames."""

    @property
    def summary(self) -> Path:
        """Path of the summary."""
        return self.out_dir / SUMMARY

    def count(self, status: str) -> int:
        """Return the number of captures of a status (corrected, rejected, unusable, failed) or quality."""
        return sum(status in (capture.status, capture.quality) for capture in self.captures)


@checked()
def rig_apply(
    rig: Rig | PathLike,
    captures: Sequence[PathLike],
    *,
    out_dir: PathLike,
    pattern: str | None = None,
    split: bool = False,
    program: Program | None = None,
    overwrite: bool = False,
    jobs: int | None = None,
    scheduler: str | None = None,
    allow_remote: bool = False,
    trust_vrt: bool = False,
    executor: Executor | Runner | None = None,
    on_event: EventCallback = ignore,
) -> RigApplied:
    """Bring the lenses of many captures onto each other: one raster for each capture.

    A bad capture (a panel, too near, blurred, a lens covered or missing) is named in a warning and in the
    summary, and the others are corrected. A capture that an earlier run has corrected from the same files
    with the same rig is not corrected again.

    Parameters
    ----------
    rig : Rig or path
        Of `rig_learn`, or RIG.json.
    captures : sequence of path
        Frames, or folders of frames.
    out_dir : path
        Folder of the rasters, `summary.csv` and `rig_apply.json`.
    split : bool
        Write a file for each lens instead of one raster: with the name, the EXIF and the XMP of the raw
        frame, and the calibration of a pinhole without distortion.
    program : {"odm", "metashape", "pix4d"} or None
        The program that takes these files, which are laid out for it; implies `split`.
    pattern, overwrite, jobs, scheduler, executor, allow_remote, trust_vrt, on_event
        As `rig_learn` takes them; `overwrite` corrects all captures anew.

    Returns
    -------
    RigApplied

    Raises
    ------
    InputError
        If there are no captures, or all are of another camera than the rig.
    OutputError
        If the results cannot be written.
    """
    model = rig if isinstance(rig, Rig) else Rig.read(rig)
    folder, crop = Path(out_dir), model.crop()
    with trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        groups, unread = _grouped(model, captures, folder, pattern)
        usable, outcomes = _sorted_out(model, groups)
        read = [frame.path for capture in groups for frame in capture.frames.values()]
        plan = split_plan(model, usable, captures, program) if split or program else None
        rasters = [folder / name for capture in usable for name in _names(model, capture, plan)]
        check_outputs(
            [*rasters, folder / SUMMARY, folder / APPLIED_FILE],
            [*read, None if isinstance(rig, Rig) else rig],
        )
        runner = open_runner(executor, on_event, jobs=checked_jobs(jobs), scheduler=scheduler)
        with lock_folder(folder), runner as opened, stage_inside(folder) as stage:
            before = _finished_before(folder)
            tasks = []
            for capture in usable:
                names = _names(model, capture, plan)
                digest = _digest(model, capture, names)
                earlier = before.get(capture.name)
                are_there = all((folder / name).is_file() for name in names)
                if not overwrite and earlier and earlier[0] == digest and are_there:
                    outcomes.append(replace(earlier[1], done_before=True))
                    continue
                path = str(stage / (names[0] if plan is None else plain_name(capture.name)))
                tasks.append(CaptureTask(model, capture, crop, path, digest, None if plan is None else names))
            digests = {name: digest for name, (digest, _) in before.items()}
            digests |= {task.capture.name: task.digest for task in tasks}

            def write_summary() -> None:
                _write_summary(stage, folder, sorted(outcomes, key=lambda outcome: outcome.name), digests)

            _apply(tasks, outcomes, folder, overwrite, opened, on_event, write_summary)
            write_summary()
            good = {outcome.name for outcome in outcomes if outcome.status == "corrected"}
            if plan is not None and program == "metashape":
                script = plan.script(model, [capture for capture in usable if capture.name in good], folder)
                (stage / SCRIPT_NAME).write_text(script, encoding="utf-8")
                place_file(stage / SCRIPT_NAME, folder / SCRIPT_NAME, overwrite=True)
        ordered = tuple(sorted(outcomes, key=lambda outcome: outcome.name))
        for outcome in ordered:
            if outcome.reason is not None:
                on_event(Warned(f"{outcome.name}: {outcome.quality or outcome.status}: {outcome.reason}"))
        if (note := thermal_note(usable)) is not None:
            on_event(Warned(note))
        for file, reason in unread:
            on_event(Warned(reason if file in reason else f"{file}: {reason}"))
    return RigApplied(ordered, folder, tuple(unread), None if plan is None else plan.next_step(folder))


def _grouped(
    rig: Rig, captures: Sequence[PathLike], folder: Path, pattern: str | None
) -> tuple[list[Capture], list[tuple[str, str]]]:
    """Return the captures, and the files that are no frames, and why; `folder` has the results."""
    inside, files = folder.resolve(), find_frames(captures)
    if not any(Path(place).resolve().is_relative_to(inside) for place in captures):
        files = [file for file in files if not file.resolve().is_relative_to(inside)]
    groups, unread = group(files, pattern)
    pictures = [capture for capture in groups if _is_picture(rig, capture)]
    if len(pictures) < len(groups):
        groups = [capture for capture in groups if capture not in pictures]
        reason = "left aside: it has neither the size nor the tags of a frame of this camera"
        unread += [(frame.path, reason) for picture in pictures for frame in picture.frames.values()]
    return groups, unread


def _apply(
    tasks: Sequence[CaptureTask],
    outcomes: list[CaptureOutcome],
    folder: Path,
    overwrite: bool,
    runner: Runner,
    on_event: EventCallback,
    write_summary: Callable[[], None],
    parameters: CaptureParameters = CAPTURE,
) -> None:
    """Correct captures, and write the summary after each part of them."""
    chunk = parameters.captures_a_core * available_cores()
    for begin in range(0, len(tasks), chunk):
        part = tasks[begin : begin + chunk]

        def tell(event: Any, begin: int = begin) -> None:  # noqa: ANN401
            if isinstance(event, Progress):
                event = Progress("captures", begin + event.done, len(tasks))
            on_event(event)

        results = runner.run(_corrected, [(task,) for task in part], "captures", tell)
        for task, outcome in zip(part, results, strict=True):
            outcomes.append(_placed(task, outcome, folder, overwrite))
        write_summary()


def _corrected(task: CaptureTask) -> CaptureOutcome:
    """Correct one capture; what nobody expected is told, and the others go on."""
    try:
        return correct_capture(task)
    except Exception as error:  # of any kind: the other captures are corrected nevertheless
        reason = f"unexpected {type(error).__name__}: {joined(error)}"
        return CaptureOutcome(task.capture.name, "failed", reason)


def _placed(task: CaptureTask, outcome: CaptureOutcome, folder: Path, overwrite: bool) -> CaptureOutcome:
    """Move a finished raster, or the frames of a capture, into the folder."""
    if outcome.status != "corrected":
        return outcome
    staged = Path(task.path)
    files = {staged.name: staged} if task.split is None else {name: staged / name for name in task.split}
    for name, file in files.items():
        place = folder / name
        try:
            place_file(file, place, overwrite=overwrite or _is_own(place))
        except OutputError as error:
            if not place.exists() or overwrite:
                raise
            return CaptureOutcome(outcome.name, "unusable", str(error))
    return replace(outcome, file=next(iter(files)))


def _names(rig: Rig, capture: Capture, plan: SplitPlan | None) -> tuple[str, ...]:
    """Return the names of the files of a capture in the folder."""
    return (f"{capture.name}.tif",) if plan is None else plan.of(rig, capture)


def _is_own(place: Path) -> bool:
    """Return whether a file is a raster of an earlier run, even of one stopped before its summary."""
    try:
        with open_raster(str(place)) as dataset:
            return CAPTURE_TAG in dataset.tags() or is_corrected(dataset)
    except InputError:
        return False


def _sorted_out(rig: Rig, captures: Sequence[Capture]) -> tuple[list[Capture], list[CaptureOutcome]]:
    """Return the captures that can be tried, and what is wrong with the others."""
    usable, outcomes, reasons = [], [], []
    for capture in captures:
        lacking = [name for name in rig.names if name not in capture.frames]
        other = None if lacking else _other_camera(rig, capture)
        if lacking:
            outcomes.append(CaptureOutcome(capture.name, "unusable", f"lens {', '.join(lacking)} is missing"))
        elif other is not None:
            outcomes.append(CaptureOutcome(capture.name, "unusable", other))
            reasons.append(other)
        else:
            usable.append(capture)
    if not usable:
        lenses = sorted({name for capture in captures for name in capture.frames})
        raise InputError(
            f"{reasons[0]}: give the RIG.json of this camera"
            if reasons
            else f"no capture has the lenses of the rig ({', '.join(rig.names)}; found: "
            f"{', '.join(lenses)[:200] or 'none'}): is this its camera?"
        )
    return usable, outcomes


def _is_picture(rig: Rig, capture: Capture) -> bool:
    """Whether a capture has nothing of this rig's frames: other sizes, and no tags of a camera."""
    sizes = {lens.lens.shape for lens in rig.lenses}
    return not any(
        frame.shape in sizes or frame.camera or frame.tells_focal or frame.capture_id
        for frame in capture.frames.values()
    )


def _other_camera(rig: Rig, capture: Capture) -> str | None:
    """Return why a capture is not of the rig's camera; None if it may be."""
    for lens in rig.lenses:
        frame = capture.frames[lens.name]
        if frame.shape != lens.lens.shape:
            return (
                f"{frame.path} has {frame.shape[1]} x {frame.shape[0]} px, and the rig's lens {lens.name} "
                f"{lens.lens.shape[1]} x {lens.lens.shape[0]}"
            )
    frame = capture.frames[rig.reference.name]
    if rig.camera and frame.camera and frame.camera != rig.camera:
        return f"{frame.path} is of the camera '{frame.camera}', and the rig of '{rig.camera}'"
    return None


def _digest(rig: Rig, capture: Capture, names: Sequence[str]) -> str:
    """Return what tells whether a capture was corrected from the same files with the same rig to `names`."""
    state: list[object] = [{**rig.to_dict(), "seconds": 0}]
    state += names if len(names) > 1 else []
    for name in rig.names:
        path = capture.frames[name].path
        try:
            about = Path(path).stat()
            state.append([path, about.st_size, about.st_mtime_ns])
        except OSError:
            state.append([path])
    return hashlib.sha256(json.dumps(state).encode()).hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class _ReadCapture(CaptureOutcome):
    """A capture of an earlier run, with the digest of its inputs."""

    inputs: str = ""


@dataclass(frozen=True, slots=True)
class _ReadCaptures:
    """The captures of an earlier run."""

    captures: tuple[_ReadCapture, ...]


def _finished_before(folder: Path) -> dict[str, tuple[str, CaptureOutcome]]:
    """Return the captures that an earlier run has corrected, with the digests of their inputs."""
    try:
        before = typed(read_json(folder / APPLIED_FILE), _ReadCaptures, written=_ReadCaptures)
    except (OSError, InputError, ValueError):
        return {}
    return {
        entry.name: (entry.inputs, filled(CaptureOutcome, entry))
        for entry in before.captures
        if entry.status == "corrected"
    }


def _write_summary(
    stage: Path, folder: Path, outcomes: Sequence[CaptureOutcome], digests: Mapping[str, str]
) -> None:
    """Write the table and the numbers, each complete or unchanged."""
    rows = [asdict(outcome) for outcome in outcomes]
    numbers = {
        "schema_version": 1,
        "captures": [{**row, "inputs": digests.get(row["name"], "")} for row in rows],
    }
    (stage / SUMMARY).write_text(csv_of(rows), encoding="utf-8", errors="backslashreplace", newline="")
    (stage / APPLIED_FILE).write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    for name in (SUMMARY, APPLIED_FILE):
        place_file(stage / name, folder / name, overwrite=True)
