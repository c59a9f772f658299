"""Corrections by an affine and waves along rows or columns, as jitter of the sensor displaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pcwlad_geo.correction.models import AffineCorrection, SmoothCorrection
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True, eq=False)
class JitterWave:
    """A wave of the displacement that depends on one coordinate of the target alone."""

    along: Literal["column", "row"]
    """The coordinate."""
    period_px: float
    origin_px: float
    """Coordinate at which the phase is zero."""
    coefficients_px: Float64
    """(2, 2) amplitudes (col, row) of the cosine, then of the sine."""

    def at(self, at_px: Float64) -> tuple[Float64, Float64]:
        """Return (n, 2) displacements at the (n, 2) `at_px` (col, row), and their (n, 2) slopes, 1/px."""
        frequency = 2 * np.pi / self.period_px
        phase = frequency * (np.asarray(at_px, dtype=np.float64)[:, self.axis] - self.origin_px)
        cosine, sine = np.cos(phase)[:, None], np.sin(phase)[:, None]
        of_cosine, of_sine = self.coefficients_px
        displacements = cosine * of_cosine + sine * of_sine
        return displacements, frequency * (cosine * of_sine - sine * of_cosine)

    @property
    def axis(self) -> int:
        """Index of the coordinate."""
        return 0 if self.along == "column" else 1

    def to_dict(self) -> dict[str, object]:
        """Return it as report.json holds it."""
        return {
            "along": self.along,
            "period": self.period_px,
            "origin": self.origin_px,
            "coefficients": self.coefficients_px.tolist(),
        }


@dataclass(frozen=True, slots=True, eq=False)
class JitterCorrection(SmoothCorrection):
    """observed = affine(predicted) + waves along the rows or the columns."""

    affine: AffineCorrection
    waves: tuple[JitterWave, ...]
    """The significant waves; empty where there are none."""

    @property
    def variance_px2(self) -> float:
        """Variance of the waves, of both components, px²."""
        return sum(float((wave.coefficients_px**2).sum()) / 2 for wave in self.waves)

    def _parameters(self) -> dict[str, object]:
        waves = [wave.to_dict() for wave in self.waves]
        return {"type": "jitter", "matrix": self.affine.matrix.tolist(), "waves": waves}

    def _forward(self, at_px: Float64) -> Float64:
        observed_px = self.affine.forward(at_px)
        for wave in self.waves:
            observed_px = observed_px + wave.at(at_px)[0]
        return observed_px

    def _slopes(self, at_px: Float64) -> Float64:
        slopes = np.tile(self.affine.matrix[:, :2], (len(at_px), 1, 1))
        for wave in self.waves:
            slopes[:, :, wave.axis] += wave.at(at_px)[1]
        return slopes
