"""What the figures must reach, from the runs of one benchmark."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from benchmarks.speed_studies import whole_scenes as w
from benchmarks.speed_studies.truth import LATTICE
from benchmarks.tables import Check, at_least, at_most, within

SIDE_PX: Final = 4096
LARGE_PX: Final = 16384


def checks_of_scenes(results: w.Results, bank_wall_s: float, warp_s: float = math.nan) -> Iterator[Check]:
    """Yield the checks that the measured modes and sizes allow.

    Parameters
    ----------
    results : Results
    bank_wall_s : float
        Wall time of the bare filter bank of the whole scene of SIDE_PX.
    warp_s : float
        Wall time of GDAL's own warp of the scene of LARGE_PX. NaN: not measured.
    """
    yield from _against_arosics(results)
    yield from _all_points(results, bank_wall_s)
    yield from _growth(results)
    if LARGE_PX in results.sizes(w.REGISTER) and not math.isnan(warp_s):
        outside_s = results.wall_s(w.REGISTER, LARGE_PX) - results.inner_s(w.REGISTER, LARGE_PX)
        what = f"{w.REGISTER}, {LARGE_PX}²: wall time but for the matching / gdalwarp and COG"
        yield at_most(what, outside_s / warp_s, 1.1)
    if pclsm := results.sizes(w.PCLSM):
        yield within("RMSE of pclsm", results.rmse_px(w.PCLSM, pclsm[-1]), 0.15, 0.4, "px", digits=2)


def _against_arosics(results: w.Results) -> Iterator[Check]:
    peer_s = results.inner_s(w.AROSICS, SIDE_PX)
    peer_px = results.rmse_px(w.AROSICS, SIDE_PX)
    if math.isnan(peer_s):
        return
    for mode, time_limit, error_limit in (
        (w.MATCH, 0.38, 0.7),
        (w.GRADIENT, 0.22, 1.0),
        (w.REGISTER, 0.48, None),
    ):
        if SIDE_PX not in results.sizes(mode):
            continue
        ratio = results.wall_s(mode, SIDE_PX) / peer_s
        yield at_most(f"{mode}, {SIDE_PX}²: wall time / AROSICS' call", ratio, time_limit)
        ratio = results.cpu_s(mode, SIDE_PX) / results.inner_cpu_s(w.AROSICS, SIDE_PX)
        yield at_most(f"{mode}, {SIDE_PX}²: CPU time / AROSICS' call", ratio, time_limit)
        if error_limit:
            ratio = results.rmse_px(mode, SIDE_PX) / peer_px
            yield at_most(f"{mode}, {SIDE_PX}²: RMSE / AROSICS'", ratio, error_limit)


def _all_points(results: w.Results, bank_wall_s: float) -> Iterator[Check]:
    sizes = [size for size in results.sizes(w.ALL) if size >= 2048]
    if SIDE_PX in sizes:
        ratio = results.wall_s(w.ALL, SIDE_PX) / bank_wall_s
        yield at_most(f"{w.ALL}, {SIDE_PX}²: wall time / bare filter bank", ratio, 2.2)
        yield at_least(
            f"{w.ALL}, {SIDE_PX}²: correct points", results.count("correct", w.ALL, SIDE_PX), 15_000, digits=0
        )
    for size in sizes:
        what = f"{w.ALL}, {size}²: peak memory"
        yield at_most(what, results.peak_mb(w.ALL, size), 1000, "MB", digits=0)
    if len(sizes) > 1:
        growth = results.cpu_s(w.ALL, sizes[-1]) / results.cpu_s(w.ALL, sizes[0])
        exponent = math.log(growth) / math.log((sizes[-1] / sizes[0]) ** 2)
        yield at_most(f"{w.ALL}, {sizes[0]}² to {sizes[-1]}²: exponent of CPU time by area", exponent, 1.05)


def _growth(results: w.Results) -> Iterator[Check]:
    for mode in (w.MATCH, w.REGISTER):
        for size in sorted({SIDE_PX, LARGE_PX} & set(results.sizes(mode))):
            what = f"{mode}, {size}²: "
            yield at_most(what + "peak memory", results.peak_mb(mode, size), 1500, "MB", digits=0)
            if mode == w.MATCH:
                cells = results.count("cells", mode, size)
                yield at_least(what + f"cells of {LATTICE} x {LATTICE}", cells, 64, digits=0)
    for mode in (w.MATCH, w.REGISTER):
        if {SIDE_PX, LARGE_PX} <= set(results.sizes(mode)):
            what = f"{mode}, {SIDE_PX}² to {LARGE_PX}²: "
            growth = results.peak_mb(mode, LARGE_PX) / results.peak_mb(mode, SIDE_PX)
            yield at_most(what + "growth of memory", growth, 1.2)
            if mode == w.MATCH:
                growth = results.inner_s(mode, LARGE_PX) / results.inner_s(mode, SIDE_PX)
                yield at_most(what + "growth of the matching time", growth, 1.5)
