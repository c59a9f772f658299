"""The images and tie points of a block of RPCs, in the pixels of their files."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pcwlad_geo.correction.fit import LOSSLESS
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.multi.block.parameters import BLOCK, BlockParameters
from pcwlad_geo.raster import Dem, Grid, RpcGrid, at_mean_height, jacobian
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True, eq=False)
class BlockPair:
    """Tie points of two images in the pixels of their files; the ground itself may be one of the two."""

    first: int
    second: int
    first_px: Float64
    """(n, 2) observed pixels (col, row) of the first image."""
    second_px: Float64
    """(n, 2) those of the same places in the second image."""
    covariance_px2: Float64
    """(n, 2, 2) covariance of the second, given the first, px²."""
    height_m: Float64 | None = None
    """(n,) heights of control points above the ellipsoid; NaN, and None for tie points: those of the DEM."""
    window_px: float = 0.0
    """Side of the windows in which they were matched, px of the frame; 0: points tell of their own places."""

    def __len__(self) -> int:
        return len(self.first_px)


@dataclass(frozen=True, slots=True)
class ImageTerms:
    """Terms 1, column, row, the last two from -1 to 1 over an image."""

    centre_px: tuple[float, float]
    radius_px: float

    @staticmethod
    def over(shape: tuple[int, int]) -> ImageTerms:
        """Return the basis of an image of `shape` (rows, columns)."""
        rows, cols = shape
        return ImageTerms((cols / 2, rows / 2), max(rows, cols) / 2)

    def values(self, at_px: Float64) -> Float64:
        """Return the (n, 3) terms at the (n, 2) `at_px` (col, row)."""
        return np.column_stack([np.ones(len(at_px)), (at_px - self.centre_px) / self.radius_px])

    def correction(self, parameters: Float64, model: str) -> AffineCorrection:
        """Return the correction of the (terms, 2) `parameters` of a model, px."""
        full = np.zeros((3, 2))
        full[list(LOSSLESS[model])] = parameters
        slope = full[1:].T / self.radius_px
        shift = full[0] - slope @ np.array(self.centre_px)
        return AffineCorrection(model, np.column_stack([np.eye(2) + slope, shift]))


@dataclass(frozen=True, slots=True)
class RpcBlock:
    """The images of a block and the frame in which the ground is given."""

    grids: tuple[Grid, ...]
    """RPC grids of the images; plain ones of a reference, and of the ground for control points."""
    frame: Grid
    fixed: frozenset[int] = field(default_factory=frozenset)
    """Numbers of the images with an RPC that stay."""
    parameters: BlockParameters = BLOCK

    @property
    def dem(self) -> Dem | None:
        """The DEM of the RPC grids."""
        heights = (grid.heights for grid in self.grids if isinstance(grid, RpcGrid))
        return next((model for model in heights if isinstance(model, Dem)), None)

    @property
    def free(self) -> tuple[int, ...]:
        """The images whose RPC is corrected."""
        images = [number for number, grid in enumerate(self.grids) if isinstance(grid, RpcGrid)]
        return tuple(number for number in images if number not in self.fixed)


def pixel_in_frame(block: RpcBlock, image: int) -> float:
    """Return the size of a pixel in the middle of an image, px of the frame."""
    grid = at_mean_height(block.grids[image])
    return float(np.sqrt(abs(np.linalg.det(jacobian(grid.middle_px, grid, block.frame)[0]))))
