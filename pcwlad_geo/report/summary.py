"""The making of the content of report.json from a registration."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import rasterio

from pcwlad_geo.correction.error_statistics import Accuracy, Pair
from pcwlad_geo.correction.jitter import MIN_WAVE_POINTS, peaks, profile, smooth_rest
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.rpc.dem import Dem
from pcwlad_geo.raster.rpc.grid import RpcGrid
from pcwlad_geo.raster.rpc.view import ground_grid
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.rpc import RpcRegistration
from pcwlad_geo.report import content as c
from pcwlad_geo.report.statistics import (
    GROUPS,
    KEPT,
    SHARE_DIGITS,
    Group,
    PrecisionMap,
    When,
    coverage_of,
    heights_m,
    native_size_m,
    precision_of,
    statistics_of,
    target_px_m,
)
from pcwlad_geo.requirements import RequirementResult
from pcwlad_geo.types import Float64

SCHEMA_VERSION: Final = 1
"""Version of the structure of report.json."""
LIBRARIES = ("numpy", "scipy", "cv2", "numba", "rasterio", "pyproj")
"""Libraries whose versions the report states."""
PX_DIGITS, M_DIGITS, SECONDS_DIGITS = 5, 4, 3
"""Numbers of decimal places of pixels, metres and seconds."""


def summarise(
    registration: Registration,
    outputs: Sequence[str],
    precision: PrecisionMap | None = None,
    output_grid: Grid | None = None,
) -> c.Report:
    """Return the content of `report.json`.

    Parameters
    ----------
    outputs : sequence of str
        Names of the files written into the output folder, relative to it.
    precision : PrecisionMap, optional
        Predicted sigma of the registration, if already computed.
    output_grid : Grid, optional
        Grid of the registered raster.
    """
    table = registration.tie_points
    kept = table.select(*KEPT)
    rpc = registration.rpc
    return c.Report(
        schema_version=SCHEMA_VERSION,
        status=registration.status,
        reason=registration.reason,
        warnings=registration.warnings,
        passed=registration.passed,
        requirements=tuple(_requirement(each) for each in registration.requirements),
        reference=_reference(registration.reference),
        target=_raster(registration.target),
        inputs=registration.inputs,
        px_m=registration.px_m,
        output_grid=_grid(output_grid) if output_grid else None,
        prealignment=registration.prealignment,
        geometry=registration.geometry,
        motions=registration.motions,
        jitter_px=registration.jitter_px,
        window_px=registration.window_px,
        tie_points=_tie_point_counts(registration),
        counts=registration.counts,
        displacement_px=_statistics(kept.displacement_px, PX_DIGITS),
        displacement_m=_statistics(kept.displacement_m, M_DIGITS),
        rpc=_rpc(rpc, registration.settings) if rpc else None,
        model=_model(registration, precision or precision_of(registration)),
        accuracy={"fit": _accuracy(registration, "fit"), "check": _accuracy(registration, "check")},
        quality=_quality(registration),
        statistics=error_statistics(registration),
        profiles=_profiles(registration),
        coverage=_coverage(registration),
        seconds=c.rounded(registration.seconds, SECONDS_DIGITS),
        settings=registration.settings,
        versions=versions(),
        outputs=tuple(outputs),
    )


def versions() -> dict[str, str]:
    """Return the versions of this package, Python, GDAL and the numerical libraries."""
    return {
        # of the code that runs, which need not be what is installed
        "pcwlad-geo": str(import_module("pcwlad_geo").__version__),
        "python": platform.python_version(),
        "gdal": rasterio.__gdal_version__,
        **{name: str(import_module(name).__version__) for name in LIBRARIES},
    }


def error_statistics(registration: Registration) -> c.StatisticsEntry:
    """Return the statistics of displacements (before) and residuals (after) of all, fit and check points."""
    sizes_m = target_px_m(registration)

    def groups(when: When) -> dict[Group, c.GroupStatistics | None]:
        return {group: _group(registration, when, group, sizes_m) for group in GROUPS}

    native_m = native_size_m(registration.reference, registration.target)
    return c.StatisticsEntry(native_m, groups("before"), groups("after"))


def _group(
    registration: Registration, when: When, group: Group, sizes_m: Float64 | None
) -> c.GroupStatistics | None:
    found = statistics_of(registration, when, group, sizes_m)
    px, native_px, m = (found[unit] for unit in ("px", "native_px", "m"))
    if px is None:
        return None
    return c.rounded(c.GroupStatistics(px.n, px.of_unit, native_px and native_px.of_unit, m and m.of_unit))


def _grid(grid: Grid) -> c.GridEntry:
    a, b, col_off, d, e, row_off = (float(value) for value in grid.transform[:6])
    crs = grid.crs.to_string() if grid.crs and not isinstance(grid, RpcGrid) else None
    return c.GridEntry(grid.shape, (a, b, col_off, d, e, row_off), crs)


def _reference(info: RasterInfo) -> c.ReferenceEntry:
    """Return the reference; with an RPC, also the grid onto which it is orthorectified."""
    ground = _grid(ground_grid(info.grid)) if isinstance(info.grid, RpcGrid) else None
    raster = _raster(info)
    return c.ReferenceEntry(
        **{each.name: getattr(raster, each.name) for each in fields(raster)}, ground=ground
    )


def _requirement(result: RequirementResult) -> c.RequirementEntry:
    requirement = result.requirement
    return c.RequirementEntry(
        requirement.text, requirement, result.value, result.met, result.reason, result.text
    )


def _raster(info: RasterInfo) -> c.RasterEntry:
    return c.RasterEntry(
        path=info.uri,
        band=info.band,
        band_count=info.band_count,
        grid=_grid(info.grid),
        georeferenced=info.georeferenced and not isinstance(info.grid, RpcGrid),
        dtype=info.dtype,
        nodata=info.nodata,
        mask=info.mask_uri,
        mask_kind=info.mask_kind if info.mask_uri else None,
    )


def _rpc(rpc: RpcRegistration, settings: Settings) -> c.RpcEntry:
    """Return the RPCs before and after and the heights used, sufficient to correct other rasters."""
    heights = rpc.original.heights
    dem = heights if isinstance(heights, Dem) else None
    return c.RpcEntry(
        origin=rpc.origin,
        dem=str(_found_again(dem.uri)) if dem else None,
        dem_vertical=_found_again(settings.dem_vertical) if dem else None,
        undulation_m=round(dem.undulation.mean_m, M_DIGITS) if dem else None,
        height_m=None if isinstance(heights, Dem) else heights.height_m,
        height_range_m=c.rounded(rpc.heights_m, 1),
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
    names = ["fit", "check", "unused", "rejected"]
    if registration.status == "matched":
        names = ["matched", "rejected"]
    return {"total": len(status), **{name: int(np.count_nonzero(status == name)) for name in names}}


def _model(registration: Registration, precision: PrecisionMap | None) -> c.ModelEntry | None:
    """Return the correction in full precision, and the candidates from which it was chosen."""
    if registration.correction is None:
        return None
    found: Any = registration.correction.to_dict()
    candidates = registration.selection.candidates if registration.selection else ()
    return c.ModelEntry(
        found["name"],
        found["forward"],
        _predicted_sigma(precision) if precision else None,
        tuple(
            c.CandidateEntry(
                each.name,
                _known(each.parameters, 1),
                _known(each.rmse_px, PX_DIGITS),
                _known(each.rmse_standard_error_px, PX_DIGITS),
                each.chosen,
                each.note,
            )
            for each in candidates
        ),
    )


def _known(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None


def _quality(registration: Registration) -> c.QualityEntry | None:
    quality, px_m = registration.quality, registration.px_m
    if quality is None:
        return None
    expected = quality.expected_ce90_px
    return c.QualityEntry(
        grade=quality.grade,
        reasons=tuple(reason.text for reason in quality.reasons),
        expected_ce90_px=round(expected, PX_DIGITS),
        expected_ce90_m=None if px_m is None else round(expected * math.sqrt(px_m[0] * px_m[1]), M_DIGITS),
        extrapolated_share=round(quality.extrapolated_share, SHARE_DIGITS),
        kept_share=round(quality.kept_share, SHARE_DIGITS),
    )


def _predicted_sigma(precision: PrecisionMap) -> c.PredictedSigma:
    """Return the sigma of the correction over the target, and the share that is extrapolated."""
    sigma = precision.sigma_px.reshape(-1, 2)
    return c.PredictedSigma(
        median=_pair(np.median(sigma, axis=0), PX_DIGITS),
        largest=_pair(sigma.max(axis=0), PX_DIGITS),
        extrapolated_share=round(float(precision.extrapolated.mean()), SHARE_DIGITS),
    )


def _profiles(registration: Registration) -> c.ProfilesEntry | None:
    """Return the displacement along rows and columns of the target beyond its cubic trend."""
    points = registration.tie_points.select("fit", "check", "unused")
    if registration.selection is None or len(points) < MIN_WAVE_POINTS:
        return None
    window_px, at_px = registration.selection.footprint_px, points.predicted_px
    rest = smooth_rest(at_px, points.displacement_px)
    col, row = at_px.T
    heights = heights_m(registration, at_px)
    step = window_px / 2
    found = c.ProfilesEntry(
        peaks(at_px, rest, window_px),
        profile(col, row, rest, step),
        profile(row, col, rest, step),
        None if heights is None else profile(heights, row, rest, 0.0),
    )
    return c.rounded(found, PX_DIGITS)


def _coverage(registration: Registration) -> c.CoverageEntry:
    """Return the tie points by square of the reference, and the reasons where there are none."""
    found = coverage_of(registration.tie_points, registration.reference.grid.shape, registration.record)
    rows, cols = found.points.shape
    return c.CoverageEntry(
        squares=(rows, cols),
        points=tuple(map(tuple, found.points.tolist())),
        reason=tuple(tuple(name or None for name in row) for row in found.reason.tolist()),
        without_points=found.without,
        empty_share=round(found.empty_share, SHARE_DIGITS),
    )


def _statistics(values: Float64, digits: int) -> c.AxisSummary | None:
    """Return mean, median and population standard deviation per axis; None without points."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) == 0:
        return None
    found = values.mean(axis=0), np.median(values, axis=0), values.std(axis=0)
    return c.AxisSummary(*(_pair(each, digits) for each in found))


def _accuracy(registration: Registration, group: str) -> dict[Literal["px", "m"], Accuracy | None]:
    def accuracy(unit: str, digits: int) -> Accuracy | None:
        found = registration.accuracy.get(f"{group}_{unit}")
        return c.rounded(found, digits) if found and found.n else None

    return {"px": accuracy("px", PX_DIGITS), "m": accuracy("m", M_DIGITS)}


def _pair(values: Float64, digits: int) -> Pair:
    col, row = np.round(values, digits).tolist()
    return col, row
