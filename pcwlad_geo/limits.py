"""Limits of what is read and made: no input, however odd, makes a run need endless memory or time.

Every limit is far beyond what real data need. Whoever meets one learns which, what was found and what to do;
docs/limits.md lists them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Final

if sys.platform != "win32":
    import resource

from pcwlad_geo.errors import ExecutionError, InputError, SettingsError

FILE_PX: Final = 2**36
"""Pixels of a band of a file: a square of 262,144 px, six times the largest mosaics that are read here."""
CHECKED_PX: Final = 2**28
"""Pixels of a band from which on a file must hold its pixels: smaller ones are read before it matters."""
PX_PER_BYTE: Final = 2000
"""Pixels of a band per byte of its files: Deflate packs at most 1,032 equal bytes into one, LZW less."""
LEAST_STORED: Final = 1 / 128
"""Share of the blocks of a large TIFF that must be in the file: a sparse file is an empty one."""
BLOCK_BYTES: Final = 2**30
"""Bytes of one block (tile or strip) once unpacked: GDAL holds at least one whole block in memory."""
BANDS: Final = 4096
"""Bands of a file: ten times those of imaging spectrometers; each has a description that is kept."""
ADDRESS_SPACE_BYTES: Final = 2**31
"""Least address space of a process (`ulimit -v`): with less, libraries that are mapped whole end it."""
COORDINATE: Final = 1e10
"""Map units from the origin: the earth is 4e7 m or 1.3e8 feet around."""
PIXEL_SHARE: Final = 1e-11
"""Least pixel size as a share of the map coordinates: a 64-bit number holds 16 digits, and a hundredth of a
pixel is wanted."""
PIXEL_RATIO: Final = 1000.0
"""Pixels of the finer raster along a side of the coarser one's: what they share shows nothing beyond."""
PIXEL_SHAPE: Final = 16.0
"""How much longer than wide the pixels of one raster may be as the other sees them."""
GCP_MISFIT_SHARE: Final = 0.25
"""Of the image's longer side, how far a geotransform may miss a control point: beyond, one is wrong."""
GRID_PX: Final = 2**34
"""Pixels of an output grid: a square of 131,072 px."""
GRID_SIDE_PX: Final = 2**20
"""Columns or rows of an output grid: four times the widest mosaics."""
OUTPUT_PIXEL_PX: Final = 1e4
"""Side of a pixel of an output grid in pixels of the target: all of them are weighed together."""
CREATED_BLOCK_PX: Final = 8192
"""Side of a block of a file that is written: all bands of several blocks are held at once."""
GRID_TIMES: Final = 64
"""Pixels of an output grid per pixel of the rasters that it is made from."""
GRID_LEAST_PX: Final = 2**28
"""Pixels that an output grid may always have."""
UNREAD_PARTS: Final = 500
"""Parts of a damaged file that are tried one by one before it is given up."""
SEARCH_RADIUS_PX: Final = 1024
"""Largest displacement looked for by matching: every tile is read with as much around it."""
TILE_PX: Final = 4096
"""Side of a tile: its maps take about 100 bytes a pixel."""
FEATURES: Final = 100_000
"""Candidates a tile."""
ITERATIONS: Final = 1000
"""Steps of a refinement, which takes about ten."""
JOBS: Final = 1024
"""Processes."""
POINTS: Final = 250_000
"""Tie points of a file: every one is held in memory and takes part in each fit."""
TEXT_BYTES: Final = 2**26
"""Bytes of a text file (tables, side files, metadata of a product), unpacked."""
BATCH_ROWS: Final = 100_000
"""Pairs of a table."""
MEMBERS: Final = 100_000
"""Files of an archive or a folder of a product."""
UNPACKED_BYTES: Final = 2**30
"""Bytes of an archive that it may unpack to however well it is packed."""
UNPACKED_RATIO: Final = 200
"""Times its size that a larger archive may unpack to: images unpack to two or three times."""
NAME_BYTES: Final = 255
"""Bytes of a name of a file or folder, on all common file systems."""
LATITUDE: Final = 90.0
"""Degrees; a pixel may be centred on the pole."""
RPC_LIMITS: Final = {
    "line_off": 1e7,
    "samp_off": 1e7,
    "line_scale": 1e7,
    "samp_scale": 1e7,
    "lat_off": 90.0,
    "long_off": 360.0,
    "lat_scale": 90.0,
    "long_scale": 360.0,
    "height_off": 2e4,
    "height_scale": 2e4,
}
"""Largest sizes of an RPC's numbers: pixels, degrees, metres."""
RPC_COEFFICIENT: Final = 1e6
"""Largest size of an RPC's coefficients, which speak of normalised coordinates."""


def check_address_space() -> None:
    """Raise where the process may use less address space than the libraries need.

    Raises
    ------
    ExecutionError
        Then.
    """
    if sys.platform == "win32":  # has no such limit
        return
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY and most < ADDRESS_SPACE_BYTES:
        raise ExecutionError(
            f"the process may use {most / 2**30:.2g} GiB of address space, and at least "
            f"{ADDRESS_SPACE_BYTES / 2**30:.0f} GiB of memory are needed: raise its limit (ulimit -v)"
        )


def check_shape(uri: str, shape: tuple[int, int], bands: int) -> None:
    """Raise where a raster has more pixels or bands than are read.

    Parameters
    ----------
    uri : str
        Its name, for the message.
    shape : (int, int)
        Rows, columns.
    bands : int

    Raises
    ------
    InputError
        Then.
    """
    rows, cols = shape
    if rows * cols > FILE_PX:
        raise InputError(
            f"{uri} declares {cols} x {rows} pixels, and at most {FILE_PX} are read: it "
            "may be damaged; crop it"
        )
    if bands > BANDS:
        raise InputError(
            f"{uri} declares {bands} bands, and at most {BANDS} are read: it may be damaged; extract the "
            "bands that are needed (gdal_translate -b)"
        )


def check_stored(uri: str, shape: tuple[int, int], file_bytes: int) -> None:
    """Raise where files are far too small for the pixels that they declare.

    Raises
    ------
    InputError
        If more than `PX_PER_BYTE` pixels come on each of the bytes.
    """
    rows, cols = shape
    if rows * cols > CHECKED_PX and rows * cols > PX_PER_BYTE * file_bytes:
        raise InputError(
            f"{uri} declares {cols} x {rows} pixels and has {file_bytes} bytes, less than one for "
            f"{PX_PER_BYTE} pixels: it is empty or damaged; crop it to where it holds data"
        )


def check_block(uri: str, shape: tuple[int, int], bytes_per_px: int) -> None:
    """Raise where one block (rows, columns) of a raster does not fit into memory.

    Raises
    ------
    InputError
        If it has more than `BLOCK_BYTES`.
    """
    rows, cols = shape
    if rows * cols * bytes_per_px > BLOCK_BYTES:
        raise InputError(
            f"{uri} is stored in blocks of {cols} x {rows} pixels, {rows * cols * bytes_per_px} bytes "
            f"each, and at most {BLOCK_BYTES} are read at once: it may be damaged; tile it "
            "(gdal_translate -co TILED=YES)"
        )


def check_geotransform(uri: str, numbers: Sequence[float], shape: tuple[int, int]) -> None:
    """Raise where a geotransform puts pixels beyond any map, or closer together than coordinates can tell.

    Parameters
    ----------
    uri : str
    numbers : six floats
        a, b, c, d, e, f: x = a col + b row + c, y = d col + e row + f.
    shape : (int, int)
        Rows, columns.

    Raises
    ------
    InputError
        Then.
    """
    a, b, c, d, e, f = numbers
    rows, cols = shape
    reach = (abs(c) + abs(a) * cols + abs(b) * rows, abs(f) + abs(d) * cols + abs(e) * rows)
    least = min(math.hypot(a, d), math.hypot(b, e))
    advice = "correct the geotransform (gdal_edit.py -a_ullr)"
    if not all(far <= COORDINATE for far in reach):  # NaN is not
        raise InputError(
            f"{uri} has map coordinates up to {max(reach):.3g}, and at most {COORDINATE:.0e} are read: "
            f"{advice}"
        )
    if not least >= PIXEL_SHARE * max(abs(c), abs(f)):
        raise InputError(
            f"{uri} has pixels of {least:.3g} map units at coordinates of {max(abs(c), abs(f)):.7g}, which "
            f"64-bit numbers cannot tell apart: {advice}"
        )


def check_coordinates(uri: str, values: Sequence[float]) -> None:
    """Raise where points have coordinates beyond any map or image.

    Raises
    ------
    InputError
        If one is beyond `COORDINATE`.
    """
    far = next((value for value in values if not abs(value) <= COORDINATE), None)
    if far is not None:
        raise InputError(
            f"{uri} has a point with the coordinate {far:.3g}, and at most {COORDINATE:.0e} is read: remove "
            "it"
        )


def check_latitudes(uri: str, lowest: float, highest: float, pixel: float) -> None:
    """Raise where a raster in degrees reaches beyond a pole by more than a pixel.

    Raises
    ------
    InputError
        Then.
    """
    if lowest < -LATITUDE - pixel or highest > LATITUDE + pixel:
        raise InputError(
            f"{uri} covers latitudes from {lowest:.10g} to {highest:.10g} degrees, and there are none beyond "
            "90: correct its geotransform or its CRS (x is the longitude, y the latitude)"
        )


def check_pixel_ratio(reference: str, target: str, step_px: Sequence[float]) -> None:
    """Raise where the pixels of two rasters are too different to be matched.

    Parameters
    ----------
    reference, target : str
        Their names, for the message.
    step_px : two floats
        Pixels of one raster along the columns and the rows of the other's.

    Raises
    ------
    InputError
        Beyond `PIXEL_RATIO` or `PIXEL_SHAPE`.
    """
    low, high = min(step_px), max(step_px)
    if not (math.isfinite(high) and low > 0):
        return  # where the one does not lie in the other's CRS: told elsewhere
    ratio = max(high, 1 / low)
    if ratio > PIXEL_RATIO:
        raise InputError(
            f"a pixel of {reference} and one of {target} differ {ratio:.3g} times in size, and at most "
            f"{PIXEL_RATIO:.0f} times can be matched: check both geotransforms, or resample the finer raster"
        )
    if high / low > PIXEL_SHAPE:
        raise InputError(
            f"the pixels of {reference} and {target} differ {high / low:.3g} times in their shape (width to "
            f"height), and at most {PIXEL_SHAPE:.0f} times can be matched: check both geotransforms"
        )


def check_gcp_misfit(uri: str, misfit_px: float, shape: tuple[int, int]) -> None:
    """Raise where no geotransform fits the control points of an image at all.

    Raises
    ------
    InputError
        If the largest misfit is more than `GCP_MISFIT_SHARE` of the image's longer side.
    """
    if not misfit_px <= GCP_MISFIT_SHARE * max(shape):
        raise InputError(
            f"{uri} has ground control points that a geotransform misses by up to {misfit_px:.3g} px, more "
            f"than {GCP_MISFIT_SHARE:.0%} of its longer side: one of them is wrong; remove it"
        )


def check_grid(what: str, counts: Sequence[float], made_from_px: float | None = None) -> None:
    """Raise where a grid that is to be made has too many pixels.

    Parameters
    ----------
    what : str
        Begins the message, such as "the output grid".
    counts : two floats
        Columns, rows.
    made_from_px : float, optional
        Pixels of the rasters that it is made from.

    Raises
    ------
    InputError
        Beyond `GRID_PX`, `GRID_SIDE_PX` a side, and `GRID_TIMES` the pixels that it is made from (or
        `GRID_LEAST_PX`).
    """
    most = float(GRID_PX)
    if made_from_px is not None:
        most = min(most, max(GRID_TIMES * made_from_px, GRID_LEAST_PX))
    cols, rows = counts
    if not cols * rows <= most:
        raise InputError(
            f"{what} would have {cols:.6g} x {rows:.6g} pixels, and at most {most:.0f} are made from these "
            "rasters: check their georeferencing, --te and --tr"
        )
    if not max(cols, rows) <= GRID_SIDE_PX:
        raise InputError(
            f"{what} would have {cols:.6g} x {rows:.6g} pixels, and at most {GRID_SIDE_PX} a side are made: "
            "check their georeferencing, --te and --tr"
        )


def check_output_pixel(step_px: Sequence[float]) -> None:
    """Raise where the pixels of an output grid are too large for those that they are made from.

    Parameters
    ----------
    step_px : two floats
        Pixels of the output along the two principal directions of a pixel of the target.

    Raises
    ------
    InputError
        If a side is longer than `OUTPUT_PIXEL_PX` pixels of the target.
    """
    least = min(step_px)
    if math.isfinite(least) and not least * OUTPUT_PIXEL_PX >= 1:
        raise InputError(
            f"a pixel of the output grid is {1 / max(least, 1e-300):.3g} pixels of the target long, and "
            f"at most {OUTPUT_PIXEL_PX:.0f} are weighed together: check --tr, --like and the georeferencing"
        )


def check_created_block(key: str, value: str) -> None:
    """Raise where a creation option asks for blocks that no memory holds.

    Raises
    ------
    SettingsError
        If it is no whole number from 1 to `CREATED_BLOCK_PX`.
    """
    if not (value.isascii() and value.isdigit() and 1 <= int(value[:10]) <= CREATED_BLOCK_PX):
        raise SettingsError(
            f"co = {key}={value[:20]}: blocks have from 1 to {CREATED_BLOCK_PX} px a side, and GDAL allows "
            "multiples of 16 only for tiles: give such a number"
        )


def check_count(where: str, count: int, most: int, things: str) -> None:
    """Raise where there are more things (points, pairs, files) than are read.

    Raises
    ------
    InputError
        Then.
    """
    if count > most:
        raise InputError(f"{where} holds more than {most} {things}: at most so many are read; divide it")


def check_unpacked(archive: str, unpacked: int, packed: int) -> None:
    """Raise where an archive unpacks to far more than images do.

    Parameters
    ----------
    archive : str
    unpacked, packed : int
        Bytes.

    Raises
    ------
    InputError
        Beyond `UNPACKED_BYTES` and `UNPACKED_RATIO` times its size.
    """
    if unpacked > max(UNPACKED_BYTES, UNPACKED_RATIO * packed):
        raise InputError(
            f"{archive} has {packed} bytes and unpacks to {unpacked}, and at most {UNPACKED_RATIO} times its "
            f"size are read beyond {UNPACKED_BYTES}: get it again, or unpack it yourself if you trust it"
        )


def check_rpc(origin: str, name: str, value: float) -> None:
    """Raise where a number of an RPC is larger than any image or the earth.

    Raises
    ------
    InputError
        Beyond `RPC_LIMITS`, coefficients beyond `RPC_COEFFICIENT`.
    """
    most = RPC_LIMITS.get(name, RPC_COEFFICIENT)
    if not abs(value) <= most:
        raise InputError(
            f"the RPC in {origin} has {name.upper()} = {value:.6g}, and at most {most:.6g} makes sense: get "
            "it again, or delete it to register without it"
        )
