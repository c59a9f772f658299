"""The correction of one band applied to another of the same sensor, at its own pixel size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.raster import warping
from pcwlad_geo.raster.grid import Grid, map_px
from pcwlad_geo.raster.source import describe

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SeenFrom:
    """A correction in the px of another raster that lies on the same ground as the target."""

    correction: Correction
    """In the target's px."""
    target: Grid
    own: Grid

    @property
    def name(self) -> str:
        """The model's name."""
        return self.correction.name

    def forward(self, predicted_px: Array) -> Array:
        """Map (n, 2) predicted to observed px of the other raster."""
        moved = self.correction.forward(map_px(predicted_px, self.own, self.target))
        return map_px(moved, self.target, self.own)

    def inverse(self, observed_px: Array) -> Array:
        """Map (n, 2) observed to predicted px of the other raster."""
        moved = self.correction.inverse(map_px(observed_px, self.own, self.target))
        return map_px(moved, self.target, self.own)

    def to_dict(self) -> dict[str, object]:
        """Return the model in the target's px."""
        return self.correction.to_dict()


def warp_other_band(
    source: str,
    out_path: Path,
    correction: AffineCorrection,
    reference_grid: Grid,
    target_grid: Grid,
    *,
    mode: Literal["reference", "target"] = "reference",
    resampling: str = "cubic",
    progress: warping.ProgressCallback | None = None,
) -> None:
    """Warp another band of the target as the registered one was, and write a COG.

    Parameters
    ----------
    source : str
        Path or GDAL URI of the band; its pixels may have another size and corner.
    out_path : pathlib.Path
    correction : AffineCorrection
        Of the registered target, in its px.
    reference_grid, target_grid : Grid
        Of the registered pair.
    mode, resampling
        As for `warping.output_grid` and `warping.warp`.
    progress : callable, optional
        Receives done, total.

    Raises
    ------
    InputError
        If the band cannot be read, or lies in another CRS than the target.
    OutputError
        If the result cannot be written.
    """
    own = describe(source).grid
    grid = warping.output_grid(reference_grid, own, SeenFrom(correction, target_grid, own), mode)
    warping.warp(source, out_path, correction, grid, resampling, target_grid=target_grid, progress=progress)
