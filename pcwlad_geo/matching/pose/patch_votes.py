"""Patches of the reference, looked for within a wide reach in the target, vote for an affine pose.

A patch is hardly changed by what moves the border of the whole image by many pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import AffineTransform, scale_at, scale_of, square
from pcwlad_geo.matching.patches import window_sums
from pcwlad_geo.matching.pose.comparisons import Comparison, StructureComparison
from pcwlad_geo.matching.pose.consensus import (
    Votes,
    affine_consensus,
    grown_homography,
    similarity_if_as_good,
    support_of,
)
from pcwlad_geo.matching.pose.image import PoseImage
from pcwlad_geo.matching.pose.parameters import PoseParameters
from pcwlad_geo.matching.pose.proposal import PoseProposal
from pcwlad_geo.matching.pose.resampling import shrunk, warped_image
from pcwlad_geo.types import Float32, Float64


class VotingPatches:
    """Overlapping patches of the reference, which are compared with the target as poses place it."""

    def __init__(
        self,
        reference: PoseImage,
        target: PoseImage,
        parameters: PoseParameters,
        comparison: Callable[[tuple[int, int], PoseParameters], Comparison] = StructureComparison,
    ) -> None:
        self._by, self._consensus = parameters.votes, parameters.consensus
        self._most_evidence = parameters.evidence.most
        self._factor = min(1.0, self._by.side_px / reference.side_px)
        values, valid, self._to_voting = shrunk(reference.values, reference.valid, self._factor)
        rows, cols = self._shape = valid.shape
        self._comparison = comparison((rows, cols), parameters)
        self._planes, self._usable = self._comparison.planes(values, valid)
        self._target = target
        side, stride = self._by.patch_px, self._by.stride
        self._corners = [
            (row, col, not (i % stride or j % stride))
            for i, row in enumerate(range(0, rows - side + 1, self._by.step_px))
            for j, col in enumerate(range(0, cols - side + 1, self._by.step_px))
            if self._usable[row : row + side, col : col + side].mean() >= self._by.least_valid
        ]

    def vote(self, pose: Float64, *, sample: bool = False) -> tuple[Votes, Float64]:
        """Let the patches, or a sample of them, vote on a (3, 3) `pose`; return also the pose they agree on.

        That is (3, 3), too.
        """
        votes = self._votes(pose, sample=sample)
        agreed = votes.to_target @ votes.matrix @ self._to_voting
        if not sample and votes.agrees.any():
            reference_px = AffineTransform(inverse(self._to_voting))(votes.middles_px)
            target_px = AffineTransform(votes.to_target)(votes.target_middles_px)
            tolerance_px = self._consensus.tolerance_px * scale_of(agreed) / self._factor
            agreed = similarity_if_as_good(
                agreed, reference_px, target_px, votes.agrees, tolerance_px, self._consensus
            )
        return votes, agreed

    def settled(self, pose: Float64, *, sample: bool = False) -> tuple[Votes, Float64]:
        """Let patches vote, each time from the (3, 3) `pose` that they agreed on, until no more agree.

        Return the votes, and the (3, 3) pose that they agree on.
        """
        votes, pose = self.vote(pose, sample=sample)
        for _ in range(self._by.iterations):
            next_votes, next_pose = self.vote(pose, sample=sample)
            if next_votes.agreeing <= votes.agreeing:
                break
            votes, pose = next_votes, next_pose
        return votes, pose

    def in_perspective(self, votes: Votes) -> Float64 | None:
        """Return the (3, 3) homography grown from votes for an affine pose; None if it gains little."""
        support, _ = support_of(votes, votes.matrix, self._consensus.tolerance_px)
        best, least = None, support + self._consensus.least_perspective_gain
        for _ in range(self._consensus.perspective_iterations):
            votes = votes if best is None else self._votes(best)
            change, support = grown_homography(votes, self._consensus)
            if support < least:
                break
            best, least = votes.to_target @ change @ self._to_voting, support
        return best if best is None else best / best[2, 2]

    def evidence(self, votes: Votes) -> float:
        """Return -log10 of the probability, as measured, that as many patches of unrelated images agree."""
        chance = self._comparison.chance
        return max(0.0, min((votes.agreeing - chance.agreeing) / chance.per_decade, self._most_evidence))

    def px(self, voting_px: float) -> float:
        """Return a length in px of the reference."""
        return voting_px / self._factor

    def _votes(self, pose: Float64, *, sample: bool = False) -> Votes:
        """Return the votes of the patches, or of a sample, with the target placed by a (3, 3) pose."""
        from_voting = AffineTransform(inverse(self._to_voting))
        middle_px = from_voting((np.array([self._shape[::-1]]) - 1) / 2)[0]
        small, valid, to_small = shrunk(
            self._target.values, self._target.valid, min(1.0, self._factor / scale_at(pose, middle_px))
        )
        to_placed = to_small @ pose @ from_voting.matrix
        image = warped_image(small, valid, to_placed, self._shape, self._by.reach_px)
        table = self._displacements(*self._comparison.planes(*image), sample=sample)
        return affine_consensus(*table, inverse(to_small) @ to_placed, self._consensus)

    def _displacements(
        self, planes: Float32, usable: Float32, *, sample: bool
    ) -> tuple[Float64, Float64, Float64]:
        """Return (n, 2) middles and displacements (col, row) of the patches, and how distinct each is."""
        patch_px, side, least = self._by.patch_px, 2 * self._by.reach_px + 1, self._by.least_valid
        enough = window_sums(usable, patch_px) >= least * patch_px**2
        norms = np.where(enough, self._comparison.norms(planes, usable), 0)
        rows = []
        for row, col, sampled in self._corners:
            shifts = np.s_[..., row : row + side, col : col + side]
            if (sample and not sampled) or np.count_nonzero(enough[shifts]) < least * side**2:
                continue
            patch = np.s_[row : row + patch_px, col : col + patch_px]
            search = planes[row : row + patch_px + side - 1, col : col + patch_px + side - 1]
            of_patch = self._planes[patch], self._usable[patch]
            peak = _peak(self._comparison.surface(*of_patch, search, norms[shifts]), self._by.clearance_px)
            rows.append((col + (patch_px - 1) / 2, row + (patch_px - 1) / 2, *peak))
        table = np.array(rows, np.float64).reshape(-1, 5)
        return table[:, :2], table[:, 2:4] - self._by.reach_px, table[:, 4]


def voted_pose(
    patches: VotingPatches,
    starts: Sequence[PoseProposal],
    scales: tuple[float, float],
    parameters: PoseParameters,
) -> PoseProposal | None:
    """Return the affine pose on which patches agree from one of several starts, whose evidence is added.

    A sample of the patches tells which starts are worth trying. It is None if the patches add too little
    evidence, or the scale is not within `scales`.
    """
    by, evidence_limits = parameters.votes, parameters.evidence
    samples = [(patches.settled(square(start.matrix), sample=True), start) for start in starts]
    samples.sort(key=lambda item: -item[0][0].agreeing)
    for (sample, pose), start in samples[: by.full_starts]:
        if sample.agreeing < by.least_sampled and start.evidence < by.least_evidence:
            continue
        votes, pose = patches.settled(pose)
        # of several starts one agrees by chance
        vote_evidence = patches.evidence(votes) - math.log10(len(starts))
        evidence = min(start.evidence + vote_evidence, evidence_limits.most)
        if vote_evidence <= 0 or evidence < evidence_limits.least:
            continue
        if is_within(scale_of(pose), scales, parameters):
            return replace(
                start,
                matrix=pose[:2],
                evidence=evidence,
                agreeing=votes.agreeing,
                spread_px=patches.px(votes.spread_px),
                homography=patches.in_perspective(votes),
            )
    return None


def is_within(scale: float, scales: tuple[float, float], parameters: PoseParameters) -> bool:
    """Whether a scale is between the smallest and the largest that are tried, or a step beyond."""
    step = parameters.structure.scale_step
    return scales[0] / step <= scale <= scales[1] * step


def _peak(surface: Float64, clearance_px: int) -> tuple[int, int, float]:
    """Return (col, row) of the highest value, and that over the highest of those beside its peak, minus 1."""
    row, col = divmod(int(surface.argmax()), surface.shape[1])
    highest, k = float(surface[row, col]), clearance_px
    surface[max(row - k, 0) : row + k + 1, max(col - k, 0) : col + k + 1] = 0
    return col, row, highest / max(float(surface.max()), 1e-6) - 1
