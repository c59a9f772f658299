"""A pose in terms that one can imagine: rotation, scale, shear and shift."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class Pose:
    """An affine transformation from reference to target file px, in terms that one can imagine."""

    rotation_deg: float
    """Clockwise rotation from reference to target, as both are seen on a screen, degrees."""
    scale: tuple[float, float]
    """Target px per reference px along columns and rows; the second is negative if mirrored."""
    shear_deg: float
    """By how much the angle between columns and rows differs from a right one, degrees."""
    shift_px: tuple[float, float]
    """(col, row) displacement of the middle of the reference, target px."""

    @staticmethod
    def of(matrix: Float64, shape: tuple[int, int]) -> Pose:
        """Return the pose of a matrix.

        Parameters
        ----------
        matrix : (3, 3) array
            Target px = matrix · reference px, corner-based (col, row).
        shape : (int, int)
            Rows and columns of the reference.
        """
        (a, b), (c, d) = matrix[:2, :2].tolist()
        across = math.hypot(a, c)
        down = (a * d - b * c) / across
        middle = np.array([shape[1] / 2, shape[0] / 2, 1.0])
        col, row = (matrix @ middle - middle)[:2].tolist()
        return Pose(
            math.degrees(math.atan2(c, a)),
            (across, down),
            math.degrees(math.atan2((a * b + c * d) / across, abs(down))),
            (col, row),
        )

    def beside(self, linear: Float64) -> Pose:
        """Return the pose beside a (2, 2) `linear` map from reference to target px, if that is known.

        Between two projections such a map turns and shears by itself.
        """
        if not np.isfinite(linear).all():
            return self
        turn, shear = math.radians(self.rotation_deg), math.radians(self.shear_deg)
        right = np.array([math.cos(turn), math.sin(turn)])
        down = abs(self.scale[1]) * math.tan(shear) * right + self.scale[1] * np.array([-right[1], right[0]])
        matrix = np.eye(3)
        matrix[:2, :2] = np.column_stack([self.scale[0] * right, down]) @ inverse(linear)
        return replace(Pose.of(matrix, (0, 0)), shift_px=self.shift_px)

    def __str__(self) -> str:
        return (
            f"rotation {self.rotation_deg:.1f} degrees, scale {self.scale[0]:.3f} x {self.scale[1]:.3f}, "
            f"shear {self.shear_deg:.1f} degrees"
        )
