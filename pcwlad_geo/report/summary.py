"""The numbers of a registration as they stand in report.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pcwlad_geo.correction.error_statistics import Accuracy, FloatPair
from pcwlad_geo.correction.jitter import JITTER, peaks, profile, without_trend
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Dem, Grid, RasterInfo, RpcGrid
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.raster.source import bands_of
from pcwlad_geo.registration import Registration, RpcRegistration
from pcwlad_geo.report.content import (
    SCHEMA_VERSION,
    AxisSummary,
    CandidateEntry,
    CoverageEntry,
    GridEntry,
    GroupStatistics,
    ModelEntry,
    PredictedSigma,
    ProfilesEntry,
    QualityEntry,
    RasterEntry,
    ReferenceEntry,
    Report,
    RequirementEntry,
    RpcEntry,
    StatisticsEntry,
)
from pcwlad_geo.report.json_content import (
    M_DIGITS,
    PX_DIGITS,
    SECONDS_DIGITS,
    SHARE_DIGITS,
    filled,
    rounded,
    versions,
)
from pcwlad_geo.report.statistics import (
    KEPT,
    STATUSES,
    PointGroup,
    PrecisionMap,
    When,
    coverage_of,
    heights_m,
    native_size_m,
    precision_of,
    statistics_of,
    target_px_m,
)
from pcwlad_geo.types import Float64


def summarise(
    registration: Registration,
    outputs: Sequence[str],
    precision: PrecisionMap | None = None,
    output_grid: Grid | None = None,
) -> Report:
    """Return the content of `report.json`.

    The `outputs` are names of the files in the output folder; the predicted sigma `precision` is given if it
    is already computed, and the grid of the registered raster if there is one.
    """
    points = registration.tie_points.select(*KEPT)
    rpc = registration.rpc
    return filled(
        Report,
        registration,
        schema_version=SCHEMA_VERSION,
        requirements=tuple(
            filled(RequirementEntry, result, text=result.requirement.text, message=result.text)
            for result in registration.requirements
        ),
        reference=reference_entry(registration.reference),
        target=raster_entry(registration.target),
        output_grid=_grid(output_grid) if output_grid else None,
        tie_points=_tie_point_counts(registration),
        displacement_px=_statistics(points.displacement_px, PX_DIGITS),
        displacement_m=_statistics(points.displacement_m, M_DIGITS),
        rpc=_rpc(rpc, registration.settings) if rpc else None,
        model=_model(registration, precision or precision_of(registration)),
        accuracy={"fit": _accuracy(registration, "fit"), "check": _accuracy(registration, "check")},
        quality=_quality(registration),
        statistics=error_statistics(registration),
        profiles=_profiles(registration),
        coverage=_coverage(registration),
        seconds=rounded(registration.seconds, SECONDS_DIGITS),
        versions=versions(),
        proof=rounded(registration.proof, PX_DIGITS),
        outputs=tuple(outputs),
    )


def error_statistics(registration: Registration) -> StatisticsEntry:
    """Return the statistics of displacements (before) and residuals (after) of all, fit and check points."""
    sizes_m = target_px_m(registration)

    def groups(when: When) -> dict[PointGroup, GroupStatistics | None]:
        return {group: _group(registration, when, group, sizes_m) for group in STATUSES}

    native_m = native_size_m(registration.reference, registration.target)
    return StatisticsEntry(native_m, groups("before"), groups("after"))


def _group(
    registration: Registration, when: When, group: PointGroup, sizes_m: Float64 | None
) -> GroupStatistics | None:
    statistics = statistics_of(registration, when, group, sizes_m)
    px, native_px, m = (statistics[unit] for unit in ("px", "native_px", "m"))
    if px is None:
        return None
    return rounded(GroupStatistics(px.n, px.of_unit, native_px and native_px.of_unit, m and m.of_unit))


def _grid(grid: Grid) -> GridEntry:
    a, b, col_off, d, e, row_off = (float(value) for value in grid.transform[:6])
    crs = grid.crs.to_string() if grid.crs and not isinstance(grid, RpcGrid) else None
    return GridEntry(grid.shape, (a, b, col_off, d, e, row_off), crs, swath=grid.swath_uri)


def reference_entry(info: RasterInfo) -> ReferenceEntry:
    """Return the reference; with an RPC, also the grid onto which it is orthorectified."""
    ground = _grid(ground_grid(info.grid)) if isinstance(info.grid, RpcGrid) else None
    return filled(ReferenceEntry, raster_entry(info), ground=ground, basemap=info.basemap)


def raster_entry(info: RasterInfo) -> RasterEntry:
    """Return the entry of a band of an input."""
    return filled(
        RasterEntry,
        info,
        path=info.uri,
        matched=bands_of(info).text,
        weights=info.several.parts if info.several else (),
        grid=_grid(info.grid),
        georeferenced=info.georeferenced and not isinstance(info.grid, RpcGrid),
        mask=info.mask_uri,
        mask_kind=info.mask_kind if info.mask_uri else None,
    )


def _rpc(rpc: RpcRegistration, settings: Settings) -> RpcEntry:
    """Return the RPCs before and after and the heights used, sufficient to correct other rasters."""
    heights = rpc.original.heights
    dem = heights if isinstance(heights, Dem) else None
    return RpcEntry(
        origin=rpc.origin,
        dem=str(_found_again(dem.uri)) if dem else None,
        dem_vertical=_found_again(settings.dem_vertical) if dem else None,
        undulation_m=round(dem.undulation.mean_m, M_DIGITS) if dem else None,
        height_m=None if isinstance(heights, Dem) else heights.height_m,
        height_range_m=rounded(rpc.heights_m, 1),
        original=rpc.original.rpc,
        corrected=rpc.corrected.rpc if rpc.corrected else None,
        fold_error_px=rpc.bias_error_px,
    )


def _found_again(file: float | Path | str | None) -> float | str | None:
    """Return an absolute path for the name of an existing file; other values are unchanged."""
    if not isinstance(file, str | Path):
        return file
    return str(Path(file).absolute() if Path(file).exists() else file)


def _tie_point_counts(registration: Registration) -> dict[str, int]:
    status = registration.tie_points.status
    names = ("matched",) if registration.status == "matched" else ("fit", "check", "unused")
    counts = {name: int(np.count_nonzero(status == name)) for name in (*names, "rejected")}
    return {"total": len(status), **counts}


def _model(registration: Registration, precision: PrecisionMap | None) -> ModelEntry | None:
    """Return the correction in full precision, and the candidates from which it was chosen."""
    if registration.model is None:
        return None
    candidates = tuple(
        filled(
            CandidateEntry,
            candidate,
            parameters=_known(candidate.parameters, 1),
            rmse_px=_known(candidate.rmse_px, PX_DIGITS),
            rmse_standard_error_px=_known(candidate.rmse_standard_error_px, PX_DIGITS),
        )
        for candidate in (registration.selection.candidates if registration.selection else ())
    )
    sigma = _predicted_sigma(precision) if precision else None
    content: Any = registration.model.to_dict()
    return ModelEntry(**content, predicted_sigma_px=sigma, candidates=candidates)


def _known(value: float, digits: int) -> float | None:
    """Return a rounded value; None if it is not finite."""
    return round(value, digits) if math.isfinite(value) else None


def _quality(registration: Registration) -> QualityEntry | None:
    quality, px_m = registration.quality, registration.px_m
    if quality is None:
        return None
    expected_px = quality.expected_ce90_px
    whole_px, extrapolated = quality.whole or (None, quality.extrapolated_share)
    size_m = None if px_m is None else math.sqrt(px_m[0] * px_m[1])
    return QualityEntry(
        grade=quality.grade,
        reasons=tuple(reason.text for reason in quality.reasons),
        expected_ce90_px=round(expected_px, PX_DIGITS),
        expected_ce90_m=None if size_m is None else round(expected_px * size_m, M_DIGITS),
        whole_ce90_px=rounded(whole_px, PX_DIGITS),
        whole_ce90_m=None if whole_px is None or size_m is None else round(whole_px * size_m, M_DIGITS),
        extrapolated_share=round(extrapolated, SHARE_DIGITS),
        kept_share=round(quality.kept_share, SHARE_DIGITS),
    )


def _predicted_sigma(precision: PrecisionMap) -> PredictedSigma:
    """Return the sigma of the correction over the target, and the share that is extrapolated."""
    sigma = precision.sigma_px.reshape(-1, 2)
    return PredictedSigma(
        median=_pair(np.median(sigma, axis=0), PX_DIGITS),
        largest=_pair(sigma.max(axis=0), PX_DIGITS),
        extrapolated_share=round(float(precision.extrapolated.mean()), SHARE_DIGITS),
    )


def _profiles(registration: Registration) -> ProfilesEntry | None:
    """Return the displacement along rows and columns of the target beyond its cubic trend."""
    points = registration.tie_points.select("fit", "check", "unused")
    if registration.selection is None or len(points) < JITTER.min_points:
        return None
    window_px, at_px = registration.selection.footprint_px, points.predicted_px
    residual = without_trend(at_px, points.displacement_px)
    col, row = at_px.T
    heights = heights_m(registration, at_px)
    entry = ProfilesEntry(
        peaks(at_px, residual, window_px),
        profile(col, row, residual, window_px / 2),
        profile(row, col, residual, window_px / 2),
        None if heights is None else profile(heights, row, residual, 0.0),
    )
    return rounded(entry, PX_DIGITS)


def _coverage(registration: Registration) -> CoverageEntry:
    """Return the tie points by square of the reference, and the reasons where there are none."""
    coverage = coverage_of(registration.tie_points, registration.reference.grid.shape, registration.record)
    rows, cols = coverage.points.shape
    return CoverageEntry(
        squares=(rows, cols),
        points=tuple(map(tuple, coverage.points.tolist())),
        reason=tuple(tuple(name or None for name in row) for row in coverage.reason.tolist()),
        without_points=coverage.without,
        empty_share=round(coverage.empty_share, SHARE_DIGITS),
    )


def _statistics(values: Float64, digits: int) -> AxisSummary | None:
    """Return mean, median and population standard deviation per axis; None without points."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) == 0:
        return None
    moments = values.mean(axis=0), np.median(values, axis=0), values.std(axis=0)
    return AxisSummary(*(_pair(moment, digits) for moment in moments))


def _accuracy(registration: Registration, group: str) -> dict[Literal["px", "m"], Accuracy | None]:
    def accuracy(unit: str, digits: int) -> Accuracy | None:
        statistics = registration.accuracy.get(f"{group}_{unit}")
        return rounded(statistics, digits) if statistics and statistics.n else None

    return {"px": accuracy("px", PX_DIGITS), "m": accuracy("m", M_DIGITS)}


def _pair(values: Float64, digits: int) -> FloatPair:
    col, row = np.round(values, digits).tolist()
    return col, row
