"""The model of a lens: from directions to the pixels of its raw frames, and back.

Directions are (x, y) of rays (x, y, 1): x to the right, y down, the optical axis at (0, 0). Pixels are (col,
row), corner-based.

References
----------
.. [1] Brown, D. C. (1966), Decentering distortion of lenses (radial and tangential terms).
.. [2] Kannala, J. and Brandt, S. (2006), doi:10.1109/TPAMI.2006.153 (odd polynomial of the angle).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.types import Bool, Float64

LensModel = Literal["brown", "fisheye"]

PARAMETERS: Final = ("focal_px", "centre_col", "centre_row", "k1", "k2", "k3", "p1", "p2")
"""The parameters of a lens, in the order of its vector."""
STEPS: Final = 12
"""Number of Newton steps of the inverse; fewer are enough within any sensible frame."""
FAN: Final = 400
"""Number of radii at which the largest one is looked for."""
BEYOND: Final = 1.6
"""How far beyond the corners of the frame, times its half diagonal, a ray is still followed."""

FRAME_SIDE_PX: Final = 20_000
"""Largest number of rows or columns of a frame; the largest cameras have 15,000."""
WIDEST_RAD: Final = 1.5
"""Largest angle to the axis of a fisheye that has a direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """One lens: how it maps directions to pixels."""

    model: LensModel
    """`brown`: radial polynomial of the tangent of the angle [1]_; `fisheye`: of the angle itself [2]_."""
    shape: tuple[int, int]
    """Rows and columns of the frame."""
    vector: Float64
    """(8,) focal length, principal point (col, row), px; k1, k2, k3; p1, p2: see `PARAMETERS`."""

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
        seen = project(rays, self.vector, self.model)
        return np.where((np.hypot(*rays.T) < limit)[:, None], seen, np.nan)

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

    def _largest_radius(self) -> float:
        """Return the radius of a direction up to which the image grows with it."""
        fan = np.linspace(0.0, BEYOND * self.corner, FAN)
        if self.model == "fisheye":  # whose angles, not their tangents, grow with the image
            fan = np.tan(np.minimum(fan, WIDEST_RAD))
        slope = np.diff(fan * _radial(fan, self.vector[3:6], self.model))
        folded = np.flatnonzero(slope <= 0)
        return float(fan[folded[0]] if len(folded) else fan[-1])

    def distortion_px(self, other: Lens, step: int = 24) -> Float64:
        """Return the (n, 2) differences to another lens over the frame, apart from their orientation.

        A homography is removed: it is what another focal length, principal point and orientation make of a
        plane.
        """
        places = lattice(self.shape, step)
        seen = other.project(self.rays(places))
        good = np.isfinite(seen).all(axis=1)
        if good.sum() < 4:  # which a homography fits exactly
            return np.empty((0, 2))
        return homography_residual(places[good], seen[good])

    def to_json(self) -> dict[str, Any]:
        """Return the lens as JSON values."""
        values = {name: float(value) for name, value in zip(PARAMETERS, self.vector, strict=True)}
        return {"model": self.model, "rows": self.shape[0], "cols": self.shape[1], **values}

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> Lens:
        """Return the lens that `to_json` has told; raises `KeyError`, `TypeError` or `ValueError`."""
        vector = np.array([float(values[name]) for name in PARAMETERS])
        model = values["model"]
        rows, cols = int(values["rows"]), int(values["cols"])
        if model not in ("brown", "fisheye") or not np.isfinite(vector).all() or vector[0] <= 0:
            raise ValueError(f"no lens: {model}, {vector}")
        if not 1 <= min(rows, cols) <= max(rows, cols) <= FRAME_SIDE_PX:
            raise ValueError(f"no frame has {cols} x {rows} px")
        return Lens(model, (rows, cols), vector)


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
    for _ in range(3):  # weights by the denominator make the linear fit one of the px
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
    """Return the (n, 2) px of (n, 2) directions.

    Parameters
    ----------
    rays : (n, 2) array
        Directions.
    vector : (8,) or (8, n) array
        Parameters of the lens, or of one for each direction.
    model : {"brown", "fisheye"}
        Of the lens.
    """
    x, y = rays.T
    radius = np.hypot(x, y)
    x, y = x * (radial := _radial(radius, vector[3:6], model)), y * radial
    if model == "brown":  # the tangential terms are of the direction itself
        dx, dy = _tangential(rays[:, 0], rays[:, 1], vector[6:8])
    else:
        dx, dy = _tangential(x, y, vector[6:8])
    return np.column_stack([vector[0] * (x + dx) + vector[1], vector[0] * (y + dy) + vector[2]])


def rays(xy_px: Float64, vector: Float64, model: LensModel) -> Float64:
    """Return the (n, 2) directions of px, the inverse of `project`.

    Parameters
    ----------
    xy_px : (n, 2) array
        Positions.
    vector, model : (8,) array and {"brown", "fisheye"}
        Of the lens.
    """
    seen_x = (xy_px[:, 0] - vector[1]) / vector[0]
    seen_y = (xy_px[:, 1] - vector[2]) / vector[0]
    direction = _undo_radial(seen_x, seen_y, vector[3:6], model)
    for _ in range(STEPS):
        wrong = project(direction, vector, model) - xy_px
        if not np.nanmax(np.abs(wrong), initial=0.0) > 1e-9:
            break
        seen_x, seen_y = seen_x - wrong[:, 0] / vector[0], seen_y - wrong[:, 1] / vector[0]
        direction = _undo_radial(seen_x, seen_y, vector[3:6], model)
    return direction


def _radial(radius: Float64, k: Float64, model: LensModel) -> Float64:
    """Return the factor on directions at a radius, the tangent of the angle to the axis."""
    if model == "brown":
        square = radius**2
        return np.asarray(1 + square * (k[0] + square * (k[1] + square * k[2])))
    angle = np.arctan(radius)
    square = angle**2
    bent = angle * (1 + square * (k[0] + square * (k[1] + square * k[2])))
    return np.asarray(np.divide(bent, radius, out=np.ones_like(bent), where=radius > 1e-12))


def _tangential(x: Float64, y: Float64, p: Float64) -> tuple[Float64, Float64]:
    square = x * x + y * y
    return (
        2 * p[0] * x * y + p[1] * (square + 2 * x * x),
        p[0] * (square + 2 * y * y) + 2 * p[1] * x * y,
    )


def _undo_radial(x: Float64, y: Float64, k: Float64, model: LensModel) -> Float64:
    """Return the directions whose radial image is (x, y), by Newton's method on the radius."""
    seen = np.hypot(x, y)
    bent = seen if model == "brown" else np.minimum(seen, WIDEST_RAD)
    at = bent.copy()
    for _ in range(STEPS):
        square = at**2
        value = at * (1 + square * (k[0] + square * (k[1] + square * k[2]))) - bent
        slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * 7 * k[2]))
        at = np.clip(at - value / np.maximum(slope, 0.2), 0.0, WIDEST_RAD if model == "fisheye" else 10.0)
    radius = at if model == "brown" else np.tan(at)
    ratio = np.divide(radius, seen, out=np.ones_like(radius), where=seen > 1e-12)
    return np.column_stack([x * ratio, y * ratio])
