"""Descriptions of raster files (`RasterInfo`), with their checks."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.plausible import ALL_VALUES, Limits
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.areas import Areas, read_areas
from pcwlad_geo.raster.bands import BandPart, Bands
from pcwlad_geo.raster.basemap import Basemap, basemap_of
from pcwlad_geo.raster.cameras import Camera, camera_of
from pcwlad_geo.raster.collars import Collar
from pcwlad_geo.raster.crs import name_of, transformation_warnings
from pcwlad_geo.raster.georeferencing import check_place, grid_of_file, plane_transform_of
from pcwlad_geo.raster.grid import Grid, Window
from pcwlad_geo.raster.masks import MaskKind, kind_of
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.rpc.annotation import relief_m
from pcwlad_geo.raster.stored_pixels import check_dataset
from pcwlad_geo.types import Bool, PathLike

MAX_READ_PX: Final = 2**25
"""Largest number of pixels of a file without overviews that is read for an overview of it."""


@dataclass(frozen=True, slots=True)
class Fill:
    """Values of a band that count as nodata though nothing declares them, see `fill`."""

    value: float
    low: float
    """Values from here to `high` are not valid: resampling has mixed fill and data at its outline."""
    high: float
    share: float
    """Of the band's pixels that have exactly the value."""

    def is_data(self, values: NDArray[Any]) -> Bool:
        """Return the (n,) or (rows, cols) mask of the values, of the same shape, that are not of the fill.

        The `values` are an (n,) or (rows, cols) array of the band.
        """
        return np.asarray((values < self.low) | (values > self.high))


@dataclass(frozen=True, slots=True)
class RasterInfo:
    """Description of one band of one file, or of several as one image; small and picklable."""

    uri: str
    """Path or GDAL URI."""
    band: int
    """Number of the band, from 1; the first of several."""
    band_count: int
    grid: Grid
    georeferenced: bool
    """False without a CRS or without a geotransform (its own, or fitted to control points), unless the raster
    was placed by the other of its pair (see `matching_grid.share_plane`)."""
    dtype: str
    nodata: float | None
    mask_uri: str | None
    """A mask file given by the user or found in a product."""
    mask_grid: Grid | None = None
    """Grid of the mask file."""
    mask_kind: MaskKind = "zeros"
    """Meaning of the values of the mask."""
    areas: Areas | None = None
    """The ground that counts, see `with_areas`."""
    gcp_misfit_px: float | None = None
    """Largest residual of the control points that the grid is fitted to, px; None without such a fit."""
    plane_transform: Affine | None = None
    """The geotransform of a file that has one but no CRS."""
    brightness: bytes | None = None
    """Of a band with a colour table: the brightness of each of its indices, see `_brightness_of`."""
    collar: Collar | None = None
    """A constant border that counts as nodata, see `undeclared.without_collar`."""
    fills: tuple[Fill, ...] = ()
    """Values that count as nodata, see `fill.find_fills`; of several bands, in each of them."""
    shows_blocks: bool = False
    """Whether blocks of lossy compression show, see `with_compression_blocks`."""
    camera: Camera | None = None
    """What a file without georeferencing says of the camera that took it."""
    limits: Limits = ALL_VALUES
    """Values of the band beyond these count as nodata, see `undeclared.without_extremes`."""
    content: str = ""
    """Digest of the versions of the files (`identity.digest`), to detect changes; empty where unknown."""
    basemap: Basemap | None = None
    """What the file is a copy of, if that is a web service."""
    several: Bands | None = None
    """The bands, where there are several, with their weights, see `combined_bands.with_bands`."""

    @property
    def on_map(self) -> bool:
        """Whether other programs show the raster in map coordinates, by a geotransform."""
        return self.georeferenced and type(self.grid) is Grid

    @property
    def relief_m(self) -> float | None:
        """By how much the ground of a radar image varies in height, by its annotation; None without one."""
        return relief_m(self.uri)

    def as_in_file(self) -> RasterInfo:
        """Return the raster as its file places it, or not, where the user has placed it."""
        return describe(self.uri, band=self.band, part=True) if self.grid.by_hand else self


def bands_of(info: RasterInfo) -> Bands:
    """Return the bands that are read: the one, or several."""
    return info.several or Bands((BandPart(info.uri, info.band, limits=info.limits),))


def describe(
    path: str | os.PathLike[str],
    *,
    band: int = 1,
    mask: str | os.PathLike[str] | None = None,
    part: bool = False,
) -> RasterInfo:
    """Describe one band of a raster file.

    A file counts as georeferenced if it has a CRS and an invertible geotransform other than the identity, or
    ground control points, whose best-fitting geotransform is then used. Otherwise (also with RPCs only) the
    grid has the identity transform and no CRS. Raises `InputError` if the file is missing, no raster,
    unreadable or empty, the band is out of range or complex, or the mask cannot be related to it.

    Parameters
    ----------
    path : path-like or GDAL URI
        Any raster GDAL reads.
    band : int
        Number of the band, from 1.
    mask : path-like, optional
        A mask file (band 1, 0 = excluded) or a quality raster (see `masks`). It is georeferenced as the
        raster is, or has the raster's size and the same pixels.
    part : bool
        Whether only a part of a georeferenced raster is read, whose size `check_part` checks later.
    """
    uri = os.fspath(path)
    with open_raster(uri) as dataset:
        check_band(uri, dataset, band)
        grid, misfit_px = grid_of_file(uri, dataset)
        check_dataset(uri, dataset, band, (0, 0) if part and grid.crs is not None else None)
        check_place(uri, grid, misfit_px)
        info = RasterInfo(
            uri=uri,
            band=band,
            band_count=dataset.count,
            grid=grid,
            georeferenced=grid.crs is not None,
            dtype=dataset.dtypes[band - 1],
            nodata=dataset.nodatavals[band - 1],
            mask_uri=None if mask is None else os.fspath(mask),
            gcp_misfit_px=misfit_px,
            plane_transform=plane_transform_of(uri, dataset),
            camera=camera_of(dataset) if grid.crs is None else None,
            brightness=_brightness_of(dataset, band),
            basemap=basemap_of(dataset, grid),
        )
    if info.mask_uri is not None:
        described = describe(info.mask_uri)
        if info.grid.swath_uri and described.grid.swath_uri:  # it has the pixels of the swath
            plain = Grid(described.grid.shape, Affine.identity(), None)
            described = replace(described, grid=plain, georeferenced=False)
        _check_mask(info, described)
        with open_raster(info.mask_uri) as dataset:
            kind = kind_of(info.mask_uri, dataset.descriptions, dataset.dtypes)
        info = replace(info, mask_grid=described.grid, mask_kind=kind)
    return info


def is_huge(grid: Grid) -> bool:
    """Whether a raster is too large to be read as a whole, as a tile service is."""
    return math.prod(grid.shape) > LIMITS.file_px


def check_part(info: RasterInfo, shape: tuple[int, int]) -> None:
    """Raise `InputError` if a part of a raster, of so many rows and columns, is too large to be read."""
    rows, cols = shape
    if rows * cols > LIMITS.file_px:
        raise InputError(
            f"of {info.uri}, {cols} x {rows} pixels show ground that is compared, and at most "
            f"{LIMITS.file_px} are read: give an --extent, or a coarser version of it"
        )
    if rows * cols > LIMITS.checked_px:
        with open_raster(info.uri) as dataset:
            check_dataset(info.uri, dataset, info.band, shape)


def with_areas(info: RasterInfo, aoi: PathLike | None, exclude: PathLike | None) -> RasterInfo:
    """Return a band of which only the areas of the vector file `aoi` count, and those of `exclude` do not.

    Raises `InputError` if a file cannot be used, the band is not georeferenced, or nothing of it is left.
    """
    paths = " and ".join(os.fspath(path) for path in (aoi, exclude) if path is not None)
    if not paths:
        return info
    if info.grid.crs is None:
        raise InputError(
            f"{info.uri} has no georeferencing, so that the areas of {paths} have no place: give a mask"
        )
    areas = Areas(*(None if path is None else read_areas(path, info.grid) for path in (aoi, exclude)))
    rows, cols = info.grid.shape
    factor = max(1.0, max(rows, cols) / 1024)
    coarse = info.grid.scaled((math.ceil(rows / factor), math.ceil(cols / factor)))
    if not areas.valid(Window.whole(coarse.shape), coarse).any():
        raise InputError(f"{paths} leaves nothing of {info.uri}: check the areas, and their CRS")
    return replace(info, areas=areas)


def has_quick_overview(info: RasterInfo) -> bool:
    """Whether a reduced version of a band can be read without reading all of a large file.

    Raises `InputError` if the file cannot be opened.
    """
    rows, cols = info.grid.shape
    with open_raster(info.uri) as dataset:
        return rows * cols <= MAX_READ_PX or bool(dataset.overviews(info.band))


def same_band(a: RasterInfo, b: RasterInfo) -> bool:
    """Whether `a` and `b` describe the same band of the same file, even under different paths."""
    one, other = ([part.band for part in bands_of(info).parts] for info in (a, b))
    if one != other or bands_of(a).principal != bands_of(b).principal:
        return False
    if a.uri == b.uri:
        return True
    try:
        return Path(a.uri).samefile(b.uri)
    except (OSError, ValueError):  # a GDAL URI, which is no path
        return False


def mask_on_pixels(info: RasterInfo, mask_grid: Grid) -> bool:
    """Whether a mask with `mask_grid` has the pixels of the raster `info`.

    They have the same grid, or, where one is not georeferenced, the same size.
    """
    if info.georeferenced and mask_grid.crs is not None:
        return info.grid == mask_grid
    return info.grid.shape == mask_grid.shape


def check_band(uri: str, dataset: DatasetReader, band: int) -> None:
    """Raise `InputError` if an open raster has no such band, or the band is complex."""
    if dataset.count == 0 and dataset.subdatasets:
        first, *siblings = dataset.subdatasets
        ends = ", ".join(re.split("[/:]", name)[-1] for name in siblings[:12])
        raise InputError(
            f"{uri} holds subdatasets, not bands: give one of them, such as {first}"
            + (f"; the others end in {ends}{' …' * (len(siblings) > 12)}" if siblings else "")
        )
    if dataset.driver == "HDF5Image" and 2 * dataset.height < min(dataset.count, dataset.width):
        raise InputError(
            f"{uri} looks like {dataset.count} bands of {dataset.width} x {dataset.height} pixels: its bands "
            "are in the middle (rows, bands, columns), as those of PRISMA; convert it with "
            "gdalmdimtranslate -array name=…,transpose=[1,0,2]"
        )
    if dataset.count == 0 or dataset.width == 0 or dataset.height == 0:
        raise InputError(
            f"{uri} is empty ({dataset.count} bands of {dataset.width} x {dataset.height} pixels)"
        )
    if not 1 <= band <= dataset.count:
        content = "1 band" if dataset.count == 1 else f"{dataset.count} bands"
        raise InputError(
            f"{uri} holds {content}, and band {band} was asked for: give one from 1 to {dataset.count}"
        )
    dtype = dataset.dtypes[band - 1]
    if "complex" in dtype:
        raise InputError(f"{uri}: band {band} is {dtype}: give its magnitude, or another band")


def _brightness_of(dataset: DatasetReader, band: int) -> bytes | None:
    """Return the brightness (luma of ITU-R BT.601, 0 to 255) of the indices of a colour table, if any.

    Indices themselves are in no order: neighbours of a scanned map or a classification are unlike.
    """
    if dataset.colorinterp[band - 1] != ColorInterp.palette or dataset.dtypes[band - 1] != "uint8":
        return None
    colours = np.zeros((256, 3))
    for index, colour in dataset.colormap(band).items():
        colours[index] = colour[:3]
    return np.rint(colours @ [0.299, 0.587, 0.114]).astype(np.uint8).tobytes()


def _check_mask(info: RasterInfo, mask: RasterInfo) -> None:
    on_map = info.on_map or not info.georeferenced, mask.on_map or not mask.georeferenced
    if on_map[0] != on_map[1] and mask.georeferenced and info.georeferenced:
        raise InputError(
            f"of {info.uri} and its mask {mask.uri} one lies on a map and the other is a swath: give a mask "
            "on the pixels of the raster"
        )
    if info.georeferenced and mask.georeferenced:
        transformation_warnings(info.grid.crs, mask.grid.crs)  # raises where none exists
    elif not mask_on_pixels(info, mask.grid):
        lacking = mask if info.georeferenced else info
        raise InputError(
            f"the mask {mask.uri} has {mask.grid.shape[1]} x {mask.grid.shape[0]} pixels, {info.uri} has "
            f"{info.grid.shape[1]} x {info.grid.shape[0]}, and {lacking.uri} has no georeferencing "
            f"({name_of(lacking.grid.crs)}): give a mask of the same size, or georeference it"
        )
