"""Vertices of lines that follow a correction: new ones are inserted where it bends a straight segment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcwlad_geo.types import Float64, Index


@dataclass(frozen=True, slots=True)
class DensifyingParameters:
    """How closely the segments between moved vertices follow the correction."""

    tolerance_px: float = 0.05
    """Largest distance of a moved segment from the correction, px; half the error of a good registration."""
    sample_px: float = 16.0
    """Spacing at which a segment is compared, px; corrections vary over windows of 61 px and more."""
    straight_px: float = 4.0
    """Length up to which a segment stays straight, px: to bend it by the tolerance would take a fold."""
    most_rounds: int = 3
    """Rounds of insertion; each divides segments by what the deviation before asks for."""
    most_parts: int = 64
    """Parts into which one segment is divided at most in a round, and places at which it is compared."""


def densify(
    vertices: Float64,
    place_px: Float64,
    starts: Index,
    forward: Callable[[Float64], Float64],
    parameters: DensifyingParameters | None = None,
) -> tuple[Float64, Index]:
    """Insert vertices on the segments of lines that a correction bends.

    Parameters
    ----------
    vertices : (n, d) array of float
        Vertices of all lines, one line after another, in any units.
    place_px : (n, 2) array of float
        Where they lie in the image that is corrected (col, row), px.
    starts : (m + 1,) array of int
        Where each line begins among the vertices, and n.
    forward : callable
        The correction, which moves (k, 2) positions (col, row), px. Its inverse bends lines alike.
    parameters : DensifyingParameters, optional
        Tolerance and spacing.

    Returns
    -------
    (p, d) array of float, (m + 1,) array of int
        Vertices with those inserted between them, and where each line begins among them.
    """
    parameters = parameters or DensifyingParameters()
    both = np.column_stack([vertices, place_px])
    unchecked = np.ones(max(len(both) - 1, 0), dtype=bool)
    for _ in range(parameters.most_rounds):
        inner = starts[(starts > 0) & (starts < len(both))]
        unchecked[inner - 1] = False  # from the end of a line to the start of the next one
        parts = np.ones(len(unchecked), dtype=np.intp)
        parts[unchecked] = _parts(both[:, -2:], np.flatnonzero(unchecked), forward, parameters)
        if (parts == 1).all():
            break
        place = np.concatenate([[0], np.cumsum(parts)])
        first = np.repeat(np.arange(len(parts)), parts)
        share = ((np.arange(len(first)) - place[first]) / parts[first])[:, None]
        inserted = both[first] + share * (both[first + 1] - both[first])
        starts = np.append(place, place[-1] + 1)[starts]
        both = np.concatenate([inserted, both[-1:]])
        unchecked = parts[first] > 1
    return both[:, :-2], starts


def _parts(
    place_px: Float64,
    segments: Index,
    forward: Callable[[Float64], Float64],
    parameters: DensifyingParameters,
) -> Index:
    """Return the number of parts that each of the segments, by number of its first vertex, needs."""
    parts = np.ones(len(segments), dtype=np.intp)
    along = place_px[segments + 1] - place_px[segments]
    length_px = np.linalg.norm(along, axis=1)
    long = np.flatnonzero(length_px > parameters.straight_px)
    if len(long) == 0:
        return parts
    first, along = place_px[segments[long]], along[long]
    counts = np.clip(np.ceil(length_px[long] / parameters.sample_px), 4, parameters.most_parts) - 1
    counts = counts.astype(np.intp)
    segment = np.repeat(np.arange(len(long)), counts)
    number = np.arange(len(segment)) - (np.cumsum(counts) - counts)[segment]
    share = ((number + 1) / (counts[segment] + 1))[:, None]
    moved_first, moved_last = forward(first), forward(first + along)
    chord = moved_first[segment] + share * (moved_last - moved_first)[segment]
    distance_px = np.linalg.norm(forward(first[segment] + share * along[segment]) - chord, axis=1)
    deviation_px = np.zeros(len(long))
    np.maximum.at(deviation_px, segment, distance_px)
    # the deviation of a curve from its chord falls with the square of the number of chords
    divided = np.ceil(np.sqrt(deviation_px / parameters.tolerance_px))
    parts[long] = np.clip(divided, 1, parameters.most_parts).astype(np.intp)
    return parts
