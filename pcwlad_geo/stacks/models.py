"""The models that the images of a stack get: homographies, and the simplest that predicts as well as any."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from pcwlad_geo.correction.models import PolynomialBasis, ProjectiveCorrection
from pcwlad_geo.correction.selection import MIN_GAIN_PX, RESAMPLING_SIGNIFICANCE
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching.epipolar import MIN_EPIPOLAR_MATCHES, EpipolarGeometry, largest_distance_px, plane_of
from pcwlad_geo.stacks.adjustment import Adjustment, adjust
from pcwlad_geo.stacks.network import (
    BLOCKS,
    MODELS,
    ROUGHNESS,
    SPLINE,
    Basis,
    Edge,
    Fold,
    HomographyBasis,
    Network,
    Part,
    SplineBasis,
    basis_over,
    components,
    errors_of,
    folds_of,
    linked,
    named,
    part_of,
    penalty_of,
    side_of_blocks,
    terms_of,
)
from pcwlad_geo.types import Bool, Float64

ROUNDS: Final = 8
"""Largest number of Gauss-Newton steps."""
STILL_PX: Final = 1e-4
"""They end where no corner of a frame moves by more."""
LEAST: Final = 6
"""Least number of tie points of a homography."""
HOMOGRAPHY: Final = "projective"
"""Name of the model."""
FLEXIBLE: Final = 2**0.5
"""Where a more flexible model was chosen, less than this share of what that leaves."""
BETTER: Final = 0.9
"""Homographies are taken where they leave less than this share of what affines leave between the frames."""


@dataclass(frozen=True, eq=False)
class FrameAdjustment(Adjustment):
    """Homographies of all frames in the pixels of one, and their covariance.

    What it inherits is of the frames as these homographies rectify them, and zero but for their covariance.
    """

    matrices: Float64 = field(default_factory=lambda: np.zeros((0, 3, 3)))
    """(images, 3, 3): px of the reference (col, row, 1) to those of each frame."""

    def displacement(self, image: int, xy: Float64) -> Float64:
        """Return by how much a frame sees the (n, 2) px `xy` of the reference beside these, (n, 2)."""
        return self.correction(image).forward(xy) - xy

    def to_ground(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) px of the reference that are seen at the (n, 2) px `xy` of a frame."""
        return self.correction(image).inverse(xy)

    def covariance(self, image: int, xy: Float64, other: int | None = None) -> Float64:
        """Return the (n, 2, 2) covariance of a frame's displacement at (n, 2) px `xy` of the reference, px².

        With `other`, that of the difference of the two frames' places in the reference.
        """
        covariance = super().covariance(image, xy, other)
        if other is not None:
            return covariance
        rate = _rate(self.matrices[image], xy)
        return rate @ covariance @ rate.transpose(0, 2, 1)

    def correction(self, image: int) -> ProjectiveCorrection:
        """Return the correction of a frame."""
        return ProjectiveCorrection(HOMOGRAPHY, self.matrices[image])


def on_epipolar_lines(edge: Edge) -> Edge | None:
    """Return a pair without the points that no depth explains; None if no geometry is found or few agree."""
    geometry = EpipolarGeometry.of(edge.first_xy, edge.second_xy)
    if geometry is None:
        return None
    off = np.abs(geometry.distance_px(edge.first_xy, edge.second_xy))
    good: Bool = off <= largest_distance_px(off)
    if good.mean() < 0.5:
        return None
    return replace(
        edge, first_xy=edge.first_xy[good], second_xy=edge.second_xy[good], covariance=edge.covariance[good]
    )


def or_homographies(
    found: Adjustment, edges: Sequence[Edge], images: int, *, datum: int | None = 0, split: bool = False
) -> Adjustment:
    """Return homographies of all frames where another adjustment leaves more, else that.

    Beside a model that is more flexible they are the image of flat ground, and are taken unless they leave
    more than twice its squares. Parameters and errors are those of `homographies`.
    """
    if min(len(edge) for edge in edges) < MIN_EPIPOLAR_MATCHES:
        return found
    try:
        projective = homographies(edges, images, datum=datum, split=split)
    except InputError:
        return found
    flexible = terms_of(found.basis) > terms_of(basis_over([edge.first_xy for edge in edges], "affine"))
    left = [
        float(np.median([math.hypot(fit.scatter, *fit.offset) for fit in each.edges if fit.used]))
        for each in (found, projective)
    ]
    return projective if left[1] < (FLEXIBLE if flexible else BETTER) * left[0] else found


def homographies(
    edges: Sequence[Edge], images: int, *, datum: int | None = 0, split: bool = False
) -> FrameAdjustment:
    """Estimate the homographies of all frames from the tie points of their pairs.

    The tie points are in the pixels of the frames; those that leave their epipolar lines have no part. Other
    parameters are those of `adjust`. Raises `InputError` as that does, or if no homography fits the points of
    the pairs of a frame.
    """
    edges = [on_epipolar_lines(edge) or edge for edge in edges]
    matrices = _chained(edges, images, datum or 0)
    for _ in range(ROUNDS):
        rectified = [_rectified(edge, matrices) for edge in edges]
        basis = _basis(rectified)
        found = adjust(rectified, images, datum=datum, split=split, basis=HomographyBasis(basis))
        corners = np.array([basis.centre_px, basis.low_px, basis.high_px])
        steps = [found.displacement(image, corners) for image in range(images)]
        matrices = np.stack(
            [
                matrix @ _homography(basis, coefficients)
                for matrix, coefficients in zip(matrices, found.coefficients, strict=True)
            ]
        )
        if max(float(np.abs(step).max()) for step in steps) < STILL_PX:
            break
    values = {name: getattr(found, name) for name in Adjustment.__dataclass_fields__}
    return FrameAdjustment(**values, matrices=matrices)


def _homography(basis: PolynomialBasis, coefficients: Float64) -> Float64:
    """Return the (3, 3) homography that displaces as the (6, 2) `coefficients` say, to first order."""
    (a, d), (b, e), (c, f) = (coefficients[:3] / basis.radius_px).tolist()
    g, h = float(coefficients[3, 0]) / basis.radius_px, float(coefficients[5, 1]) / basis.radius_px
    inner = np.array([[1 + b, c, a], [e, 1 + f, d], [-g, -h, 1.0]])
    x, y = basis.centre_px
    unit = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, basis.radius_px]]) / basis.radius_px
    found = inverse(unit) @ inner @ unit
    return np.asarray(found / found[2, 2])


def _basis(edges: Sequence[Edge]) -> PolynomialBasis:
    found = basis_over([edge.first_xy for edge in edges], "polynomial2")
    if not isinstance(found, PolynomialBasis):
        raise TypeError(f"{found!r} is no polynomial")
    return found


def _chained(edges: Sequence[Edge], images: int, first: int) -> Float64:
    """Return (images, 3, 3) homographies along the pairs of most points from the first of each group."""
    pairwise = [plane_of(edge.first_xy, edge.second_xy) if len(edge) >= LEAST else None for edge in edges]
    matrices = np.tile(np.eye(3), (images, 1, 1))
    known: set[int] = set()
    by_points = sorted(range(len(edges)), key=lambda number: -len(edges[number]))
    _, group = components(edges, images, np.ones(len(edges), bool))
    firsts = [int(np.flatnonzero(group == each)[0]) for each in range(int(group.max()) + 1)]
    for start in [first, *(each for each in firsts if group[each] != group[first])]:
        if start in known:
            continue
        known.add(start)
        waiting = deque([start])
        while waiting:
            here = waiting.popleft()
            for number in by_points:
                edge, step = edges[number], pairwise[number]
                if step is None:
                    continue
                ways = ((edge.first, edge.second, step), (edge.second, edge.first, inverse(step)))
                for one, other, way in ways:
                    if one == here and other not in known:
                        matrices[other] = way @ matrices[here]
                        known.add(other)
                        waiting.append(other)
    lost = {image for edge in edges for image in (edge.first, edge.second)} - known
    if lost:
        raise InputError(f"no homography fits the tie points of {len(lost)} frames: choose another model")
    return matrices / matrices[:, 2:, 2:]


def _rectified(edge: Edge, matrices: Float64) -> Edge:
    """Return the points of a pair in px of the reference, as the homographies so far place them.

    Raises `InputError` if one is beyond the horizon.
    """
    first, second = (ProjectiveCorrection(HOMOGRAPHY, matrices[image]) for image in (edge.first, edge.second))
    first_xy, second_xy = first.inverse(edge.first_xy), second.inverse(edge.second_xy)
    if not (np.isfinite(first_xy).all() and np.isfinite(second_xy).all()):
        raise InputError("no homography fits the tie points of all frames: choose another model")
    rate = _rate(inverse(second.matrix), edge.second_xy)
    covariance = np.asarray(rate @ edge.covariance @ rate.transpose(0, 2, 1))
    return replace(edge, first_xy=first_xy, second_xy=second_xy, covariance=covariance)


def _rate(matrix: Float64, xy: Float64) -> Float64:
    """Return the (n, 2, 2) derivatives of a homography at (n, 2) positions."""
    moved = np.column_stack([xy, np.ones(len(xy))]) @ matrix.T
    place = moved[:, :2] / moved[:, 2:]
    rate = matrix[None, :2, :2] - place[:, :, None] * matrix[None, 2:, :2]
    return rate / moved[:, 2:, None]


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
    edges: Sequence[Edge], images: int, model: str, *, datum: int | None = 0, split: bool = False
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
        start = adjust(edges, len(known), datum=datum, split=split)
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
