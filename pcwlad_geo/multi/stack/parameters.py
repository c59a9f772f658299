"""The tuned numbers of a stack: of its pairs, of their adjustment, and of the grades of its images."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from pcwlad_geo.registration import QualityParameters
from pcwlad_geo.registration.motions import MotionParameters


@dataclass(frozen=True, slots=True)
class PairParameters:
    """Numbers of the pairs of a stack."""

    small_tiles: int = 4
    """Largest number of tiles of a pair that is matched as a whole, in one of several processes."""
    min_points: int = 12
    """Least number of tie points of a pair."""
    square_px: float = 60.0
    """Side of the squares by whose number the evidence of a pair is measured, px of the frame."""
    motions: MotionParameters = field(default_factory=MotionParameters)
    """Those of the displacements of single pairs."""
    product_sigma_m: float = 5.0
    """Standard deviation of the misregistration of two bands of a product along an axis, metres. The
    requirements of Landsat 8 (LE90 4.5 m, thermal bands 30 m) and Sentinel-2 (0.3 px at three sigmas) lie on
    both sides."""


@dataclass(frozen=True, slots=True)
class ControlParameters:
    """Numbers of control points."""

    min_points: int = 4
    """Least number of control points of an image."""
    min_sigma_px: float = 1e-3
    """Least standard deviation of a control point, px of the frame: no position in an image is known
    better."""
    sigma_px: float = 0.5
    """Standard deviation of a control point for which the table has none, px of the frame."""
    evidence: float = 50.0
    """Evidence of the control points of an image: that of a pair with points in this number of squares."""


@dataclass(frozen=True, slots=True)
class SplineParameters:
    """Numbers of the splines by which images are displaced."""

    cells: int = 4
    """Cells of a spline along the longer side of the ground."""
    roughness: tuple[float, float, float] = (0.1, 1.0, 10.0)
    """Bendings of a spline that are tried, map units over the side of a cell: of the deviation of
    neighbouring coefficients from a plane, standard deviation."""


@dataclass(frozen=True, slots=True)
class AdjustmentParameters:
    """Numbers of the adjustment of all images; the study of stacks in the benchmarks prints their effect."""

    min_shared: float = 1.0
    """Least value of `Adjustment.shared`."""
    max_rounds: int = 20
    """Largest number of iterations in which pairs are selected and weighted."""
    freedom: int = 8
    """Degrees of freedom of the sigma of a pair, which a few blocks estimate to a quarter of its value."""
    alpha: float = 0.01
    """Probability that any pair of a stack is left out where all are right."""
    min_redundancy: float = 0.1
    """Least redundancy of the pairs that the shared error is estimated from."""
    min_sigma_redundancy: float = 0.01
    """Redundancies below this are taken as this in the sigma of a pair."""
    feature_px: float = 0.5
    """Points that lie nearer to each other in an image are of one feature, px of the frame."""
    blocks: int = 3
    """An image is divided into so many blocks along each axis, which are left out in turn."""
    max_growth: float = 1e4
    """Coefficients so many times as large as what is observed are those of a singular matrix."""
    max_images_to_choose: int = 40
    """Largest number of images that the model is chosen by: those connected to the datum by the fewest
    pairs."""

    @property
    def median_sigmas(self) -> float:
        """Median of the length of the offset of a right pair, sigmas, by the distribution of `critical`."""
        return math.sqrt(self.freedom * (2.0 ** (2 / self.freedom) - 1))


@dataclass(frozen=True, slots=True)
class HomographyParameters:
    """Numbers of the homographies of frames without georeferencing."""

    max_ratio: float = 0.9
    """Homographies are used where their residuals are smaller than those of affines by this ratio at
    least."""
    flexible_ratio: float = 2**0.5
    """The same where a more flexible model than an affine was chosen: their squares may be twice as large."""
    min_epipolar_share: float = 0.5
    """Least share of the points of a pair that an epipolar geometry must keep."""


@dataclass(frozen=True, slots=True)
class GradeParameters:
    """Numbers of the closure of cycles and of the grades of images."""

    max_cycles: int = 20_000
    """Largest number of cycles that are looked at."""
    max_open_cycles: int = 30
    """Largest number of cycles that are listed."""
    open_sigmas: float = 5.0
    """A cycle that fails to close by more sigmas is listed."""
    supported_share: float = 1 / 2
    """An image is refused unless a larger share of its pairs supports its place."""
    contradicted_share: float = 1 / 3
    """Share of the pairs of an image off its place from which it is not good: pairs may share a cause."""
    min_cause_px: float = 0.05
    """Least part of the expected error of an image that is named."""
    min_redundancy: float = 0.1
    """Least redundancy of a pair that others check."""
    quality: QualityParameters = field(default_factory=QualityParameters)
    """Those of the grades of single pairs."""


PAIR: Final = PairParameters()
"""The numbers of pairs in use."""
CONTROL: Final = ControlParameters()
"""The numbers of control points in use."""
SPLINES: Final = SplineParameters()
"""The numbers of splines in use."""
ADJUSTMENT: Final = AdjustmentParameters()
"""The numbers of the adjustment in use."""
HOMOGRAPHIES: Final = HomographyParameters()
"""The numbers of homographies in use."""
GRADING: Final = GradeParameters()
"""The numbers of grades in use."""
