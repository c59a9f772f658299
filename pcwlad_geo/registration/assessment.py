"""A correction fitted to the tie points of a pair, graded with all that is known of these."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.correction.error_statistics import FitAccuracy
from pcwlad_geo.correction.fit import CANDIDATES, LOSSLESS, VRT_MODELS
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.events import EventCallback, JobLog, Progress, ignore
from pcwlad_geo.execution.runner import one_library_thread
from pcwlad_geo.matching.outliers import consistent
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import of_one_product
from pcwlad_geo.raster import (
    RasterInfo,
    RpcGrid,
    ViewPair,
    at_mean_height,
    file_px_per_px,
    pixel_sizes_m,
    plan_views,
)
from pcwlad_geo.raster.grid import pixel_size_m
from pcwlad_geo.raster.rpc.planning import plan_rpc_views
from pcwlad_geo.registration.decision import Decision
from pcwlad_geo.registration.fitting import Fitted, fit_correction, footprint_px
from pcwlad_geo.registration.match_record import MatchRecord, record_ground
from pcwlad_geo.registration.motions import MotionParameters
from pcwlad_geo.registration.quality import FAIR_PX, GOOD_PX, Quality, Reason, assess
from pcwlad_geo.registration.result import Matches, Pair, Registration
from pcwlad_geo.registration.rpc import corrected_rpc, height_errors
from pcwlad_geo.registration.seams import seam_of
from pcwlad_geo.tiepoints.table import TiePointTable, overlap_middle_px, predict_target_px
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class AssessmentParameters:
    """Numbers of the assessment, beside those of the grade."""

    surface_share: float = 1 / 3
    """Least share of the tie points that are a main surface, to which the correction is fitted."""
    bare_share: float = 0.05
    """Share of the common ground that shows nothing and lies beyond the tie points, from which that is
    warned of."""
    bent_share: float = 0.1
    """Share of the common ground that is such and lies more than a pixel off the trend of the tie points,
    from which a registration is fair at most."""


@one_library_thread()
def fit_pair(
    matches: Matches,
    settings: Settings | None = None,
    *,
    on_event: EventCallback = ignore,
    parameters: AssessmentParameters = AssessmentParameters(),
) -> Registration:
    """Fit a correction to tie points that were accepted, grade it, and conclude: registered, or rejected.

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
        candidates = CANDIDATES
        if settings.of.upper() == "VRT":
            candidates = tuple(name for name in CANDIDATES if name in VRT_MODELS)
        candidates = tuple(LOSSLESS) if matches.pair.rpc else candidates
        sizes_m = pixel_sizes_m(at_mean_height(target.grid), table.predicted_px)
        smooth = _of_the_main_surface(matches, footprint, parameters)
        shape, frames = target.grid.shape, not matches.pair.georeferenced
        fitted = fit_correction(
            table, settings, footprint, sizes_m, shape, candidates, smooth, frames, matches.roles
        )
        places, bare = _counted_px(matches, fitted.selection, log, parameters)
        whole = _whole_px(matches.pair)
        of_all = _fitted_to_all(matches, fitted, settings, footprint)
        quality = assess(
            fitted.table,
            matches.every,
            fitted.selection,
            places,
            footprint,
            matches.jitter_px,
            matches.bend_px,
            whole,
            of_all,
        )
        quality = _with_seam(quality, fitted, places, footprint)
        quality = _with_bends(quality, fitted, bare, len(places), parameters)
        for doubt in matches.decision.doubts:
            quality = doubt.applied_to(quality, float(file_px_per_px(matches.views.target).max()))
        if sizes_m is not None and of_one_product(matches.pair.reference.uri, target.uri):
            quality = _with_prior(quality, table[table.status == "matched"], float(sizes_m.max()))
        heights = height_errors(
            matches.pair.reference.grid, target.grid, fitted.table.select("fit", "check", "unused")
        )
        if heights and quality.grade != "good":
            quality = replace(quality, reasons=(Reason(quality.grade, heights), *quality.reasons))
        log.on_event(Progress("fitting", 1, 1))
    decision = replace(matches.decision, quality=quality)
    decision = decision.refused(None if settings.tie_points else quality.refusal)
    for reason in quality.reasons if decision.accepted else ():
        if reason.text not in log.warnings:
            log.warn(reason.text)
    return _concluded(matches, fitted, decision, settings, log)


def _fitted_to_all(
    matches: Matches, fitted: Fitted, settings: Settings, footprint_px: float
) -> Selection | None:
    """Return the same model fitted to all matches, where some points of a file were left out."""
    if matches.origin is None or not matches.origin.left_out:
        return None
    model, auto = (fitted.selection.name,), replace(settings, model="auto")
    shape = matches.pair.target.grid.shape
    with suppress(InputError):  # all of them may fold the image
        return fit_correction(matches.every, auto, footprint_px, None, shape, model).selection
    return None


def _concluded(
    matches: Matches, fitted: Fitted, decision: Decision, settings: Settings, log: JobLog
) -> Registration:
    """Return a pair with the correction fitted, or if that is refused with what tells of it alone."""
    registration = replace(
        conclude(matches, fitted.correction if decision.accepted else None),
        decision=decision,
        warnings=tuple(log.warnings),
        settings=settings,
        seconds=log.seconds,
        selection=fitted.selection,
    )
    if not decision.accepted:
        return registration
    return replace(registration, tie_points=fitted.table, accuracy=fitted.accuracy)


def conclude(matches: Matches, correction: Correction | None = None) -> Registration:
    """Return what is known of a pair: with a correction, or matched only, or rejected with a reason."""
    pair = matches.pair
    grid = at_mean_height(pair.target.grid)
    return Registration(
        decision=matches.decision,
        warnings=matches.warnings,
        reference=pair.reference,
        target=pair.target,
        matching_grid=matches.views.reference.grid,
        px_m=pixel_size_m(grid, overlap_middle_px(matches.views, pair.target)),
        prealignment=matches.prealignment,
        tie_points=matches.tie_points,
        model=correction,
        accuracy=FitAccuracy(),
        counts=matches.counts,
        seconds=matches.seconds,
        settings=pair.settings,
        geometry=matches.geometry,
        motions=matches.motions,
        jitter_px=matches.jitter_px,
        bend_px=matches.bend_px,
        record=matches.record,
        rpc=corrected_rpc(pair.rpc, correction) if pair.rpc else None,
        inputs=pair.inputs,
        window_px=matches.window_px if matches.origin is None else matches.origin.window_px,
        origin=matches.origin,
    )


def _with_seam(quality: Quality, fitted: Fitted, places_px: Float64, footprint_px: float) -> Quality:
    """Return the quality of a correction that goes smoothly over a seam of the target, if there is one."""
    points = fitted.table.select("fit", "check", "unused")
    seam = seam_of(points, footprint_px)
    if seam is None:
        return quality
    at_px = places_px if len(places_px) else points.predicted_px
    expected_px = float(np.hypot(quality.expected_ce90_px, seam.off_px(fitted.correction, at_px)))
    return replace(quality.at_most("fair", seam.text(at_px, footprint_px)), expected_ce90_px=expected_px)


def _with_bends(
    quality: Quality, fitted: Fitted, bare_px: Float64, places: int, parameters: AssessmentParameters
) -> Quality:
    """Return the quality of a correction that bends on bare ground, beyond the tie points.

    What is counted has `places`. The (n, 2) `bare_px` are not, as nothing can be matched there. A correction
    that continues the affine trend of its points does no harm there. One that goes on to bend moves it.
    """
    points_px = fitted.table.select("fit", "check", "unused").predicted_px
    if len(bare_px) == 0 or len(points_px) < 3:
        return quality
    trend = AffineTransform.fit(points_px, fitted.correction.forward(points_px))
    off_px = np.hypot(*(fitted.correction.forward(bare_px) - trend(bare_px)).T)
    share = np.count_nonzero(off_px > FAIR_PX) / (len(bare_px) + places)
    if share <= parameters.bent_share:
        return quality
    return quality.at_most(
        "fair",
        f"the {fitted.selection.name} correction bends beyond the tie points: {100 * share:.0f} % of the "
        f"common ground shows nothing that could be matched, and lies up to {off_px.max():.0f} px off the "
        "affine trend of the points. Choose --model affine if that ground matters",
    )


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


def _of_the_main_surface(
    matches: Matches, footprint_px: float, parameters: AssessmentParameters
) -> Bool | None:
    """Return the (n,) mask of the rows that agree with a smooth displacement, which a correction can follow.

    None where all do, and where hardly any do. The others, right but of another depth, are in no fit.
    """
    if matches.geometry.name != "epipolar":
        return None
    table = matches.tie_points
    unit_px = float(file_px_per_px(matches.views.target).max())
    smooth = np.asarray(table.status == "matched")
    least = parameters.surface_share * np.count_nonzero(smooth)
    for _ in range(2):
        index = np.flatnonzero(smooth)
        smooth[index] = consistent(
            table.predicted_px[index] / unit_px,
            table.displacement_px[index] / unit_px,
            np.zeros(len(index)),  # their sigmas hold the other depths
            round(footprint_px / unit_px),
        )
    return smooth if np.count_nonzero(smooth) >= least else None


def _counted_px(
    matches: Matches, selection: Selection, log: JobLog, parameters: AssessmentParameters
) -> tuple[Float64, Float64]:
    """Return (n, 2) and (m, 2) target px of the common ground: what counts, and the bare beyond the points.

    Bare ground is such as water. Nothing can be matched there, and hardly anything seen. Ground that has
    structure in either band counts.
    """
    with_structure, bare = (
        _common_px(matches.record, matches.views, matches.pair.target, bare=is_bare)
        for is_bare in (False, True)
    )
    beyond = selection.extrapolated(bare) if len(bare) else np.zeros(0, bool)
    share = beyond.sum() / max(len(with_structure) + len(bare), 1)
    if share > parameters.bare_share or (share and not len(with_structure)):
        log.warn(
            f"{100 * share:.0f} % of the common ground shows nothing that could be matched, such as water, "
            "and lies beyond the tie points: the grade and the expected error are of the rest"
        )
    return np.concatenate([with_structure, bare[~beyond]]), bare[beyond]


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
