"""The job, up to its result: pre-align, plan tiles, match, merge, fit, judge. Writes nothing."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.fit import CANDIDATES
from pcwlad_geo.correction.thinning import thin
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.antimeridian import moved_beside
from pcwlad_geo.raster.geodesy import pixel_size_m, pixel_sizes_m
from pcwlad_geo.raster.identity import digest
from pcwlad_geo.raster.locate import locate, overlap_middle_px, predict_target_px
from pcwlad_geo.raster.matching_grid import ViewPair, plan_views
from pcwlad_geo.raster.rpc_grid import levelled
from pcwlad_geo.raster.rpc_view import Placed, plan_rpc_views
from pcwlad_geo.raster.shared_plane import share_plane
from pcwlad_geo.raster.source import RasterInfo, describe, same_band
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.raster.trust import trusting
from pcwlad_geo.raster.view import file_px_per_px
from pcwlad_geo.registration.advice import refusal
from pcwlad_geo.registration.fitting import Fitted, fit_correction
from pcwlad_geo.registration.given_points import footprint_px, points_of_file
from pcwlad_geo.registration.inputs import identify_inputs, resolve
from pcwlad_geo.registration.job_log import JobLog
from pcwlad_geo.registration.judge import Verdict
from pcwlad_geo.registration.kernels import load_kernels
from pcwlad_geo.registration.match_record import MatchRecord, record_ground
from pcwlad_geo.registration.planning import count_tiles
from pcwlad_geo.registration.prealign import Look, by_georeferencing, by_search, look_at
from pcwlad_geo.registration.progress import EventCallback, Progress, ignore
from pcwlad_geo.registration.quality import Quality, assess
from pcwlad_geo.registration.result import Prealignment, Registration
from pcwlad_geo.registration.rpc_target import (
    MODELS,
    check_start,
    corrected_rpc,
    place_reference,
    place_target,
    shifted,
)
from pcwlad_geo.registration.scene import Matched, match_scene
from pcwlad_geo.registration.settings import VRT_MODELS, Settings
from pcwlad_geo.registration.tasks import InThisProcess, Runner

COMMON_STEP = 3
"""One of so many places of the common ground is asked what error is expected there."""
MOST_REFERENCE_MISFIT_PX = 0.05
"""Of ground control points."""
NEARER = 2
"""Times that a target with RPC is matched again,"""
NEAR_PX = 0.5
"""as long as it lies farther than this from where it was taken to be, target px."""

Float64 = NDArray[np.float64]
PathLike = str | os.PathLike[str]


def run(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    *,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
    match_only: bool = False,
) -> Registration:
    """Register the target to the reference, or only match them.

    Parameters
    ----------
    reference, target : path
        Rasters, or products (see `inputs.resolve`).
    settings : Settings
    on_event : callable
        Receives progress and warnings; an exception that it raises ends the job.
    runner : Runner, optional
        Runs the tiles; None: this process.
    match_only : bool
        Stop at the tie points.

    Raises
    ------
    InputError
        If the input cannot be used.
    """
    with trusting(settings.trust):
        return _run(reference, target, settings, JobLog(on_event), runner or InThisProcess(), match_only)


def _run(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    log: JobLog,
    runner: Runner,
    match_only: bool,
) -> Registration:
    with log.stage("reading"):
        inputs = resolve(reference, target, settings, all_bands=not match_only)
        settings = inputs.settings
        files = identify_inputs(inputs)  # before any of them is read
        ref = describe(inputs.reference, band=int(settings.ref_band), mask=settings.ref_mask)
        tgt = describe(inputs.target, band=int(settings.tgt_band), mask=settings.tgt_mask)
        content = digest(file.identity for file in files)
        ref, tgt = replace(ref, content=content), replace(tgt, content=content)
        placed_reference, told = place_reference(ref, tgt, settings)
        ref = placed_reference.info if placed_reference else ref
        placed, warnings = place_target(ref, tgt, settings)
        if placed:
            tgt = placed.info
        elif not placed_reference:
            ref, tgt, shared = share_plane(moved_beside(ref, tgt), tgt)
            warnings = (*warnings, *shared)
        for warning in (*inputs.notes, *_control_point_notes(ref, tgt), *told, *warnings):
            log.warn(warning)
        pair = plan_rpc_views(ref, tgt) if placed or placed_reference else plan_views(ref, tgt)
        for warning in pair.warnings:
            log.warn(warning)
        if same_band(ref, tgt):
            log.warn(
                "reference and target are the same file and band: the displacement is zero by construction"
            )
    found, pair = (
        (_from_file(pair, settings.tie_points, log), pair)
        if settings.tie_points
        else _by_matching(pair, placed, settings, log, runner)
    )
    every, found = found.table, _only_wanted(found, settings)
    table = found.table
    px_m = pixel_size_m(levelled(tgt.grid), overlap_middle_px(pair, tgt))
    verdict = found.verdict
    fitted: Fitted | None = None
    quality: Quality | None = None
    if verdict.accepted and not match_only:
        with log.stage("fitting"):
            log.on_event(Progress("fitting", 0, 1))
            footprint = settings.window * float(file_px_per_px(pair.target)[0])
            if settings.tie_points:
                footprint = footprint_px(every, footprint)
            candidates = MODELS if placed else VRT_MODELS if settings.of.upper() == "VRT" else CANDIDATES
            sizes_m = pixel_sizes_m(levelled(tgt.grid), table.predicted_px)
            fitted = fit_correction(table, settings, footprint, sizes_m, tgt.grid.shape, candidates)
            places = _common_px(found.record, pair, tgt)
            quality = assess(fitted.table, every, fitted.selection, places, footprint)
            log.on_event(Progress("fitting", 1, 1))
        if quality.refusal and not settings.tie_points:
            verdict = replace(verdict, accepted=False, reason=quality.refusal)
            fitted = None
        else:
            for reason in quality.reasons:
                log.warn(reason.text)
    status = "rejected" if not verdict.accepted else "matched" if match_only else "registered"
    return Registration(
        status=status,  # type: ignore[arg-type]  # one of three literals
        reason=verdict.reason if quality else _reason(verdict, placed),
        warnings=tuple(log.warnings),
        reference=ref,
        target=tgt,
        matching_grid=pair.reference.grid,
        px_m=px_m,
        prealignment=found.prealignment,
        tie_points=fitted.table if fitted else table,
        correction=fitted.correction if fitted else None,
        accuracy=fitted.accuracy if fitted else {},
        counts=found.counts,
        seconds=log.seconds,
        settings=settings,
        selection=fitted.selection if fitted else None,
        quality=quality,
        record=found.record,
        rpc=corrected_rpc(placed, fitted.correction if fitted else None) if placed else None,
        inputs=files,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Tie points, wherever they come from, before any fit."""

    table: TiePointTable
    verdict: Verdict
    counts: dict[str, int]
    prealignment: Prealignment
    record: MatchRecord | None


def _only_wanted(found: _Found, settings: Settings) -> _Found:
    """Keep as many tie points as the user wants, spread evenly, the most precise of each neighbourhood.

    Here and nowhere else, so that what is fitted, checked, printed and written are the same points.
    """
    if settings.points in (None, "all") or not found.verdict.accepted:
        return found
    table = found.table
    agreeing = np.flatnonzero(table.status == "matched")
    taken = thin(table.predicted_px[agreeing], np.hypot(*table.sigma_px[agreeing].T), int(settings.points))
    surplus = agreeing[~taken]
    counts = {**found.counts, "thinned": len(surplus), "tie_points": int(taken.sum())}
    record = found.record
    if record is not None:
        record = replace(record, thinned_px=table.reference_px[surplus])
    kept = np.ones(len(table), dtype=bool)
    kept[surplus] = False
    return replace(found, table=table[kept], counts=counts, record=record)


def _reason(verdict: Verdict, placed: Placed | None) -> str | None:
    """Return why a pair was rejected; an RPC of another image puts a target on other ground."""
    if verdict.reason is None or placed is None:
        return verdict.reason
    return (
        f"{verdict.reason}; check also that the RPC in {placed.source.origin} belongs to the target as it "
        "is, not to an image that it was cropped or decimated from"
    )


def _from_file(pair: ViewPair, path: Path | str, log: JobLog) -> _Found:
    with log.stage("reading"):
        table, verdict, counts = points_of_file(path, pair)
        record = record_ground(pair)
    return _Found(table, verdict, counts, Prealignment("tie points of a file", (0.0, 0.0), 0), record)


def _by_matching(
    pair: ViewPair, placed: Placed | None, settings: Settings, log: JobLog, runner: Runner
) -> tuple[_Found, ViewPair]:
    """Return the tie points, and the views that they were found on."""
    with log.stage("reading"):
        runner.expect(count_tiles(pair, settings))
        if runner.shares_kernels:
            load_kernels(settings.method, runner, log.on_event)
        log.on_event(Progress("reading", 0, 1))
        look = look_at(pair)
        log.on_event(Progress("reading", 1, 1))
    matched = _match(pair, look, settings, log, runner)
    original = pair.target.info
    if placed and matched.verdict.accepted:
        check_start(placed, matched.prealignment, pair.reference.grid, settings)
        matched, pair = _match_from_nearer(matched, pair, settings, log, runner)
    table = _table(matched, pair, original)
    found = _Found(table, matched.verdict, matched.counts, matched.prealignment, matched.record)
    return found, pair


def _match(pair: ViewPair, look: Look, settings: Settings, log: JobLog, runner: Runner) -> Matched:
    """Match from the best start known; where that fails and the user left it open, from a search."""
    starts = _starts(pair, look, settings, log)
    result: Matched | None = None
    searched = False
    for prealignment in starts:
        searched |= prealignment is None or prealignment.method == "search"
        if prealignment is None:
            continue
        prealignment = replace(prealignment, searched=searched)
        result = match_scene(pair, look, prealignment, settings, log, runner)
        if result.verdict.accepted:
            if prealignment.method == "search" and pair.georeferenced:
                col, row = prealignment.shift_px
                log.warn(
                    f"the georeferencing is off by about ({col:.0f}, {row:.0f}) px (col, row; of the "
                    "coarser raster): found by a search"
                )
            return result
    if result is None:
        raise InputError("no start for the matching: give --prealign auto")
    start = replace(result.prealignment, searched=searched)
    reason = refusal(result.verdict, start)
    return replace(result, prealignment=start, verdict=replace(result.verdict, reason=reason))


def _starts(pair: ViewPair, look: Look, settings: Settings, log: JobLog) -> Iterator[Prealignment | None]:
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


def _match_from_nearer(
    matched: Matched, pair: ViewPair, settings: Settings, log: JobLog, runner: Runner
) -> tuple[Matched, ViewPair]:
    """Match a target with RPC again, as the shift found so far places it.

    Where the RPC errs, the image is seen with the height of the ground beside: relief distorts the windows by
    the more, the larger the error is.
    """
    for _ in range(NEARER):
        table = _table(matched, pair, pair.target.info)
        shift_px = np.median(table.select("matched").displacement_px, axis=0)
        if np.hypot(*shift_px) < NEAR_PX:
            break
        target = shifted(pair.target.info, shift_px)
        nearer = plan_rpc_views(pair.reference.info, target)
        again = match_scene(
            nearer, look_at(nearer), by_georeferencing(settings.search_radius), settings, log, runner
        )
        if not again.verdict.accepted:
            break
        matched, pair = replace(again, prealignment=matched.prealignment), nearer
    return matched, pair


def _table(matched: Matched, pair: ViewPair, original: RasterInfo) -> TiePointTable:
    table = locate(matched.matches, pair, original)
    return replace(table, status=np.where(matched.kept, "matched", "rejected"))


def _common_px(record: MatchRecord | None, pair: ViewPair, target: RasterInfo) -> Float64:
    """Return (n, 2) target px that the original georeferencing predicts for the ground in common."""
    if record is None:
        return np.empty((0, 2))
    original = replace(pair, target=replace(pair.target, info=target))
    reference = pair.reference.info.grid.shape
    predicted = predict_target_px(record.common_px(reference)[::COMMON_STEP], original)
    return predicted[np.isfinite(predicted).all(axis=1)]


def _control_point_notes(reference: RasterInfo, target: RasterInfo) -> list[str]:
    """Tell how well control points are fitted by a geotransform; the reference's must be."""
    off_px = reference.gcp_misfit_px
    if off_px is not None and off_px > MOST_REFERENCE_MISFIT_PX:
        raise InputError(
            f"{reference.uri} is georeferenced by ground control points that no geotransform fits (off by "
            f"up to {off_px:.2f} px): a reference must be on a map grid; warp it first (gdalwarp -tps)"
        )
    off_px = target.gcp_misfit_px
    if off_px is None or off_px <= MOST_REFERENCE_MISFIT_PX:
        return []
    return [
        f"{target.uri} is georeferenced by ground control points: displacements count from the geotransform "
        f"that fits them best, which is off by up to {off_px:.1f} px; if that is much, raise --search-radius"
    ]
