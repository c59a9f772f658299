"""Frames of one camera without georeferencing: a homography a frame, all estimated together.

A frame sees the plane that most of the ground is through a homography of the reference's pixels. Points of
each pair that leave their epipolar lines are wrong whatever their depth, and have no part; those off the
plane are right, and lose weight. The homographies are found by Gauss-Newton steps: what is left between the
frames as rectified so far is the infinitesimal homography, a polynomial of order 2 of eight parameters.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from pcwlad_geo.correction.models import PolynomialBasis, ProjectiveCorrection
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import SIGMA_OF_MEDIAN
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching.epipolar import MIN_POINTS, EpipolarGeometry, plane_of
from pcwlad_geo.stacks.adjustment import Adjustment, adjust
from pcwlad_geo.stacks.basis import HomographyBasis, basis_over, terms_of
from pcwlad_geo.stacks.network import Edge, components
from pcwlad_geo.types import Bool, Float64

ROUNDS: Final = 8
"""Largest number of Gauss-Newton steps."""
STILL_PX: Final = 1e-4
"""They end where no corner of a frame moves by more."""
TOLERANCE_PX: Final = 1.0
"""Largest distance of a tie point from its epipolar line."""
LEAST_TOLERANCE_PX: Final = 0.25
"""Least limit of that distance."""
SCATTERS: Final = 5.0
"""That limit, in robust scatters of the points about their lines."""
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
        return np.asarray(self.correction(image).forward(xy) - xy)

    def to_ground(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) px of the reference that are seen at the (n, 2) px `xy` of a frame."""
        return self.correction(image).inverse(xy)

    def covariance(self, image: int, xy: Float64, other: int | None = None) -> Float64:
        """Return the (n, 2, 2) covariance of a frame's displacement at (n, 2) px `xy` of the reference, px².

        With `other`, that of the difference of the two frames' places in the reference.
        """
        told = super().covariance(image, xy, other)
        if other is not None:
            return told
        rate = _rate(self.matrices[image], xy)
        return np.asarray(rate @ told @ rate.transpose(0, 2, 1))

    def correction(self, image: int) -> ProjectiveCorrection:
        """Return the correction of a frame."""
        return ProjectiveCorrection(HOMOGRAPHY, self.matrices[image])


def on_epipolar_lines(edge: Edge) -> Edge | None:
    """Return a pair without the points that no depth explains; None if no geometry is found or few agree."""
    geometry = EpipolarGeometry.of(edge.first_xy, edge.second_xy)
    if geometry is None:
        return None
    off = np.abs(geometry.distance_px(edge.first_xy, edge.second_xy))
    limit = np.clip(SCATTERS * SIGMA_OF_MEDIAN * float(np.median(off)), LEAST_TOLERANCE_PX, TOLERANCE_PX)
    good: Bool = off <= limit
    if good.mean() < 0.5:
        return None
    return replace(
        edge, first_xy=edge.first_xy[good], second_xy=edge.second_xy[good], covariance=edge.covariance[good]
    )


def or_homographies(
    found: Adjustment, edges: Sequence[Edge], images: int, *, datum: int | None = 0, apart: bool = False
) -> Adjustment:
    """Return homographies of all frames where another adjustment leaves more, else that.

    Beside a model that is more flexible they are the image of flat ground, and are taken unless they leave
    more than twice its squares. Parameters and errors are those of `homographies`.
    """
    if min(len(edge) for edge in edges) < MIN_POINTS:
        return found
    try:
        projective = homographies(edges, images, datum=datum, apart=apart)
    except InputError:
        return found
    flexible = terms_of(found.basis) > terms_of(basis_over([edge.first_xy for edge in edges], "affine"))
    left = [
        float(np.median([math.hypot(fit.scatter, *fit.offset) for fit in each.edges if fit.used]))
        for each in (found, projective)
    ]
    return projective if left[1] < (FLEXIBLE if flexible else BETTER) * left[0] else found


def homographies(
    edges: Sequence[Edge], images: int, *, datum: int | None = 0, apart: bool = False
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
        found = adjust(rectified, images, datum=datum, apart=apart, basis=HomographyBasis(basis))
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
    return np.asarray(matrices / matrices[:, 2:, 2:])


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
    return np.asarray(rate / moved[:, 2:, None])
