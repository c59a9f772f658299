"""Swaths of the synthetic scene, whose lines bend and whose pixels grow to the sides, in netCDF-4."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.raster import WGS84, Grid, transform_xy
from pcwlad_geo.raster.grid import apply
from tests.scenes import Array, make_grid, render

DIMENSION = "This is a netCDF dimension but not a netCDF variable. {:9d}"
"""How netCDF-4 names what HDF5 needs for a dimension without coordinates."""


@dataclass(frozen=True, slots=True)
class Bent(Grid):
    """The truth of a swath: wider pixels at its sides, bent lines; scans of some rows, if any, overlap."""

    scan_rows: int = 0

    def to_xy(self, pixel_xy_px: Array) -> Array:
        rows, cols = self.shape
        col, row = pixel_xy_px.T
        u = (col - cols / 2) / (cols / 2)
        if self.scan_rows:
            scan = np.clip(np.floor(row / self.scan_rows), 0, rows // self.scan_rows - 1)
            middle = (scan + 0.5) * self.scan_rows
            row = middle + (row - middle) * (1 + 0.5 * u**2)
        bent = [cols / 2 * (1 + u + 0.12 * u**3) + 6 * (row / rows) ** 2, row + 5 * u**2]
        return apply(self.transform, np.column_stack(bent))


def bent(shape: tuple[int, int] = (208, 200), scan_rows: int = 0, **options: Any) -> Bent:
    """Return a swath across the scene; the options are those of `make_grid`."""
    base = make_grid(shape, rotation_deg=12, **({"offset_m": (1500, -500)} | options))
    return Bent(shape, base.transform, base.crs, scan_rows)


def pixels(grid: Grid) -> Array:
    """Return the middles of all pixels, row by row."""
    rows, cols = grid.shape
    return np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5), axis=-1).reshape(-1, 2)


def lon_lat_of(grid: Grid) -> Array:
    """Return (2, rows, cols) longitudes and latitudes of the middles of the pixels."""
    return transform_xy(grid.to_xy(pixels(grid)), grid.crs, WGS84).T.reshape(2, *grid.shape)


def seen_by(grid: Grid, band: str = "red", **options: Any) -> Array:
    """Render a band on a swath; the options are those of `render`."""
    return render(grid, band, local=np.zeros_like, **options)


def write_swath(path: Path, image: NDArray[np.generic], lon_lat: Array) -> str:
    """Write an image with its geolocation arrays as NASA's level 2 has them, and return GDAL's name of it."""
    h5py: Any = __import__("h5py")
    with h5py.File(path, "w") as file:
        file.attrs["Conventions"] = np.bytes_("CF-1.6")
        axes = []
        for name, size in zip(("number_of_lines", "pixels_per_line"), image.shape, strict=True):
            axis = file.create_dataset(name, (size,), dtype=">f4")
            axis.make_scale(DIMENSION.format(size))
            axes.append(axis)
        arrays = {"geophysical_data/sst": image.astype("f4")}
        for name, values in zip(("longitude", "latitude"), lon_lat, strict=True):
            arrays[f"navigation_data/{name}"] = values.astype("f4")
        for name, values in arrays.items():
            array = file.create_dataset(name, data=values)
            for axis, scale in zip(array.dims, axes, strict=True):
                axis.attach_scale(scale)
        for name, unit in (("longitude", "degrees_east"), ("latitude", "degrees_north")):
            file[f"navigation_data/{name}"].attrs["units"] = np.bytes_(unit)
            file[f"navigation_data/{name}"].attrs["standard_name"] = np.bytes_(name)
    return f'NETCDF:"{path}":/geophysical_data/sst'
