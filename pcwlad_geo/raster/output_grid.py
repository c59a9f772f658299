"""The grid of a registered raster, and the way from its pixels to those of the original."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import shapely
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_grid, check_output_pixel
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px
from pcwlad_geo.raster.output_size import pixel_sizes

Array = NDArray[np.float64]
Box = tuple[Array, Array]
"""Lowest and highest (x, y) of a lattice."""

_SLIVER_PX: Final = 1e-3
"""Slivers of the footprint thinner than this get no pixel of their own."""
_WHOLE: Final = 1e-6
"""Ratios of pixel sizes this close to a whole number are one."""
_MOST_PX: Final = 2**31 - 1
"""Along a side of a raster: GDAL's limit."""


@dataclass(frozen=True, slots=True)
class GridRequest:
    """What the user says of the output grid; by default the reference's alignment, the raster's pixels."""

    mode: Literal["reference", "reference-exact", "target"] = "reference"
    like: Grid | None = None
    """Exactly this grid."""
    pixel_size: tuple[float, float] | None = None
    """Along x and y, units of the output's CRS."""
    extent: tuple[float, float, float, float] | None = None
    """x_min, y_min, x_max, y_max in the output's CRS."""
    crs: CRS | None = None
    """The reference's by default."""

    @property
    def needs_ground(self) -> bool:
        """Whether it speaks of map coordinates."""
        return any(wish is not None for wish in (self.like, self.pixel_size, self.extent, self.crs))

    def fixed(self, reference: Grid) -> Grid | None:
        """Return the grid where it does not depend on the raster."""
        return reference if self.mode == "reference-exact" else self.like


def output_grid(
    reference_grid: Grid, target_grid: Grid, correction: Correction, request: GridRequest | None = None
) -> Grid:
    """Return the grid of the registered target, see `output_grids`."""
    return output_grids(reference_grid, target_grid, correction, request, (target_grid,))[0]


def output_grids(
    reference_grid: Grid,
    target_grid: Grid,
    correction: Correction,
    request: GridRequest | None,
    rasters: Sequence[Grid],
) -> list[Grid]:
    """Return the grids of the registered target's bands: one extent for all, whatever their pixel sizes.

    By default they have CRS, axes and corners of the reference and the pixel sizes of `pixel_sizes`, and
    cover the corrected footprint of the target, rounded outwards to whole pixels of the coarsest of them and
    the target. A raster that reaches beyond that by more than such a pixel enlarges it. Where either has no
    CRS: the reference's pixels.

    Parameters
    ----------
    reference_grid, target_grid : Grid
        The original grids.
    correction : Correction
        Maps predicted to observed target pixels.
    request : GridRequest, optional
    rasters : sequence of Grid
        Of the target itself, or of other rasters of its geometry.

    Raises
    ------
    InputError
        If a footprint cannot be transformed to the CRS of the output, or the correction has no place for it,
        or the grid that is asked for has no pixel, or too many.
    """
    request = request or GridRequest()
    fixed = request.fixed(reference_grid)
    if fixed is not None:
        check_grid("the output grid", fixed.shape[::-1])
        if fixed.located and target_grid.located:
            _check_pixel(fixed, target_grid)
        return [fixed] * len(rasters)
    if request.mode == "target":
        return list(rasters)
    if not (reference_grid.located and target_grid.located):
        return [reference_grid] * len(rasters)
    lattice = output_lattice(reference_grid, request)
    boxes = [_footprint(own, target_grid, correction, lattice) for own in (target_grid, *rasters)]
    sizes = pixel_sizes(lattice, reference_grid, target_grid, rasters)
    grids = lay_out(lattice, request, boxes, sizes)
    made_from_px = sum(
        float(each.shape[0]) * each.shape[1] for each in (reference_grid, target_grid, *rasters)
    )
    for grid in grids:
        check_grid("the output grid", grid.shape[::-1], made_from_px)
        _check_pixel(grid, target_grid)
    return grids


def _check_pixel(grid: Grid, target: Grid) -> None:
    """Raise where the pixels of an output grid are too large for those of the target."""
    middle = np.array([[target.shape[1] / 2, target.shape[0] / 2]])
    steps = jacobian(middle, target, grid)[0]
    if np.isfinite(steps).all():
        check_output_pixel(np.linalg.svd(steps, compute_uv=False).tolist())


def output_lattice(reference: Grid, request: GridRequest) -> Grid:
    """Return the lattice that the pixels of an output are laid on: one map unit a pixel.

    Its corner and axes are the reference's; north up with a pixel size or an extent given, as for gdalwarp;
    the origin of the CRS in another one than the reference's.
    """
    crs, place = request.crs or reference.crs, reference.transform
    if crs != reference.crs:
        return Grid(reference.shape, Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0), crs)
    if request.pixel_size is not None or request.extent is not None:
        return Grid(reference.shape, Affine(1.0, 0.0, place.c, 0.0, -1.0, place.f), crs)
    (a, b), (d, e) = (linear_part(place) / np.hypot(*linear_part(place))).tolist()
    return Grid(reference.shape, Affine(a, b, place.c, d, e, place.f), crs)


def lay_out(lattice: Grid, request: GridRequest, boxes: Sequence[Box], sizes: Sequence[Array]) -> list[Grid]:
    """Return the grids of rasters that share an extent.

    Parameters
    ----------
    lattice : Grid
        See `output_lattice`.
    request : GridRequest
        Its pixel size and extent count.
    boxes : sequence of (2,), (2,) arrays
        What the target and then each raster covers, lattice px.
    sizes : sequence of (2,) arrays
        Pixel sizes of the same, lattice px.

    Raises
    ------
    InputError
        If a grid has no pixel, or too many.
    """
    if request.pixel_size is not None:
        sizes = [np.array(request.pixel_size)] * len(sizes)
    step = np.max(sizes, axis=0)
    if request.extent is not None:
        return [_within(lattice, request, size, step) for size in sizes[1:]]
    low, high = boxes[0]
    for other_low, other_high in boxes[1:]:
        low = np.where(other_low < low - step, other_low, low)
        high = np.where(other_high > high + step, other_high, high)
    first = np.floor(low / step + _SLIVER_PX)
    steps = np.maximum(np.ceil(high / step - _SLIVER_PX) - first, 1)
    return [_laid(lattice, first * step, size, _count(steps, step, size)) for size in sizes[1:]]


def check_covered(grid: Grid, footprint_xy: Array, footprint_crs: CRS | None, *, beyond: float = 0.0) -> None:
    """Raise where an output grid shows nothing of a raster.

    Parameters
    ----------
    grid : Grid
    footprint_xy : (n, 2) array
        Around the raster, map coordinates.
    footprint_crs : CRS or None
        Theirs. Where it or the grid alone has none, the grid has no place, or the outline cannot be placed,
        nothing is checked.
    beyond : float
        How far the raster may lie from there, as a share of its larger side.

    Raises
    ------
    InputError
        Then.
    """
    if (footprint_crs is None) != (grid.crs is None) or not grid.located or not len(footprint_xy):
        return
    plain = Grid(grid.shape, Affine.identity(), footprint_crs)
    outline_px = map_px(footprint_xy, plain, grid)
    if not np.isfinite(outline_px).all():
        return
    low, high = outline_px.min(axis=0), outline_px.max(axis=0)
    around = shapely.Polygon(outline_px).buffer(beyond * float((high - low).max()))
    rows, cols = grid.shape
    if around.intersection(shapely.box(0, 0, cols, rows)).area > 0:
        return
    (left, top), (right, bottom) = grid.to_xy(np.array([[0.0, 0.0], [cols, rows]])).tolist()
    place = Grid((1, 1), Affine.identity(), grid.crs)
    xy = map_px(footprint_xy, plain, place)
    (x_min, y_min), (x_max, y_max) = xy.min(axis=0), xy.max(axis=0)
    where = "in the plane of their geotransforms" if grid.crs is None else f"in {name_of(grid.crs)}"
    raise InputError(
        f"the output grid shows nothing of the target: {where} it covers x {left:.10g} to "
        f"{right:.10g}, y {bottom:.10g} to {top:.10g}, and the target x {x_min:.10g} to {x_max:.10g}, "
        f"y {y_min:.10g} to {y_max:.10g}: change --te, --t-srs or --like"
    )


def original_pixels(
    own_grid: Grid, target_grid: Grid, correction: Correction, grid: Grid
) -> Callable[[Array], Array]:
    """Return the mapping of (n, 2) output pixels (col, row) to the original ones that show the same ground.

    Output pixel → predicted target pixel → observed target pixel → pixel of the raster.

    Parameters
    ----------
    own_grid : Grid
        Of the raster: the target, or another one of its geometry.
    target_grid : Grid
        The grid whose pixels the correction speaks of.
    correction : Correction
        Maps predicted to observed target pixels.
    grid : Grid
        The output grid. Where it or the raster has no place, its pixels are the predicted ones.
    """
    placed = own_grid.located and grid.located

    def mapping(at_px: Array) -> Array:
        predicted_px = map_px(at_px, grid, target_grid) if placed else at_px
        return map_px(correction.forward(predicted_px), target_grid, own_grid)

    return mapping


def corrected_outline(target: Grid, correction: Correction) -> Array:
    """Return (n, 2): map coordinates around the ground that a target shows, in its CRS."""
    return target.to_xy(correction.inverse(target.boundary_px()))


def _footprint(own: Grid, target: Grid, correction: Correction, lattice: Grid) -> Box:
    """Return what a raster covers once corrected, lattice px."""
    observed_px = map_px(own.boundary_px(), own, target)
    around = map_px(correction.inverse(observed_px), target, lattice)
    if not np.isfinite(around).all():
        raise InputError(
            f"the target's footprint cannot be transformed from {name_of(target.crs)} to "
            f"{name_of(lattice.crs)}: crop it to where that CRS is valid, or use --grid target"
        )
    return around.min(axis=0), around.max(axis=0)


def _count(steps: Array, step: Array, size: Array) -> Array:
    """Return how many pixels of a size so many of the coarsest ones are."""
    ratio = step / size
    whole = np.rint(ratio)
    exact = np.abs(ratio / whole - 1.0) <= _WHOLE
    return np.where(exact, steps * whole, np.ceil(steps * ratio - _SLIVER_PX))


def _within(lattice: Grid, request: GridRequest, size: Array, step: Array) -> Grid:
    """Return the grid of an extent that the user gives, as gdalwarp does: -te, with -tr or without."""
    if request.extent is None:
        raise TypeError("there is no extent")
    x_min, y_min, x_max, y_max = request.extent
    sides = np.array([x_max - x_min, y_max - y_min])
    if request.pixel_size is not None:
        counts = np.floor(sides / size + 0.5)
        corner = Grid(lattice.shape, Affine(1.0, 0.0, x_min, 0.0, -1.0, y_max), lattice.crs)
        return _laid(corner, np.zeros(2), size, counts)
    counts = _count(np.maximum(np.floor(sides / step + 0.5), 1), step, size)
    corner = Grid(lattice.shape, Affine(1.0, 0.0, x_min, 0.0, -1.0, y_max), lattice.crs)
    return _laid(corner, np.zeros(2), sides / counts, counts)


def _laid(lattice: Grid, origin_px: Array, size: Array, counts: Array) -> Grid:
    """Return so many pixels of a size from a place of the lattice on."""
    if not (counts >= 1).all() or (counts > _MOST_PX).any():
        raise InputError(
            f"the output grid would have {counts[0]:.0f} x {counts[1]:.0f} pixels of {size[0]:.10g} x "
            f"{size[1]:.10g}: check --te and --tr, which are in units of {name_of(lattice.crs)}"
        )
    linear = ((float(size[0]), 0.0), (0.0, float(size[1])))
    cols, rows = counts.astype(int).tolist()
    return lattice.remade(linear, (float(origin_px[0]), float(origin_px[1])), (rows, cols))
