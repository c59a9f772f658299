"""Descriptions of raster files (`RasterInfo`), with their checks, and the functions that open them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader
from rasterio.windows import Window as FileWindow

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_coordinates, check_gcp_misfit, check_geotransform, check_latitudes
from pcwlad_geo.raster.cameras import Camera, camera_of
from pcwlad_geo.raster.crs import WGS84, name_of, transform_xy, transformation_warnings, utm_zone_of
from pcwlad_geo.raster.file_tree import name_of_uri
from pcwlad_geo.raster.gdal import (
    GDAL_ERRORS,
    LIBRARY_ERRORS,
    check_dataset,
    ignoring,
    open_for_reading,
    open_own,
    reading,
)
from pcwlad_geo.raster.grid import Grid, Window, geotransform_of, is_invertible, linear_part
from pcwlad_geo.raster.masks import Areas, Collar, MaskKind, find_collar, find_frame, kind_of, read_areas
from pcwlad_geo.raster.trust import current_trust
from pcwlad_geo.text import check_regular, check_sidecars, is_uri, joined
from pcwlad_geo.types import Bool, Float64, PathLike

MAX_READ_PX: Final = 2**25
"""Largest number of pixels of a file without overviews that is read for an overview of it."""
BLOCK_PX: Final = 8
"""Side of a block of JPEG (ITU-T T.81, Annex A): phase congruency sees the grid of blocks where a scene is
flat, and two images of different places would agree on it."""
MIN_RATIO: Final = 1.1
"""Steps at the edges of blocks over those inside, from which a band counts as compressed. Bands
without loss show 1.00 to 1.06 along both axes, JPEGs 1.05 to 2.1, those of low quality most."""
MIN_LEAD: Final = 1.05
"""Steps at the edges of blocks over the largest at any other position in a block."""
COMMON: Final = 98
"""Percentile of the steps of a sample to which larger ones, which are the scene's edges, are cut down."""
SAMPLE_PX: Final = 256
"""Side of the samples in which blocks are looked for."""
SAMPLES_ACROSS: Final = 3
"""Number of samples along rows and along columns."""


EXACT_PX: Final = 0.05
"""Up to this residual control points count as fitted by a geotransform of their own CRS."""
MAX_NAMED: Final = 12
"""Number of subdatasets that a message names at most."""


@dataclass(frozen=True, slots=True)
class BandPart:
    """A band of an image that several bands make."""

    path: str
    """Path or GDAL URI."""
    band: int
    """From 1."""
    weight: float = 1.0
    """What its values are multiplied by."""


@dataclass(frozen=True, slots=True)
class Bands:
    """The bands that are matched as one image, the sum of their weighted values."""

    parts: tuple[BandPart, ...]
    """All of one grid, one after another those of a file; empty: all bands of the file, not known yet."""
    principal: bool = False
    """Whether they make the first principal component, instead of the mean."""

    @staticmethod
    def of_file(path: str, choice: int | str) -> Bands | None:
        """Return the bands of a file by number; None where the choice names those of a product."""
        if choice == "pca":
            return Bands((), principal=True)
        spans = [span.split("-") for span in str(choice).removeprefix("pca:").split(",")]
        if not all(end.isdecimal() for span in spans for end in span):
            return None
        ends = [sorted(int(end) for end in span) for span in spans]
        numbers = (number for span in ends for number in range(span[0], span[-1] + 1))
        parts = tuple(BandPart(path, number) for number in numbers)
        return Bands(parts, principal=str(choice).startswith("pca:"))

    @property
    def first(self) -> int:
        """Number of the first band."""
        return self.parts[0].band if self.parts else 1

    @property
    def numbers(self) -> str:
        """The numbers of the bands, or the files of those of several."""
        numbers = [part.band for part in self.parts]
        files = dict.fromkeys(file_name(part.path) for part in self.parts)
        if len(numbers) == 1:
            return f"band {numbers[0]}"
        if len(files) > 1:
            return ", ".join(files)
        span = len(numbers) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1))
        return f"bands {numbers[0]} to {numbers[-1]}" if span else f"bands {', '.join(map(str, numbers))}"

    @property
    def text(self) -> str:
        """What is matched, for people."""
        if len(self.parts) == 1:
            return self.numbers
        return f"{'first principal component' if self.principal else 'mean'} of {self.numbers}"


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
    """A constant border that counts as nodata, see `without_collar`."""
    shows_blocks: bool = False
    """Whether blocks of lossy compression show, see `with_compression_blocks`."""
    camera: Camera | None = None
    """What a file without georeferencing says of the camera that took it."""
    content: str = ""
    """Digest of the versions of the files (`identity.digest`), to detect changes; empty where unknown."""
    several: Bands | None = None
    """The bands, where there are several, with their weights, see `view.with_bands`."""


def bands_of(info: RasterInfo) -> Bands:
    """Return the bands that are read: the one, or several."""
    return info.several or Bands((BandPart(info.uri, info.band),))


def describe(
    path: str | os.PathLike[str], *, band: int = 1, mask: str | os.PathLike[str] | None = None
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
    """
    uri = os.fspath(path)
    with open_raster(uri) as dataset:
        check_band(uri, dataset, band)
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
            camera=camera_of(dataset) if grid.crs is None else None,
            brightness=_brightness_of(dataset, band),
        )
    if info.mask_uri is not None:
        described = describe(info.mask_uri)
        _check_mask(info, described)
        with open_raster(info.mask_uri) as dataset:
            kind = kind_of(info.mask_uri, dataset.descriptions, dataset.dtypes)
        info = replace(info, mask_grid=described.grid, mask_kind=kind)
    return info


def without_collar(info: RasterInfo) -> tuple[RasterInfo, tuple[str, ...]]:
    """Return a band with its collar as nodata, and a note that says so if it has one.

    A collar is a constant border that nothing marks (see `masks.find_collar`). A band with a nodata value, an
    alpha band or a mask of any kind has said which of its pixels count, and is returned as it is, as is one
    that cannot be read here: whoever reads it next reports that. Of any other band four corners are read,
    and more of it only if one of them is constant.
    """
    if info.nodata is not None or info.mask_uri is not None:
        return info, ()
    collar, framed = None, False
    with suppress(InputError), open_raster(info.uri) as dataset:
        marked = dataset.mask_flag_enums[info.band - 1] != [MaskFlags.all_valid]
        if not marked and ColorInterp.alpha not in dataset.colorinterp:
            read = partial(_read_nearest, dataset, info.band)
            collar = find_collar(read, dataset.shape)
            framed = collar is None and (collar := find_frame(read, dataset.shape)) is not None
    if collar is None:
        return info, ()
    what = "border of a scanned frame (tone about" if framed else "constant border (value"
    note = (
        f"a {what} {collar.value:g}) of {100 * collar.share:.2g} % of {info.uri} is taken "
        "for nodata; if it is data, declare another nodata value, or give a mask"
    )
    return replace(info, collar=collar), (note,)


def with_areas(info: RasterInfo, aoi: PathLike | None, exclude: PathLike | None) -> RasterInfo:
    """Return a band of which only the areas of the vector file `aoi` count, and those of `exclude` do not.

    Raises `InputError` if a file cannot be used, the band is not georeferenced, or nothing of it is left.
    """
    named = " and ".join(os.fspath(path) for path in (aoi, exclude) if path is not None)
    if not named:
        return info
    if info.grid.crs is None:
        raise InputError(
            f"{info.uri} has no georeferencing, so that the areas of {named} have no place: give a mask"
        )
    found = (None if path is None else read_areas(path, info.grid) for path in (aoi, exclude))
    areas = Areas(*found)
    rows, cols = info.grid.shape
    factor = max(1.0, max(rows, cols) / 1024)
    coarse = info.grid.scaled((math.ceil(rows / factor), math.ceil(cols / factor)))
    if not areas.valid(Window.whole(coarse.shape), coarse).any():
        raise InputError(f"{named} leaves nothing of {info.uri}: check the areas, and their CRS")
    return replace(info, areas=areas)


def with_compression_blocks(info: RasterInfo) -> RasterInfo:
    """Return a band that says whether the blocks of lossy compression show in its pixels (see `compression`).

    Only bands of 8 bits are looked at, in nine samples. Whether it is a JPEG does not matter: many a TIFF was
    one. A band that cannot be read here is returned as it is: whoever reads it next reports that.
    """
    if info.dtype != "uint8":
        return info
    with suppress(InputError, *GDAL_ERRORS), open_raster(info.uri) as dataset:

        def read(window: Window) -> tuple[NDArray[np.generic], Bool]:
            values = _read_nearest(dataset, info.band, window, window.shape)
            return values, values != info.nodata

        return replace(info, shows_blocks=find_blocks(read, dataset.shape) is not None)
    return info


def _read_nearest(
    dataset: DatasetReader, band: int, window: Window, shape: tuple[int, int]
) -> NDArray[np.generic]:
    file_window = FileWindow(window.col, window.row, window.cols, window.rows)
    return np.asarray(dataset.read(band, window=file_window, out_shape=shape))


def file_name(uri: str) -> str:
    """Return the last part of a path or GDAL URI, without the prefix and options of a vrt:// connection."""
    return name_of_uri(plain_uri(uri))


def plain_uri(uri: str) -> str:
    """Return a path or GDAL URI without the prefix and options of a vrt:// connection."""
    return uri.removeprefix("vrt://").partition("?")[0] if uri.startswith("vrt://") else uri


def plain_name(name: str) -> str:
    """Return a name usable for output files: no reserved character, no leading dot, never empty."""
    return re.sub(r'[<>:"/\\|?*\x00-\x1f]+', "_", name).lstrip(".") or "raster"


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


@contextmanager
def open_raster(uri: str, **options: object) -> Iterator[DatasetReader]:
    """Open a raster for reading within the context, with GDAL on one thread.

    The files that an untrusted raster may make GDAL open are restricted, see `gdal`. Nothing is written
    beside it (GDAL would store properties of a .gz file there). Raises `InputError` if it cannot be opened,
    or reading within the context fails. The `uri` is a path or a GDAL URI; the options are GDAL's.
    """
    if "\0" in uri:  # where GDAL would end the name
        raise InputError(f"the name {uri!r} holds a NUL character: no file has such a name")
    check_regular(uri)  # GDAL could wait for a pipe for ever
    check_sidecars(uri)
    with _opened(open_for_reading, uri, options) as dataset:
        yield dataset


@contextmanager
def open_written_raster(uri: str) -> Iterator[DatasetReader]:
    """Open a raster that this program has written, as `open_raster` does, wherever its sources are.

    Temporary files of GDAL (of a warp by a table of positions) lie beside it. GDAL itself would choose the
    working folder, which need not be one that can be written.
    """
    options = {} if uri.startswith("<") else {"CPL_TMPDIR": str(Path(uri).parent)}
    with rasterio.Env(**options), _opened(open_own, uri, {}) as dataset:
        yield dataset


@contextmanager
def _opened(
    opener: Callable[..., DatasetReader], uri: str, options: Mapping[str, object]
) -> Iterator[DatasetReader]:
    settings = {"GDAL_NUM_THREADS": "1", "CPL_VSIL_GZIP_WRITE_PROPERTIES": "NO"}
    if not current_trust().remote:  # a suffix that no file on a server has
        settings["CPL_VSIL_CURL_ALLOWED_EXTENSIONS"] = "{none}"
    if current_trust().vrt:  # GDAL 3.12 refuses raw bands of files elsewhere by itself
        settings["GDAL_VRT_RAWRASTERBAND_ALLOWED_SOURCE"] = "ALL"
    with rasterio.Env(**settings):
        try:
            with ignoring(NotGeoreferencedWarning):
                dataset = opener(uri, **options)
        except (*LIBRARY_ERRORS, OSError, ValueError) as error:
            raise InputError(_why_not_opened(uri, error)) from error
        with dataset, reading(uri):
            yield dataset


def _why_not_opened(uri: str, error: Exception) -> str:
    path = Path(uri)
    if isinstance(error, UnicodeError):
        return f"the name of {uri!r} is not UTF-8, which GDAL needs: rename it"
    try:
        if path.is_dir():
            return (
                f"{uri} is a folder, and neither a Landsat scene nor a Sentinel-2 SAFE product: "
                "give a raster file"
            )
        if path.is_file():
            if not os.access(path, os.R_OK):
                return f"{uri} cannot be read: change its permissions"
            reason = joined(error)
            if "not recognized" in reason:
                reason += " (formats whose files name other files are read with --trust-vrt only)"
            return f"{uri} is not a raster that GDAL can read, or it is damaged: {reason}"
    except (OSError, ValueError):  # too long or odd for a path, as GDAL URIs may be
        pass
    if is_uri(uri):
        return f"{uri} cannot be opened: {joined(error)}"
    return f"{uri} does not exist: check the path"


def check_band(uri: str, dataset: DatasetReader, band: int) -> None:
    """Raise `InputError` if an open raster has no such band, or the band is complex."""
    if dataset.count == 0 and dataset.subdatasets:
        first, *others = dataset.subdatasets
        ends = ", ".join(re.split("[/:]", name)[-1] for name in others[:MAX_NAMED])
        raise InputError(
            f"{uri} holds subdatasets, not bands: give one of them, such as {first}"
            + (f"; the others end in {ends}{' …' * (len(others) > MAX_NAMED)}" if others else "")
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
        held = "1 band" if dataset.count == 1 else f"{dataset.count} bands"
        raise InputError(
            f"{uri} holds {held}, and band {band} was asked for: give one from 1 to {dataset.count}"
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


def _has_transform(dataset: DatasetReader) -> bool:
    """Whether there is an invertible geotransform other than the identity."""
    transform = dataset.transform
    if transform == Affine.identity() or not np.isfinite([*transform]).all():
        return False
    return is_invertible(linear_part(transform))


def _grid_of(uri: str, dataset: DatasetReader) -> tuple[Grid, float | None]:
    """Return the grid, and its largest residual in px where it was fitted to control points."""
    if dataset.crs is not None and _has_transform(dataset):
        return Grid(dataset.shape, dataset.transform, dataset.crs), None
    gcps, crs = dataset.gcps
    # Beside RPCs, control points are the approximate corners of an image (NITF).
    check_coordinates(uri, [value for gcp in gcps for value in (gcp.col, gcp.row, gcp.x, gcp.y)])
    if crs is None or dataset.tags(ns="RPC"):
        return Grid(dataset.shape, Affine.identity(), None), None
    return _grid_of_gcps(dataset.shape, gcps, crs)


def _grid_of_gcps(
    shape: tuple[int, int], gcps: Sequence[GroundControlPoint], crs: CRS
) -> tuple[Grid, float | None]:
    """Return the grid that fits control points best, in their CRS or, of degrees, in the UTM zone if better.

    Degrees of longitude become shorter towards the poles: over a radar swath of 250 km by hundreds of pixels.
    """
    found = geotransform_of(gcps)
    if found is not None and found[1] > EXACT_PX and crs.is_geographic:
        lon_lat = np.array([[gcp.x, gcp.y] for gcp in gcps])
        zone = utm_zone_of(transform_xy(lon_lat[len(lon_lat) // 2][None], crs, WGS84)[0])
        moved = zip(gcps, transform_xy(lon_lat, crs, zone).tolist(), strict=True)
        there = geotransform_of([GroundControlPoint(gcp.row, gcp.col, x, y) for gcp, (x, y) in moved])
        if there is not None and there[1] < found[1]:
            found, crs = there, zone
    if found is None:
        return Grid(shape, Affine.identity(), None), None
    return Grid(shape, found[0], crs), found[1]


def _plane_transform(uri: str, dataset: DatasetReader) -> Affine | None:
    """Return the geotransform of a file that has one but no CRS."""
    if dataset.crs is not None or not _has_transform(dataset):
        return None
    transform: Affine = dataset.transform
    check_geotransform(uri, tuple(transform)[:6], dataset.shape)
    return transform


def _check_place(uri: str, grid: Grid, misfit_px: float | None) -> None:
    """Raise where the georeferencing is not plausible."""
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


def find_blocks(
    read: Callable[[Window], tuple[NDArray[Any], Bool]], shape: tuple[int, int]
) -> tuple[int, int] | None:
    """Find the blocks of a band of `shape` (rows, cols) in nine samples; None if it shows none.

    `read` returns the (rows, cols) values and validity of a window. The result is the row and the column,
    modulo 8, at which blocks begin.
    """
    samples = [(read(window), window) for window in _samples(shape)]
    if not samples:
        return None
    by_row = _mean_steps((values, valid, window.row) for (values, valid), window in samples)
    by_col = _mean_steps((values.T, valid.T, window.col) for (values, valid), window in samples)
    row, col = _first_px(by_row), _first_px(by_col)
    return None if row is None or col is None else (row, col)


def _samples(shape: tuple[int, int]) -> list[Window]:
    side_r, side_c = min(shape[0], SAMPLE_PX), min(shape[1], SAMPLE_PX)
    if min(side_r, side_c) < 4 * BLOCK_PX:
        return []
    rows = np.unique(np.linspace(0, shape[0] - side_r, SAMPLES_ACROSS).astype(int)).tolist()
    cols = np.unique(np.linspace(0, shape[1] - side_c, SAMPLES_ACROSS).astype(int)).tolist()
    return [Window(row, col, side_r, side_c) for row in rows for col in cols]


def _mean_steps(samples: Iterable[tuple[NDArray[Any], Bool, int]]) -> Float64:
    """Return the (8,) mean absolute steps into rows of each number modulo 8; the scene's edges are capped."""
    total, count = np.zeros(BLOCK_PX), np.zeros(BLOCK_PX)
    for values, valid, first in samples:
        slopes = np.diff(values.astype(np.float64), axis=0)
        size = np.abs(slopes[1:-1] - (slopes[:-2] + slopes[2:]) / 2)  # less the slopes beside the step
        good = valid[:-3] & valid[1:-2] & valid[2:-1] & valid[3:]  # the four pixels of each step
        if not good.any():
            continue
        size = np.minimum(size, np.percentile(size[good], COMMON)) * good
        row = (first + 2 + np.arange(len(size))) % BLOCK_PX
        total += np.bincount(row, size.sum(axis=1), BLOCK_PX)
        count += np.bincount(row, good.sum(axis=1), BLOCK_PX)
    return np.divide(total, count, out=np.zeros(BLOCK_PX), where=count > 0)


def _first_px(steps: Float64) -> int | None:
    """Return where blocks begin, from the (8,) mean steps; None if they do not show."""
    first = int(np.argmax(steps))
    others = np.delete(steps, first)
    shown = steps[first] >= max(MIN_RATIO * others.mean(), MIN_LEAD * others.max())
    return first if shown and steps[first] > 0 else None
