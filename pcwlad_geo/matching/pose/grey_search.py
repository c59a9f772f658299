"""Search for a pose by grey values: what has one tone in one image has one in the other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

from pcwlad_geo.estimation.transforms import square
from pcwlad_geo.matching.pose.ascent import Ascent
from pcwlad_geo.matching.pose.climb import JointScore
from pcwlad_geo.matching.pose.comparisons import GreyComparison
from pcwlad_geo.matching.pose.distances import distinct_poses, mean_distance_px
from pcwlad_geo.matching.pose.parameters import PoseParameters
from pcwlad_geo.matching.pose.patch_votes import VotingPatches, is_within, voted_pose
from pcwlad_geo.matching.pose.proposal import PoseProposal, combined_evidence
from pcwlad_geo.matching.pose.search import PoseSearch
from pcwlad_geo.types import Float64


def poses_by_grey_values(search: PoseSearch) -> Iterator[PoseProposal | None]:
    """Yield the pose on which patches agree by their grey values, then that of all grey values together.

    Both begin with poses of the coarse search, and the accepted one. In unrelated images grey values and
    structure are independent, so that the product of their scores has fewer rivals than either. The second
    pose is moved to where both agree the most. None where nothing stands out.
    """
    first, second, parameters = search.reference, search.target, search.parameters
    structure = Ascent(first, second, parameters.affine.ascent_cells[-1], parameters)
    joint = JointScore(first, second, structure, 0, parameters)
    dependences = [joint.dependence(pose) for _, pose in search.trials]
    trials = zip(search.trials, dependences, strict=True)
    scored = [(score * dependence, pose) for (score, pose), dependence in trials]
    accepted = search.proposal if search.proposal is not None and search.proposal.accepted else None
    if accepted is not None:
        scored.append((math.inf, square(accepted.matrix)))  # the first, whatever its score
    best = _best_distinct(scored, first.values.shape, parameters)
    least = parameters.evidence.least
    starts = [PoseProposal(pose[:2], score, 0.0, least_evidence=least) for score, pose in best]
    if accepted is not None:
        starts[0] = accepted
    patches = VotingPatches(first, second, parameters, GreyComparison)
    yield voted_pose(patches, starts, search.scales, parameters) if starts else None
    yield _climbed_pose(search, joint, dependences, best, accepted)


def _climbed_pose(
    search: PoseSearch,
    joint: JointScore,
    dependences: Sequence[float],
    best: Sequence[tuple[float, Float64]],
    accepted: PoseProposal | None,
) -> PoseProposal | None:
    """Return the pose of the `best` that stands out when they have climbed; None if none does.

    The `dependences` are those of the trials of the search. The `accepted` pose is the first of the best.
    """
    first, second, parameters = search.reference, search.target, search.parameters
    by, shape = parameters.grey, first.values.shape
    if len(best) < 2 or (accepted is None and best[0][0] < by.least_ratio * best[1][0]):
        return None
    climbed = _best_distinct((joint.climbed(pose) for _, pose in best), shape, parameters)
    score, pose = climbed[0]
    ratio = score / max(climbed[1][0] if len(climbed) > 1 else score, 1e-9)
    most = parameters.evidence.most
    evidence = min(max(0.0, by.evidence_per_joint_ratio * (ratio - by.joint_ratio)), most)
    if accepted is not None and _is_same(pose, accepted.matrix, search):
        rivals = [
            dependence
            for (_, rival), dependence in zip(search.trials, dependences, strict=True)
            if not _is_same(pose, rival, search)
        ]
        grey_ratio = joint.dependence(pose) / max(max(rivals, default=math.inf), 1e-9)
        total = accepted.evidence + by.evidence_per_grey_ratio * max(0.0, grey_ratio - 1)
        evidence = max(evidence, accepted.evidence, min(combined_evidence(total), by.most_evidence))
    if evidence < parameters.evidence.least:
        return None
    fine = JointScore(first, second, joint.structure, 1, parameters)
    score, pose = fine.climbed(fine.climbed(pose)[1], affine=True)
    error_px = by.error_px * max(1.0, first.side_px / by.sides_px[1])
    proposal = PoseProposal(
        pose[:2], score, evidence, spread_px=error_px, least_evidence=parameters.evidence.least
    )
    return proposal if is_within(proposal.scale, search.scales, parameters) else None


def _is_same(pose: Float64, other: Float64, search: PoseSearch) -> bool:
    """Whether two poses place the reference alike."""
    least_px = search.parameters.structure.distinct_distance * search.reference.side_px
    return mean_distance_px(pose[:2], other[:2], search.reference.values.shape) < least_px


def _best_distinct(
    scored: Iterable[tuple[float, Float64]], shape: tuple[int, ...], parameters: PoseParameters
) -> list[tuple[float, Float64]]:
    """Return the best of scores and (3, 3) poses that are distinct, the best first."""
    ranked = sorted(scored, key=lambda item: -item[0])
    least = parameters.structure.distinct_distance
    selection = distinct_poses((pose for _, pose in ranked), shape, parameters.grey.distinct, least)
    return [ranked[index] for index in selection]
