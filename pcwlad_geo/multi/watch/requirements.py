"""The requirements of a watch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.estimation.time_series import SERIES
from pcwlad_geo.multi.watch.ground_motion import GroundMotion
from pcwlad_geo.multi.watch.numbers import ImageSeries, SeriesOffset, WatchedImage
from pcwlad_geo.requirements import Figure, Requirement, RequirementResult, judge


def judge_watch(
    series: Sequence[ImageSeries],
    offsets: Sequence[SeriesOffset],
    motion: GroundMotion | None,
    requirements: Sequence[Requirement],
) -> tuple[RequirementResult, ...]:
    """Evaluate requirements on the largest of any series or region; what was not sought is not known."""
    lengths_of: dict[str, list[tuple[tuple[float, float], float | None]]] = {
        "step": [(step.size_px, group.pixel_size_m) for group in series for step in group.steps],
        "drift": [(group.drift.px_per_year, group.pixel_size_m) for group in series if group.drift],
        "season": [(group.season.amplitude_px, group.pixel_size_m) for group in series if group.season],
        "latest": [(_off(group.images[-1]), group.pixel_size_m) for group in series],
        "offset": [(offset.offset_px, series[0].pixel_size_m) for offset in offsets],
        "motion": [(region.velocity_px, motion.px_m) for region in motion.regions] if motion else [],
    }
    results = []
    for requirement in requirements:
        lengths, reason = [], _not_sought(requirement.statistic, series, offsets, motion)
        for size_px, px_m in lengths_of[requirement.statistic]:
            scale = 1.0 if requirement.unit == "px" else px_m
            if scale is None:
                reason = "not known: the images have no size of a pixel in metres"
            else:
                lengths.append(scale * float(np.hypot(*size_px)))
        figure = Figure(None if reason else max(lengths, default=0.0), reason)
        results.append(judge(requirement, figure))
    return tuple(results)


def _off(image: WatchedImage) -> tuple[float, float]:
    """Return how far an image lies off what its series lets expect (col, row), px."""
    return float_pair(np.subtract(image.shift_px, image.expected_px))


def _not_sought(
    statistic: str,
    series: Sequence[ImageSeries],
    offsets: Sequence[SeriesOffset],
    motion: GroundMotion | None,
) -> str | None:
    """Return why a figure is not known; None where it is."""
    shortest, span = min(len(group.images) for group in series), min(group.span_years for group in series)
    if statistic in ("step", "drift", "latest") and shortest < SERIES.min_images:
        return f"not known: a series has {shortest} images, and {SERIES.min_images} are needed"
    if statistic == "season" and (shortest < SERIES.min_season_images or span < SERIES.min_season_years):
        images, years = SERIES.min_season_images, SERIES.min_season_years
        return f"not known: {images} images in {years} years are needed of each series"
    if statistic == "offset" and len(offsets) < max(1, len(series) - 1):
        return "not known: there is one series, or no size of a pixel relates them"
    if statistic == "motion" and motion is None:
        return "not known: too few dates, or images that cannot be read"
    return None
