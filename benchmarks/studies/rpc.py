"""A satellite image with RPC against two references: height datum, agreement, second registration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.studies.rpc_pair import rpc_pair
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import transform_xy
from pcwlad_geo.raster.rpc.bias import BIAS_TOLERANCE_PX
from pcwlad_geo.raster.rpc.files import to_gdal
from pcwlad_geo.raster.vrt import write_rpc_vrt
from pcwlad_geo.registration import RpcRegistration

UNDULATION_M = 29.0
"""EGM2008 above the ellipsoid at the scene."""
DATUM_PX = 0.1
AGREE_PX = 0.3
AGAIN_PX = 0.05


def rpc(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield a table for each question."""
    sentinel = data / "cross_sensor/sentinel2_b432_byte.tif"
    aerial = data / "cross_sensor/ngi_rgb_byte_1.tif"
    target = data / "rpc/qb2_basic1b.tif"
    heights = Settings(dem=data / "rpc/dem_egm2008.tif", dem_vertical=UNDULATION_M)
    jobs = [
        Job(sentinel, target, heights, match_only=False),
        Job(sentinel, target, replace(heights, dem_vertical=0.0), match_only=False),
        Job(aerial, target, heights, match_only=False),
        Job(sentinel, aerial, Settings(), match_only=False),
    ]
    by_sentinel, no_undulation, by_aerial, aerial_displacement = runner(jobs)
    yield _datum(by_sentinel, no_undulation)
    yield _agreement(by_sentinel, by_aerial, aerial_displacement)
    references = {"Sentinel-2": (sentinel, by_sentinel), "aerial": (aerial, by_aerial)}
    again = []
    for name, (reference, outcome) in references.items():
        path = scratch / f"{name}_rpc.vrt"
        items = to_gdal(_rpc(outcome).corrected_grid.rpc)
        write_rpc_vrt(path, target, items, final_path=path)
        again.append(Job(reference, path, heights, match_only=False))
    yield _second(
        dict(zip(references, zip([by_sentinel, by_aerial], runner(again), strict=True), strict=True))
    )
    yield from rpc_pair(data, scratch)


def _datum(with_undulation: Outcome, without: Outcome) -> Table:
    """Compare how far the correction moves with what the RPC says of the undulation."""
    grid = _rpc(with_undulation).original
    lon_lat = transform_xy(with_undulation.points.xy, with_undulation.points.crs, grid.crs)
    ground = np.column_stack([lon_lat, grid.heights.at(lon_lat)])
    # what lies higher is predicted elsewhere, and so displaced the other way
    expected = -UNDULATION_M * grid.rpc.px_per_metre_of_height(ground).mean(axis=0)
    shifts = [_shift(outcome) for outcome in (with_undulation, without)]
    moved = shifts[0] - shifts[1]
    rows: list[list[Cell]] = [
        [f"heights + {UNDULATION_M:.0f} m", *_signed(shifts[0])],
        ["heights as they are", *_signed(shifts[1])],
        ["difference", *_signed(moved)],
        [f"{UNDULATION_M:.0f} m of height by the RPC", *_signed(expected)],
    ]
    checks = [
        at_most(f"datum, {axis}: difference from the RPC's", float(abs(value)), DATUM_PX, "px")
        for axis, value in zip(("column", "row"), moved - expected, strict=True)
    ]
    return Table(
        "Height datum: mean correction against Sentinel-2, px", ("heights", "column", "row"), rows, checks
    )


def _agreement(by_sentinel: Outcome, by_aerial: Outcome, aerial_displacement: Outcome) -> Table:
    """Where ground that both references show is seen in the image, by one and by the other correction."""
    at_xy = by_aerial.points.xy
    seen = aerial_displacement.result
    if seen.model is None:
        raise RuntimeError(f"refused: {seen.reason}")
    # the same ground in the aerial image's coordinates
    aerial_xy = seen.target.grid.to_xy(seen.model.forward(seen.target.grid.to_px(at_xy)))
    by_first, by_second = _observed_px(by_sentinel, at_xy), _observed_px(by_aerial, aerial_xy)
    raw = _observed_px(by_aerial, at_xy) - by_first
    apart = by_second - by_first
    rows: list[list[Cell]] = [
        ["correction by Sentinel-2", by_sentinel.result.model.name, *_signed(_shift(by_sentinel))],  # type: ignore[union-attr]
        ["correction by the aerial image", by_aerial.result.model.name, *_signed(_shift(by_aerial))],  # type: ignore[union-attr]
        ["apart, as they are", "", *_signed(raw.mean(axis=0))],
        ["apart, aerial displacement taken off", "", *_signed(apart.mean(axis=0))],
        ["its RMS over the common ground", "", *_signed(np.sqrt((apart**2).mean(axis=0)))],
    ]
    distance = float(np.hypot(*apart.mean(axis=0)))
    return Table(
        "Two references, px of the image",
        ("", "model", "column", "row"),
        rows,
        [at_most("two references: distance of the corrections", distance, AGREE_PX, "px")],
    )


def _second(outcomes: dict[str, tuple[Outcome, Outcome]]) -> Table:
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for name, (first, again) in outcomes.items():
        left = again.points.displacement_px
        error = _rpc(first).bias_error_px
        fold_px = float("nan") if error is None else error
        check = first.result.accuracy["check_px"].rmse
        rows.append([name, len(again.points), *_signed(left.mean(axis=0)), check, f"{fold_px:.1e}"])
        distance = float(np.hypot(*left.mean(axis=0)))
        checks.append(at_most(f"{name}: found by a second registration", distance, AGAIN_PX, "px"))
        checks.append(at_most(f"{name}: fold error", fold_px, BIAS_TOLERANCE_PX, "px", 7))
    header = ("reference", "points", "mean column", "row", "check RMSE of the first", "fold error")
    return Table("With the corrected RPC, px of the image", header, rows, checks)


def _rpc(outcome: Outcome) -> RpcRegistration:
    if outcome.result.rpc is None:
        raise RuntimeError(f"no RPC was used: {outcome.reason}")
    return outcome.result.rpc


def _observed_px(outcome: Outcome, xy: Array) -> Array:
    """Return where ground at (x, y) of the reference CRS is seen in the image."""
    grid, correction = _rpc(outcome).original, outcome.result.model
    if correction is None:
        raise RuntimeError(f"refused: {outcome.reason}")
    return correction.forward(grid.to_px(transform_xy(xy, outcome.points.crs, grid.crs)))


def _shift(outcome: Outcome) -> Array:
    """Return the mean of the correction over its tie points."""
    at_px = outcome.points.predicted_px
    if outcome.result.model is None:
        raise RuntimeError(f"refused: {outcome.reason}")
    moved: Array = (outcome.result.model.forward(at_px) - at_px).mean(axis=0)
    return moved


def _signed(values: Array) -> list[str]:
    return [f"{value:+.3f}" for value in values]
