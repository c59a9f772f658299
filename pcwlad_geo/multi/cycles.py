"""What the pairs of a stack say against each other: cycles that fail to close, and the grades of images."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from statistics import median
from typing import Final, Literal

import numpy as np

from pcwlad_geo.correction.error_statistics import SIGMA_90, Residuals, left_by_correction
from pcwlad_geo.matching.types import FIRST_WINDOW_PX
from pcwlad_geo.multi.adjustment import MIN_REDUNDANCY
from pcwlad_geo.multi.stack_pairs import StackPair
from pcwlad_geo.registration import FAIR_PX, GOOD_PX, GRADES, QualityParameters, Reason
from pcwlad_geo.types import Float64

MAX_CYCLES: Final = 20_000
"""Largest number of cycles that are looked at."""
OPEN_SIGMAS: Final = 5.0
"""A cycle that fails to close by more sigmas is listed."""


@dataclass(frozen=True, slots=True)
class Cycle:
    """A cycle that does not close."""

    images: tuple[str, ...]
    """Names of its images, in order."""
    closure_px: tuple[float, float]
    """What the displacements of its pairs add up to (col, row), px of the frame."""
    sigma_px: float
    """Standard deviation of that along an axis, if all its pairs are right."""
    blame: tuple[str, str]
    """The pair of it that disagrees most with all others, in sigmas."""


@dataclass(frozen=True, slots=True)
class Closure:
    """How the cycles of three pairs, or of four where there are none of three, close."""

    cycles: int
    """Number of cycles of measured pairs."""
    before_px: float | None
    """Root mean square length of what all of them fail to close by, px of the frame; null without a cycle."""
    after_px: float | None
    """The same of those without a pair that was left out."""
    open: tuple[Cycle, ...]
    """Those that do not close, the worst first."""


def closure_of(pairs: Sequence[StackPair]) -> Closure:
    """Return how the cycles of measured pairs close.

    In a cycle the displacements of the adjustment add up to nothing; what is left is by how much each pair
    lies off it.
    """
    measured = {(pair.reference, pair.target): pair for pair in pairs if pair.offset_px is not None}
    every, good, found = [], [], []
    for images in _cycles(measured):
        steps = [_step(measured, *ends) for ends in zip(images, (*images[1:], images[0]), strict=True)]
        col, row = (
            sum(sign * (pair.offset_px or (0.0, 0.0))[axis] for pair, sign in steps) for axis in (0, 1)
        )
        length = math.hypot(col, row)
        every.append(length)
        if all(pair.status == "used" for pair, _ in steps):
            good.append(length)
        sigma = math.sqrt(sum((pair.sigma_px or 0.0) ** 2 for pair, _ in steps))
        if length > OPEN_SIGMAS * max(sigma, 1e-9):
            worst = max(
                (pair for pair, _ in steps), key=lambda pair: (pair.status != "used", misfit_sigmas(pair))
            )
            found.append(Cycle(images, (col, row), sigma, (worst.reference, worst.target)))
    found.sort(key=lambda each: -math.hypot(*each.closure_px))
    return Closure(len(every), root_mean_square(every), root_mean_square(good), tuple(found[:30]))


def misfit_sigmas(pair: StackPair) -> float:
    """Return by how many sigmas a pair disagrees with all others; 0 for one that was refused."""
    return pair.off_px / pair.sigma_px if pair.sigma_px else 0.0


def root_mean_square(values: Sequence[float]) -> float | None:
    """Return the root mean square of values; None of none."""
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else None


def _step(measured: dict[tuple[str, str], StackPair], one: str, other: str) -> tuple[StackPair, float]:
    """Return the pair of two images, and whether it is gone forwards (1) or backwards (-1)."""
    found = measured.get((one, other))
    return (found, 1.0) if found is not None else (measured[other, one], -1.0)


def _cycles(measured: dict[tuple[str, str], StackPair]) -> list[tuple[str, ...]]:
    """Return the cycles of three images, or of four where there are none of three."""
    near: dict[str, set[str]] = {}
    for one, other in measured:
        near.setdefault(one, set()).add(other)
        near.setdefault(other, set()).add(one)
    order = {name: number for number, name in enumerate(near)}
    found: list[tuple[str, ...]] = []
    for one, other in measured:
        later = max(order[one], order[other])
        thirds = sorted(
            (each for each in near[one] & near[other] if order[each] > later), key=order.__getitem__
        )
        found += [(one, other, third) for third in thirds]
        if len(found) > MAX_CYCLES:
            return found[:MAX_CYCLES]
    return found or _of_four(near, order)


def _of_four(near: dict[str, set[str]], order: dict[str, int]) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    for one, across in combinations(order, 2):
        between = sorted((near[one] & near[across]) - {one, across}, key=order.__getitem__)
        found += [
            (one, two, across, four)
            for two, four in combinations(between, 2)
            if order[one] < min(order[two], order[four])
        ]
        if len(found) > MAX_CYCLES:
            break
    return found[:MAX_CYCLES]


SUPPORTED_SHARE: Final = 1 / 2
"""An image is refused unless a larger share of its pairs supports its place."""
CONTRADICTED_SHARE: Final = 1 / 3
"""Share of the pairs of an image off its place from which it is not good: pairs may share a cause."""
GRADES_OF_IMAGES: Final = ("refused", *GRADES)
"""What an image can be graded, the worst first."""
NOISE_OF_MEDIAN: Final = 0.53
"""Standard deviation along an axis of the median of five normal errors, in their median distance from it."""
LEAST_CAUSE_PX: Final = 0.05
"""Least part of the expected error of an image that is told."""


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
    def of_all(found: Mapping[str, StackQuality]) -> StackQuality:
        """Return the quality of a stack by those of its images."""
        worst_first = sorted(found, key=lambda name: GRADES_OF_IMAGES.index(found[name].grade))
        grade = found[worst_first[0]].grade
        reasons = (f"{name}: {reason}" for name in worst_first for reason in found[name].reasons[:1])
        expected = max(each.expected_ce90_px for each in found.values())
        return StackQuality("poor" if grade == "refused" else grade, tuple(reasons), expected)


def residual_ce90(at_px: Float64, residual_px: Float64) -> float:
    """Return the distance within which 90 % of what a pair shows lies from the adjustment, px.

    The (n, 2) `residual_px` at the (n, 2) places `at_px` are averaged over neighbours, and the noise of
    single points, by which neighbours differ, is taken out.
    """
    places = at_px[:: math.ceil(len(at_px) / 500)]
    residuals = Residuals(at_px, residual_px, np.ones(len(at_px), bool))
    left = left_by_correction(residuals, places, FIRST_WINDOW_PX)
    noise = SIGMA_90 * NOISE_OF_MEDIAN * float(np.median(left.spread_px))
    return math.sqrt(max(0.0, float(np.percentile(np.hypot(*left.median_px.T), 90)) ** 2 - noise**2))


def image_qualities(
    pairs: Sequence[StackPair],
    sigma_px: Mapping[str, float],
    unit_px: Mapping[str, float],
    anchors: Collection[str],
    heights_px: Mapping[str, float],
) -> dict[str, StackQuality]:
    """Grade the images of a stack by what their pairs say for and against their places.

    A pair that was left out is evidence that the adjustment has not used; of one in use the part that the
    others check is (its offset by the root of its redundancy: Pope 1976). By the names of images, `sigma_px`
    is the standard deviation of the position of each along an axis, its own px, and `unit_px` the side of its
    pixels, px of the frame. The `anchors` are the images that stay, one a group; none where the mean or
    control points do. What wrong heights of a DEM do to an image is `heights_px`, its own px.
    """
    measured = [pair for pair in pairs if pair.offset_px is not None]
    own = [
        (pair.sigma_px or 0.0) / math.sqrt(pair.redundancy)
        for pair in measured
        if pair.status == "used" and pair.redundancy is not None and pair.redundancy >= MIN_REDUNDANCY
    ]
    noise_px = QualityParameters().many_sigmas * median(own or [0.0])

    def off(name: str, among: Iterable[StackPair], limit_px: float) -> float:
        """Return the share of the pairs of an image that lie off its place by more than a limit, its px."""
        limit = max(limit_px * unit_px[name], noise_px)
        far = [_discrepancy(pair) > limit for pair in among if name in (pair.reference, pair.target)]
        return sum(far) / max(len(far), 1)

    refused: dict[str, str] = {}
    while True:  # what an image that was refused says of the others no longer counts
        among = [pair for pair in measured if not {pair.reference, pair.target} & refused.keys()]
        shares = {name: off(name, among, FAIR_PX) for name in sigma_px if name not in refused}
        worst = max(shares.values(), default=0.0)
        if worst < SUPPORTED_SHARE:
            break
        refused |= {
            name: f"{100 * worst:.0f} % of its pairs lie more than {FAIR_PX:g} px off where the others put it"
            for name, share in shares.items()
            if share == worst
        }
    refused |= _cut_off(among, shares, anchors, refused)
    found, jitter_px = {}, _jitter(pairs, sigma_px, anchors)
    for name, sigma in sigma_px.items():
        about = [
            pair for pair in (measured if name in refused else among) if name in (pair.reference, pair.target)
        ]
        share = {limit: off(name, about, limit) for limit in (FAIR_PX, GOOD_PX)}
        expected, reasons = _judged(
            about, sigma, unit_px[name], share, jitter_px[name], heights_px.get(name, 0.0)
        )
        reasons.sort(key=lambda each: GRADES.index(each.grade))
        grade = "refused" if name in refused else reasons[0].grade if reasons else "good"
        texts = [refused[name]] if name in refused else []
        found[name] = StackQuality(grade, (*texts, *(each.text for each in reasons)), expected)
    return found


def _discrepancy(pair: StackPair) -> float:
    """Return by how much a pair lies off what the others tell, px of the frame, less what it tells itself."""
    return pair.off_px / math.sqrt(max(pair.redundancy or 0.0, MIN_REDUNDANCY))


def _cut_off(
    pairs: Sequence[StackPair], names: Collection[str], anchors: Collection[str], refused: Collection[str]
) -> dict[str, str]:
    """Return why images are refused that only images that were refused connect with those that stay."""
    reached, new = set[str](), set(anchors) - set(refused)
    if not refused or not anchors:
        return {}
    while new:
        reached |= new
        used = ({pair.reference, pair.target} for pair in pairs if pair.status == "used")
        new = {name for ends in used if ends & reached for name in ends} - reached
    reason = f"only {', '.join(refused)}, which cannot be placed, would connect it with the datum"
    return {name: reason for name in names if name not in reached and name not in refused}


def _jitter(pairs: Sequence[StackPair], names: Collection[str], anchors: Collection[str]) -> dict[str, float]:
    """Return the jitter of every image against those that stay, px of the frame.

    Two images may share it, so that their pair shows none. It is the least along the pairs that lead to an
    image that stays, their variances added; where none stays, the least of the image's own pairs.
    """
    used = [pair for pair in pairs if pair.status == "used"]
    least = {name: 0.0 if name in anchors else math.inf for name in names}
    for _ in range(len(names) if anchors else 0):
        for pair in used:
            for one, other in ((pair.reference, pair.target), (pair.target, pair.reference)):
                least[one] = min(least[one], math.hypot(least[other], pair.jitter_px))
    own = {
        name: min((pair.jitter_px for pair in used if name in (pair.reference, pair.target)), default=0.0)
        for name in names
    }
    return {name: size if math.isfinite(size) else own[name] for name, size in least.items()}


def _judged(
    pairs: Sequence[StackPair],
    sigma_px: float,
    unit_px: float,
    off: Mapping[float, float],
    jitter_px: float,
    heights_px: float,
) -> tuple[float, list[Reason]]:
    """Return the expected CE90 of an image, its px, and what keeps it from being good.

    `off` is the share of its pairs that lie off by more than each limit.
    """
    used, reasons = [pair for pair in pairs if pair.status == "used"], []
    residual_px = median([pair.ce90_px or 0.0 for pair in used] or [0.0]) / unit_px
    causes = {
        f"the sigma of its position ({sigma_px:.2f} px)": SIGMA_90 * sigma_px,
        "what its pairs leave": residual_px,
        "rows or columns that move within matching windows (jitter)": SIGMA_90 / 2**0.5 * jitter_px / unit_px,
        "heights of a DEM that lies beside its relief": heights_px,
    }
    expected = math.hypot(*causes.values())
    if expected > GOOD_PX:
        parts = ", ".join(
            f"{size:.2f} px by {cause}" for cause, size in causes.items() if size >= LEAST_CAUSE_PX
        )
        text = f"a tenth of it is expected to lie more than {expected:.2f} px off: {parts}"
        reasons.append(Reason("fair" if expected <= FAIR_PX else "poor", text))
    far = FAIR_PX if off[FAIR_PX] > CONTRADICTED_SHARE else GOOD_PX
    if off[far] >= CONTRADICTED_SHARE:
        text = f"{100 * off[far]:.0f} % of its pairs lie more than {far:g} px off its place"
        reasons.append(Reason("poor" if far == FAIR_PX else "fair", text))
    if not any((pair.redundancy or 0.0) >= MIN_REDUNDANCY for pair in used):
        reasons.append(Reason("fair", "no other pair checks those that place it"))
    graded = sorted((_own_grade(pair) for pair in used), key=lambda each: GRADES.index(each.grade))
    middle = graded[len(graded) // 2] if graded else Reason("good", "")
    if middle.grade != "good":
        share = sum(each.grade != "good" for each in graded)
        text = f"{share} of the {len(used)} pairs that place it are not good: {middle.text}"
        reasons.append(Reason(middle.grade, text))
    return expected, reasons


def _own_grade(pair: StackPair) -> Reason:
    """Return the grade of a pair by itself, and why it is not better."""
    empty = pair.empty_share or 0.0
    if empty > QualityParameters().good_extrapolated_share and pair.quality != "poor":
        return Reason("fair", f"{100 * empty:.0f} % of the common ground has no tie point")
    return Reason(pair.quality or "good", "; ".join(pair.quality_reasons[:1]))
