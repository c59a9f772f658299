"""The tuned numbers of rigs: of learning, of lenses, of the adjustment, and of placing a capture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class LearningParameters:
    """Numbers of learning; the study of rigs in the benchmarks prints what they give."""

    most_captures: int = 30
    """Largest number of captures to learn from; more are thinned out evenly."""
    search_radii_px: tuple[int, int, int] = (7, 4, 3)
    """Search radius of each later round. There are several, as windows cut by the edge of a frame are biased
    towards the prediction."""
    least_distortion_sigma_px: float = 0.03
    """Standard deviation of distortion per axis that more points do not lessen: that of aliased detail,
    which is displaced with the grid of px."""
    focal_sigma: tuple[float, float] = (0.01, 0.15)
    """Expected relative deviation of the focal length: with metadata of it, and without."""
    centre_sigma: tuple[float, float] = (0.004, 0.02)
    """Expected deviation of the principal point, as a share of the frame's longer side: calibrated, and
    not."""
    radial_sigma_px: tuple[float, float] = (1.0, 40.0)
    """Expected deviation of each radial term at the corners of frames of 1280 px: calibrated, and not."""
    tangential_sigma_px: tuple[float, float] = (0.5, 6.0)
    """Expected deviation of the tangential terms at the corners of frames of 1280 px: calibrated, and
    not."""
    overlap_sigma_factors: tuple[float, ...] = (1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 1.0, 1.0)
    """(8,) factor on the sigmas of a lens where captures overlap, which determines the radial terms."""
    rotation_sigma_rad: float = 0.15
    """Expected rotation of a lens to the reference."""
    baseline_sigma: tuple[float, float, float] = (0.004, 0.004, 0.001)
    """Expected baseline over the mean distance; the lenses of a rig lie in one plane, nearly."""
    slope_sigma: float = 0.2
    """Expected slopes of inverse depth by direction."""
    inverse_depth_sigma: tuple[float, float] = (0.15, 0.6)
    """Expected relative deviation of the inverse depth of a capture: with its height in metadata, and
    without."""
    start_side_px: int = 360
    """Longer side of the frames in which approximate rotations are searched."""
    coarse_side_px: int = 480
    """Longer side of the frames in the first round of matching, from approximate rotations."""
    start_captures: int = 4
    """Number of captures in which an approximate rotation is searched."""
    focal_ratio_spread: tuple[float, float] = (1.3, 2.2)
    """Factor within which the ratio of two focal lengths is searched: where metadata have both, and
    otherwise."""
    focal_factors: tuple[float, ...] = tuple(float(1.08**step) for step in sorted(range(-9, 10), key=abs))
    """Factors on a focal length without metadata that are tried, the likely ones first."""
    min_start_points: int = 16
    """Least number of points that agree on an approximate rotation."""
    start_agree_px: float = 2.5
    """Distance within which they agree, px of the small frames."""
    min_overlap_points: int = 25
    """Least number of features that agree on the overlap of two captures."""
    window_share: tuple[float, float] = (0.2, 0.1)
    """Side of the windows as a share of the frame's shorter side: usually, and after the first round where
    captures overlap. Smaller windows reach nearer to the corners, where distortion is largest, but are too
    noisy for a single capture."""
    margin_share: float = 0.3
    """Least distance from the edges of a frame, as a share of the window, of points between captures and of
    those with small windows: obliqueness deforms windows, and windows cut by more are biased inwards."""
    min_lens_points: int = 20
    """Least number of tie points of a lens in a capture."""
    overlap_sigma_px: float = 0.05
    """Standard deviation of points between captures, across their parallax. That of their matching is mostly
    relief within the windows, which displaces them along the parallax only."""


@dataclass(frozen=True, slots=True)
class AdjustmentParameters:
    """Numbers of the adjustment; the study of rigs in the benchmarks prints what they give."""

    max_steps: int = 14
    """Largest number of Gauss–Newton steps."""
    lenient_steps: int = 3
    """Steps, from the first on, in which the limit of outliers is wider, as the state is not yet
    accurate."""
    least_sigma_ratio: float = 0.2
    """Least ratio of the estimated sigma of a lens's points to that of their matching."""
    outlier_sigmas: float = 6.0
    """Points with residuals beyond this number of sigmas, and `least_outlier_px`, are outliers."""
    least_outlier_px: float = 0.6
    """Points with residuals below this are never outliers."""
    model_sigma_px: float = 0.06
    """Standard deviation of model errors and of differences between bands, added to that of every point."""
    relief_sigma_px: float = 0.1
    """Standard deviation of the relief, as parallax of the lens with the longest baseline."""
    relief_sigma_limits: tuple[float, float] = (0.02, 0.3)
    """Smallest and largest standard deviation of the relief, in inverse depth."""
    max_relief: float = 0.5
    """Largest relief of a point, in inverse depth."""
    max_relief_sigmas: float = 3.0
    """Largest relief of a point, in standard deviations of the relief of all."""
    mean_depth_sigma: float = 0.001
    """Standard deviation of the mean inverse depth of all captures from 1: it fixes the unit of the
    baselines."""


@dataclass(frozen=True, slots=True)
class LensParameters:
    """Numbers of the projection of a lens."""

    newton_steps: int = 12
    """Largest number of Newton steps of the inverse projection; any sensible frame needs fewer."""
    max_corner_ratio: float = 1.6
    """Largest radius of a direction that is projected, over that of the corners of the frame."""
    max_fisheye_rad: float = 1.5
    """Largest angle to the axis of a fisheye lens; at π/2 its tangent is infinite."""
    max_side_px: int = 20_000
    """Largest number of rows or columns of a frame; the largest cameras have 15,000."""


@dataclass(frozen=True, slots=True)
class CaptureParameters:
    """Numbers by which a capture is placed and judged; the study of rigs prints what they give."""

    cells: int = 160
    """Number of cells of a frame, each with at most one place that is measured in every lens."""
    min_agreeing_share: float = 0.3
    """Least share of the places of a lens that agree with the rig."""
    min_places: int = 12
    """Least number of them that agree."""
    agree_px: float = 1.0
    """Distance from the model within which a place agrees, px of the measured frame."""
    least_sigma_px: float = 0.05
    """Least standard deviation of a place, px of the measured frame."""
    distance_ratio: float = 6.0
    """How many times nearer than the nearest capture learned from, or farther than the farthest, is
    plausible."""
    chance_ratio: float = 0.55
    """Median distance of the agreeing places of a lens, over `agree_px`, from which they agree by chance:
    that of uniformly distributed places is 0.7."""
    test_window_share: float = 0.6
    """Side of the windows that test a capture, as a share of those of the fit: objects off the plane of the
    ground may be small."""
    reach_px: int = 12
    """Search radius of a displaced place, px of the measured frame."""
    displaced_correlation: float = 0.1
    """Least gain of correlation over that near the prediction for a place to count as displaced: repetitive
    structure, as rows of plants, gains less."""
    code_share: float = 0.04
    """Least side of a panel's code, as a share of the frame's longer side: in flight that is metres."""
    blurred_share: float = 0.55
    """Share of the least detail learned below which a frame is blurred."""
    covered_share: float = 0.12
    """Share of the contrast learned below which a lens is covered."""
    panel_ratio: float = 1.5
    """Captures that are nearer than the nearest capture learned from by this factor are searched for a
    panel."""
    min_crop_px: int = 64
    """Least side of the part of the frame that all lenses see, px, or"""
    min_crop_share: float = 0.3
    """as a share of the frame's side: rigs with less are refused."""
    captures_a_core: int = 16
    """Number of captures for each core after which the summary is written."""


LEARNING: Final = LearningParameters()
"""Those in use."""
ADJUSTMENT: Final = AdjustmentParameters()
"""Those in use."""
LENS: Final = LensParameters()
"""Those in use."""
CAPTURE: Final = CaptureParameters()
"""Those in use."""
