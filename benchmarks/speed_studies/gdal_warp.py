"""What GDAL's own programs need for the pixels that `register` writes: gdalwarp and the COG driver."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

from benchmarks.speed_studies.processes import measure
from benchmarks.speed_studies.scene_files import ORIGIN_XY_M, PIXEL_M, ScenePair

SHIFT_M = 3.7
"""Beside the grid, so that pixels are interpolated; a shift is the cheapest correction there is."""


def warp_s(pair: ScenePair, scratch: Path) -> float:
    """Return the wall time of `gdalwarp -multi` and `gdal_translate -of COG` of the target; NaN without them.

    Resampling, compression and overviews are those of `register`.
    """
    if not (shutil.which("gdalwarp") and shutil.which("gdal_translate")):
        return math.nan
    moved, warped, cog = (str(scratch / name) for name in ("moved.vrt", "warped.tif", "cog.tif"))
    west, north = ORIGIN_XY_M
    side_m = pair.side_px * PIXEL_M
    corners = [west + SHIFT_M, north - SHIFT_M, west + side_m + SHIFT_M, north - side_m - SHIFT_M]
    extent = [west, north - side_m, west + side_m, north]
    warp = "gdalwarp -q -overwrite -multi -wo NUM_THREADS=ALL_CPUS -r lanczos -co TILED=YES"
    made = "gdal_translate -q -of COG -co COMPRESS=DEFLATE -co PREDICTOR=YES -co NUM_THREADS=ALL_CPUS"
    commands = [
        ["gdal_translate", "-q", "-of", "VRT", "-a_ullr", *map(str, corners), str(pair.target), moved],
        [*warp.split(), "-tr", *[str(PIXEL_M)] * 2, "-te", *map(str, extent), moved, warped],
        [*made.split(), "-co", "OVERVIEW_RESAMPLING=AVERAGE", warped, cog],
    ]
    total_s = 0.0
    for command in commands:
        cost = measure(command, folder=scratch)
        if cost.status:
            raise RuntimeError(f"{command[0]}: {cost.reason}")
        total_s += cost.wall_s
    for path in (moved, warped, cog):
        Path(path).unlink()
    return total_s
