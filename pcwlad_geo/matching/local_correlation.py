"""Correlation of the two images around matches: more than chance, or better at another displacement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.matching.guidance import FieldGuide
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.types import TiePoints, to_index
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class LocalCorrelationParameters:
    """Where, and from when on, two images correlate around a match."""

    half_px: int = 40
    """Half side of what must correlate around a match, about the first window of refinement."""
    chance_offset_px: int = 24
    """Offset of places (row and col) that correlate by chance only, beyond the reach of the filters."""
    more_than_chance: float = 2.0
    """Least correlation of a match, in standard deviations of those by chance."""
    near_half_px: int = 20
    """Half side of what shows the displacement of the ground right around a point."""
    clear_difference: float = 0.05
    """How much more another displacement must correlate there."""
    at_once: int = 128
    """Number of points that are compared at once, which limits the memory."""


CORRELATION: Final = LocalCorrelationParameters()
"""Those in use."""


def displacement_by_surroundings(
    pair: ChannelPair, points: TiePoints, guide: FieldGuide, other_px: Float64
) -> Float64:
    """Return (1, n, 2) the displacement (col, row) that fits best right around each of n points.

    It is the point's own, or that and the (2,) `other_px` (col, row), or one of two as far away in other
    directions, which fit as often by chance. The `points` are in pixel coordinates of the arrays of `pair`.
    """
    corners = to_index(points)
    matches = corners + np.rint(points.displacement_px[:, ::-1]).astype(np.intp)
    offsets = np.array([np.zeros(2), other_px, -other_px, other_px[::-1] * (1, -1)])
    places = [matches + np.rint(offset[::-1]).astype(np.intp) for offset in offsets]
    correlation = np.stack([correlations(pair, corners, rc, CORRELATION.near_half_px) for rc in places])
    correlation[0] += CORRELATION.clear_difference
    best: Float64 = points.displacement_px + offsets[correlation.argmax(axis=0)]
    return best[None]


def significantly_correlated(
    pair: ChannelPair, corners_rc: Index, shift_xy_px: Float64, least: float = CORRELATION.more_than_chance
) -> Bool:
    """Return the (n,) mask of the matches around which the two images correlate more than by chance.

    The (n, 2) `corners_rc` are pixels of the reference, `shift_xy_px` where they are in the target beside
    that. The correlation of the maps around each is compared with those that the same places have with places
    beside their matches: it is `least` times their RMS or more.
    """
    whole = np.rint(shift_xy_px[:, ::-1]).astype(np.intp)
    right, elsewhere = (
        correlations(pair, corners_rc, corners_rc + whole + offset, CORRELATION.half_px, 2)
        for offset in (0, CORRELATION.chance_offset_px)
    )
    by_chance = float(np.sqrt(np.mean(elsewhere**2))) if len(elsewhere) else 0.0
    return right > least * by_chance


def correlations(
    pair: ChannelPair, reference_rc: Index, target_rc: Index, half_px: int, step_px: int = 1
) -> Float64:
    """Return the (n,) correlations of the maps around pixels of the reference and of the target.

    These are the (n, 2) `reference_rc` and the (n, 2) `target_rc` (row, col). The squares compared reach
    `half_px` from their pixels, and consist of the pixels `step_px` apart.
    """
    steps = np.arange(-half_px, half_px + 1, step_px)
    result = np.zeros(len(reference_rc))
    for begin in range(0, len(reference_rc), CORRELATION.at_once):
        part = slice(begin, begin + CORRELATION.at_once)
        centred = []
        sides = (pair.reference.maps, reference_rc[part]), (pair.target.maps, target_rc[part])
        for maps, centre_rc in sides:
            rows, cols = (
                np.clip(centre[:, None] + steps, 0, length - 1)
                for centre, length in zip(centre_rc.T, maps.shape[1:], strict=True)
            )
            values = maps[:, rows[:, :, None], cols[:, None, :]]
            centred.append(values - values.mean(axis=(2, 3), keepdims=True))
        reference, target = centred
        both, first, second = (
            np.einsum("knij,knij->n", one, other)
            for one, other in ((reference, target), (reference, reference), (target, target))
        )
        result[part] = both / np.sqrt(np.maximum(first * second, np.finfo(np.float32).tiny))
    return result
