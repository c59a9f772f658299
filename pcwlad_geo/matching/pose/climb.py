"""Poses that climb to where structure and grey values of two images agree the most."""

from __future__ import annotations

from typing import Final

import numpy as np

from pcwlad_geo.estimation.transforms import affine_matrix
from pcwlad_geo.matching.pose.ascent import Ascent
from pcwlad_geo.matching.pose.dependence import GreyDependence
from pcwlad_geo.matching.pose.image import PoseImage
from pcwlad_geo.matching.pose.parameters import PoseParameters
from pcwlad_geo.types import Float64

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


class JointScore:
    """Scores poses by the structure and by the grey values of two images, and moves them to higher scores.

    Its `stage` is 0 for many poses, on a small reference, and 1 for the best of them, on a larger one.
    """

    def __init__(
        self,
        reference: PoseImage,
        target: PoseImage,
        structure: Ascent,
        stage: int,
        parameters: PoseParameters,
    ) -> None:
        side_px, steps_px = parameters.grey.sides_px[stage], parameters.grey.steps_px[stage]
        self.structure = structure
        self.dependence = GreyDependence(reference, target, side_px, parameters)
        self._middle, self._half = reference.middle_px, reference.side_px / 2
        # by which a parameter moves the border, as a share of that distance
        self._steps = [2 * step / min(side_px, reference.side_px) for step in steps_px]
        self._rounds = parameters.grey.rounds

    def score(self, pose: Float64) -> float:
        """Return the product of both scores of a (3, 3) `pose`."""
        return self.dependence(pose) * max(self.structure.score(pose), 0.0)

    def climbed(self, pose: Float64, *, affine: bool = False) -> tuple[float, Float64]:
        """Move a (3, 3) `pose` to the highest score around it by a pattern search; return both.

        The pose is changed by similarities, or by affine transformations (Hooke & Jeeves 1961,
        doi:10.1145/321062.321069).
        """
        best = self.score(pose)
        for step in self._steps:
            for _ in range(self._rounds):
                before = best
                for change in _AFFINE_CHANGES if affine else _SIMILAR_CHANGES:
                    for signed in (step, -step):
                        candidate = pose @ self._about_middle(signed * change)
                        score = self.score(candidate)
                        if score > best:
                            best, pose = score, candidate
                            break
                if best == before:
                    break
        return best, pose

    def _about_middle(self, change: Float64) -> Float64:
        """Return the (3, 3) transformation by a (2, 3) change, whose unit is half a side."""
        linear = np.eye(2) + change[:, :2]
        return affine_matrix(linear, self._middle - linear @ self._middle + self._half * change[:, 2])
