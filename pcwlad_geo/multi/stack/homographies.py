"""Homographies of frames without georeferencing, all adjusted together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from pcwlad_geo.correction.models import ProjectiveCorrection
from pcwlad_geo.correction.polynomials import PolynomialBasis
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import components, inverse
from pcwlad_geo.matching.epipolar import EPIPOLAR, EpipolarGeometry, largest_distance_px, plane_of
from pcwlad_geo.multi.stack.adjustment import Adjustment, adjust, datums_of
from pcwlad_geo.multi.stack.bases import HomographyBasis, lossless, polynomial_over
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.equations import ends_of
from pcwlad_geo.multi.stack.parameters import HOMOGRAPHIES, HomographyParameters
from pcwlad_geo.types import Bool, Float64

HOMOGRAPHY: Final = "projective"
"""Name of the model."""
NO_HOMOGRAPHY: Final = "no homography fits the tie points of all frames: choose another model"
"""Message where tie points or ground lie beyond the horizon of a frame."""


@dataclass(frozen=True, eq=False)
class FrameAdjustment(Adjustment):
    """Homographies of all frames in the pixels of one, and their covariance.

    The inherited fields are those of the frames rectified by the homographies, whose displacements are zero.
    """

    matrices: Float64
    """(images, 3, 3): px of the reference (col, row, 1) to those of each frame."""

    def displacement(self, image: int, xy: Float64) -> Float64:
        """Return the (n, 2) displacements of a frame at the (n, 2) px `xy` of the reference."""
        return self.correction(image).forward(xy) - xy

    def to_ground(self, image: int, xy: Float64) -> Float64:
        """Map the (n, 2) px `xy` of a frame to the (n, 2) px of the reference."""
        return self.correction(image).inverse(xy)

    def covariance(self, image: int, xy: Float64, other: int | None = None) -> Float64:
        """Return the (n, 2, 2) covariance of a frame's displacement at (n, 2) px `xy` of the reference, px².

        With `other`, that of the difference of the two frames' places in the reference.
        """
        covariance = super().covariance(image, xy, other)
        if other is not None:
            return covariance
        jacobian = _jacobian(self.matrices[image], xy)
        return jacobian @ covariance @ jacobian.transpose(0, 2, 1)

    def correction(self, image: int) -> ProjectiveCorrection:
        """Return the correction of a frame."""
        return ProjectiveCorrection(HOMOGRAPHY, self.matrices[image])


def on_epipolar_lines(edge: Edge, parameters: HomographyParameters = HOMOGRAPHIES) -> Edge | None:
    """Return a pair without points off their epipolar lines; None if no geometry is found or few fit it."""
    geometry = EpipolarGeometry.of(edge.first_xy, edge.second_xy)
    if geometry is None:
        return None
    off = np.abs(geometry.distance_px(edge.first_xy, edge.second_xy))
    good: Bool = off <= largest_distance_px(off)
    if good.mean() < parameters.min_epipolar_share:
        return None
    return replace(
        edge, first_xy=edge.first_xy[good], second_xy=edge.second_xy[good], covariance=edge.covariance[good]
    )


def or_homographies(
    adjusted: Adjustment,
    edges: Sequence[Edge],
    images: int,
    *,
    datum: int | None = 0,
    split: bool = False,
    parameters: HomographyParameters = HOMOGRAPHIES,
) -> Adjustment:
    """Return homographies of all frames where the tie points fit them better than an adjustment, else that.

    Against a model that is more flexible than an affine they are preferred, as flat ground is mapped by
    homographies (`flexible_ratio`). Parameters and errors are those of `homographies`.
    """
    if min(len(edge) for edge in edges) < EPIPOLAR.least_matches:
        return adjusted
    try:
        projective = homographies(edges, images, datum=datum, split=split, parameters=parameters)
    except InputError:
        return adjusted
    before, after = (
        float(np.median([math.hypot(fit.scatter, *fit.offset) for fit in adjustment.edges if fit.in_use]))
        for adjustment in (adjusted, projective)
    )
    ratio = parameters.max_ratio if lossless(adjusted.basis) else parameters.flexible_ratio
    return projective if after < ratio * before else adjusted


def homographies(
    edges: Sequence[Edge],
    images: int,
    *,
    datum: int | None = 0,
    split: bool = False,
    parameters: HomographyParameters = HOMOGRAPHIES,
) -> FrameAdjustment:
    """Estimate the homographies of all frames from the tie points of their pairs.

    The tie points are in the pixels of the frames; those off their epipolar lines are left out. Other
    parameters are those of `adjust`. Raises `InputError` as that does, or if no homography fits the points of
    the pairs of a frame.
    """
    edges = [on_epipolar_lines(edge, parameters) or edge for edge in edges]
    matrices = _chained(edges, images, datum)
    for _ in range(8):
        rectified = [_rectified(edge, matrices) for edge in edges]
        basis = polynomial_over([edge.first_xy for edge in rectified], 2, HomographyBasis)
        step = adjust(rectified, images, datum=datum, split=split, basis=basis)
        corners = np.array([basis.centre_px, basis.low_px, basis.high_px])
        steps = [np.abs(step.displacement(image, corners)).max() for image in range(images)]
        matrices = matrices @ np.stack([_homography(basis, terms) for terms in step.coefficients])
        if max(steps) < 1e-4:
            break
    values = {name: getattr(step, name) for name in Adjustment.__dataclass_fields__}
    adjusted = FrameAdjustment(**values, matrices=matrices)
    corners = np.array(list(product(*zip(basis.low_px, basis.high_px, strict=True))))
    if not all(np.isfinite(adjusted.displacement(image, corners)).all() for image in range(images)):
        raise InputError(NO_HOMOGRAPHY)
    return adjusted


def _homography(basis: PolynomialBasis, coefficients: Float64) -> Float64:
    """Return the (3, 3) homography whose displacement is to first order that of the (6, 2) `coefficients`."""
    (a, d), (b, e), (c, f) = (coefficients[:3] / basis.radius_px).tolist()
    g, h = float(coefficients[3, 0]) / basis.radius_px, float(coefficients[5, 1]) / basis.radius_px
    inner = np.array([[1 + b, c, a], [e, 1 + f, d], [-g, -h, 1.0]])
    x, y = basis.centre_px
    unit = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, basis.radius_px]]) / basis.radius_px
    matrix = inverse(unit) @ inner @ unit
    return np.asarray(matrix / matrix[2, 2])


def _chained(edges: Sequence[Edge], images: int, datum: int | None) -> Float64:
    """Return (images, 3, 3) homographies, chained from the datum of each group by pairs of most points first.

    Raises `InputError` if those that have a homography do not connect all images.
    """
    steps: list[tuple[int, int, Float64]] = []
    for edge in sorted(edges, key=len, reverse=True):
        matrix = plane_of(edge.first_xy, edge.second_xy) if len(edge) >= 6 else None
        if matrix is not None:
            steps += [(edge.first, edge.second, matrix), (edge.second, edge.first, inverse(matrix))]
    matrices = np.tile(np.eye(3), (images, 1, 1))
    reached = list(datums_of(components(ends_of(edges), images), datum))
    for image in reached:  # breadth first: it grows
        for first, second, matrix in steps:
            if first == image and second not in reached:
                matrices[second] = matrix @ matrices[image]
                reached.append(second)
    unreached = images - len(reached)
    if unreached:
        raise InputError(f"no homography fits the tie points of {unreached} frames: choose another model")
    return matrices / matrices[:, 2:, 2:]


def _rectified(edge: Edge, matrices: Float64) -> Edge:
    """Return a pair with its points in px of the reference, mapped there by the homographies.

    Raises `InputError` if one is beyond the horizon.
    """
    first, second = (ProjectiveCorrection(HOMOGRAPHY, matrices[image]) for image in (edge.first, edge.second))
    first_xy, second_xy = first.inverse(edge.first_xy), second.inverse(edge.second_xy)
    if not (np.isfinite(first_xy).all() and np.isfinite(second_xy).all()):
        raise InputError(NO_HOMOGRAPHY)
    jacobian = _jacobian(inverse(second.matrix), edge.second_xy)
    covariance = np.asarray(jacobian @ edge.covariance @ jacobian.transpose(0, 2, 1))
    return replace(edge, first_xy=first_xy, second_xy=second_xy, covariance=covariance)


def _jacobian(matrix: Float64, xy: Float64) -> Float64:
    """Return the (n, 2, 2) derivatives of a homography at (n, 2) positions."""
    projected = np.column_stack([xy, np.ones(len(xy))]) @ matrix.T
    place = projected[:, :2] / projected[:, 2:]
    return (matrix[:2, :2] - place[:, :, None] * matrix[2:, :2]) / projected[:, 2:, None]
