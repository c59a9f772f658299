"""The refinement in both directions: the mean of the two, and whether they agree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import numpy as np

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching.mutual_structure import passes_paper, shared_structure
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import InitialEstimate, Refined, refine
from pcwlad_geo.matching.types import TRAITS, MatchSettings
from pcwlad_geo.types import Bool, Float64, Index

Back = Literal["forward only", "sample", "as needed", "always"]


@dataclass(frozen=True, slots=True)
class DirectionParameters:
    """Which points are also matched backward, and when both directions agree."""

    most_difference_px: float = 0.5
    """Difference of the two directions from which a point is rejected."""
    every: int = 5
    """One of so many points is in the sample; a divisor of the points of a cell would sample one rank."""
    least_to_sample: int = 16
    """Of fewer points all are matched backward, unless a sample was asked for."""
    outlying: float = 5.0
    """A difference larger than so many times the method's limit is outlying."""
    most_outlying: float = 0.005
    """Largest share of these in the sample at which no other point is matched backward."""


DIRECTIONS: Final = DirectionParameters()
"""Those in use."""


def refine_both(
    pair: ChannelPair,
    corners: Index,
    start: InitialEstimate,
    settings: MatchSettings,
    direction: Back,
    step_px: int = 1,
) -> tuple[Refined, Bool, Float64]:
    """Refine forward and, where the method asks for it, backward.

    The (n, 2) `corners` are (row, col). The result is the mean of the directions, the (n,) mask of those that
    agree, and their (n,) difference: infinite where the backward match failed, NaN where it was not made.
    """
    forward = _refine_one_way(pair, corners, start, settings, step_px)
    forward_backward = np.full(len(corners), np.nan)
    if not TRAITS[settings.method].backward:
        ok = np.ones(len(corners), bool)
        if settings.method == "pcwlad":
            ok = passes_paper(pair, corners, start, forward, settings.window.side_px, settings.ssim_min)
        return forward, ok, forward_backward
    mean, covariance = forward.shift_xy_px.copy(), forward.covariance_px2.copy()

    def match_backward(index: Index) -> None:
        shift, linear = forward.shift_xy_px[index], forward.linear[index]
        structure = None if start.structure_xy_px is None else start.structure_xy_px[index]
        returned, backward = _refine_back(pair, corners[index], shift, linear, structure, settings, step_px)
        mean[index] = (shift + returned) / 2
        covariance[index] = (covariance[index] + backward.covariance_px2) / 2
        distance = np.linalg.norm(shift - returned, axis=1)
        forward_backward[index] = np.where(backward.converged, distance, np.inf)

    # points whose forward match did not converge need no backward match
    arrived = np.flatnonzero(forward.converged)
    is_few = direction == "as needed" and len(arrived) < DIRECTIONS.least_to_sample
    if direction != "forward only":
        match_backward(arrived[:: 1 if is_few or direction == "always" else DIRECTIONS.every])
    if direction == "as needed" and not forward_is_enough(forward_backward, settings):
        match_backward(arrived[np.isnan(forward_backward[arrived])])
    converged = forward.converged & ~np.isinf(forward_backward)
    agree = ~(forward_backward >= DIRECTIONS.most_difference_px)
    return Refined(mean, forward.linear, covariance, converged), agree, forward_backward


def _refine_back(
    pair: ChannelPair,
    corners: Index,
    shift_xy: Float64,
    linear: Float64,
    structure_xy: Float64 | None,
    settings: MatchSettings,
    step_px: int,
) -> tuple[Float64, Refined]:
    """Refine from target to reference; return the shifts, as seen forward, and the whole result."""
    landed = corners + np.round(shift_xy[:, ::-1]).astype(np.intp)
    # the backward window is centred on a whole target pixel; between that and the exact target position the
    # field differs by deformation times the remainder
    remainder = (landed - corners)[:, ::-1] - shift_xy
    deformation = np.einsum("nij,nj->ni", linear, remainder)
    start = InitialEstimate(
        -(shift_xy + deformation),
        inverse(np.eye(2) + linear) - np.eye(2),
        None if structure_xy is None else -(structure_xy + deformation),
        is_match=structure_xy is not None,
    )
    backward = _refine_one_way(pair.turned, landed, start, settings, step_px)
    return -backward.shift_xy_px - deformation, backward


def _refine_one_way(
    pair: ChannelPair, corners: Index, start: InitialEstimate, settings: MatchSettings, step_px: int
) -> Refined:
    traits = TRAITS[settings.method]
    if traits.structure == "filter":
        start = replace(start, structure=shared_structure(pair, corners, start, settings.window.side_px))
    refined = partial(
        refine,
        pair.reference,
        pair.target,
        corners,
        window_px=settings.window.side_px,
        step_px=step_px,
        affine=traits.affine,
        iterations=settings.iterations,
        least_valid=settings.least_valid,
        threads=pair.threads,
    )
    result = refined(start, use_structure=traits.structure == "local", robust=traits.robust)
    if traits.structure == "filter":
        # taken once, at the whole-pixel match, the structure would pull the answer towards that pixel
        start = InitialEstimate(result.shift_xy_px, result.linear)
        result = refined(
            replace(start, structure=shared_structure(pair, corners, start, settings.window.side_px))
        )
    return result


def forward_is_enough(forward_backward_px: Float64, settings: MatchSettings) -> bool:
    """Return whether the forward-backward errors are small enough for matching in one direction only.

    The (n,) `forward_backward_px` are NaN for points that were not matched backward. The method of the
    settings sets the limit.
    """
    error_px = forward_backward_px[~np.isnan(forward_backward_px)]
    limit_px = TRAITS[settings.method].one_way_px
    if len(error_px) == 0 or (error_px > DIRECTIONS.outlying * limit_px).mean() > DIRECTIONS.most_outlying:
        return False
    return bool(np.sqrt(np.mean(error_px**2)) <= limit_px)
