"""A registration as plain numbers: what `report.json` holds and the page is made from."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray

import pcwlad_geo
from pcwlad_geo.correction.accuracy import Accuracy
from pcwlad_geo.raster.dem import Dem
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.rpc_grid import RpcGrid
from pcwlad_geo.raster.rpc_view import ground_grid
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.rpc_target import RpcRegistration
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.report.coverage import SHARE_DIGITS, coverage_of
from pcwlad_geo.report.precision import PrecisionMap, precision_of
from pcwlad_geo.report.statistics import KEPT, error_statistics
from pcwlad_geo.requirements import RequirementResult

SCHEMA_VERSION = 1
LIBRARIES = ("numpy", "scipy", "cv2", "numba", "rasterio", "pyproj")
PX_DIGITS, M_DIGITS, SECONDS_DIGITS = 5, 4, 3

Summary = dict[str, object]


def summarise(
    registration: Registration,
    outputs: Sequence[str],
    precision: PrecisionMap | None = None,
    output_grid: Grid | None = None,
) -> Summary:
    """Return the content of `report.json`.

    Parameters
    ----------
    registration : Registration
    outputs : sequence of str
        Names of the files written into the output folder, relative to it.
    precision : PrecisionMap, optional
        The registration's, where it is known already.
    output_grid : Grid, optional
        Of the registered raster.

    Returns
    -------
    dict
        JSON types only; NaN and infinity are None.
    """
    table = registration.tie_points
    kept = table.select(*KEPT)
    summary = {
        "schema_version": SCHEMA_VERSION,
        "status": registration.status,
        "reason": registration.reason,
        "warnings": list(registration.warnings),
        "passed": registration.passed,
        "requirements": [_requirement(each) for each in registration.requirements],
        "reference": _raster(registration.reference) | {"ground": _ground(registration.reference)},
        "target": _raster(registration.target),
        "inputs": [{"role": file.role} | file.identity.to_json() for file in registration.inputs],
        "px_m": registration.px_m,
        "output_grid": _grid(output_grid) if output_grid else None,
        "prealignment": asdict(registration.prealignment),
        "tie_points": _tie_point_counts(registration),
        "counts": dict(registration.counts),
        "displacement_px": _statistics(kept.displacement_px, PX_DIGITS),
        "displacement_m": _statistics(kept.displacement_m, M_DIGITS),
        "rpc": _rpc(registration.rpc, registration.settings) if registration.rpc else None,
        "model": _model(registration, precision or precision_of(registration)),
        "accuracy": {
            group: {
                unit: _accuracy(registration.accuracy.get(f"{group}_{unit}"), digits)
                for unit, digits in (("px", PX_DIGITS), ("m", M_DIGITS))
            }
            for group in ("fit", "check")
        },
        "quality": _quality(registration),
        "statistics": error_statistics(registration),
        "coverage": _coverage(registration),
        "seconds": {stage: round(value, SECONDS_DIGITS) for stage, value in registration.seconds.items()},
        "settings": asdict(registration.settings),
        "versions": versions(),
        "outputs": list(outputs),
    }
    return {name: plain(value) for name, value in summary.items()}


def to_json(summary: Mapping[str, object]) -> str:
    """Return the text of `report.json`."""
    return json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def versions() -> dict[str, str]:
    """Return the versions of this package, Python, GDAL and the libraries that make the numbers."""
    return {
        "pcwlad-geo": pcwlad_geo.__version__,
        "python": platform.python_version(),
        "gdal": rasterio.__gdal_version__,
        **{name: str(import_module(name).__version__) for name in LIBRARIES},
    }


def plain(value: object) -> object:
    """Return a value in JSON types: NaN and infinity become None, paths text, arrays lists."""
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def _grid(grid: Grid) -> Summary:
    return {
        "shape": list(grid.shape),
        "transform": list(grid.transform)[:6],
        "crs": grid.crs.to_string() if grid.crs and not isinstance(grid, RpcGrid) else None,
    }


def _requirement(result: RequirementResult) -> Summary:
    return {
        "text": result.requirement.text,
        **asdict(result.requirement),
        "value": result.value,
        "met": result.met,
        "reason": result.reason,
        "message": result.text,
    }


def _raster(info: RasterInfo) -> Summary:
    grid = info.grid
    return {
        "path": info.uri,
        "band": info.band,
        "band_count": info.band_count,
        **_grid(grid),
        "georeferenced": info.georeferenced and not isinstance(grid, RpcGrid),
        "dtype": info.dtype,
        "nodata": info.nodata,
        "mask": info.mask_uri,
        "mask_kind": info.mask_kind if info.mask_uri else None,
    }


def _ground(reference: RasterInfo) -> Summary | None:
    """Return the grid that a reference with RPC is orthorectified onto."""
    if not isinstance(reference.grid, RpcGrid):
        return None
    grid = ground_grid(reference.grid)
    return {
        "shape": list(grid.shape),
        "transform": list(grid.transform)[:6],
        "crs": grid.crs.to_string() if grid.crs else None,
    }


def _rpc(rpc: RpcRegistration, settings: Settings) -> Summary:
    """Return the RPC before and after, and the heights that it was used with: enough for its siblings."""
    heights = rpc.original.heights
    dem = heights if isinstance(heights, Dem) else None
    return {
        "origin": rpc.origin,
        "dem": _found_again(dem.uri) if dem else None,
        "dem_vertical": _found_again(settings.dem_vertical) if dem else None,
        "undulation_m": round(dem.undulation.mean_m, M_DIGITS) if dem else None,
        "height_m": None if isinstance(heights, Dem) else heights.height_m,
        "height_range_m": np.round(rpc.heights_m, 1).tolist(),
        "original": asdict(rpc.original.rpc),
        "corrected": asdict(rpc.corrected.rpc) if rpc.corrected else None,
        "fold_error_px": rpc.fold_error_px,
    }


def _found_again(file: object) -> object:
    """Return a file's name as it can be found from any folder; what is none stays."""
    is_file = isinstance(file, str | Path) and Path(file).exists()
    return str(Path(str(file)).absolute()) if is_file else file


def _tie_point_counts(registration: Registration) -> dict[str, int]:
    status = registration.tie_points.status
    names = ["fit", "check", "unused", "rejected"]
    if registration.status == "matched":
        names = ["matched", "rejected"]
    return {"total": len(status), **{name: int(np.count_nonzero(status == name)) for name in names}}


def _model(registration: Registration, precision: PrecisionMap | None) -> Summary | None:
    """Return the correction, in full precision, and the candidates it was chosen from."""
    if registration.correction is None:
        return None
    selection = registration.selection
    candidates = selection.candidates if selection else ()
    return registration.correction.to_dict() | {
        "predicted_sigma_px": precision and _predicted_sigma(precision),
        "candidates": [
            asdict(candidate)
            | {
                "parameters": round(candidate.parameters, 1),
                "rmse_px": round(candidate.rmse_px, PX_DIGITS),
                "rmse_standard_error_px": round(candidate.rmse_standard_error_px, PX_DIGITS),
            }
            for candidate in candidates
        ],
    }


def _quality(registration: Registration) -> Summary | None:
    quality, px_m = registration.quality, registration.px_m
    if quality is None:
        return None
    expected = quality.expected_ce90_px
    return {
        "grade": quality.grade,
        "reasons": [reason.text for reason in quality.reasons],
        "expected_ce90_px": round(expected, PX_DIGITS),
        "expected_ce90_m": None if px_m is None else round(expected * math.sqrt(px_m[0] * px_m[1]), M_DIGITS),
        "extrapolated_share": round(quality.extrapolated_share, 3),
        "kept_share": round(quality.kept_share, 3),
    }


def _predicted_sigma(precision: PrecisionMap) -> Summary:
    """Return the sigma of the correction over the target, and how much of it lies beyond the tie points."""
    sigma = precision.sigma_px.reshape(-1, 2)
    return {
        "median": np.round(np.median(sigma, axis=0), PX_DIGITS).tolist(),
        "largest": np.round(sigma.max(axis=0), PX_DIGITS).tolist(),
        "extrapolated_share": round(float(precision.extrapolated.mean()), 3),
    }


def _coverage(registration: Registration) -> Summary:
    """Return the tie points by square of the reference, and why there are none."""
    found = coverage_of(registration.tie_points, registration.reference.grid.shape, registration.record)
    return {
        "squares": list(found.points.shape),
        "points": found.points.tolist(),
        "reason": [[name or None for name in row] for row in found.reason.tolist()],
        "without_points": found.without,
        "empty_share": round(found.empty_share, SHARE_DIGITS),
    }


def _statistics(values: NDArray[np.float64], digits: int) -> dict[str, list[float]] | None:
    """Return mean, median and population standard deviation per axis; None where there are no points."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) == 0:
        return None
    return {
        "mean": np.round(values.mean(axis=0), digits).tolist(),
        "median": np.round(np.median(values, axis=0), digits).tolist(),
        "std": np.round(values.std(axis=0), digits).tolist(),
    }


def _accuracy(accuracy: Accuracy | None, digits: int) -> Summary | None:
    if accuracy is None or accuracy.n == 0:
        return None
    return {
        name: value if name == "n" else np.round(value, digits).tolist()
        for name, value in asdict(accuracy).items()
    }
