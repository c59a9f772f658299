"""Homographies that grow from the affine transformation on which patches agree."""

from __future__ import annotations

import cv2
import numpy as np

from pcwlad_geo.estimation.transforms import shift
from pcwlad_geo.matching.pose.consensus import Votes
from pcwlad_geo.matching.pose.parameters import ConsensusParameters
from pcwlad_geo.types import Bool, Float64


def grown_homography(votes: Votes, parameters: ConsensusParameters) -> tuple[Float64, float]:
    """Return the (3, 3) homography grown from the affine change of votes, and its support."""
    best, agrees = votes.matrix, votes.agrees
    support, _ = support_of(votes, best, parameters.tolerance_px)
    for _ in range(parameters.refits):
        if np.count_nonzero(agrees) < parameters.least_patches:
            break
        middle = votes.middles_px[agrees].mean(axis=0)
        about, _ = cv2.findHomography(votes.middles_px[agrees] - middle, votes.target_middles_px[agrees])
        change = votes.matrix if about is None else about @ shift(-middle)
        higher, inliers = support_of(votes, change, parameters.tolerance_px)
        if higher <= support:
            break
        best, support, agrees = change, higher, inliers
    return best, support


def support_of(votes: Votes, change: Float64, tolerance_px: float) -> tuple[float, Bool]:
    """Return how far patches agree with a (3, 3) `change`, and the (n,) mask of those that do.

    A patch counts for 1 less the square of its distance, in tolerances (Torr & Zisserman 2000,
    doi:10.1006/cviu.1999.0832); a change that places one beyond the horizon has no support.
    """
    targets = np.column_stack([votes.middles_px, np.ones(len(votes.middles_px))]) @ change.T
    if (targets[:, 2] <= 0).any():
        return 0.0, np.zeros(len(targets), bool)
    distances = np.hypot(*(targets[:, :2] / targets[:, 2:] - votes.target_middles_px).T) / tolerance_px
    return float(np.maximum(1 - distances**2, 0.0).sum()), distances <= 1
