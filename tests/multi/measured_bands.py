"""Stacks made by hand: bands of one grid with known displacements, and files of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.multi.qa.band_pairs import PairResult, statistics_by_unit
from pcwlad_geo.multi.qa.bands import Band
from pcwlad_geo.raster import Grid, RasterInfo
from pcwlad_geo.tiepoints.table import TiePointTable, predict_px

Array = NDArray[np.float64]

UTM = CRS.from_epsg(32633)


def make_band(
    name: str,
    *,
    pixel_m: float = 30.0,
    native_m: float | None = None,
    georeferenced: bool = True,
    shape: tuple[int, int] = (400, 400),
) -> Band:
    """A band at (500000, 4600000); without georeferencing it has no pixel size."""
    transform = Affine(pixel_m, 0, 500000, 0, -pixel_m, 4600000) if georeferenced else Affine.identity()
    grid = Grid(shape, transform, UTM if georeferenced else None)
    info = RasterInfo(f"/data/{name}.tif", 1, 1, grid, georeferenced, "uint16", 0.0, None)
    px_m = (pixel_m, pixel_m) if georeferenced else None
    told = native_m is not None
    return Band(name, info, None, px_m, (native_m, native_m) if native_m is not None else px_m, told)


def make_pair(
    reference: Band,
    target: Band,
    displacement_px: tuple[float, float] = (0.0, 0.0),
    *,
    noise_px: float = 0.05,
    sigma_px: float = 0.05,
    n: int = 400,
    seed: int = 0,
) -> PairResult:
    """A measured pair: tie points all over the target, displaced by so many of its px."""
    rng = np.random.default_rng(seed)
    rows, cols = target.info.grid.shape
    predicted = rng.uniform((0, 0), (cols, rows), (n, 2))
    points = TiePointTable(
        reference_px=predicted,
        target_px=predicted + displacement_px + rng.normal(0, noise_px, (n, 2)),
        predicted_px=predicted,
        xy=target.info.grid.to_xy(predicted),
        displacement_m=np.full((n, 2), np.nan),
        covariance_px2=np.tile(np.eye(2) * sigma_px**2, (n, 1, 1)),
        score=np.ones(n),
        residual_px=np.full((n, 2), np.nan),
        status=np.full(n, "matched"),
        crs=reference.info.grid.crs,
    )
    statistics = statistics_by_unit(points, reference, target)
    return PairResult(reference, target, "measured", points=points, rejected=3, statistics=statistics)


def make_mapped_pair(
    reference: Band,
    target: Band,
    seen_at: Callable[[Array], Array],
    *,
    noise_px: float = 0.0,
    n: int = 600,
    seed: int = 0,
) -> PairResult:
    """A measured pair whose tie points lie where a function puts them: reference px to target px."""
    rng = np.random.default_rng(seed)
    rows, cols = reference.info.grid.shape
    reference_px = rng.uniform((0, 0), (cols, rows), (n, 2))
    target_px = seen_at(reference_px)
    rows, cols = target.info.grid.shape
    inside = ((target_px >= 0) & (target_px <= (cols, rows))).all(axis=1)
    made = make_pair(reference, target, n=int(inside.sum()))
    assert made.points is not None
    points = replace(
        made.points,
        reference_px=reference_px[inside],
        predicted_px=predict_px(reference_px[inside], reference.info, target.info),
        target_px=target_px[inside] + rng.normal(0, noise_px, (int(inside.sum()), 2)),
    )
    return replace(made, points=points)


def refused(reference: Band, target: Band, reason: str = "only 7 of 900 agree") -> PairResult:
    """A pair that could not be matched."""
    return PairResult(reference, target, "refused", reason)


def schema_file() -> Path:
    """The published schema of qa.json."""
    return Path(__file__).resolve().parents[2] / "docs" / "qa.schema.json"
