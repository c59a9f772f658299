"""The grades of the images of a stack, and whether it meets its requirements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcwlad_geo.multi.block.adjustment import BlockAdjustment
from pcwlad_geo.multi.stack.quality import image_qualities
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.requirements import Figure, Requirement, RequirementResult, judge


def grade_images(result: Stack) -> Stack:
    """Grade the images of a stack by their pairs."""
    groups = {image.name: image.group for image in result.images}
    anchors = set[str]()
    if result.datum in groups:
        datums = {image.group: image.name for image in reversed(result.images)}
        anchors = set((datums | {groups[result.datum]: result.datum}).values())
    sigma_px = {image.name: float(np.hypot(*image.sigma_px)) / 2**0.5 for image in result.images}
    unit_px = {image.name: image.frame_px for image in result.images}
    heights_px: dict[str, float] = {}
    check = result.block.dem if result.block else None
    if check is not None and isinstance(result.adjustment, BlockAdjustment):
        off_px = check.off_m * np.hypot(*result.adjustment.by_height_px.T)
        heights_px = {image.name: float(off_px[number]) for number, image in enumerate(result.images)}
    qualities = image_qualities(result.pairs, sigma_px, unit_px, anchors, heights_px)
    faults = check.faults if check else ()
    for image in result.images if faults else ():
        if image.rpc is not None:
            qualities[image.name] = qualities[image.name].doubted(faults[0])
    images = tuple(replace(image, quality=qualities[image.name]) for image in result.images)
    return replace(result, images=images)


def judge_stack(result: Stack, requirements: Sequence[Requirement]) -> tuple[RequirementResult, ...]:
    """Evaluate requirements on the worst image, all cycles (closure) or all pairs in use (points).

    Lengths in metres are computed with the largest pixel of all images.
    """
    sizes_m = [
        float(np.divide(image.sigma_m, image.sigma_px).max())
        for image in result.images
        if image.sigma_m and min(image.sigma_px) > 0
    ]
    px_m = max(sizes_m, default=None)
    points = [pair.points for pair in result.pairs if pair.status == "used"]
    values: dict[str, float | str | None] = {
        "quality": result.quality.grade,
        "points": float(min(points, default=0)),
        "sigma": max(max(image.sigma_px) for image in result.images),
        "displacement": max(float(np.hypot(*image.shift_px)) for image in result.images),
        "closure": result.closure.after_px,
    }
    grade = result.quality.grade
    doubt = None if grade == "good" else f"but the stack is {grade}"
    results = []
    for requirement in requirements:
        value = values[requirement.statistic]
        if requirement.unit == "m" and isinstance(value, float):
            value = None if px_m is None else value * px_m
        reason = "not known: no cycle, or no size of a pixel in metres" if value is None else None
        results.append(judge(requirement, Figure(value, reason, doubt)))
    return tuple(results)
