"""The settings with which the tiles of a scene are matched, above all their windows."""

from __future__ import annotations

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import AUTO_FEATURES, MatchSettings
from pcwlad_geo.matching.types import FIRST_WINDOW_PX, LARGE_WINDOWS_PX, OTHER_WINDOWS_PX, TRAITS
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
    template, window = settings.template, settings.window or FIRST_WINDOW_PX
    most = max(by.least_window_px, int(narrow / by.windows_across) // 2 * 2 - 1)
    if max(template, window) > most:
        template, window = min(template, most), min(window, most)
        context.log.warn(
            f"narrow overlap of {narrow} px: matching windows shrunk to {template} px (coarse), "
            f"{window} px (fine)"
        )
    margin = round(0.4 * template)
    others = _other_windows(settings, window, narrow, by)
    return MatchSettings(
        method=settings.method,
        features=settings.features if settings.points is None else settings.features or AUTO_FEATURES,
        keypoints=settings.keypoints,
        features_area_px2=float(max((rows - margin) * (cols - margin), 1)),
        template=template,
        window=window,
        other_windows=others,
        open_window=others[: len(OTHER_WINDOWS_PX)] == OTHER_WINDOWS_PX,
        search_radius=min(prealignment.search_radius_px, farthest_px(pair, offset)),
        ssim_min=settings.ssim_min,
        iterations=settings.iterations,
        consensus=settings.consensus,
        backward="sample" if settings.points in ("all", "dense") else "as needed",
    )


def _other_windows(
    settings: Settings, window_px: int, narrow_px: int, by: SceneParameters
) -> tuple[int, ...]:
    """Return what some points are matched with beside the first window.

    If that is not given, it is what the second pass may choose from, unless the overlap, `narrow_px` wide, is
    narrow for it. Otherwise smaller windows tell the error of the given one. None where points are
    not guided.
    """
    if TRAITS[settings.method].structure != "local" or settings.consensus == "off":
        return ()
    if settings.window is None and narrow_px >= by.choice_windows_across * max(OTHER_WINDOWS_PX):
        fitting = (window for window in LARGE_WINDOWS_PX if by.windows_across * window <= narrow_px)
        return *OTHER_WINDOWS_PX, *fitting
    return tuple(int(share * window_px) // 2 * 2 + 1 for share in by.smaller_windows)
