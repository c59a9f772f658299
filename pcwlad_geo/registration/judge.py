"""The verdict on a pair: enough tie points must agree, and many more than would agree by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.matching.chance import evidence_against_chance
from pcwlad_geo.matching.epipolar import EPIPOLAR
from pcwlad_geo.matching.types import TiePoints
from pcwlad_geo.raster.compression import BLOCK_PX
from pcwlad_geo.registration.prealign import Prealignment
from pcwlad_geo.types import Bool, Float64, Index

MIN_POINTS: Final = 12
"""Least number of consistent tie points of an accepted pair."""
MIN_CELLS: Final = 4
"""Least number of separate cells that must agree in an accepted pair."""
SEPARATION_WINDOWS: Final = 0.5
"""Distance along an axis from which matches count as independent evidence, in window sides: of radar over
optical two wrong poses, each of three clusters, had 0.2 and 2.0 by it, and the right ones 11.5 and 14."""
CERTAIN_EVIDENCE: Final = 3.2
"""Evidence of a search from which nothing but chance is asked of its pose; below it the pose may stand on one
structure, which overlapping windows all show: a path, in an image beside itself transposed, gave 2.9."""
DOUBTFUL_SEPARATION_WINDOWS: Final = 2 / 3
"""The distance of independent evidence for such a pose: of that path 8 of 8 places were half a window apart,
and 4 of 4 this far."""
EVIDENCE_SHARE: Final = 0.75
"""Share of its evidence that is added to that of the points, which see what its patches have seen: that path
has 5.8; of 85 pairs that the studies of poses, radar and refusal accept, those of such a pose have 6.3."""
CELL_PER_WINDOW: Final = 0.75
"""Side of the cells in which several motions of an accepted pair are told apart, in window sides."""
AGREE_PX: Final = 2.0
"""Largest distance of a cell's displacement from the common one with which it agrees."""
MIN_SIGNIFICANCE: Final = 6.0
"""Least significance of an accepted pair: -log10 of the probability of such agreement by chance."""
MIN_OWN_SIGNIFICANCE: Final = 2.0
"""Least significance of the points themselves from which the evidence of a search is added to it."""
BLOCKS_APART_SHARE: Final = 0.5
"""Share of the matches that contradict the common displacement which do so by whole blocks, from which it is
one of many that put the grids on each other: 0.96 of two parts of a photograph of a blackboard, with 8 of 9
places that agree. Right pairs of JPEGs reach 0.8 too; their places are more."""
BY_BLOCKS: Final = (
    f"the candidates agree only up to multiples of {BLOCK_PX} px: both images show the grid of blocks that "
    "JPEG compression leaves, and little else; use images without it, or mask what shows nothing else"
)
"""Why such a pair is refused."""
CLOSE_PX: Final = 0.2
"""Median distance per axis from their common displacement below which points agree closely."""
AGREEING_SHARE: Final = 0.75
"""Least share of agreeing cells with which a refusal says that they are too few, not that they disagree."""
AT_BORDER: Final = 0.25
"""Share of candidates matched on the edge of the search above which a larger search radius is advised."""

PLANE_RATIO: Final = 1.2
"""Matches are compared about a common plane where so many times as many agree then."""
MAX_SHARE_BETWEEN: Final = 0.25
"""Largest share of a motion's matches, in number, that lie halfway to another: a smooth field fills that."""
MIN_REJECTED: Final = 8
"""Least number of rejected matches that propose a displacement of patches smaller than a window."""
DISPLACED_SHARE: Final = 0.035
"""Share of the points at whose surroundings it must fit better, so that it counts as one: patches on 15 % of
the ground gave 4.8 to 5.7 %, clouds on 8 % of it 2.1 %, and images without patches at most 2.1 %."""
GEOREFERENCED_PX: Final = 3.0
"""Typical error of a georeferencing, matching-grid px: of motions the likelier lies nearer to it (Cauchy)."""
PRODUCT_M: Final = 15.0
"""The same of bands of one product, metres: half of what Landsat 8 allows its thermal bands (LE90 30 m)."""
MAIN_MOTION_RATIO: Final = 2.0
"""So many times as much must speak for the motion of most matches as for any other."""
MAX_PRODUCT_SIGMAS: Final = 10.0
"""Bands of one product do not lie apart by so many typical errors."""
OTHER_MOTION_RATIO: Final = 20.0
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
        far = np.hypot(*self.displacement_px) / error_px if error_px else 0.0
        return float(self.places / (1 + far**2))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the tie points of a pair are accepted, and the evidence."""

    accepted: bool
    reason: str | None
    """Why the pair was refused; None if it was accepted."""
    cells: int
    """Number of cells with a match of any kind."""
    agreeing_cells: int
    """Number of cells that agree with the common displacement."""
    significance: float
    """-log10 of the probability that unrelated images agree as much."""
    past_search_border: bool | None = None
    """Whether many best matches lie on the edge of the search; None unless the points agree by chance."""
    few_valid: bool = False
    """Whether many candidates had too few valid pixels around them."""
    smaller_windows: bool = False
    """Whether smaller windows may give the places that are missing: the points agree, in too few of them."""


def judge(
    matches: TiePoints,
    kept: Bool,
    counts: dict[str, int],
    window_px: int,
    radius_px: int,
    *,
    evidence: float = 0.0,
) -> Verdict:
    """Judge the first pass by an a contrario test (Desolneux et al. 2000, doi:10.1023/A:1026593302236).

    All n matches were found independently, consistent or not; the (n,) bool array `kept` is the mask of the
    consistent ones. The `counts` are of candidates and of those that each stage rejected. The window is
    `window_px` wide, and the coarse match searched `radius_px` around. The `evidence` of the
    start, see `Prealignment.net_evidence`, is 0 where nothing was searched, and counts if the points say
    something themselves.
    """
    share = min(1.0, np.pi * AGREE_PX**2 / (2 * radius_px + 1) ** 2)
    by_blocks = _lie_blocks_apart(matches, kept)
    if by_blocks:
        share = min(1.0, BLOCK_PX**2 / (2 * radius_px + 1) ** 2)
    doubtful = is_doubtful(evidence)
    separation_px = (DOUBTFUL_SEPARATION_WINDOWS if doubtful else SEPARATION_WINDOWS) * window_px
    cells, agreeing, found = _best_agreement(matches, kept, separation_px, share)
    # the common displacement is the best of 1 / share different ones
    significance = max(0.0, found + float(np.log10(share)))
    enough = kept.sum() >= MIN_POINTS and agreeing >= MIN_CELLS
    if evidence < 0:
        significance = max(0.0, significance + evidence)
    elif significance >= MIN_OWN_SIGNIFICANCE:
        significance += evidence * (EVIDENCE_SHARE if doubtful else 1.0)
    accepted = bool(enough and significance >= MIN_SIGNIFICANCE)
    if accepted:
        return Verdict(True, None, cells, agreeing, significance)
    if by_blocks:
        return Verdict(False, BY_BLOCKS, cells, agreeing, significance)
    nothing = _nothing_to_match(counts)
    missing = nothing or _too_few(int(kept.sum()), agreeing, cells)
    if missing:
        smaller_windows = bool(nothing) or agree_closely(matches[kept])
        return Verdict(False, missing, cells, agreeing, significance, smaller_windows=smaller_windows)
    by_chance = f"none of the {counts['candidates']} candidates agrees with its neighbours"
    if kept.any():
        by_chance = (
            f"only {int(kept.sum())} of {counts['candidates']} candidates agree with their neighbours, in "
            f"{min(agreeing, int(kept.sum()))} of {cells} separate places"
        )
    by_chance += ", no better than chance"
    past_search_border = counts.get("at_search_border", 0) > AT_BORDER * counts["candidates"]
    few_valid = counts.get("not_comparable", 0) > FEW_VALID_SHARE * counts["candidates"]
    return Verdict(False, by_chance, cells, agreeing, significance, past_search_border, few_valid)


def agree_closely(points: TiePoints) -> bool:
    """Whether points are enough, and have one displacement up to a fraction of a pixel."""
    moved = points.displacement_px
    if len(moved) < MIN_POINTS:
        return False
    return bool(np.median(np.abs(moved - np.median(moved, axis=0)), axis=0).max() < CLOSE_PX)


def _lie_blocks_apart(matches: TiePoints, kept: Bool) -> bool:
    """Whether most matches that contradict the common displacement do so by whole blocks of JPEG."""
    if kept.sum() < MIN_POINTS:
        return False
    from_common = matches.displacement_px - np.median(matches.displacement_px[kept], axis=0)
    contradict = np.abs(from_common).max(axis=1) > BLOCK_PX / 2
    in_register = np.abs(from_common - BLOCK_PX * np.rint(from_common / BLOCK_PX)).max(axis=1) < 1
    return bool(contradict.sum() >= MIN_POINTS and in_register[contradict].mean() >= BLOCKS_APART_SHARE)


def is_doubtful(evidence: float) -> bool:
    """Whether the evidence of a search, 0 where nothing was searched, leaves a doubt about its start."""
    return evidence != 0 and evidence < CERTAIN_EVIDENCE


def _best_agreement(
    matches: TiePoints, kept: Bool, separation_px: float, share: float
) -> tuple[int, int, float]:
    """Count places with matches, and those that agree with the common displacement, which may be a plane.

    The third value is -log10 of the probability that as many agree by chance with the better of the two.
    """
    if len(matches) == 0:
        return 0, 0, 0.0
    chance = min(0.5, EPIPOLAR.chance_factor * share)
    middle_px = np.median(matches.displacement_px[kept if kept.any() else slice(None)], axis=0)
    place_of = _places(matches, separation_px)
    cells, agreeing = _agreement(matches, middle_px, place_of)
    level = cells, agreeing, evidence_against_chance(agreeing, cells, chance)
    if kept.sum() < 3 * MIN_POINTS:
        return level
    plane_px, planes = _common_plane(matches, kept)
    cells, agreeing = _agreement(matches, plane_px, place_of)
    tilted = cells, agreeing, evidence_against_chance(agreeing, cells, chance) - float(np.log10(planes))
    cells, agreeing, found = max(level, tilted, key=lambda each: each[2])
    return cells, agreeing, found - float(np.log10(2))


def _agreement(matches: TiePoints, common_px: Float64, place_of: Index) -> tuple[int, int]:
    """Count places with matches, and those whose typical match agrees with a (2,) or (n, 2) displacement."""
    agrees = np.linalg.norm(matches.displacement_px - common_px, axis=1) < AGREE_PX
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


def _cells(matches: TiePoints, cell_px: float) -> Index:
    """Return the (n,) number of the cell of each match, counted without gaps."""
    cells = np.floor(matches.reference_xy_px / cell_px).astype(np.intp)
    return np.unique(cells, axis=0, return_inverse=True)[1].ravel()


def _common_plane(matches: TiePoints, kept: Bool) -> tuple[Float64, float]:
    """Return the plane through the displacements of the consistent points, and of how many it is one.

    The plane is the (n, 2) displacement at all matches. The number counts the planes that tilt no more and
    differ by `AGREE_PX` at the border: the best of many planes agrees with more cells by chance, so a plane
    that is nearly level says more than one that is steep.
    """
    xy = matches.reference_xy_px - matches.reference_xy_px[kept].mean(axis=0)
    design = np.c_[np.ones(len(xy)), xy]
    solution = least_squares(design[kept], matches.displacement_px[kept])
    rise_px = np.abs(solution[1:]) * (np.ptp(xy, axis=0) / 2)[:, None]  # from the middle to the border
    return design @ solution, float(np.prod(1 + rise_px / AGREE_PX))


def motions_of(
    matches: TiePoints, kept: Bool, offset_px: Float64, window_px: int, radius_px: int
) -> list[tuple[Motion, Bool]]:
    """Find the displacements on each of which so many matches agree that it would be accepted by itself.

    Clouds seen from another angle or at another time, and the ground below them, are two such motions; what
    varies smoothly over the scene is one. Each comes with the (n,) bool array of its matches, that with most
    first; none where few of all n matches are consistent, the (n,) bool array `kept`. The `offset_px` is the
    (2,) displacement (col, row) of a target that lies where its georeferencing says; window and radius are
    those of `judge`.
    """
    if kept.sum() < MIN_POINTS:
        return []
    moved = matches.displacement_px - offset_px
    plane_px = _common_plane(matches, kept)[0]
    flat = moved - plane_px + plane_px[kept].mean(axis=0)
    if _most_frequent(flat)[1] > PLANE_RATIO * _most_frequent(moved)[1]:
        moved = flat
    cell_of = _cells(matches, CELL_PER_WINDOW * window_px)
    total = np.bincount(cell_of)
    share = min(1.0, np.pi * AGREE_PX**2 / (2 * radius_px + 1) ** 2)
    found: list[tuple[Motion, Bool]] = []
    left = np.ones(len(moved), bool)
    while left.sum() >= MIN_POINTS:
        middle_px = _most_frequent(moved[left])[0]
        off_px = np.linalg.norm(moved - middle_px, axis=1)
        near, left = off_px < AGREE_PX, left & (off_px >= 2 * AGREE_PX)
        places = int((np.bincount(cell_of, weights=near) >= total / 2).sum())
        evidence = evidence_against_chance(places, len(total), min(0.5, EPIPOLAR.chance_factor * share))
        significance = max(0.0, evidence + float(np.log10(share)))
        if near.sum() < MIN_POINTS or places < MIN_CELLS or significance < MIN_SIGNIFICANCE:
            break
        col, row = np.median(moved[near], axis=0).tolist()
        motion = Motion((col, row), int(near.sum()), float(near.mean()), places, significance)
        if all(_are_distinct(moved, motion, other) for other, _ in found):
            found.append((motion, near))
    return found


def other_displacement(matches: TiePoints, kept: Bool) -> tuple[Float64, Bool] | None:
    """Return what most matches that are not `kept`, an (n,) mask, lie off their neighbours, and which do.

    It is a (2,) displacement (col, row), px, and an (n,) mask; None where it may be chance.
    """
    off = np.flatnonzero(~kept)
    if len(off) < MIN_REJECTED or not kept.any():
        return None
    xy, moved = matches.reference_xy_px, matches.displacement_px
    offset = moved[off] - moved[kept][cKDTree(xy[kept]).query(xy[off])[1]]
    far = np.hypot(*offset.T) > AGREE_PX
    if far.sum() < MIN_REJECTED:
        return None
    middle_px, count = _most_frequent(offset[far])
    near = np.zeros(len(kept), bool)
    near[off[np.linalg.norm(offset - middle_px, axis=1) < AGREE_PX]] = True
    return (middle_px, near) if count >= MIN_REJECTED else None


def share_displaced(best_fit_px: Float64, other_px: Float64) -> float:
    """Return the share of the points at whose surroundings another displacement fits, beyond chance.

    It is the (2,) `other_px` (col, row) beside the points' own. The (n, 2) `best_fit_px` (col, row) are what
    fits best there beside these, see `matcher.displacement_by_surroundings`; NaN where nothing is known.
    """
    known = best_fit_px[np.isfinite(best_fit_px).all(axis=1)]
    if len(known) < MIN_POINTS:
        return 0.0
    other = float((np.linalg.norm(known - other_px, axis=1) < AGREE_PX).mean())
    elsewhere = float((np.linalg.norm(known, axis=1) > AGREE_PX).mean()) - other
    return other - elsewhere / 2  # of two displacements that are there by chance only


def patches(
    matches: TiePoints, kept: Bool, other: tuple[Float64, Bool], offset_px: Float64, window_px: int
) -> list[Motion]:
    """Return the motion of the matches that are `kept`, an (n,) mask, and that of patches beside it.

    The `other` displacement, (2,), with the (m,) mask of the first m matches, is that of
    `other_displacement`. The (2,) `offset_px` (col, row) and the window are those of `motions_of`.
    """
    cell_of, moved = _cells(matches, CELL_PER_WINDOW * window_px), matches.displacement_px - offset_px
    usual_px = np.median(moved[kept], axis=0)
    masks = kept, np.pad(other[1], (0, len(kept) - len(other[1]))) & ~kept
    return [
        Motion((col, row), int(mask.sum()), float(mask.mean()), len(np.unique(cell_of[mask])), 0.0)
        for (col, row), mask in zip((usual_px.tolist(), (usual_px + other[0]).tolist()), masks, strict=True)
    ]


def _most_frequent(moved: Float64) -> tuple[Float64, int]:
    """Return the displacement with which most agree, and how many do."""
    some = moved[:: -(-len(moved) // 4000)]
    tree = cKDTree(some)
    count = tree.query_ball_point(some, AGREE_PX, return_length=True)
    around = some[tree.query_ball_point(some[np.argmax(count)], AGREE_PX)]
    return np.median(around, axis=0), int(count.max())


def _are_distinct(moved: Float64, one: Motion, other: Motion) -> bool:
    """Whether two motions lie apart by what matches of one may differ, and hardly any lies halfway."""
    begin = np.asarray(other.displacement_px)
    way = np.asarray(one.displacement_px) - begin
    if np.hypot(*way) < 2 * AGREE_PX:
        return False
    along = (moved - begin) @ way / (way @ way)
    across = np.linalg.norm(moved - begin - along[:, None] * way, axis=1)
    halfway = (np.abs(along - 0.5) < 1 / 6) & (across < AGREE_PX)
    return bool(halfway.sum() <= MAX_SHARE_BETWEEN * min(one.points, other.points))


def motion_of_the_ground(
    motions: Sequence[tuple[Motion, Bool]], kept: Bool, error_px: float | None, of_one_product: bool
) -> tuple[list[tuple[Motion, Bool]], tuple[Motion, Bool] | None, str | None]:
    """Return motions, the likeliest first, the one of most (n,) `kept` matches, and why they are refused.

    The `motions` come with the (n,) masks of their matches. What is georeferenced, with a typical error, lies
    near its place, and bands of one product do to some metres: a motion far away has to be seen in many more
    places than one that is near.
    """
    if not motions:
        return [], None, None
    usual = max(motions, key=lambda each: np.count_nonzero(each[1] & kept))
    likely = sorted(motions, key=lambda each: -each[0].evidence(error_px))
    evidence = [motion.evidence(error_px) for motion, _ in likely]
    least = (
        MAIN_MOTION_RATIO * max(evidence[1:], default=0.0)
        if likely[0] is usual
        else OTHER_MOTION_RATIO * usual[0].evidence(error_px)
    )
    best, reason = likely[0][0], None
    if evidence[0] < least:
        reason = describe_motions([motion for motion, _ in likely], taken=False)
    elif error_px and of_one_product and np.hypot(*best.displacement_px) > MAX_PRODUCT_SIGMAS * error_px:
        reason = (
            f"bands of a product lie within metres of each other, and the matches agree on {best}, probably "
            "clouds: mask them (--ref-mask, --tgt-mask), or give --prealign search if a band has been moved"
        )
    return likely, usual, reason


def describe_motions(motions: Sequence[Motion], taken: bool) -> str:
    """Return what is told of a pair of several motions: that the first was taken, or why it is refused."""
    each = "; ".join(map(str, motions))
    message = f"the matches agree on {len(motions)} different displacements ({each})"
    if taken:
        return (
            f"{message}: the first was taken for that of the ground, the rest for clouds, what else moves or "
            "lies at another depth; there the correction does not hold"
        )
    return (
        f"{message}, and nothing tells which is that of the ground: give a mask (--ref-mask, --tgt-mask) "
        "with 0 on clouds and what else moves, or --prealign georef with a small --search-radius"
    )


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


def _too_few(points: int, agreeing: int, cells: int) -> str | None:
    """Return why points that agree are too few; None if they do not agree."""
    if agreeing < AGREEING_SHARE * cells or min(agreeing, points) == 0:
        return None
    needed = f"at least {MIN_POINTS} are needed"
    if points >= MIN_POINTS:
        needed = "points within a matching window say the same: more places are needed"
    return (
        f"{points} tie points agree, in {agreeing} of {cells} separate places, and so few say too little "
        f"({needed}): use rasters that share more ground, masks that exclude less, or a smaller --window"
    )


FEW_VALID_SHARE: Final = 0.3
"""Share of candidates with too few valid pixels around them from which it is advised to fill gaps."""


def refusal(
    verdict: Verdict, start: Prealignment, *, georeferenced: bool = True, few_values: Sequence[str] = ()
) -> str:
    """Return why a pair was refused, and what to try, the likeliest first.

    The verdict is that on the last start; `start` says whether the whole image has been searched. What is
    likely depends on whether both rasters are `georeferenced`, and on which have `few_values`.
    """
    reason = verdict.reason or ""
    advice = [] if verdict.past_search_border is None else [_advice(start, verdict.past_search_border)]
    if reason and start.evidence > 0:
        place = start.pose.shift_px if start.pose else start.shift_px
        advice.append(
            f"the search proposes ({place[0]:+.0f}, {place[1]:+.0f}) px (col, row), as it does by chance in "
            f"one of {10**start.evidence:.0f} pairs, and no tie points confirm it: check it by eye"
        )
    if few_values:
        advice.append(
            f"{' and '.join(few_values)} has little more than two values, as a mask or a map of classes: "
            "match an image that it was made from, and move it by what that gives (shift)"
        )
    elif verdict.past_search_border is not None:
        advice.append(_other_causes(verdict, start, georeferenced))
    return f"{reason}{'; ' if ': ' in reason else ': '}{'; '.join(advice)}" if advice else reason


def _other_causes(verdict: Verdict, start: Prealignment, georeferenced: bool) -> str:
    """Return what to try beside a search, the likeliest first."""
    causes = []
    if verdict.few_valid:
        causes.append("fill small gaps (gdal_fillnodata.py), around which too few pixels are valid")
    if not georeferenced and start.searched:
        causes.append(
            "if the two share a small part only, or their pixels differ more than four times in size, give "
            "both a rough geotransform (gdal_edit.py -a_ullr), right to some pixels"
        )
    causes.append("choose bands that look alike")
    causes.append("mask clouds and what has changed")
    return f"{', or '.join(causes)}, unless the two do not show the same place"


def _advice(start: Prealignment, past_search_border: bool) -> str:
    radius_px = start.search_radius_px
    edge = f"many best matches lie on the edge of the search radius of {radius_px} px"
    if not start.searched:
        if past_search_border:
            return f"{edge}: raise --search-radius, or give --prealign search"
        return (
            f"the displacement may exceed the search radius of {radius_px} px (raise --search-radius), or "
            "the two may be turned against each other (give --prealign search)"
        )
    if start.pose is not None:
        return (
            f"this is the best of {start.tried} starts, which a search over all rotations, scales and shifts "
            f"found at {start.pose}"
        )
    if start.method != "search":
        return "a search over the whole image found no start that holds"
    if past_search_border:
        return (
            f"{edge} around the shift that a search over the whole image found: give --prealign search with "
            f"--search-radius {2 * radius_px}"
        )
    return "this is from the shift that a search over the whole image found"
