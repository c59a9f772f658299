"""Pairs of one ground in two CRSs, around the earth and at its poles: displaced by what their file says.

Every raster is one function of the place on the earth, evaluated at its pixel centres; the georeferencing of
the target is off by a known shift.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.runs import Job, Outcome, Runner
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.options import Settings
from tests.earth import GEOSTATIONARY, LONLAT, SINUSOIDAL, Raster

SHIFT_PX: Final = (1.3, -0.7)
RIGHT_PX: Final = 0.05
SETTINGS: Final = Settings(jobs=1)
MERCATOR_M: Final = 20037508.342789244


def _antimeridian(lat: float, utm: tuple[str, str]) -> list[Raster]:
    at, half = (180.0, lat), np.degrees(110 * 100.0 / 6_371_000.0 / np.cos(np.radians(lat)))
    return [
        Raster("lonlat to 180", LONLAT, (180.0 - half, lat)),
        Raster("lonlat from -180", LONLAT, (-180.0 + half, lat)),
        Raster("lonlat across to 181", LONLAT, at),
        Raster("lonlat across from -181", LONLAT, at, turns=-1),
        Raster("UTM 60", utm[0], at),
        Raster("UTM 1", utm[1], at),
        Raster("3857 to 180", "EPSG:3857", (180.0 - half, lat)),
        Raster("3857 across", "EPSG:3857", at),
        Raster("3857 across from -180", "EPSG:3857", at, turns=-1),
        Raster("3832", "EPSG:3832", at),
        Raster("Equal Earth", "EPSG:8857", at),
        Raster("sinusoidal", SINUSOIDAL, at),
    ]


def _pole(sign: int, polar: str, laea: str) -> list[Raster]:
    wide = {"px_m": 25_000.0, "shape": (220, 220)}
    south, north = sorted((sign * 62.0, sign * 90.0))
    return [
        Raster("stereographic", polar, (0.0, sign * 90.0), bounds=(-2.75e6, -2.75e6, 2.75e6, 2.75e6), **wide),
        Raster("LAEA", laea, (0.0, sign * 90.0), bounds=(-2.75e6, -2.75e6, 2.75e6, 2.75e6), **wide),
        Raster("lonlat", LONLAT, px_m=25_000.0, shape=(112, 720), bounds=(-180.0, south, 180.0, north)),
        Raster("lonlat 0 to 360", LONLAT, px_m=25_000.0, shape=(112, 720), bounds=(0.0, south, 360.0, north)),
    ]


def _earth() -> list[Raster]:
    px, disk = 40_000.0, 5.43e6
    west, east = GEOSTATIONARY.format(-137), GEOSTATIONARY.format(-75)
    return [
        Raster("full disk -137", west, px_m=px, shape=(300, 300), bounds=(-disk, -disk, disk, disk)),
        Raster("full disk -75", east, px_m=px, shape=(300, 300), bounds=(-disk, -disk, disk, disk)),
        Raster("sector", west, px_m=px, shape=(130, 180), bounds=(-5.4e6, 0.8e6, 1.1e6, 5.4e6)),
        Raster("lonlat", LONLAT, px_m=px, shape=(450, 900), bounds=(-180.0, -90.0, 180.0, 90.0)),
        Raster("lonlat 0 to 360", LONLAT, px_m=px, shape=(450, 900), bounds=(0.0, -90.0, 360.0, 90.0)),
        Raster(
            "3857", "EPSG:3857", px_m=px, shape=(700, 800), bounds=(-MERCATOR_M, -1.75e7, MERCATOR_M, 1.75e7)
        ),
        Raster(
            "3832", "EPSG:3832", px_m=px, shape=(700, 800), bounds=(-MERCATOR_M, -1.75e7, MERCATOR_M, 1.75e7)
        ),
        Raster(
            "Equal Earth", "EPSG:8857", px_m=px, shape=(420, 860), bounds=(-1.73e7, -8.4e6, 1.73e7, 8.4e6)
        ),
        Raster("sinusoidal", SINUSOIDAL, px_m=px, shape=(480, 960), bounds=(-2.01e7, -1.0e7, 2.01e7, 1.0e7)),
        Raster("3413", "EPSG:3413", px_m=px, shape=(220, 220), bounds=(-5.0e6, -5.0e6, 5.0e6, 5.0e6)),
    ]


def _tile() -> list[Raster]:
    at, side = (-105.0, 45.0), 6371007.181 * np.pi / 18
    left = -8 * side
    return [
        Raster("MODIS tile", SINUSOIDAL, px_m=5_000.0, bounds=(left, 4 * side, left + side, 5 * side)),
        Raster("lonlat", LONLAT, at, 5_000.0),
        Raster("lonlat 0 to 360", LONLAT, at, 5_000.0, turns=1),
        Raster("UTM 13", "EPSG:32613", at, 5_000.0),
        Raster("3857", "EPSG:3857", at, 5_000.0),
        Raster("LAEA", "+proj=laea +lat_0=45 +lon_0=-100 +datum=WGS84 +units=m +no_defs", at, 5_000.0),
        Raster("Equal Earth", "EPSG:8857", at, 5_000.0),
        Raster("sector -75", GEOSTATIONARY.format(-75), at, 5_000.0),
    ]


SCENES: Final = {
    "the earth, 40 km": _earth(),
    "north pole, 25 km": _pole(1, "EPSG:3413", "EPSG:3408"),
    "south pole, 25 km": _pole(-1, "EPSG:3031", "EPSG:3409"),
    "a tile, 5 km": _tile(),
    "180 degrees, 52 N, 100 m": _antimeridian(52.0, ("EPSG:32660", "EPSG:32601")),
    "180 degrees, 17 S, 100 m": _antimeridian(-17.0, ("EPSG:32760", "EPSG:32701")),
}


def crs(_data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield a table for each ground: the shift that is found between every two CRSs, or why there is none."""
    for scene, rasters in SCENES.items():
        references, targets = scratch / scene / "references", scratch / scene / "targets"
        references.mkdir(parents=True)
        targets.mkdir()
        paths = [(each.write(references), each.write(targets, SHIFT_PX)) for each in rasters]
        pairs = [pair[:: 1 if sum(pair) % 2 else -1] for pair in combinations(range(len(rasters)), 2)]
        outcomes = runner([Job(paths[one][0], paths[other][1], SETTINGS) for one, other in pairs])
        yield _table(scene, [(rasters[a].name, rasters[b].name) for a, b in pairs], outcomes)


def _table(scene: str, names: list[tuple[str, str]], outcomes: list[Outcome]) -> Table:
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for (reference, target), outcome in zip(names, outcomes, strict=True):
        if not outcome.accepted:
            reason = outcome.reason or str(outcome.result.reason)
            rows.append([reference, target, 0, "", "", "", reason[:150]])
            continue
        off_px = outcome.points.target_px - outcome.points.predicted_px - SHIFT_PX
        mean, scatter = off_px.mean(axis=0), float(np.sqrt(off_px.var(axis=0).mean()))
        figures = [f"{figure:+.3f}" for figure in mean]
        rows.append([reference, target, len(off_px), *figures, f"{scatter:.3f}", ""])
        checks.append(
            at_most(f"{reference} – {target}: larger axis", float(np.abs(mean).max()), RIGHT_PX, "px")
        )
    header = ("reference", "target", "points", "off col, px", "row", "scatter", "refused")
    return Table(scene, header, rows, checks)
