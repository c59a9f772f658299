"""The tuned numbers of a block: of its adjustment, and of the check of its DEM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class BlockParameters:
    """Numbers of the adjustment; the study of RPC blocks in the benchmarks prints what they give."""

    ground_cells: int = 5
    """The ground is divided into so many cells along each axis, which are left out in turn: fewer where they
    would be smaller than a pixel of the DEM, whose error neighbours would share."""
    prior_shared_px: float = 0.03
    """Standard deviation of the error that the points of a pair share, where no cycle tells it."""
    least_shared_px: float = 0.01
    """Least standard deviation of that error where cycles tell it."""
    min_total_redundancy: float = 0.3
    """Least sum of the redundancies of all pairs with which that error is estimated from their cycles."""
    min_sigma_redundancy: float = 0.1
    """Redundancies below this are taken as this in the sigma of a pair."""
    datum_defect: float = 1e-5
    """Combinations of biases of less information than this share of the best known one are a matter of
    datum."""
    outlier_sigmas: float = 5.0
    """A pair that lies off all others by more sigmas may be an outlier."""
    outlier_share: float = 0.5
    """It is, if without it the others contradict each other by less than this share."""
    dem_position_m: float = 100.0
    """Standard deviation of the horizontal position of a DEM, as weak as errors of a datum are large."""
    dem_shift_sigmas: float = 5.0
    """A DEM stays where it is, unless the relief tells by more sigmas that it lies elsewhere."""
    height_limit: float = 0.2
    """Heights off by more of their standard deviations count by their sign: what the ground of most points
    tells is their median, whatever lies on the rest (forest, cliffs, cells of a coarse DEM)."""
    control_power: int = 3
    """Power of the robust factors of control points: they are a few, set one by one, and a wrong one must not
    pull at all."""
    min_cells: int = 6
    """Least number of cells that may speak for a more flexible model."""
    min_gain_px: float = 0.05
    """Least RMSE by which a more flexible model must predict them better."""
    max_pair_points: int = 3000
    """Largest number of tie points of a pair in the adjustment, spread evenly."""


BLOCK: Final = BlockParameters()
"""The numbers in use."""


@dataclass(frozen=True, slots=True)
class DemCheckParameters:
    """Numbers by which the errors of a DEM are reported."""

    significance: float = 0.1
    """Probability below which biases that all lie along the parallax are not taken for those of RPCs."""
    min_separation_px: float = 4.0
    """Least disagreement of two images by which a DEM is called too high or too low."""
    min_offset_px: float = 3.0
    """A DEM is called displaced by at least so many of its pixels, or of the images', if significant."""
    min_offset_m: tuple[float, float] = (3.0, 10.0)
    """The least displacement in metres: of a block that a reference or control points fix, and of others, as
    the RPCs of all images may err alike."""
    min_scale: float = 0.03
    """Least error of the scale of heights that is reported."""
    scale_sigmas: float = 5.0
    """It is reported beyond so many sigmas."""
    scale_cells: int = 6
    """The ground has so many cells along its longer side, and the scale needs points in as many cells."""
    min_relief: float = 10.0
    """Least relief, in standard deviations of a point's height, that tells of the scale."""
    rough_px: float = 2.0
    """Least distance of two orthoimages by the scatter of a DEM's heights that is reported."""


DEM_CHECK: Final = DemCheckParameters()
"""The numbers of the check in use."""
