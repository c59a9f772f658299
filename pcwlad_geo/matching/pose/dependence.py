"""How far the grey values of two images depend on each other in a pose."""

from __future__ import annotations

import math

import cv2
import numpy as np

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import scale_of
from pcwlad_geo.matching.grey_values import Ranks, local_deviation
from pcwlad_geo.matching.pose.image import PoseImage
from pcwlad_geo.matching.pose.parameters import PoseParameters
from pcwlad_geo.matching.pose.resampling import shrunk
from pcwlad_geo.types import Bool, Float32, Float64


class GreyDependence:
    """The dependence of the grey values of two images where a pose places the target.

    What is bright in one image may be dark or of medium tone in the other. The dependence is the sum of the
    squared correlations of polynomials of the ranks, of the first and the second order: the mean square
    contingency, cut off there (Lancaster 1958, doi:10.1214/aoms/1177706532).
    """

    def __init__(
        self, reference: PoseImage, target: PoseImage, side_px: int, parameters: PoseParameters
    ) -> None:
        self._factor = min(1.0, side_px / reference.side_px)
        values, valid, self._to_small = shrunk(reference.values, reference.valid, self._factor)
        self._shape, self._reach_px = valid.shape, parameters.grey.reach * max(values.shape)
        self._least_cells = parameters.structure.least_cells
        self._terms = _terms(rank_polynomials(values, valid, self._reach_px))
        self._target, self._levels = target, dict[int, tuple[Float32, Float64]]()

    def __call__(self, pose: Float64) -> float:
        """Return the root of dependence times overlap in a (3, 3) `pose`; 0 where that is too small."""
        planes, to_level = self._level(scale_of(pose))
        to_plane = (to_level @ pose @ inverse(self._to_small))[:2]
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        target_planes = cv2.warpAffine(planes, to_plane, self._shape[::-1], flags=flags)
        target_terms = _terms(np.asarray(target_planes, np.float32))
        sums = (self._terms.T @ target_terms).astype(np.float64)
        count = float(sums[4, 4])
        if count < self._least_cells:
            return 0.0
        cross = sums[:2, :2] - np.outer(sums[:2, 4], sums[4, :2]) / count
        first, second = sums[2:4, 4] - sums[:2, 4] ** 2 / count, sums[4, 2:4] - sums[4, :2] ** 2 / count
        return math.sqrt(count * float((cross**2 / np.maximum(np.outer(first, second), 1e-9)).sum()))

    def _level(self, scale: float) -> tuple[Float32, Float64]:
        """Return polynomials of the target about as coarse as the reference, and the matrix to them."""
        step = round(4 * math.log2(min(1.0, self._factor / scale)))
        if step not in self._levels:
            factor = 2 ** (step / 4)
            values, valid, to_level = shrunk(self._target.values, self._target.valid, factor)
            reach_px = self._reach_px * factor * scale / self._factor
            self._levels[step] = rank_polynomials(values, valid, reach_px), to_level
        return self._levels[step]


def rank_polynomials(values: Float32, valid: Bool, reach_px: float) -> Float32:
    """Return Legendre polynomials of the ranks of grey values without their local mean.

    They are (rows, cols, 3) of the (rows, cols) `values`: of first and second order, and 1 where the (rows,
    cols) bool array `valid` is true. The mean is that of a Gaussian of sigma `reach_px`.
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
    usable = (flat[:, 2:] > 0.9).astype(np.float32)
    values = flat[:, :2] * usable
    return np.concatenate([values, values**2, usable], axis=1)
