"""Geolayers: the corrected longitude and latitude of each pixel of a target, which other programs warp by."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from affine import Affine

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.outputs.map_raster import MAP_DEFAULTS, Layer, Squares, write_map
from pcwlad_geo.raster import WGS84, Grid, transform_xy
from pcwlad_geo.types import Float64

LAYERS: Final = (Layer("longitude", "degree"), Layer("latitude", "degree"))
"""The bands, of WGS 84."""


def write_lon_lat(path: Path, correction: Correction, target: Grid) -> None:
    """Write where the middles of the pixels of a target lie once corrected, longitude and latitude of WGS 84.

    Two bands of float64 on the target's pixels; NaN where it has no georeferencing.
    """

    def values(centres: Float64) -> Float64:
        return transform_xy(target.corrected_xy(centres, correction.inverse), target.crs, WGS84)

    plain = Grid(target.shape, Affine.identity(), None)
    pixels = Squares(plain, 1, plain, located=False, both_located=False)
    write_map(path, pixels, LAYERS, values, block_px=MAP_DEFAULTS.block_px, dtype="float64")
