"""The tuned numbers of the search for a pose; the tuning log of the documentation says what was tried."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final


@dataclass(frozen=True, slots=True)
class StructureParameters:
    """Numbers of the correlation of two images in cells, over rotations, ratios of sizes, and shifts."""

    cells: int = 112
    """Longer side of the larger image, in cells of the correlation."""
    pixels_per_cell: tuple[float, ...] = (3.0,)
    """Channels are computed at so many pixels a cell, a layer each, and averaged."""
    angle_step_deg: float = 4.0
    """Step of the rotations; half of it moves the border of the image by two cells."""
    scale_step: float = 1.08
    """Ratio of one scale to the next; half of it moves the border of the image by two cells."""
    small_ratio: float = 0.5
    """Up to this share of the larger image, both steps are twice as large: the border moves no farther."""
    scales: tuple[float, float] = (0.25, 4.0)
    """Smallest and largest scale, target px per reference px."""
    least_overlap: float = 0.25
    """Least overlap of a pose, as a share of the smaller image's valid area."""
    least_cells: float = 16.0
    """Least overlap of a pose, cells."""
    distinct_distance: float = 0.08
    """Two poses are distinct if they place an image this share of its longer side apart, on average."""
    refined: int = 16
    """Number of distinct poses that are tried with finer steps."""
    fine_cells: int = 160
    """Longer side of the larger image, in cells of the correlation with finer steps."""
    fine_steps: int = 3
    """Number of fine steps to a coarse one."""
    reach_cells: int = 3
    """Largest change of the shift by the finer steps."""
    remembered: int = 8
    """Number of resolutions at which the averaged harmonics of an image are remembered."""
    batch: int = 2**16
    """Largest number of scores computed together, to stay in the cache; those of one rotation may be more."""


@dataclass(frozen=True, slots=True)
class EvidenceParameters:
    """How far a score must stand out of others, in powers of ten of the probability of chance."""

    least: float = 2.0
    """Least evidence of a pose that is worth a match; tie points alone would accept a chance pose of many."""
    most: float = 4.0
    """Largest evidence that a score can give by itself: the tie points must give the rest."""
    per_ratio: float = 8.0
    """Evidence for a pose whose score is twice that of its best rival."""
    per_ascended_ratio: float = 5.0
    """The same of scores that ascended."""


@dataclass(frozen=True, slots=True)
class AffineParameters:
    """Numbers of the search for affine poses: similarities of stretched images, which ascend."""

    stretches: tuple[tuple[float, int, float], ...] = ((1.0, 1, 0.0), (1.17, 4, 0.0), (1.4, 8, 0.5))
    """Ratios of the axes of a stretched image, in how many directions, and the first of these, in steps."""
    scales: tuple[float, float] = (0.5, 2.0)
    """Smallest and largest scale of a pose of a stretched image, target px per reference px."""
    cells: int = 40
    """Longer side of the larger image, in cells of the correlation with a stretched one."""
    angle_step_deg: float = 8.0
    """Step of the rotations of a stretched image."""
    scale_step: float = 1.16
    """Ratio of one scale of a stretched image to the next."""
    layers_px: tuple[float, ...] = (168.0, 336.0)
    """Sides of the images whose channels are averaged to the cells of stretched images and of ascents."""
    most_starts: int = 96
    """Largest number of distinct poses of a stretched image that ascend."""
    close_distance: float = 0.05
    """Distance at which these are distinct, as `StructureParameters.distinct_distance`."""
    ascent_cells: tuple[int, ...] = (56, 112)
    """Cells on which they ascend, and on which those that are the best and distinct ascend once more."""
    rounds: int = 7
    """Largest number of steps of an ascent."""
    halvings: int = 2
    """Number of times that a step which gains nothing is halved."""
    least_correlation: float = 0.03
    """The step of an ascent is that between equal images, over the correlation or this."""
    least_gain: float = 1e-3
    """Share of its score that an ascent must gain by a step to go on."""


@dataclass(frozen=True, slots=True)
class FrameParameters:
    """Numbers of the frame in which a pose is compared with its surroundings."""

    side_px: int = 288
    """Longer side of the frame."""
    margin_px: int = 16
    """Margin of the target around the frame."""
    iterations: int = 2
    """Largest number of times that patches are compared, each time from the similarity they agreed on."""
    least_evidence: float = 0.5
    """Least evidence of a pose that is confirmed."""
    least_ratio: float = 1.25
    """Ratio of the correlation in place to that of the best other shift, above which it speaks for a pose."""
    evidence_per_ratio: float = 4.0
    """Evidence for a pose whose ratio is 1 above that."""


@dataclass(frozen=True, slots=True)
class ConsensusParameters:
    """When the displacements of patches agree on an affine transformation."""

    least_patches: int = 8
    """Least number of patches that determine one."""
    tolerance_px: float = 2.25
    """A patch agrees with an affine pose if its displacement is this close to it."""
    samples: int = 600
    """Number of affine poses that are tried, each of three patches."""
    least_triangle_px2: float = 1000.0
    """Least area of the triangle of three patches that determine an affine pose."""
    refits: int = 3
    """Number of times that the best of these is fitted to the patches that agree with it."""
    stretch_limits: tuple[float, float] = (0.55, 1.9)
    """Smallest and largest singular value of an affine change of a pose."""
    most_anisotropy: float = 1.7
    """Largest ratio of these singular values."""
    similarity_share: float = 0.85
    """A similarity that keeps this share of the inliers of an affine pose replaces it."""
    least_perspective_gain: float = 8.0
    """A homography must have so much more support than the affine pose that it grows from."""
    perspective_iterations: int = 2
    """Largest number of times that a homography grows, the second time from patches seen in perspective."""


@dataclass(frozen=True, slots=True)
class ChanceParameters:
    """How many patches of unrelated images agree."""

    agreeing: float
    """Number that agrees in the median."""
    per_decade: float
    """Number of further patches whose agreement makes chance ten times less probable."""


@dataclass(frozen=True, slots=True)
class VoteParameters:
    """Numbers of the patches that vote for an affine pose."""

    side_px: int = 192
    """Longer side of the reference where patches vote."""
    patch_px: int = 36
    """Side of a patch."""
    step_px: int = 12
    """Distance between the patches, which overlap."""
    reach_px: int = 30
    """Largest displacement of a patch from the pose that it starts from, per axis."""
    blur_px: float = 0.75
    """Sigma of the Gaussian that smooths their channels further."""
    least_valid: float = 0.5
    """Least share of a patch that must be valid, and of its displacements at which it is."""
    clearance_px: int = 4
    """Displacements this close to a peak, per axis, belong to it."""
    stride: int = 2
    """Every n-th patch along each axis is in the sample."""
    iterations: int = 5
    """Largest number of times that patches vote, each time from the pose that they agreed on."""
    by_structure: ChanceParameters = field(default_factory=lambda: ChanceParameters(14.0, 7.5))
    """Chance of patches compared by structure."""
    by_grey_values: ChanceParameters = field(default_factory=lambda: ChanceParameters(9.0, 5.0))
    """Chance of patches compared by grey values."""
    sampled_starts: int = 3
    """Number of the best ascended poses from which a sample of the patches votes."""
    least_sampled: int = 7
    """Least number of patches of the sample that agree, so that all vote; of unrelated images 3 to 8 do."""
    least_evidence: float = 1.0
    """Least evidence of a start from which all patches vote however few of the sample agree."""
    full_starts: int = 2
    """Largest number of starts, those with which most of the sample agree, from which all patches vote."""


@dataclass(frozen=True, slots=True)
class GreyPoseParameters:
    """Numbers of the search by grey values."""

    sides_px: tuple[int, int] = (96, 192)
    """Longer sides of the reference where grey values are compared: of many poses, and of the best."""
    reach: float = 0.125
    """Sigma of the Gaussian whose mean is taken from grey values, as a share of that side: what is wider is
    light, haze or a slope, which any two images may share."""
    trials: int = 150
    """Number of the best poses of the coarse search whose grey values are compared."""
    distinct: int = 6
    """Number of the best distinct ones of these that climb."""
    least_ratio: float = 1.12
    """Ratio of the best of them to the second from which they climb."""
    joint_ratio: float = 1.05
    """Ratio of the best of those that climbed to the second from which it speaks for a pose."""
    evidence_per_joint_ratio: float = 2.2
    """Evidence for a pose whose ratio is 1 above that."""
    evidence_per_grey_ratio: float = 3.0
    """Evidence, beside that of structure, for a pose of twice the dependence of any other coarse one."""
    most_evidence: float = 6.0
    """Largest evidence of structure and grey values together."""
    steps_px: tuple[tuple[float, ...], tuple[float, ...]] = ((1.0, 0.4), (1.5, 0.75, 0.4))
    """Steps of the climb, by how far they move the border: px of the first and of the second of the sides."""
    rounds: int = 6
    """Largest number of times that all parameters are tried with a step."""
    error_px: float = 1.0
    """Typical error of a pose after the climb, px of the second side; 0.9 at the median of near infrared."""


@dataclass(frozen=True, slots=True)
class PoseParameters:
    """The numbers of all parts of the search."""

    structure: StructureParameters = field(default_factory=StructureParameters)
    """Of the correlation in cells."""
    evidence: EvidenceParameters = field(default_factory=EvidenceParameters)
    """Of what the scores say."""
    affine: AffineParameters = field(default_factory=AffineParameters)
    """Of affine poses."""
    frame: FrameParameters = field(default_factory=FrameParameters)
    """Of the confirmation in a frame."""
    votes: VoteParameters = field(default_factory=VoteParameters)
    """Of patches that vote."""
    consensus: ConsensusParameters = field(default_factory=ConsensusParameters)
    """Of their consensus."""
    grey: GreyPoseParameters = field(default_factory=GreyPoseParameters)
    """Of grey values."""


POSE: Final = PoseParameters()
"""Those in use."""
