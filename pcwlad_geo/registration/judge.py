"""The verdict on a pair: enough tie points must agree, and many more than would agree by chance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.matching.chance import evidence_against_chance
from pcwlad_geo.matching.epipolar import EPIPOLAR
from pcwlad_geo.raster.compression import BLOCK_PX
from pcwlad_geo.registration.decision import Decision, Evidence
from pcwlad_geo.types import Bool, Float64, Index

BY_BLOCKS: Final = (
    f"the candidates agree only up to multiples of {BLOCK_PX} px: both images show the grid of blocks that "
    "JPEG compression leaves, and little else; use images without it, or mask what shows nothing else"
)
"""Why such a pair is refused."""


@dataclass(frozen=True, slots=True)
class JudgeParameters:
    """Numbers of the verdict, from the studies of poses, radar and refusals."""

    least_points: int = 12
    """Least number of consistent tie points of an accepted pair."""
    least_places: int = 4
    """Least number of separate places that must agree in an accepted pair."""
    agree_px: float = 2.0
    """Largest distance of a displacement from the common one with which it agrees, matching-grid px."""
    least_significance: float = 6.0
    """Least significance of an accepted pair: -log10 of the probability of such agreement by chance."""
    least_point_significance: float = 2.0
    """Least significance of the points themselves from which the evidence of a search is added to it."""
    separation_windows: float = 0.5
    """Distance along an axis from which matches count as independent evidence, in window sides."""
    certain_evidence: float = 3.2
    """Evidence of a search from which nothing but chance is asked of its pose; below it the pose may stand
    on one structure, which overlapping windows all show."""
    doubtful_separation_windows: float = 2 / 3
    """The distance of independent evidence for such a pose, in window sides."""
    evidence_share: float = 0.75
    """Share of its evidence that is added to that of the points, which see what its patches have seen."""
    blocks_apart_share: float = 0.5
    """Share of the matches against the common displacement that contradict it by whole blocks of JPEG, from
    which it is one of many that put the grids of blocks on each other."""
    close_px: float = 0.2
    """Median distance per axis from their common displacement below which points agree closely."""
    agreeing_share: float = 0.75
    """Least share of agreeing places with which a refusal says that they are too few, not that they
    disagree."""
    border_share: float = 0.25
    """Share of candidates matched on the edge of the search above which a larger radius is advised."""
    few_valid_share: float = 0.3
    """Share of candidates with too few valid pixels around them from which it is advised to fill gaps."""


def judge(
    matches: TiePoints,
    consistent: Bool,
    counts: dict[str, int],
    window_px: int,
    radius_px: int,
    *,
    evidence: float = 0.0,
    parameters: JudgeParameters = JudgeParameters(),
) -> Decision:
    """Judge the first pass by an a contrario test (Desolneux et al. 2000, doi:10.1023/A:1026593302236).

    All n matches were found independently, consistent or not; the (n,) bool array `consistent` is the mask of
    the consistent ones. The `counts` are of candidates and of those that each stage rejected. The window is
    `window_px` wide, and the coarse match searched `radius_px` around. The `evidence` of the start, see
    `Prealignment.net_evidence`, is 0 where nothing was searched, and counts if the points say something
    themselves.
    """
    share = min(1.0, np.pi * parameters.agree_px**2 / (2 * radius_px + 1) ** 2)
    by_blocks = _lie_blocks_apart(matches, consistent, parameters)
    if by_blocks:
        share = min(1.0, BLOCK_PX**2 / (2 * radius_px + 1) ** 2)
    doubtful = is_doubtful(evidence, parameters=parameters)
    separation_px = (
        parameters.doubtful_separation_windows if doubtful else parameters.separation_windows
    ) * window_px
    cells, agreeing, best = _best_agreement(matches, consistent, separation_px, share, parameters)
    # the common displacement is the best of 1 / share different ones
    significance = max(0.0, best + float(np.log10(share)))
    enough = consistent.sum() >= parameters.least_points and agreeing >= parameters.least_places
    if evidence < 0:
        significance = max(0.0, significance + evidence)
    elif significance >= parameters.least_point_significance:
        significance += evidence * (parameters.evidence_share if doubtful else 1.0)
    accepted = bool(enough and significance >= parameters.least_significance)
    agreement = Evidence(cells, agreeing, significance)
    if accepted:
        return Decision(None, agreement)
    if by_blocks:
        return Decision(BY_BLOCKS, agreement)
    nothing = _nothing_to_match(counts)
    missing = nothing or _too_few(int(consistent.sum()), agreeing, cells, parameters)
    if missing:
        smaller_windows = bool(nothing) or agree_closely(matches[consistent], parameters=parameters)
        return Decision(missing, replace(agreement, smaller_windows=smaller_windows))
    by_chance = f"none of the {counts['candidates']} candidates agrees with its neighbours"
    if consistent.any():
        by_chance = (
            f"only {int(consistent.sum())} of {counts['candidates']} candidates agree with their "
            "neighbours, in "
            f"{min(agreeing, int(consistent.sum()))} of {cells} separate places"
        )
    by_chance += ", no better than chance"
    past_search_border = counts.get("at_search_border", 0) > parameters.border_share * counts["candidates"]
    few_valid = counts.get("not_comparable", 0) > parameters.few_valid_share * counts["candidates"]
    return Decision(by_chance, Evidence(cells, agreeing, significance, past_search_border, few_valid))


def agree_closely(points: TiePoints, parameters: JudgeParameters = JudgeParameters()) -> bool:
    """Whether points are enough, and have one displacement up to a fraction of a pixel."""
    displacement_px = points.displacement_px
    if len(displacement_px) < parameters.least_points:
        return False
    return bool(
        np.median(np.abs(displacement_px - np.median(displacement_px, axis=0)), axis=0).max()
        < parameters.close_px
    )


def is_doubtful(evidence: float, parameters: JudgeParameters = JudgeParameters()) -> bool:
    """Whether the evidence of a search, 0 where nothing was searched, leaves a doubt about its start."""
    return evidence != 0 and evidence < parameters.certain_evidence


def _lie_blocks_apart(matches: TiePoints, consistent: Bool, parameters: JudgeParameters) -> bool:
    """Whether most matches that contradict the common displacement do so by whole blocks of JPEG."""
    if consistent.sum() < parameters.least_points:
        return False
    from_common = matches.displacement_px - np.median(matches.displacement_px[consistent], axis=0)
    contradict = np.abs(from_common).max(axis=1) > BLOCK_PX / 2
    in_register = np.abs(from_common - BLOCK_PX * np.rint(from_common / BLOCK_PX)).max(axis=1) < 1
    return bool(
        contradict.sum() >= parameters.least_points
        and in_register[contradict].mean() >= parameters.blocks_apart_share
    )


def _best_agreement(
    matches: TiePoints, consistent: Bool, separation_px: float, share: float, parameters: JudgeParameters
) -> tuple[int, int, float]:
    """Count places with matches, and those that agree with the common displacement, which may be a plane.

    The third value is -log10 of the probability that as many agree by chance with the better of the two.
    """
    if len(matches) == 0:
        return 0, 0, 0.0
    chance = min(0.5, EPIPOLAR.chance_factor * share)
    middle_px = np.median(matches.displacement_px[consistent if consistent.any() else slice(None)], axis=0)
    place_of = _places(matches, separation_px)
    cells, agreeing = _agreement(matches, middle_px, place_of, parameters)
    level = cells, agreeing, evidence_against_chance(agreeing, cells, chance)
    if consistent.sum() < 3 * parameters.least_points:
        return level
    plane_px, planes = common_plane(matches, consistent, parameters=parameters)
    cells, agreeing = _agreement(matches, plane_px, place_of, parameters)
    tilted = cells, agreeing, evidence_against_chance(agreeing, cells, chance) - float(np.log10(planes))
    cells, agreeing, evidence = max(level, tilted, key=lambda count: count[2])
    return cells, agreeing, evidence - float(np.log10(2))


def _agreement(
    matches: TiePoints, common_px: Float64, place_of: Index, parameters: JudgeParameters
) -> tuple[int, int]:
    """Count places with matches, and those whose typical match agrees with a (2,) or (n, 2) displacement."""
    agrees = np.linalg.norm(matches.displacement_px - common_px, axis=1) < parameters.agree_px
    total = np.bincount(place_of)
    share = np.bincount(place_of, weights=agrees) / total
    return len(total), int((share >= 0.5).sum())


def _places(matches: TiePoints, separation_px: float) -> Index:
    """Return the (n,) number of the place of each match; the middles of places lie `separation_px` apart.

    The densest come first, so that a cluster, whose windows show the same pixels, is one place: cells of a
    fixed grid cut clusters, and three clusters of chance, through which there is always a plane, counted as
    nine cells that agree.
    """
    xy = matches.reference_xy_px
    tree = cKDTree(xy)
    around = tree.query_ball_point(xy, separation_px / 2, p=np.inf, return_length=True)
    free, middles = np.ones(len(xy), bool), []
    for index in np.argsort(-around, kind="stable").tolist():
        if free[index]:
            middles.append(index)
            free[tree.query_ball_point(xy[index], separation_px, p=np.inf)] = False
    return np.asarray(cKDTree(xy[middles]).query(xy, p=np.inf)[1], np.intp)


def common_plane(
    matches: TiePoints, consistent: Bool, parameters: JudgeParameters = JudgeParameters()
) -> tuple[Float64, float]:
    """Return the plane through the displacements of the consistent points, and of how many it is one.

    These are the (n,) mask `consistent`. The plane is the (n, 2) displacement at all matches. The number
    counts the planes that tilt no more and differ by `agree_px` at the border: the best of many planes agrees
    with more cells by chance, so a plane that is nearly level says more than one that is steep.
    """
    xy = matches.reference_xy_px - matches.reference_xy_px[consistent].mean(axis=0)
    design = np.c_[np.ones(len(xy)), xy]
    solution = least_squares(design[consistent], matches.displacement_px[consistent])
    rise_px = np.abs(solution[1:]) * (np.ptp(xy, axis=0) / 2)[:, None]  # from the middle to the border
    return design @ solution, float(np.prod(1 + rise_px / parameters.agree_px))


def _nothing_to_match(counts: dict[str, int]) -> str | None:
    """Return why hardly any candidate could be matched; None if many could."""
    candidates = counts.get("candidates", 0)
    if candidates == 0:
        return (
            "no structure to match: the overlap is flat, masked or too small; check bands, masks and nodata"
        )
    if counts.get("not_comparable", 0) > 0.9 * candidates:
        return "almost no window has enough valid pixels in both images; check masks, nodata and overlap"
    return None


def _too_few(points: int, agreeing: int, cells: int, parameters: JudgeParameters) -> str | None:
    """Return why points that agree are too few; None if they do not agree."""
    if agreeing < parameters.agreeing_share * cells or min(agreeing, points) == 0:
        return None
    needed = f"at least {parameters.least_points} are needed"
    if points >= parameters.least_points:
        needed = "points within a matching window say the same: more places are needed"
    return (
        f"{points} tie points agree, in {agreeing} of {cells} separate places, and so few say too little "
        f"({needed}): use rasters that share more ground, masks that exclude less, or a smaller --window"
    )
