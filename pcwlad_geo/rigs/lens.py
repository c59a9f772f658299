"""A lens: how it maps directions to pixels, and its distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.rigs.parameters import LENS, LensParameters
from pcwlad_geo.types import Bool, Float64

LensModel = Literal["brown", "fisheye"]
LENS_PARAMETERS: Final = ("focal_px", "centre_col", "centre_row", "k1", "k2", "k3", "p1", "p2")
"""The parameters of a lens, in the order of its vector."""


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """One lens: how it maps directions to pixels."""

    model: LensModel
    """`brown`: radial polynomial of the tangent of the angle; `fisheye`: of the angle itself."""
    shape: tuple[int, int]
    """Rows and columns of the frame."""
    vector: Float64
    """(8,) focal length, principal point (col, row), px; k1, k2, k3; p1, p2: see `LENS_PARAMETERS`."""

    @property
    def focal_px(self) -> float:
        """Focal length, px."""
        return float(self.vector[0])

    @property
    def corner(self) -> float:
        """Tangent of the angle to the corner of the frame, without distortion."""
        return math.hypot(*self.shape) / 2 / self.focal_px

    def project(self, rays: Float64) -> Float64:
        """Return the (n, 2) px of the (n, 2) directions `rays`; NaN where the distortion folds back."""
        limit = self._largest_radius()
        projected = project(rays, self.vector, self.model)
        return np.where((np.hypot(*rays.T) < limit)[:, None], projected, np.nan)

    def rays(self, xy_px: Float64) -> Float64:
        """Return the (n, 2) directions of the (n, 2) px `xy_px`."""
        return rays(xy_px, self.vector, self.model)

    def inside(self, xy_px: Float64, margin_px: float = 0.0) -> Bool:
        """Return the (n,) mask of the (n, 2) `xy_px` that are `margin_px` or more inside the frame."""
        rows, cols = self.shape
        col, row = xy_px.T
        return np.asarray(
            (col >= margin_px) & (col <= cols - margin_px) & (row >= margin_px) & (row <= rows - margin_px)
        )

    def _largest_radius(self, parameters: LensParameters = LENS) -> float:
        """Return the radius of a direction up to which the projection is monotonic."""
        radii = np.linspace(0.0, parameters.max_corner_ratio * self.corner, 400)
        if self.model == "fisheye":  # the angle, not its tangent, is proportional to the radius in the image
            radii = np.tan(np.minimum(radii, parameters.max_fisheye_rad))
        slope = np.diff(radii * _radial(radii, self.vector[3:6], self.model))
        folded = np.flatnonzero(slope <= 0)
        return float(radii[folded[0]] if len(folded) else radii[-1])

    def distortion_px(self, other: Lens, step: int = 24) -> Float64:
        """Return the (n, 2) differences of distortion to another lens, on a lattice over the frame.

        The best homography is removed: it absorbs a difference of focal length, principal point and rotation.
        """
        places = lattice(self.shape, step)
        projected = other.project(self.rays(places))
        good = np.isfinite(projected).all(axis=1)
        if good.sum() < 4:  # a homography fits fewer exactly
            return np.empty((0, 2))
        return homography_residual(places[good], projected[good])


def lattice(shape: tuple[int, int], step: int) -> Float64:
    """Return (n, 2) px (col, row) spread over a frame of `shape`, edges included, about `step` px apart."""
    rows, cols = (np.linspace(0.0, size, max(2, round(size / step) + 1)) for size in shape)
    col, row = np.meshgrid(cols, rows)
    return np.column_stack([col.ravel(), row.ravel()])


def homography_residual(source: Float64, target: Float64) -> Float64:
    """Return the (n, 2) residuals of (n, 2) `target` px of the best homography of the (n, 2) `source`."""
    centre, size = source.mean(axis=0), np.ptp(source, axis=0).max() / 2
    x, y = ((source - centre) / size).T
    u, v = ((target - centre) / size).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    weight = one
    for _ in range(3):  # weighted by the denominator, the algebraic residuals become those in px
        rows = np.vstack(
            [
                np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y]) / weight[:, None],
                np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y]) / weight[:, None],
            ]
        )
        h = least_squares(rows, np.concatenate([u / weight, v / weight]))
        weight = 1 + h[6] * x + h[7] * y
    fitted = np.column_stack([h[0] * x + h[1] * y + h[2], h[3] * x + h[4] * y + h[5]]) / weight[:, None]
    return np.asarray((np.column_stack([u, v]) - fitted) * size)


def project(rays: Float64, vector: Float64, model: LensModel) -> Float64:
    """Return the (n, 2) px of the (n, 2) directions `rays`, by the (8,) parameters `vector` of a lens."""
    distorted = rays * _radial(np.hypot(*rays.T), vector[3:6], model)[:, None]
    # Brown's tangential terms are of the undistorted direction
    tangential = _tangential(rays if model == "brown" else distorted, vector[6:8])
    return np.asarray(vector[0] * (distorted + tangential) + vector[1:3])


def rays(xy_px: Float64, vector: Float64, model: LensModel, parameters: LensParameters = LENS) -> Float64:
    """Return (n, 2) directions of the (n, 2) px `xy_px` by the (8,) `vector`, the inverse of `project`."""
    distorted = (xy_px - vector[1:3]) / vector[0]
    for _ in range(parameters.newton_steps + 1):
        direction = _undo_radial(distorted, vector[3:6], model, parameters)
        error = project(direction, vector, model) - xy_px
        if not np.nanmax(np.abs(error), initial=0.0) > 1e-9:
            break
        distorted = distorted - error / vector[0]
    return direction


def _radial(radius: Float64, k: Float64, model: LensModel) -> Float64:
    """Return the factor on directions at a radius, the tangent of the angle to the axis."""
    argument = radius if model == "brown" else np.arctan(radius)
    square = argument**2
    factor = 1 + square * (k[0] + square * (k[1] + square * k[2]))
    if model == "brown":
        return np.asarray(factor)
    return np.asarray(np.divide(argument * factor, radius, out=np.ones_like(radius), where=radius > 1e-12))


def _tangential(xy: Float64, p: Float64) -> Float64:
    x, y = xy.T
    square = x * x + y * y
    return np.column_stack(
        [
            2 * p[0] * x * y + p[1] * (square + 2 * x * x),
            p[0] * (square + 2 * y * y) + 2 * p[1] * x * y,
        ]
    )


def _undo_radial(distorted: Float64, k: Float64, model: LensModel, parameters: LensParameters) -> Float64:
    """Return the (n, 2) directions whose radial image is (n, 2) `distorted`, by Newton's method."""
    length = np.hypot(*distorted.T)
    bent = length if model == "brown" else np.minimum(length, parameters.max_fisheye_rad)
    largest = 10.0 if model == "brown" else parameters.max_fisheye_rad
    solution = bent.copy()
    for _ in range(parameters.newton_steps):
        square = solution**2
        value = solution * (1 + square * (k[0] + square * (k[1] + square * k[2]))) - bent
        slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * 7 * k[2]))
        solution = np.clip(solution - value / np.maximum(slope, 0.2), 0.0, largest)
    radius = solution if model == "brown" else np.tan(solution)
    ratio = np.divide(radius, length, out=np.ones_like(radius), where=length > 1e-12)
    return np.asarray(distorted * ratio[:, None])
