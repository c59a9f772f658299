"""Rasters of numbers about a correction, written block by block: its sigma, and the displacement field."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from affine import Affine

from pcwlad_geo.correction.dense import Lattice
from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_grid
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.gdal import small_block_cache
from pcwlad_geo.raster.geodesy import displacement_m
from pcwlad_geo.raster.grid import Grid, jacobian, map_px
from pcwlad_geo.raster.output_format import write_cog
from pcwlad_geo.raster.rpc.grid import at_mean_height
from pcwlad_geo.raster.rpc.view import ground_grid
from pcwlad_geo.raster.warping import scratch_folder, sink
from pcwlad_geo.types import Float64, Index

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.correction.models import Correction
    from pcwlad_geo.correction.selection import Selection
    from pcwlad_geo.registration.result import Registration
    from pcwlad_geo.tiepoints.table import TiePointTable

MAX_PX: Final = 1000
"""Longer side of the sigma raster, px: sigma varies only on the scale of the tie point spacing."""
BLOCK_PX: Final = 512
"""Side of the blocks in which a raster is computed, which limits the memory."""
NODES: Final = 128
"""Largest number of nodes along an axis between which the covariance of the correction is interpolated."""
SHARE_OF_WINDOW: Final = 0.25
"""Spacing of the displacement field in matching windows: two of its places share most of their pixels."""


class Layer(NamedTuple):
    """A band of such a raster."""

    description: str
    unit: str
    long_name: str = ""
    """Tag of the band, from which programs that read netCDF tell the components of a vector."""


Values = Callable[[Float64], Float64]
"""Maps (n, 2) positions (col, row) of a raster, px, to the (n, bands) values there; NaN where unknown."""

SIGMA_LAYERS: Final = (
    Layer("sigma along column", "px"),
    Layer("sigma along row", "px"),
    Layer("1 beyond the tie points, 0 among them", ""),
)
"""Bands of the sigma raster."""


def write_sigma(path: Path, precision: Selection, target_grid: Grid, grid: Grid) -> None:
    """Write the sigma of a correction over the registered raster.

    Three bands of float32: sigma along the target's columns and rows, target px, and 1 where the correction
    extrapolates. A pixel covers a square of the registered raster's pixels. If either grid has no CRS, the
    pixels of the registered raster, on `grid`, are the predicted ones of `target_grid`.
    """
    factor = -(-max(grid.shape) // MAX_PX)
    places = _Places.every(factor, grid, target_grid)

    def values(centres: Float64) -> Float64:
        at_px = places.predicted_px(centres)
        found = np.full((len(at_px), 3), np.nan)
        known = np.isfinite(at_px).all(axis=1)
        found[known, :2] = precision.sigma(at_px[known])
        found[known, 2] = precision.extrapolated(at_px[known])
        return found

    write_map(path, places, SIGMA_LAYERS, values, block_px=MAX_PX)


@dataclass(frozen=True, slots=True)
class _Places:
    """Squares of a grid's pixels, and where the target's georeferencing predicts their middles."""

    grid: Grid
    """Its pixels are the squares."""
    side_px: int
    """Side of a square in pixels of the grid that is divided."""
    target_grid: Grid
    located: bool
    """Whether the divided grid has map coordinates."""
    placed: bool
    """Whether both have; otherwise pixels of the divided grid are the predicted ones."""

    @classmethod
    def every(cls, side_px: int, grid: Grid, target_grid: Grid) -> _Places:
        """Divide a grid into squares, from its first pixel on; the last ones may reach beyond it."""
        shape = (-(-grid.shape[0] // side_px), -(-grid.shape[1] // side_px))
        coarse = grid.resampled_grid(((side_px, 0.0), (0.0, side_px)), (0.0, 0.0), shape)
        return cls(coarse, side_px, target_grid, grid.located, grid.located and target_grid.located)

    @property
    def transform(self) -> Affine:
        """The geotransform to write; without map coordinates that of the pixel plane, y = -row."""
        return self.grid.transform if self.located else Affine.scale(self.side_px, -self.side_px)

    def predicted_px(self, centres: Float64) -> Float64:
        """Map (n, 2) positions (col, row) of the raster to predicted target px; NaN where there is none."""
        return map_px(centres, self.grid, self.target_grid) if self.placed else centres * self.side_px


def write_map(
    path: Path,
    places: _Places,
    layers: Sequence[Layer],
    values: Values,
    *,
    block_px: int = BLOCK_PX,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write a float32 COG with NaN for nodata, block by block: the memory does not grow with the raster.

    Parameters
    ----------
    layers : sequence of Layer
        Descriptions and units of the bands.
    values : callable
        Computes the bands at the middles of pixels.
    block_px : int
        Side of the blocks.
    tags : mapping, optional
        Tags of the file.
    """
    rows, cols = places.grid.shape
    profile = {"driver": "GTiff", "dtype": "float32", "nodata": np.nan, "count": len(layers)}
    profile |= {"height": rows, "width": cols, "tiled": True, "bigtiff": "IF_SAFER"}
    profile |= {"crs": places.grid.crs, "transform": places.transform}
    with scratch_folder(path) as scratch, small_block_cache():
        with sink(scratch / "pixels.tif", profile) as file:
            for row in range(0, rows, block_px):
                for col in range(0, cols, block_px):
                    shape = min(block_px, rows - row), min(block_px, cols - col)
                    down, across = np.indices(shape)
                    first = np.stack([across + col, down + row], axis=-1).reshape(-1, 2)
                    centres = first.astype(np.float64) + 0.5
                    block = values(centres).T.reshape(len(layers), *shape)
                    file.write(
                        block.astype(np.float32), window=((row, row + shape[0]), (col, col + shape[1]))
                    )
            for band, layer in enumerate(layers, start=1):
                file.set_band_description(band, layer.description)
                file.set_band_unit(band, layer.unit)
                if layer.long_name:
                    file.update_tags(band, long_name=layer.long_name)
            file.update_tags(**(tags or {}))
        write_cog(scratch / "pixels.tif", path)


OUTSIDE, BEYOND, MODELLED, MEASURED = range(4)
"""The values of the quality band: no data; the model, beyond the tie points; the model, among them; measured
by tie points of this pixel."""
NAMES: Final = ("dx", "dy", "sigma_x", "sigma_y")
"""Descriptions of the first four bands."""
LONG_NAMES: Final[Mapping[str, Mapping[str, str]]] = {
    "px": {},  # dy is down, and arrows that others draw of components point up
    "m": {"dx": "u-component of displacement", "dy": "v-component of displacement"},
}
"""By unit."""
QUALITY: Final = "quality: 0 none, 1 model beyond the tie points, 2 model, 3 measured"
"""Description of the last band of the displacement raster."""
UNITS: Final = {"px": "px", "m": "metre"}
"""By unit; PROJ knows no other word."""
TAGS: Final[Mapping[str, Mapping[str, str]]] = {
    "px": {
        "DISPLACEMENT": "observed minus predicted position in the target, target px: dx along columns, dy "
        "along rows (down); predicted by the original georeferencing",
    },
    "m": {
        "DISPLACEMENT": "where the target's original georeferencing shows the ground, less where it is: "
        "metres along the axes of the CRS, dy north",
        "TYPE": "HORIZONTAL_OFFSET",  # for PROJ
    },
}
"""Tags of the file, by unit."""


def write_displacement(path: Path, registration: Registration) -> None:
    """Write the displacement field of the target on the reference's grid.

    Five bands of float32: dx, dy, sigma_x and sigma_y in target px (with y down) or in metres along the axes
    of the reference CRS (y north), and the quality. A pixel covers a square of the reference's pixels, from
    its first one on; its values hold at its middle. With ``--points dense`` a pixel with tie points of its
    own has their mean displacement, which is brought to the middle by the slope of the model, and their mean
    covariance; elsewhere it has that of the model. Raises `InputError` where metres are wanted and not known.
    """
    if registration.selection is None or registration.correction is None:
        raise TypeError("a registration without a fit has no displacement field")
    reference = ground_grid(registration.reference.grid)
    field = _Field.of(registration, reference)
    rows, cols = field.places.grid.shape
    check_grid("the displacement field", (cols, rows))
    unit = registration.settings.displacement_unit
    layers = (
        *(Layer(name, UNITS[unit], LONG_NAMES[unit].get(name, "")) for name in NAMES),
        Layer(QUALITY, ""),
    )
    write_map(path, field.places, layers, field.values, tags=TAGS[unit])


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """The displacement anywhere on the reference, and how well it is known."""

    places: _Places
    correction: Correction
    precision: Selection
    covariance: _Interpolated
    measured: _Measured
    metres: _Metres | None
    """None for px."""

    @classmethod
    def of(cls, registration: Registration, reference: Grid) -> _Field:
        """Return the field that a finished registration has found."""
        selection, correction = registration.selection, registration.correction
        if selection is None or correction is None:
            raise TypeError("there is no correction")
        target, settings = registration.target, registration.settings
        side = settings.displacement_spacing or _spacing_px(selection, reference, target.grid)
        places = _Places.every(side, reference, target.grid)
        own = target.grid if places.placed else reference
        metres = None
        if settings.displacement_unit == "m":
            if reference.crs is None:
                raise InputError("a displacement in metres needs a CRS: leave out --displacement-unit m")
            metres = _Metres(own, reference)
        statuses = ("fit", "check", "unused") if settings.points == "dense" else ()
        measured = _Measured.of(registration.tie_points.select(*statuses), places)
        covariance = _Interpolated.of(selection, target.grid.shape)
        return cls(places, correction, selection, covariance, measured, metres)

    def values(self, centres: Float64) -> Float64:
        """Return (n, 5) dx, dy, sigma_x, sigma_y and quality at (n, 2) positions of the raster."""
        found = np.full((len(centres), 5), np.nan)
        found[:, 4] = OUTSIDE
        predicted = self.places.predicted_px(centres)
        predicted[~np.isfinite(predicted).all(axis=1)] = np.nan
        observed = self.correction.forward(predicted)
        own, offset, covariance = self.measured.at(centres)
        observed[own] += offset
        rows, cols = self.places.target_grid.shape
        with np.errstate(invalid="ignore"):
            seen = ((observed >= 0) & (observed <= [cols, rows])).all(axis=1)
        spread = np.empty((len(centres), 2, 2))
        spread[seen] = self.covariance.at(predicted[seen])
        spread[own] = covariance
        quality = np.full(len(centres), MODELLED)
        quality[seen] = np.where(self.precision.extrapolated(predicted[seen]), BEYOND, MODELLED)
        quality[own] = MEASURED
        moved, spread = self._in_unit(predicted[seen], observed[seen], spread[seen])
        sigma = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
        found[seen] = np.column_stack([moved, sigma, quality[seen]])
        return found

    def _in_unit(
        self, predicted_px: Float64, observed_px: Float64, covariance_px2: Float64
    ) -> tuple[Float64, Float64]:
        if self.metres is None:
            return observed_px - predicted_px, covariance_px2
        return self.metres.of(predicted_px, observed_px, covariance_px2)


def _spacing_px(selection: Selection, reference: Grid, target: Grid) -> int:
    """Return the default spacing: a quarter of the matching window, or of the points' spacing without one."""
    window_px = selection.footprint_px or selection.fit.support.reach_px
    placed = reference.located and target.located
    scale = jacobian(target.middle_px, at_mean_height(target), reference)[0] if placed else np.eye(2)
    size = float(np.sqrt(abs(np.linalg.det(scale)))) if np.isfinite(scale).all() else 1.0
    return max(1, round(SHARE_OF_WINDOW * window_px * size))


@dataclass(frozen=True, slots=True, eq=False)
class _Interpolated:
    """The covariance of a correction, interpolated between nodes: it varies as slowly as the points lie."""

    lattice: Lattice
    values_px2: Float64

    @classmethod
    def of(cls, precision: Selection, shape: tuple[int, int]) -> _Interpolated:
        """Compute the covariance at nodes over a target of `shape` (rows, columns)."""
        high = np.array(shape[::-1], dtype=np.float64)
        lattice = Lattice.over(np.zeros(2), high, max(float(high.max()) / (NODES - 1), 1.0))
        values = precision.covariance(lattice.nodes_px())
        return cls(lattice, values.reshape(*lattice.shape, 2, 2))

    def at(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance at the (n, 2) predicted target px, px²."""
        (left, top), (down, across) = self.lattice.origin_px, np.subtract(self.lattice.shape, 1)
        far = left + across * self.lattice.step_px[0], top + down * self.lattice.step_px[1]
        return self.lattice.interpolated(self.values_px2, np.clip(at_px, (left, top), far))


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
    def of(cls, points: TiePointTable, places: _Places) -> _Measured:
        """Gather tie points by the pixel in which they lie."""
        rows, cols = places.grid.shape
        at_px = places.grid.to_px(points.xy) if places.placed else points.reference_px / places.side_px
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
        wanted = row * self.columns + col
        place = np.searchsorted(self.pixel, wanted)
        place[place == len(self.pixel)] = 0
        own = np.flatnonzero(self.pixel[place] == wanted) if len(self.pixel) else np.empty(0, np.intp)
        return own, self.residual_px[place[own]], self.covariance_px2[place[own]]


@dataclass(frozen=True, slots=True)
class _Metres:
    """The conversion of displacements from target px to metres along the axes of the reference CRS."""

    own: Grid
    """The grid of the predicted and observed px."""
    reference: Grid

    def of(
        self, predicted_px: Float64, observed_px: Float64, covariance_px2: Float64
    ) -> tuple[Float64, Float64]:
        """Return (n, 2) displacements (x, y) and their (n, 2, 2) covariances, metres and m²."""
        level = at_mean_height(self.own)
        steps = [
            self._between(level, observed_px - half, observed_px + half)
            for half in np.array([[0.5, 0.0], [0.0, 0.5]])
        ]
        per_px = np.stack(steps, axis=2)
        covariance = per_px @ covariance_px2 @ per_px.transpose(0, 2, 1)
        return self._between(self.own, predicted_px, observed_px), covariance

    def _between(self, grid: Grid, from_px: Float64, to_px: Float64) -> Float64:
        crs = self.reference.crs
        xy_from, xy_to = (transform_xy(grid.to_xy(px), grid.crs, crs) for px in (from_px, to_px))
        return displacement_m(xy_from, xy_to, crs)
