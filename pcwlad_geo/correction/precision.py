"""The standard deviation of a correction at any place: on a lattice, and after other mappings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.types import Float64

DIFFERENCE_STEP_PX: Final = 0.5
"""Half of the distance over which derivatives are taken, px: corrections are smooth over many pixels."""


class Precision(Protocol):
    """What knows the standard deviation of a correction."""

    def sigma(self, at_px: Float64) -> Float64:
        """Return the (n, 2) standard deviation (col, row), px, at the (n, 2) predicted `at_px`."""


@dataclass(frozen=True, slots=True, eq=False)
class SigmaLattice:
    """Standard deviations at nodes, between which they are interpolated; NaN beyond."""

    cols_px: Float64
    """(m,) columns of the nodes, predicted px."""
    rows_px: Float64
    """(k,) rows of the nodes, predicted px."""
    sigma_px: Float64
    """(k, m, 2) standard deviation (col, row), px."""

    @classmethod
    def of(
        cls, precision: Precision, shape: tuple[int, int], nodes: int = 65, margin: float = 0.1
    ) -> SigmaLattice:
        """Return the lattice over a raster of (rows, cols), `nodes` along its longer side.

        It reaches beyond the raster by the `margin`, a share of its sides.
        """
        rows, cols = shape
        on_cols, on_rows = (
            np.linspace(-margin * side, (1 + margin) * side, max(3, round(nodes * side / max(shape))))
            for side in (cols, rows)
        )
        at_px = np.stack(np.meshgrid(on_cols, on_rows), axis=-1)
        return cls(on_cols, on_rows, precision.sigma(at_px.reshape(-1, 2)).reshape(at_px.shape))

    @classmethod
    def unknown(cls) -> SigmaLattice:
        """Return the lattice that knows it nowhere."""
        return cls(np.arange(2.0), np.arange(2.0), np.full((2, 2, 2), np.nan))

    def sigma(self, at_px: Float64) -> Float64:
        """Return the (n, 2) standard deviation (col, row), px, at the (n, 2) predicted `at_px`."""
        nodes = RegularGridInterpolator(
            (self.rows_px, self.cols_px), self.sigma_px, bounds_error=False, fill_value=np.nan
        )
        return np.asarray(nodes(at_px[:, ::-1]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class ComposedPrecision:
    """The standard deviation of ``later @ fitted @ first``, of which `later` and `first` are exact."""

    of: Precision
    """Of the fitted correction."""
    fitted: Correction
    first: Correction | None = None
    later: Correction | None = None

    def sigma(self, at_px: Float64) -> Float64:
        """Return the (n, 2) standard deviation (col, row), px, at the (n, 2) predicted `at_px`."""
        at_px = at_px if self.first is None else self.first.forward(at_px)
        sigma_px = self.of.sigma(at_px)
        if self.later is None:
            return sigma_px
        slopes = slopes_of(self.later, self.fitted.forward(at_px))
        return np.asarray(np.sqrt((slopes**2 @ sigma_px[:, :, None] ** 2)[:, :, 0]))


def slopes_of(correction: Correction, at_px: Float64) -> Float64:
    """Return the (n, 2, 2) derivatives of a correction at the (n, 2) `at_px` (last axis: by col, row)."""
    columns = [
        (correction.forward(at_px + step) - correction.forward(at_px - step)) / (2 * DIFFERENCE_STEP_PX)
        for step in np.eye(2) * DIFFERENCE_STEP_PX
    ]
    return np.stack(columns, axis=-1)
