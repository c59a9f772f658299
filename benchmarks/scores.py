"""The figures of the paper: NCM, CMR, RMSE, bias and scatter of matched points against a truth.

A point is correct where its error is below 2 px; RMSE, bias and scatter are those of the correct points.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CORRECT_BELOW_PX: Final = 2.0


@dataclass(frozen=True, slots=True)
class Score:
    """Figures of one set of matched points; NaN where no point is correct."""

    points: int
    correct: int
    """NCM, the number of correct matches."""
    rmse_px: float
    bias_px: tuple[float, ...]
    """Mean error per axis."""
    scatter_px: float
    """Standard deviation of the error about its mean, all axes together."""

    @property
    def share_correct(self) -> float:
        """CMR, correct points of all points."""
        return self.correct / self.points if self.points else float("nan")


def translation_errors(points: Array, truth_xy_px: tuple[float, float]) -> Array:
    """Return errors against a known translation.

    Parameters
    ----------
    points : (n, 4) array
        Reference x, y and target x, y, px.
    truth_xy_px : (float, float)
        Target minus reference position.

    Returns
    -------
    (n, 2) array
        Error along x and y, px.
    """
    return np.asarray(points[:, 2:] - points[:, :2] - np.asarray(truth_xy_px))


def epipolar_errors(points: Array) -> Array:
    """Return the signed distance of each target point to its epipolar line.

    The fundamental matrix is fitted to the points themselves (MAGSAC++), from a fixed seed.

    Parameters
    ----------
    points : (n, 4) array
        Reference x, y and target x, y, px; at least 8 rows.

    Returns
    -------
    (n, 1) array
        Distances in target px.
    """
    return distance_to_lines(points, fundamental_matrix(points))


def fundamental_matrix(points: Array) -> Array:
    """Return the (3, 3) fundamental matrix of (n, 4) points (MAGSAC++), from a fixed seed."""
    cv2.setRNGSeed(1)
    reference, target = points[:, :2].copy(), points[:, 2:].copy()
    fundamental, _ = cv2.findFundamentalMat(reference, target, cv2.USAC_MAGSAC, 1.0, 0.9999, 20000)
    return np.asarray(fundamental, dtype=np.float64)


def distance_to_lines(points: Array, fundamental: Array) -> Array:
    """Return the (n, 1) signed distances of target points to the lines that a fundamental matrix gives."""
    ones = np.ones((len(points), 1))
    lines = np.hstack([points[:, :2], ones]) @ fundamental.T
    distance = (np.hstack([points[:, 2:], ones]) * lines).sum(axis=1)
    return np.asarray((distance / np.hypot(lines[:, 0], lines[:, 1]))[:, None])


def score(errors: Array) -> Score:
    """Summarise (n, 1) or (n, 2) errors in px."""
    size = np.linalg.norm(errors, axis=1)
    correct = size < CORRECT_BELOW_PX
    if not correct.any():
        nan = float("nan")
        return Score(len(errors), 0, nan, (nan,) * errors.shape[1], nan)
    kept = errors[correct]
    return Score(
        points=len(errors),
        correct=int(correct.sum()),
        rmse_px=float(np.sqrt((size[correct] ** 2).mean())),
        bias_px=tuple(kept.mean(axis=0).tolist()),
        scatter_px=float(np.sqrt(kept.var(axis=0).sum())),
    )


def read_envi_points(path: Path) -> Array:
    """Return the points of an ENVI image-to-image file: (n, 4), reference x, y and target x, y."""
    lines = path.read_text(errors="replace").splitlines()
    rows = [[float(value) for value in line.split()[:4]] for line in lines if line.strip() and line[0] != ";"]
    return np.asarray(rows, dtype=np.float64).reshape(-1, 4)
