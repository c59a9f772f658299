"""How large the pixels of an output are: those of the raster, in the units of the output's CRS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import name_of, to_pyproj
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part

Array = NDArray[np.float64]

_SAME: Final = 1e-6
"""Pixel sizes this close, relatively, are equal."""
_SAME_ACROSS_UNITS: Final = 0.02
"""Where units cannot be compared, sizes so close to a multiple or fraction of the reference's become that."""
_SAME_SCALE: Final = 0.1
"""Two maps in metres whose scales differ by less keep a pixel size: 30 m stay 30 m."""
_ALIGNED: Final = 1e-9
"""Least share of a pixel's side by which axes that are parallel may differ."""


def pixel_sizes(lattice: Grid, reference: Grid, target: Grid, rasters: Sequence[Grid]) -> list[Array]:
    """Return the pixel sizes that the target and other rasters of its geometry get on an output grid.

    Where CRS and axes are the raster's own, its size stays exactly. In another CRS in the same linear unit,
    or on turned axes, it stays too (30 m), unless the maps' scales differ by more than 10 %. Else pixels
    are as long as the target's along its finer axis: the reference's own size, or a multiple or fraction of
    it, that is within 2 %, or a square of two significant digits. Sizes of the other rasters keep their ratio
    to the target's.

    Parameters
    ----------
    lattice : Grid
        One map unit a pixel, with the axes and the CRS of the output.
    reference : Grid
    target : Grid
    rasters : sequence of Grid

    Returns
    -------
    list of (2,) arrays
        Of the target and each raster, map units along the axes of the lattice.

    Raises
    ------
    InputError
        If the middle of the target cannot be placed in the output's CRS.
    """
    reference_size = _lengths(reference) if reference.crs == lattice.crs else None
    own = _own_size(lattice, target, reference_size)
    first = _size_elsewhere(lattice, target, reference_size) if own is None else own
    sizes = [first]
    for raster in rasters:
        own = _own_size(lattice, raster, reference_size)
        sizes.append(first * _ratio(lattice, raster, target) if own is None else own)
    return sizes


def snapped_size(size: float, tolerance: float = _SAME_ACROSS_UNITS) -> float:
    """Return the whole multiple or fraction of 1 that a size agrees with, or the size itself."""
    whole = max(1, round(max(size, 1.0 / size)))
    nearest = float(whole) if size >= 1.0 else 1.0 / whole
    return nearest if abs(size / nearest - 1.0) <= tolerance else size


def _own_size(lattice: Grid, raster: Grid, reference_size: Array | None) -> Array | None:
    """Return the size of a raster with the CRS and the directions of axes of the output; None for others."""
    if raster.crs != lattice.crs:
        return None
    matrix = np.abs(np.linalg.inv(linear_part(lattice.transform)) @ linear_part(raster.transform))
    if matrix[0, 1] > matrix[0, 0]:
        matrix = matrix[:, ::-1]  # columns that run along y
    if max(matrix[0, 1], matrix[1, 0]) > _ALIGNED * matrix.max():
        return None
    size: Array = np.diagonal(matrix).copy()
    return size if reference_size is None else _or_equal(size, reference_size)


def _size_elsewhere(lattice: Grid, target: Grid, reference_size: Array | None) -> Array:
    """Return the size of a target in another CRS, or on turned axes."""
    across, swapped = _steps_across(lattice, target)
    if _same_unit(lattice, target):
        nominal = _lengths(target)[:: -1 if swapped else 1]
        square = abs(nominal[0] / nominal[1] - 1.0) <= _SAME
        if (square or not _turned(lattice, target)) and np.all(np.abs(across / nominal - 1.0) <= _SAME_SCALE):
            return nominal if reference_size is None else _or_equal(nominal, reference_size)
    if reference_size is not None:
        ratio = np.array([snapped_size(value) for value in across / reference_size])
        whole = np.maximum(ratio, 1.0 / ratio)
        if np.all(np.abs(whole - np.rint(whole)) <= _SAME):
            return ratio * reference_size
    side = float(f"{across.min():.1e}")
    return np.array([side, side])


def _same_unit(lattice: Grid, target: Grid) -> bool:
    if target.crs is None or lattice.crs is None:
        return target.crs == lattice.crs  # without a CRS both lie in one plane
    return bool(to_pyproj(target.crs).axis_info[0].unit_name == to_pyproj(lattice.crs).axis_info[0].unit_name)


def _or_equal(size: Array, reference_size: Array) -> Array:
    return np.where(np.abs(size / reference_size - 1.0) <= _SAME, reference_size, size)


def _ratio(lattice: Grid, raster: Grid, target: Grid) -> Array:
    """Return how many of the target's pixels those of another raster are long, along the output's axes."""
    ratio = np.array([snapped_size(value, _SAME) for value in _lengths(raster) / _lengths(target)])
    return ratio[:: -1 if _steps_across(lattice, target)[1] else 1]


def _steps_across(lattice: Grid, target: Grid) -> tuple[Array, bool]:
    """Return how long a step along each axis of the output is that crosses one pixel in the target's middle.

    And whether the target's columns run along the output's second axis.
    """
    centre_px = np.array([[target.shape[1] / 2, target.shape[0] / 2]])
    forward = jacobian(centre_px, target, lattice)[0]
    if not np.isfinite(forward).all():
        raise InputError(
            f"the middle of the target cannot be transformed from {name_of(target.crs)} to "
            f"{name_of(lattice.crs)}: crop it to where that CRS is valid, or use --grid target"
        )
    inverse = np.linalg.inv(forward)
    return 1.0 / np.hypot(*inverse), bool(abs(forward[0, 0]) < abs(forward[0, 1]))


def _turned(lattice: Grid, target: Grid) -> bool:
    """Whether no axis of the target lies near one of the output, so that its two sizes belong to none."""
    centre_px = np.array([[target.shape[1] / 2, target.shape[0] / 2]])
    forward = np.abs(jacobian(centre_px, target, lattice)[0])
    share = forward.min(axis=0) / forward.max(axis=0)
    return bool(share.max() > np.tan(np.radians(20.0)))


def _lengths(grid: Grid) -> Array:
    """Return the lengths of a pixel's sides, columns and rows, map units."""
    return np.asarray(np.hypot(*linear_part(grid.transform)))
