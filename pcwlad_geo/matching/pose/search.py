"""Search for the pose between two images of different modality by the structure that both show."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.pose.ascent import ascended, stretched_starts
from pcwlad_geo.matching.pose.frame import Frame, confirmed
from pcwlad_geo.matching.pose.image import PoseImage
from pcwlad_geo.matching.pose.parameters import POSE, PoseParameters
from pcwlad_geo.matching.pose.patch_votes import VotingPatches, is_within, voted_pose
from pcwlad_geo.matching.pose.proposal import PoseProposal, evidence_of_ratio
from pcwlad_geo.matching.pose.structure import Scan, Trial, distinct_trials
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True, eq=False)
class PoseSearch:
    """The result of a search by the structure, and what one by the grey values goes on from."""

    proposal: PoseProposal | None
    """The pose in which most structure agrees, accepted or not; None if none could be compared."""
    trials: list[tuple[float, Float64]]
    """Scores and (3, 3) poses of the coarse search, those whose grey values are compared, the best first."""
    reference: PoseImage
    target: PoseImage
    scales: tuple[float, float]
    parameters: PoseParameters


def search_pose(
    reference: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    reference_valid: Bool,
    target_valid: Bool,
    *,
    scales: tuple[float, float] | None = None,
    stretched: bool = True,
    parameters: PoseParameters = POSE,
) -> PoseSearch:
    """Find the similarity, or the affine transformation, between two images whose structure agrees best.

    The coarse search knows similarities. From the best of them patches vote for an affine transformation.
    Where they agree on none, and no similarity stands out, stretched images are searched, and affine poses
    ascend from all of these to where most of the whole image correlates.

    Parameters
    ----------
    reference, target : (rows, cols) float array
        Best about 300 to 1000 px a side; the values of invalid pixels are ignored.
    reference_valid, target_valid : (rows, cols) bool array
        True where a pixel of the image is valid.
    scales : (float, float), optional
        Smallest and largest scale that is tried, target px per reference px; None: those of the parameters.
    stretched : bool
        Whether the search goes on where no similarity is found: from others, and with a stretched reference.
    parameters : PoseParameters
        Those in use, unless a study varies them.

    Returns
    -------
    PoseSearch

    References
    ----------
    .. [1] Padfield, D. (2012), doi:10.1109/TIP.2011.2181402 (masked normalised cross-correlation).
    """
    first = PoseImage(np.asarray(reference, np.float32), reference_valid, parameters.structure)
    second = PoseImage(np.asarray(target, np.float32), target_valid, parameters.structure)
    scales = scales or parameters.structure.scales
    scans = (
        Scan(first, second, False, parameters.structure),
        Scan(second, first, True, parameters.structure),
    )
    ranked = sorted(itertools.chain(*(scan.trials(scales) for scan in scans)), key=lambda trial: -trial.score)
    proposal = _best_by_structure(first, second, ranked, scales, stretched, parameters)
    # the other trials take much memory
    trials = [(trial.score, trial.matrix) for trial in ranked[: parameters.grey.trials]]
    return PoseSearch(proposal, trials, first, second, scales, parameters)


def _best_by_structure(
    first: PoseImage,
    second: PoseImage,
    ranked: Sequence[Trial],
    scales: tuple[float, float],
    stretched: bool,
    parameters: PoseParameters,
) -> PoseProposal | None:
    """Return the pose that the `ranked` trials of the coarse search, the best first, lead to."""
    coarse = _distinct(ranked, first, parameters)
    if not coarse:
        return None
    patches = VotingPatches(first, second, parameters)
    least = parameters.evidence.least
    best_coarse = PoseProposal(coarse[0].matrix[:2], coarse[0].score, 0.0, least_evidence=least)
    voted = voted_pose(patches, [best_coarse], scales, parameters)
    if voted is not None:
        return confirmed(first, second, voted, parameters)
    similarity = _best_similarity(first, second, coarse, parameters)
    if similarity.accepted or not stretched:
        return confirmed(first, second, similarity, parameters)
    starts = [trial.matrix for trial in coarse] + stretched_starts(first, second, scales, parameters)
    affine = ascended(first, second, starts, parameters)
    voted = voted_pose(patches, affine[: parameters.votes.sampled_starts], scales, parameters)
    if voted is not None:
        return confirmed(first, second, voted, parameters)
    within = [pose for pose in affine[:1] if is_within(pose.scale, scales, parameters)]
    candidates = [confirmed(first, second, pose, parameters) for pose in (similarity, *within)]
    best = max(candidates, key=lambda pose: pose.evidence)
    if not best.accepted:
        return similarity
    return Frame(first, second, best, parameters).moved_to_consensus(best)


def _best_similarity(
    first: PoseImage, second: PoseImage, coarse: Sequence[Trial], parameters: PoseParameters
) -> PoseProposal:
    """Return the best of the similarities around those of the coarse search, and how it stands out."""
    ranked = _distinct([trial.scan.refined(trial) for trial in coarse], first, parameters)
    best, rival = ranked[0], ranked[1].score if len(ranked) > 1 else 0.0
    limits = parameters.evidence
    evidence = evidence_of_ratio(best.score, rival, limits.per_ratio, limits)
    proposal = PoseProposal(best.matrix[:2], best.score, evidence, least_evidence=limits.least)
    return Frame(first, second, proposal, parameters).moved_to_consensus(proposal)


def _distinct(trials: Sequence[Trial], image: PoseImage, parameters: PoseParameters) -> list[Trial]:
    by = parameters.structure
    return distinct_trials(trials, image.values.shape, by.refined, by.distinct_distance)
