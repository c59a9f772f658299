"""Search the shift between two images of different modality without any prior, and judge it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.chance import evidence_against_chance
from pcwlad_geo.matching.channels import Channels, channels_at
from pcwlad_geo.matching.masked_correlation import peaks_of
from pcwlad_geo.matching.patches import PATCHES, Patches
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class ShiftSearchParameters:
    """Resolutions of the search, and when a shift is accepted."""

    finest_side_px: int = 512
    """Approximate longer side of the smaller image at the finest level; modalities share coarse
    structure."""
    largest_side_px: int = 1200
    """Longest side of the larger image at the finest level."""
    levels: int = 3
    """Number of resolution levels, each half as fine as the one before."""
    agreeing_by_chance: float = 0.1
    """Share of patches of unrelated images that agree with the best similarity and candidate, as
    measured."""
    least_significance: float = 5.0
    """Least significance, -log10 of the probability of chance, of an accepted shift."""
    least_distinctness: float = 0.25
    """Least value of 1 minus the share of patches that agree on the best rival elsewhere, over that of an
    accepted shift."""


SHIFT_SEARCH: Final = ShiftSearchParameters()
"""Those that are used."""


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The shift found, and how well it is supported."""

    shift_xy: tuple[float, float]
    """(col, row) target minus reference array index, px: the middle of what the patches found."""
    spread_px: float
    """Distance from the shift within which 95 % of the agreeing patches lie: parallax, scale and rotation."""
    significance: float
    """-log10 of the probability that as many patches agree by chance."""
    accepted: bool
    """Whether it is significant, and distinct from its best rival elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class _Vote:
    """How many patches support one candidate, at the finest level."""

    shift_xy: Float64
    spread_px: float = 0.0
    patches: int = 0
    agreeing: int = 0
    significance: float = 0.0

    @property
    def share(self) -> float:
        return self.agreeing / max(self.patches, PATCHES.least)


def search_shift(
    reference: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    reference_valid: Bool,
    target_valid: Bool,
    by: ShiftSearchParameters = SHIFT_SEARCH,
) -> SearchResult:
    """Find the shift between two images of the same resolution, to about 1 px.

    Parameters
    ----------
    reference, target : (rows, cols) float array
        The shapes may differ, best at most about 1024 px a side; the values of invalid pixels are ignored.
    reference_valid, target_valid : (rows, cols) bool array
        True where a pixel of the image is valid.
    by : ShiftSearchParameters
        Those that are used, unless a study varies them.

    Returns
    -------
    SearchResult
        Not accepted, with shift (0, 0), where nothing could be compared.

    Notes
    -----
    Structure common to both images is taken for the ground: a common pixel pattern (two frames of one
    flawed sensor, a burnt-in overlay) stronger than the scene is accepted, at shift 0.

    References
    ----------
    .. [1] Padfield, D. (2012), doi:10.1109/TIP.2011.2181402 (masked normalised cross-correlation).
    """
    sides = max(reference.shape), max(target.shape)
    factor = max(1, round(min(sides) / by.finest_side_px), -(-max(sides) // by.largest_side_px))
    finest = channels_at(reference, reference_valid, factor), channels_at(target, target_valid, factor)
    candidates: list[tuple[float, float]] = []
    for level in range(1, by.levels):
        step = factor * 2**level
        pair = channels_at(reference, reference_valid, step), channels_at(target, target_valid, step)
        candidates += [(x * 2**level, y * 2**level) for x, y in peaks_of(*pair)]
    votes = [_vote(*finest, np.array(candidate), by) for candidate in _distinct(candidates)]
    return _judge(votes, factor, by)


def _distinct(candidates: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Drop candidates that lie within the search of the patches around an earlier one."""
    distinct: list[tuple[float, float]] = []
    for candidate in candidates:
        if all(np.hypot(candidate[0] - x, candidate[1] - y) > PATCHES.radius_px / 2 for x, y in distinct):
            distinct.append(candidate)
    return distinct


def _vote(reference: Channels, target: Channels, candidate_xy: Float64, by: ShiftSearchParameters) -> _Vote:
    """Match patches around a candidate and count those that agree on one similarity."""
    start = np.rint(candidate_xy).astype(int)
    patches = Patches.matched((reference.values, reference.valid), (target.values, target.valid), start)
    if patches.count == 0:
        return _Vote(candidate_xy)
    agreeing = patches.displacements_px[patches.agrees]
    middle = np.median(agreeing, axis=0)
    spread = np.percentile(np.hypot(*(agreeing - middle).T), 95)
    significance = 0.0
    if patches.count >= PATCHES.least:
        significance = evidence_against_chance(patches.agreeing, patches.count, by.agreeing_by_chance)
    return _Vote(start + middle, float(spread), patches.count, patches.agreeing, significance)


def _judge(votes: list[_Vote], factor: int, by: ShiftSearchParameters) -> SearchResult:
    """Take the best vote and compare it with its best rival elsewhere."""
    if not votes:
        return SearchResult((0.0, 0.0), 0.0, 0.0, False)
    best = max(votes, key=lambda vote: vote.significance)
    rivals = [vote.share for vote in votes if np.hypot(*(vote.shift_xy - best.shift_xy)) > PATCHES.radius_px]
    distinctness = 1 - min(max(rivals, default=0.0) / best.share, 1.0) if best.agreeing else 0.0
    accepted = best.significance >= by.least_significance and distinctness >= by.least_distinctness
    x, y = best.shift_xy * factor
    return SearchResult((float(x), float(y)), best.spread_px * factor, best.significance, accepted)
