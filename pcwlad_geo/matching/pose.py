"""Search for the pose between two images of different modality: any rotation, scale, shift, and some shear.

Rotating an image rotates its orientation channels and shifts them cyclically, so that the channels of one
resolution serve all rotations. With harmonics of the orientation the cyclic shift is a product with a phase.
The search knows similarities. From the best of them patches, each looked for within a wide reach, vote for an
affine transformation: a patch is hardly changed by what moves the border of the whole image by many pixels.
Where none stands out, images stretched in several directions are searched for, and affine poses ascend from
those, by the gradient, to where most of the whole image correlates. Where the matching from the pose that was
found fails, or none was, the grey values tell more: what has one tone in one image has one in the other.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import SCALE, inverse, least_squares, solve
from pcwlad_geo.matching.channels import normalised_channels
from pcwlad_geo.matching.grey_values import Ranks, local_deviation
from pcwlad_geo.matching.kernels.phase_congruency import ORIENTATIONS
from pcwlad_geo.matching.kernels.pose_search import (
    LAYER_HARMONICS,
    MASK_STEP,
    cross_spectra,
    place_layer,
    weigh_by_overlap,
)
from pcwlad_geo.matching.masked_correlation import ratio_in_place
from pcwlad_geo.matching.patches import PARAMETERS as PATCHES
from pcwlad_geo.matching.patches import Patches, window_sums
from pcwlad_geo.matching.transforms import mapped, similarity_between
from pcwlad_geo.types import Bool, Float32, Float64

CORRELATION_CELLS: Final = 112
"""Longer side of the larger image, in cells of the correlation."""
PIXELS_PER_CELL: Final = 3.0
"""Channels are computed at so many pixels a cell and averaged: they tolerate the steps of the search."""
ANGLE_STEP_DEG: Final = 4.0
"""Step of the rotations; half of it moves the border of the image by two cells."""
SCALE_STEP: Final = 1.08
"""Ratio of one scale to the next; half of it moves the border of the image by two cells."""
SMALL_RATIO: Final = 0.5
"""Up to this share of the larger image, both steps may be twice as large: the border moves no farther."""
SCALES: Final = (0.25, 4.0)
"""Smallest and largest scale, target px per reference px."""
MIN_OVERLAP: Final = 0.25
"""Least overlap of a pose, as a share of the smaller image's valid area."""
MIN_CELLS: Final = 16.0
"""Least overlap of a pose, cells."""
DISTINCT_DISTANCE: Final = 0.08
"""Two poses are distinct if they place an image this share of its longer side apart, on average."""
REFINED: Final = 16
"""Number of distinct poses that are tried again with finer steps."""
FINE_CELLS: Final = 160
"""Longer side of the larger image, in cells of the correlation with finer steps."""
REMEMBERED: Final = 8
"""Number of resolutions at which the averaged harmonics of an image are remembered."""
FINE_STEPS: Final = 3
"""Number of fine steps to a coarse one."""
REACH_CELLS: Final = 3
"""Largest change of the shift by the finer steps."""
SCORES_PER_BATCH: Final = 2**16
"""Largest number of scores computed together, to stay in the cache; those of one rotation may be more."""
FRAME_PX: Final = 288
"""Longer side of the frame in which the patches of a pose are compared."""
FRAME_MARGIN_PX: Final = 16
"""Margin of the target around that frame."""
FRAME_ITERATIONS: Final = 2
"""Largest number of times that patches are compared there, each time from the similarity they agreed on."""
EVIDENCE_PER_RATIO: Final = 8.0
"""Evidence for a pose whose score is twice that of its best rival, see docs/accuracy.md."""
EVIDENCE_PER_ASCENDED_RATIO: Final = 5.0
"""The same of scores that ascended; of 60 unrelated pairs the best is at most 1.38 times the second."""
MAX_EVIDENCE: Final = 4.0
"""Largest evidence that a score can give by itself: the tie points must give the rest."""
MIN_EVIDENCE: Final = 2.0
"""Least evidence of a pose that is worth a match; tie points alone would accept a chance pose of many."""
VOTING_SIDE_PX: Final = 192
"""Longer side of the reference where patches vote for an affine pose."""
PATCH_PX: Final = 36
"""Side of such a patch."""
PATCH_STEP_PX: Final = 12
"""Distance between the patches, which overlap."""
PATCH_REACH_PX: Final = 30
"""Largest displacement of such a patch from the pose that it starts from, per axis."""
PATCH_BLUR_PX: Final = 0.75
"""Sigma of the Gaussian that smooths their channels further."""
PATCH_VALID: Final = 0.5
"""Least share of such a patch that must be valid, and of its displacements at which it is."""
PATCH_CLEARANCE_PX: Final = 4
"""Displacements this close to a peak, per axis, belong to it."""
VOTE_TOLERANCE_PX: Final = 2.25
"""A patch agrees with an affine pose if its displacement is this close to it."""
VOTE_SAMPLES: Final = 600
"""Number of affine poses that are tried, each of three patches."""
CONSENSUS_REFITS: Final = 3
"""Number of times that the best of these is fitted again to the patches that agree with it."""
STRETCH_LIMITS: Final = (0.55, 1.9)
"""Smallest and largest singular value of an affine change of a pose."""
MAX_ANISOTROPY: Final = 1.7
"""Largest ratio of these singular values."""
LEAST_TRIANGLE_PX2: Final = 1000.0
"""Least area of the triangle of three patches that determine an affine pose."""
STRETCHES: Final = ((1.0, 1, 0.0), (1.17, 4, 0.0), (1.4, 8, 0.5))
"""Ratios of the axes by which the smaller image is stretched, in how many directions, and the first of these,
in steps; what these miss moves the border by less than two cells."""
STRETCHED_SCALES: Final = (0.5, 2.0)
"""Smallest and largest scale of a pose of a stretched image, target px per reference px."""
STRETCHED_CELLS: Final = 40
"""Longer side of the larger image, in cells of the correlation with a stretched one."""
STRETCHED_ANGLE_STEP_DEG: Final = 8.0
"""Step of the rotations of a stretched image."""
STRETCHED_SCALE_STEP: Final = 1.16
"""Ratio of one scale of a stretched image to the next."""
LAYERS_PX: Final = (168.0, 336.0)
"""Sides of the images whose channels are averaged to the cells of stretched images and of ascents: of the
true poses of 34 stretched pairs 24 are among the best four then, and 16 with the larger one alone."""
MAX_STRETCHED_POSES: Final = 96
"""Largest number of distinct poses of a stretched image that ascend."""
CLOSE_DISTANCE: Final = 0.05
"""Distance at which these are distinct, as `DISTINCT_DISTANCE`."""
ASCENT_CELLS: Final = (56, 112)
"""Cells on which they ascend, and on which those that are the best and distinct then ascend once more."""
ASCENT_ROUNDS: Final = 7
"""Largest number of steps of an ascent."""
ASCENT_HALVINGS: Final = 2
"""Number of times that a step which gains nothing is halved."""
LEAST_CORRELATION: Final = 0.03
"""The step of an ascent is what the gradient tells of equal images, over the correlation or this."""
LEAST_GAIN: Final = 1e-3
"""Share of its score that an ascent must gain by a step to go on."""
MIN_EVIDENCE_TO_CONFIRM: Final = 0.5
"""Least evidence of a pose that is looked at once more; that of the best ascended pose is less for 25 of 30
unrelated pairs."""
CONFIRMING_RATIO: Final = 1.25
"""Ratio of the correlation in place to that of the best other shift, above which it speaks for a pose; of the
best ascended poses of 30 unrelated pairs it is 1.63 at most."""
EVIDENCE_PER_CONFIRMING_RATIO: Final = 4.0
"""Evidence for a pose whose ratio is 1 above that."""
GREY_SIDES_PX: Final = (96, 192)
"""Longer sides of the reference where grey values are compared: of many poses, and of the best of them."""
GREY_REACH: Final = 0.125
"""Sigma of the Gaussian whose mean is taken from grey values, as a share of that side: what is wider is
light, haze or a slope, which any two images may share."""
GREY_TRIALS: Final = 150
"""Number of the best poses of the coarse search whose grey values are compared."""
GREY_DISTINCT: Final = 6
"""Number of the best distinct ones of these that climb."""
MIN_GREY_RATIO: Final = 1.12
"""Ratio of the best of them to the second from which they climb: of unrelated pairs one in three has it."""
JOINT_RATIO: Final = 1.05
"""Ratio of the best of those that climbed to the second from which it speaks for a pose."""
EVIDENCE_PER_JOINT_RATIO: Final = 2.2
"""Evidence for a pose whose ratio is 1 above that; of 53 unrelated pairs five have 1.5, and the most 1.84."""
EVIDENCE_PER_GREY_RATIO: Final = 3.0
"""Evidence, beside that of its structure, for a pose whose dependence is twice that of any other of the
coarse search; of 53 unrelated pairs two have 1.4 times, and the most 1.52."""
MAX_GREY_EVIDENCE: Final = 6.0
"""Largest evidence of structure and grey values together."""
GREY_STEPS_PX: Final = ((1.0, 0.4), (1.5, 0.75, 0.4))
"""Steps of the climb, by how far they move the border: px of the first and of the second of the two sides."""
GREY_ROUNDS: Final = 6
"""Largest number of times that all parameters are tried with a step."""
GREY_ERROR_PX: Final = 1.0
"""Typical error of a pose after the climb, px of the second side; 0.9 at the median of near infrared."""
SAMPLED_STARTS: Final = 3
"""Number of the best ascended poses from which a sample of the patches votes until no more of it agree."""
MIN_SAMPLED: Final = 7
"""Least number of patches of the sample that agree, so that all vote; of unrelated images 3 to 8 do."""
MIN_EVIDENCE_FOR_ALL_PATCHES: Final = 1.0
"""Least evidence of such a pose for all patches to vote however few of the sample agree."""
FULL_STARTS: Final = 2
"""Largest number of these poses, those with which most of the sample agree, from which all patches vote."""
PATCH_STRIDE: Final = 2
"""Every n-th patch along each axis is in the sample."""
SIMILARITY_SHARE: Final = 0.85
"""A similarity that keeps this share of the inliers of an affine pose replaces it: of 60 pairs, most of whose
true poses are similarities, 13 came nearer to the truth by more than 0.5 px; one went off by 3 px."""
MIN_PERSPECTIVE_GAIN: Final = 8.0
"""A homography must have so much more support than the affine pose that it grows from: of 35 pairs without
perspective one gains 6.8, and started 34 px off at the border with that; of 16 with 7 to 14 % of it five gain
more than 8, and come nearer by 1.5 to 5 px."""
PERSPECTIVE_ITERATIONS: Final = 2
"""Largest number of times that a homography grows, the second time from patches seen in perspective."""
CONSENSUS_ITERATIONS: Final = 5
"""Largest number of times that patches vote again, each time from the pose that they agreed on."""
AGREEING_BY_CHANCE: Final = 14.0
"""Number of these patches that agree in unrelated images (median of 63 pairs; the most were 24)."""
PATCHES_PER_DECADE: Final = 7.5
"""Number of further patches whose agreement makes chance ten times less probable."""
GREY_AGREEING_BY_CHANCE: Final = 9.0
"""The same of patches that are compared by their grey values (of 58 pairs; the most were 17)."""
GREY_PATCHES_PER_DECADE: Final = 5.0
"""The same of these: 12 agree in one of ten unrelated pairs."""

_ROOT_2 = math.sqrt(2.0)
_ANGLES = np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS
_HARMONICS = np.stack(
    [
        np.ones(ORIENTATIONS),
        _ROOT_2 * np.cos(2 * _ANGLES),
        _ROOT_2 * np.sin(2 * _ANGLES),
        _ROOT_2 * np.cos(4 * _ANGLES),
        _ROOT_2 * np.sin(4 * _ANGLES),
    ]
).astype(np.float32)
"""Mean, second and fourth harmonic of the orientations; the sixth has no phase."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseProposal:
    """A similarity or an affine transformation that the search proposes, and its support."""

    matrix: Float64
    """(2, 3): target px (col, row) = matrix · (col, row, 1) of the reference, array indices."""
    score: float
    """Correlation times the root of the overlap in cells, which is fair between large and small overlaps."""
    evidence: float
    """-log10 of the probability, as measured, that unrelated images give as much: a score that stands out as
    far, or as many patches that agree."""
    patches: int = 0
    """Number of patches that were compared."""
    agreeing: int = 0
    """Number of patches that agree on the transformation."""
    spread_px: float = 0.0
    """Distance from it within which 95 % of the agreeing patches lie, reference px."""
    homography: Float64 | None = None
    """(3, 3) the same as `matrix`, in perspective; None unless the patches agree clearly better on that."""

    @property
    def accepted(self) -> bool:
        """Whether the score stands out of all others, or more patches agree than by chance."""
        return self.evidence >= MIN_EVIDENCE

    @property
    def scale(self) -> float:
        """Target px per reference px."""
        return _scale_of(self.matrix)


@dataclass(frozen=True, eq=False)
class _PoseTrial:
    """One rotation and ratio of sizes, and the best shift with them."""

    score: float
    angle_rad: float
    ratio: float
    scan: _Scan
    moving: _Cells
    fixed: _Cells
    opposite: bool
    """Whether the fixed image is turned by half."""
    shift_rc: tuple[int, int]
    """Shift (row, col) of the moving image, cells."""
    period: int | None
    """Period modulo which the shift is known, cells; None if it is unambiguous."""
    stride: int
    """Steps to the next rotation and ratio that were tried."""

    @cached_property
    def matrix(self) -> Float64:
        """(3, 3) target px = matrix · reference px, array indices."""
        row, col = self.shift_rc if self.period is None else map(self._unwrapped, (0, 1))
        from_px = np.diag([-1.0, -1.0, 1.0]) @ self.fixed.from_px if self.opposite else self.fixed.from_px
        shift = _affine(np.eye(2), np.array([col, row], np.float64))
        found = inverse(from_px) @ shift @ self.moving.from_px
        return inverse(found) if self.scan.from_target else found

    def _unwrapped(self, axis: int) -> int:
        """Return the shift along an axis with the largest overlap, of those equal modulo the period."""
        at, size = self.shift_rc[axis], self.period or 0
        moving, fixed = self.moving.shape[axis], self.fixed.shape[axis]
        first = 1 - fixed if self.opposite else 0
        shifts = (at - 2 * size, at - size, at)
        return max(shifts, key=lambda shift: min(shift + moving, first + fixed) - max(shift, first))


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """One image in cells, transformed for the correlation."""

    spectra: Float32
    """(harmonics, 2, rows, half the cols) real and imaginary part."""
    mask: Float32
    """(1, 2, …) spectrum of the mask, of a coarser lattice."""
    shape: tuple[int, int]
    """Rows and columns before the zeros that the transform adds."""
    area: float
    """Number of valid cells."""
    from_px: Float64
    """(3, 3) px of the image to cells, array indices."""


_Layer: TypeAlias = tuple[list[Float32], Float64]
"""Harmonics and then what is usable, as (rows, cols, 3 or 4) arrays of several of these planes, which are
warped together, and the (3, 3) matrix from px."""


@dataclass(slots=True, eq=False)
class _PoseImage:
    """One image, with its channels at the resolutions that were asked for so far."""

    values: Float32
    valid: Bool
    _levels: dict[int, tuple[Float32, Float32, Float64]] = field(default_factory=dict)
    _averaged: dict[tuple[float, tuple[float, ...]], list[_Layer]] = field(default_factory=dict)

    @property
    def side_px(self) -> int:
        return int(max(self.values.shape))

    def canvas_side(self, side_cells: float) -> int:
        """Return the side of a square that holds the image however it is rotated, cells."""
        rows, cols = self.values.shape
        return math.ceil(math.hypot(rows, cols) * side_cells / self.side_px) + 1

    def in_cells(
        self,
        side_cells: float,
        size: int,
        angles_rad: Sequence[float] = (),
        *,
        stretches: Sequence[Float64] = (),
        per_cell: Sequence[float] = (PIXELS_PER_CELL,),
    ) -> Iterator[_Cells]:
        """Yield the image with its longer side of so many cells, rotated about its middle; else as it is.

        Instead it may be stretched, by (2, 2) matrices. For `per_cell` see `averaged`.
        """
        layers = self.averaged(side_cells, per_cell)
        per_px = side_cells / self.side_px
        middle_px = (np.array(self.values.shape[::-1]) - 1) / 2
        for angle_rad, change in [(0.0, each) for each in stretches] or [
            (angle_rad, _rotation(angle_rad)) for angle_rad in angles_rad or (0.0,)
        ]:
            cols, rows = (max(8, round(n * per_px)) for n in np.abs(change) @ self.values.shape[::-1])
            if angles_rad:
                rows = cols = self.canvas_side(side_cells)
            linear = per_px * change
            from_px = _affine(linear, (np.array([cols, rows]) - 1) / 2 - linear @ middle_px)
            values = []
            for packed, to_map in layers:
                warp = from_px @ inverse(to_map)
                parts = (_warped(some, warp, (rows, cols)) for some in packed)
                warped = np.concatenate([part.transpose(2, 0, 1) for part in parts])
                known = (warped[-1] > 0.5).astype(np.float32)
                values.append(_turned(warped[:-1] * known, angle_rad))
            spectra = _spectra(np.concatenate(values), (size, size))
            yield _Cells(spectra, _mask_spectrum(known, size), (rows, cols), float(known.sum()), from_px)

    def averaged(self, side_cells: float, per_cell: Sequence[float]) -> list[_Layer]:
        """Return harmonics averaged over half a cell, so that nothing between two samples is missed.

        There is a layer for each number of px `per_cell`, with which channels are computed. Of several, each
        has fewer harmonics, and the same weight. The last ones asked for are remembered.
        """
        key = side_cells, tuple(per_cell)
        layers = self._averaged.pop(key, None)
        layers = layers or [self._layer(side_cells, per_cell, count) for count in per_cell]
        self._averaged[key] = layers
        if len(self._averaged) > REMEMBERED:
            del self._averaged[next(iter(self._averaged))]
        return layers

    def _layer(self, side_cells: float, per_cell: Sequence[float], count: float) -> _Layer:
        maps, usable, to_map = self._level(side_cells * count / PIXELS_PER_CELL)
        sigma_px = 0.5 * _scale_of(to_map) * self.side_px / side_cells
        chosen = maps[:LAYER_HARMONICS] if len(per_cell) > 1 else maps
        planes = [np.asarray(cv2.GaussianBlur(each, (0, 0), sigma_px), np.float32) for each in chosen]
        if len(per_cell) > 1:
            deviation = np.float32(max(float(np.std(planes)), 1e-6))
            planes = [plane / deviation for plane in planes]
        planes.append(usable)
        together = LAYER_HARMONICS + 1 if len(per_cell) > 1 else 3
        starts = range(0, len(planes), together)
        return [np.stack(planes[start : start + together], axis=-1) for start in starts], to_map

    def _level(self, side_cells: float) -> tuple[Float32, Float32, Float64]:
        """Return channels, usable px and the (3, 3) matrix from px, at the nearest half octave."""
        step = round(2 * math.log2(side_cells / CORRELATION_CELLS))
        if step not in self._levels:
            factor = min(1.0, PIXELS_PER_CELL * CORRELATION_CELLS * 2 ** (step / 2) / self.side_px)
            values, valid, to_map = _shrunk(self.values, self.valid, factor)
            channels, usable = normalised_channels(values, valid)
            maps = np.einsum("rco,ho->hrc", channels, _HARMONICS / ORIENTATIONS)
            self._levels[step] = np.ascontiguousarray(maps), usable, to_map
        return self._levels[step]


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """A moving image, not larger than the fixed one, against all rotations of that."""

    moving: _PoseImage
    fixed: _PoseImage
    from_target: bool
    """Whether the target is the moving image."""
    cells: int = CORRELATION_CELLS
    """Longer side of the fixed image, cells."""
    angle_step_deg: float = ANGLE_STEP_DEG
    scale_step: float = SCALE_STEP
    stretches: tuple[Float64, ...] = ()
    """(2, 2) matrices by which the moving image is stretched; none: as it is."""
    per_cell: tuple[float, ...] = (PIXELS_PER_CELL,)
    """See `_PoseImage.averaged`."""

    def everywhere(self, scales: tuple[float, float]) -> list[_PoseTrial]:
        """Try all rotations and ratios of the sizes; two equal sizes count for the reference as moving."""
        largest = self.fixed.side_px / self.moving.side_px
        limits = (1 / scales[1], 1 / scales[0]) if self.from_target else scales
        last = math.ceil(math.log(max(largest / limits[0], 1.0)) / math.log(self.scale_step))
        ratios = [self.scale_step**-step for step in range(int(self.from_target), 1 + last)]
        ratios = [ratio for ratio in ratios if ratio * largest <= limits[1] * self.scale_step]
        ratios = [ratio for number, ratio in enumerate(ratios) if number % _stride(ratio) == 0]
        angles = np.radians(np.arange(0.0, 180.0, self.angle_step_deg)).tolist()
        return list(self._trials(ratios, angles))

    def around(self, trial: _PoseTrial) -> _PoseTrial:
        """Return the best of finer steps around a trial."""
        steps = trial.stride * np.arange(-(FINE_STEPS // 2), FINE_STEPS // 2 + 1) / FINE_STEPS
        angles = trial.angle_rad + np.radians(ANGLE_STEP_DEG) * steps
        ratios = trial.ratio * SCALE_STEP**steps
        fine = replace(self, cells=FINE_CELLS)
        finer = fine._trials(ratios.tolist(), angles.tolist(), trial.matrix)
        best = max(finer, key=lambda each: each.score, default=trial)
        return replace(best, score=math.sqrt(best.score * trial.score), scan=self)

    def _trials(
        self, ratios: Sequence[float], angles: Sequence[float], near: Float64 | None = None
    ) -> Iterator[_PoseTrial]:
        """Try rotations and ratios, near a pose or anywhere, there with the opposite of each rotation too.

        A rotation and its opposite have conjugate spectra.
        """
        if not ratios:
            return
        # Only shifts of little overlap wrap around, so less padding suffices.
        side = self.fixed.canvas_side(self.cells)
        coarse = math.ceil(max(side, 1.6 * self.cells) / MASK_STEP)
        size = MASK_STEP * scipy.fft.next_fast_len(coarse, real=True)
        rotated = list(self.fixed.in_cells(self.cells, size, angles, per_cell=self.per_cell))
        turns = list(zip(angles, rotated, strict=True))
        strides = {ratio: _stride(ratio) if near is None else 1 for ratio in ratios}
        chosen = {stride: _Rotations.of(turns[::stride]) for stride in set(strides.values())}
        fixed_area = max(cells.area for cells in rotated)
        for ratio, moving in self._moving(ratios, size):
            least = max(MIN_OVERLAP * min(fixed_area, moving.area), MIN_CELLS)
            stride = strides[ratio]
            for opposite in (False, True) if near is None else (False,):
                for angle, fixed, score, highest in chosen[stride].scores(moving, opposite, size, least):
                    shift_rc = divmod(highest, size)
                    if near is not None:
                        shift_rc = _highest(score, self._expected(moving, fixed, near))
                    best = float(score[shift_rc[0] % size, shift_rc[1] % size])
                    turned, period = angle + np.pi * opposite, size if near is None else None
                    if best > 0:
                        yield _PoseTrial(
                            best, turned, ratio, self, moving, fixed, opposite, shift_rc, period, stride
                        )

    def _moving(self, ratios: Sequence[float], size: int) -> Iterator[tuple[float, _Cells]]:
        for ratio in ratios:
            side = self.cells * ratio
            for each in self.moving.in_cells(side, size, stretches=self.stretches, per_cell=self.per_cell):
                yield ratio, each

    def _expected(self, moving: _Cells, fixed: _Cells, near: Float64) -> tuple[int, int]:
        """Return the shift (col, row), cells, at which a pose places the middle of the moving image."""
        pose = inverse(near) if self.from_target else near
        middle = np.array([(moving.shape[1] - 1) / 2, (moving.shape[0] - 1) / 2, 1.0])
        col, row, _ = fixed.from_px @ pose @ inverse(moving.from_px) @ middle - middle
        return round(col), round(row)


def _stride(ratio: float) -> int:
    return 2 if ratio <= SMALL_RATIO else 1


@dataclass(frozen=True, slots=True, eq=False)
class PoseSearch:
    """What a search by the structure has found, and what one by the grey values goes on from."""

    found: PoseProposal | None
    """The pose in which most structure agrees, accepted or not; None if none could be compared."""
    trials: list[tuple[float, Float64]]
    """Scores and (3, 3) poses of the coarse search, the best `GREY_TRIALS`, the best first."""
    reference: _PoseImage
    target: _PoseImage
    scales: tuple[float, float]


def search_pose(
    reference: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    reference_valid: Bool,
    target_valid: Bool,
    *,
    scales: tuple[float, float] = SCALES,
    stretched: bool = True,
) -> PoseSearch:
    """Find the similarity, or the affine transformation, between two images whose structure agrees best.

    Parameters
    ----------
    reference, target : (rows, cols) float array
        Best about 300 to 1000 px a side; the values of invalid pixels are ignored.
    reference_valid, target_valid : (rows, cols) bool array
        True where a pixel of the image is valid.
    scales : (float, float)
        Smallest and largest scale that is tried, target px per reference px.
    stretched : bool
        Whether the search goes on where no similarity is found: from others, and with a stretched reference.

    Returns
    -------
    PoseSearch

    References
    ----------
    .. [1] Padfield, D. (2012), doi:10.1109/TIP.2011.2181402 (masked normalised cross-correlation).
    """
    first = _PoseImage(np.asarray(reference, np.float32), reference_valid)
    second = _PoseImage(np.asarray(target, np.float32), target_valid)
    scans = _Scan(first, second, from_target=False), _Scan(second, first, from_target=True)
    ranked = sorted(
        itertools.chain(*(scan.everywhere(scales) for scan in scans)), key=lambda each: -each.score
    )
    found = _best_by_structure(first, second, ranked, scales, stretched)
    trials = [(trial.score, trial.matrix) for trial in ranked[:GREY_TRIALS]]  # the others take much memory
    return PoseSearch(found, trials, first, second, scales)


def _best_by_structure(
    first: _PoseImage,
    second: _PoseImage,
    ranked: Sequence[_PoseTrial],
    scales: tuple[float, float],
    stretched: bool,
) -> PoseProposal | None:
    """Return the pose that the `ranked` trials of the coarse search, the best first, lead to."""
    coarse = _distinct(ranked, first.values.shape)
    if not coarse:
        return None
    patches = _OverlappingPatches(first, second)
    best_coarse = PoseProposal(coarse[0].matrix[:2], coarse[0].score, 0.0)
    voted = _affine_by_patches(patches, [best_coarse], scales)
    if voted is not None:
        return _confirmed(first, second, voted)
    similarity = _best_similarity(first, second, coarse)
    if similarity.accepted or not stretched:
        return _confirmed(first, second, similarity)
    starts = [trial.matrix for trial in coarse] + _stretched(first, second, scales)
    ascended = _ascended(first, second, starts)
    voted = _affine_by_patches(patches, ascended[:SAMPLED_STARTS], scales)
    if voted is not None:
        return _confirmed(first, second, voted)
    affine = [each for each in ascended[:1] if _is_within(each.scale, scales)]
    checked = [_confirmed(first, second, each) for each in (similarity, *affine)]
    best = max(checked, key=lambda each: each.evidence)
    return _Frame(first, second, best).moved_to_consensus(best) if best.accepted else similarity


def poses_by_grey_values(search: PoseSearch) -> Iterator[PoseProposal | None]:
    """Yield the pose on which patches agree by their grey values, then that which all grey values tell.

    Both begin with poses of the coarse search, and the one that was found. In unrelated images grey values
    and structure are independent, so that the product of their scores has fewer rivals than either. The
    second pose is moved to where both agree the most. None where nothing stands out.
    """
    first, second, found = search.reference, search.target, search.found
    coarse = _JointScore(first, second, _Ascent(first, second, ASCENT_CELLS[-1]), 0)
    dependences = [coarse.grey.dependence(pose) for _, pose in search.trials]
    scored = [(score * by, pose) for (score, pose), by in zip(search.trials, dependences, strict=True)]
    known = found if found is not None and found.accepted else None
    if known is not None:
        scored.append((math.inf, _square(known.matrix)))  # the first, whatever its score
    best = _best_distinct(scored, first.values.shape)
    starts = [PoseProposal(pose[:2], score, 0.0) for score, pose in best]
    if known is not None:
        starts[0] = known
    yield _affine_by_patches(_GreyPatches(first, second), starts, search.scales) if starts else None
    yield _climbed_pose(search, coarse, dependences, best, known)


def _climbed_pose(
    search: PoseSearch,
    coarse: _JointScore,
    dependences: Sequence[float],
    best: Sequence[tuple[float, Float64]],
    known: PoseProposal | None,
) -> PoseProposal | None:
    """Return the pose of the `best` that stands out when they have climbed; None if none does.

    The `dependences` are those of the trials of the search; `known` is the first of the best, if accepted.
    """
    first, second, shape = search.reference, search.target, search.reference.values.shape
    if len(best) < 2 or (known is None and best[0][0] < MIN_GREY_RATIO * best[1][0]):
        return None
    climbed = _best_distinct((coarse.climbed(pose) for _, pose in best), shape)
    score, pose = climbed[0]
    ratio = score / max(climbed[1][0] if len(climbed) > 1 else score, 1e-9)
    evidence = min(max(0.0, EVIDENCE_PER_JOINT_RATIO * (ratio - JOINT_RATIO)), MAX_EVIDENCE)

    def is_here(other: Float64) -> bool:
        return mean_distance_px(pose[:2], other[:2], shape) < DISTINCT_DISTANCE * first.side_px

    if known is not None and is_here(known.matrix):
        elsewhere = [
            by for (_, other), by in zip(search.trials, dependences, strict=True) if not is_here(other)
        ]
        grey_ratio = coarse.grey.dependence(pose) / max(max(elsewhere, default=math.inf), 1e-9)
        both = _fisher(known.evidence + EVIDENCE_PER_GREY_RATIO * max(0.0, grey_ratio - 1))
        evidence = max(evidence, known.evidence, min(both, MAX_GREY_EVIDENCE))
    if evidence < MIN_EVIDENCE:
        return None
    fine = _JointScore(first, second, coarse.structure, 1)
    score, pose = fine.climbed(fine.climbed(pose)[1], affine=True)
    error_px = GREY_ERROR_PX * max(1.0, first.side_px / GREY_SIDES_PX[1])
    proposal = PoseProposal(pose[:2], score, evidence, spread_px=error_px)
    return proposal if _is_within(proposal.scale, search.scales) else None


def _fisher(both: float) -> float:
    """Return the evidence of two independent probabilities, whose own evidence adds up to `both`."""
    return both - math.log10(1 + both * math.log(10))


def _square(matrix: Float64) -> Float64:
    """Return a (2, 3) affine transformation as a (3, 3) matrix."""
    return _affine(matrix[:, :2], matrix[:, 2])


def _best_distinct(
    scored: Iterable[tuple[float, Float64]], shape: tuple[int, ...]
) -> list[tuple[float, Float64]]:
    """Return the best of scores and (3, 3) poses that are distinct, the best first."""
    ranked = sorted(scored, key=lambda each: -each[0])
    chosen = _first_distinct((pose for _, pose in ranked), shape, GREY_DISTINCT, DISTINCT_DISTANCE)
    return [ranked[index] for index in chosen]


def _best_similarity(first: _PoseImage, second: _PoseImage, coarse: Sequence[_PoseTrial]) -> PoseProposal:
    """Return the best of the similarities around those of the coarse search, and how it stands out."""
    ranked = _distinct((trial.scan.around(trial) for trial in coarse), first.values.shape)
    best, rival = ranked[0], ranked[1].score if len(ranked) > 1 else 0.0
    evidence = _evidence_of_ratio(best.score, rival, EVIDENCE_PER_RATIO)
    proposal = PoseProposal(best.matrix[:2], best.score, evidence)
    return _Frame(first, second, proposal).moved_to_consensus(proposal)


def _evidence_of_ratio(score: float, rival: float, per_ratio: float) -> float:
    """Return the evidence for a pose that the ratio of its score to that of its best rival gives."""
    return min(per_ratio * (score / rival - 1), MAX_EVIDENCE) if rival > 0 else MAX_EVIDENCE


def mean_distance_px(first: Float64, second: Float64, shape: tuple[int, ...]) -> float:
    """Return how far apart two transformations place the pixels of an image on average.

    The affine `first` and `second`, (2, 3) or (3, 3), are of px (col, row).
    """
    return float(np.hypot(*((first - second)[:2] @ _lattice(shape))).mean())


def _lattice(shape: tuple[int, ...]) -> Float64:
    """Return (3, 81) places (col, row, 1) that are spread evenly over an image."""
    row, col = np.mgrid[0 : shape[0] : 9j, 0 : shape[1] : 9j]
    return np.stack([col.ravel(), row.ravel(), np.ones(row.size)])


def _distinct(
    trials: Iterable[_PoseTrial],
    shape: tuple[int, ...],
    wanted: int = REFINED,
    least: float = DISTINCT_DISTANCE,
) -> list[_PoseTrial]:
    """Return the best trials that differ, the best first; see `_first_distinct`."""
    ranked = sorted(trials, key=lambda each: -each.score)
    chosen = _first_distinct((trial.matrix for trial in ranked), shape, wanted, least)
    return [ranked[index] for index in chosen]


def _first_distinct(poses: Iterable[Float64], shape: tuple[int, ...], wanted: int, least: float) -> list[int]:
    """Return the indices of the first `wanted` poses that are distinct from all chosen before them.

    Two are if they place an image `least`, a share of its longer side, apart on average.
    """
    places = _lattice(shape)
    chosen: list[int] = []
    placed = np.empty((0, 2, places.shape[1]))
    for index, pose in enumerate(poses):
        here = (pose[:2] @ places)[None]
        away = np.hypot(*np.moveaxis(placed - here, 1, 0)).mean(axis=1)
        if (away > least * max(shape) * _scale_of(pose)).all():
            chosen.append(index)
            placed = np.concatenate([placed, here])
        if len(chosen) == wanted:
            break
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class _Rotations:
    """Rotations of the fixed image, which are compared together."""

    angles_rad: tuple[float, ...]
    cells: tuple[_Cells, ...]
    spectra: Float32
    """(n, harmonics, 2, rows, half the cols)."""
    masks: Float32
    """(n, 1, 2, …)."""

    @staticmethod
    def of(rotated: Sequence[tuple[float, _Cells]]) -> _Rotations:
        """Return these angles, radians, and images."""
        angles, cells = zip(*rotated, strict=True)
        spectra, masks = np.stack([each.spectra for each in cells]), np.stack([each.mask for each in cells])
        return _Rotations(angles, cells, spectra, masks)

    def scores(
        self, moving: _Cells, opposite: bool, size: int, least: float
    ) -> Iterator[tuple[float, _Cells, Float32, int]]:
        """Yield the angle, the image, the (size, size) scores of all shifts, and where the highest is.

        `opposite` is whether the fixed image is turned by half, and `least` the least overlap, cells.
        """
        masks = cross_spectra(moving.mask, self.masks, opposite=opposite)
        overlaps = scipy.fft.irfft2(masks, [size // MASK_STEP] * 2, overwrite_x=True) / MASK_STEP**2
        some = max(1, SCORES_PER_BATCH // size**2)
        for start in range(0, len(self.cells), some):
            part = slice(start, start + some)
            spectra = cross_spectra(moving.spectra, self.spectra[part], opposite=opposite)
            scores = scipy.fft.irfft2(spectra, (size, size), overwrite_x=True)
            highest = weigh_by_overlap(scores, overlaps[part], least)
            yield from zip(self.angles_rad[part], self.cells[part], scores, highest.tolist(), strict=True)


def _highest(score: Float32, expected: tuple[int, int]) -> tuple[int, int]:
    """Return the shift (row, col) of the highest score near the (col, row) that is expected."""
    reach = np.arange(-REACH_CELLS, REACH_CELLS + 1)
    part = score[np.ix_((expected[1] + reach) % len(score), (expected[0] + reach) % len(score))]
    down, right = divmod(int(part.argmax()), part.shape[1])
    return expected[1] + int(reach[down]), expected[0] + int(reach[right])


def _spectra(maps: Float32, shape: tuple[int, int]) -> Float32:
    """Transform (n, rows, cols) maps; return (n, 2, rows, half the cols), the real and the imaginary part."""
    found = scipy.fft.rfft2(maps, shape)
    return np.stack([found.real, found.imag], axis=1)


def _mask_spectrum(known: Float32, size: int) -> Float32:
    """Transform a mask summed over blocks, for a count of the overlap that may be coarse."""
    padded = np.zeros((size, size), np.float32)
    padded[: known.shape[0], : known.shape[1]] = known
    summed = padded.reshape((size // MASK_STEP, MASK_STEP) * 2).sum(axis=(1, 3))
    return _spectra(summed[None], summed.shape)


@dataclass(frozen=True, slots=True, eq=False)
class _Votes:
    """What patches of the reference tell of an affine change of a pose."""

    matrix: Float64
    """(3, 3) of most support, voting px of the reference to those of the target as the pose places it."""
    agrees: Bool
    """(n,) mask of the patches that agree with it."""
    spread_px: float
    """Distance from it within which 95 % of these lie, voting px."""
    middles_px: Float64
    """(n, 2) middles (col, row) of the patches, voting px."""
    moved_px: Float64
    """(n, 2) where they were found in the target as the pose places it, voting px."""
    to_target: Float64
    """(3, 3) from these voting px to px of the target."""

    @property
    def agreeing(self) -> int:
        return int(np.count_nonzero(self.agrees))

    def in_perspective(self) -> tuple[Float64, float]:
        """Return the (3, 3) homography grown from the affine change, and its support."""
        best, agrees, support = self.matrix, self.agrees, self.support
        for _ in range(CONSENSUS_REFITS):
            if np.count_nonzero(agrees) < PATCHES.least:
                break
            middle = self.middles_px[agrees].mean(axis=0)
            about, _ = cv2.findHomography(self.middles_px[agrees] - middle, self.moved_px[agrees])
            change = self.matrix if about is None else about @ _affine(np.eye(2), -middle)
            higher, agreeing = self._support(change)
            if higher <= support:
                break
            best, support, agrees = change, higher, agreeing
        return best, support

    @property
    def support(self) -> float:
        """Support of the affine change, see `_support`."""
        return self._support(self.matrix)[0]

    def _support(self, change: Float64) -> tuple[float, Bool]:
        """Return how far the patches agree with a (3, 3) change, and the (n,) mask of those that do.

        A patch counts for 1 less the square of its distance, in tolerances (Torr & Zisserman 2000,
        doi:10.1006/cviu.1999.0832); a change that places one beyond the horizon has no support.
        """
        places = np.column_stack([self.middles_px, np.ones(len(self.middles_px))]) @ change.T
        if (places[:, 2] <= 0).any():
            return 0.0, np.zeros(len(places), bool)
        off = np.hypot(*(places[:, :2] / places[:, 2:] - self.moved_px).T) / VOTE_TOLERANCE_PX
        return float(np.maximum(1 - off**2, 0.0).sum()), off <= 1


class _OverlappingPatches:
    """Patches of the reference, which are looked for in the target as poses place it."""

    _by_chance, _per_decade = AGREEING_BY_CHANCE, PATCHES_PER_DECADE

    def __init__(self, reference: _PoseImage, target: _PoseImage) -> None:
        self._factor = min(1.0, VOTING_SIDE_PX / reference.side_px)
        values, self._valid, self._to_voting = _shrunk(reference.values, reference.valid, self._factor)
        self._planes, self._usable = self._seen(values, self._valid)
        self._target = target
        rows, cols = (range(0, n - PATCH_PX + 1, PATCH_STEP_PX) for n in self._usable.shape)
        self._corners = [
            (row, col, not (i % PATCH_STRIDE or j % PATCH_STRIDE))
            for i, row in enumerate(rows)
            for j, col in enumerate(cols)
            if self._usable[row : row + PATCH_PX, col : col + PATCH_PX].mean() >= PATCH_VALID
        ]

    def vote(self, pose: Float64, *, sample: bool = False) -> tuple[_Votes, Float64]:
        """Let the patches, or a sample of them, vote; the second result is the (3, 3) pose they agree on."""
        votes = self._votes(pose, sample=sample)
        agreed = votes.to_target @ votes.matrix @ self._to_voting
        if not sample and votes.agrees.any():
            reference_px = mapped(inverse(self._to_voting), votes.middles_px)
            target_px = mapped(votes.to_target, votes.moved_px)
            tolerance_px = VOTE_TOLERANCE_PX * _scale_of(agreed) / self._factor
            agreed = _as_similarity(agreed, reference_px, target_px, votes.agrees, tolerance_px)
        return votes, agreed

    def in_perspective(self, votes: _Votes) -> Float64 | None:
        """Return the (3, 3) homography grown from votes for an affine pose; None if it gains little."""
        best, least = None, votes.support + MIN_PERSPECTIVE_GAIN
        for _ in range(PERSPECTIVE_ITERATIONS):
            votes = votes if best is None else self._votes(best)
            change, support = votes.in_perspective()
            if support < least:
                break
            best, least = votes.to_target @ change @ self._to_voting, support
        return best if best is None else best / best[2, 2]

    def _votes(self, pose: Float64, *, sample: bool = False) -> _Votes:
        """Return the votes of the patches, or of a sample, with the target placed by a (3, 3) pose."""
        from_voting = inverse(self._to_voting)
        middle_px = mapped(from_voting, (np.array([self._valid.shape[::-1]]) - 1) / 2)[0]
        small, known, to_small = _shrunk(
            self._target.values, self._target.valid, min(1.0, self._factor / _scale_at(pose, middle_px))
        )
        to_placed = to_small @ pose @ from_voting
        placed = _warped_image(small, known, to_placed, self._valid.shape, PATCH_REACH_PX)
        found = self._displacements(*self._seen(*placed), sample=sample)
        return _consensus(*found, inverse(to_small) @ to_placed)

    def evidence(self, votes: _Votes) -> float:
        """Return -log10 of the probability, as measured, that as many patches of unrelated images agree."""
        return max(0.0, min((votes.agreeing - self._by_chance) / self._per_decade, MAX_EVIDENCE))

    def px(self, voting_px: float) -> float:
        """Return a length in px of the reference."""
        return voting_px / self._factor

    def _displacements(
        self, planes: Float32, usable: Float32, *, sample: bool
    ) -> tuple[Float64, Float64, Float64]:
        """Return (n, 2) middles and displacements (col, row) of the patches, and how distinct each is."""
        side = 2 * PATCH_REACH_PX + 1
        enough = window_sums(usable, PATCH_PX) >= PATCH_VALID * PATCH_PX**2
        norms = np.where(enough, self._norms(planes, usable), 0)
        found = []
        for row, col, sampled in self._corners:
            there = np.s_[..., row : row + side, col : col + side]
            if (sample and not sampled) or np.count_nonzero(enough[there]) < PATCH_VALID * side**2:
                continue
            patch = np.s_[row : row + PATCH_PX, col : col + PATCH_PX]
            search = planes[row : row + PATCH_PX + side - 1, col : col + PATCH_PX + side - 1]
            surface = self._surface(patch, search, norms[there])
            found.append((col + (PATCH_PX - 1) / 2, row + (PATCH_PX - 1) / 2, *_peak(surface)))
        table = np.array(found, np.float64).reshape(-1, 5)
        return table[:, :2], table[:, 2:4] - PATCH_REACH_PX, table[:, 4]

    def _seen(self, values: Float32, valid: Bool) -> tuple[Float32, Float32]:
        """Return the (rows, cols, n) planes that are compared, and where they are usable, 1 or 0."""
        channels, usable = normalised_channels(values, valid)
        return np.asarray(cv2.GaussianBlur(channels, (0, 0), PATCH_BLUR_PX), np.float32), usable

    def _norms(self, planes: Float32, usable: Float32) -> Float64:
        """Return by what the windows of the target are normalised, of shape (…, rows, cols)."""
        return 1 / np.sqrt(np.maximum(window_sums((planes**2).sum(axis=2), PATCH_PX), 1e-6))

    def _surface(self, patch: tuple[slice, slice], search: Float32, norms: Float64) -> Float64:
        """Return how well a patch of the reference fits at each displacement."""
        return np.asarray(cv2.matchTemplate(search, self._planes[patch], cv2.TM_CCORR) * norms)


class _GreyPatches(_OverlappingPatches):
    """The same patches, compared by how far their grey values depend on each other, as `_GreyValues`."""

    _by_chance, _per_decade = GREY_AGREEING_BY_CHANCE, GREY_PATCHES_PER_DECADE

    def _seen(self, values: Float32, valid: Bool) -> tuple[Float32, Float32]:
        reach_px = GREY_REACH * max(self._valid.shape)
        planes = _rank_polynomials(values, valid, reach_px)
        return np.ascontiguousarray(planes[..., :2]), np.ascontiguousarray(planes[..., 2])

    def _norms(self, planes: Float32, usable: Float32) -> Float64:
        count = np.maximum(window_sums(usable, PATCH_PX), 1)
        sums = [
            (window_sums(plane, PATCH_PX), window_sums(plane**2, PATCH_PX))
            for plane in planes.transpose(2, 0, 1)
        ]
        return np.stack([1 / np.maximum(square - total**2 / count, 1e-3) for total, square in sums])

    def _surface(self, patch: tuple[slice, slice], search: Float32, norms: Float64) -> Float64:
        dependence = np.zeros(norms.shape[1:])
        known = self._usable[patch] > 0
        others = [np.ascontiguousarray(plane) for plane in search.transpose(2, 0, 1)]
        for plane in self._planes[patch].transpose(2, 0, 1):
            # without its mean the patch needs none of the windows that it is compared with
            varying = np.where(known, plane - plane[known].mean(), 0).astype(np.float32)
            energy = max(float((varying**2).sum()), 1e-3)
            for other, norm in zip(others, norms, strict=True):
                dependence += cv2.matchTemplate(other, varying, cv2.TM_CCORR) ** 2 * norm / energy
        return np.sqrt(dependence)


def _peak(surface: NDArray[Any]) -> tuple[int, int, float]:
    """Return (col, row) of the highest value, and that over the highest of those apart from it, minus 1."""
    row, col = divmod(int(surface.argmax()), surface.shape[1])
    highest, k = float(surface[row, col]), PATCH_CLEARANCE_PX
    surface[max(row - k, 0) : row + k + 1, max(col - k, 0) : col + k + 1] = 0
    return col, row, highest / max(float(surface.max()), 1e-6) - 1


def _consensus(middles: Float64, displacements: Float64, distinct: Float64, to_target: Float64) -> _Votes:
    """Return the affine change with which most of (n, 2) patches agree (doi:10.1145/358669.358692).

    The distinct ones are drawn more often; for `to_target` see `_Votes`.
    """
    n, moved = len(middles), middles + displacements
    no_consensus = _Votes(np.eye(3), np.zeros(n, bool), 0.0, middles, moved, to_target)
    if n < PATCHES.least:
        return no_consensus
    weights = np.clip(distinct, 0, 1) + 0.02
    # three different ones a sample, by the exponential race of their weights
    race = np.random.default_rng(0).exponential(size=(VOTE_SAMPLES, n)) / weights
    drawn = np.argpartition(race, 3, axis=1)[:, :3]
    places = np.column_stack([middles, np.ones(n)])
    drawn = drawn[np.abs(np.linalg.det(places[drawn])) >= 2 * LEAST_TRIANGLE_PX2]
    changes = solve(places[drawn], moved[drawn])
    changes = changes[_is_plausible(changes[:, :2])]
    if not len(changes):
        return no_consensus
    near = np.hypot(*np.moveaxis(places @ changes - moved, -1, 0)) <= VOTE_TOLERANCE_PX
    agrees = near[int(near.sum(axis=1).argmax())]
    for _ in range(CONSENSUS_REFITS):
        change = least_squares(places[agrees], moved[agrees])
        off = np.hypot(*(places @ change - moved).T)
        if np.count_nonzero(off <= VOTE_TOLERANCE_PX) < 3:
            break
        agrees = off <= VOTE_TOLERANCE_PX
    if not _is_plausible(change[None, :2])[0]:
        return no_consensus
    spread_px = float(np.percentile(off[agrees], 95))
    return _Votes(_affine(change[:2].T, change[2]), agrees, spread_px, middles, moved, to_target)


def _as_similarity(
    affine: Float64, reference_px: Float64, target_px: Float64, agrees: Bool, tolerance_px: float
) -> Float64:
    """Return a similarity if it keeps at least 85 % of the inliers of an affine pose, otherwise that pose.

    Patches in one part of an image tell two scales badly, and what follows from them elsewhere is far off.
    The poses are (3, 3), the positions (n, 2) (col, row), and `agrees` (n,) are those of the affine pose.
    """
    near = agrees
    for _ in range(CONSENSUS_REFITS):
        similarity = similarity_between(reference_px[near], target_px[near])
        near = np.hypot(*(mapped(similarity, reference_px) - target_px).T) <= tolerance_px
        if np.count_nonzero(near) < SIMILARITY_SHARE * np.count_nonzero(agrees):
            return affine
    return similarity


def _is_within(scale: float, scales: tuple[float, float]) -> bool:
    """Whether a scale is between the smallest and the largest that are tried, or a step beyond."""
    return scales[0] / SCALE_STEP <= scale <= scales[1] * SCALE_STEP


def _is_plausible(linear: Float64) -> Bool:
    """Return the (n,) mask of (n, 2, 2) matrices that do not mirror, and stretch within the limits."""
    values = np.linalg.svd(linear, compute_uv=False)
    smallest, largest = values[:, 1], values[:, 0]
    least, most = STRETCH_LIMITS
    within = (smallest >= least) & (largest <= most) & (largest <= MAX_ANISOTROPY * smallest)
    return np.asarray(within & (np.linalg.det(linear) > 0))


def _affine_by_patches(
    patches: _OverlappingPatches, starts: Sequence[PoseProposal], scales: tuple[float, float]
) -> PoseProposal | None:
    """Return the affine pose on which patches agree from one of several starts, whose evidence is added.

    A sample of the patches tells which starts are worth trying. It is None if the patches add too little
    evidence, or the scale is not within `scales`.
    """

    def sampled(start: PoseProposal) -> tuple[_Votes, Float64, PoseProposal]:
        pose = _square(start.matrix)
        return *_iterated_consensus(patches, *patches.vote(pose, sample=True), sample=True), start

    tries = sorted(map(sampled, starts), key=lambda each: -each[0].agreeing)
    for few, pose, start in tries[:FULL_STARTS]:
        if few.agreeing < MIN_SAMPLED and start.evidence < MIN_EVIDENCE_FOR_ALL_PATCHES:
            continue
        votes, pose = _iterated_consensus(patches, *patches.vote(pose), sample=False)
        own_evidence = patches.evidence(votes) - math.log10(
            len(starts)
        )  # of several starts one agrees by chance
        evidence = min(start.evidence + own_evidence, MAX_EVIDENCE)
        if own_evidence > 0 and evidence >= MIN_EVIDENCE and _is_within(_scale_of(pose), scales):
            spread_px, of = patches.px(votes.spread_px), len(votes.agrees)
            homography = patches.in_perspective(votes)
            return PoseProposal(pose[:2], start.score, evidence, of, votes.agreeing, spread_px, homography)
    return None


def _iterated_consensus(
    patches: _OverlappingPatches, votes: _Votes, pose: Float64, *, sample: bool
) -> tuple[_Votes, Float64]:
    """Let patches vote again from the (3, 3) pose that they agreed on, until no more agree."""
    for _ in range(CONSENSUS_ITERATIONS):
        newer, moved = patches.vote(pose, sample=sample)
        if newer.agreeing <= votes.agreeing:
            break
        votes, pose = newer, moved
    return votes, pose


def _stretched(reference: _PoseImage, target: _PoseImage, scales: tuple[float, float]) -> list[Float64]:
    """Search poses with the smaller image stretched in several directions; return the best (3, 3) ones."""
    limits = max(scales[0], STRETCHED_SCALES[0]), min(scales[1], STRETCHED_SCALES[1])
    turns = [(ratio, np.pi * (k + first) / n) for ratio, n, first in STRETCHES for k in range(n)]
    stretches = tuple(
        _rotation(along) @ np.diag([ratio**0.5, ratio**-0.5]) @ _rotation(along).T for ratio, along in turns
    )
    per_cell = tuple(side / STRETCHED_CELLS for side in LAYERS_PX)
    how = STRETCHED_CELLS, STRETCHED_ANGLE_STEP_DEG, STRETCHED_SCALE_STEP, stretches, per_cell
    scans = _Scan(reference, target, False, *how), _Scan(target, reference, True, *how)
    trials = itertools.chain(*(scan.everywhere(limits) for scan in scans))
    best = heapq.nlargest(8 * MAX_STRETCHED_POSES, trials, key=lambda each: each.score)
    distinct = _distinct(best, reference.values.shape, MAX_STRETCHED_POSES, CLOSE_DISTANCE)
    return [trial.matrix for trial in distinct]


def _ascended(reference: _PoseImage, target: _PoseImage, poses: Sequence[Float64]) -> list[PoseProposal]:
    """Let (3, 3) poses ascend to better affine ones; return those that differ, the best first."""
    for cells in ASCENT_CELLS:
        ascent = _Ascent(reference, target, cells)
        found = sorted(map(ascent.from_pose, poses), key=lambda each: -each[0])
        ranked = (pose for _, pose in found)
        chosen = _first_distinct(ranked, reference.values.shape, REFINED, DISTINCT_DISTANCE)
        best = [found[index] for index in chosen]
        poses = [pose for _, pose in best]
    evidence = [0.0] * len(best)
    if len(best) > 1:
        evidence[0] = _evidence_of_ratio(best[0][0], best[1][0], EVIDENCE_PER_ASCENDED_RATIO)
    return [PoseProposal(pose[:2], score, own) for (score, pose), own in zip(best, evidence, strict=True)]


class _Ascent:
    """Ascends from poses to affine ones of more correlation, by the gradient of the reference.

    As an inverse compositional alignment (doi:10.1023/B:VISI.0000011205.11775.fd), its steps as long as a
    correlation far below 1 wants them (doi:10.1109/TPAMI.2008.113).
    """

    def __init__(self, reference: _PoseImage, target: _PoseImage, cells: int) -> None:
        per_px = cells / reference.side_px
        rows, cols = self._shape = tuple(max(8, round(n * per_px)) for n in reference.values.shape)
        middle = (np.array([cols, rows]) - 1) / 2
        middle_px = (np.array(reference.values.shape[::-1]) - 1) / 2
        self._from_px = _affine(per_px * np.eye(2), middle - per_px * middle_px)
        self._to_px = inverse(self._from_px)
        self._per_cell = tuple(side / cells for side in LAYERS_PX)
        self._target, self._per_px, self._levels = target, per_px, dict[int, list[_Layer]]()
        self._known = np.ones(self._shape, np.float32)
        layers = reference.averaged(cells, self._per_cell)
        self._planes, self._known = self._placed_layers(layers, np.eye(3), 0.0)
        self._least = max(MIN_OVERLAP * float(self._known.sum()), MIN_CELLS)
        half = max(rows, cols) / 2
        self._unit = _affine(np.eye(2) / half, -middle / half)
        col, row = ((np.arange(n, dtype=np.float32) - (n - 1) / 2) / np.float32(half) for n in (cols, rows))
        down, right = np.gradient(self._planes, axis=(1, 2))
        slopes = [each * by for each in (right, down) for by in (col, row[:, None], np.float32(1))]
        self._slopes = np.stack(slopes).reshape(6, -1)

    def from_pose(self, pose: Float64) -> tuple[float, Float64]:
        """Return the best score, correlation times the root of the overlap, and its (3, 3) pose."""
        placed, known = self._placed(pose)
        score, normal = self._score(placed, known), self._normal(known)
        for _ in range(ASCENT_ROUNDS):
            step, to_cells = self._step(placed, known, normal), pose @ self._to_px
            for _ in range(1 + ASCENT_HALVINGS):
                moved = to_cells @ _undone(step @ self._unit) @ self._from_px
                there, valid = self._placed(moved)
                higher = self._score(there, valid)
                if higher > score:
                    break
                step = step / 2
            else:
                break
            gain, score, pose, placed, known = higher - score, higher, moved, there, valid
            if gain < LEAST_GAIN * abs(score):
                break
        return score, pose

    def score(self, pose: Float64) -> float:
        """Return the score of a (3, 3) pose, as that of `from_pose`."""
        return self._score(*self._placed(pose))

    def _score(self, placed: Float32, known: Float32) -> float:
        return float(np.vdot(placed, self._planes)) / math.sqrt(max(float(known.sum()), self._least))

    def _normal(self, known: Float32) -> Float64:
        slopes = self._slopes * np.broadcast_to(known, self._planes.shape).ravel()
        normal = (slopes @ self._slopes.T).astype(np.float64)
        return np.asarray(normal + 1e-3 * max(float(np.trace(normal)), 1e-6) / 6 * np.eye(6))

    def _step(self, placed: Float32, known: Float32, normal: Float64) -> Float64:
        """Return the (2, 3) change of (col, row) by (col, row, 1) that the gradient tells, up to a cell."""
        energy = float(((self._planes * known) ** 2).sum()), float((placed**2).sum())
        ratio = math.sqrt(energy[0] / max(energy[1], 1e-6))
        correlation = float(np.vdot(placed, self._planes)) / max(math.sqrt(energy[0] * energy[1]), 1e-6)
        right = (self._slopes @ placed.ravel()).astype(np.float64)
        step = solve(normal, right).reshape(2, 3) * ratio / max(correlation, LEAST_CORRELATION)
        return step / max(1.0, math.sqrt(float((step**2 @ [1 / 3, 1 / 3, 1.0]).sum())))

    def _placed(self, pose: Float64) -> tuple[Float32, Float32]:
        """Return the target as a pose places it on the cells of the reference, and where both are known."""
        side_cells = self._per_px * self._target.side_px / _scale_of(pose)
        level = round(4 * math.log2(side_cells))
        if level not in self._levels:
            self._levels[level] = self._target.averaged(2 ** (level / 4), self._per_cell)
        (a, b), (c, d) = pose[:2, :2].tolist()
        return self._placed_layers(self._levels[level], pose, -math.atan2(c - b, a + d))

    def _placed_layers(
        self, layers: Sequence[_Layer], pose: Float64, angle_rad: float
    ) -> tuple[Float32, Float32]:
        placed = np.empty((len(layers), LAYER_HARMONICS, *self._shape), np.float32)
        known = np.empty(self._shape, np.float32)
        for ((packed,), to_map), planes in zip(layers, placed, strict=True):
            to_image = np.ascontiguousarray((to_map @ pose @ self._to_px)[:2])
            place_layer(packed, to_image, -2 * angle_rad, self._known, known, planes)
        return placed.reshape(-1, *self._shape), known


class _GreyValues:
    """Tells how far the grey values of two images depend on each other where a pose places the target.

    What is bright in one image may be dark or of medium tone in the other. The dependence is the sum of the
    squared correlations of polynomials of the ranks, of the first and the second order: the mean square
    contingency, cut off there (Lancaster 1958, doi:10.1214/aoms/1177706532).
    """

    def __init__(self, reference: _PoseImage, target: _PoseImage, side_px: int) -> None:
        self._factor = min(1.0, side_px / reference.side_px)
        values, valid, self._to_small = _shrunk(reference.values, reference.valid, self._factor)
        self._shape, self._reach_px = valid.shape, GREY_REACH * max(values.shape)
        self._terms = _terms(_rank_polynomials(values, valid, self._reach_px))
        self._target, self._levels = target, dict[int, tuple[Float32, Float64]]()

    def dependence(self, pose: Float64) -> float:
        """Return the root of dependence times overlap in a (3, 3) pose; 0 where that is too small."""
        planes, to_level = self._level(_scale_of(pose))
        to_plane = (to_level @ pose @ inverse(self._to_small))[:2]
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        placed = cv2.warpAffine(planes, to_plane, self._shape[::-1], flags=flags)
        moved = _terms(np.asarray(placed, np.float32))
        sums = (self._terms.T @ moved).astype(np.float64)
        count = float(sums[4, 4])
        if count < MIN_CELLS:
            return 0.0
        cross = sums[:2, :2] - np.outer(sums[:2, 4], sums[4, :2]) / count
        fixed, other = sums[2:4, 4] - sums[:2, 4] ** 2 / count, sums[4, 2:4] - sums[4, :2] ** 2 / count
        return math.sqrt(count * float((cross**2 / np.maximum(np.outer(fixed, other), 1e-9)).sum()))

    def _level(self, scale: float) -> tuple[Float32, Float64]:
        """Return polynomials of the target about as coarse as the reference, and the matrix to them."""
        step = round(4 * math.log2(min(1.0, self._factor / scale)))
        if step not in self._levels:
            factor = 2 ** (step / 4)
            values, valid, to_level = _shrunk(self._target.values, self._target.valid, factor)
            reach_px = self._reach_px * factor * scale / self._factor
            self._levels[step] = _rank_polynomials(values, valid, reach_px), to_level
        return self._levels[step]


def _rank_polynomials(values: Float32, valid: Bool, reach_px: float) -> Float32:
    """Return Legendre polynomials of the ranks of grey values without their local mean.

    They are (rows, cols, 3): of first and second order, and 1 where they are valid.
    """
    planes = np.zeros((*values.shape, 3), np.float32)
    local = local_deviation(values, valid, reach_px)[valid]
    if len(local):
        planes[valid, :2] = Ranks.of(local).polynomials(local)
        planes[valid, 2] = 1
    return planes


def _terms(planes: Float32) -> Float32:
    """Return (n, 5) values, their squares and 1 of two planes, and 0 where the third is not nearly 1."""
    flat = planes.reshape(-1, 3)
    known = (flat[:, 2:] > 0.9).astype(np.float32)
    values = flat[:, :2] * known
    return np.concatenate([values, values**2, known], axis=1)


class _JointScore:
    """Scores poses by the structure and by the grey values of two images, and moves them to higher scores."""

    def __init__(self, reference: _PoseImage, target: _PoseImage, structure: _Ascent, stage: int) -> None:
        side_px = GREY_SIDES_PX[stage]
        self.structure, self.grey = structure, _GreyValues(reference, target, side_px)
        rows, cols = reference.values.shape
        self._middle = np.array([cols - 1, rows - 1]) / 2
        # by which a parameter moves the border, as a share of that distance
        self._steps = [2 * step / min(side_px, reference.side_px) for step in GREY_STEPS_PX[stage]]
        self._half = reference.side_px / 2

    def score(self, pose: Float64) -> float:
        """Return the product of both scores of a (3, 3) pose."""
        return self.grey.dependence(pose) * max(self.structure.score(pose), 0.0)

    def climbed(self, pose: Float64, *, affine: bool = False) -> tuple[float, Float64]:
        """Move a (3, 3) pose to the highest score near it by a pattern search; return both.

        The pose is changed by similarities, or by affine transformations (Hooke & Jeeves 1961,
        doi:10.1145/321062.321069).
        """
        best = self.score(pose)
        for step in self._steps:
            for _ in range(GREY_ROUNDS):
                before = best
                for change in _AFFINE_CHANGES if affine else _SIMILAR_CHANGES:
                    for by in (step, -step):
                        moved = pose @ self._about_middle(by * change)
                        score = self.score(moved)
                        if score > best:
                            best, pose = score, moved
                            break
                if best == before:
                    break
        return best, pose

    def _about_middle(self, change: Float64) -> Float64:
        """Return the (3, 3) transformation by a (2, 3) change, whose unit is half a side."""
        linear = np.eye(2) + change[:, :2]
        return _affine(linear, self._middle - linear @ self._middle + self._half * change[:, 2])


_AFFINE_CHANGES: Final = np.eye(6).reshape(6, 2, 3)[[2, 5, 0, 4, 1, 3]]
"""Changes of (col, row) by (col, row, 1), one parameter each, the shift first."""
_SIMILAR_CHANGES: Final = np.stack(
    [
        *_AFFINE_CHANGES[:2],
        _AFFINE_CHANGES[2] + _AFFINE_CHANGES[3],
        _AFFINE_CHANGES[4] - _AFFINE_CHANGES[5],
    ]
)
"""Shift, scale and rotation."""


def _confirmed(reference: _PoseImage, target: _PoseImage, proposal: PoseProposal) -> PoseProposal:
    """Return a proposal with what the correlation in a frame adds, if that may make a difference."""
    if not MIN_EVIDENCE_TO_CONFIRM <= proposal.evidence < MAX_EVIDENCE:
        return proposal
    return _Frame(reference, target, proposal).confirmed(proposal)


class _Frame:
    """A frame of the reference: patches and the correlation tell how well a target fits as placed in it."""

    def __init__(self, reference: _PoseImage, target: _PoseImage, proposal: PoseProposal) -> None:
        self._factor = min(1.0, proposal.scale, FRAME_PX / reference.side_px)
        values, valid, self._to_frame = _shrunk(reference.values, reference.valid, self._factor)
        self._target = _shrunk(target.values, target.valid, min(1.0, self._factor / proposal.scale))
        self._channels, self._shape = normalised_channels(values, valid), valid.shape

    def moved_to_consensus(self, proposal: PoseProposal) -> PoseProposal:
        """Compare patches of both, the target warped by a proposal, and move that to where they agree."""
        margin = np.array([FRAME_MARGIN_PX, FRAME_MARGIN_PX])
        best = proposal
        for _ in range(FRAME_ITERATIONS):
            warp, placed = self._placed(best.matrix)
            patches = Patches.matched(self._channels, placed, margin)
            if patches.agreeing <= best.agreeing:
                break
            step, left_px = patches.similarity()
            matrix = (inverse(self._target[2]) @ warp @ step @ self._to_frame)[:2]
            counts = patches.count, patches.agreeing
            best = PoseProposal(matrix, best.score, best.evidence, *counts, left_px / self._factor)
        return best

    def confirmed(self, proposal: PoseProposal) -> PoseProposal:
        """Add what the correlation tells of a proposal: whether it is highest where that puts the target.

        The two are combined as independent probabilities (Fisher's method), which is what they are of
        unrelated images: the search has seen cells of several of these pixels.
        """
        _, (channels, usable) = self._placed(proposal.matrix)
        inside = np.s_[FRAME_MARGIN_PX:-FRAME_MARGIN_PX, FRAME_MARGIN_PX:-FRAME_MARGIN_PX]
        ratio = ratio_in_place(self._channels, (channels[inside], usable[inside]))
        both = proposal.evidence + max(0.0, EVIDENCE_PER_CONFIRMING_RATIO * (ratio - CONFIRMING_RATIO))
        evidence = min(_fisher(both), MAX_EVIDENCE)
        return replace(proposal, evidence=max(proposal.evidence, evidence))

    def _placed(self, matrix: Float64) -> tuple[Float64, tuple[Float32, Float32]]:
        """Return the (3, 3) warp from the frame to the shrunk target, and its channels, with a margin."""
        values, known, to_small = self._target
        warp = to_small @ _square(matrix) @ inverse(self._to_frame)
        return warp, normalised_channels(*_warped_image(values, known, warp, self._shape, FRAME_MARGIN_PX))


def _warped_image(
    values: Float32, known: Bool, frame_to_image: Float64, shape: tuple[int, int], margin_px: int
) -> tuple[Float32, Bool]:
    """Resample an image onto a frame with a margin, and tell where its pixels are valid."""
    to_image = frame_to_image @ _affine(np.eye(2), np.full(2, -float(margin_px)))
    size = (shape[1] + 2 * margin_px, shape[0] + 2 * margin_px)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warp: Any = cv2.warpPerspective if to_image[2, :2].any() else cv2.warpAffine
    to_image = to_image if to_image[2, :2].any() else to_image[:2]
    total = warp(values, to_image, size, flags=flags)
    weight = warp(known.astype(np.float32), to_image, size, flags=flags)
    return np.asarray(total / np.maximum(weight, 1e-3), np.float32), np.asarray(weight > 0.9)


def _shrunk(values: Float32, valid: Bool, factor: float) -> tuple[Float32, Bool, Float64]:
    """Return an image averaged to a share of its size, its validity, and the (3, 3) matrix from its px."""
    rows, cols = (max(16, round(n * factor)) for n in values.shape)
    across, down = cols / values.shape[1], rows / values.shape[0]
    matrix = _affine(np.diag([across, down]), np.array([across - 1, down - 1]) / 2)
    if (rows, cols) == values.shape:
        return np.where(valid, values, np.float32(0)), valid, matrix
    weight = cv2.resize(valid.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(valid, values, np.float32(0)), (cols, rows), interpolation=cv2.INTER_AREA)
    known = np.asarray(weight >= 0.5)
    return np.where(known, total / np.maximum(weight, np.float32(1e-3)), np.float32(0)), known, matrix


def _turned(maps: Float32, angle_rad: float) -> Float32:
    """Rotate the orientations of (harmonics, rows, cols) maps; rows count downwards, orientations upwards."""
    if angle_rad == 0.0:
        return maps
    result = maps.copy()
    for index, order in ((1, 2), (3, 4))[: len(maps) // 2]:
        cos, sin = math.cos(order * angle_rad), -math.sin(order * angle_rad)
        result[index] = cos * maps[index] - sin * maps[index + 1]
        result[index + 1] = sin * maps[index] + cos * maps[index + 1]
    return result


def _affine(linear: Float64, origin: Float64) -> Float64:
    return np.vstack([np.column_stack([linear, origin]), [0.0, 0.0, 1.0]])


def _undone(change: Float64) -> Float64:
    """Return the (3, 3) inverse of the transformation that adds a (2, 3) change to positions."""
    (a, b, x), (c, d, y) = change.tolist()
    a, d = 1 + a, 1 + d
    size = a * d - b * c
    if size == 0:
        raise InputError(f"{SCALE} (a step of the search has none)")
    rows = (d, -b, b * y - d * x), (-c, a, c * x - a * y), (0.0, 0.0, size)
    return np.asarray(np.array(rows) / size, np.float64)


def _rotation(angle_rad: float) -> Float64:
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def _scale_of(matrix: Float64) -> float:
    return math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))


def _scale_at(homography: Float64, at_px: Float64) -> float:
    """Return by how much a (3, 3) homography, which may be affine, scales lengths at (col, row)."""
    depth = float(homography[2] @ [*at_px, 1.0])
    return math.sqrt(abs(float(np.linalg.det(homography / depth))))


def _warped(plane: Float32, matrix: Float64, shape: tuple[int, int]) -> Float32:
    return np.asarray(cv2.warpAffine(plane, matrix[:2], shape[::-1], flags=cv2.INTER_LINEAR), np.float32)
