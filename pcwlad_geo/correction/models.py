"""Corrections: their interface and algebra, and those that a matrix describes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcwlad_geo.correction.dense import Lattice, in_chunks, invert
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import AffineTransform, ProjectiveTransform
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True, eq=False)
class Correction(ABC):
    """Maps the target pixel that the original georeferencing predicts to the one observed.

    Pixel coordinates are (col, row), corner-based, of the original target file. ``later @ first`` is the
    correction that applies `first`, then `later`.
    """

    name: str
    """The model, a key of `fit.MODELS`; of a composition those of its steps."""

    @property
    def _transform(self) -> ProjectiveTransform | None:
        """The mapping without its name, if a matrix describes it; None for other mappings."""
        return None

    @abstractmethod
    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels; NaN where the model has none."""

    @abstractmethod
    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels; NaN where the model has none."""

    def at_nodes(self, nodes_px: Float64) -> Float64:
        """Map the (rows, cols, 2) `nodes_px` of a lattice to observed target pixels, of the same shape."""
        return self.forward(nodes_px.reshape(-1, 2)).reshape(nodes_px.shape)

    @abstractmethod
    def _parameters(self) -> dict[str, object]:
        """Return the type and the parameters of the mapping as report.json holds them."""

    def to_dict(self) -> dict[str, object]:
        """Return the model as report.json holds it, which alone is enough to warp (see `from_dict`)."""
        return {"name": self.name, "forward": self._parameters()}

    def invert(self) -> Correction:
        """Return the correction that maps observed to predicted pixels."""
        return Composition(self.name, ((self, True),))

    def __matmul__(self, first: Correction) -> Correction:
        if self._transform is not None and first._transform is not None:
            transform = self._transform @ first._transform
            if isinstance(transform, AffineTransform):
                return AffineCorrection(self.name if self.name == first.name else "affine", transform.rows)
            return ProjectiveCorrection("projective", transform.matrix)
        steps = [part.steps if isinstance(part, Composition) else ((part, False),) for part in (first, self)]
        return Composition(f"{first.name}, {self.name}", (*steps[0], *steps[1]))

    def to_gdal(self) -> tuple[float, float, float, float, float, float]:
        """Return the geotransform, in GDAL's order, that places observed at predicted pixels.

        The corrected geotransform of a target is this one followed by its own. Raises `InputError` for a
        model that is no affine.
        """
        raise InputError(f"a geotransform holds no {self.name} model: use GCPs, or warp the raster")

    def to_skimage(self) -> Any:  # noqa: ANN401  # of scikit-image, which has no types
        """Return the correction as a transform of scikit-image, in its coordinates.

        scikit-image counts from the centre of the first pixel, this package from its corner: what `forward`
        maps from (0.5, 0.5) to (1.5, 0.5), the transform maps from (0, 0) to (1, 0). It takes and returns
        (n, 2) arrays of (col, row), and ``skimage.transform.warp(target, transform)`` is the corrected target
        on its own pixels.

        Returns
        -------
        skimage.transform.AffineTransform, ProjectiveTransform, or a callable like these
            Shift, drift and affine; projective; other models, exactly, with the attribute `inverse`.
        """
        import skimage.transform  # slow to load

        to_corner = AffineCorrection("shift", np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]))
        centred = to_corner.invert() @ self @ to_corner
        if centred._transform is None:
            return CallableTransform(centred)
        affine = isinstance(centred, AffineCorrection)
        kind = skimage.transform.AffineTransform if affine else skimage.transform.ProjectiveTransform
        return kind(matrix=centred._transform.matrix)


@dataclass(frozen=True, slots=True, eq=False)
class CallableTransform:
    """A correction as scikit-image calls a transform."""

    correction: Correction

    def __call__(self, coords: ArrayLike) -> Float64:
        """Map (n, 2) coordinates (col, row)."""
        return self.correction.forward(np.asarray(coords, dtype=np.float64))

    @property
    def inverse(self) -> CallableTransform:
        """The inverse transform."""
        return CallableTransform(self.correction.invert())


@dataclass(frozen=True, slots=True, eq=False)
class Composition(Correction):
    """Corrections one after another."""

    steps: tuple[tuple[Correction, bool], ...]
    """Pairs of a correction and whether it is inverted, in the order in which they are applied."""

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels; NaN where a step has none."""
        for step, inverted in self.steps:
            predicted_px = step.inverse(predicted_px) if inverted else step.forward(predicted_px)
        return predicted_px

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels; NaN where a step has none."""
        return self.invert().forward(observed_px)

    def invert(self) -> Correction:
        """Return the correction that maps observed to predicted pixels."""
        steps = tuple((step, not inverted) for step, inverted in reversed(self.steps))
        return steps[0][0] if len(steps) == 1 and not steps[0][1] else Composition(self.name, steps)

    def _parameters(self) -> dict[str, object]:
        steps = [{"inverted": inverted, **step.to_dict()} for step, inverted in self.steps]
        return {"type": "composition", "steps": steps}


@dataclass(frozen=True, slots=True, eq=False)
class SmoothCorrection(Correction):
    """A correction with known derivatives, which Newton's method inverts."""

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels (col, row)."""
        return in_chunks(self._forward, predicted_px)

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels, to 1e-8 px; NaN where there is none."""
        return in_chunks(lambda at_px: invert(self._forward, self._slopes, at_px), observed_px)

    @abstractmethod
    def _forward(self, at_px: Float64) -> Float64:
        """Map (n, 2) predicted px to observed ones."""

    @abstractmethod
    def _slopes(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) derivatives of the observed px (last axis: by col, row)."""


@dataclass(frozen=True, slots=True, eq=False)
class AffineCorrection(Correction):
    """observed = matrix · (predicted col, predicted row, 1); a shift is the affine with identity."""

    matrix: Float64
    """(2, 3); the last column in px."""

    @classmethod
    def fit(cls, predicted_px: Float64, observed_px: Float64) -> AffineCorrection:
        """Return the affine of least squares from the (n, 2) `predicted_px` to the (n, 2) `observed_px`."""
        return cls("affine", AffineTransform.fit(predicted_px, observed_px).rows)

    @property
    def _transform(self) -> AffineTransform:
        """The mapping without its name."""
        return AffineTransform.from_rows(self.matrix)

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels (col, row)."""
        return self._transform(predicted_px)

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels (col, row)."""
        return self._transform.apply_inverse(observed_px)

    def invert(self) -> AffineCorrection:
        """Return the affine that maps observed to predicted pixels."""
        return AffineCorrection(self.name, self._transform.inverse().rows)

    def to_gdal(self) -> tuple[float, float, float, float, float, float]:
        """Return the geotransform, in GDAL's order, that places observed at predicted pixels."""
        (a, b, c), (d, e, f) = self._transform.inverse().rows.tolist()
        return c, a, b, f, d, e

    def _parameters(self) -> dict[str, object]:
        return self._transform.to_dict()


@dataclass(frozen=True, slots=True, eq=False)
class ProjectiveCorrection(Correction):
    """(w·observed col, w·observed row, w) = matrix · (predicted col, predicted row, 1)."""

    matrix: Float64
    """(3, 3), of positive w where the tie points are."""

    @property
    def _transform(self) -> ProjectiveTransform:
        """The mapping without its name."""
        return ProjectiveTransform(self.matrix)

    def forward(self, predicted_px: Float64) -> Float64:
        """Map the (n, 2) `predicted_px` to observed target pixels; NaN beyond the horizon."""
        return self._transform(predicted_px)

    def inverse(self, observed_px: Float64) -> Float64:
        """Map the (n, 2) `observed_px` to predicted target pixels; NaN beyond the horizon."""
        return self._transform.apply_inverse(observed_px)

    def invert(self) -> ProjectiveCorrection:
        """Return the projective that maps observed to predicted pixels."""
        return ProjectiveCorrection(self.name, self._transform.inverse().matrix)

    def _parameters(self) -> dict[str, object]:
        return self._transform.to_dict()


def has_foldover(correction: Correction, low_px: Float64, high_px: Float64) -> bool:
    """Return whether a correction has a foldover, or no value, anywhere in a box of predicted pixels.

    The (2,) `low_px` and `high_px` are corners of the box (col, row), px.
    """
    if isinstance(correction, AffineCorrection):
        (a, b, _), (d, e, _) = correction.matrix.tolist()
        return not a * e - b * d > 0
    # Four nodes per cell of the finest spline.
    lattice = Lattice.over(low_px, high_px, float((high_px - low_px).max()) / 320)
    nodes_px = lattice.nodes_px().reshape(*lattice.shape, 2)
    observed_px = correction.at_nodes(nodes_px)
    along_cols, along_rows = np.diff(observed_px, axis=1), np.diff(observed_px, axis=0)
    return not all(
        (cols[..., 0] * rows[..., 1] - cols[..., 1] * rows[..., 0] > 0).all()  # area of the cell's image
        for cols in (along_cols[:-1], along_cols[1:])
        for rows in (along_rows[:, :-1], along_rows[:, 1:])
    )
