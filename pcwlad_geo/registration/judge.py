"""Is the pair registered? Enough points that agree, and many more than chance would make agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.chance import evidence_against_chance
from pcwlad_geo.matching.tie_points import TiePoints

Float64 = NDArray[np.float64]

LEAST_POINTS: Final = 12
LEAST_CELLS: Final = 4
"""Separate places (one matching window each) that must agree."""
CELL_PER_WINDOW: Final = 0.75
"""Side of the cells that count as independent witnesses, in windows."""
AGREE_PX: Final = 2.0
LEAST_SIGNIFICANCE: Final = 6.0
"""-log10 of the probability that unrelated images show such agreement."""
MOSTLY: Final = 0.75
"""Where such a share of the places agrees, it is their number that does not suffice."""
AT_BORDER: Final = 0.25
"""Share of the candidates whose best match lies on the edge of the search that is many."""
CHANCE_FACTOR: Final = 2.0
"""Matches of unrelated images are not uniform over the search window: more chance is allowed for."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the points can be trusted, and by what evidence."""

    accepted: bool
    reason: str | None
    """What was found, where that is not enough."""
    cells: int
    """Separate places with a match of any kind."""
    agreeing_cells: int
    significance: float
    beyond: bool | None = None
    """Whether many best matches lie on the edge of the search; None unless the points agree by chance."""


def judge(
    matches: TiePoints, kept: NDArray[np.bool_], counts: dict[str, int], window_px: int, radius_px: int
) -> Verdict:
    """Judge the first pass.

    Parameters
    ----------
    matches : TiePoints
        All matches, each found on its own, consistent or not.
    kept : (n,) bool array
        The consistent ones.
    counts : dict
        What the stages counted.
    window_px : int
        Side of the matching window: one cell is one independent witness.
    radius_px : int
        Search radius of the coarse match.
    """
    cells, agreeing = _witnesses(matches, kept, CELL_PER_WINDOW * window_px)
    share = min(1.0, np.pi * AGREE_PX**2 / (2 * radius_px + 1) ** 2)
    # the best of 1 / share different common displacements is looked at
    found = evidence_against_chance(agreeing, cells, min(0.5, CHANCE_FACTOR * share))
    significance = max(0.0, found + float(np.log10(share)))
    enough = kept.sum() >= LEAST_POINTS and agreeing >= LEAST_CELLS
    accepted = bool(enough and significance >= LEAST_SIGNIFICANCE)
    if accepted:
        return Verdict(True, None, cells, agreeing, significance)
    missing = _nothing_to_match(counts) or _too_few(int(kept.sum()), agreeing, cells)
    if missing:
        return Verdict(False, missing, cells, agreeing, significance)
    by_chance = (
        f"only {int(kept.sum())} of {counts['candidates']} candidates agree with their neighbours, in "
        f"{agreeing} of {cells} separate places, no better than chance"
    )
    return Verdict(False, by_chance, cells, agreeing, significance, _beyond(counts))


def _witnesses(matches: TiePoints, kept: NDArray[np.bool_], cell_px: float) -> tuple[int, int]:
    """Count cells with matches, and those whose typical match agrees with the common displacement."""
    if len(matches) == 0:
        return 0, 0
    xy, moved = matches.reference_xy_px, matches.displacement_px
    cell_of = np.unique(np.floor(xy / cell_px).astype(np.intp), axis=0, return_inverse=True)[1].ravel()
    common = _common_displacement(xy, moved, kept)
    agrees = np.linalg.norm(moved - common, axis=1) < AGREE_PX
    total = np.bincount(cell_of)
    share = np.bincount(cell_of, weights=agrees) / total
    return len(total), int((share >= 0.5).sum())


def _common_displacement(xy: Float64, moved: Float64, kept: NDArray[np.bool_]) -> Float64:
    """Return what the consistent points say everywhere: (n, 2), a plane where they are many."""
    if not kept.any():
        return np.median(moved, axis=0)[None].repeat(len(moved), 0)
    centre = xy[kept].mean(axis=0)
    if kept.sum() < 3 * LEAST_POINTS:
        return np.median(moved[kept], axis=0)[None].repeat(len(moved), 0)
    design = np.c_[np.ones(int(kept.sum())), xy[kept] - centre]
    solution = np.linalg.lstsq(design, moved[kept], rcond=None)[0]
    result: Float64 = np.c_[np.ones(len(xy)), xy - centre] @ solution
    return result


def _nothing_to_match(counts: dict[str, int]) -> str | None:
    """Return why hardly a candidate could be matched at all; None where they could."""
    candidates = counts.get("candidates", 0)
    if candidates == 0:
        return (
            "no structure to match: the overlap is flat, masked or too small; check bands, masks and nodata"
        )
    if counts.get("not_comparable", 0) > 0.9 * candidates:
        return "almost no window has enough valid pixels in both images; check masks, nodata and overlap"
    return None


def _too_few(points: int, agreeing: int, cells: int) -> str | None:
    """Return why points that agree are too few all the same; None where they do not agree."""
    if agreeing < MOSTLY * cells or agreeing == 0:
        return None
    return (
        f"{points} tie points agree, in {agreeing} of {cells} separate places, and so few say too little "
        f"(at least {LEAST_POINTS} points are needed, and some more places than {LEAST_CELLS}): use rasters "
        "that share more ground, masks that exclude less, or a smaller --window"
    )


def _beyond(counts: dict[str, int]) -> bool:
    return counts.get("at_search_border", 0) > AT_BORDER * counts["candidates"]
