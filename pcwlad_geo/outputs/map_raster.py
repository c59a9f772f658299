"""Rasters of values that are known anywhere on a grid, computed block by block; that of the sigma."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from affine import Affine

from pcwlad_geo.raster import Grid, map_px
from pcwlad_geo.raster.gdal import small_block_cache
from pcwlad_geo.raster.output_format import write_cog
from pcwlad_geo.raster.writing import scratch_folder, sink
from pcwlad_geo.types import Float64

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.correction.selection import Selection


@dataclass(frozen=True, slots=True)
class MapParameters:
    """Sizes of rasters of values."""

    sigma_side_px: int = 1000
    """Longer side of the sigma raster, px: sigma varies only on the scale of the tie point spacing."""
    block_px: int = 512
    """Side of the blocks in which the displacement field is computed, which limits the memory."""
    covariance_nodes: int = 128
    """Largest number of nodes along an axis between which the covariance is interpolated."""
    spacing_windows: float = 0.25
    """Default spacing of the displacement field in windows: two of its places share most of their pixels."""


MAP_DEFAULTS: Final = MapParameters()
"""As jobs write them."""


class Layer(NamedTuple):
    """A band of such a raster."""

    description: str
    unit: str
    long_name: str = ""
    """Tag of the band, from which programs that read netCDF tell the components of a vector."""


Values = Callable[[Float64], Float64]
"""Maps (n, 2) positions (col, row) of a raster, px, to the (n, bands) values there; NaN where unknown."""
SIGMA_LAYERS: Final = (
    Layer("sigma along column", "px"),
    Layer("sigma along row", "px"),
    Layer("1 beyond the tie points, 0 among them", ""),
)
"""Bands of the sigma raster."""


def write_sigma(
    path: Path,
    precision: Selection,
    target_grid: Grid,
    grid: Grid,
    parameters: MapParameters = MAP_DEFAULTS,
) -> None:
    """Write the sigma of a correction over the registered raster.

    Three bands of float32: sigma along the target's columns and rows, target px, and 1 where the correction
    extrapolates. A pixel covers a square of the registered raster's pixels. If either grid has no CRS, the
    pixels of the registered raster, on `grid`, are the predicted ones of `target_grid`.
    """
    factor = -(-max(grid.shape) // parameters.sigma_side_px)
    places = Squares.every(factor, grid, target_grid)

    def values(centres: Float64) -> Float64:
        at_px = places.predicted_px(centres)
        bands = np.full((len(at_px), 3), np.nan)
        finite = np.isfinite(at_px).all(axis=1)
        bands[finite, :2] = precision.sigma(at_px[finite])
        bands[finite, 2] = precision.extrapolated(at_px[finite])
        return bands

    write_map(path, places, SIGMA_LAYERS, values, block_px=parameters.sigma_side_px)


@dataclass(frozen=True, slots=True)
class Squares:
    """Squares of a grid's pixels, and where the target's georeferencing predicts their middles."""

    grid: Grid
    """Its pixels are the squares."""
    side_px: int
    """Side of a square in pixels of the grid that is divided."""
    target_grid: Grid
    located: bool
    """Whether the divided grid has map coordinates."""
    both_located: bool
    """Whether both have; otherwise pixels of the divided grid are the predicted ones."""

    @classmethod
    def every(cls, side_px: int, grid: Grid, target_grid: Grid) -> Squares:
        """Divide a grid into squares, from its first pixel on; the last ones may reach beyond it."""
        shape = (-(-grid.shape[0] // side_px), -(-grid.shape[1] // side_px))
        coarse = grid.resampled_grid(((side_px, 0.0), (0.0, side_px)), (0.0, 0.0), shape)
        return cls(coarse, side_px, target_grid, grid.located, grid.located and target_grid.located)

    @property
    def transform(self) -> Affine:
        """The geotransform to write; without map coordinates that of the pixel plane, y = -row."""
        return self.grid.transform if self.located else Affine.scale(self.side_px, -self.side_px)

    def predicted_px(self, centres: Float64) -> Float64:
        """Map (n, 2) `centres` (col, row) of the raster to predicted target px; NaN where there is none."""
        return map_px(centres, self.grid, self.target_grid) if self.both_located else centres * self.side_px


def write_map(
    path: Path,
    places: Squares,
    layers: Sequence[Layer],
    values: Values,
    *,
    block_px: int,
    tags: Mapping[str, str] | None = None,
    dtype: str = "float32",
) -> None:
    """Write a COG of floats with NaN for nodata, block by block: the memory does not grow with the raster.

    The `values` compute the bands, described by the `layers`, at the middles of pixels.
    """
    rows, cols = places.grid.shape
    profile = {"driver": "GTiff", "dtype": dtype, "nodata": np.nan, "count": len(layers)}
    profile |= {"height": rows, "width": cols, "tiled": True, "bigtiff": "IF_SAFER"}
    profile |= {"crs": places.grid.crs, "transform": places.transform}
    with scratch_folder(path) as scratch, small_block_cache():
        with sink(str(scratch / "pixels.tif"), profile) as file:
            for row in range(0, rows, block_px):
                for col in range(0, cols, block_px):
                    shape = min(block_px, rows - row), min(block_px, cols - col)
                    down, across = np.indices(shape)
                    first = np.stack([across + col, down + row], axis=-1).reshape(-1, 2)
                    centres = first.astype(np.float64) + 0.5
                    block = values(centres).T.reshape(len(layers), *shape)
                    file.write(block.astype(dtype), window=((row, row + shape[0]), (col, col + shape[1])))
            for band, layer in enumerate(layers, start=1):
                file.set_band_description(band, layer.description)
                file.set_band_unit(band, layer.unit)
                if layer.long_name:
                    file.update_tags(band, long_name=layer.long_name)
            file.update_tags(**(tags or {}))
        write_cog(scratch / "pixels.tif", path)
