"""Which model the images of a stack get: the simplest that predicts left-out ground as well as any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.correction.models import PolynomialBasis
from pcwlad_geo.correction.selection import MIN_GAIN_PX, RESAMPLING_SIGNIFICANCE
from pcwlad_geo.stacks.adjustment import Adjustment, adjust
from pcwlad_geo.stacks.basis import (
    MODELS,
    ROUGHNESS,
    SPLINE,
    Basis,
    SplineBasis,
    basis_over,
    penalty_of,
    terms_of,
)
from pcwlad_geo.stacks.network import (
    BLOCKS,
    Edge,
    Fold,
    Network,
    Part,
    errors_of,
    folds_of,
    linked,
    named,
    part_of,
    side_of_blocks,
)
from pcwlad_geo.types import Float64

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
"""An affine must predict better than a shift by so many standard errors of the difference."""


def choose_basis(
    edges: Sequence[Edge], images: int, model: str, *, datum: int | None = 0, apart: bool = False
) -> Basis:
    """Return the functions of place of the model that predicts left-out ground best.

    Cells of the ground are left out in turn, in all pairs at once; the tie points in them are held against
    the adjustment of the others. A simpler model stays unless a more flexible one is better by more than
    chance, cell by cell. The `model` is a key of `TRIED`; the rest is as `adjust` takes it.
    """
    places = [edge.first_xy for edge in edges]
    tried = [
        basis_over(places, name, roughness)
        for name in TRIED[model]
        for roughness in (ROUGHNESS if name == SPLINE else ROUGHNESS[:1])
    ]
    least = min(map(len, edges), default=0)  # control points may be few
    tried = [basis for basis in tried if isinstance(basis, SplineBasis) or terms_of(basis) < least] or tried[
        :1
    ]
    if len(tried) == 1:
        return tried[0]
    edges, known, datum = _nearest(edges, images, datum)
    with named(known):
        start = adjust(edges, len(known), datum=datum, apart=apart)
        edges = [edge for edge, fit in zip(linked(edges), start.edges, strict=True) if fit.used]
        trials: list[_Trial] = []
        for basis in tried:
            same = bool(trials) and all(isinstance(each, SplineBasis) for each in (basis, trials[-1].basis))
            trials.append(replace(trials[-1], basis=basis) if same else _trial(edges, start, basis))
        # what points scatter, and pairs share, is held against all models alike: as by the best of them
        scatter = np.min([[part.scatter for part in trial.parts] for trial in trials], axis=0)
        shared = np.min([trial.shared for trial in trials], axis=0)
        errors = [_errors(trial, start, scatter, shared) for trial in trials]
    typical, chosen = float(np.median(scatter)), 0
    for number in range(1, len(tried)):
        gain = errors[chosen] - errors[number]
        gain = gain[np.isfinite(gain)]
        if len(gain) > 1 and _is_better(gain, lossless(tried[chosen]), lossless(tried[number]), typical):
            chosen = number
    return tried[chosen]


def lossless(basis: Basis) -> bool:
    """Return whether images of a model keep their pixels, with a corrected geotransform."""
    return isinstance(basis, PolynomialBasis) and basis.order <= 1


def _is_better(gain: Float64, before: bool, after: bool, scatter: float) -> bool:
    """Return whether a more flexible model predicts better, by the (turns,) gain in squared scatters.

    `before` and `after` tell which of the two are lossless. As for a pair: what matches of two sensors share
    looks like detail, so that a model that needs resampling must gain more than that, and between such
    models simplicity is worth nothing.
    """
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    if not before:
        return bool(gain.mean() > 0)
    if after:
        return bool(gain.mean() > BELIEVED * error)
    enough = scatter * np.sqrt(max(gain.mean(), 0.0)) >= MIN_GAIN_PX
    return bool(enough and gain.mean() > RESAMPLING_SIGNIFICANCE * error)


def _nearest(
    edges: Sequence[Edge], images: int, datum: int | None
) -> tuple[Sequence[Edge], Sequence[int], int | None]:
    """Return the pairs of the images nearest to the datum, numbered anew if there are many, and these."""
    if images <= MANY:
        return edges, range(images), datum
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
    return kept, known, None if datum is None else 0


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A model, and what the pairs tell by it, which is the same for splines of any roughness."""

    basis: Basis
    parts: list[Part]
    folds: list[list[Fold]]
    """Of each pair."""
    shared: Float64
    """(edges,) standard deviations of what the points of each share, map units."""


def _trial(edges: Sequence[Edge], start: Adjustment, basis: Basis) -> _Trial:
    """Sum up the pairs by a model, at the ground that another tells."""
    side = side_of_blocks(edges)
    network = _network(start, basis)
    coefficients = np.zeros((network.images, network.terms, 2))
    for _ in range(2):  # at the ground that the displacements so far tell
        parts = [part_of(edge, basis, coefficients, side) for edge in edges]
        shared = errors_of(parts)
        coefficients = network.coefficients(parts, np.ones(len(parts), bool), shared)
    folds = [
        folds_of(edge, basis, coefficients, side / 2, part) for edge, part in zip(edges, parts, strict=True)
    ]
    return _Trial(basis, parts, folds, shared)


def _network(start: Adjustment, basis: Basis) -> Network:
    return Network(len(start.coefficients), terms_of(basis), start.fixed, penalty_of(basis))


def _errors(trial: _Trial, start: Adjustment, scatter: Float64, shared: Float64) -> Float64:
    """Return, for each turn, the mean square of what left-out points lie off, in scatters of their pairs.

    NaN for turns in which none are left out.
    `scatter` and `shared`, (edges,) standard deviations, are of the points and of what those of a pair share.
    """
    network, found = _network(start, trial.basis), np.full(BLOCKS**2, np.nan)
    for number in range(BLOCKS**2):
        left_out = [next((fold for fold in folds if fold.number == number), None) for folds in trial.folds]
        kept = [fold.kept if fold else part for part, fold in zip(trial.parts, left_out, strict=True)]
        without = network.coefficients(kept, np.ones(len(kept), bool), shared)
        total = count = 0.0
        for part, fold, unit in zip(trial.parts, left_out, scatter, strict=True):
            if fold is None or fold.kept is part:  # nothing of it was left out
                continue
            off = fold.observed - fold.values @ (without[part.second] - without[part.first])
            total += float(np.minimum((off / unit) ** 2, CAP**2).sum())
            count += off.size
        if count:
            found[number] = total / count
    return found
