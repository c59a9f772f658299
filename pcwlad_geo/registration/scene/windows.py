"""The windows of a scene: those of its first pass, and the choice for the second by what a sample shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import only_warnings
from pcwlad_geo.matching import AUTO_FEATURES, FieldGuide, MatchSettings, Scales, TiePoints
from pcwlad_geo.matching.jitter import jitter_px
from pcwlad_geo.matching.types import TRAITS
from pcwlad_geo.matching.window import WINDOWS, MatchingWindow
from pcwlad_geo.matching.windows import WindowErrors, choose_scales, sample_size
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import ViewPair
from pcwlad_geo.registration.motions import share_displaced
from pcwlad_geo.registration.planning import common_region, farthest_px
from pcwlad_geo.registration.scene.first_pass import FirstPass
from pcwlad_geo.registration.scene.parameters import SceneContext, SceneParameters
from pcwlad_geo.registration.starts.alignment import Prealignment
from pcwlad_geo.registration.tiles import compare_stripes, compare_surroundings, compare_windows
from pcwlad_geo.types import Float64, Index


def match_settings(
    pair: ViewPair, offset: tuple[int, int], prealignment: Prealignment, context: SceneContext
) -> MatchSettings:
    """Return the settings of all tiles, with windows that fit into the common area.

    Raises `InputError` if no window fits into it.
    """
    settings, by, region = context.settings, context.parameters, common_region(pair, offset)
    rows, cols = region.rows, region.cols
    if prealignment.method in ("georeferencing", "pose"):  # a resampled view reaches beyond the overlap
        rows, cols = min(rows, pair.overlap.rows), min(cols, pair.overlap.cols)
    narrow = min(rows, cols)
    if narrow < by.least_window_px:
        raise InputError(
            f"the common area is {cols} x {rows} px of the matching grid: too small to match "
            f"(at least {by.least_window_px} px a side); use rasters that share more ground"
        )
    template, window = settings.template, settings.matching_window
    most = max(by.least_window_px, int(narrow / by.windows_across) // 2 * 2 - 1)
    if max(template, window.side_px) > most:
        template, window = min(template, most), replace(window, side_px=min(window.side_px, most))
        context.log.warn(
            f"narrow overlap of {narrow} px: matching windows shrunk to {template} px (coarse), "
            f"{window.side_px} px (fine)"
        )
    margin = round(0.4 * template)
    return MatchSettings(
        method=settings.method,
        features=settings.features if settings.points is None else settings.features or AUTO_FEATURES,
        keypoints=settings.keypoints,
        features_area_px2=float(max((rows - margin) * (cols - margin), 1)),
        template=template,
        window=_fitting(window, settings, narrow, by),
        search_radius=min(prealignment.search_radius_px, farthest_px(pair, offset)),
        ssim_min=settings.ssim_min,
        iterations=settings.iterations,
        consensus=settings.consensus,
        backward="sample" if settings.points in ("all", "dense") else "as needed",
    )


def _fitting(
    window: MatchingWindow, settings: Settings, narrow_px: int, by: SceneParameters
) -> MatchingWindow:
    """Return the window with those sides besides its first that an overlap `narrow_px` wide takes.

    An open one stays open, unless the overlap is narrow for it. Otherwise smaller sides tell the error of
    the first. There are none where points are not guided.
    """
    side_px = window.side_px
    if TRAITS[settings.method].structure != "local" or settings.consensus == "off":
        return MatchingWindow(side_px)
    if window.is_open and narrow_px >= by.choice_windows_across * max(WINDOWS.others_px):
        fitting = (large for large in WINDOWS.large_px if by.windows_across * large <= narrow_px)
        return replace(window, others_px=(*WINDOWS.others_px, *fitting))
    smaller = (int(share * side_px) // 2 * 2 + 1 for share in by.smaller_windows)
    return MatchingWindow(side_px, tuple(smaller))


@dataclass(frozen=True, slots=True, eq=False)
class WindowChoice:
    """The windows of the second pass, and what they average out."""

    scales: Scales
    errors: WindowErrors | None = None
    """Those of the windows; None where too few points show them."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window, RMS, view px."""
    displaced_share: float = 0.0
    """Share of the points around which another displacement fits better."""


def choose_windows(
    first: FirstPass,
    points: TiePoints,
    tile_of: Index,
    guide: FieldGuide,
    other_px: Float64 | None,
    context: SceneContext,
) -> WindowChoice:
    """Choose the windows of the second pass by a sample of the points, whose tiles are spread over the scene.

    The `points` are the consistent ones, in the (n,) tiles `tile_of`, with their guide. The (2,) `other_px`
    (col, row) is a displacement beside their own of which the share of the points is wanted.
    """
    window = first.jobs[0].settings.window
    least_points = sample_size(points.reference_xy_px, window)
    if not least_points:
        return WindowChoice(Scales.of(window.side_px))
    tiles, counts = np.unique(tile_of, return_counts=True)
    # multiples of the golden ratio are spread evenly, however many are taken
    spread = np.argsort((5**0.5 - 1) / 2 * np.arange(len(tiles)) % 1, kind="stable")
    enough = int(np.searchsorted(np.cumsum(counts[spread]), least_points)) + 1
    selection = np.sort(spread[:enough])
    step = max(1, int(counts[selection].sum() / least_points))
    members = [np.flatnonzero(tile_of == tile) for tile in tiles[selection]]
    on_event = partial(only_warnings, context.log.on_event)  # the progress is no stage's own

    def measured(
        compare: Callable[..., Float64], samples: Sequence[Index], *windows_px: Sequence[int]
    ) -> Float64:
        calls = [
            (first.jobs[tile], points[sample], guide.part(sample), *windows_px)
            for tile, sample in zip(tiles[selection], samples, strict=True)
        ]
        return np.concatenate(context.runner.run(compare, calls, "refining", on_event), axis=1)

    samples = [index[::step] for index in members]
    scales, errors = choose_scales(partial(measured, compare_windows, samples), window)
    step = max(1, int(counts[selection].sum() / WINDOWS.sample))  # jitter shows in many points only
    larger = [index[:: max(1, step // 2)] for index in members]
    sample = np.concatenate(larger)
    xy, displacement_px = points.reference_xy_px[sample], points.displacement_px[sample]
    beside_px = context.parameters.stripes_beside_px
    stripes_px = measured(partial(compare_stripes, beside_px=beside_px), larger)
    jitter, share = jitter_px(xy, stripes_px - displacement_px, beside_px), 0.0
    if other_px is not None:
        best_px = measured(partial(compare_surroundings, other_px=other_px), larger)[0]
        share = share_displaced(best_px - displacement_px, other_px, context.parameters.motions)
    return WindowChoice(scales, errors, jitter, share)
