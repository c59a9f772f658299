"""The job, up to its result: pre-align, plan tiles, match, merge, fit, judge. Writes nothing."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.guidance import calibrate, guide_by_field
from pcwlad_geo.matching.matcher import consistent_points
from pcwlad_geo.matching.settings import MatchSettings
from pcwlad_geo.matching.tie_points import TiePoints
from pcwlad_geo.raster.geodesy import pixel_size_m
from pcwlad_geo.raster.locate import locate
from pcwlad_geo.raster.matching_grid import ViewPair, plan_views
from pcwlad_geo.raster.source import RasterInfo, describe, same_band
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.registration.fitting import Fitted, fit_correction, shared_residual_px
from pcwlad_geo.registration.judge import Verdict, judge
from pcwlad_geo.registration.prealign import Look, by_georeferencing, by_search, look_at, target_offset_px
from pcwlad_geo.registration.progress import EventCallback, Progress, Warned, ignore
from pcwlad_geo.registration.result import Prealignment, Registration
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.registration.tasks import run_tasks
from pcwlad_geo.registration.tiles import (
    TileJob,
    TileResult,
    common_region,
    match_tile,
    plan_tiles,
    rematch_tile,
)

LEAST_WINDOW_PX = 41
WINDOWS_ACROSS = 1.6
"""An overlap narrower than this many windows gets smaller ones."""
FEATURE_AREA_PX = 1024
"""`features` candidates lie in a square of this side, or in the scene where that is smaller."""
PARALLAX_PX = 0.5
"""Residuals that neighbours share are worth a warning where a third of them exceed this."""

PathLike = str | os.PathLike[str]


@dataclass(slots=True)
class _Log:
    """Warnings and stage times of a run."""

    on_event: EventCallback
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def warn(self, message: str) -> None:
        self.warnings.append(message)
        self.on_event(Warned(message))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun


@dataclass(frozen=True, slots=True, eq=False)
class _Matched:
    """What the tiles gave, merged."""

    matches: TiePoints
    """All of the first pass, view px; the kept ones as the second pass left them."""
    kept: NDArray[np.bool_]
    counts: dict[str, int]
    verdict: Verdict
    prealignment: Prealignment


def run(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    *,
    on_event: EventCallback = ignore,
    executor: Executor | None = None,
    match_only: bool = False,
) -> Registration:
    """Register the target to the reference, or only match them.

    Parameters
    ----------
    reference, target : path
    settings : Settings
    on_event : callable
        Receives progress and warnings; an exception that it raises ends the job.
    executor : concurrent.futures.Executor, optional
        Runs the tiles; None: this process.
    match_only : bool
        Stop at the tie points.

    Raises
    ------
    InputError
        If the input cannot be used.
    """
    log = _Log(on_event)
    with log.stage("reading"):
        ref = describe(reference, band=settings.ref_band, mask=settings.ref_mask)
        tgt = describe(target, band=settings.tgt_band, mask=settings.tgt_mask)
        pair = plan_views(ref, tgt)
        for warning in pair.warnings:
            log.warn(warning)
        if same_band(ref, tgt):
            log.warn(
                "reference and target are the same file and band: the displacement is zero by construction"
            )
        on_event(Progress("reading", 0, 1))
        look = look_at(pair)
        on_event(Progress("reading", 1, 1))
    matched = _match(pair, look, settings, log, executor)
    table = _table(matched, pair)
    px_m = _px_m(tgt)
    fitted: Fitted | None = None
    if matched.verdict.accepted and not match_only:
        with log.stage("fitting"):
            on_event(Progress("fitting", 0, 1))
            footprint = settings.window * _target_px_per_view_px(pair)
            fitted = fit_correction(table, settings, footprint, px_m, tgt.grid.shape)
            _warn_of_parallax(fitted, log)
            on_event(Progress("fitting", 1, 1))
    status = "rejected" if not matched.verdict.accepted else "matched" if match_only else "registered"
    return Registration(
        status=status,  # type: ignore[arg-type]  # one of three literals
        reason=matched.verdict.reason,
        warnings=tuple(log.warnings),
        reference=ref,
        target=tgt,
        matching_grid=pair.reference.grid,
        px_m=px_m,
        prealignment=matched.prealignment,
        tie_points=fitted.table if fitted else table,
        correction=fitted.correction if fitted else None,
        accuracy=fitted.accuracy if fitted else {},
        counts=matched.counts,
        seconds=log.seconds,
        settings=settings,
        selection=fitted.selection if fitted else None,
    )


def _match(pair: ViewPair, look: Look, settings: Settings, log: _Log, executor: Executor | None) -> _Matched:
    """Match from the best start known; where that fails and the user left it open, from a search."""
    starts = _starts(pair, look, settings, log)
    result: _Matched | None = None
    for prealignment in starts:
        if prealignment is None:
            continue
        result = _match_from(pair, look, prealignment, settings, log, executor)
        if result.verdict.accepted:
            if prealignment.method == "search" and pair.georeferenced:
                col, row = prealignment.shift_px
                log.warn(
                    f"the georeferencing is off by about ({col:.0f}, {row:.0f}) px (col, row): "
                    "found by a search"
                )
            return result
    if result is None:
        raise InputError("no start for the matching: give --prealign auto")
    return result


def _starts(pair: ViewPair, look: Look, settings: Settings, log: _Log) -> Iterator[Prealignment | None]:
    radius = settings.search_radius
    direct = by_georeferencing(radius)
    if not pair.georeferenced:
        direct = replace(direct, method="identity")
    if settings.prealign == "none":
        direct = replace(direct, method="none")
    search_first = settings.prealign == "search" or (settings.prealign == "auto" and not pair.georeferenced)
    if not search_first:
        yield direct
    if search_first or (settings.prealign == "auto" and radius is None):
        with log.stage("prealignment"):
            log.on_event(Progress("prealignment", 0, 1))
            found, _ = by_search(pair, look, radius)
            log.on_event(Progress("prealignment", 1, 1))
        yield found
    if search_first:
        yield direct


def _match_from(
    pair: ViewPair,
    look: Look,
    prealignment: Prealignment,
    settings: Settings,
    log: _Log,
    executor: Executor | None,
) -> _Matched:
    """Both passes over all tiles, from one start."""
    offset = target_offset_px(pair, prealignment)
    matching = _match_settings(pair, offset, prealignment, settings, log)
    jobs = plan_tiles(pair, offset, look.scenes, matching, settings.tile_size)
    with log.stage("matching"):
        first = run_tasks(
            match_tile, [(job,) for job in jobs], "matching", executor, settings.jobs, log.on_event
        )
    _warn_of_failures(first, log)
    matches = TiePoints.concatenate([result.points for result in first])
    tile_of = np.repeat(np.arange(len(first)), [len(result.points) for result in first])
    kept = consistent_points(matches, matching) if len(matches) else np.zeros(0, bool)
    counts = _sum_counts(first)
    verdict = judge(matches, kept, counts, matching.window, prealignment.search_radius_px)
    if verdict.accepted:
        with log.stage("refining"):
            matches, kept = _second_pass(jobs, matches, tile_of, kept, matching, settings, log, executor)
    counts["inconsistent"] = int((~kept).sum())
    counts["tie_points"] = int(kept.sum())
    return _Matched(matches, kept, counts, verdict, prealignment)


def _second_pass(
    jobs: list[TileJob],
    matches: TiePoints,
    tile_of: NDArray[np.intp],
    kept: NDArray[np.bool_],
    matching: MatchSettings,
    settings: Settings,
    log: _Log,
    executor: Executor | None,
) -> tuple[TiePoints, NDArray[np.bool_]]:
    """Match the consistent points again, guided by the field of all of them; check them once more."""
    index = np.flatnonzero(kept)
    good = matches[index]
    guide = guide_by_field(good, matching)
    calls = []
    parts = []
    for tile in np.unique(tile_of[index]):
        part = np.flatnonzero(tile_of[index] == tile)
        parts.append(part)
        calls.append((jobs[tile], good[part], guide.part(part)))
    results = run_tasks(rematch_tile, calls, "refining", executor, settings.jobs, log.on_event)
    order = np.concatenate(parts)
    again = TiePoints.concatenate([result.points for result in results])[np.argsort(order)]
    final = kept.copy()
    final[index] = consistent_points(again, matching)
    good = calibrate(again[final[index]], guide, matching)
    # rejected points are listed with their formal covariance
    target, covariance = matches.target_xy_px.copy(), matches.covariance_px2.copy()
    target[final], covariance[final] = good.target_xy_px, good.covariance_px2
    return replace(matches, target_xy_px=target, covariance_px2=covariance), final


def _match_settings(
    pair: ViewPair, offset: tuple[int, int], prealignment: Prealignment, settings: Settings, log: _Log
) -> MatchSettings:
    region = common_region(pair, offset)
    rows, cols = region.rows, region.cols
    if prealignment.method == "georeferencing":  # a resampled view reaches beyond the overlap
        rows, cols = min(rows, pair.overlap.rows), min(cols, pair.overlap.cols)
    narrow = min(rows, cols)
    if narrow < LEAST_WINDOW_PX:
        raise InputError(
            f"the common area is {cols} x {rows} px of the matching grid: too small to match "
            f"(at least {LEAST_WINDOW_PX} px a side); use rasters that share more ground"
        )
    template, window = settings.template, settings.window
    most = max(LEAST_WINDOW_PX, int(narrow / WINDOWS_ACROSS) // 2 * 2 - 1)
    if max(template, window) > most:
        template, window = min(template, most), min(window, most)
        log.warn(
            f"narrow overlap of {narrow} px: matching windows shrunk to {template} px (coarse), "
            f"{window} px (fine)"
        )
    margin = round(0.4 * template)
    area = min((rows - margin) * (cols - margin), FEATURE_AREA_PX**2)
    return MatchSettings(
        method=settings.method,
        features=settings.features,
        keypoints=settings.keypoints,
        features_area_px2=float(max(area, 1)),
        template=template,
        window=window,
        search_radius=prealignment.search_radius_px,
        ssim_min=settings.ssim_min,
        iterations=settings.iterations,
        consensus=settings.consensus,
    )


def _table(matched: _Matched, pair: ViewPair) -> TiePointTable:
    table = locate(matched.matches, pair)
    return replace(table, status=np.where(matched.kept, "matched", "rejected"))


def _sum_counts(results: list[TileResult]) -> dict[str, int]:
    total: dict[str, int] = {"tiles": len(results), "candidates": 0}
    for result in results:
        for name, count in result.counts.items():
            total[name] = total.get(name, 0) + count
    return total


def _warn_of_failures(results: list[TileResult], log: _Log) -> None:
    failed = [result for result in results if result.status == "failed"]
    if failed and len(failed) == len(results):
        raise InputError(failed[0].reason or "no tile could be read")
    for result in failed:
        log.warn(f"tile {result.id} left out: {result.reason}")


def _warn_of_parallax(fitted: Fitted, log: _Log) -> None:
    """Tell where points agree with their neighbours but not with any model: relief, another viewpoint."""
    spread = shared_residual_px(fitted.table)
    if spread > PARALLAX_PX:
        log.warn(
            f"local displacements of {spread:.1f} px (68 % of the points) remain that the "
            f"{fitted.correction.name} model does not take out: parallax of another viewpoint, relief or "
            "sensor jitter; the corrected raster is off by as much"
        )


def _px_m(target: RasterInfo) -> tuple[float, float] | None:
    rows, cols = target.grid.shape
    return pixel_size_m(target.grid, np.array([cols / 2, rows / 2]))


def _target_px_per_view_px(pair: ViewPair) -> float:
    rows, cols = pair.target.grid.shape
    middle = np.array([[cols / 2, rows / 2]])
    step = pair.target.to_file_px(middle + np.array([[1.0, 0.0]])) - pair.target.to_file_px(middle)
    return float(np.hypot(*step[0]))
