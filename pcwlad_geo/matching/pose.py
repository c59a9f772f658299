"""Search for the pose between two images of different modality: any rotation, scale and shift.

Rotating an image rotates its orientation channels and shifts them cyclically, so that the channels of one
resolution serve all rotations. With harmonics of the orientation the cyclic shift is a product with a phase.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching.kernels.phase_congruency import ORIENTATIONS
from pcwlad_geo.matching.shift_search import Patches, normalised_channels, patches_against_chance
from pcwlad_geo.types import Bool, Float32, Float64

CORRELATION_CELLS: Final = 112
"""Longer side of the larger image, in cells of the correlation."""
PIXELS_PER_CELL: Final = 3.0
"""Channels are computed at so many pixels a cell and averaged: they tolerate the steps of the search."""
ANGLE_STEP_DEG: Final = 4.0
"""Step of the rotations; half of it moves the border of the image by two cells."""
SCALE_STEP: Final = 1.08
"""Ratio of one scale to the next; half of it moves the border of the image by two cells."""
SCALES: Final = (0.25, 4.0)
"""Smallest and largest scale, target px per reference px."""
MIN_OVERLAP: Final = 0.25
"""Least overlap of a pose, as a share of the smaller image's valid area."""
MIN_CELLS: Final = 16.0
"""Least overlap of a pose, cells."""
DISTINCT: Final = 0.08
"""Two poses are distinct if they place an image this share of its longer side apart, on average."""
REFINED: Final = 16
"""Number of distinct poses that are tried again with finer steps."""
FINE_CELLS: Final = 160
"""Longer side of the larger image, in cells of the correlation with finer steps."""
FINER: Final = 3
"""Number of fine steps to a coarse one."""
REACH_CELLS: Final = 3
"""Largest change of the shift by the finer steps."""
MASK_STEP: Final = 4
"""The overlap of two images is counted on every so-manieth cell along each axis."""
FRAME_PX: Final = 288
"""Longer side of the frame in which the patches of a pose are compared."""
FRAME_MARGIN_PX: Final = 16
"""Margin of the target around that frame."""
ROUNDS: Final = 2
"""Number of times that patches are compared, each time from the similarity that they agreed on."""
EVIDENCE_PER_RATIO: Final = 8.0
"""Evidence for a pose whose score is twice that of its best rival, see docs/accuracy.md."""
MAX_EVIDENCE: Final = 4.0
"""Largest evidence that a score can give by itself: the tie points must give the rest."""
MIN_EVIDENCE: Final = 2.0
"""Least evidence of a pose that is worth a match; tie points alone would accept a chance pose of many."""

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

Complex64 = NDArray[np.complex64]


@dataclass(frozen=True, slots=True, eq=False)
class PoseProposal:
    """A similarity that the search proposes, and its support."""

    matrix: Float64
    """(2, 3): target px (col, row) = matrix · (col, row, 1) of the reference, array indices."""
    score: float
    """Correlation times the root of the overlap in cells, which is fair between large and small overlaps."""
    evidence: float
    """-log10 of the probability, as measured, that the score of unrelated images stands out as much."""
    patches: int = 0
    """Number of patches that were compared."""
    agreeing: int = 0
    """Number of patches that agree on the similarity."""
    spread_px: float = 0.0
    """Distance from the similarity within which 95 % of the agreeing patches lie, reference px."""

    @property
    def significance(self) -> float:
        """-log10 of the probability that as many patches agree by chance; 0 for a few patches."""
        return patches_against_chance(self.agreeing, self.patches)

    @property
    def accepted(self) -> bool:
        """Whether the score stands out of all others."""
        return self.evidence >= MIN_EVIDENCE

    @property
    def scale(self) -> float:
        """Target px per reference px."""
        return _scale_of(self.matrix)


@dataclass(frozen=True, eq=False)
class _Trial:
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
    cycle: int | None
    """Size of the cycle that the shift is known in, cells; None where it is known."""

    @cached_property
    def matrix(self) -> Float64:
        """(3, 3) target px = matrix · reference px, array indices."""
        row, col = self.shift_rc if self.cycle is None else map(self._nearest_cycle, (0, 1))
        from_px = np.diag([-1.0, -1.0, 1.0]) @ self.fixed.from_px if self.opposite else self.fixed.from_px
        shift = _affine(np.eye(2), np.array([col, row], np.float64))
        found = inverse(from_px) @ shift @ self.moving.from_px
        return inverse(found) if self.scan.from_target else found

    def _nearest_cycle(self, axis: int) -> int:
        """Return the shift along an axis, of those that are one in the cycle, with the largest overlap."""
        at, size = self.shift_rc[axis], self.cycle or 0
        moving, fixed = self.moving.shape[axis], self.fixed.shape[axis]
        first = 1 - fixed if self.opposite else 0
        shifts = (at - 2 * size, at - size, at)
        return max(shifts, key=lambda shift: min(shift + moving, first + fixed) - max(shift, first))


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """One image in cells, transformed for the correlation."""

    spectra: Complex64
    """(harmonics, rows, half the cols)."""
    mask: Complex64
    """Spectrum of the mask, of a coarser lattice."""
    shape: tuple[int, int]
    """Rows and columns before the zeros that the transform adds."""
    area: float
    """Number of valid cells."""
    from_px: Float64
    """(3, 3) px of the image to cells, array indices."""


@dataclass(slots=True, eq=False)
class _Image:
    """One image, with its channels at the resolutions that were asked for so far."""

    values: Float32
    valid: Bool
    _levels: dict[int, tuple[Float32, Float32, Float64]] = field(default_factory=dict)

    @property
    def side_px(self) -> int:
        return int(max(self.values.shape))

    def canvas_side(self, side_cells: float) -> int:
        """Return the side of a square that holds the image however it is rotated, cells."""
        rows, cols = self.values.shape
        return math.ceil(math.hypot(rows, cols) * side_cells / self.side_px) + 1

    def in_cells(self, side_cells: float, size: int, angles_rad: Sequence[float] = ()) -> Iterator[_Cells]:
        """Yield the image with its longer side of so many cells, rotated about its middle; else as it is."""
        maps, usable, to_map = self._level(side_cells)
        per_px = side_cells / self.side_px
        sigma_px = 0.5 * _scale_of(to_map) / per_px  # half a cell: nothing between two samples is missed
        blurred = [np.asarray(cv2.GaussianBlur(plane, (0, 0), sigma_px), np.float32) for plane in maps]
        rows, cols = (max(8, round(n * per_px)) for n in self.values.shape)
        if angles_rad:
            rows = cols = self.canvas_side(side_cells)
        middle_px, from_map = (np.array(self.values.shape[::-1]) - 1) / 2, inverse(to_map)
        for angle_rad in angles_rad or (0.0,):
            linear = per_px * _rotation(angle_rad)
            from_px = _affine(linear, (np.array([cols, rows]) - 1) / 2 - linear @ middle_px)
            warp = from_px @ from_map
            known = (_warped(usable, warp, (rows, cols)) > 0.5).astype(np.float32)
            values = np.stack([_warped(plane, warp, (rows, cols)) * known for plane in blurred])
            yield _Cells(
                scipy.fft.rfft2(_turned(values, angle_rad), (size, size)),
                _mask_spectrum(known, size),
                (rows, cols),
                float(known.sum()),
                from_px,
            )

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

    moving: _Image
    fixed: _Image
    from_target: bool
    """Whether the target is the moving image."""
    cells: int = CORRELATION_CELLS
    """Longer side of the fixed image, cells."""

    def everywhere(self, scales: tuple[float, float]) -> Iterator[_Trial]:
        """Try all rotations and ratios of the sizes; two equal sizes count for the reference as moving."""
        largest = self.fixed.side_px / self.moving.side_px
        limits = (1 / scales[1], 1 / scales[0]) if self.from_target else scales
        steps = range(
            int(self.from_target),
            1 + math.ceil(math.log(max(largest / limits[0], 1.0)) / math.log(SCALE_STEP)),
        )
        ratios = [
            SCALE_STEP**-step for step in steps if SCALE_STEP**-step * largest <= limits[1] * SCALE_STEP
        ]
        angles = np.radians(np.arange(0.0, 180.0, ANGLE_STEP_DEG)).tolist()
        return self._trials(ratios, angles, both_halves=True)

    def around(self, trial: _Trial) -> _Trial:
        """Return the best of finer steps around a trial."""
        steps = np.arange(-(FINER // 2), FINER // 2 + 1) / FINER
        angles = trial.angle_rad + np.radians(ANGLE_STEP_DEG) * steps
        ratios = trial.ratio * SCALE_STEP**steps
        fine = replace(self, cells=FINE_CELLS)
        finer = fine._trials(ratios.tolist(), angles.tolist(), both_halves=False, near=trial.matrix)
        best = max(finer, key=lambda each: each.score, default=trial)
        return replace(best, score=math.sqrt(best.score * trial.score), scan=self)

    def _trials(
        self,
        ratios: Sequence[float],
        angles: Sequence[float],
        *,
        both_halves: bool,
        near: Float64 | None = None,
    ) -> Iterator[_Trial]:
        """Try rotations and ratios; a rotation and its opposite have conjugate spectra."""
        if not ratios:
            return
        # Shifts of little overlap may meet others beyond the end: so the transform stays small.
        side = self.fixed.canvas_side(self.cells)
        coarse = math.ceil(max(side, 1.6 * self.cells) / MASK_STEP)
        size = MASK_STEP * scipy.fft.next_fast_len(coarse, real=True)
        rotated = list(self.fixed.in_cells(self.cells, size, angles))
        spectra = np.stack([cells.spectra for cells in rotated], axis=1)
        masks = np.stack([cells.mask for cells in rotated])[None]
        fixed_area = max(cells.area for cells in rotated)
        for ratio in ratios:
            (moving,) = self.moving.in_cells(self.cells * ratio, size)
            least = max(MIN_OVERLAP * min(fixed_area, moving.area), MIN_CELLS)
            for opposite in (False, True) if both_halves else (False,):
                scores = _scores(moving, spectra, masks, opposite, size, least)
                for angle, cells, score in zip(angles, rotated, scores, strict=True):
                    shift_rc = _highest(score, self._expected(moving, cells, near))
                    best = float(score[shift_rc[0] % size, shift_rc[1] % size])
                    turned = angle + np.pi * opposite
                    cycle = size if near is None else None
                    if best > 0:
                        yield _Trial(best, turned, ratio, self, moving, cells, opposite, shift_rc, cycle)

    def _expected(self, moving: _Cells, fixed: _Cells, near: Float64 | None) -> tuple[int, int] | None:
        """Return the shift (col, row), cells, at which a pose places the middle of the moving image."""
        if near is None:
            return None
        pose = inverse(near) if self.from_target else near
        middle = np.array([(moving.shape[1] - 1) / 2, (moving.shape[0] - 1) / 2, 1.0])
        col, row, _ = fixed.from_px @ pose @ inverse(moving.from_px) @ middle - middle
        return round(col), round(row)


def search_pose(
    reference: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    reference_valid: Bool,
    target_valid: Bool,
    *,
    scales: tuple[float, float] = SCALES,
) -> PoseProposal | None:
    """Find the similarity between two images whose structure agrees best.

    Parameters
    ----------
    reference, target : (rows, cols) float array
        Best about 300 to 1000 px a side; the values of invalid pixels are ignored.
    reference_valid, target_valid : (rows, cols) bool array
        True where a pixel of the image is valid.
    scales : (float, float)
        Smallest and largest scale that is tried, target px per reference px.

    Returns
    -------
    PoseProposal or None
        The best, accepted or not; None where nothing could be compared.

    References
    ----------
    .. [1] Padfield, D. (2012), doi:10.1109/TIP.2011.2181402 (masked normalised cross-correlation).
    """
    first = _Image(np.asarray(reference, np.float32), reference_valid)
    second = _Image(np.asarray(target, np.float32), target_valid)
    trials = [
        trial
        for scan in (_Scan(first, second, from_target=False), _Scan(second, first, from_target=True))
        for trial in scan.everywhere(scales)
    ]
    finer = [trial.scan.around(trial) for trial in _distinct(trials, reference.shape)]
    ranked = _distinct(finer, reference.shape)
    if not ranked:
        return None
    best, rival = ranked[0], ranked[1].score if len(ranked) > 1 else 0.0
    stands_out = EVIDENCE_PER_RATIO * (best.score / rival - 1) if rival > 0 else MAX_EVIDENCE
    return _moved_to_consensus(
        first, second, PoseProposal(best.matrix[:2], best.score, min(stands_out, MAX_EVIDENCE))
    )


def mean_distance_px(first: Float64, second: Float64, shape: tuple[int, ...]) -> float:
    """Return how far apart two transformations place the pixels of an image on average.

    Parameters
    ----------
    first, second : (2, 3) or (3, 3) array
        Affine, of px (col, row).
    shape : (int, int)
        Rows and columns of the image.
    """
    row, col = np.mgrid[0 : shape[0] : 9j, 0 : shape[1] : 9j]
    places = np.stack([col.ravel(), row.ravel(), np.ones(row.size)])
    return float(np.hypot(*((first - second)[:2] @ places)).mean())


def _distinct(trials: Iterable[_Trial], shape: tuple[int, ...]) -> list[_Trial]:
    """Return the best trials that differ, the best first."""
    chosen: list[_Trial] = []
    for trial in sorted(trials, key=lambda each: -each.score):
        distinct_px = DISTINCT * max(shape) * _scale_of(trial.matrix)
        if all(mean_distance_px(trial.matrix, other.matrix, shape) > distinct_px for other in chosen):
            chosen.append(trial)
        if len(chosen) == REFINED:
            break
    return chosen


def _scores(
    moving: _Cells, spectra: Complex64, masks: Complex64, opposite: bool, size: int, least: float
) -> Float32:
    """Return the (rotations, size, size) scores of all shifts against every rotation of the fixed image.

    Parameters
    ----------
    spectra : (harmonics, rotations, size, half the size) complex64 array
        Of the fixed image; turned by half, it has the conjugate.
    masks : (1, rotations, rows, half the cols) complex64 array
        The same of its mask.
    least : float
        Least overlap, cells.
    """
    blocks = (size // MASK_STEP, MASK_STEP) * 2
    scores = scipy.fft.irfft2(_cross_spectra(moving.spectra, spectra, opposite), (size, size))
    overlap = scipy.fft.irfft2(_cross_spectra(moving.mask[None], masks, opposite), blocks[::2])
    overlap /= MASK_STEP**2
    weight = (overlap >= least) / np.sqrt(np.maximum(overlap, 1.0))
    by_block = scores.reshape(-1, *blocks)
    by_block *= weight[:, :, None, :, None]
    return np.asarray(scores)


def _highest(score: Float32, expected: tuple[int, int] | None) -> tuple[int, int]:
    """Return the shift (row, col) of the highest score, near the (col, row) that is expected."""
    if expected is None:
        row, col = divmod(int(score.argmax()), score.shape[1])
        return row, col
    reach = np.arange(-REACH_CELLS, REACH_CELLS + 1)
    part = score[np.ix_((expected[1] + reach) % len(score), (expected[0] + reach) % len(score))]
    down, right = divmod(int(part.argmax()), part.shape[1])
    return expected[1] + int(reach[down]), expected[0] + int(reach[right])


def _cross_spectra(moving: Complex64, fixed: Complex64, opposite: bool) -> Complex64:
    """Sum the cross spectra over the harmonics; the fixed image turned by half has the conjugate."""
    moving = moving if opposite else moving.conj()
    total, product = moving[0] * fixed[0], np.empty_like(fixed[0])
    for first, second in zip(moving[1:], fixed[1:], strict=True):
        total += np.multiply(first, second, out=product)
    return np.asarray(total.conj() if opposite else total)


def _mask_spectrum(known: Float32, size: int) -> Complex64:
    """Transform a mask summed over blocks, for a count of the overlap that may be coarse."""
    padded = np.zeros((size, size), np.float32)
    padded[: known.shape[0], : known.shape[1]] = known
    blocks = padded.reshape((size // MASK_STEP, MASK_STEP) * 2)
    return np.asarray(scipy.fft.rfft2(blocks.sum(axis=(1, 3))), np.complex64)


def _moved_to_consensus(reference: _Image, target: _Image, proposal: PoseProposal) -> PoseProposal:
    """Compare patches of both images, the target warped by a proposal, and move that to where they agree."""
    factor = min(1.0, proposal.scale, FRAME_PX / reference.side_px)
    values, valid, to_frame = _shrunk(reference.values, reference.valid, factor)
    small, known, to_small = _shrunk(target.values, target.valid, min(1.0, factor / proposal.scale))
    channels = normalised_channels(values, valid)
    margin = np.array([FRAME_MARGIN_PX, FRAME_MARGIN_PX])
    best = proposal
    for _ in range(ROUNDS):
        warp = to_small @ _square(best.matrix) @ inverse(to_frame)
        warped = _warped_image(
            small, known, warp @ _affine(np.eye(2), -margin.astype(np.float64)), valid.shape
        )
        patches = Patches.matched(channels, normalised_channels(*warped), margin)
        if patches.agreeing <= best.agreeing:
            break
        step, left_px = patches.similarity()
        matrix = inverse(to_small) @ warp @ step @ to_frame
        best = PoseProposal(
            matrix[:2], proposal.score, proposal.evidence, patches.count, patches.agreeing, left_px / factor
        )
    return best


def _warped_image(
    values: Float32, known: Bool, frame_to_image: Float64, shape: tuple[int, int]
) -> tuple[Float32, Bool]:
    """Resample an image onto a frame with a margin, and tell where its pixels are valid."""
    size = (shape[1] + 2 * FRAME_MARGIN_PX, shape[0] + 2 * FRAME_MARGIN_PX)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    total = cv2.warpAffine(values, frame_to_image[:2], size, flags=flags)
    weight = cv2.warpAffine(known.astype(np.float32), frame_to_image[:2], size, flags=flags)
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
    result = maps.copy()
    for index, order in ((1, 2), (3, 4)):
        cos, sin = math.cos(order * angle_rad), -math.sin(order * angle_rad)
        result[index] = cos * maps[index] - sin * maps[index + 1]
        result[index + 1] = sin * maps[index] + cos * maps[index + 1]
    return result


def _rotation(angle_rad: float) -> Float64:
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def _affine(linear: Float64, origin: Float64) -> Float64:
    return np.vstack([np.column_stack([linear, origin]), [0.0, 0.0, 1.0]])


def _square(matrix: Float64) -> Float64:
    return np.vstack([matrix, [0.0, 0.0, 1.0]])


def _scale_of(matrix: Float64) -> float:
    return math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))


def _warped(plane: Float32, matrix: Float64, shape: tuple[int, int]) -> Float32:
    return np.asarray(cv2.warpAffine(plane, matrix[:2], shape[::-1], flags=cv2.INTER_LINEAR), np.float32)
