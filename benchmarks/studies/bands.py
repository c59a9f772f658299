"""The quality report must find bands where they are, and every triangle of them must close.

Bands of one Landsat scene and of Sentinel-2; the raw frames of a camera with five lenses, 5 to 25 px apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pcwlad_geo
from benchmarks.runs import Runner
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.multi.qa.band_pairs import PairResult
from pcwlad_geo.multi.qa.closure import Triangle

APART_PX = 0.05
CLOSES_PX = 0.05


def bands(data: Path, scratch: Path, _runner: Runner) -> Iterator[Table]:
    """Yield tables of the pairs and the triangles of ``pcwlad-geo qa``, and of the triangles of a rig."""
    folder = data / "cross_sensor"
    result = pcwlad_geo.qa(
        [f"{folder / 'landsat8_byte.tif'}:2,4,5", f"{folder / 'sentinel2_b432_byte.tif'}:1"],
        out_dir=scratch / "qa",
        jobs=1,
    )
    yield _pairs(result.pairs)
    yield _triangles(result.triangles, "Closure of the bands, px of 30 m")
    frames = sorted((data / "rig" / "rededge").glob("*.tif"))
    rig = pcwlad_geo.qa(frames, out_dir=scratch / "rig", jobs=1)
    yield _triangles(rig.triangles, "Closure of the raw frames of five lenses, px")


def _pairs(pairs: tuple[PairResult, ...]) -> Table:
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for pair in pairs:
        px = pair.statistics["px"]
        if px is None:
            raise RuntimeError(f"{pair.name}: {pair.reason}")
        figures = (px.col.mean, px.row.mean, px.col.le90, px.row.le90, px.radial.ce90, px.net.ce90)
        rows.append([pair.name, px.n, *(f"{figure:+.3f}" for figure in figures)])
        if "sentinel2" not in pair.name:
            apart = math.hypot(px.col.mean, px.row.mean)
            checks.append(at_most(f"{pair.name}: mean displacement", apart, APART_PX, "px"))
    header = ("pair", "points", "mean col, px", "row", "LE90 col", "row", "CE90", "net CE90")
    return Table("Bands: displacement as found, px of 30 m", header, rows, checks)


def _triangles(triangles: tuple[Triangle, ...], title: str) -> Table:
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for triangle in triangles:
        mean, error = triangle.mean_px or (math.nan,) * 2, triangle.error_px or (math.nan,) * 2
        rows.append([triangle.name, triangle.cells, *(f"{figure:+.3f}" for figure in (*mean, *error))])
        gap = max(abs(mean[0]), abs(mean[1])) if triangle.mean_px else math.nan
        checks.append(at_most(f"{triangle.name}: larger axis", gap, CLOSES_PX, "px"))
    header = ("triangle", "places", "mean col, px", "row", "standard error col", "row")
    return Table(title, header, rows, checks)
