"""Geolocation arrays, as GDAL's metadata domain GEOLOCATION names them, and the grids that they place."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.crs import WGS84, transform_xy
from pcwlad_geo.raster.grid import Grid, PixelMapping, apply, apply_inverse
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.swath import Swath, fitted_swath
from pcwlad_geo.raster.trust.destinations import destination
from pcwlad_geo.raster.trust.local_files import OnDisk, Stamp
from pcwlad_geo.types import Bool, Float64

DOMAIN: Final = "GEOLOCATION"
"""GDAL's metadata domain."""


@dataclass(frozen=True, slots=True)
class GeolocationParameters:
    """Which values of arrays count."""

    min_valid: float = 0.5
    """Least share of positions that have to be known."""
    latitudes: float = 90.0
    longitudes: float = 360.0
    """Largest of each, degrees."""


GEOLOCATION: Final = GeolocationParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class GeolocationArrays:
    """Which arrays hold the map coordinates of an image's pixels."""

    names: tuple[str, str]
    """GDAL's names of the rasters of x and y."""
    bands: tuple[int, int]
    crs: str
    """That of the coordinates, as text."""
    origin_px: tuple[float, float]
    """Pixel (col, row), corner-based, of the first values."""
    step_px: tuple[float, float]

    @classmethod
    def of_file(cls, uri: str, dataset: DatasetReader) -> GeolocationArrays | None:
        """Return the arrays that the metadata of an open raster name; None where they name none.

        Raises `InputError` if the metadata make no sense.
        """
        tags = dataset.tags(ns=DOMAIN)
        if not {"X_DATASET", "Y_DATASET"} <= tags.keys():
            return None
        centre = 0.5 if tags.get("GEOREFERENCING_CONVENTION") == "PIXEL_CENTER" else 0.0
        try:
            col, row = (float(tags.get(f"{axis}_OFFSET", 0)) + centre for axis in ("PIXEL", "LINE"))
            across, down = (float(tags.get(f"{axis}_STEP", 1)) for axis in ("PIXEL", "LINE"))
            bands = int(tags.get("X_BAND", 1)), int(tags.get("Y_BAND", 1))
            crs = tags.get("SRS") or WGS84.to_string()
            CRS.from_user_input(crs)
        except (ValueError, CRSError) as error:
            raise InputError(f"{uri}: its geolocation makes no sense: {error}") from error
        if not (math.isfinite(col + row) and min(across, down) > 0 and math.isfinite(across + down)):
            raise InputError(f"{uri}: its geolocation has no pixels of a size: {dict(tags)}")
        return cls((tags["X_DATASET"], tags["Y_DATASET"]), bands, crs, (col, row), (across, down))


@dataclass(frozen=True, slots=True)
class SwathGrid(Grid):
    """A grid whose pixels geolocation arrays place, in a plane around their middle.

    Its geotransform is that which fits them best, from which the arrays say how far the pixels are away.
    """

    arrays: GeolocationArrays
    file_transform: Affine
    """The geotransform of the file's pixels; `transform` is that of these (of an overview, of a part)."""
    uri: str = field(compare=False)
    """Path or GDAL URI of the raster."""

    @property
    def swath_uri(self) -> str:
        """Path or GDAL URI of the raster whose metadata name the arrays."""
        return self.uri

    def has_plane_of(self, other: Grid) -> bool:
        """Whether another grid is placed by the same arrays."""
        return isinstance(other, SwathGrid) and self.arrays == other.arrays

    def to_xy(self, pixel_xy_px: Float64) -> Float64:
        """Map (n, 2) `pixel_xy_px` (col, row) to (n, 2) map coordinates (x, y); NaN without a value."""
        file_px = apply_inverse(self.file_transform, apply(self.transform, pixel_xy_px))
        return apply(self.file_transform, swath_of(self.arrays).flat_px(file_px))

    def to_px(self, xy: Float64) -> Float64:
        """Map (n, 2) map coordinates `xy` to (n, 2) pixels (col, row); NaN without a value."""
        file_px = swath_of(self.arrays).own_px(apply_inverse(self.file_transform, xy))
        return apply_inverse(self.transform, apply(self.file_transform, file_px))

    def within_scans(self, at_px: Float64) -> Float64:
        """Return (n, 2) pixels halfway between `at_px` and the middle rows of their scans, if any."""
        file_px = apply_inverse(self.file_transform, apply(self.transform, at_px))
        inner_px = swath_of(self.arrays).within_scans(file_px)
        return apply_inverse(self.transform, apply(self.file_transform, inner_px))

    def observed_px(self, xy: Float64, forward: PixelMapping) -> Float64:
        """Map (n, 2) map coordinates `xy` to (n, 2) pixels that show them; a correction leaves no scan."""
        if self.transform != self.file_transform:
            return forward(self.to_px(xy))
        return swath_of(self.arrays).own_px(apply_inverse(self.file_transform, xy), forward)

    def corrected_xy(self, at_px: Float64, inverse: PixelMapping) -> Float64:
        """Map (n, 2) pixels `at_px` to (n, 2) map coordinates; a correction leaves no scan."""
        if self.transform != self.file_transform:
            return self.to_xy(inverse(at_px))
        return apply(self.file_transform, swath_of(self.arrays).flat_px(at_px, inverse))


def swath_grid(uri: str, dataset: DatasetReader) -> SwathGrid | None:
    """Return the grid of an open raster that its geolocation arrays place; None of a raster without them.

    Raises `InputError` if they cannot be read, or do not place it, and `TrustError` if they may not be read.
    """
    arrays = GeolocationArrays.of_file(uri, dataset)
    if arrays is None:
        return None
    with open_raster(arrays.names[0]) as file:
        if min(file.shape) < 2:
            return None  # an axis each, of a map grid
    swath, shape = swath_of(arrays), dataset.shape
    nodes = np.array(swath.valid.shape[::-1])
    reach = np.array(arrays.origin_px) + np.array(arrays.step_px) * (nodes - 0.5)
    if not np.all(np.abs(reach - shape[::-1]) <= 2 * np.array(arrays.step_px)):
        raise InputError(
            f"{uri} has {shape[1]} x {shape[0]} pixels, and its geolocation arrays reach to {reach[0]:g} x "
            f"{reach[1]:g}: they are of another image"
        )
    return SwathGrid(shape, swath.transform, plane_of(arrays), arrays, swath.transform, uri)


def swath_of(arrays: GeolocationArrays) -> Swath:
    """Return what the arrays say; raise `InputError` if they cannot be read, or say too little."""
    return _loaded(arrays, _stamps(arrays))[0]


def plane_of(arrays: GeolocationArrays) -> CRS:
    """Return the CRS of the plane in which the arrays are used: equal-area, around their middle."""
    return _loaded(arrays, _stamps(arrays))[1]


def _stamps(arrays: GeolocationArrays) -> tuple[Stamp, ...]:
    return tuple(OnDisk(Path(destination(name).path)).stamp() for name in arrays.names)


@lru_cache(maxsize=4)  # a job asks for every tile
def _loaded(arrays: GeolocationArrays, _: tuple[Stamp, ...]) -> tuple[Swath, CRS]:
    (x, x_valid), (y, y_valid) = (
        _read(name, band) for name, band in zip(arrays.names, arrays.bands, strict=True)
    )
    if x.shape != y.shape:
        raise InputError(f"the geolocation arrays {' and '.join(arrays.names)} have not the same size")
    xy, valid = np.stack([x, y], axis=2), x_valid & y_valid
    crs = CRS.from_user_input(arrays.crs)
    if crs.is_geographic:
        valid &= (
            (np.abs(x) <= GEOLOCATION.longitudes)
            & (np.abs(y) <= GEOLOCATION.latitudes)
            & ((x != 0) | (y != 0))
        )
    if valid.mean() < GEOLOCATION.min_valid:
        raise InputError(
            f"the geolocation arrays {' and '.join(arrays.names)} have values for {valid.mean():.0%} of "
            "their pixels, which is too little: crop the image to where it is placed"
        )
    plane = _plane_around(transform_xy(xy[valid], crs, WGS84))
    in_plane = np.full_like(xy, np.nan)
    in_plane[valid] = transform_xy(xy[valid], crs, plane)
    valid &= np.isfinite(in_plane).all(axis=2)
    return fitted_swath(in_plane, valid, arrays.origin_px, arrays.step_px), plane


def _read(name: str, band: int) -> tuple[Float64, Bool]:
    with open_raster(name) as file:
        if file.width * file.height > LIMITS.file_px or not 1 <= band <= file.count:
            raise InputError(f"the geolocation array {name} has no band {band}, or is too large to be read")
        values = file.read(band, masked=True)
        scale, offset = file.scales[band - 1], file.offsets[band - 1]
    known = ~np.ma.getmaskarray(values)
    numbers = values.data.astype(np.float64) * scale + offset
    return numbers, known & np.isfinite(numbers)


def _plane_around(lon_lat: Float64) -> CRS:
    """Return the equal-area plane around the middle of (n, 2) longitudes and latitudes, in whole degrees."""
    lon, lat = np.radians(lon_lat).T
    x, y, z = np.mean([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
    middle = np.degrees([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
    lon_0, lat_0 = np.rint(middle).astype(int).tolist()
    plane = CRS.from_user_input(f"+proj=laea +lon_0={lon_0} +lat_0={lat_0} +datum=WGS84 +units=m +type=crs")
    return CRS.from_wkt(plane.to_wkt().replace('"unknown"', '"plane of the swath"', 1))
