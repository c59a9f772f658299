"""The displacement field of a registration as a raster, its sigma and its quality."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.correction.dense import Lattice
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_grid
from pcwlad_geo.outputs.map_raster import MAP_DEFAULTS, Layer, MapParameters, Squares, write_map
from pcwlad_geo.raster import Grid, at_mean_height, jacobian
from pcwlad_geo.raster.grid import metres_between
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.types import Float64, Index

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.correction.selection import Selection
    from pcwlad_geo.registration import Registration
    from pcwlad_geo.tiepoints.table import TiePointTable


OUTSIDE, EXTRAPOLATED, MODELLED, MEASURED = range(4)
"""The values of the quality band: no data; the model, beyond the tie points; the model, among them; measured
by tie points of this pixel."""
FIELD_BANDS: Final = ("dx", "dy", "sigma_x", "sigma_y")
"""Descriptions of the first four bands."""
LONG_NAMES: Final[Mapping[str, Mapping[str, str]]] = {
    "px": {},  # dy is down, and arrows that others draw of components point up
    "m": {"dx": "u-component of displacement", "dy": "v-component of displacement"},
}
"""By unit."""
QUALITY: Final = "quality: 0 none, 1 model beyond the tie points, 2 model, 3 measured"
"""Description of the last band of the displacement raster."""
UNIT_NAMES: Final = {"px": "px", "m": "metre"}
"""By unit; PROJ knows no other word."""
TAGS: Final[Mapping[str, Mapping[str, str]]] = {
    "px": {
        "DISPLACEMENT": "observed minus predicted position in the target, target px: dx along columns, dy "
        "along rows (down); predicted by the original georeferencing"
    },
    "m": {
        "DISPLACEMENT": "where the target's original georeferencing shows the ground, less where it is: "
        "metres along the axes of the CRS, dy north",
        "TYPE": "HORIZONTAL_OFFSET",  # for PROJ
    },
}
"""Tags of the file, by unit."""


def write_displacement(
    path: Path, registration: Registration, parameters: MapParameters = MAP_DEFAULTS
) -> None:
    """Write the displacement field of the target on the reference's grid.

    Five bands of float32: dx, dy, sigma_x and sigma_y in target px (with y down) or in metres along the axes
    of the reference CRS (y north), and the quality. A pixel covers a square of the reference's pixels, from
    its first one on; its values hold at its middle. With ``--points dense`` a pixel with tie points of its
    own has their mean displacement, which is brought to the middle by the slope of the model, and their mean
    covariance; elsewhere it has that of the model. Raises `InputError` where metres are wanted and not known.
    """
    if registration.selection is None or registration.model is None:
        raise TypeError("a registration without a fit has no displacement field")
    reference = ground_grid(registration.reference.grid)
    field = _Field.of(registration, reference, parameters)
    rows, cols = field.places.grid.shape
    check_grid("the displacement field", (cols, rows))
    unit = registration.settings.displacement_unit
    layers = (
        *(Layer(name, UNIT_NAMES[unit], LONG_NAMES[unit].get(name, "")) for name in FIELD_BANDS),
        Layer(QUALITY, ""),
    )
    write_map(path, field.places, layers, field.values, block_px=parameters.block_px, tags=TAGS[unit])


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """The displacement anywhere on the reference, and how well it is known."""

    places: Squares
    correction: Correction
    precision: Selection
    covariance: InterpolatedCovariance
    measured: _Measured
    metres: _Metres | None
    """None for px."""

    @classmethod
    def of(cls, registration: Registration, reference: Grid, parameters: MapParameters) -> _Field:
        """Return the field that a finished registration has found."""
        selection, correction = registration.selection, registration.model
        if selection is None or correction is None:
            raise TypeError("there is no correction")
        target, settings = registration.target, registration.settings
        side = settings.displacement_spacing or _spacing_px(
            selection, reference, target.grid, parameters.spacing_windows
        )
        places = Squares.every(side, reference, target.grid)
        origin = target.grid if places.both_located else reference
        metres = None
        if settings.displacement_unit == "m":
            if reference.crs is None:
                raise InputError("a displacement in metres needs a CRS: leave out --displacement-unit m")
            metres = _Metres(origin, reference.crs)
        statuses = ("fit", "check", "unused") if settings.points == "dense" else ()
        measured = _Measured.of(registration.tie_points.select(*statuses), places)
        covariance = InterpolatedCovariance.of(
            selection.covariance, target.grid.shape, parameters.covariance_nodes
        )
        return cls(places, correction, selection, covariance, measured, metres)

    def values(self, centres: Float64) -> Float64:
        """Return (n, 5) dx, dy, sigma_x, sigma_y and quality at (n, 2) positions of the raster."""
        values = np.full((len(centres), 5), np.nan)
        values[:, 4] = OUTSIDE
        predicted = self.places.predicted_px(centres)
        predicted[~np.isfinite(predicted).all(axis=1)] = np.nan
        observed = self.correction.forward(predicted)
        measured, offset, covariance = self.measured.at(centres)
        observed[measured] += offset
        rows, cols = self.places.target_grid.shape
        with np.errstate(invalid="ignore"):
            observable = ((observed >= 0) & (observed <= [cols, rows])).all(axis=1)
        spread = np.empty((len(centres), 2, 2))
        spread[observable] = self.covariance.at(predicted[observable])
        spread[measured] = covariance
        quality = np.full(len(centres), MODELLED)
        quality[observable] = np.where(
            self.precision.extrapolated(predicted[observable]), EXTRAPOLATED, MODELLED
        )
        quality[measured] = MEASURED
        predicted, observed, spread = (array[observable] for array in (predicted, observed, spread))
        displacement = observed - predicted
        if self.metres is not None:
            displacement, spread = self.metres.of(predicted, observed, spread)
        sigma = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
        values[observable] = np.column_stack([displacement, sigma, quality[observable]])
        return values


def _spacing_px(selection: Selection, reference: Grid, target: Grid, share: float) -> int:
    """Return the default spacing: a share of the matching window, or of the points' spacing without one."""
    window_px = selection.footprint_px or selection.fit.support.reach_px
    both_located = reference.located and target.located
    scale = jacobian(target.middle_px, at_mean_height(target), reference)[0] if both_located else np.eye(2)
    size = float(np.sqrt(abs(np.linalg.det(scale)))) if np.isfinite(scale).all() else 1.0
    return max(1, round(share * window_px * size))


@dataclass(frozen=True, slots=True, eq=False)
class InterpolatedCovariance:
    """The covariance of a correction, interpolated between nodes: it varies as slowly as the points lie."""

    lattice: Lattice
    values_px2: Float64

    @classmethod
    def of(
        cls, covariance: Callable[[Float64], Float64], shape: tuple[int, int], most: int
    ) -> InterpolatedCovariance:
        """Compute a covariance over a target of `shape` (rows, columns), at `most` nodes along an axis."""
        high = np.array(shape[::-1], dtype=np.float64)
        lattice = Lattice.over(np.zeros(2), high, max(float(high.max()) / (most - 1), 1.0))
        values = covariance(lattice.nodes_px())
        return cls(lattice, values.reshape(*lattice.shape, 2, 2))

    def at(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance at the (n, 2) predicted target px `at_px`."""
        (first_col, first_row), (down, across) = self.lattice.origin_px, np.subtract(self.lattice.shape, 1)
        end = first_col + across * self.lattice.step_px[0], first_row + down * self.lattice.step_px[1]
        return self.lattice.interpolated(self.values_px2, np.clip(at_px, (first_col, first_row), end))


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """The pixels of the raster with tie points of their own."""

    columns: int
    """Columns of the raster."""
    pixel: Index
    """(m,) indices of these pixels, row by row, ascending."""
    residual_px: Float64
    """(m, 2) mean of the residuals of their points, weighted by precision, target px."""
    covariance_px2: Float64
    """(m, 2, 2) mean of the covariances: points so near to each other share their windows."""

    @classmethod
    def of(cls, points: TiePointTable, places: Squares) -> _Measured:
        """Gather tie points by the pixel in which they lie."""
        rows, cols = places.grid.shape
        at_px = places.grid.to_px(points.xy) if places.both_located else points.reference_px / places.side_px
        with np.errstate(invalid="ignore"):
            inside = ((at_px >= 0) & (at_px < [cols, rows])).all(axis=1)
        col, row = at_px[inside].astype(np.intp).T
        pixel, which = np.unique(row * cols + col, return_inverse=True)
        residual, covariance = points.residual_px[inside], points.covariance_px2[inside]
        variance = np.trace(covariance, axis1=1, axis2=2)
        weight = 1.0 / np.maximum(variance, 1e-3 * float(np.median(variance)) if len(variance) else 1.0)
        total = np.bincount(which, weight, len(pixel))

        def mean(values: Float64) -> Float64:
            flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
            sums = [np.bincount(which, weight * column, len(pixel)) / total for column in flat.T]
            return np.stack(sums, axis=-1).reshape(len(pixel), *values.shape[1:])

        return cls(cols, pixel, mean(residual), mean(covariance))

    def at(self, centres: Float64) -> tuple[Index, Float64, Float64]:
        """Return which of (n, 2) pixel centres have points, and the m residuals and covariances of these."""
        col, row = np.floor(centres).astype(np.intp).T
        index = row * self.columns + col
        place = np.searchsorted(self.pixel, index)
        place[place == len(self.pixel)] = 0
        which = np.flatnonzero(self.pixel[place] == index) if len(self.pixel) else np.empty(0, np.intp)
        return which, self.residual_px[place[which]], self.covariance_px2[place[which]]


@dataclass(frozen=True, slots=True)
class _Metres:
    """The conversion of displacements from target px to metres along the axes of the reference CRS."""

    grid: Grid
    """The grid of the predicted and observed px."""
    crs: CRS

    def of(
        self, predicted_px: Float64, observed_px: Float64, covariance_px2: Float64
    ) -> tuple[Float64, Float64]:
        """Return (n, 2) displacements (x, y) and their (n, 2, 2) covariances, metres and m²."""
        level, crs = at_mean_height(self.grid), self.crs
        steps = [
            metres_between(level, observed_px - half, observed_px + half, crs)
            for half in np.array([[0.5, 0.0], [0.0, 0.5]])
        ]
        per_px = np.stack(steps, axis=2)
        covariance = per_px @ covariance_px2 @ per_px.transpose(0, 2, 1)
        return metres_between(self.grid, predicted_px, observed_px, crs), covariance
