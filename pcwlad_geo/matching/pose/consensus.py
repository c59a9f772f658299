"""The affine transformation on which the displacements of most patches agree, or a homography."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pcwlad_geo.estimation.solving import least_squares, solve
from pcwlad_geo.estimation.transforms import SimilarityTransform, affine_matrix, shift
from pcwlad_geo.matching.pose.parameters import ConsensusParameters
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """What patches of the reference say of an affine change of a pose."""

    matrix: Float64
    """(3, 3) of most support, voting px of the reference to those of the target as the pose places it."""
    agrees: Bool
    """(n,) mask of the patches that agree with it."""
    spread_px: float
    """Distance from it within which 95 % of these lie, voting px."""
    middles_px: Float64
    """(n, 2) middles (col, row) of the patches, voting px."""
    target_middles_px: Float64
    """(n, 2) where they are in the target as the pose places it, voting px."""
    to_target: Float64
    """(3, 3) from these voting px to px of the target."""

    @property
    def agreeing(self) -> int:
        """Number of patches that agree."""
        return int(np.count_nonzero(self.agrees))


def affine_consensus(
    middles: Float64,
    displacements: Float64,
    distinctness: Float64,
    to_target: Float64,
    parameters: ConsensusParameters,
) -> Votes:
    """Return the affine change with which most of n patches agree (doi:10.1145/358669.358692).

    The `middles` and `displacements` are (n, 2). Those of large (n,) `distinctness` are drawn more often. For
    the (3, 3) `to_target` see `Votes`.
    """
    n, targets = len(middles), middles + displacements
    no_consensus = Votes(np.eye(3), np.zeros(n, bool), 0.0, middles, targets, to_target)
    if n < parameters.least_patches:
        return no_consensus
    weights = np.clip(distinctness, 0, 1) + 0.02
    # three different ones a sample, by the exponential race of their weights
    race = np.random.default_rng(0).exponential(size=(parameters.samples, n)) / weights
    triples = np.argpartition(race, 3, axis=1)[:, :3]
    design = np.column_stack([middles, np.ones(n)])
    triples = triples[np.abs(np.linalg.det(design[triples])) >= 2 * parameters.least_triangle_px2]
    changes = solve(design[triples], targets[triples])
    changes = changes[_is_plausible(changes[:, :2], parameters)]
    if not len(changes):
        return no_consensus
    tolerance_px = parameters.tolerance_px
    agreement = np.hypot(*np.moveaxis(design @ changes - targets, -1, 0)) <= tolerance_px
    agrees = agreement[int(agreement.sum(axis=1).argmax())]
    for _ in range(parameters.refits):
        change = least_squares(design[agrees], targets[agrees])
        distances_px = np.hypot(*(design @ change - targets).T)
        if np.count_nonzero(distances_px <= tolerance_px) < 3:
            break
        agrees = distances_px <= tolerance_px
    if not _is_plausible(change[None, :2], parameters)[0]:
        return no_consensus
    spread_px = float(np.percentile(distances_px[agrees], 95))
    matrix = affine_matrix(change[:2].T, change[2])
    return Votes(matrix, agrees, spread_px, middles, targets, to_target)


def similarity_if_as_good(
    affine: Float64,
    reference_px: Float64,
    target_px: Float64,
    agrees: Bool,
    tolerance_px: float,
    parameters: ConsensusParameters,
) -> Float64:
    """Return a similarity if it keeps most of the inliers of an affine pose, otherwise that pose.

    Patches in one part of an image tell two scales badly, and what follows from them elsewhere is far off.
    The pose `affine`, and that returned, are (3, 3), the positions `reference_px` and `target_px` (n, 2) of
    (col, row), and the (n,) inliers `agrees` are those of the affine pose.
    """
    inliers = agrees
    for _ in range(parameters.refits):
        similarity = SimilarityTransform.fit(reference_px[inliers], target_px[inliers])
        inliers = np.hypot(*(similarity(reference_px) - target_px).T) <= tolerance_px
        if np.count_nonzero(inliers) < parameters.similarity_share * np.count_nonzero(agrees):
            return affine
    return similarity.matrix


def _is_plausible(linear: Float64, parameters: ConsensusParameters) -> Bool:
    """Return the (n,) mask of (n, 2, 2) matrices that do not mirror, and stretch within the limits."""
    values = np.linalg.svd(linear, compute_uv=False)
    smallest, largest = values[:, 1], values[:, 0]
    least, most = parameters.stretch_limits
    within = (smallest >= least) & (largest <= most) & (largest <= parameters.most_anisotropy * smallest)
    return np.asarray(within & (np.linalg.det(linear) > 0))


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
