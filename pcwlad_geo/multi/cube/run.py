"""The dates of a cube placed by the adjustment of a stack: each is read once, and its correction returned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.multi.cube.layout import CubeLayout, grid_of
from pcwlad_geo.multi.cube.scenes import SCENES, Scene, write_median, write_scenes, write_warped
from pcwlad_geo.multi.stack.frame import StackFrame, frame_of
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.job import StackJob, job_of
from pcwlad_geo.multi.stack.pair_choice import Candidate, candidates, planned_pairs, read_overview
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.multi.stack.run import placed
from pcwlad_geo.multi.stack.verdict import grade_images
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, trusting
from pcwlad_geo.raster.crs import displacement_m
from pcwlad_geo.raster.scratch import Scratch

OF_FILES: Final = ("require", "keep", "like", "grid", "of", "co", "write_sigma", "write_displacement", "pdf")
"""Options about the files of a stack, of which a cube writes none."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedDate:
    """Where an image of a cube lies."""

    file: str
    """Its pixels, in a temporary file."""
    grade: str
    """good, fair, poor or refused."""
    reason: str
    """Why it is not good; empty where it is."""
    correction: Correction | None = None
    """None where it was refused, so that it stays where it was."""
    displacement_m: tuple[float, float] = (np.nan, np.nan)
    """Mean displacement along the axes of the CRS, metres: where it shows the ground less where that lies."""
    sigma_m: float = np.nan
    """Standard deviation of its position along an axis, metres."""


def place_dates(
    cube: Any,  # noqa: ANN401  # of xarray, which need not be installed
    mask: Any,  # noqa: ANN401
    layout: CubeLayout,
    reference: Any,  # noqa: ANN401
    scratch: Scratch,
    options: Mapping[str, Any],
    on_event: EventCallback,
    executor: Executor | Runner | None,
) -> list[PlacedDate]:
    """Place the images of a cube by the adjustment of a stack, each of whose images is read once.

    Parameters
    ----------
    cube, mask : xarray.DataArray
        Of (time, y, x), the same pixels and dates; the mask may be None.
    layout : CubeLayout
    reference : "median", "monthly", date or xarray.DataArray
        What stays: the median of all dates, that of the dates of a month over all years (the month of most
        dates; each date is compared with that of its month), the image of a date, or another image.
    scratch : Scratch
        Folder of the files.
    options : mapping
        As `stack` takes them.
    on_event : callable
    executor : concurrent.futures.Executor or Runner, optional

    Raises
    ------
    InputError
        If the images, or they and the reference, share no ground.
    RegistrationRejectedError
        If no two images could be matched.
    """
    job = job_of(scratch.folder, False, on_event, executor, {**options, "no_report": True})
    default = Settings()
    for name in OF_FILES:
        if getattr(job.settings, name) != getattr(default, name):
            raise SettingsError(f"{name} is about the files of a stack, and a cube writes none: leave it out")
    medians = isinstance(reference, str) and reference in ("median", "monthly")
    number = None if medians or _is_image(reference) else layout.number_of(reference)
    if medians and reference == "monthly" and max(Counter(_months(layout)).values()) < SCENES.min_dates:
        raise InputError(
            f"reference = 'monthly': no month has {SCENES.min_dates} dates, as a median needs: give 'median'"
        )
    with trusting(job.settings.trust):
        dates = write_scenes(cube, mask, layout, scratch, job.tell)
        usable = [scene for scene in dates if scene.valid.any()]
        if len(usable) < 2:
            raise InputError(f"{len(usable)} of the {len(dates)} dates show valid pixels: give more")
        if number is not None and dates[number] not in usable:
            raise InputError(f"reference = {reference!r}: its image has no valid pixel: name another date")
        references = [_image(reference, dates[0], scratch)] if _is_image(reference) else []
        datum = None if medians else usable.index(dates[number]) if number is not None else 0
        placements = _placements(job, [*references, *usable], len(references), datum)
        if medians:
            references = _medians(dates, placements, layout, reference, scratch)
            second_job = replace(job, measurements={})  # pairs of dates are read from their folders
            if references:
                placements = _placements(second_job, [*references, *usable], len(references), 0)
    empty = PlacedDate("", "refused", "it has no valid pixel")
    return [placements.get(scene.given.name, replace(empty, file=scene.given.path)) for scene in dates]


def _is_image(reference: Any) -> bool:  # noqa: ANN401
    return len(getattr(reference, "dims", ())) > 1


def _months(layout: CubeLayout) -> list[int]:
    return [int(str(time)[5:7]) for time in layout.times]


def _image(reference: Any, date: Scene, scratch: Scratch) -> Scene:  # noqa: ANN401
    """Return the reference that is an image beside the cube; `date` is an image of that."""
    grid_of(reference, "the reference")
    image = reference.squeeze()
    if image.ndim != 2:
        raise InputError(
            f"the reference has the dimensions {', '.join(map(str, reference.dims))}: give an image of (y, x)"
        )
    return Scene(StackInput(scratch.file_of(image, "reference"), 1, "reference"), np.ones_like(date.valid))


def _medians(
    dates: Sequence[Scene],
    placements: Mapping[str, PlacedDate],
    layout: CubeLayout,
    reference: str,
    scratch: Scratch,
) -> list[Scene]:
    """Return the medians of dates that have been placed, that of most dates first.

    They are medians of warped images: those of images that lie apart would show every edge several times.
    Their common place is the median of those of the dates.
    """
    good = {name: date.correction for name, date in placements.items() if date.correction is not None}
    if len(good) < SCENES.min_dates:
        return []
    middle = layout.grid.middle_px
    shift_px = np.median([correction.forward(middle) - middle for correction in good.values()], axis=0)[0]
    shift_back = AffineCorrection("shift", np.column_stack([np.eye(2), -shift_px]))
    months: dict[int, list[str]] = {}
    for scene, month in zip(dates, _months(layout), strict=True):
        if scene.given.name in good:
            file = write_warped(scene, good[scene.given.name] @ shift_back, layout, scratch)
            months.setdefault(month if reference == "monthly" else 0, []).append(file)
    largest_first = sorted(months.items(), key=lambda month: -len(month[1]))
    return [
        write_median(files, f"month{month:02}" if month else "median", layout, scratch, month)
        for month, files in largest_first
        if len(files) >= SCENES.min_dates
    ]


def _stack_of(job: StackJob, scenes: Sequence[Scene], references: int, datum: int | None) -> Stack:
    """Return the graded stack of images, of which the first are references."""
    inputs = [scene.given for scene in scenes]
    infos = [image.describe() for image in inputs]
    frame = frame_of(inputs, infos, None if datum is None else inputs[datum].name, job.settings.model)
    overviews = [read_overview(info) for info in infos]
    ranked = [pair for pair in candidates(frame, inputs, overviews) if _share_ground(scenes, pair)]
    if not ranked:
        raise InputError(
            "no two dates of the cube share ground: give images of one place, or a mask that leaves more"
        )
    if datum is not None and not any(datum in candidate.pair for candidate in ranked):
        raise InputError(
            f"no date of the cube shares ground with the reference {inputs[datum].name}: give one of the "
            "same place"
        )
    choice, plan = planned_pairs(frame, ranked, None, None)
    plan += [pair for pair in _with_references(scenes, references, frame) if pair not in plan]
    try:
        return grade_images(placed(job, frame, ranked, (choice, plan), datum, split=True))
    except RegistrationRejectedError as error:
        reasons = [text for text in job.warnings if ": refused: " in text]
        raise RegistrationRejectedError(
            f"no two dates of the cube could be matched ({reasons[0] if reasons else error}): mask clouds "
            "and what moves, or give another band"
        ) from error


def _share_ground(scenes: Sequence[Scene], candidate: Candidate) -> bool:
    one, other = candidate.pair
    return bool((scenes[one].valid & scenes[other].valid).any())


def _with_references(scenes: Sequence[Scene], references: int, frame: StackFrame) -> list[tuple[int, int]]:
    """Return the pairs of each date with the reference, or the median of its month."""
    pairs = []
    for number in range(references, len(scenes)):
        month = (scenes[number].given.date or "")[5:7]
        for other in range(references):
            if references == 1 or frame.names[other] == f"month{month}":
                pairs.append((other, number))
    return [pair for pair in pairs if (scenes[pair[0]].valid & scenes[pair[1]].valid).any()]


def _placements(
    job: StackJob, scenes: Sequence[Scene], references: int, datum: int | None
) -> dict[str, PlacedDate]:
    """Adjust images, of which the first are references, and return where each lies, by its name."""
    result = _stack_of(job, scenes, references, datum)
    groups = [image.group for image in result.images]
    main = groups[datum] if datum is not None else max(set(groups), key=groups.count)
    placements = {}
    for scene, image in zip(scenes, result.images, strict=True):
        grade, reason = image.quality.grade, "; ".join(image.quality.reasons)
        if image.group != main:
            reasons = [pair.reason for pair in result.pairs if image.name in (pair.reference, pair.target)]
            text = next(filter(None, reasons), "it shares no ground with the others")
            grade, reason = "refused", f"no pair connects it with the reference: {text}"
        date = PlacedDate(scene.given.path, grade, reason)
        if grade != "refused":
            moved_m = mean_displacement_m(scene.given.describe().grid, image.correction)
            sigma_m = float(np.hypot(*(image.sigma_m or (np.nan, np.nan))) / 2**0.5)
            date = replace(date, correction=image.correction, displacement_m=moved_m, sigma_m=sigma_m)
        placements[image.name] = date
    return placements


def mean_displacement_m(grid: Grid, correction: Correction) -> tuple[float, float]:
    """Return the mean displacement of an image along the axes of its CRS, metres."""
    at_px = grid.lattice_px(5)
    moved = displacement_m(grid.to_xy(at_px), grid.to_xy(correction.forward(at_px)), grid.crs)
    x_m, y_m = np.mean(moved, axis=0).tolist()
    return x_m, y_m
