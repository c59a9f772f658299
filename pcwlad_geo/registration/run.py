"""The job, up to its result: open a pair, match it, fit a correction, conclude. Writes nothing."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.error_statistics import Proof
from pcwlad_geo.correction.fit import CANDIDATES, LOSSLESS, VRT_MODELS
from pcwlad_geo.correction.points import thin
from pcwlad_geo.correction.selection import COMMON_SIGMA, Selection
from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.events import EventCallback, JobLog, Progress, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner, one_library_thread
from pcwlad_geo.matching.clusters import contradicted_clusters
from pcwlad_geo.matching.outliers import consistent
from pcwlad_geo.matching.types import FIRST_WINDOW_PX, TiePoints
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import of_one_product
from pcwlad_geo.raster.band_pixels import BandPixels
from pcwlad_geo.raster.bands import Bands
from pcwlad_geo.raster.cameras import expected_scale
from pcwlad_geo.raster.compression import with_compression_blocks
from pcwlad_geo.raster.fill import without_shared_fill
from pcwlad_geo.raster.grid import pixel_size_m, pixel_sizes_m
from pcwlad_geo.raster.identity import digest
from pcwlad_geo.raster.matching_grid import (
    ONLY_PIXELS,
    ViewPair,
    limited,
    limited_to_overlap,
    plan_views,
    share_plane,
)
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height
from pcwlad_geo.raster.rpc.ortho import plan_rpc_views
from pcwlad_geo.raster.source import RasterInfo, describe, same_band, with_areas
from pcwlad_geo.raster.trust.permissions import trusting
from pcwlad_geo.raster.undeclared import without_undeclared
from pcwlad_geo.raster.view import file_px_per_px, with_bands
from pcwlad_geo.registration.edge_sides import error_of_sides_px
from pcwlad_geo.registration.fitting import AssessedFit, Fitted, fit_correction, footprint_px
from pcwlad_geo.registration.frame_evidence import frame_evidence
from pcwlad_geo.registration.inputs import identify_inputs, resolve
from pcwlad_geo.registration.motions import MotionParameters, describe_motions
from pcwlad_geo.registration.point_file import UNKNOWN_ORIGIN, user_points
from pcwlad_geo.registration.positions import PositionConflict, position_conflict
from pcwlad_geo.registration.prealign import RADIUS_PX, Prealignment, StartingAlignment, read_overviews
from pcwlad_geo.registration.quality import FAIR_PX, GOOD_PX, Quality, Reason, assess
from pcwlad_geo.registration.result import (
    Matches,
    MatchRecord,
    Pair,
    PairGeometry,
    Registration,
    RegistrationStatus,
    record_ground,
)
from pcwlad_geo.registration.rpc import (
    check_start,
    corrected_rpc,
    height_errors,
    place_reference,
    place_target,
)
from pcwlad_geo.registration.scene import (
    located,
    match_again_from_shifted_rpc,
    match_from_best_start,
    match_scene,
)
from pcwlad_geo.registration.seams import seam_of
from pcwlad_geo.registration.tiles import forget_tiles
from pcwlad_geo.text import joined
from pcwlad_geo.tiepoints.table import TiePointTable, overlap_middle_px, predict_target_px
from pcwlad_geo.types import Bool, Float64, PathLike

LEAST_OF_A_SURFACE = 1 / 3
"""Least share of the tie points that are a main surface, to which the correction is fitted."""
MIN_PARALLAX = 2.0
"""Least ratio of what is found along the epipolar lines to what is found across, where nothing can be."""
MIN_PARALLAX_PX = 0.5
"""Least parallax that is warned of, RMS, target px."""
BY_POINTS = "only the tie points given tell how the two lie"
"""What is said instead where tie points are given."""
LEAST_TOLD_BARE = 0.05
"""Share of the common ground."""
LEAST_TOLD_JITTER_PX = 0.05
"""RMS, target px."""
MAX_REFERENCE_MISFIT_PX = 0.05
"""Of ground control points."""


def run(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    *,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
    match_only: bool = False,
) -> Registration:
    """Register the target to the reference, or only match them: open, match, fit, conclude.

    Both are rasters, or products (see `inputs.resolve`). The `runner` runs the tiles; None: this process. An
    exception that `on_event` raises ends the job. Raises `InputError` if the input cannot be used.
    """
    with trusting(settings.trust):
        pair = open_pair(reference, target, settings, on_event=on_event, all_bands=not match_only)
        matches = match(pair, runner or InThisProcess(), on_event=on_event)
        if settings.prove != "off" and matches.accepted:
            return _proved(matches, settings, on_event, runner or InThisProcess(), match_only=match_only)
        if match_only or not matches.accepted:
            return conclude(matches)
        return conclude(matches, fit(matches, on_event=on_event))


def _proved(
    matches: Matches, settings: Settings, on_event: EventCallback, runner: Runner, *, match_only: bool
) -> Registration:
    """Conclude with a proof, and with sigmas that hold for what it has seen, if that is asked for.

    A pair that nothing can be proved of, as it has too few points, is concluded with a warning.
    """
    try:
        fitted, proof, seconds = _fit_and_prove(
            matches, "full" if settings.prove == "full" else "quick", on_event, runner
        )
    except InputError as error:
        done = conclude(matches, None if match_only else fit(matches, on_event=ignore))
        log = JobLog(on_event, list(done.warnings))
        log.warn(joined(error) + ("; its sigmas are not calibrated" if settings.calibrate_sigma else ""))
        return replace(done, warnings=tuple(log.warnings))
    if settings.calibrate_sigma:
        matches = _with_sigmas(matches, proof.sigma.calibration)
        fitted = fit(matches, on_event=ignore)
    done = conclude(matches, None if match_only else fitted)
    return replace(done, proof=proof, seconds=done.seconds | {"proving": seconds["proving"]})


def _fit_and_prove(
    matches: Matches, effort: Effort, on_event: EventCallback, runner: Runner
) -> tuple[AssessedFit, Proof, dict[str, float]]:
    """Fit the correction and measure the error of the matching; return both and the seconds of the stages."""
    from pcwlad_geo.registration.proof import prove  # slow to load, and rarely asked for

    fitted = fit(matches, on_event=on_event)
    log = JobLog(on_event, list(fitted.warnings), dict(fitted.seconds))
    with log.stage("proving"):
        proof = prove(matches, fitted, effort, log, runner.threads, register=run)
    return fitted, proof, log.seconds


def _with_sigmas(matches: Matches, factor: float) -> Matches:
    """Return tie points whose sigmas are multiplied by a factor."""
    tables = [
        replace(table, covariance_px2=table.covariance_px2 * factor**2)
        for table in (matches.tie_points, matches.every)
    ]
    return replace(matches, tie_points=tables[0], every=tables[1])


def prove_pair(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    effort: Effort,
    *,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
) -> tuple[Registration, Proof]:
    """Register a pair, and measure the error of its matching, see `proof.prove`.

    Raises `InputError` if the input cannot be used, and `RegistrationRejectedError` if the pair cannot be
    matched reliably.
    """
    runner = runner or InThisProcess()
    pair = open_pair(reference, target, settings, on_event=on_event)
    matches = match(pair, runner, on_event=on_event)
    if not matches.accepted:
        raise RegistrationRejectedError(f"nothing can be proved: {matches.reason}", conclude(matches))
    fitted, proof, seconds = _fit_and_prove(matches, effort, on_event, runner)
    return replace(conclude(matches, fitted), seconds=seconds), proof


def open_pair(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    *,
    on_event: EventCallback = ignore,
    all_bands: bool = False,
) -> Pair:
    """Describe two rasters and decide on which pixels they are compared.

    No pixel is read, but for those that tell whether a raster without nodata and mask has a constant border,
    and whether one of 8 bits shows the blocks of lossy compression.
    Raises `InputError` if the input cannot be used, or the two do not overlap.

    Parameters
    ----------
    reference, target : path
        Rasters, or products (see `inputs.resolve`).
    on_event : callable
        Receives warnings.
    all_bands : bool
        The other bands of the target's product are inputs too.
    """
    log = JobLog(on_event)
    with log.stage("reading"):
        inputs = resolve(reference, target, settings, all_bands=all_bands)
        settings = inputs.settings
        files = identify_inputs(inputs)  # before any of them is read
        content = digest(file.identity for file in files)
        ref, ref_said, ref_pixels = _described(inputs.reference, inputs.ref_bands, settings.ref_mask, content)
        tgt, tgt_said, tgt_pixels = _described(inputs.target, inputs.tgt_bands, settings.tgt_mask, content)
        reference_by_rpc, reference_warnings = place_reference(ref, tgt, settings)
        ref = reference_by_rpc.info if reference_by_rpc else ref
        placed, warnings = place_target(ref, tgt, settings)
        if placed:
            tgt = placed.info
        elif not reference_by_rpc:
            ref, tgt, assumed = share_plane(ref, tgt)
            warnings = (*warnings, *assumed)
        ref, tgt, shared = without_shared_fill(ref, tgt, ref_pixels, tgt_pixels)
        ref = with_areas(ref, settings.aoi, settings.exclude)
        notes = (
            *inputs.notes,
            *_camera_notes(ref, tgt),
            *(ref_said + tgt_said + shared),
            *_control_point_notes(ref, tgt),
        )
        for warning in (*notes, *reference_warnings, *warnings):
            log.warn(warning)
        if settings.write_displacement and settings.displacement_unit == "m" and ref.grid.crs is None:
            raise InputError(
                "the reference has no CRS, so that a displacement in metres is not known: leave out "
                "--displacement-unit m, or give the reference a CRS (gdal_edit.py -a_srs)"
            )
        views = plan_rpc_views(ref, tgt) if placed or reference_by_rpc else plan_views(ref, tgt)
        views = limited_to_overlap(limited(views, settings.extent) if settings.extent else views)
        for warning in views.warnings:
            log.warn(warning.replace(ONLY_PIXELS, BY_POINTS) if settings.tie_points else warning)
        if same_band(ref, tgt):
            log.warn(
                "reference and target are the same file and band: the displacement is zero by construction"
            )
    return Pair(
        reference=ref,
        target=tgt,
        views=views,
        settings=settings,
        warnings=tuple(log.warnings),
        inputs=files,
        seconds=log.seconds,
        rpc=placed,
    )


def _described(
    uri: str, bands: Bands, mask: PathLike | None, content: str
) -> tuple[RasterInfo, tuple[str, ...], BandPixels]:
    """Return a raster as the matching takes it, notes of its border and values, and the pixels looked at."""
    pixels = BandPixels(describe(uri, band=bands.first, mask=mask, part=True))
    info, notes = without_undeclared(pixels.info, pixels)
    return replace(with_bands(with_compression_blocks(info), bands), content=content), notes, pixels


@one_library_thread()
def match(pair: Pair, runner: Runner, *, on_event: EventCallback = ignore) -> Matches:
    """Find the tie points of a pair, or read those of the file that its settings name.

    Raises `InputError` if the input cannot be read or holds nothing to match.

    Parameters
    ----------
    runner : Runner
        Runs the tiles.
    on_event : callable
        Receives progress and warnings; an exception that it raises ends the work.
    """
    log = JobLog(on_event, list(pair.warnings), dict(pair.seconds))
    path = pair.settings.tie_points
    try:
        found = (
            _from_file(pair, path, log) if path else _without_clusters(_by_matching(pair, log, runner), log)
        )
        found = _with_frame_evidence(found, log, runner)
    finally:
        forget_tiles()
    conflict = None if path else _position_conflict(found)
    if conflict is not None and conflict.no_overlap:
        found = replace(found, verdict=replace(found.verdict, accepted=False, reason=conflict.text))
    return replace(_only_wanted(found), warnings=tuple(log.warnings), seconds=log.seconds)


def _with_frame_evidence(matches: Matches, log: JobLog, runner: Runner) -> Matches:
    """Refuse or doubt a pair that agrees in what stands still in both frames, unless its ground is found.

    Points of a file are only doubted.
    """
    pair, points = matches.pair, matches.tie_points.select("matched")
    found = None
    if matches.accepted:
        found = frame_evidence(pair.reference, pair.target, points.reference_px, points.target_px)
    if found is None or found.doubt is None:
        return matches
    given = pair.settings.tie_points is not None
    if found.rival_px is not None and not given and pair.reference.grid == pair.target.grid:
        ground = _without_clusters(_by_matching(pair, log, runner, found.rival_px), log)
        if ground.accepted:
            col, row = found.rival_px
            log.warn(
                "what stands still in both frames agrees at no displacement; the ground was found about "
                f"({col:+.0f}, {row:+.0f}) px off, and is matched there"
            )
            return ground
    if found.is_frame and not given:
        return replace(matches, verdict=replace(matches.verdict, accepted=False, reason=found.doubt))
    log.warn(found.doubt)
    return replace(matches, frame_doubt=found.doubt)


def _doubts_of_frames(matches: Matches) -> list[str]:
    conflict = _position_conflict(matches)
    texts = None if conflict is None else conflict.text, matches.frame_doubt
    return [text for text in texts if text is not None]


def _position_conflict(matches: Matches) -> PositionConflict | None:
    points = matches.tie_points.select("matched")
    pair = matches.pair
    if not matches.accepted:
        return None
    return position_conflict(pair.reference, pair.target, points.reference_px, points.target_px)


@one_library_thread()
def fit(
    matches: Matches, settings: Settings | None = None, *, on_event: EventCallback = ignore
) -> AssessedFit:
    """Fit a correction to tie points that were accepted, and grade it.

    Raises `InputError` if the model cannot be fitted to these points.

    Parameters
    ----------
    settings : Settings, optional
        Those of the pair by default; their model counts here.
    on_event : callable
        Receives progress and warnings.
    """
    settings = settings or matches.pair.settings
    log = JobLog(on_event, list(matches.warnings), dict(matches.seconds))
    target, table = matches.pair.target, matches.tie_points
    with log.stage("fitting"):
        log.on_event(Progress("fitting", 0, 1))
        footprint = matches.window_px * float(file_px_per_px(matches.views.target)[0])
        if settings.tie_points:
            footprint = footprint_px(matches.every, footprint)
        candidates = VRT_MODELS if settings.of.upper() == "VRT" else CANDIDATES
        candidates = tuple(LOSSLESS) if matches.pair.rpc else candidates
        sizes_m = pixel_sizes_m(at_mean_height(target.grid), table.predicted_px)
        smooth = _of_the_main_surface(matches, footprint)
        shape, frames = target.grid.shape, not matches.pair.georeferenced
        fitted = fit_correction(
            table, settings, footprint, sizes_m, shape, candidates, smooth, frames, matches.roles
        )
        places = _counted_px(matches, fitted.selection, log)
        whole = _whole_px(matches.pair)
        of_all = None
        if matches.origin is not None and matches.origin.left_out:
            model, auto = (fitted.selection.name,), replace(settings, model="auto")
            with suppress(InputError):  # all of them may fold the image
                of_all = fit_correction(matches.every, auto, footprint, None, shape, model).selection
        quality = assess(
            fitted.table, matches.every, fitted.selection, places, footprint, matches.jitter_px, whole, of_all
        )
        quality = _with_seam(quality, fitted, places, footprint)
        if matches.motions:
            quality = quality.at_most("fair", describe_motions(matches.motions, accepted=True))
        for text in _doubts_of_frames(matches):
            quality = quality.at_most("poor", text)
        for doubt in matches.doubts:
            quality = doubt.applied_to(quality, float(file_px_per_px(matches.views.target).max()))
        if matches.origin is not None and matches.origin.folder is None:
            quality = quality.at_most("fair", UNKNOWN_ORIGIN)
        if sizes_m is not None and of_one_product(matches.pair.reference.uri, target.uri):
            quality = _with_prior(quality, table[table.status == "matched"], float(sizes_m.max()))
        heights = height_errors(
            matches.pair.reference.grid, target.grid, fitted.table.select("fit", "check", "unused")
        )
        if heights and quality.grade != "good":
            quality = replace(quality, reasons=(Reason(quality.grade, heights), *quality.reasons))
        log.on_event(Progress("fitting", 1, 1))
    refusal = None if settings.tie_points else quality.refusal()
    for reason in () if refusal else quality.reasons:
        if reason.text not in log.warnings:
            log.warn(reason.text)
    return AssessedFit(fitted, quality, refusal, settings, tuple(log.warnings), log.seconds)


def _with_seam(quality: Quality, fitted: Fitted, places_px: Float64, footprint_px: float) -> Quality:
    """Return the quality of a correction that goes smoothly over a seam of the target, if there is one."""
    points = fitted.table.select("fit", "check", "unused")
    seam = seam_of(points, footprint_px)
    if seam is None:
        return quality
    at_px = places_px if len(places_px) else points.predicted_px
    expected_px = float(np.hypot(quality.expected_ce90_px, seam.off_px(fitted.correction, at_px)))
    return replace(quality.at_most("fair", seam.text(at_px, footprint_px)), expected_ce90_px=expected_px)


def _with_prior(quality: Quality, points: TiePointTable, size_m: float) -> Quality:
    """Return the quality of bands of one product, which lie within metres of each other, at their points.

    It is poor where anything else speaks against them, and fair otherwise: a band may have been moved.
    """
    off_px = float(np.percentile(np.hypot(*points.displacement_px.T), 90))
    if off_px <= max(GOOD_PX, MotionParameters().product_m / size_m):
        return quality
    return quality.at_most(
        "fair" if off_px <= FAIR_PX or quality.grade == "good" else "poor",
        f"a tenth of the tie points say that bands of one product lie more than {off_px * size_m:.0f} m "
        "apart, which its geometry hardly allows: they may be on clouds, which each band sees elsewhere",
    )


def _of_the_main_surface(matches: Matches, footprint_px: float) -> Bool | None:
    """Return the (n,) mask of the rows that agree with a smooth displacement, which a correction can follow.

    None where all do, and where hardly any do. The others, right but of another depth, are in no fit.
    """
    if matches.geometry.name != "epipolar":
        return None
    table = matches.tie_points
    unit_px = float(file_px_per_px(matches.views.target).max())
    smooth = np.asarray(table.status == "matched")
    least = LEAST_OF_A_SURFACE * np.count_nonzero(smooth)
    for _ in range(2):
        index = np.flatnonzero(smooth)
        smooth[index] = consistent(
            table.predicted_px[index] / unit_px,
            table.displacement_px[index] / unit_px,
            np.zeros(len(index)),  # their sigmas hold the other depths
            round(footprint_px / unit_px),
        )
    return smooth if np.count_nonzero(smooth) >= least else None


def conclude(matches: Matches, fit: AssessedFit | None = None) -> Registration:
    """Judge what was found: registered, rejected with a reason, or matched where nothing was fitted.

    The `fit` is of these tie points.
    """
    pair = matches.pair
    rejected = not matches.accepted or (fit is not None and fit.refusal is not None)
    status: RegistrationStatus = "rejected" if rejected else "registered" if fit else "matched"
    fitted = None if fit is None or rejected else fit.fitted
    correction = fitted.correction if fitted else None
    grid = at_mean_height(pair.target.grid)
    return Registration(
        status=status,
        reason=fit.refusal if fit else matches.reason,
        warnings=fit.warnings if fit else matches.warnings,
        reference=pair.reference,
        target=pair.target,
        matching_grid=matches.views.reference.grid,
        px_m=pixel_size_m(grid, overlap_middle_px(matches.views, pair.target)),
        prealignment=matches.prealignment,
        tie_points=fitted.table if fitted else matches.tie_points,
        correction=correction,
        accuracy=fitted.accuracy if fitted else {},
        counts=matches.counts,
        seconds=fit.seconds if fit else matches.seconds,
        settings=fit.settings if fit else pair.settings,
        selection=fitted.selection if fitted else None,
        geometry=matches.geometry,
        motions=matches.motions,
        jitter_px=matches.jitter_px,
        quality=fit.quality if fit else None,
        record=matches.record,
        rpc=corrected_rpc(pair.rpc, correction) if pair.rpc else None,
        inputs=pair.inputs,
        window_px=matches.window_px if matches.origin is None else matches.origin.window_px,
        origin=matches.origin,
    )


def _without_clusters(found: Matches, log: JobLog) -> Matches:
    """Reject clusters of tie points that contradict what all others predict, each with a warning.

    They stay in the table as rejected, and count for the quality, as the ground may have moved there. A
    user's own points are not asked: who knows better takes the rejected ones back in such a file. Nor are
    those of an epipolar geometry, in which another depth is no contradiction.
    """
    if not found.accepted:
        return found
    if found.geometry.name == "epipolar":
        _warn_of_parallax(found.geometry, log)
        return found
    table = found.tie_points
    agreeing = np.flatnonzero(table.status == "matched")
    unit_px = float(file_px_per_px(found.views.target).max())
    window_px = found.window_px * unit_px
    placed, moved = table.predicted_px[agreeing], table.displacement_px[agreeing]
    clusters = contradicted_clusters(placed, moved, window_px, unit_px)
    if not clusters:
        return found
    status = table.status.copy()
    for cluster in clusters:
        index = agreeing[cluster.index]
        status[index] = "rejected"
        (col, row), (d_col, d_row) = np.median(table.target_px[index], axis=0), cluster.offset_px
        log.warn(
            f"{len(index)} tie points around ({col:.0f}, {row:.0f}) px (col, row) of the target agree among "
            f"themselves and lie ({d_col:+.1f}, {d_row:+.1f}) px off what all others predict: rejected as "
            "wrong matches; if the ground has moved there, or is at another depth, they are right, and the "
            "correction does not hold there"
        )
    rejected = int((status != table.status).sum())
    counts = dict(found.counts)
    counts["inconsistent"] += rejected
    counts["tie_points"] -= rejected
    table = replace(table, status=status)
    return replace(found, tie_points=table, every=table, counts=counts)


def _warn_of_parallax(geometry: PairGeometry, log: JobLog) -> None:
    across, along = geometry.across_px, geometry.along_px
    if across is None or along is None or along < max(MIN_PARALLAX * across, MIN_PARALLAX_PX):
        return
    log.warn(
        f"the displacement holds parallax: {across:.2f} px (RMS) across the epipolar lines, {along:.2f} px "
        "along them beside what one plane gives: the tie points are right at every depth, and one smooth "
        "correction cannot follow them all"
    )


def _only_wanted(found: Matches) -> Matches:
    """Keep as many tie points as the user wants, spread evenly, the most precise of each neighbourhood.

    Here and nowhere else, so that what is fitted, checked, printed and written are the same points.
    """
    wanted, table = found.pair.settings.points, found.tie_points
    if not isinstance(wanted, int) or not found.accepted:
        return found
    thinned = table.status == "matched"
    if found.roles is not None:  # check points are not fitted, and stay
        thinned &= found.roles != "check"
    agreeing = np.flatnonzero(thinned)
    taken = thin(table.predicted_px[agreeing], np.hypot(*table.sigma_px[agreeing].T), int(wanted))
    surplus = agreeing[~taken]
    counts = {**found.counts, "thinned": len(surplus), "tie_points": int(taken.sum())}
    record = found.record
    if record is not None:
        record = replace(record, thinned_px=table.reference_px[surplus])
    kept = np.ones(len(table), dtype=bool)
    kept[surplus] = False
    roles = None if found.roles is None else found.roles[kept]
    return replace(found, tie_points=table[kept], counts=counts, record=record, roles=roles)


def _from_file(pair: Pair, path: Path | str, log: JobLog) -> Matches:
    with log.stage("reading"):
        given = user_points(path, pair.views)
        record = record_ground(pair.views)
    origin = given.origin
    if origin.left_out:
        log.warn(
            f"{origin.left_out} points that the matching had kept are left out of {path}: residuals of the "
            "fit are those of chosen points; the check points are still all that were held out before"
        )
    return Matches(
        pair=pair,
        tie_points=given.table,
        verdict=given.verdict,
        counts=given.counts,
        prealignment=Prealignment("tie points of a file", (0.0, 0.0), 0),
        record=record,
        views=pair.views,
        every=given.every,
        window_px=origin.window_px or pair.settings.window or FIRST_WINDOW_PX,
        motions=given.motions,
        jitter_px=given.jitter_px,
        origin=origin,
        roles=given.roles,
    )


def _by_matching(
    pair: Pair, log: JobLog, runner: Runner, around_px: tuple[float, float] | None = None
) -> Matches:
    """Match a pair from the best start, or of frames around a displacement, but for none at all."""
    settings, views = pair.settings, pair.views
    with log.stage("reading"):
        log.on_event(Progress("reading", 0, 1))
        overviews = read_overviews(views)
        log.on_event(Progress("reading", 1, 1))
    if around_px is None:
        matched, views = match_from_best_start(views, overviews, settings, log, runner)
    else:
        radius_px = min(RADIUS_PX, max(2, round(np.abs(around_px).max()) - 3))
        start = StartingAlignment(Prealignment("search", around_px, radius_px, True), views, overviews)
        matched = match_scene(start, settings, log, runner)
    if pair.rpc and matched.verdict.accepted:
        check_start(pair.rpc, matched.prealignment, views.reference.grid, settings)
        matched, views = match_again_from_shifted_rpc(matched, views, settings, log, runner)
    table = located(matched, views, (pair.views.reference.info, pair.target))
    geometry = PairGeometry.of(table, matched.epipolar and matched.verdict.accepted)
    several = len(matched.motions) > 1
    motions = tuple(motion for motion, _ in matched.motions) if several else tuple(matched.patches)
    if motions and matched.verdict.accepted:
        log.warn(describe_motions(motions, accepted=True))
    for doubt in matched.doubts:
        log.warn(doubt.text)
    if matched.verdict.accepted and geometry.name == "planar":
        table = _with_error_of_sides(table, matched.matches[matched.kept], views, log)
    jitter_px = matched.jitter_px * float(file_px_per_px(views.target).max())
    if jitter_px >= LEAST_TOLD_JITTER_PX:
        log.warn(
            f"rows or columns move against each other by {jitter_px:.2f} px (RMS) within a matching window: "
            "tie points are means over it; resampling by nearest neighbour does that, by steps of up to half "
            "a pixel, and a line scanner that shakes (jitter), which a smaller --window with --model jitter "
            "may follow"
        )
    return Matches(
        pair=pair,
        tie_points=table,
        verdict=matched.verdict,
        counts=matched.counts,
        prealignment=matched.prealignment,
        record=matched.record,
        views=views,
        every=table,
        window_px=matched.window_px,
        geometry=geometry,
        motions=motions,
        jitter_px=jitter_px,
        job=matched.job,
        scales=matched.scales,
        doubts=matched.doubts if matched.verdict.accepted else (),
    )


def _with_error_of_sides(
    table: TiePointTable, points: TiePoints, views: ViewPair, log: JobLog
) -> TiePointTable:
    """Return tie points whose sigmas hold the error that they share where edges differ by side."""
    error_px = error_of_sides_px(views, points) * file_px_per_px(views.target)
    if not error_px.any():
        return table
    log.warn(
        f"rising and falling edges lie ({2 * error_px[0]:.1f}, {2 * error_px[1]:.1f}) px (col, row) apart, "
        "as where one image shows heights, or other shadows: the tie points are means of the two, and share "
        "an error of half of that, which no residual shows and their sigmas hold"
    )
    shared_px2 = np.diag((error_px / COMMON_SIGMA) ** 2)
    return replace(table, covariance_px2=table.covariance_px2 + shared_px2)


def _counted_px(matches: Matches, selection: Selection, log: JobLog) -> Float64:
    """Return (n, 2) target px of the common ground, without what is bare beyond the tie points, as water is.

    Nothing can be matched there, and hardly anything seen. Ground that has structure in either band counts.
    """
    with_structure, bare = (
        _common_px(matches.record, matches.views, matches.pair.target, bare=is_bare)
        for is_bare in (False, True)
    )
    beyond = selection.extrapolated(bare) if len(bare) else np.zeros(0, bool)
    share = beyond.sum() / max(len(with_structure) + len(bare), 1)
    if share > LEAST_TOLD_BARE or (share and not len(with_structure)):
        log.warn(
            f"{100 * share:.0f} % of the common ground shows nothing that could be matched, such as water, "
            "and lies beyond the tie points: the grade and the expected error are of the rest"
        )
    return np.concatenate([with_structure, bare[~beyond]])


def _common_px(record: MatchRecord | None, pair: ViewPair, target: RasterInfo, *, bare: bool) -> Float64:
    """Return (n, 2) target px that the georeferencing predicts for the ground in common."""
    if record is None:
        return np.empty((0, 2))
    return _predicted_px(record.common_px(pair.reference.info.grid.shape, bare=bare)[::3], pair, target)


def _predicted_px(reference_px: Float64, pair: ViewPair, target: RasterInfo) -> Float64:
    """Return (k, 2) target px that the original georeferencing predicts for (n, 2) ones of the reference."""
    predicted = predict_target_px(reference_px, replace(pair, target=replace(pair.target, info=target)))
    return predicted[np.isfinite(predicted).all(axis=1)]


def _whole_px(pair: Pair) -> Float64 | None:
    """Return the places of all ground that both show; None where nothing leaves out a part, or not known.

    Masks of a product tell what is no ground; one of zeros may be an area of interest, beyond which the
    correction is applied too. Beyond an extent nothing is read: there all places of both rasters count.
    """
    infos = pair.reference, pair.target
    masked = [
        info.areas is not None or (info.mask_uri is not None and info.mask_kind == "zeros") for info in infos
    ]
    if pair.settings.extent is None and not any(masked):
        return None
    ref, tgt = (
        replace(info, mask_uri=None, areas=None) if is_masked else info
        for info, is_masked in zip(infos, masked, strict=True)
    )
    by_rpc = isinstance(ref.grid, RpcGrid) or isinstance(tgt.grid, RpcGrid)
    views = plan_rpc_views(ref, tgt) if by_rpc else plan_views(ref, tgt)
    if pair.settings.extent is None:
        places = _common_px(record_ground(views), views, pair.target, bare=False)
    else:
        (rows, cols), size = ref.grid.shape, np.array(tgt.grid.shape[::-1])
        lattice = np.meshgrid(*(np.linspace(0.5, n - 0.5, 64) for n in (cols, rows)))
        places = _predicted_px(np.stack(lattice, axis=-1).reshape(-1, 2), views, pair.target)
        places = places[((places >= 0) & (places <= size)).all(axis=1)]
    return places if len(places) else None


def _camera_notes(reference: RasterInfo, target: RasterInfo) -> list[str]:
    """Tell what scale the cameras' data make expect of two frames, or why they are ignored."""
    _, note = expected_scale(reference.camera, target.camera)
    return [] if note is None or reference.georeferenced or target.georeferenced else [note]


def _control_point_notes(reference: RasterInfo, target: RasterInfo) -> list[str]:
    """Tell how well control points are fitted by a geotransform; the reference's must be."""
    off_px = reference.gcp_misfit_px
    if off_px is not None and off_px > MAX_REFERENCE_MISFIT_PX:
        raise InputError(
            f"{reference.uri} is georeferenced by ground control points that no geotransform fits (off by "
            f"up to {off_px:.2f} px): a reference must be on a map grid; warp it first (gdalwarp -tps)"
        )
    off_px = target.gcp_misfit_px
    if off_px is None or off_px <= MAX_REFERENCE_MISFIT_PX:
        return []
    return [
        f"{target.uri} is georeferenced by ground control points: displacements count from the geotransform "
        f"that fits them best, which is off by up to {off_px:.1f} px; if that is much, raise --search-radius"
    ]
