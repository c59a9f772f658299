"""A frame of the reference, in which patches and the correlation tell how well a pose fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import square
from pcwlad_geo.matching.channels import normalised_channels
from pcwlad_geo.matching.masked_correlation import ratio_in_place
from pcwlad_geo.matching.patches import Patches
from pcwlad_geo.matching.pose.image import PoseImage
from pcwlad_geo.matching.pose.parameters import PoseParameters
from pcwlad_geo.matching.pose.proposal import PoseProposal, combined_evidence
from pcwlad_geo.matching.pose.resampling import shrunk, warped_image
from pcwlad_geo.types import Float32, Float64


def confirmed(
    reference: PoseImage, target: PoseImage, proposal: PoseProposal, parameters: PoseParameters
) -> PoseProposal:
    """Return a proposal with what the correlation in a frame adds, if that may make a difference."""
    if not parameters.frame.least_evidence <= proposal.evidence < parameters.evidence.most:
        return proposal
    return Frame(reference, target, proposal, parameters).confirmed(proposal)


class Frame:
    """A frame of the reference, and the target, which poses place in it."""

    def __init__(
        self, reference: PoseImage, target: PoseImage, proposal: PoseProposal, parameters: PoseParameters
    ) -> None:
        self._by, self._most_evidence = parameters.frame, parameters.evidence.most
        self._factor = min(1.0, proposal.scale, self._by.side_px / reference.side_px)
        values, valid, self._to_frame = shrunk(reference.values, reference.valid, self._factor)
        self._target = shrunk(target.values, target.valid, min(1.0, self._factor / proposal.scale))
        self._channels, self._shape = normalised_channels(values, valid), valid.shape

    def moved_to_consensus(self, proposal: PoseProposal) -> PoseProposal:
        """Compare patches of both, the target warped by a proposal, and move that to where they agree."""
        margin = np.array([self._by.margin_px, self._by.margin_px])
        best = proposal
        for _ in range(self._by.iterations):
            warp, channels = self._placed(best.matrix)
            patches = Patches.matched(self._channels, channels, margin)
            if patches.agreeing <= best.agreeing:
                break
            step, spread_px = patches.similarity()
            matrix = (inverse(self._target[2]) @ warp @ step @ self._to_frame)[:2]
            best = replace(
                best,
                matrix=matrix,
                agreeing=patches.agreeing,
                spread_px=spread_px / self._factor,
            )
        return best

    def confirmed(self, proposal: PoseProposal) -> PoseProposal:
        """Add what the correlation says of a proposal: whether it is highest where that puts the target.

        The two are combined as independent probabilities (Fisher's method), which is what they are of
        unrelated images: the search has seen cells of several of these pixels.
        """
        by, margin = self._by, self._by.margin_px
        _, (channels, usable) = self._placed(proposal.matrix)
        inside = np.s_[margin:-margin, margin:-margin]
        ratio = ratio_in_place(self._channels, (channels[inside], usable[inside]))
        total = proposal.evidence + max(0.0, by.evidence_per_ratio * (ratio - by.least_ratio))
        evidence = min(combined_evidence(total), self._most_evidence)
        return replace(proposal, evidence=max(proposal.evidence, evidence))

    def _placed(self, matrix: Float64) -> tuple[Float64, tuple[Float32, Float32]]:
        """Return the (3, 3) warp from the frame to the shrunk target, and its channels, with a margin."""
        values, valid, to_small = self._target
        warp = to_small @ square(matrix) @ inverse(self._to_frame)
        return warp, normalised_channels(*warped_image(values, valid, warp, self._shape, self._by.margin_px))
