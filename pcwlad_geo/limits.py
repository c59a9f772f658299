"""Limits of what is read and written, so that no input makes a run need unlimited memory or time.

Every limit is far beyond what real data need. An error about a limit says which one it is, what was found and
what to do; docs/development/limits.md lists all limits.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

if sys.platform != "win32":
    import resource

from pcwlad_geo.errors import ExecutionError, InputError, SettingsError


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits, each with the reason for it."""

    file_px: int = 2**36
    """Largest number of pixels of a band of a file: a square of 262,144 px, six times the largest mosaics."""
    checked_px: int = 2**28
    """Number of pixels of a band above which it is checked that its files can hold them."""
    px_per_byte: int = 2000
    """Largest number of pixels of a band per byte of its files; Deflate packs at most 1,032 bytes into
    one."""
    min_stored: float = 1 / 128
    """Least share of the blocks of a large TIFF that must be stored in the file; a sparse file is empty."""
    block_bytes: int = 2**30
    """Largest size of an unpacked block (tile or strip), as GDAL holds at least one whole block in memory."""
    bands: int = 4096
    """Largest number of bands of a file, ten times that of imaging spectrometers."""
    address_space_bytes: int = 2**31
    """Least address space of a process (`ulimit -v`), below which libraries fail when they are mapped."""
    coordinate: float = 1e10
    """Largest map coordinate, in map units; the circumference of the earth is 4e7 m or 1.3e8 feet."""
    pixel_share: float = 1e-11
    """Least pixel size as a share of the map coordinates: a 64-bit number holds 16 digits, and a hundredth of
    a pixel must be resolved."""
    basemap_tiles: int = 1024
    """Largest number of tiles of a web map that a run fetches, out of regard for the server: 67 million
    pixels."""
    basemap_zoom: int = 24
    """Largest zoom of a web map, pixels of 9 mm."""
    tile_bytes: int = 2**24
    """Largest size of a tile of a web map as it comes."""
    pixel_ratio: float = 1000.0
    """Largest ratio of the pixel sizes of two rasters, beyond which they share no structure."""
    pixel_shape: float = 16.0
    """Largest ratio of length to width of the pixels of one raster on the grid of the other."""
    gcp_misfit_share: float = 0.25
    """Largest misfit of a geotransform at a control point, as a share of the image's longer side."""
    grid_px: int = 2**34
    """Largest number of pixels of an output grid: a square of 131,072 px."""
    grid_side_px: int = 2**20
    """Largest number of columns or rows of an output grid, four times those of the widest mosaics."""
    output_pixel_px: float = 1e4
    """Largest side of a pixel of an output grid, in pixels of the target, all of which are weighted
    together."""
    created_block_px: int = 8192
    """Largest side of a block of a written file, as all bands of several blocks are held in memory at
    once."""
    grid_times: int = 64
    """Largest number of pixels of an output grid per pixel of the rasters from which it is made."""
    grid_least_px: int = 2**28
    """Number of pixels that an output grid may always have, whatever it is made from."""
    unread_parts: int = 500
    """Largest number of parts of a damaged file that are tried one by one."""
    search_radius_px: int = 1024
    """Largest search radius of the matching; every tile is read with a margin of this width."""
    spacing_px: int = 10_000
    """Largest side of a pixel of a displacement field, reference px."""
    tile_px: int = 4096
    """Largest side of a tile, whose maps take about 100 bytes per pixel."""
    features: int = 100_000
    """Largest number of candidates of a tile."""
    iterations: int = 1000
    """Largest number of steps of a refinement, which usually takes about ten."""
    jobs: int = 1024
    """Largest number of workers."""
    sigma_px: tuple[float, float] = (1e-4, 1e4)
    """Least and largest sigma of a tie point of a file, px; 64-bit numbers cannot weigh others together."""
    points: int = 250_000
    """Largest number of tie points of a file; all are held in memory and used in each fit."""
    areas: int = 100_000
    """Largest number of areas of a vector file around a raster; all are held in memory."""
    vertices: int = 2**22
    """Largest number of their vertices; detailed coasts of a continent have a million."""
    segments: int = 2**18
    """Number of parts into which edges of areas are divided at most where they are curved on the raster."""
    reading_s: float = 60.0
    """Longest time, in seconds, in which a vector file or a database is read; real ones take less than
    one."""
    reading_bytes: int = 3 * 2**30
    """Largest address space of the process that reads a vector file."""
    json_depth: int = 50
    """Levels of objects and lists within each other in a JSON file; those of STAC have about ten."""
    json_digits: int = 300
    """Largest number of digits of a whole number in a JSON file, which a float still holds."""
    text_bytes: int = 2**26
    """Largest size of an unpacked text file (table, side file, metadata of a product)."""
    xmp_bytes: int = 2**20
    """Largest XMP packet of a raster that is parsed; those of cameras have some kB."""
    batch_rows: int = 100_000
    """Largest number of pairs of a batch table."""
    rig_lenses: int = 16
    """Largest number of lenses of a rig."""
    rig_frames: int = 100_000
    """Largest number of frames of a run of a rig."""
    trend_figures: int = 100_000
    """Largest number of pairs in the reports of a trend; each is drawn."""
    options_bytes: int = 2**14
    """Largest size of a file of options; reading TOML takes time with the cube of its nested names."""
    rpc_bytes: int = 2**16
    """Largest size of an RPC file; real ones have about three kilobytes."""
    metadata_bytes: int = 2**24
    """Largest size of a product's metadata, unpacked; those of Sentinel-2 have about a megabyte, and XML
    takes up to 40 times its bytes once it is read."""
    vrt_bytes: int = 2**25
    """Largest size of a VRT; mosaics of 10,000 tiles have a few megabytes."""
    members: int = 100_000
    """Largest number of files in an archive or a folder of a product."""
    unpacked_bytes: int = 2**30
    """Unpacked size that any archive may have, whatever its packed size."""
    unpacked_ratio: int = 200
    """Largest ratio of unpacked to packed size of a larger archive; images have two or three."""
    name_bytes: int = 255
    """Largest length of the name of a file or folder on all common file systems."""
    latitude: float = 90.0
    """Largest latitude in degrees; a pixel may be centred on the pole."""
    rpc_coefficient: float = 1e6
    """Largest absolute value of the coefficients of an RPC, which apply to normalised coordinates."""


LIMITS: Final = Limits()
"""Those of all jobs."""
RPC_LIMITS: Final = {
    **dict.fromkeys(("line_off", "samp_off", "line_scale", "samp_scale"), 1e7),
    **dict.fromkeys(("lat_off", "lat_scale"), 90.0),
    **dict.fromkeys(("long_off", "long_scale"), 360.0),
    **dict.fromkeys(("height_off", "height_scale"), 2e4),
}
"""Largest absolute values of the offsets and scales of an RPC, in pixels, degrees or metres."""


def check_address_space() -> None:
    """Raise `ExecutionError` if the process may use less than `address_space_bytes` of address space."""
    if sys.platform == "win32":  # has no such limit
        return
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY and most < LIMITS.address_space_bytes:
        raise ExecutionError(
            f"the process may use {most / 2**30:.2g} GiB of address space, and at least "
            f"{LIMITS.address_space_bytes / 2**30:.0f} GiB of memory are needed: raise its limit (ulimit -v)"
        )


def check_shape(uri: str, shape: tuple[int, int], bands: int) -> None:
    """Raise `InputError` if a raster has more than `file_px` pixels or `bands` bands.

    `uri` is the raster's name for the message, as in all checks; `shape` is (rows, columns).
    """
    rows, cols = shape
    if rows * cols > LIMITS.file_px:
        raise InputError(
            f"{uri} declares {cols} x {rows} pixels, and at most {LIMITS.file_px} are read: it "
            "may be damaged; crop it"
        )
    if bands > LIMITS.bands:
        raise InputError(
            f"{uri} declares {bands} bands, and at most {LIMITS.bands} are read: it may be damaged; "
            "extract the bands that are needed (gdal_translate -b)"
        )


def check_stored(uri: str, shape: tuple[int, int], file_bytes: int) -> None:
    """Raise `InputError` if a raster of `shape` (rows, columns) has too few `file_bytes`.

    These are fewer than one for `px_per_byte` pixels, where there are more than `checked_px` pixels.
    """
    rows, cols = shape
    if rows * cols > LIMITS.checked_px and rows * cols > LIMITS.px_per_byte * file_bytes:
        raise InputError(
            f"{uri} declares {cols} x {rows} pixels and has {file_bytes} bytes, less than one for "
            f"{LIMITS.px_per_byte} pixels: it is empty or damaged; crop it to where it holds data"
        )


def check_block(uri: str, shape: tuple[int, int], bytes_per_px: int) -> None:
    """Raise `InputError` if a block of `shape` (rows, columns), all bands, is larger than `block_bytes`."""
    rows, cols = shape
    if rows * cols * bytes_per_px > LIMITS.block_bytes:
        raise InputError(
            f"{uri} is stored in blocks of {cols} x {rows} pixels, {rows * cols * bytes_per_px} bytes "
            f"each, and at most {LIMITS.block_bytes} are read at once: it may be damaged; tile it "
            "(gdal_translate -co TILED=YES)"
        )


def check_geotransform(uri: str, numbers: Sequence[float], shape: tuple[int, int]) -> None:
    """Raise `InputError` if a geotransform leads beyond `coordinate`, or its pixels are too small for that.

    These are smaller than `pixel_share` of the coordinates. The `numbers` a to f mean x = a col + b row + c,
    y = d col + e row + f; `shape` is (rows, columns).
    """
    a, b, c, d, e, f = numbers
    rows, cols = shape
    reach = (abs(c) + abs(a) * cols + abs(b) * rows, abs(f) + abs(d) * cols + abs(e) * rows)
    least = min(math.hypot(a, d), math.hypot(b, e))
    advice = "correct the geotransform (gdal_edit.py -a_ullr)"
    if not all(extreme <= LIMITS.coordinate for extreme in reach):  # NaN is not
        raise InputError(
            f"{uri} has map coordinates up to {max(reach):.3g}, and at most {LIMITS.coordinate:.0e} "
            f"are read: {advice}"
        )
    if not least >= LIMITS.pixel_share * max(abs(c), abs(f)):
        raise InputError(
            f"{uri} has pixels of {least:.3g} map units at coordinates of {max(abs(c), abs(f)):.7g}, which "
            f"64-bit numbers cannot tell apart: {advice}"
        )


def check_coordinates(uri: str, values: Sequence[float]) -> None:
    """Raise `InputError` if one of the coordinates `values` of the file `uri` is beyond `coordinate`."""
    beyond = next((value for value in values if not abs(value) <= LIMITS.coordinate), None)
    if beyond is not None:
        raise InputError(
            f"{uri} has a point with the coordinate {beyond:.3g}, and at most "
            f"{LIMITS.coordinate:.0e} is read: remove it"
        )


def check_latitudes(uri: str, lowest: float, highest: float, pixel: float) -> None:
    """Raise `InputError` if `lowest` or `highest`, degrees, is beyond `latitude` plus the size `pixel`."""
    if lowest < -LIMITS.latitude - pixel or highest > LIMITS.latitude + pixel:
        raise InputError(
            f"{uri} covers latitudes from {lowest:.10g} to {highest:.10g} degrees, and there are none beyond "
            "90: correct its geotransform or its CRS (x is the longitude, y the latitude)"
        )


def check_pixel_ratio(reference: str, target: str, step_px: Sequence[float]) -> None:
    """Raise `InputError` if two rasters' pixels differ by more than `pixel_ratio`, or `pixel_shape`.

    `step_px` are the pixels of one raster along the columns and the rows of the other.
    """
    low, high = min(step_px), max(step_px)
    if not (math.isfinite(high) and low > 0):
        return  # one raster does not lie in the other's CRS, which is reported elsewhere
    ratio = max(high, 1 / low)
    if ratio > LIMITS.pixel_ratio:
        raise InputError(
            f"a pixel of {reference} and one of {target} differ {ratio:.3g} times in size, and at most "
            f"{LIMITS.pixel_ratio:.0f} times can be matched: check both geotransforms, or resample "
            "the finer raster"
        )
    if high / low > LIMITS.pixel_shape:
        raise InputError(
            f"the pixels of {reference} and {target} differ {high / low:.3g} times in their shape (width to "
            f"height), and at most {LIMITS.pixel_shape:.0f} times can be matched: check both geotransforms"
        )


def check_gcp_misfit(uri: str, misfit_px: float, shape: tuple[int, int]) -> None:
    """Raise `InputError` if a geotransform misses control points by `misfit_px`, which is too much.

    That is more than `gcp_misfit_share` of the longer side of `shape`.
    """
    if not misfit_px <= LIMITS.gcp_misfit_share * max(shape):
        raise InputError(
            f"{uri} has ground control points that a geotransform misses by up to {misfit_px:.3g} px, more "
            f"than {LIMITS.gcp_misfit_share:.0%} of its longer side: one of them is wrong; remove it"
        )


def check_grid(what: str, counts: Sequence[float], source_px: float | None = None) -> None:
    """Raise `InputError` if an output grid, `what` in the message, would have too many pixels.

    These are more than `grid_px`, than `grid_side_px` a side, or than `grid_times` the `source_px` from
    which it is made (at least `grid_least_px`). `counts` are its columns and rows.
    """
    most = float(LIMITS.grid_px)
    if source_px is not None:
        most = min(most, max(LIMITS.grid_times * source_px, LIMITS.grid_least_px))
    cols, rows = counts
    if not cols * rows <= most:
        raise InputError(
            f"{what} would have {cols:.6g} x {rows:.6g} pixels, and at most {most:.0f} are made from these "
            "rasters: check their georeferencing, --te and --tr"
        )
    if not max(cols, rows) <= LIMITS.grid_side_px:
        raise InputError(
            f"{what} would have {cols:.6g} x {rows:.6g} pixels, and at most {LIMITS.grid_side_px} a "
            "side are made: check their georeferencing, --te and --tr"
        )


def check_output_pixel(step_px: Sequence[float]) -> None:
    """Raise `InputError` if a side of an output pixel is longer than `output_pixel_px` target pixels.

    `step_px` are the lengths of the two principal axes of a target pixel, in pixels of the output.
    """
    least = min(step_px)
    if math.isfinite(least) and not least * LIMITS.output_pixel_px >= 1:
        raise InputError(
            f"a pixel of the output grid is {1 / max(least, 1e-300):.3g} pixels of the target long, and "
            f"at most {LIMITS.output_pixel_px:.0f} are weighed together: check --tr, --like and the "
            "georeferencing"
        )


def check_created_block(key: str, value: str) -> None:
    """Raise `SettingsError` if the creation option `key` is no number from 1 to `created_block_px`."""
    if not (value.isascii() and value.isdigit() and 1 <= int(value[:10]) <= LIMITS.created_block_px):
        raise SettingsError(
            f"co = {key}={value[:20]}: blocks have from 1 to {LIMITS.created_block_px} px a side, "
            "and GDAL allows multiples of 16 only for tiles: give such a number"
        )


def check_count(where: str, count: int, most: int, things: str) -> None:
    """Raise `InputError` if the `count` of `things` (points, pairs, files) in `where` is above `most`."""
    if count > most:
        raise InputError(f"{where} holds more than {most} {things}: at most so many are read; divide it")


def check_unpacked(archive: str, unpacked: int, packed: int) -> None:
    """Raise `InputError` if an archive of `packed` bytes has too many `unpacked` ones.

    These are more than `unpacked_bytes` and more than `unpacked_ratio` times as many.
    """
    if unpacked > max(LIMITS.unpacked_bytes, LIMITS.unpacked_ratio * packed):
        raise InputError(
            f"{archive} has {packed} bytes and unpacks to {unpacked}, and at most "
            f"{LIMITS.unpacked_ratio} times its "
            f"size are read beyond {LIMITS.unpacked_bytes}: get it again, or unpack it yourself if "
            "you trust it"
        )


def check_rpc(origin: str, name: str, value: float) -> None:
    """Raise `InputError` if the number `name` of the RPC in `origin` is beyond what any image has."""
    most = RPC_LIMITS.get(name, LIMITS.rpc_coefficient)
    if not abs(value) <= most:
        raise InputError(
            f"the RPC in {origin} has {name.upper()} = {value:.6g}, and at most {most:.6g} makes sense: get "
            "it again, or delete it to register without it"
        )
