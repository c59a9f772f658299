"""How much to smooth a thin-plate spline: generalised cross-validation that knows of shared errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.overlap import SharedErrors
from pcwlad_geo.correction.plate import Plate, mean_precision
from pcwlad_geo.correction.windows import Overlaps

Array = NDArray[np.float64]

MOST_FREEDOM = 0.6
"""Largest share of the points' information that the spline may use up."""
ROUNDS = 4
SETTLED = 0.02


@dataclass(frozen=True, slots=True)
class Trial:
    """A spline of some smoothing."""

    smoothing: float
    squares: float
    """Σ weighted squared residuals, mean of the axes."""
    used: tuple[float, float]
    """Share of the points' information used up if their errors are independent, and if windows share them."""
    errors: SharedErrors
    """What the residuals say about that."""

    def score(self, alpha: float) -> float:
        """Return the generalised cross-validation score; infinite where the spline has too much freedom.

        Correlated errors make a spline follow them, as if it had more parameters (Opsomer, Wang & Yang 2001,
        Nonparametric regression with correlated errors, Statistical Science 16(2), 134-153).
        """
        used = (1 - alpha) * self.used[0] + alpha * self.used[1]
        return self.squares / (1 - used) ** 2 if used < MOST_FREEDOM else np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Points with weights, ready for splines of any smoothing; col and row alike."""

    plate: Plate
    overlaps: Overlaps
    values_px: Array
    """(n, 2)."""
    precision: Array
    """(n,) 1/px², 0 for outliers."""
    inlier: Array
    """(n,) 1, or 0 for outliers."""
    probes: Array
    """(n, m) random signs."""

    @classmethod
    def of(
        cls, plate: Plate, overlaps: Overlaps, probes: Array, values_px: Array, whitener: Array, weight: Array
    ) -> Trials:
        """Return trials of a spline through (n, 2) values with (n, 2, 2) whiteners and robust weights.

        Inliers count in full: weights that follow the residuals would make these look small.
        """
        inlier = (weight > 0).astype(np.float64)
        return cls(plate, overlaps, values_px, mean_precision(whitener, inlier), inlier, probes)

    def smoothing(self, stiffness: float) -> float:
        """Return the λ of a stiffness."""
        return self.plate.smoothing(stiffness, self.precision)

    def at(self, smoothing: float) -> Trial:
        """Fit the spline, and what a spline of that smoothing makes of independent and of shared errors."""
        factor = self.plate.factor(self.plate.normal(self.precision), smoothing)
        root = np.sqrt(self.precision)[:, None]

        def remaining(whitened: Array) -> Array:
            found = factor.solve(self.plate.design.T @ (root * whitened))
            return np.asarray(whitened - root * (self.plate.design @ found))

        own, shared = self.inlier[:, None] * self.probes, self._shared(self.probes)
        left, left_own, left_shared = remaining(self.probes), remaining(own), remaining(shared)
        count = self.probes.shape[1]
        products = [[(a * b).sum() for b in (left_own, left_shared)] for a in (left, self._shared(left))]
        residual = remaining(root * self.values_px)
        squares = float((residual**2).sum()) / 2
        errors = SharedErrors.of(
            np.array(products) / count,
            squares,
            float((residual * self._shared(residual)).sum()) / 2,
            self.overlaps.patches(),
        )
        # Planes are left as they are, and counted exactly; random signs estimate the rest of the traces.
        planes = self.plate.planes(root[:, 0])
        bent = self.probes - planes @ (planes.T @ self.probes)
        smoothed = bent - remaining(bent)
        straight = (planes**2).sum(), (planes * self._shared(planes)).sum()
        used = [
            float(part + (smoothed * noise).sum() / count) / float(self.inlier.sum())
            for part, noise in zip(straight, (own, shared), strict=True)
        ]
        return Trial(smoothing, squares, (used[0], used[1]), errors)

    def _shared(self, vectors: Array) -> Array:
        inlier = self.inlier[:, None]
        return np.asarray(inlier * self.overlaps.times(inlier * vectors))


def best(trials: list[Trial], alpha: float) -> tuple[int, float]:
    """Return the index of the best of several smoothings, the stiffest first, and how far errors are shared.

    The two depend on each other: what the spline leaves says how far the errors are shared, and that says how
    much to smooth. From errors shared in full, which smooths most, the iteration comes down.

    Parameters
    ----------
    trials : list of Trial
    alpha : float
        First guess: 1, or an earlier result.
    """
    index = 0
    for _ in range(ROUNDS):
        index = int(np.argmin([trial.score(alpha) for trial in trials]))
        before, alpha = alpha, trials[index].errors.alpha
        if abs(alpha - before) < SETTLED:
            break
    return index, alpha
