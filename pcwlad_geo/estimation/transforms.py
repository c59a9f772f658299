"""The algebra of transforms of the plane: shift, similarity, affine and projective, composed by ``@``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import SCALE, inverse, least_squares
from pcwlad_geo.types import Float64

if TYPE_CHECKING:
    from typing_extensions import Self

MAX_STRETCH: Final = 1e6
"""Largest factor by which an affine that is read may stretch or shrink; those of images have about one."""


@dataclass(frozen=True, slots=True, eq=False)
class ProjectiveTransform:
    """(w·x', w·y', w) = matrix · (x, y, 1). ``later @ first`` applies `first`, then `later`."""

    KIND: ClassVar[str] = "projective"
    matrix: Float64
    """(3, 3)."""

    @classmethod
    def fit(cls, from_xy: Float64, to_xy: Float64) -> Self:
        """Return the transform of least squares between the (n, 2) points `from_xy` and `to_xy`.

        Of a projective they are algebraic, with normalised points (Hartley 1997, doi:10.1109/34.601246).
        Raises `InputError` if the points are too few, or not finite.
        """
        if len(from_xy) < 4 or not (np.isfinite(from_xy).all() and np.isfinite(to_xy).all()):
            raise InputError(f"a projective transform needs at least 4 finite points, not {len(from_xy)}")
        normalised = [_normalising(points) for points in (from_xy, to_xy)]
        (x, y), (u, v) = (unit(points).T for unit, points in zip(normalised, (from_xy, to_xy), strict=True))
        zero, one = np.zeros_like(x), np.ones_like(x)
        rows = [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1),
        ]
        matrix = np.linalg.svd(np.concatenate(rows))[2][-1].reshape(3, 3)
        matrix = inverse(normalised[1].matrix) @ matrix @ normalised[0].matrix
        middle = matrix[2] @ [*from_xy.mean(axis=0), 1.0]
        return cls(matrix / (middle if matrix[2, 2] / middle <= 0 else matrix[2, 2]))

    def __call__(self, xy: Float64) -> Float64:
        """Map the (n, 2) points `xy`; NaN beyond the horizon."""
        mapped = np.asarray(xy, dtype=np.float64) @ self.matrix[:, :2].T + self.matrix[:, 2]
        w = np.where(mapped[:, 2:] > 0, mapped[:, 2:], np.nan)
        return np.asarray(mapped[:, :2] / w)

    def apply_inverse(self, xy: Float64) -> Float64:
        """Map the (n, 2) points `xy` by the inverse; NaN beyond the horizon."""
        return self.inverse()(xy)

    def inverse(self) -> Self:
        """Return the inverse; raise `InputError` if there is none."""
        return type(self)(inverse(self.matrix))

    def __matmul__(self, first: ProjectiveTransform) -> ProjectiveTransform:
        general = type(self) if isinstance(first, type(self)) else type(first)
        return general(self.matrix @ first.matrix)

    def to_dict(self) -> dict[str, object]:
        """Return its kind and its matrix, without the last row of an affine."""
        return {"type": self.KIND, "matrix": self.matrix.tolist()}

    @classmethod
    def from_numbers(cls, values: object) -> Self:
        """Return the transform of a nested list; raise `ValueError` if it has no inverse."""
        matrix = finite_array(values, (3, 3))
        if not np.linalg.cond(matrix) * np.finfo(np.float64).eps < 1:
            raise ValueError("its matrix cannot be inverted")
        return cls(matrix)


@dataclass(frozen=True, slots=True, eq=False)
class AffineTransform(ProjectiveTransform):
    """(x', y') = linear · (x, y) + offset."""

    KIND: ClassVar[str] = "affine"

    @classmethod
    def from_parts(cls, linear: Float64, offset: Float64) -> Self:
        """Return the transform of a (2, 2) `linear` part and a (2,) `offset`."""
        return cls(affine_matrix(linear, offset))

    @classmethod
    def from_rows(cls, rows: Float64) -> Self:
        """Return the transform of the (2, 3) matrix `rows`."""
        return cls(np.vstack([rows, [0.0, 0.0, 1.0]]))

    @property
    def rows(self) -> Float64:
        """(2, 3) matrix."""
        return self.matrix[:2]

    @property
    def linear(self) -> Float64:
        """(2, 2) linear part."""
        return self.matrix[:2, :2]

    @property
    def offset(self) -> Float64:
        """(2,) image of the origin."""
        return self.matrix[:2, 2]

    @classmethod
    def fit(cls, from_xy: Float64, to_xy: Float64) -> Self:
        """Return the affine of least squares between the (n, 2) points `from_xy` and `to_xy`."""
        # Relative to the means: eastings and northings have more digits than normal equations keep.
        centre, image = from_xy.mean(axis=0), to_xy.mean(axis=0)
        linear = least_squares(from_xy - centre, to_xy - image).T
        return cls.from_parts(linear, image - linear @ centre)

    def __call__(self, xy: Float64) -> Float64:
        """Map the (n, 2) points `xy`."""
        return np.asarray(np.asarray(xy, dtype=np.float64) @ self.linear.T + self.offset)

    def apply_inverse(self, xy: Float64) -> Float64:
        """Map the (n, 2) points `xy` by the inverse."""
        # Differences first: eastings and northings have more digits than the inverse of a geotransform keeps.
        return np.asarray((np.asarray(xy, dtype=np.float64) - self.offset) @ inverse(self.linear).T)

    def inverse(self) -> Self:
        """Return the inverse; raise `ZeroDivisionError` if there is none."""
        (a, b, c), (d, e, f) = self.rows.tolist()
        scale = 1 / (a * e - b * d)
        a, b, d, e = e * scale, -b * scale, -d * scale, a * scale
        return self.from_rows(np.array([[a, b, -c * a - f * b], [d, e, -c * d - f * e]]))

    def to_dict(self) -> dict[str, object]:
        """Return its kind and its matrix without the last row."""
        return {"type": self.KIND, "matrix": self.rows.tolist()}

    @classmethod
    def from_numbers(cls, values: object) -> Self:
        """Return the transform of a nested list; raise `ValueError` if it is far from that of an image."""
        rows = finite_array(values, (2, 3))
        large, small = np.linalg.svd(rows[:, :2], compute_uv=False).tolist()
        if not 1 / MAX_STRETCH <= small <= large <= MAX_STRETCH:
            raise ValueError("its matrix cannot be inverted, or stretches the image beyond measure")
        return cls.from_rows(rows)


@dataclass(frozen=True, slots=True, eq=False)
class SimilarityTransform(AffineTransform):
    """A rotation, a scale and a shift."""

    KIND: ClassVar[str] = "similarity"

    @classmethod
    def from_angle(cls, angle_rad: float, scale: float = 1.0) -> Self:
        """Return the rotation about the origin from the x axis towards the y axis, times a scale."""
        return cls.from_parts(scale * rotation(angle_rad), np.zeros(2))

    @classmethod
    def fit(cls, from_xy: Float64, to_xy: Float64) -> Self:
        """Return the similarity of least squares between the (n, 2) points `from_xy` and `to_xy`.

        Of points in one place it is the shift.
        """
        z, image = from_xy @ (1, 1j), to_xy @ (1, 1j)
        spread = float((np.abs(z - z.mean()) ** 2).sum())
        factor = ((z - z.mean()).conj() * (image - image.mean())).sum() / spread if spread > 0 else 1.0 + 0j
        origin = image.mean() - factor * z.mean()
        rows = [factor.real, -factor.imag, origin.real], [factor.imag, factor.real, origin.imag]
        return cls.from_rows(np.array(rows, np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class ShiftTransform(SimilarityTransform):
    """A shift."""

    KIND: ClassVar[str] = "shift"

    @classmethod
    def by(cls, offset: Float64) -> Self:
        """Return the shift by a (2,) `offset`."""
        return cls.from_parts(np.eye(2), offset)

    @classmethod
    def fit(cls, from_xy: Float64, to_xy: Float64) -> Self:
        """Return the shift of least squares between the (n, 2) points `from_xy` and `to_xy`."""
        return cls.by((to_xy - from_xy).mean(axis=0))


def finite_array(values: object, shape: tuple[int, ...]) -> Float64:
    """Return nested lists as an (n, ...) array; raise `ValueError` if not finite, or not of the `shape`."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers of shape {shape}, found shape {array.shape}")
    return array


def _normalising(points: Float64) -> SimilarityTransform:
    """Return what maps the (n, 2) points to a mean of zero and a mean distance of √2."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2) / max(float(np.linalg.norm(points - centre, axis=1).mean()), 1e-12)
    return SimilarityTransform.from_parts(scale * np.eye(2), -scale * centre)


def affine_matrix(linear: Float64, origin: Float64) -> Float64:
    """Return the (3, 3) matrix of a (2, 2) `linear` part and the (2,) `origin`, to which it takes (0, 0)."""
    return np.vstack([np.column_stack([linear, origin]), [0.0, 0.0, 1.0]])


def square(matrix: Float64) -> Float64:
    """Return an affine transformation as a (3, 3) matrix; `matrix` is (2, 3) or (3, 3)."""
    return affine_matrix(matrix[:2, :2], matrix[:2, 2])


def shift(xy: Float64) -> Float64:
    """Return the (3, 3) matrix that adds (2,) `xy` to positions."""
    return affine_matrix(np.eye(2), xy)


def rotation(angle_rad: float) -> Float64:
    """Return the (2, 2) matrix that turns by an angle."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def scale_of(matrix: Float64) -> float:
    """Return by how much an affine `matrix`, (2, 3) or (3, 3), scales lengths in the mean."""
    return math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))


def scale_at(homography: Float64, at_px: Float64) -> float:
    """Return by how much a (3, 3) `homography`, maybe affine, scales lengths at the (2,) place `at_px`."""
    depth = float(homography[2] @ [*at_px, 1.0])
    return math.sqrt(abs(float(np.linalg.det(homography / depth))))


def inverse_of_step(step: Float64) -> Float64:
    """Return the (3, 3) inverse of the transformation that adds a (2, 3) `step`, times position, to it."""
    (a, b, x), (c, d, y) = step.tolist()
    a, d = 1 + a, 1 + d
    size = a * d - b * c
    if size == 0:
        raise InputError(f"{SCALE} (a step of the search has none)")
    rows = (d, -b, b * y - d * x), (-c, a, c * x - a * y), (0.0, 0.0, size)
    return np.asarray(np.array(rows) / size, np.float64)
