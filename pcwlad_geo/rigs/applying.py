"""One capture: whether it can be corrected, its expected error, and its raster."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.registration import FAIR_PX, GOOD_PX, Grade, QualityParameters, grade_of_error
from pcwlad_geo.rigs.capture_raster import CaptureTask, write_capture
from pcwlad_geo.rigs.captures import Capture, Frame, read_frame
from pcwlad_geo.rigs.inspection import BadCaptureError, check_sharpness, measure_sharpness, panel_shown
from pcwlad_geo.rigs.parameters import CAPTURE
from pcwlad_geo.rigs.placing import Placement, place, reduction_of, refined
from pcwlad_geo.rigs.rig import Rig
from pcwlad_geo.types import Float32

CaptureStatus = Literal["corrected", "rejected", "unusable", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class CaptureOutcome:
    """What became of a capture."""

    name: str
    status: CaptureStatus
    """`rejected`: a bad capture; `unusable`: its files cannot be used; `failed`: an unexpected error."""
    reason: str | None = None
    file: str | None = None
    """Name of the raster in the output folder, or of the reference's frame."""
    points: int | None = None
    """Places that agree with the rig."""
    residual_px: float | None = None
    """Their median distance from it, px of the common frame."""
    inverse_depth: float | None = None
    """Inverse depth: mean distance of the captures learned from over the distance of this one."""
    distance_m: float | None = None
    """Distance of the ground; None if the rig has no scale in metres."""
    sigma_px: float | None = None
    """Largest standard deviation of the mapping to a lens in the middle of the frame."""
    quality: Grade | None = None
    """Grade as of a registration: `good` if 90 % of the frame is expected to lie within 0.5 px, of the
    coarser lens; `fair` within 1 px; `poor` otherwise. The `reason` says why it is not good."""
    expected_ce90_px: float | None = None
    """Error that 90 % of the frame is expected not to exceed, by places that were not used in the fit."""
    seconds: float | None = None
    done_before: bool = False


def doubt_of(expected_ce90_px: float) -> str | None:
    """Return why a capture, or a rig, is not good; None if it is."""
    if expected_ce90_px <= GOOD_PX:
        return None
    return (
        f"a tenth of the frame is expected to lie more than {expected_ce90_px:.1f} px off: ground of several "
        "depths, or lenses that moved"
    )


def correct_capture(task: CaptureTask) -> CaptureOutcome:
    """Correct one capture, or say why that cannot be done; nothing is raised but for an unexpected error."""
    begun = time.perf_counter()
    name = task.capture.name
    try:
        placement, frames, values = placed_capture(task.rig, task.capture)
        write_capture(task, placement, frames, values)
    except BadCaptureError as error:
        return CaptureOutcome(name, "rejected", str(error))
    except InputError as error:
        return CaptureOutcome(name, "unusable", str(error))
    inverse_depth = float(placement.plane[0])
    return CaptureOutcome(
        name,
        "corrected",
        doubt_of(placement.expected_ce90_px),
        file=f"{name}.tif" if task.split is None else task.split[0],
        points=placement.points,
        residual_px=placement.residual_px,
        inverse_depth=inverse_depth,
        distance_m=None if task.rig.distance_m is None else task.rig.distance_m / inverse_depth,
        sigma_px=placement.sigma_px,
        quality=grade_of_error(placement.expected_ce90_px),
        expected_ce90_px=placement.expected_ce90_px,
        seconds=time.perf_counter() - begun,
    )


def placed_capture(rig: Rig, capture: Capture) -> tuple[Placement, list[Frame], list[Float32]]:
    """Return where the ground of a capture was, and its frames with their (rows, cols) values.

    Raises `BadCaptureError` if it cannot be corrected.
    """
    frames = [capture.frames[name] for name in rig.names]
    values = [read_frame(frame) for frame in frames]
    height_m, distance_m = capture.height_m, rig.distance_m
    expected = None if height_m is None or distance_m is None else distance_m / height_m
    try:
        sharpness = {name: measure_sharpness(plane) for name, plane in zip(rig.names, values, strict=True)}
        check_sharpness({lens.name: lens.sharpness for lens in rig.lenses}, sharpness)
        placement = with_expected_error(place(rig, values, expected), values)
    except BadCaptureError as error:
        raise BadCaptureError(panel_shown(frames, values) or str(error)) from error
    is_near = placement.plane[0] > CAPTURE.panel_ratio * rig.inverse_depth[1]
    panel = panel_shown(frames, values) if is_near or any(frame.panel for frame in frames) else None
    if panel is not None:
        raise BadCaptureError(panel)
    return placement, frames, values


def with_expected_error(placement: Placement, values: Sequence[Float32]) -> Placement:
    """Return a capture with its expected error, by places that its fit has not used.

    The (rows, cols) `values` are its frames. Raises `BadCaptureError` if hardly any place agrees.
    """
    rig = placement.rig
    errors_px, count = [], 0
    for number, lens in enumerate(rig.lenses[1:], 1):
        corners, refinement = refined(rig, number, values, placement.plane, test=True)
        own_px = reduction_of(rig, lens) * min(1.0, lens.lens.focal_px / rig.reference.lens.focal_px)
        errors_px.append(own_px * np.hypot(*refinement.shift_xy_px[refinement.converged].T))
        count += len(corners)
    every = np.concatenate(errors_px)
    agreeing = int((every < FAIR_PX).sum())
    measured = all(map(len, errors_px))
    expected = max([np.percentile(every, 90), *map(np.median, errors_px)]) if measured else math.inf
    if expected > FAIR_PX and agreeing <= QualityParameters().poor_kept_share * count:
        raise BadCaptureError(
            f"only {agreeing} of {count} places lie within {FAIR_PX:g} px of one ground: it has several "
            "depths, as near scenes do, its lenses show different ground, or the rig is not of this camera "
            "as it is"
        )
    return replace(placement, expected_ce90_px=float(expected))


def try_capture(rig: Rig, capture: Capture) -> float | str:
    """Return the error expected of a capture, px, or why it cannot be corrected."""
    try:
        return placed_capture(rig, capture)[0].expected_ce90_px
    except BadCaptureError as error:
        return str(error)
