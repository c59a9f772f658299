"""The coarse search: correlation of the structure of two images over rotations, ratios of sizes, and shifts.

It covers similarities, and where one image is stretched by several matrices, some affine transformations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.fft

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import rotation, shift
from pcwlad_geo.matching.kernels.pose_search import MASK_STEP, cross_spectra, weigh_by_overlap
from pcwlad_geo.matching.pose.distances import distinct_poses
from pcwlad_geo.matching.pose.image import Cells, PoseImage
from pcwlad_geo.matching.pose.parameters import StructureParameters
from pcwlad_geo.types import Float32, Float64


@dataclass(frozen=True, eq=False)
class Trial:
    """One rotation and ratio of sizes, and the best shift with them."""

    score: float
    angle_rad: float
    ratio: float
    scan: Scan
    moving: Cells
    fixed: Cells
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
        pose = inverse(from_px) @ shift(np.array([col, row], np.float64)) @ self.moving.from_px
        return inverse(pose) if self.scan.from_target else pose

    def _unwrapped(self, axis: int) -> int:
        """Return the shift along an axis with the largest overlap, of those equal modulo the period."""
        remainder, size = self.shift_rc[axis], self.period or 0
        moving, fixed = self.moving.shape[axis], self.fixed.shape[axis]
        first = 1 - fixed if self.opposite else 0
        shifts = (remainder - 2 * size, remainder - size, remainder)
        return max(shifts, key=lambda cells: min(cells + moving, first + fixed) - max(cells, first))


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A moving image, not larger than the fixed one, against all rotations of that."""

    moving: PoseImage
    fixed: PoseImage
    from_target: bool
    """Whether the target is the moving image."""
    parameters: StructureParameters
    stretches: tuple[Float64, ...] = field(default_factory=lambda: (rotation(0.0),))
    """(2, 2) matrices by which the moving image is stretched, by default as it is."""

    def trials(self, scales: tuple[float, float]) -> list[Trial]:
        """Try all rotations and ratios of the sizes; two equal sizes count for the reference as moving."""
        step = self.parameters.scale_step
        largest = self.fixed.side_px / self.moving.side_px
        limits = (1 / scales[1], 1 / scales[0]) if self.from_target else scales
        last = math.ceil(math.log(max(largest / limits[0], 1.0)) / math.log(step))
        ratios = [step**-number for number in range(int(self.from_target), 1 + last)]
        ratios = [ratio for ratio in ratios if ratio * largest <= limits[1] * step]
        ratios = [ratio for number, ratio in enumerate(ratios) if number % self._stride(ratio) == 0]
        angles = np.radians(np.arange(0.0, 180.0, self.parameters.angle_step_deg)).tolist()
        return list(self._trials(ratios, angles))

    def refined(self, trial: Trial) -> Trial:
        """Return the best of finer steps around a trial."""
        by = self.parameters
        steps = trial.stride * np.arange(-(by.fine_steps // 2), by.fine_steps // 2 + 1) / by.fine_steps
        angles = trial.angle_rad + np.radians(by.angle_step_deg) * steps
        ratios = trial.ratio * by.scale_step**steps
        fine = replace(self, parameters=replace(by, cells=by.fine_cells))
        trials = fine._trials(ratios.tolist(), angles.tolist(), trial.matrix)
        best = max(trials, key=lambda candidate: candidate.score, default=trial)
        return replace(best, score=math.sqrt(best.score * trial.score), scan=self)

    def _trials(
        self, ratios: Sequence[float], angles: Sequence[float], pose: Float64 | None = None
    ) -> Iterator[Trial]:
        """Try rotations and ratios, around a pose or anywhere, there with the opposite of each rotation too.

        A rotation and its opposite have conjugate spectra.
        """
        if not ratios:
            return
        cells, per_cell = self.parameters.cells, self.parameters.pixels_per_cell
        # Only shifts of little overlap wrap around, so less padding suffices.
        blocks = math.ceil(max(self.fixed.canvas_side(cells), 1.6 * cells) / MASK_STEP)
        size = MASK_STEP * scipy.fft.next_fast_len(blocks, real=True)
        images = list(self.fixed.rotations(cells, size, angles, per_cell))
        turns = list(zip(angles, images, strict=True))
        strides = {ratio: self._stride(ratio) if pose is None else 1 for ratio in ratios}
        rotations = {stride: _Rotations.of(turns[::stride]) for stride in set(strides.values())}
        fixed_area = max(image.area for image in images)
        for ratio, moving in self._moving(ratios, size):
            least = self.parameters.least_overlap * min(fixed_area, moving.area)
            least, stride = max(least, self.parameters.least_cells), strides[ratio]
            for opposite in (False, True) if pose is None else (False,):
                surfaces = rotations[stride].scores(moving, opposite, size, least, self.parameters.batch)
                for angle, fixed, score, highest in surfaces:
                    shift_rc = divmod(highest, size)
                    if pose is not None:
                        shift_rc = self._highest(score, self._expected(moving, fixed, pose))
                    best = float(score[shift_rc[0] % size, shift_rc[1] % size])
                    turned, period = angle + np.pi * opposite, size if pose is None else None
                    if best > 0:
                        yield Trial(
                            best, turned, ratio, self, moving, fixed, opposite, shift_rc, period, stride
                        )

    def _moving(self, ratios: Sequence[float], size: int) -> Iterator[tuple[float, Cells]]:
        for ratio in ratios:
            side = self.parameters.cells * ratio
            images = self.moving.stretched(side, size, self.stretches, self.parameters.pixels_per_cell)
            yield from ((ratio, image) for image in images)

    def _stride(self, ratio: float) -> int:
        return 2 if ratio <= self.parameters.small_ratio else 1

    def _expected(self, moving: Cells, fixed: Cells, pose: Float64) -> tuple[int, int]:
        """Return the shift (col, row), cells, at which a pose places the middle of the moving image."""
        onto_fixed = inverse(pose) if self.from_target else pose
        middle = np.array([(moving.shape[1] - 1) / 2, (moving.shape[0] - 1) / 2, 1.0])
        col, row, _ = fixed.from_px @ onto_fixed @ inverse(moving.from_px) @ middle - middle
        return round(col), round(row)

    def _highest(self, score: Float32, expected: tuple[int, int]) -> tuple[int, int]:
        """Return the shift (row, col) of the highest score around the (col, row) that is expected."""
        reach_cells = self.parameters.reach_cells
        reach = np.arange(-reach_cells, reach_cells + 1)
        part = score[np.ix_((expected[1] + reach) % len(score), (expected[0] + reach) % len(score))]
        down, right = divmod(int(part.argmax()), part.shape[1])
        return expected[1] + int(reach[down]), expected[0] + int(reach[right])


@dataclass(frozen=True, slots=True, eq=False)
class _Rotations:
    """Rotations of the fixed image, which are compared together."""

    angles_rad: tuple[float, ...]
    cells: tuple[Cells, ...]
    spectra: Float32
    """(n, harmonics, 2, rows, half the cols)."""
    masks: Float32
    """(n, 1, 2, …)."""

    @staticmethod
    def of(turns: Sequence[tuple[float, Cells]]) -> _Rotations:
        """Return these angles, radians, and images."""
        angles, cells = zip(*turns, strict=True)
        spectra = np.stack([image.spectra for image in cells])
        return _Rotations(angles, cells, spectra, np.stack([image.mask for image in cells]))

    def scores(
        self, moving: Cells, opposite: bool, size: int, least: float, batch: int
    ) -> Iterator[tuple[float, Cells, Float32, int]]:
        """Yield the angle, the image, the (size, size) scores of all shifts, and where the highest is.

        `opposite` is whether the fixed image is turned by half, `least` the least overlap, cells, and `batch`
        the largest number of scores computed together.
        """
        masks = cross_spectra(moving.mask, self.masks, opposite=opposite)
        overlaps = scipy.fft.irfft2(masks, [size // MASK_STEP] * 2, overwrite_x=True) / MASK_STEP**2
        count = max(1, batch // size**2)
        for start in range(0, len(self.cells), count):
            part = slice(start, start + count)
            spectra = cross_spectra(moving.spectra, self.spectra[part], opposite=opposite)
            scores = scipy.fft.irfft2(spectra, (size, size), overwrite_x=True)
            highest = weigh_by_overlap(scores, overlaps[part], least)
            yield from zip(self.angles_rad[part], self.cells[part], scores, highest.tolist(), strict=True)


def distinct_trials(trials: Iterable[Trial], shape: tuple[int, ...], count: int, least: float) -> list[Trial]:
    """Return the `count` best trials that differ, the best first; for `least` see `distinct_poses`."""
    ranked = sorted(trials, key=lambda trial: -trial.score)
    selection = distinct_poses((trial.matrix for trial in ranked), shape, count, least)
    return [ranked[index] for index in selection]
