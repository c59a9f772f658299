"""The grids of the outputs: pixel sizes, extents, and the mapping from output to original pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import shapely
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.limits import check_grid, check_output_pixel
from pcwlad_geo.raster.crs import WGS84, in_turn, name_of, to_pyproj, transform_xy
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px
from pcwlad_geo.raster.overlap import Box, bounds_of, footprint, shown_by
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class OutputGridParameters:
    """Which differences of pixel sizes and extents do not count."""

    same: float = 1e-6
    """Pixel sizes whose relative difference is smaller count as equal."""
    same_across_units: float = 0.02
    """Between units, sizes within this share of a multiple or fraction of the reference's become that."""
    same_scale: float = 0.1
    """Between two CRSs of one unit whose scales differ by less, a pixel size is kept: 30 m stay 30 m."""
    sliver_px: float = 1e-3
    """A strip of the footprint thinner than this adds no row or column of pixels."""
    turned_deg: float = 20.0
    """Angle from which the axes of a target count as turned against those of the output."""
    part_of_turn: float = 0.45
    """Share of a turn around the earth, on each side of a longitude, that is mapped without a cut."""
    slack_of_turn: float = 1e-3
    """Share of a turn by which an extent may lack some of the whole earth."""


OUTPUT_GRIDS: Final = OutputGridParameters()
"""Those in use."""


def pixel_sizes(lattice: Grid, reference: Grid, target: Grid, rasters: Sequence[Grid]) -> list[Float64]:
    """Return the pixel sizes of the target and other rasters of its geometry on an output grid.

    Where the output has the CRS and the axes of a raster, its size is kept exactly. In another CRS of the
    same linear unit, or on rotated axes, it is kept too (30 m), unless the scales of the maps differ by more
    than 10 %. Otherwise pixels are as long as the target's along its finer axis: a multiple or fraction of
    the reference's size that is within 2 %, or else a square of two significant digits. The sizes of the
    other rasters keep their ratio to the target's. Raises `InputError` if the middle of the target cannot be
    transformed to the output's CRS.

    Parameters
    ----------
    lattice : Grid
        One map unit per pixel, with the axes and the CRS of the output.
    reference, target : Grid
        The original grids.
    rasters : sequence of Grid
        Grids of the other rasters.

    Returns
    -------
    list of (2,) arrays
        Pixel sizes of the target and then of each raster, map units along the axes of the lattice.
    """
    reference_size = _lengths(reference) if reference.crs == lattice.crs else None
    exact = _own_size(lattice, target, reference_size)
    first = _size_elsewhere(lattice, target, reference_size) if exact is None else exact
    sizes = [first]
    for raster in rasters:
        exact = _own_size(lattice, raster, reference_size)
        sizes.append(first * _ratio(lattice, raster, target) if exact is None else exact)
    return sizes


def snapped_size(size: float, tolerance: float = OUTPUT_GRIDS.same_across_units) -> float:
    """Return the multiple or fraction of 1 within the relative `tolerance` of `size`, or `size` itself."""
    whole = max(1, round(max(size, 1.0 / size)))
    nearest = float(whole) if size >= 1.0 else 1.0 / whole
    return nearest if abs(size / nearest - 1.0) <= tolerance else size


def _own_size(lattice: Grid, raster: Grid, reference_size: Float64 | None) -> Float64 | None:
    """Return the (2,) size of a raster with the output's CRS and directions of axes; None for others."""
    if raster.crs != lattice.crs:
        return None
    matrix = np.abs(inverse(linear_part(lattice.transform)) @ linear_part(raster.transform))
    if matrix[0, 1] > matrix[0, 0]:
        matrix = matrix[:, ::-1]  # columns along y
    if max(matrix[0, 1], matrix[1, 0]) > 1e-9 * matrix.max():
        return None
    size: Float64 = np.diagonal(matrix).copy()
    return size if reference_size is None else _or_equal(size, reference_size)


def _size_elsewhere(lattice: Grid, target: Grid, reference_size: Float64 | None) -> Float64:
    """Return the (2,) pixel size of a target in another CRS, or on rotated axes."""
    across, swapped = _steps_across(lattice, target)
    if type(target) is Grid and _same_unit(lattice, target):
        nominal = _lengths(target)[:: -1 if swapped else 1]
        square = abs(nominal[0] / nominal[1] - 1.0) <= OUTPUT_GRIDS.same
        if (square or not _turned(lattice, target)) and np.all(
            np.abs(across / nominal - 1.0) <= OUTPUT_GRIDS.same_scale
        ):
            return nominal if reference_size is None else _or_equal(nominal, reference_size)
    if reference_size is not None:
        ratio = np.array([snapped_size(value) for value in across / reference_size])
        whole = np.maximum(ratio, 1.0 / ratio)
        if np.all(np.abs(whole - np.rint(whole)) <= OUTPUT_GRIDS.same):
            return ratio * reference_size
    side = float(f"{across.min():.1e}")
    return np.array([side, side])


def _same_unit(lattice: Grid, target: Grid) -> bool:
    if target.crs is None or lattice.crs is None:
        return target.crs == lattice.crs  # without a CRS both lie in one plane
    return bool(to_pyproj(target.crs).axis_info[0].unit_name == to_pyproj(lattice.crs).axis_info[0].unit_name)


def _or_equal(size: Float64, reference_size: Float64) -> Float64:
    return np.where(np.abs(size / reference_size - 1.0) <= OUTPUT_GRIDS.same, reference_size, size)


def _ratio(lattice: Grid, raster: Grid, target: Grid) -> Float64:
    """Return the (2,) ratio of a raster's pixel size to the target's, along the axes of the output."""
    ratio = np.array(
        [snapped_size(value, OUTPUT_GRIDS.same) for value in _lengths(raster) / _lengths(target)]
    )
    return ratio[:: -1 if _steps_across(lattice, target)[1] else 1]


def _steps_across(lattice: Grid, target: Grid) -> tuple[Float64, bool]:
    """Return the (2,) steps along the output's axes that cross one pixel in the middle of the target.

    The second value is whether the target's columns run along the output's second axis.
    """
    forward = _slopes(lattice, target)
    if not np.isfinite(forward).all():
        raise InputError(
            f"the middle of the target cannot be transformed from {name_of(target.crs)} to "
            f"{name_of(lattice.crs)}: crop it to where that CRS is valid, or use --grid target"
        )
    return 1.0 / np.hypot(*inverse(forward)), bool(abs(forward[0, 0]) < abs(forward[0, 1]))


def _slopes(lattice: Grid, target: Grid) -> Float64:
    """Return the (2, 2) lattice px per px in the middle of a target, or of what of it the lattice shows."""
    slopes = jacobian(target.middle_px, target, lattice)[0]
    if not np.isfinite(slopes).all():
        area, _ = footprint(target, lattice)
        at_px = shapely.get_coordinates(area.representative_point())
        slopes = jacobian(map_px(at_px, lattice, target), target, lattice)[0] if len(at_px) else slopes
    return np.asarray(slopes)


def _turned(lattice: Grid, target: Grid) -> bool:
    """Whether no axis of the target is near one of the output, so that its two sizes cannot be assigned."""
    forward = np.abs(_slopes(lattice, target))
    share = forward.min(axis=0) / forward.max(axis=0)
    return bool(share.max() > np.tan(np.radians(OUTPUT_GRIDS.turned_deg)))


def _lengths(grid: Grid) -> Float64:
    """Return the (2,) lengths of a pixel along columns and rows, map units."""
    return np.asarray(np.hypot(*linear_part(grid.transform)))


@dataclass(frozen=True, slots=True)
class GridRequest:
    """The user's request for the output grid; the default is the reference's alignment, own pixel size."""

    mode: Literal["reference", "reference-exact", "target"] = "reference"
    like: Grid | None = None
    """The exact grid to use."""
    pixel_size: tuple[float, float] | None = None
    """Pixel size along x and y, units of the output's CRS."""
    extent: tuple[float, float, float, float] | None = None
    """Extent (x_min, y_min, x_max, y_max) in the output's CRS."""
    crs: CRS | None = None
    """CRS of the output; the reference's by default."""

    @property
    def needs_ground(self) -> bool:
        """Whether the request needs map coordinates."""
        return any(option is not None for option in (self.like, self.pixel_size, self.extent, self.crs))

    def fixed(self, reference: Grid) -> Grid | None:
        """Return the grid if it does not depend on the raster, else None."""
        return reference if self.mode == "reference-exact" else self.like


def output_grid(
    reference_grid: Grid, target_grid: Grid, correction: Correction, request: GridRequest | None = None
) -> Grid:
    """Return the grid of the registered target alone.

    The parameters `reference_grid`, `target_grid`, `correction` and `request` are those of `output_grids`.
    """
    return output_grids(reference_grid, target_grid, correction, request, (target_grid,))[0]


def output_grids(
    reference_grid: Grid,
    target_grid: Grid,
    correction: Correction,
    request: GridRequest | None,
    rasters: Sequence[Grid],
) -> list[Grid]:
    """Return the grids of the registered target's bands: one extent for all, whatever their pixel sizes.

    By default they have the CRS, the axes and the pixel corners of the reference and the sizes of
    `pixel_sizes`, and cover the corrected footprint of the target, rounded outwards to whole pixels of the
    coarsest raster, in the turn around the earth of the reference. Where the outline of the target is not
    defined in their CRS, they cover what is, around the reference: as far again as it on each side. A raster
    that extends beyond that by more than such a pixel enlarges it. Where the reference or the target has no
    map coordinates, the outputs have the reference's grid. The `rasters` are the grids of the target itself,
    or of others of its geometry; the correction maps predicted to observed target pixels. Raises `InputError`
    if a footprint cannot be transformed to the CRS of the output or by the correction, or the requested grid
    has no pixel, or too many.
    """
    request = request or GridRequest()
    fixed = request.fixed(reference_grid)
    if fixed is not None and fixed.swath_uri:
        raise InputError(f"{fixed.swath_uri} is a swath, and has no grid for an output: give --grid target")
    if fixed is not None:
        check_grid("the output grid", fixed.shape[::-1])
        if fixed.located and target_grid.located:
            _check_pixel(fixed, target_grid)
        return [fixed] * len(rasters)
    on_map = all(type(grid) is Grid for grid in rasters)
    if request.mode == "target" and on_map:
        return list(rasters)
    if request.mode == "target":  # a swath has no grid of its own
        request = replace(request, crs=request.crs or WGS84)
    if not (reference_grid.located and target_grid.located):
        return [reference_grid] * len(rasters)
    lattice = output_lattice(reference_grid, request)
    ref_box = bounds_of(footprint(reference_grid, lattice)[0])
    boxes = [_footprint(grid, target_grid, correction, lattice, ref_box) for grid in (target_grid, *rasters)]
    sizes = pixel_sizes(lattice, reference_grid, target_grid, rasters)
    grids = lay_out(lattice, request, boxes, sizes)
    source_px = sum(float(grid.shape[0]) * grid.shape[1] for grid in (reference_grid, target_grid, *rasters))
    for grid in grids:
        check_grid("the output grid", grid.shape[::-1], source_px)
        _check_pixel(grid, target_grid)
    return grids


def _check_pixel(grid: Grid, target: Grid) -> None:
    """Raise where the pixels of an output grid are too large relative to those of the target."""
    steps = jacobian(target.middle_px, target, grid)[0]
    if np.isfinite(steps).all():
        check_output_pixel(np.linalg.svd(steps, compute_uv=False).tolist())


def output_lattice(reference: Grid, request: GridRequest) -> Grid:
    """Return the lattice to which the pixels of an output are aligned: one map unit per pixel.

    It has the corner and the axes of the reference. It is north up if a pixel size or an extent is
    requested, as for gdalwarp, and starts at the origin of the CRS if that is not the reference's.
    """
    own = WGS84 if reference.swath_uri else reference.crs
    crs, place = request.crs or own, reference.transform
    rows, cols = np.ceil(np.multiply(reference.shape, _lengths(reference)[::-1])).astype(int).tolist()
    if crs != reference.crs:
        return Grid(reference.shape, Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0), crs)
    if request.pixel_size is not None or request.extent is not None:
        return Grid((rows, cols), Affine(1.0, 0.0, place.c, 0.0, -1.0, place.f), crs)
    (a, b), (d, e) = (linear_part(place) / np.hypot(*linear_part(place))).tolist()
    return Grid((rows, cols), Affine(a, b, place.c, d, e, place.f), crs)


def lay_out(
    lattice: Grid, request: GridRequest, boxes: Sequence[Box], sizes: Sequence[Float64]
) -> list[Grid]:
    """Return the grids of rasters that share an extent.

    Raises `InputError` if a grid has no pixel, or too many. For the `lattice` see `output_lattice`; of the
    request its pixel size and extent are used. The `boxes` are lowest and highest (x, y) of the target and
    then of each raster, lattice px, in (2,) arrays; `sizes` are their pixel sizes (x, y), (2,) arrays too.
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
    first = np.floor(low / step + OUTPUT_GRIDS.sliver_px)
    steps = np.maximum(np.ceil(high / step - OUTPUT_GRIDS.sliver_px) - first, 1)
    return [_laid(lattice, first * step, size, _count(steps, step, size)) for size in sizes[1:]]


def check_covered(
    grid: Grid, footprint_xy: Float64, footprint_crs: CRS | None, *, tolerance: float = 0.0
) -> None:
    """Check that an output grid overlaps a raster.

    Its outline is the (n, 2) `footprint_xy`, map coordinates (x, y). Nothing is checked if only one of its
    CRS and the grid's is None, the grid has no map coordinates, or the outline cannot be transformed. A
    distance between the two of `tolerance`, as a share of the raster's larger side, is tolerated. Raises
    `InputError` if the two do not overlap.
    """
    if (footprint_crs is None) != (grid.crs is None) or not grid.located or not len(footprint_xy):
        return
    plain = Grid(grid.shape, Affine.identity(), footprint_crs)
    outline = footprint(plain, grid, footprint_xy)[0] if np.isfinite(footprint_xy).all() else shapely.Point()
    if outline.is_empty:
        return
    low, high = bounds_of(outline)
    if shown_by(grid, outline.buffer(tolerance * float((high - low).max()))).area > 0:
        return
    rows, cols = grid.shape
    (left, top), (right, bottom) = grid.to_xy(np.array([[0.0, 0.0], [cols, rows]])).tolist()
    xy = grid.to_xy(shapely.get_coordinates(outline))
    (x_min, y_min), (x_max, y_max) = xy.min(axis=0), xy.max(axis=0)
    where = "in the plane of their geotransforms" if grid.crs is None else f"in {name_of(grid.crs)}"
    raise InputError(
        f"the output grid shows nothing of the target: {where} it covers x {left:.10g} to "
        f"{right:.10g}, y {bottom:.10g} to {top:.10g}, and the target x {x_min:.10g} to {x_max:.10g}, "
        f"y {y_min:.10g} to {y_max:.10g}: change --te, --t-srs or --like"
    )


def mapped_parts(target: Grid) -> tuple[float, ...]:
    """Return the `turns` of `original_pixels` that map all of a raster: three if it is around the earth."""
    x = target.to_xy(target.boundary_px())[:, 0]
    return (0.0, 0.5, -0.5) if np.ptp(x) > 2 * OUTPUT_GRIDS.part_of_turn * target.turn else (0.0,)


def original_pixels(
    own_grid: Grid, target_grid: Grid, correction: Correction, grid: Grid, *, turns: float = 0.0
) -> Callable[[Float64], Float64]:
    """Return the mapping from output pixels to the original pixels that show the same ground.

    Output pixel → predicted target pixel → observed target pixel → pixel of the raster. `own_grid` is that of
    the raster: the target, or another one of its geometry; the correction maps pixels of `target_grid`. Where
    the output `grid` or the raster has no map coordinates, its pixels are the predicted ones. The callable
    maps (n, 2) output pixels (col, row) to (n, 2) pixels (col, row) of the raster. These are continuous and
    NaN almost half the earth around from the middle of the target, or from a place so many `turns` east.
    """
    both_located, turn = own_grid.located and grid.located, target_grid.turn
    about = float(target_grid.to_xy(target_grid.middle_px)[0, 0]) + (turns * turn if turns else 0.0)

    def mapping(at_px: Float64) -> Float64:
        if not both_located:
            return map_px(correction.forward(at_px), target_grid, own_grid)
        xy = transform_xy(grid.to_xy(at_px), grid.crs, target_grid.crs)
        xy = in_turn(xy, about, turn)
        xy = np.where(np.abs(xy[:, :1] - about) <= OUTPUT_GRIDS.part_of_turn * turn, xy, np.nan)
        observed_px = target_grid.observed_px(xy, correction.forward)
        return observed_px if own_grid == target_grid else own_grid.to_px(target_grid.to_xy(observed_px))

    return mapping


def corrected_outline(target: Grid, correction: Correction) -> Float64:
    """Return the outline of the ground that a `target` shows once corrected by `correction`.

    It has (n, 2) map coordinates (x, y) in the target's CRS.
    """
    return target.to_xy(correction.inverse(target.boundary_px()))


def _footprint(raster: Grid, target: Grid, correction: Correction, lattice: Grid, ref_box: Box) -> Box:
    """Return the bounding box of a corrected raster, lattice px, in the turn of that of the reference."""
    outline_px = correction.inverse(map_px(raster.boundary_px(), raster, target))
    area, whole = shapely.Polygon(), False
    if np.isfinite(outline_px).all():
        area, whole = footprint(target, lattice, outline_px)
    if not whole and np.isfinite(ref_box).all():
        size = ref_box[1] - ref_box[0]
        area = area.intersection(shapely.box(*(ref_box[0] - size), *(ref_box[1] + size)))
    if area.is_empty:
        raise InputError(
            f"the target's footprint cannot be transformed from {name_of(target.crs)} to "
            f"{name_of(lattice.crs)}: crop it to where that CRS is valid, or use --grid target"
        )
    return _in_turn_of(ref_box, bounds_of(area), lattice.turn_px) if whole else bounds_of(area)


def _in_turn_of(ref_box: Box, box: Box, turn_px: Float64 | None) -> Box:
    """Return a box moved around the earth to the reference's, which one of all the earth then holds."""
    if turn_px is None or not np.isfinite(ref_box).all():
        return box
    turn, middle = float(np.hypot(*turn_px)), (ref_box[0] + ref_box[1]) / 2
    shift = np.rint((middle - (box[0] + box[1]) / 2) @ turn_px / turn**2) * turn_px
    low, high = box[0] + shift, box[1] + shift
    slack = OUTPUT_GRIDS.slack_of_turn * turn
    if high[0] - low[0] > turn - slack and (
        ref_box[0][0] < low[0] - slack or ref_box[1][0] > high[0] + slack
    ):
        low[0], high[0] = middle[0] - turn / 2, middle[0] + turn / 2
    return low, high


def _count(steps: Float64, step: Float64, size: Float64) -> Float64:
    """Return the (2,) numbers of pixels of a size that cover a number of steps."""
    ratio = step / size
    whole = np.rint(ratio)
    exact = np.abs(ratio / whole - 1.0) <= OUTPUT_GRIDS.same
    return np.where(exact, steps * whole, np.ceil(steps * ratio - OUTPUT_GRIDS.sliver_px))


def _within(lattice: Grid, request: GridRequest, size: Float64, step: Float64) -> Grid:
    """Return the grid of the user's extent, as for gdalwarp: -te, with -tr or without."""
    if request.extent is None:
        raise TypeError("there is no extent")
    x_min, y_min, x_max, y_max = request.extent
    sides = np.array([x_max - x_min, y_max - y_min])
    corner = Grid(lattice.shape, Affine(1.0, 0.0, x_min, 0.0, -1.0, y_max), lattice.crs)
    if request.pixel_size is not None:
        return _laid(corner, np.zeros(2), size, np.floor(sides / size + 0.5))
    counts = _count(np.maximum(np.floor(sides / step + 0.5), 1), step, size)
    return _laid(corner, np.zeros(2), sides / counts, counts)


def _laid(lattice: Grid, origin_px: Float64, size: Float64, counts: Float64) -> Grid:
    """Return the grid of (2,) counts of pixels of a (2,) size, from an origin on the lattice on."""
    if not (counts >= 1).all() or (counts > 2**31 - 1).any():  # GDAL's limit
        raise InputError(
            f"the output grid would have {counts[0]:.0f} x {counts[1]:.0f} pixels of {size[0]:.10g} x "
            f"{size[1]:.10g}: check --te and --tr, which are in units of {name_of(lattice.crs)}"
        )
    linear = ((float(size[0]), 0.0), (0.0, float(size[1])))
    cols, rows = counts.astype(int).tolist()
    return lattice.resampled_grid(linear, (float(origin_px[0]), float(origin_px[1])), (rows, cols))
