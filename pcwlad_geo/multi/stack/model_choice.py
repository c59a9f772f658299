"""The model of the images of a stack, chosen by the ground that is left out (cross-validation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.correction.fit import of_option
from pcwlad_geo.correction.selection_parameters import SELECTION
from pcwlad_geo.estimation.comparison import is_significant, simplest_unbeaten
from pcwlad_geo.multi.stack.adjustment import Adjustment, adjust, network_of
from pcwlad_geo.multi.stack.bases import (
    IMAGE_MODELS,
    SPLINE,
    Basis,
    SplineBasis,
    basis_over,
    lossless,
    terms_of,
)
from pcwlad_geo.multi.stack.edges import Edge, linked
from pcwlad_geo.multi.stack.equations import (
    EdgeEquations,
    Fold,
    GroundBlocks,
    edge_equations,
    errors_of,
    folds_of,
)
from pcwlad_geo.multi.stack.network import named
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT, SPLINES, AdjustmentParameters, SplineParameters
from pcwlad_geo.types import Float64

CANDIDATE_MODELS: Final = {
    "auto": IMAGE_MODELS,
    **{name: of_option(name) for name in ("shift", "affine", "polynomial", SPLINE)},
}
"""Models of an image that are tried, by the option that the user gives."""


def choose_basis(
    edges: Sequence[Edge],
    images: int,
    model: str,
    *,
    datum: int | None = 0,
    split: bool = False,
    parameters: AdjustmentParameters = ADJUSTMENT,
    splines: SplineParameters = SPLINES,
) -> Basis:
    """Return the basis of the model that predicts left-out ground best (cross-validation).

    Blocks of the ground are left out in turn, in all pairs at once; the tie points in them are compared with
    the adjustment of the others. A simpler model is kept unless a more flexible one is significantly better.
    The `model` is a key of `CANDIDATE_MODELS`; the other parameters are those of `adjust`.
    """
    places = [edge.first_xy for edge in edges]
    bases = [
        basis_over(places, name, roughness, splines)
        for name in CANDIDATE_MODELS[model]
        for roughness in (splines.roughness if name == SPLINE else splines.roughness[:1])
    ]
    least = min(map(len, edges), default=0)  # control points may be few
    determined = [
        basis_tried
        for basis_tried in bases
        if isinstance(basis_tried, SplineBasis) or terms_of(basis_tried) < least
    ]
    bases = determined or bases[:1]
    if len(bases) == 1:
        return bases[0]
    edges, members, datum = _nearest(edges, images, datum, parameters.max_images_to_choose)
    with named(members):
        start = adjust(edges, len(members), datum=datum, split=split, parameters=parameters)
        edges = [
            edge
            for edge, fit in zip(linked(edges, parameters.feature_px), start.edges, strict=True)
            if fit.in_use
        ]
        trials: list[_ModelTrial] = []
        for basis in bases:
            same = bool(trials) and all(
                isinstance(basis_tried, SplineBasis) for basis_tried in (basis, trials[-1].basis)
            )
            trials.append(replace(trials[-1], basis=basis) if same else _trial(edges, start, basis))
        # all models are compared with the same weights: the smallest scatters and shared errors of all
        scatter = np.min([[part.scatter for part in trial.parts] for trial in trials], axis=0)
        shared = np.min([trial.shared for trial in trials], axis=0)
        errors = [_errors(trial, start, scatter, shared) for trial in trials]
    typical = float(np.median(scatter))

    def beats(number: int, simpler: int) -> bool:
        gain = errors[simpler] - errors[number]
        gain = gain[np.isfinite(gain)]
        both = lossless(bases[simpler]), lossless(bases[number])
        return len(gain) > 1 and _is_better(gain, *both, typical)

    return bases[simplest_unbeaten(range(len(bases)), beats)]


def _is_better(gain: Float64, lossless_before: bool, lossless_after: bool, scatter: float) -> bool:
    """Return whether a more flexible model predicts better, by the (blocks,) gain in squared scatters.

    As for a pair, common errors of the matches of two sensors look like local displacements: a model that
    needs resampling must gain more than these where the other one is lossless, and between two models that
    need resampling the better one is chosen, however small its gain.
    """
    if not lossless_before:
        return is_significant(gain, SELECTION.dense_significance)
    if lossless_after:
        return is_significant(gain, 2.0)
    enough = scatter * np.sqrt(max(gain.mean(), 0.0)) >= SELECTION.min_gain_px
    return bool(enough) and is_significant(gain, SELECTION.resampling_significance)


def _nearest(
    edges: Sequence[Edge], images: int, datum: int | None, most: int
) -> tuple[Sequence[Edge], Sequence[int], int | None]:
    """Return the pairs of the images nearest to the datum, these images, and the number of the datum.

    The images are numbered anew if there are more than `most`.
    """
    if images <= most:
        return edges, range(images), datum
    members = [datum or 0]
    for image in members:
        for edge in edges:
            if image in (edge.first, edge.second) and len(members) < most:
                other = edge.first + edge.second - image
                members += [other] if other not in members else []
    number = {image: index for index, image in enumerate(members)}
    their_edges = [
        replace(edge, first=number[edge.first], second=number[edge.second])
        for edge in edges
        if edge.first in number and edge.second in number
    ]
    return their_edges, members, None if datum is None else 0


@dataclass(frozen=True, slots=True, eq=False)
class _ModelTrial:
    """A model, and the equations of the pairs by it, which are the same for splines of any roughness."""

    basis: Basis
    parts: list[EdgeEquations]
    folds: list[dict[int, Fold]]
    """Left-out blocks of each pair, by their number."""
    shared: Float64
    """(edges,) standard deviations of the error that the points of each share, map units."""


def _trial(edges: Sequence[Edge], start: Adjustment, basis: Basis) -> _ModelTrial:
    """Return the equations of the pairs by a model, with the datum of the adjustment `start`."""
    blocks = GroundBlocks.of(edges, start.parameters.blocks)
    network = network_of(len(start.coefficients), basis, start.fixed, start.parameters)
    coefficients = np.zeros((network.images, network.terms, 2))
    for _ in range(2):  # the ground of the points depends on the displacements
        parts = [edge_equations(edge, basis, coefficients, blocks) for edge in edges]
        shared = errors_of(parts)
        coefficients = network.coefficients(parts, np.ones(len(parts), bool), shared)
    folds = [
        {fold.number: fold for fold in folds_of(edge, basis, coefficients, blocks.halved, part)}
        for edge, part in zip(edges, parts, strict=True)
    ]
    return _ModelTrial(basis, parts, folds, shared)


def _errors(trial: _ModelTrial, start: Adjustment, scatter: Float64, shared: Float64) -> Float64:
    """Return the mean squared residual of the points of each left-out block, in scatters of their pairs.

    It is NaN for blocks without points. `scatter` and `shared` are the (edges,) standard deviations of the
    points and of the error that those of a pair share.
    """
    network = network_of(len(start.coefficients), trial.basis, start.fixed, start.parameters)
    errors = np.full(start.parameters.blocks**2, np.nan)
    for number in range(len(errors)):
        left_out = [folds.get(number) for folds in trial.folds]
        folds = zip(trial.parts, left_out, strict=True)
        remaining = [fold.remaining if fold else part for part, fold in folds]
        without = network.coefficients(remaining, np.ones(len(remaining), bool), shared)
        total = count = 0.0
        for part, fold, unit in zip(trial.parts, left_out, scatter, strict=True):
            if fold is None or fold.remaining is part:  # nothing of it was left out
                continue
            residual = fold.observed - fold.values @ (without[part.second] - without[part.first])
            total += float(np.minimum((residual / unit) ** 2, 3.0**2).sum())
            count += residual.size
        if count:
            errors[number] = total / count
    return errors
