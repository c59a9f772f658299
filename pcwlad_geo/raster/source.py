"""What a raster file holds, checked before any work is done."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.input_files import check_regular
from pcwlad_geo.limits import check_coordinates, check_gcp_misfit, check_geotransform, check_latitudes
from pcwlad_geo.raster.boundary import LIBRARY_ERRORS, reading
from pcwlad_geo.raster.crs import name_of, transformation_warnings
from pcwlad_geo.raster.file_tree import name_of_uri
from pcwlad_geo.raster.gcp_grid import geotransform_of
from pcwlad_geo.raster.grid import Grid, linear_part
from pcwlad_geo.raster.mask_kinds import MaskKind, kind_of
from pcwlad_geo.raster.opening import network_settings, open_for_reading, open_own
from pcwlad_geo.raster.quiet import ignoring
from pcwlad_geo.raster.stored import check_dataset

MOST_READ_PX: Final = 2**25
"""A file without overviews that has more pixels is not read for a look at it alone."""


@dataclass(frozen=True, slots=True)
class RasterInfo:
    """One band of one file, described: small and picklable."""

    uri: str
    """Path or GDAL URI."""
    band: int
    """From 1."""
    band_count: int
    grid: Grid
    georeferenced: bool
    """False where the file has no geotransform (nor control points that give one) or no CRS, unless another
    raster's tells it (see `shared_plane`)."""
    dtype: str
    nodata: float | None
    mask_uri: str | None
    """A mask file given by the user or found in a product."""
    mask_grid: Grid | None = None
    """Where its pixels lie."""
    mask_kind: MaskKind = "zeros"
    """What its values mean."""
    gcp_misfit_px: float | None = None
    """Largest misfit of the ground control points that the grid is made from; None: it is the file's own."""
    plane_transform: Affine | None = None
    """The geotransform of a file that has one and no CRS."""
    content: str = ""
    """Tells what the files of a job hold from what they hold later (`identity.digest`); empty: not known."""


def describe(
    path: str | os.PathLike[str], *, band: int = 1, mask: str | os.PathLike[str] | None = None
) -> RasterInfo:
    """Describe one band of a raster file.

    A file counts as georeferenced with a CRS and a geotransform that can be inverted and is not the
    identity, or with ground control points on the geotransform that fits them best; without them (also with
    RPCs only) the grid has the identity and no CRS.

    Parameters
    ----------
    path : path-like or GDAL URI
        Any raster GDAL reads.
    band : int
        From 1.
    mask : path-like, optional
        A mask file, its band 1, 0 = excluded, or a quality raster (see `mask_kinds`): as large as the
        raster (then it lies on it pixel for pixel, unless both are georeferenced), or georeferenced as the
        raster is.

    Raises
    ------
    InputError
        If the file is missing, no raster, unreadable or empty, the band is out of range or complex, or the
        mask cannot be laid on it.
    """
    uri = os.fspath(path)
    with open_raster(uri) as dataset:
        _check_band(uri, dataset, band)
        check_dataset(uri, dataset, band)
        grid, misfit_px = _grid_of(uri, dataset)
        _check_place(uri, grid, misfit_px)
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
            plane_transform=_plane_transform(uri, dataset),
        )
    if info.mask_uri is not None:
        described = describe(info.mask_uri)
        _check_mask(info, described)
        with open_raster(info.mask_uri) as dataset:
            kind = kind_of(info.mask_uri, dataset.descriptions, dataset.dtypes)
        info = replace(info, mask_grid=described.grid, mask_kind=kind)
    return info


def file_name(uri: str) -> str:
    """Return the last part of a path or GDAL URI, without what a vrt:// connection adds to it."""
    return name_of_uri(plain_uri(uri))


def plain_uri(uri: str) -> str:
    """Return a path or GDAL URI without what a vrt:// connection adds to it."""
    return uri.removeprefix("vrt://").partition("?")[0] if uri.startswith("vrt://") else uri


def plain_name(name: str) -> str:
    """Return a file name: a URI's may be none, "." and "/" have none, results do not hide behind a dot."""
    return re.sub(r'[<>:"/\\|?*]+', "_", name).lstrip(".") or "raster"


def is_quick_to_glance_at(info: RasterInfo) -> bool:
    """Whether a band can be read made small without reading all of a large file.

    Raises
    ------
    InputError
        If it cannot be opened.
    """
    rows, cols = info.grid.shape
    with open_raster(info.uri) as dataset:
        return rows * cols <= MOST_READ_PX or bool(dataset.overviews(info.band))


def same_band(a: RasterInfo, b: RasterInfo) -> bool:
    """Whether both are the same band of the same file, however its path is written."""
    if a.band != b.band:
        return False
    if a.uri == b.uri:
        return True
    try:
        return Path(a.uri).samefile(b.uri)
    except OSError:  # a GDAL URI, which is no path
        return False


def mask_on_pixels(info: RasterInfo, mask_grid: Grid) -> bool:
    """Whether a mask lies on a raster pixel for pixel: same grid, or same size where one lacks a place."""
    if info.georeferenced and mask_grid.crs is not None:
        return info.grid == mask_grid
    return info.grid.shape == mask_grid.shape


@contextmanager
def open_raster(uri: str, **options: object) -> Iterator[DatasetReader]:
    """Open a raster for reading, with GDAL on one thread; errors of opening and reading become `InputError`.

    What a stranger's file may make GDAL open is in `opening`. Nothing is written beside it (GDAL would keep
    what it learns of a .gz there).
    """
    _check_files(uri)
    with _opened(open_for_reading, uri, options) as dataset:
        yield dataset


@contextmanager
def open_own_raster(uri: str) -> Iterator[DatasetReader]:
    """Open what this program has just made, as `open_raster` does, wherever the pixels are that it shows."""
    with _opened(open_own, uri, {}) as dataset:
        yield dataset


@contextmanager
def _opened(
    opener: Callable[..., DatasetReader], uri: str, options: Mapping[str, object]
) -> Iterator[DatasetReader]:
    with rasterio.Env(GDAL_NUM_THREADS="1", CPL_VSIL_GZIP_WRITE_PROPERTIES="NO", **network_settings()):
        try:
            with ignoring(NotGeoreferencedWarning):
                dataset = opener(uri, **options)
        except (*LIBRARY_ERRORS, OSError, ValueError) as error:
            raise InputError(_why_not_opened(uri, error)) from error
        with dataset, reading(uri):
            yield dataset


def _check_files(uri: str) -> None:
    """Raise where GDAL could wait for a pipe for ever: the raster, or what it looks for beside it."""
    for ending in ("", ".aux.xml", ".ovr", ".msk"):
        check_regular(uri + ending)


def _why_not_opened(uri: str, error: Exception) -> str:
    path = Path(uri)
    if isinstance(error, UnicodeError):
        return f"the name of {uri!r} is not UTF-8, which GDAL needs: rename it"
    try:
        if path.is_dir():
            return (
                f"{uri} is a folder, and neither a Landsat Collection 2 nor a Sentinel-2 SAFE product: "
                "give a raster file"
            )
        if path.is_file():
            if not os.access(path, os.R_OK):
                return f"{uri} cannot be read: change its permissions"
            reason = _one_line(error)
            if "not recognized" in reason:
                reason += " (formats whose files name other files are read with --trust-vrt only)"
            return f"{uri} is not a raster that GDAL can read, or it is damaged: {reason}"
    except (OSError, ValueError):  # too long or odd for a path, as GDAL URIs may be
        pass
    if ":" in uri or uri.startswith("/vsi") or uri.startswith("<"):
        return f"{uri} cannot be opened: {_one_line(error)}"
    return f"{uri} does not exist: check the path"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _check_band(uri: str, dataset: DatasetReader, band: int) -> None:
    if dataset.count == 0 and dataset.subdatasets:
        raise InputError(
            f"{uri} holds subdatasets, not bands: give one of them, such as {dataset.subdatasets[0]}"
        )
    if dataset.count == 0 or dataset.width == 0 or dataset.height == 0:
        raise InputError(
            f"{uri} is empty ({dataset.count} bands of {dataset.width} x {dataset.height} pixels)"
        )
    if not 1 <= band <= dataset.count:
        held = "1 band" if dataset.count == 1 else f"{dataset.count} bands"
        raise InputError(
            f"{uri} holds {held}, and band {band} was asked for: give one from 1 to {dataset.count}"
        )
    dtype = dataset.dtypes[band - 1]
    if "complex" in dtype:
        raise InputError(f"{uri}: band {band} is {dtype}: give its magnitude, or another band")


def _is_georeferenced(dataset: DatasetReader) -> bool:
    return dataset.crs is not None and _has_transform(dataset)


def _has_transform(dataset: DatasetReader) -> bool:
    """Whether there is a geotransform that says something and can be inverted."""
    transform = dataset.transform
    matrix = linear_part(transform)
    if transform == Affine.identity() or not np.isfinite([*transform]).all() or not matrix.any():
        return False
    return bool(np.linalg.det(matrix / np.abs(matrix).max()) != 0.0)  # squares of huge numbers are infinite


def _grid_of(uri: str, dataset: DatasetReader) -> tuple[Grid, float | None]:
    """Return the grid, and how well it fits the control points where it is made from them."""
    if _is_georeferenced(dataset):
        return Grid(dataset.shape, dataset.transform, dataset.crs), None
    gcps, crs = dataset.gcps
    # Beside RPCs they are the rough corners of an image (NITF).
    check_coordinates(uri, [value for gcp in gcps for value in (gcp.col, gcp.row, gcp.x, gcp.y)])
    found = geotransform_of(gcps) if crs is not None and not dataset.tags(ns="RPC") else None
    if found is not None:
        return Grid(dataset.shape, found[0], crs), found[1]
    return Grid(dataset.shape, Affine.identity(), None), None


def _plane_transform(uri: str, dataset: DatasetReader) -> Affine | None:
    """Return the geotransform of a file that has one and no CRS."""
    if dataset.crs is not None or not _has_transform(dataset):
        return None
    transform: Affine = dataset.transform
    check_geotransform(uri, tuple(transform)[:6], dataset.shape)
    return transform


def _check_place(uri: str, grid: Grid, misfit_px: float | None) -> None:
    """Raise where the pixels lie on no map."""
    if misfit_px is not None:
        check_gcp_misfit(uri, misfit_px, grid.shape)
    if grid.crs is None:
        return
    check_geotransform(uri, tuple(grid.transform)[:6], grid.shape)
    if grid.crs.is_geographic and grid.crs.units_factor[0].lower().startswith("degree"):
        rows, cols = grid.shape
        corners = grid.to_xy(np.array([[0.0, 0.0], [cols, 0.0], [cols, rows], [0.0, rows]]))[:, 1]
        pixel = float(np.abs(linear_part(grid.transform)[1]).max())
        check_latitudes(uri, float(corners.min()), float(corners.max()), min(pixel, 1.0))


def _check_mask(info: RasterInfo, mask: RasterInfo) -> None:
    if info.georeferenced and mask.georeferenced:
        transformation_warnings(info.grid.crs, mask.grid.crs)  # raises where none exists
    elif not mask_on_pixels(info, mask.grid):
        lacking = mask if info.georeferenced else info
        raise InputError(
            f"the mask {mask.uri} has {mask.grid.shape[1]} x {mask.grid.shape[0]} pixels, {info.uri} has "
            f"{info.grid.shape[1]} x {info.grid.shape[0]}, and {lacking.uri} has no georeferencing "
            f"({name_of(lacking.grid.crs)}): give a mask of the same size, or georeference it"
        )
