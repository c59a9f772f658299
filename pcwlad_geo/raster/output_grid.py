"""The grid of a registered raster, and the way from its pixels to those of the original."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.grid import Grid, jacobian, map_px

Array = NDArray[np.float64]
# Slivers of the footprint thinner than this get no pixel of their own.
_SLIVER_PX = 1e-3
# Pixel sizes this close to a multiple or a fraction of the reference's are taken as such across CRSs.
_SAME_SIZE_ACROSS_CRS = 0.02
_SAME_SIZE = 1e-6


def output_grid(
    reference_grid: Grid,
    target_grid: Grid,
    correction: Correction,
    mode: Literal["reference", "target"] = "reference",
    *,
    own_grid: Grid | None = None,
) -> Grid:
    """Return the grid of the registered raster.

    Parameters
    ----------
    reference_grid, target_grid : Grid
        The original grids.
    correction : Correction
        Maps predicted to observed target pixels.
    mode : {"reference", "target"}
        ``target``: the raster's own grid. ``reference``: CRS, axes and pixel corners of the
        reference with the raster's pixel size, over the whole corrected footprint of the
        raster; with equal pixel sizes that is the reference's own pixel lattice. Across CRSs a
        pixel size within 2 % of a multiple or fraction of the reference's becomes that.
        Where either has no CRS: the reference's pixels.
    own_grid : Grid, optional
        Of another raster of the target's geometry; the target's by default.

    Raises
    ------
    InputError
        If the footprint cannot be transformed to the reference CRS, or the correction has no place for it.
    """
    own = own_grid or target_grid
    if mode == "target":
        return own
    if reference_grid.crs is None or target_grid.crs is None:
        return reference_grid
    observed_px = map_px(own.boundary_px(), own, target_grid)
    boundary_px = map_px(correction.inverse(observed_px), target_grid, reference_grid)
    centre_px = np.array([[own.shape[1] / 2, own.shape[0] / 2]])
    inverse = jacobian(map_px(centre_px, own, reference_grid), reference_grid, own)[0]
    if not (np.isfinite(boundary_px).all() and np.isfinite(inverse).all()):
        raise InputError(
            f"the target's footprint cannot be transformed from {name_of(target_grid.crs)} to "
            f"{name_of(reference_grid.crs)}: crop it to where that CRS is valid, or use --grid target"
        )
    tolerance = _SAME_SIZE if reference_grid.crs == own.crs else _SAME_SIZE_ACROSS_CRS
    # A step along an axis of the reference that crosses one pixel of the raster, in reference pixels.
    size = np.array([snapped_size(1.0 / float(np.hypot(*column)), tolerance) for column in inverse.T])
    low = np.floor(boundary_px.min(axis=0) / size + _SLIVER_PX).astype(int)
    high = np.ceil(boundary_px.max(axis=0) / size - _SLIVER_PX).astype(int)
    cols, rows = (high - low).tolist()
    linear = ((float(size[0]), 0.0), (0.0, float(size[1])))
    origin_px = (float(low[0] * size[0]), float(low[1] * size[1]))
    return reference_grid.remade(linear, origin_px, (rows, cols))


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
        The output grid. Where it or the raster has no CRS, its pixels are the predicted ones.
    """
    placed = own_grid.crs is not None and grid.crs is not None

    def mapping(at_px: Array) -> Array:
        predicted_px = map_px(at_px, grid, target_grid) if placed else at_px
        return map_px(correction.forward(predicted_px), target_grid, own_grid)

    return mapping


def snapped_size(size: float, tolerance: float = _SAME_SIZE_ACROSS_CRS) -> float:
    """Return the whole multiple or fraction of 1 that a size agrees with, or the size itself."""
    whole = max(1, round(max(size, 1.0 / size)))
    nearest = float(whole) if size >= 1.0 else 1.0 / whole
    return nearest if abs(size / nearest - 1.0) <= tolerance else size
