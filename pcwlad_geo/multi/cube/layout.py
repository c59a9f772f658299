"""The layout of a cube of xarray: its axes, its grid and its times, checked before any pixel is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid, georeferencing_of
from pcwlad_geo.raster.raster import Raster

DIMENSION_NAMES: Final = (("time", "t"), ("y", "lat", "latitude"), ("x", "lon", "longitude"))
"""Dimensions of a DataArray that are times, rows and columns."""
CRS_NAMES: Final = ("epsg", "spatial_ref", "crs")
"""Coordinates that hold the CRS."""


@dataclass(frozen=True, slots=True, eq=False)
class CubeLayout:
    """The axes of a cube, the grid of its pixels and its times."""

    dims: tuple[str, str, str]
    """Names of the axes of times, rows and columns."""
    grid: Grid
    times: NDArray[np.datetime64]
    """(dates,) times, seconds, in the order of the cube."""

    @property
    def names(self) -> list[str]:
        """The dates as texts, with the time where a day has several."""
        days = [str(time)[:10] for time in self.times]
        return days if len(set(days)) == len(days) else [str(time) for time in self.times]

    def ordered(self, cube: Any) -> Any:  # noqa: ANN401  # of xarray, which need not be installed
        """Return a DataArray with the axes time, further ones, rows, columns."""
        time, y, x = self.dims
        return cube.transpose(time, ..., y, x)

    def number_of(self, date: Any) -> int:  # noqa: ANN401
        """Return the number of the only image of a date or time; raises `InputError` if there is none."""
        try:
            text = str(np.datetime64(date))
        except (TypeError, ValueError) as error:
            raise InputError(
                f"reference = {date!r}: give 'median', 'monthly', a date of the cube, or a DataArray"
            ) from error
        times = [str(time) for time in self.times]
        exact = [number for number, time in enumerate(times) if time == text[:19]]
        numbers = exact or [number for number, time in enumerate(times) if time.startswith(text[:10])]
        if len(numbers) != 1 or (len(text) < 10):
            what = "no image" if not numbers else f"{len(numbers)} images"
            raise InputError(
                f"reference = {date!r}: the cube has {what} of it: give one of its times, such as {times[0]}"
            )
        return numbers[0]


def layout_of(cube: Any) -> CubeLayout:  # noqa: ANN401  # of xarray, which need not be installed
    """Check a cube and return its layout; its pixels are not read.

    Raises `InputError` if it is no DataArray of times, rows and columns, has one date only, equal times, no
    CRS, uneven coordinates, or chunks that divide its images.
    """
    if not (hasattr(cube, "dims") and hasattr(cube, "chunks") and hasattr(cube, "dtype")):
        raise InputError(f"a {type(cube).__name__} is no cube: give an xarray.DataArray of (time, y, x)")
    dims = [str(name) for name in cube.dims]
    axes = [[name for name in dims if name in names] for names in DIMENSION_NAMES]
    if any(len(names) != 1 for names in axes) or len(dims) > 4:
        raise InputError(
            f"a DataArray of ({', '.join(dims)}) is no cube: it needs the dimensions time, y and x, and may "
            "have one of bands (rename, expand_dims('time'))"
        )
    time, y, x = (names[0] for names in axes)
    times = _times(cube, time)
    _check_chunks(cube, (y, x))
    return CubeLayout((time, y, x), grid_of(cube.transpose(..., y, x), "the cube"), times)


def grid_of(image: Any, what: str) -> Grid:  # noqa: ANN401  # of xarray, which need not be installed
    """Return the grid of a DataArray whose last axes are rows and columns.

    Raises `InputError`, in which it is called `what`, if it has no CRS, several, or no even coordinates.
    """
    for name in CRS_NAMES:
        values = image.coords[name].values if name in image.coords else np.empty(())
        if values.ndim and len(several := sorted({str(value) for value in values.ravel()})) > 1:
            raise InputError(
                f"{what} has several CRSs ({name}: {', '.join(several)}): load all images in one "
                "(odc.stac.load crs=…, stackstac.stack epsg=…)"
            )
    transform, crs = georeferencing_of(image)
    if crs is None or not crs:
        raise InputError(
            f"{what} has no CRS: give it one (cube.rio.write_crs('EPSG:32633'), "
            "cube.odc.assign_crs('EPSG:32633'))"
        )
    if transform is None:
        raise InputError(
            f"{what} has no coordinates along y and x: assign those of the centres of its pixels"
        )
    rows, cols = image.shape[-2:]
    place = Raster(np.zeros((1, 1), np.uint8), transform, crs)
    return Grid((rows, cols), transform, place.crs)


def same_pixels(one: Grid, other: Grid) -> bool:
    """Whether two grids have the same pixels, up to the rounding of coordinates."""
    corners = [grid.to_xy(np.array([[0.0, 0.0], grid.shape[::-1]])) for grid in (one, other)]
    off_px = np.abs(one.to_px(corners[1]) - one.to_px(corners[0])).max()
    return one.shape == other.shape and one.crs == other.crs and bool(off_px < 1e-3)


def _times(cube: Any, name: str) -> NDArray[np.datetime64]:  # noqa: ANN401
    if name not in cube.coords:
        raise InputError(f"the cube has no coordinate {name}: assign its dates (cube.assign_coords)")
    values = np.asarray(cube.coords[name].values)
    if values.dtype.kind != "M":
        raise InputError(
            f"the coordinate {name} of the cube holds {values.dtype} instead of dates: convert it "
            "(pandas.to_datetime)"
        )
    if np.isnat(values).any():
        raise InputError(
            f"{int(np.isnat(values).sum())} times of the cube are missing (NaT): leave these out"
        )
    if len(values) < 2:
        raise InputError(
            f"the cube has {'one' if len(values) else 'no'} date, and dates are aligned with each other: "
            "give more, or register the image to another (image.pcwlad.register(reference))"
        )
    seconds = values.astype("datetime64[s]")
    times, counts = np.unique(seconds, return_counts=True)
    if len(times) < len(seconds):
        twice = [str(time) for time in times[counts > 1]]
        raise InputError(
            f"{len(twice)} times of the cube come more than once ({', '.join(twice[:3])}): combine their "
            f"images (cube.groupby('{name}').first(), odc.stac.load groupby='solar_day')"
        )
    return seconds


def _check_chunks(cube: Any, axes: tuple[str, str]) -> None:  # noqa: ANN401
    """Raise `InputError` if chunks divide the images of a cube, which are read as a whole."""
    chunks = dict(zip(cube.dims, cube.chunks or (), strict=False))
    for name in axes:
        if len(chunks.get(name, ())) > 1:
            whole = f"{{'time': 1, '{axes[0]}': -1, '{axes[1]}': -1}}"
            raise InputError(
                f"the cube has {len(chunks[name])} chunks along {name}, and each image is read as a whole: "
                f"load it with one, or cube.chunk({whole})"
            )
