"""Which model the images of a stack get: the simplest that predicts left-out ground as well as any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.sparse.linalg import splu

from pcwlad_geo.stacks.adjustment import Adjustment, adjust, sigma_of
from pcwlad_geo.stacks.basis import MODELS, ROUGHNESS, SPLINE, Basis, basis_over, penalty_of, terms_of
from pcwlad_geo.stacks.network import (
    BLOCKS,
    Edge,
    Network,
    Part,
    blocks_of,
    left_over,
    linked,
    part_of,
    side_of_blocks,
)
from pcwlad_geo.types import Bool, Float64

TRIED: Final[Mapping[str, tuple[str, ...]]] = {
    "auto": MODELS,
    "shift": ("shift",),
    "affine": ("affine",),
    "polynomial": ("polynomial2", "polynomial3"),
    "tps": (SPLINE,),
}
"""Models of an image that are tried for each that can be asked for."""
MANY: Final = 40
"""Of more images so many of those nearest to the datum, in pairs, decide."""
CAP: Final = 3.0
"""A left-out point counts at most as one that lies off by so many scatters of its pair."""
BELIEVED: Final = 2.0
"""A more flexible model must predict better by so many standard errors of the difference."""


def choose_basis(
    edges: Sequence[Edge], images: int, model: str, *, datum: int | None = 0, apart: bool = False
) -> Basis:
    """Return the functions of place of the model that predicts left-out ground best.

    Cells of the ground are left out in turn, in all pairs at once; the tie points in them are held against
    the adjustment of the others. A simpler model stays unless a more flexible one is better by more than
    chance, cell by cell.

    Parameters
    ----------
    edges : sequence of Edge
    images : int
        Number of images.
    model : str
        A key of `TRIED`.
    datum, apart
        As `adjust` takes them.
    """
    places = [edge.first_xy for edge in edges]
    tried = [
        basis_over(places, name, roughness)
        for name in TRIED[model]
        for roughness in (ROUGHNESS if name == SPLINE else ROUGHNESS[:1])
    ]
    if len(tried) == 1:
        return tried[0]
    edges, images, datum = _nearest(edges, images, datum)
    start = adjust(edges, images, datum=datum, apart=apart)
    errors = [_errors(edges, start, basis) for basis in tried]
    chosen = 0
    for number in range(1, len(tried)):
        gain = errors[chosen] - errors[number]
        if gain.mean() > BELIEVED * gain.std(ddof=1) / np.sqrt(len(gain)):
            chosen = number
    return tried[chosen]


def _nearest(edges: Sequence[Edge], images: int, datum: int | None) -> tuple[Sequence[Edge], int, int | None]:
    """Return the pairs of the images nearest to the datum, renumbered, if there are many images."""
    if images <= MANY:
        return edges, images, datum
    known = [datum or 0]
    for image in known:
        for edge in edges:
            if image in (edge.first, edge.second) and len(known) < MANY:
                other = edge.first + edge.second - image
                known += [] if other in known else [other]
    number = {image: index for index, image in enumerate(known)}
    kept = [
        replace(edge, first=number[edge.first], second=number[edge.second])
        for edge in edges
        if edge.first in number and edge.second in number
    ]
    return kept, len(known), None if datum is None else 0


def _errors(edges: Sequence[Edge], start: Adjustment, basis: Basis) -> Float64:
    """Return, for each turn, the mean square of what left-out points lie off, in scatters of their pairs."""
    images, side = len(start.coefficients), side_of_blocks(edges)
    network = Network(images, terms_of(basis), start.fixed, penalty_of(basis))
    used = np.array([fit.used for fit in start.edges])
    edges, coefficients = linked(edges), np.zeros((images, network.terms, 2))
    for _ in range(2):  # at the ground that the displacements so far tell
        parts = [part_of(edge, basis, coefficients, side) for edge in edges]
        sigma = sigma_of(start, parts)
        coefficients = _solved(network, parts, used, sigma)
    blocks = [
        dict(blocks_of(edge, basis, coefficients, side / 2, part)) if good else {}
        for edge, part, good in zip(edges, parts, used, strict=True)
    ]
    found = []
    for number in range(BLOCKS**2):
        kept = [of_edge.get(number, part) for part, of_edge in zip(parts, blocks, strict=True)]
        without = _solved(network, kept, used, sigma)
        total = count = 0.0
        for edge, part, less, shared in zip(edges, parts, kept, sigma, strict=True):
            if less is part:  # nothing of it was left out
                continue
            off = left_over(edge, basis, coefficients, without, side / 2, number, less, float(shared))
            total += float(np.minimum((off / part.scatter) ** 2, CAP**2).sum())
            count += off.size
        if count:
            found.append(total / count)
    return np.array(found)


def _solved(network: Network, parts: Sequence[Part], used: Bool, sigma: Float64) -> Float64:
    normal, right = network.equations(parts, used, sigma)
    return network.unpacked(splu(normal).solve(right))
