"""The job that learns a rig from some captures."""

from __future__ import annotations

import statistics
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.events import EventCallback, Warned, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.execution.workers import open_runner
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.outputs.folder import place_file, stage_inside
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.raster import Trust, trusting
from pcwlad_geo.rigs.applying import doubt_of, try_capture
from pcwlad_geo.rigs.captures import Capture, find_frames, group, thermal_note
from pcwlad_geo.rigs.initial_poses import evenly
from pcwlad_geo.rigs.inspection import BadCaptureError, Sharpness, check_sharpness, inspect, usual_of
from pcwlad_geo.rigs.learning import learn
from pcwlad_geo.rigs.parameters import LEARNING
from pcwlad_geo.rigs.rig import Rig
from pcwlad_geo.types import PathLike


@checked()
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
        groups, unread = group(files, pattern)
        for file, reason in unread:
            on_event(Warned(reason if file in reason else f"{file}: {reason}"))
        whole = list(_whole(groups, on_event))
        if (note := thermal_note(whole)) is not None:
            on_event(Warned(note))
        _check_one_camera(whole)
        runner = open_runner(executor, on_event, jobs=checked_jobs(jobs), scheduler=scheduler)
        with runner as opened:
            rig = _learned(evenly(whole, LEARNING.most_captures), fisheye, opened, on_event)
    rig = replace(rig, seconds=time.perf_counter() - begun)
    for lens in rig.lenses:
        off = lens.off_by_px()
        if off is not None and off[1] > max(0.5, 2 * lens.distortion_sigma_px):
            on_event(
                Warned(
                    f"lens {lens.name}: the calibration in its frames is off by {off[0]:.2f} px RMS, at most "
                    f"{off[1]:.2f} px, by the tie points (± {lens.distortion_sigma_px:.2f}): it was refined"
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
    inspections = runner.run(inspect, [(capture,) for capture in captures], "inspecting", on_event)
    flown = _in_flight(captures, inspections, on_event)
    for _ in range(2):
        rig = learn(list(flown), [*flown.values()], fisheye, runner, on_event)
        trials = runner.run(try_capture, [(rig, capture) for capture in flown], "testing", on_event)
        refused = {capture: why for capture, why in zip(flown, trials, strict=True) if isinstance(why, str)}
        flown = {capture: flown[capture] for capture in _agreeing(list(flown), refused, on_event)}
        if not refused:
            break
    if refused.keys() & flown:
        raise RegistrationRejectedError("the captures contradict each other: give captures of one flight")
    expected = [error_px for error_px in trials if isinstance(error_px, float)]
    return replace(rig, expected_ce90_px=statistics.median(expected))


def _in_flight(
    captures: Sequence[Capture],
    inspections: Sequence[tuple[str | None, dict[str, Sharpness]]],
    on_event: EventCallback,
) -> dict[Capture, dict[str, Sharpness]]:
    """Return the captures that show ground, sharply, with what they look like; name the others."""
    flying = [sharpness for panel, sharpness in inspections if not panel]
    usual = {name: usual_of([capture[name] for capture in flying]) for name in captures[0].frames if flying}
    flown, reasons = {}, []
    for capture, (panel, sharpness) in zip(captures, inspections, strict=True):
        try:
            if panel:
                raise BadCaptureError(panel)
            check_sharpness(usual, sharpness)
            flown[capture] = sharpness
        except BadCaptureError as error:
            reasons.append(f"{capture.name}: left out: {error}")
    if not flown:
        raise RegistrationRejectedError(f"{'; '.join(reasons)[:300]}. Give captures of ground in flight")
    for reason in reasons:
        on_event(Warned(reason))
    return flown


def _agreeing(
    captures: Sequence[Capture], refused: Mapping[Capture, str], on_event: EventCallback
) -> list[Capture]:
    """Return most of the captures: those that a rig of all holds for, or else the others; name the rest."""
    accepted = [capture for capture in captures if capture not in refused]
    majority, minority = (
        (accepted, list(refused)) if len(accepted) > len(refused) else (list(refused), accepted)
    )
    if refused and (not accepted or len(accepted) == len(refused)):
        name, why = next((capture.name, reason) for capture, reason in refused.items())
        other = f" It and {accepted[0].name} contradict each other." if accepted else ""
        raise RegistrationRejectedError(f"{name}: {why}.{other} Give captures of level ground in flight")
    for capture in minority:
        reason = refused.get(capture, f"it contradicts {len(majority)} others: a near scene, or a panel")
        on_event(Warned(f"{capture.name}: left out: {reason}"))
    return majority


def _whole(captures: Sequence[Capture], on_event: EventCallback) -> Iterator[Capture]:
    """Yield the captures that have all lenses; name those that lack one."""
    names = Counter(name for capture in captures for name in capture.frames)
    # a lens of a stray file is none of the rig's
    lenses = {name for name, count in names.items() if count >= max(1, 0.5 * len(captures))}
    if not 2 <= len(lenses) <= LIMITS.rig_lenses:
        listed = ", ".join(sorted(names)) or "none"
        raise InputError(
            f"the {len(captures)} captures found have not two to {LIMITS.rig_lenses} lenses in common (lenses"
            f": {listed[:200]}): name frames of one camera, or give --pattern"
        )
    complete = 0
    for capture in captures:
        lacking = sorted(lenses - capture.frames.keys())
        if lacking:
            on_event(Warned(f"{capture.name}: left out: lens {', '.join(lacking)} is missing"))
            continue
        complete += 1
        yield replace(capture, frames={name: capture.frames[name] for name in sorted(lenses)})
    if not complete:
        raise InputError(f"none of {len(captures)} captures has all lenses ({', '.join(sorted(lenses))})")


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


def checked_jobs(jobs: int | None) -> int | None:
    """Return a number of processes; raises `InputError` if it is none that can be."""
    if jobs is not None and not 1 <= jobs <= LIMITS.jobs:
        raise InputError(f"jobs = {jobs}: give 1 to {LIMITS.jobs} processes")
    return jobs
