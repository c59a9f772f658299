"""The settings with which the tiles of a scene are matched, above all their windows."""

from __future__ import annotations

from dataclasses import replace

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import AUTO_FEATURES, MatchSettings
from pcwlad_geo.matching.types import TRAITS
from pcwlad_geo.matching.window import WINDOWS, MatchingWindow
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import ViewPair
from pcwlad_geo.registration.planning import common_region, farthest_px
from pcwlad_geo.registration.scene.parameters import SceneContext, SceneParameters
from pcwlad_geo.registration.starts.alignment import Prealignment


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
