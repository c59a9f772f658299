"""The displacements on which parts of the matches of a pair agree, and which of them the ground has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.matching import TiePoints
from pcwlad_geo.matching.chance import evidence_against_chance
from pcwlad_geo.matching.epipolar import EPIPOLAR
from pcwlad_geo.registration.judge import JudgeParameters, common_plane
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """Numbers by which several motions of a pair are distinguished, and one of them taken."""

    judge: JudgeParameters = field(default_factory=JudgeParameters)
    """Those of the verdict, which each motion has to pass by itself."""
    cell_windows: float = 0.75
    """Side of the cells in which motions are counted, in window sides."""
    plane_ratio: float = 1.2
    """Matches are compared about a common plane where so many times as many agree then."""
    most_between_share: float = 0.25
    """Largest share of a motion's matches, in number, that lie halfway to another: a smooth field fills
    that."""
    least_rejected: int = 8
    """Least number of rejected matches that propose a displacement of patches smaller than a window."""
    displaced_share: float = 0.035
    """Share of the points at whose surroundings it must fit better: patches on 15 % of the ground give 4.8
    % and more, images without patches 2.1 % at most."""
    georeferenced_px: float = 3.0
    """Typical error of a georeferencing, matching-grid px: of motions the likelier lies nearer to it
    (Cauchy)."""
    product_m: float = 15.0
    """The same of bands of one product, metres: half of what Landsat 8 allows its thermal bands (LE90 30
    m)."""
    main_ratio: float = 2.0
    """So many times as much must speak for the motion of most matches as for any other."""
    most_product_sigmas: float = 10.0
    """Bands of one product do not lie apart by so many typical errors."""
    other_ratio: float = 20.0
    """So many times as much must speak for another motion, so that it is taken instead."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Matches that agree on a displacement, which other matches of the pair contradict."""

    displacement_px: tuple[float, float]
    """Their median displacement (col, row), matching-grid px."""
    points: int
    share: float
    """Of all matches, consistent or not."""
    places: int
    """Number of separate places in which most matches agree with it."""
    significance: float
    """-log10 of the probability that unrelated images agree as much."""

    def __str__(self) -> str:
        col, row = self.displacement_px
        return f"({col:+.1f}, {row:+.1f}) px by {self.points} points in {self.places} separate places"

    def evidence(self, error_px: float | None) -> float:
        """Return how much speaks for it, where a georeferencing errs by so much, if there is one."""
        distance = np.hypot(*self.displacement_px) / error_px if error_px else 0.0
        return float(self.places / (1 + distance**2))


def motions_of(
    matches: TiePoints,
    consistent: Bool,
    offset_px: Float64,
    window_px: int,
    radius_px: int,
    parameters: MotionParameters = MotionParameters(),
) -> list[tuple[Motion, Bool]]:
    """Find the displacements on each of which so many matches agree that it would be accepted by itself.

    Clouds seen from another angle or at another time, and the ground below them, are two such motions; what
    varies smoothly over the scene is one. Each comes with the (n,) bool array of its matches, that with most
    first; none where few of all n matches are consistent, the (n,) bool array `consistent`. The `offset_px`
    is the (2,) displacement (col, row) of a target that lies where its georeferencing says; window and radius
    are those of `judge`.
    """
    if consistent.sum() < parameters.judge.least_points:
        return []
    displacement_px = matches.displacement_px - offset_px
    plane_px = common_plane(matches, consistent, parameters.judge)[0]
    flat = displacement_px - plane_px + plane_px[consistent].mean(axis=0)
    if (
        _most_frequent(flat, parameters)[1]
        > parameters.plane_ratio * _most_frequent(displacement_px, parameters)[1]
    ):
        displacement_px = flat
    cell_of = _cells(matches, parameters.cell_windows * window_px)
    total = np.bincount(cell_of)
    share = min(1.0, np.pi * parameters.judge.agree_px**2 / (2 * radius_px + 1) ** 2)
    motions: list[tuple[Motion, Bool]] = []
    remaining = np.ones(len(displacement_px), bool)
    while remaining.sum() >= parameters.judge.least_points:
        middle_px = _most_frequent(displacement_px[remaining], parameters)[0]
        off_px = np.linalg.norm(displacement_px - middle_px, axis=1)
        members, remaining = (
            off_px < parameters.judge.agree_px,
            remaining & (off_px >= 2 * parameters.judge.agree_px),
        )
        places = int((np.bincount(cell_of, weights=members) >= total / 2).sum())
        evidence = evidence_against_chance(places, len(total), min(0.5, EPIPOLAR.chance_factor * share))
        significance = max(0.0, evidence + float(np.log10(share)))
        if (
            members.sum() < parameters.judge.least_points
            or places < parameters.judge.least_places
            or significance < parameters.judge.least_significance
        ):
            break
        col, row = np.median(displacement_px[members], axis=0).tolist()
        motion = Motion((col, row), int(members.sum()), float(members.mean()), places, significance)
        if all(_are_distinct(displacement_px, motion, other, parameters) for other, _ in motions):
            motions.append((motion, members))
    return motions


def other_displacement(
    matches: TiePoints, consistent: Bool, parameters: MotionParameters = MotionParameters()
) -> tuple[Float64, Bool] | None:
    """Return what most matches that are not `consistent` lie off their neighbours, and which do.

    The (n,) mask `consistent` is of all matches. What they lie off is a (2,) displacement (col, row), px, and
    an (n,) mask; None where it may be chance.
    """
    off = np.flatnonzero(~consistent)
    if len(off) < parameters.least_rejected or not consistent.any():
        return None
    offset = matches.offsets_px(consistent)
    distinct = np.hypot(*offset.T) > parameters.judge.agree_px
    if distinct.sum() < parameters.least_rejected:
        return None
    middle_px, count = _most_frequent(offset[distinct], parameters)
    members = np.zeros(len(consistent), bool)
    members[off[np.linalg.norm(offset - middle_px, axis=1) < parameters.judge.agree_px]] = True
    return (middle_px, members) if count >= parameters.least_rejected else None


def share_displaced(
    best_fit_px: Float64, other_px: Float64, parameters: MotionParameters = MotionParameters()
) -> float:
    """Return the share of the points at whose surroundings another displacement fits, beyond chance.

    It is the (2,) `other_px` (col, row) beside the points' own. The (n, 2) `best_fit_px` (col, row) are what
    fits best there beside these, see `matcher.displacement_by_surroundings`; NaN where nothing is known.
    """
    measured_px = best_fit_px[np.isfinite(best_fit_px).all(axis=1)]
    if len(measured_px) < parameters.judge.least_points:
        return 0.0
    other = float((np.linalg.norm(measured_px - other_px, axis=1) < parameters.judge.agree_px).mean())
    elsewhere = float((np.linalg.norm(measured_px, axis=1) > parameters.judge.agree_px).mean()) - other
    return other - elsewhere / 2  # of two displacements that are there by chance only


def patches(
    matches: TiePoints,
    consistent: Bool,
    other: tuple[Float64, Bool],
    offset_px: Float64,
    window_px: int,
    parameters: MotionParameters = MotionParameters(),
) -> list[Motion]:
    """Return the motion of the matches that are `consistent`, an (n,) mask, and that of patches beside it.

    The `other` displacement, (2,), with the (m,) mask of the first m matches, is that of
    `other_displacement`. The (2,) `offset_px` (col, row) and the window are those of `motions_of`.
    """
    cell_of, displacement_px = (
        _cells(matches, parameters.cell_windows * window_px),
        matches.displacement_px - offset_px,
    )
    usual_px = np.median(displacement_px[consistent], axis=0)
    masks = consistent, np.pad(other[1], (0, len(consistent) - len(other[1]))) & ~consistent
    return [
        Motion((col, row), int(mask.sum()), float(mask.mean()), len(np.unique(cell_of[mask])), 0.0)
        for (col, row), mask in zip((usual_px.tolist(), (usual_px + other[0]).tolist()), masks, strict=True)
    ]


def _cells(matches: TiePoints, cell_px: float) -> Index:
    """Return the (n,) number of the cell of each match, counted without gaps."""
    cells = np.floor(matches.reference_xy_px / cell_px).astype(np.intp)
    return np.unique(cells, axis=0, return_inverse=True)[1].ravel()


def _most_frequent(displacement_px: Float64, parameters: MotionParameters) -> tuple[Float64, int]:
    """Return the displacement with which most agree, and how many do."""
    sample_px = displacement_px[:: -(-len(displacement_px) // 4000)]
    tree = cKDTree(sample_px)
    count = tree.query_ball_point(sample_px, parameters.judge.agree_px, return_length=True)
    around = sample_px[tree.query_ball_point(sample_px[np.argmax(count)], parameters.judge.agree_px)]
    return np.median(around, axis=0), int(count.max())


def _are_distinct(displacement_px: Float64, one: Motion, other: Motion, parameters: MotionParameters) -> bool:
    """Whether two motions lie apart by what matches of one may differ, and hardly any lies halfway."""
    begin = np.asarray(other.displacement_px)
    way = np.asarray(one.displacement_px) - begin
    if np.hypot(*way) < 2 * parameters.judge.agree_px:
        return False
    along = (displacement_px - begin) @ way / (way @ way)
    across = np.linalg.norm(displacement_px - begin - along[:, None] * way, axis=1)
    halfway = (np.abs(along - 0.5) < 1 / 6) & (across < parameters.judge.agree_px)
    return bool(halfway.sum() <= parameters.most_between_share * min(one.points, other.points))


def motion_of_the_ground(
    motions: Sequence[tuple[Motion, Bool]],
    consistent: Bool,
    error_px: float | None,
    of_one_product: bool,
    parameters: MotionParameters = MotionParameters(),
) -> tuple[list[tuple[Motion, Bool]], tuple[Motion, Bool] | None, str | None]:
    """Return motions, the likeliest first, that of most (n,) `consistent` matches, and why they are refused.

    The `motions` come with the (n,) masks of their matches. What is georeferenced, with a typical error, lies
    near its place, and bands of one product do to some metres: a motion far away has to be seen in many more
    places than one that is near.
    """
    if not motions:
        return [], None, None
    usual = max(motions, key=lambda entry: np.count_nonzero(entry[1] & consistent))
    likely = sorted(motions, key=lambda entry: -entry[0].evidence(error_px))
    evidence = [motion.evidence(error_px) for motion, _ in likely]
    least = (
        parameters.main_ratio * max(evidence[1:], default=0.0)
        if likely[0] is usual
        else parameters.other_ratio * usual[0].evidence(error_px)
    )
    best, reason = likely[0][0], None
    if evidence[0] < least:
        reason = describe_motions([motion for motion, _ in likely], accepted=False)
    elif (
        error_px
        and of_one_product
        and np.hypot(*best.displacement_px) > parameters.most_product_sigmas * error_px
    ):
        reason = (
            f"bands of a product lie within metres of each other, and the matches agree on {best}, probably "
            "clouds: mask them (--ref-mask, --tgt-mask), or give --prealign search if a band has been moved"
        )
    return likely, usual, reason


def describe_motions(motions: Sequence[Motion], accepted: bool) -> str:
    """Return what is told of a pair of several motions: that the first was taken, or why it is refused."""
    texts = "; ".join(map(str, motions))
    message = f"the matches agree on {len(motions)} different displacements ({texts})"
    if accepted:
        return (
            f"{message}: the first was taken for that of the ground, the rest for clouds, what else moves or "
            "lies at another depth; there the correction does not hold"
        )
    return (
        f"{message}, and nothing tells which is that of the ground: give a mask (--ref-mask, --tgt-mask) "
        "with 0 on clouds and what else moves, or --prealign georef with a small --search-radius"
    )
