"""The predicted sigma of a correction as a raster."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.raster.grid import Grid, map_px
from pcwlad_geo.raster.quiet import ignoring

Array = NDArray[np.float64]

MOST_PX = 1000
"""Longer side of the raster: sigma is as smooth as the tie points are wide apart."""
DESCRIPTIONS = ("sigma along column", "sigma along row", "1 beyond the tie points, 0 among them")


class Precision(Protocol):
    """How good a correction is anywhere."""

    def sigma(self, at_px: Array) -> Array:
        """Return the standard deviation (col, row) at (n, 2) predicted px: (n, 2), px."""

    def extrapolated(self, at_px: Array) -> NDArray[np.bool_]:
        """Return whether (n, 2) predicted px lie beyond the tie points."""


def write(path: Path, precision: Precision, target_grid: Grid, grid: Grid) -> None:
    """Write the sigma of a correction over the registered raster.

    Three bands of float32: sigma along the target's columns and rows, target px, and 1 where the correction
    extrapolates. A pixel stands for a square of the registered raster's.

    Parameters
    ----------
    path : pathlib.Path
    precision : Precision
        Of the correction.
    target_grid : Grid
        The grid whose pixels the correction speaks of.
    grid : Grid
        Of the registered raster; where either has no CRS, its pixels are the predicted ones.
    """
    factor = -(-max(grid.shape) // MOST_PX)
    shape = (-(-grid.shape[0] // factor), -(-grid.shape[1] // factor))
    coarse = grid.remade(((factor, 0.0), (0.0, factor)), (0.0, 0.0), shape)
    rows, cols = np.indices(shape)
    centres = np.asarray(np.stack([cols, rows], axis=-1).reshape(-1, 2) + 0.5, dtype=np.float64)
    placed = grid.located and target_grid.located
    at_px = map_px(centres, coarse, target_grid) if placed else centres * factor
    bands = np.full((3, len(at_px)), np.nan, dtype=np.float32)
    known = np.isfinite(at_px).all(axis=1)
    bands[:2, known] = precision.sigma(at_px[known]).T
    bands[2, known] = precision.extrapolated(at_px[known])
    profile = {"driver": "GTiff", "count": 3, "dtype": "float32", "height": shape[0], "width": shape[1]}
    # Without a CRS the pixel plane, y = -row.
    transform = coarse.transform if placed else Affine.scale(factor, -factor)
    options = {"compress": "deflate", "predictor": 3, "tiled": True, "nodata": np.nan}
    with ignoring(NotGeoreferencedWarning):  # of the pixel plane
        file = rasterio.open(path, "w", **profile, **options, crs=coarse.crs, transform=transform)
    with file:
        file.write(bands.reshape(3, *shape))
        for band, (description, unit) in enumerate(zip(DESCRIPTIONS, ("px", "px", ""), strict=True), start=1):
            file.set_band_description(band, description)
            file.set_band_unit(band, unit)
