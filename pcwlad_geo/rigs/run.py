"""The two jobs: learn a rig from some captures, and apply it to many."""

from __future__ import annotations

import hashlib
import json
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import InputError, OutputError, RegistrationRejectedError
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.processes import available_cores, open_runner
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.limits import JOBS
from pcwlad_geo.outputs.folder import lock_folder, place_file, stage_inside
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.raster.source import open_raster, plain_name
from pcwlad_geo.raster.trust import Trust, trusting
from pcwlad_geo.rigs.applying import (
    CAPTURE_TAG,
    BadCaptureError,
    CaptureOutcome,
    CaptureTask,
    check_sharpness,
    correct_capture,
    doubt_of,
    try_capture,
)
from pcwlad_geo.rigs.captures import MAX_LENSES, Capture, find_frames, group
from pcwlad_geo.rigs.learning import MOST_CAPTURES, evenly, inspect, learn, usual_of
from pcwlad_geo.rigs.rig import Rig, Sharpness
from pcwlad_geo.text import csv_of, joined, read_json
from pcwlad_geo.types import PathLike

SUMMARY: Final = "summary.csv"
"""A line for each capture."""
NUMBERS: Final = "rig_apply.json"
"""The same with what is needed to go on where a run was stopped."""
CHUNK: Final = 16
"""Captures for each process between two updates of the summary."""
_PRELOAD: Final = "pcwlad_geo.rigs.applying"


@dataclass(frozen=True, slots=True, eq=False)
class RigApplied:
    """What became of all captures."""

    captures: tuple[CaptureOutcome, ...]
    """By name."""
    out_dir: Path
    unread: tuple[tuple[str, str], ...]
    """Files that are no frames, and why."""

    @property
    def summary(self) -> Path:
        """Path of the summary."""
        return self.out_dir / SUMMARY

    def count(self, status: str) -> int:
        """Return the number of captures of a status (corrected, rejected, unusable, failed) or quality."""
        return sum(status in (each.status, each.quality) for each in self.captures)


def rig_learn(
    captures: Sequence[PathLike],
    *,
    out: PathLike | None = None,
    pattern: str | None = None,
    fisheye: bool = False,
    overwrite: bool = False,
    jobs: int | None = None,
    scheduler: str | None = None,
    allow_remote: bool = False,
    trust_vrt: bool = False,
    executor: Executor | Runner | None = None,
    on_event: EventCallback = ignore,
) -> Rig:
    """Learn how the lenses of a camera stand to each other, and their distortion, from some captures.

    Parameters
    ----------
    captures : sequence of path
        Frames, or folders of frames, raw as the camera wrote them; of one camera. A few captures at different
        heights tell the parallax of the lenses, some that overlap the distortion that all share.
    out : path, optional
        File to write, RIG.json.
    pattern : str, optional
        Regular expression of file names without ending, with the groups `capture` and `lens`, where neither
        XMP nor the usual names tell what belongs together.
    fisheye : bool
        Whether lenses without a calibration in their frames are fisheyes.
    overwrite : bool
        Replace `out` where it exists.
    jobs, scheduler, executor, allow_remote, trust_vrt
        As `register` takes them.
    on_event : callable
        Receives `Progress` and `Warned` events.

    Returns
    -------
    Rig

    Raises
    ------
    InputError
        If there are no captures with all lenses, or they are of several cameras.
    RegistrationRejectedError
        If a lens cannot be matched with the others.
    OutputError
        If `out` cannot be written.
    """
    begun = time.perf_counter()
    with trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        files = find_frames(captures)
        if out is not None:
            check_outputs([Path(out)], files, overwrite=overwrite)
        found, unread = group(files, pattern)
        for file, reason in unread:
            on_event(Warned(reason if file in reason else f"{file}: {reason}"))
        whole = list(_whole(found, on_event))
        _check_one_camera(whole)
        runner = open_runner(executor, on_event, jobs=_processes(jobs), scheduler=scheduler, preload=_PRELOAD)
        with runner as opened:
            rig = _learned(evenly(whole, MOST_CAPTURES), fisheye, opened, on_event)
    rig = replace(rig, seconds=time.perf_counter() - begun)
    for each in rig.lenses:
        off = each.off_by_px()
        if off is not None and off[1] > max(0.5, 2 * each.distortion_sigma_px):
            on_event(
                Warned(
                    f"lens {each.name}: the calibration in its frames is off by {off[0]:.2f} px RMS, at most "
                    f"{off[1]:.2f} px, by the tie points (± {each.distortion_sigma_px:.2f}): it was refined"
                )
            )
    if rig.expected_ce90_px is not None and rig.quality != "good":
        on_event(Warned(f"the rig is {rig.quality}: {doubt_of(rig.expected_ce90_px)}"))
    if out is not None:
        with stage_inside(Path(out).parent) as stage:
            rig.write(stage / "rig.json")
            place_file(stage / "rig.json", out, overwrite=overwrite)
    return rig


def _learned(captures: Sequence[Capture], fisheye: bool, runner: Runner, on_event: EventCallback) -> Rig:
    """Learn a rig from captures of flight, and again without those that it does not hold for."""
    found = runner.run(inspect, [(each,) for each in captures], "inspecting", on_event).results
    flown = _in_flight(captures, found, on_event)
    for _ in range(2):
        rig = learn(list(flown), [*flown.values()], fisheye, runner, on_event)
        tried = runner.run(try_capture, [(rig, each) for each in flown], "testing", on_event).results
        refused = {each: why for each, why in zip(flown, tried, strict=True) if isinstance(why, str)}
        flown = {each: flown[each] for each in _agreeing(list(flown), refused, on_event)}
        if not refused:
            break
    if refused.keys() & flown:
        raise RegistrationRejectedError("the captures contradict each other: give captures of one flight")
    expected = [each for each in tried if isinstance(each, float)]
    return replace(rig, expected_ce90_px=statistics.median(expected))


def _in_flight(
    captures: Sequence[Capture],
    found: Sequence[tuple[str | None, dict[str, Sharpness]]],
    on_event: EventCallback,
) -> dict[Capture, dict[str, Sharpness]]:
    """Return the captures that show ground, sharply, with what they look like; name the others."""
    flying = [sharpness for panel, sharpness in found if not panel]
    usual = {name: usual_of([each[name] for each in flying]) for name in captures[0].frames if flying}
    flown, left = {}, []
    for each, (panel, sharpness) in zip(captures, found, strict=True):
        try:
            if panel:
                raise BadCaptureError(panel)
            check_sharpness(usual, sharpness)
            flown[each] = sharpness
        except BadCaptureError as error:
            left.append(f"{each.name}: left out: {error}")
    if not flown:
        raise RegistrationRejectedError(f"{'; '.join(left)[:300]}. Give captures of ground in flight")
    for reason in left:
        on_event(Warned(reason))
    return flown


def _agreeing(
    captures: Sequence[Capture], refused: Mapping[Capture, str], on_event: EventCallback
) -> list[Capture]:
    """Return most of the captures: those that a rig of all holds for, or else the others; name the rest."""
    held = [each for each in captures if each not in refused]
    kept, left = (held, list(refused)) if len(held) > len(refused) else (list(refused), held)
    if refused and (not held or len(held) == len(refused)):
        name, why = next((each.name, reason) for each, reason in refused.items())
        other = f" It and {held[0].name} contradict each other." if held else ""
        raise RegistrationRejectedError(f"{name}: {why}.{other} Give captures of level ground in flight")
    for each in left:
        reason = refused.get(each, f"it contradicts {len(kept)} others: a near scene, or a panel")
        on_event(Warned(f"{each.name}: left out: {reason}"))
    return kept


def rig_apply(
    rig: Rig | PathLike,
    captures: Sequence[PathLike],
    *,
    out_dir: PathLike,
    pattern: str | None = None,
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
    known = rig if isinstance(rig, Rig) else Rig.read(rig)
    folder, crop = Path(out_dir), known.crop()
    with trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        found, unread = group(find_frames(captures), pattern)
        usable, outcomes = _sorted_out(known, found)
        read = [frame.path for capture in found for frame in capture.frames.values()]
        rasters = [folder / f"{capture.name}.tif" for capture in usable]
        check_outputs(
            [*rasters, folder / SUMMARY, folder / NUMBERS], [*read, None if isinstance(rig, Rig) else rig]
        )
        runner = open_runner(executor, on_event, jobs=_processes(jobs), scheduler=scheduler, preload=_PRELOAD)
        with lock_folder(folder), runner as opened, stage_inside(folder) as stage:
            before = _finished_before(folder)
            tasks = []
            for capture in usable:
                digest = _digest(known, capture)
                earlier = before.get(capture.name)
                if not overwrite and earlier and earlier[0] == digest and _is_there(folder, earlier[1]):
                    outcomes.append(replace(earlier[1], done_before=True))
                    continue
                path = str(stage / f"{capture.name}.tif")
                tasks.append(CaptureTask(known, capture, crop, path, digest))
            digests = {name: digest for name, (digest, _) in before.items()}
            digests |= {task.capture.name: task.digest for task in tasks}

            def write_summary() -> None:
                _write_summary(stage, folder, sorted(outcomes, key=lambda each: each.name), digests)

            _apply(tasks, outcomes, folder, overwrite, opened, on_event, write_summary)
            write_summary()
        ordered = tuple(sorted(outcomes, key=lambda each: each.name))
        for each in ordered:
            if each.reason is not None:
                on_event(Warned(f"{each.name}: {each.quality or each.status}: {each.reason}"))
        for file, reason in unread:
            on_event(Warned(reason if file in reason else f"{file}: {reason}"))
    return RigApplied(ordered, folder, tuple(unread))


def _apply(
    tasks: Sequence[CaptureTask],
    outcomes: list[CaptureOutcome],
    folder: Path,
    overwrite: bool,
    runner: Runner,
    on_event: EventCallback,
    write_summary: Callable[[], None],
) -> None:
    """Correct captures, and write the summary after each part of them."""
    runner.expect(len(tasks))
    chunk = CHUNK * available_cores()
    for begin in range(0, len(tasks), chunk):
        part = tasks[begin : begin + chunk]

        def tell(event: Any, begin: int = begin) -> None:  # noqa: ANN401
            if isinstance(event, Progress):
                event = Progress("captures", begin + event.done, len(tasks))
            on_event(event)

        results = runner.run(_corrected, [(task,) for task in part], "captures", tell).results
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
    """Move a finished raster into the folder."""
    if outcome.status != "corrected":
        return outcome
    staged = Path(task.path)
    place = folder / staged.name
    try:
        place_file(staged, place, overwrite=overwrite or _is_own(place))
    except OutputError as error:
        if not place.exists() or overwrite:
            raise
        return CaptureOutcome(outcome.name, "unusable", str(error))
    return replace(outcome, file=staged.name)


def _is_own(place: Path) -> bool:
    """Return whether a file is a raster of an earlier run, even of one stopped before its summary."""
    try:
        with open_raster(str(place)) as dataset:
            return CAPTURE_TAG in dataset.tags()
    except InputError:
        return False


def _processes(jobs: int | None) -> int | None:
    if jobs is not None and not 1 <= jobs <= JOBS:
        raise InputError(f"jobs = {jobs}: give 1 to {JOBS} processes")
    return jobs


def _whole(found: Sequence[Capture], on_event: EventCallback) -> Iterator[Capture]:
    """Yield the captures that have all lenses; name those that lack one."""
    names = Counter(name for capture in found for name in capture.frames)
    # a lens of a stray file is none of the rig's
    lenses = {name for name, count in names.items() if count >= max(1, 0.5 * len(found))}
    if not 2 <= len(lenses) <= MAX_LENSES:
        listed = ", ".join(sorted(names)) or "none"
        raise InputError(
            f"the {len(found)} captures found have not two to {MAX_LENSES} lenses in common (lenses: "
            f"{listed[:200]}): name frames of one camera, or give --pattern"
        )
    complete = 0
    for capture in found:
        lacking = sorted(lenses - capture.frames.keys())
        if lacking:
            on_event(Warned(f"{capture.name}: left out: lens {', '.join(lacking)} is missing"))
            continue
        complete += 1
        yield replace(capture, frames={name: capture.frames[name] for name in sorted(lenses)})
    if not complete:
        raise InputError(f"none of {len(found)} captures has all lenses ({', '.join(sorted(lenses))})")


def _check_one_camera(captures: Sequence[Capture]) -> None:
    first = captures[0]
    for capture in captures:
        for name, frame in capture.frames.items():
            other = first.frames[name]
            if frame.shape != other.shape:
                raise InputError(
                    f"{frame.path} has {frame.shape[1]} x {frame.shape[0]} px and {other.path} "
                    f"{other.shape[1]} x {other.shape[0]}: give captures of one camera"
                )
            if frame.camera != other.camera:
                raise InputError(
                    f"{frame.path} is of the camera '{frame.camera}' and {other.path} of '{other.camera}': "
                    "give captures of one camera"
                )


def _sorted_out(rig: Rig, found: Sequence[Capture]) -> tuple[list[Capture], list[CaptureOutcome]]:
    """Return the captures that can be tried, and what is wrong with the others."""
    usable, outcomes, others = [], [], []
    for capture in found:
        lacking = [name for name in rig.names if name not in capture.frames]
        other = None if lacking else _other_camera(rig, capture)
        if lacking:
            outcomes.append(CaptureOutcome(capture.name, "unusable", f"lens {', '.join(lacking)} is missing"))
        elif other is not None:
            outcomes.append(CaptureOutcome(capture.name, "unusable", other))
            others.append(other)
        else:
            usable.append(capture)
    if not usable:
        lenses = sorted({name for capture in found for name in capture.frames})
        raise InputError(
            f"{others[0]}: give the RIG.json of this camera"
            if others
            else f"no capture has the lenses of the rig ({', '.join(rig.names)}; found: "
            f"{', '.join(lenses)[:200] or 'none'}): is this its camera?"
        )
    return usable, outcomes


def _other_camera(rig: Rig, capture: Capture) -> str | None:
    """Return why a capture is not of the rig's camera; None if it may be."""
    for each in rig.lenses:
        frame = capture.frames[each.name]
        if frame.shape != each.lens.shape:
            return (
                f"{frame.path} has {frame.shape[1]} x {frame.shape[0]} px, and the rig's lens {each.name} "
                f"{each.lens.shape[1]} x {each.lens.shape[0]}"
            )
    frame = capture.frames[rig.reference.name]
    if rig.camera and frame.camera and frame.camera != rig.camera:
        return f"{frame.path} is of the camera '{frame.camera}', and the rig of '{rig.camera}'"
    return None


def _digest(rig: Rig, capture: Capture) -> str:
    """Return what tells whether a capture was corrected from the same files with the same rig."""
    state: list[object] = [{**rig.to_dict(), "seconds": 0}]
    for name in rig.names:
        path = capture.frames[name].path
        try:
            about = Path(path).stat()
            state.append([path, about.st_size, about.st_mtime_ns])
        except OSError:
            state.append([path])
    return hashlib.sha256(json.dumps(state).encode()).hexdigest()


def _finished_before(folder: Path) -> dict[str, tuple[str, CaptureOutcome]]:
    """Return the captures that an earlier run has corrected, with the digests of their inputs."""
    try:
        before = read_json(folder / NUMBERS)
        found = {}
        for each in before["captures"]:
            outcome = CaptureOutcome(**{field.name: each[field.name] for field in fields(CaptureOutcome)})
            if outcome.status == "corrected":
                found[outcome.name] = str(each["inputs"]), outcome
        return found
    except (OSError, InputError, KeyError, TypeError, ValueError, AttributeError):
        return {}


def _is_there(folder: Path, outcome: CaptureOutcome) -> bool:
    return outcome.file is not None and (folder / plain_name(outcome.file)).is_file()


def _write_summary(
    stage: Path, folder: Path, outcomes: Sequence[CaptureOutcome], digests: Mapping[str, str]
) -> None:
    """Write the table and the numbers, each complete or unchanged."""
    rows = [asdict(each) for each in outcomes]
    numbers = {
        "schema_version": 1,
        "captures": [{**row, "inputs": digests.get(row["name"], "")} for row in rows],
    }
    (stage / SUMMARY).write_text(csv_of(rows), encoding="utf-8", errors="backslashreplace", newline="")
    (stage / NUMBERS).write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    for name in (SUMMARY, NUMBERS):
        place_file(stage / name, folder / name, overwrite=True)
