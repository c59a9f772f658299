"""The grades of the images of a stack, by what their pairs say for and against their places."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Final, Literal

import numpy as np

from pcwlad_geo.correction.error_statistics import SIGMA_90
from pcwlad_geo.correction.expected_error import Residuals, local_residuals
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.parameters import GRADING, GradeParameters
from pcwlad_geo.registration import (
    FAIR_PX,
    GOOD_PX,
    GRADES,
    QualityParameters,
    Reason,
    grade_of,
    grade_of_error,
    worst_first,
)
from pcwlad_geo.types import Float64

GRADES_OF_IMAGES: Final = ("refused", *GRADES)
"""What an image can be graded, the worst first."""
NOISE_OF_MEDIAN: Final = 0.53
"""Standard deviation along an axis of the median of five normal errors, in their median distance from it."""


@dataclass(frozen=True, slots=True)
class StackQuality:
    """How far the place of an image can be relied on, or those of all images of a stack."""

    grade: Literal["good", "fair", "poor", "refused"]
    """good: 90 % of the image is expected to lie within 0.5 of its px, and nothing contradicts it; fair:
    within 1 px; poor: neither; refused: its pairs do not tell its place, and it has no corrected raster. Of a
    stack the worst of its images; poor where one was refused."""
    reasons: tuple[str, ...]
    """Why it is not good, the worst first."""
    expected_ce90_px: float
    """Error within which 90 % of the image is expected to lie, px of the image; of a stack the largest."""

    def doubted(self, text: str) -> StackQuality:
        """Return the quality, fair at most, with one more reason."""
        return replace(
            self, grade=min(self.grade, "fair", key=GRADES_OF_IMAGES.index), reasons=(*self.reasons, text)
        )

    @staticmethod
    def of_all(qualities: Mapping[str, StackQuality]) -> StackQuality:
        """Return the quality of a stack by those of its images."""
        worst_first = sorted(qualities, key=lambda name: GRADES_OF_IMAGES.index(qualities[name].grade))
        grade = qualities[worst_first[0]].grade
        reasons = (f"{name}: {reason}" for name in worst_first for reason in qualities[name].reasons[:1])
        expected = max(quality.expected_ce90_px for quality in qualities.values())
        return StackQuality("poor" if grade == "refused" else grade, tuple(reasons), expected)


def residual_ce90(at_px: Float64, residual_px: Float64) -> float:
    """Return the distance within which 90 % of what a pair shows lies from the adjustment, px.

    The (n, 2) `residual_px` at the (n, 2) places `at_px` are averaged over neighbours, and the noise of
    single points, by which neighbours differ, is taken out.
    """
    places = at_px[:: math.ceil(len(at_px) / 500)]
    residuals = Residuals(at_px, residual_px, np.ones(len(at_px), bool))
    smooth = local_residuals(residuals, places, MatchingWindow().side_px)
    noise = SIGMA_90 * NOISE_OF_MEDIAN * float(np.median(smooth.spread_px))
    return math.sqrt(max(0.0, float(np.percentile(np.hypot(*smooth.median_px.T), 90)) ** 2 - noise**2))


def image_qualities(
    pairs: Sequence[StackPair],
    sigma_px: Mapping[str, float],
    unit_px: Mapping[str, float],
    anchors: Collection[str],
    heights_px: Mapping[str, float],
    parameters: GradeParameters = GRADING,
) -> dict[str, StackQuality]:
    """Grade the images of a stack by what their pairs say for and against their places.

    A pair that was left out is evidence that the adjustment has not used; of one in use the part that the
    others check is (its offset by the root of its redundancy: Pope 1976). By the names of images, `sigma_px`
    is the standard deviation of the position of each along an axis, its own px, and `unit_px` the side of its
    pixels, px of the frame. The `anchors` are the images that stay, one a group; none where the mean or
    control points do. What wrong heights of a DEM do to an image is `heights_px`, its own px.
    """
    measured = [pair for pair in pairs if pair.offset_px is not None]
    pair_sigmas = [
        (pair.sigma_px or 0.0) / math.sqrt(pair.redundancy)
        for pair in measured
        if pair.status == "used" and pair.redundancy and pair.redundancy >= parameters.min_redundancy
    ]
    noise_px = parameters.quality.many_sigmas * median(pair_sigmas or [0.0])

    def off(name: str, among: Iterable[StackPair], limit_px: float) -> float:
        """Return the share of the pairs of an image that lie off its place by more than a limit, its px."""
        limit = max(limit_px * unit_px[name], noise_px)
        own_pairs = [pair for pair in among if name in (pair.reference, pair.target)]
        return sum(_discrepancy(pair, parameters) > limit for pair in own_pairs) / max(len(own_pairs), 1)

    refused: dict[str, str] = {}
    while True:  # what an image that was refused says of the others no longer counts
        among = [pair for pair in measured if not {pair.reference, pair.target} & refused.keys()]
        shares = {name: off(name, among, FAIR_PX) for name in sigma_px if name not in refused}
        worst = max(shares.values(), default=0.0)
        if worst < parameters.supported_share:
            break
        refused |= {
            name: f"{100 * worst:.0f} % of its pairs lie more than {FAIR_PX:g} px off where the others put it"
            for name, share in shares.items()
            if share == worst
        }
    refused |= _cut_off(among, shares, anchors, refused)
    qualities, jitter_px = {}, _jitter(pairs, sigma_px, anchors)
    for name, sigma in sigma_px.items():
        about = [
            pair for pair in (measured if name in refused else among) if name in (pair.reference, pair.target)
        ]
        share = {limit: off(name, about, limit) for limit in (FAIR_PX, GOOD_PX)}
        expected, reasons = _judged(
            about, sigma, unit_px[name], share, jitter_px[name], heights_px.get(name, 0.0), parameters
        )
        grade = "refused" if name in refused else grade_of(reasons)
        texts = [refused[name]] if name in refused else []
        texts += [reason.text for reason in worst_first(reasons)]
        qualities[name] = StackQuality(grade, tuple(texts), expected)
    return qualities


def _discrepancy(pair: StackPair, parameters: GradeParameters) -> float:
    """Return by how much a pair lies off what the others tell, px of the frame, less what it tells itself."""
    return pair.off_px / math.sqrt(max(pair.redundancy or 0.0, parameters.min_redundancy))


def _cut_off(
    pairs: Sequence[StackPair], names: Collection[str], anchors: Collection[str], refused: Collection[str]
) -> dict[str, str]:
    """Return why images are refused that only images that were refused connect with those that stay."""
    reached, new = set[str](), set(anchors) - set(refused)
    if not refused or not anchors:
        return {}
    while new:
        reached |= new
        ends_in_use = ({pair.reference, pair.target} for pair in pairs if pair.status == "used")
        new = {name for ends in ends_in_use if ends & reached for name in ends} - reached
    reason = f"only {', '.join(refused)}, which cannot be placed, would connect it with the datum"
    return {name: reason for name in names if name not in reached and name not in refused}


def _jitter(pairs: Sequence[StackPair], names: Collection[str], anchors: Collection[str]) -> dict[str, float]:
    """Return the jitter of every image against those that stay, px of the frame.

    Two images may share it, so that their pair shows none. It is the least along the pairs that lead to an
    image that stays, their variances added; where none stays, the least of the image's own pairs.
    """
    in_use = [pair for pair in pairs if pair.status == "used"]
    least = {name: 0.0 if name in anchors else math.inf for name in names}
    for _ in range(len(names) if anchors else 0):
        for pair in in_use:
            for one, other in ((pair.reference, pair.target), (pair.target, pair.reference)):
                least[one] = min(least[one], math.hypot(least[other], pair.jitter_px))
    pair_jitter = {
        name: min((pair.jitter_px for pair in in_use if name in (pair.reference, pair.target)), default=0.0)
        for name in names
    }
    return {name: size if math.isfinite(size) else pair_jitter[name] for name, size in least.items()}


def _judged(
    pairs: Sequence[StackPair],
    sigma_px: float,
    unit_px: float,
    off: Mapping[float, float],
    jitter_px: float,
    heights_px: float,
    parameters: GradeParameters,
) -> tuple[float, list[Reason]]:
    """Return the expected CE90 of an image, its px, and what keeps it from being good.

    `off` is the share of its pairs that lie off by more than each limit.
    """
    in_use, reasons = [pair for pair in pairs if pair.status == "used"], []
    residual_px = median([pair.ce90_px or 0.0 for pair in in_use] or [0.0]) / unit_px
    causes = {
        f"the sigma of its position ({sigma_px:.2f} px)": SIGMA_90 * sigma_px,
        "what its pairs leave": residual_px,
        "rows or columns that move within matching windows (jitter)": SIGMA_90 / 2**0.5 * jitter_px / unit_px,
        "heights of a DEM that lies beside its relief": heights_px,
    }
    expected = math.hypot(*causes.values())
    if expected > GOOD_PX:
        parts = ", ".join(
            f"{size:.2f} px by {cause}" for cause, size in causes.items() if size >= parameters.min_cause_px
        )
        text = f"a tenth of it is expected to lie more than {expected:.2f} px off: {parts}"
        reasons.append(Reason(grade_of_error(expected), text))
    limit = FAIR_PX if off[FAIR_PX] > parameters.contradicted_share else GOOD_PX
    if off[limit] >= parameters.contradicted_share:
        text = f"{100 * off[limit]:.0f} % of its pairs lie more than {limit:g} px off its place"
        reasons.append(Reason("poor" if limit == FAIR_PX else "fair", text))
    if not any((pair.redundancy or 0.0) >= parameters.min_redundancy for pair in in_use):
        reasons.append(Reason("fair", "no other pair checks those that place it"))
    graded = worst_first(_own_grade(pair, parameters.quality) for pair in in_use)
    middle = graded[len(graded) // 2] if graded else Reason("good", "")
    if middle.grade != "good":
        share = sum(pair_reason.grade != "good" for pair_reason in graded)
        text = f"{share} of the {len(in_use)} pairs that place it are not good: {middle.text}"
        reasons.append(Reason(middle.grade, text))
    return expected, reasons


def _own_grade(pair: StackPair, parameters: QualityParameters) -> Reason:
    """Return the grade of a pair by itself, and why it is not better."""
    empty = pair.empty_share or 0.0
    if empty > parameters.good_extrapolated_share and pair.quality != "poor":
        return Reason("fair", f"{100 * empty:.0f} % of the common ground has no tie point")
    return Reason(pair.quality or "good", "; ".join(pair.quality_reasons[:1]))
