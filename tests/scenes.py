"""Rasters of a synthetic scene that is defined at every point of the ground, with a known displacement.

Each band is a smooth function of a few random fields, each a sum of plane waves. On an affine grid a plane
wave is an outer product, so an image is a few matrix products, and nothing is ever resampled: a displaced
raster is the ground evaluated where the displacement says.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from scipy.interpolate import RectBivariateSpline

from pcwlad_geo.raster import Grid, RpcGrid, transform_xy

Array = NDArray[np.float64]
Field = Callable[[Array], Array]
"""(n, 2) predicted pixels to (n, 2) displacements, px."""

PIXEL_M = 30.0
ORIGIN_XY_M = np.array([500000.0, 4600000.0])
CRS_OF_SCENE = CRS.from_epsg(32633)

_FIELDS, _WAVES = 5, 40
_WAVELENGTHS_PX = (9.0, 60.0)
_EDGE_STEEPNESS = 4.0
_BLOCK = 4000
"""So many points are computed at once: their waves fit into the processor's cache."""
_SPLINE_STEP_PX = 4
# What each band sees of the fields: shared edges of other contrast, and a field of its own.
_CONTRASTS = {"red": (50.0, 40.0, 30.0, 12.0, 0.0), "thermal": (-40.0, 45.0, -30.0, 0.0, 12.0)}


def make_grid(
    shape: tuple[int, int] = (240, 240),
    *,
    pixel_m: float = PIXEL_M,
    offset_m: tuple[float, float] = (0.0, 0.0),
    rotation_deg: float = 0.0,
    south_up: bool = False,
) -> Grid:
    """Return a grid on the scene with its top-left corner `offset_m` (east, south) of the scene's origin."""
    corner = ORIGIN_XY_M + np.array([offset_m[0], -offset_m[1]])
    transform = Affine.translation(*corner) @ Affine.rotation(rotation_deg) @ Affine.scale(pixel_m, -pixel_m)
    if south_up:
        transform = transform @ Affine.translation(0, shape[0]) @ Affine.scale(1, -1)
    return Grid(shape, transform, CRS_OF_SCENE)


def render(
    grid: Grid,
    band: str = "red",
    *,
    seed: int = 0,
    displacement_px: ArrayLike = (0.0, 0.0),
    linear: ArrayLike | None = None,
    local: Field | None = None,
    noise: float = 1.0,
) -> Array:
    """Render a band on a grid, values about 0 to 255.

    Parameters
    ----------
    grid : Grid
        In the CRS of the scene or any other.
    band : {"red", "thermal"}
    seed : int
        Selects the scene.
    displacement_px : (2,) array
        Observed minus predicted (col, row): what the grid says lies at p is seen at p + displacement.
    linear : (2, 2) array, optional
        observed = linear · predicted + displacement; identity by default.
    local : callable, optional
        A displacement that varies from place to place, besides.
    noise : float
        Standard deviation.
    """
    rng = np.random.default_rng(seed)
    count = (_FIELDS, _WAVES)
    wavelength = np.exp(rng.uniform(*np.log(_WAVELENGTHS_PX), count))
    direction = rng.uniform(0, np.pi, count)
    frequency = 2 * np.pi / wavelength * np.stack([np.cos(direction), np.sin(direction)])
    phase = rng.uniform(0, 2 * np.pi, count)
    amplitude = np.sqrt(wavelength) / np.sqrt((wavelength / 2).sum(axis=1, keepdims=True))

    rows, cols = grid.shape
    matrix = np.linalg.inv(np.eye(2) if linear is None else np.asarray(linear, float))
    shift = np.asarray(displacement_px, float)
    value = np.full(grid.shape, 127.0)
    plain = grid.crs == CRS_OF_SCENE and local is None
    ground = np.empty((0, 2))
    if not plain:

        def seen(rows: Array, cols: Array) -> Array:
            observed = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
            predicted = _predicted(observed, matrix, shift, local)
            return _ground(transform_xy(grid.to_xy(predicted), grid.crs, CRS_OF_SCENE))

        centres = np.arange(rows) + 0.5, np.arange(cols) + 0.5
        ground = _between(seen, *centres) if isinstance(grid, RpcGrid) and local is None else seen(*centres)
    for field, contrast in enumerate(_CONTRASTS[band]):
        if not contrast:
            continue
        waves = frequency[:, field], phase[field], amplitude[field]
        if plain:
            total = _on_affine_grid(grid, matrix, shift, *waves)
        else:
            total = _at_points(ground, *waves).reshape(grid.shape)
        value += contrast * np.tanh(_EDGE_STEEPNESS * total) / 2
    return value + noise * np.random.default_rng([seed, len(band), cols]).standard_normal(grid.shape)


def _predicted(observed: Array, matrix: Array, shift: Array, local: Field | None) -> Array:
    predicted = (observed - shift) @ matrix.T
    for _ in range(0 if local is None else 12):
        predicted = (observed - shift - local(predicted)) @ matrix.T
    return predicted


def _between(seen: Callable[[Array, Array], Array], rows: Array, cols: Array) -> Array:
    """Return what is seen at all pixels, by a spline through some: lines of sight take long to follow.

    The relief of the scene is smooth: the spline is right to 0.001 px (RMS).
    """
    nodes = [np.linspace(at[0], at[-1], len(at) // _SPLINE_STEP_PX + 2) for at in (rows, cols)]
    lattice = seen(*nodes).reshape(len(nodes[0]), len(nodes[1]), 2)
    if not np.isfinite(lattice).all():  # beyond the relief
        return seen(rows, cols)
    axes = [RectBivariateSpline(*nodes, lattice[..., axis])(rows, cols).ravel() for axis in (0, 1)]
    return np.column_stack(axes)


def _ground(xy: Array) -> Array:
    """Return scene coordinates, in scene pixels, of map coordinates."""
    return (xy - ORIGIN_XY_M) / [PIXEL_M, -PIXEL_M]


def _on_affine_grid(
    grid: Grid, matrix: Array, shift: Array, frequency: Array, phase: Array, amplitude: Array
) -> Array:
    rows, cols = grid.shape
    base = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    origin, right, down = _ground(grid.to_xy((base - shift) @ matrix.T))
    along_cols = np.outer(np.arange(cols) + 0.5, (right - origin) @ frequency)
    along_rows = np.outer(np.arange(rows) + 0.5, (down - origin) @ frequency) + (origin @ frequency + phase)
    waves = (np.exp(1j * along_rows) * amplitude) @ np.exp(1j * along_cols).T
    return np.asarray(waves.real)


def _at_points(ground: Array, frequency: Array, phase: Array, amplitude: Array) -> Array:
    """Return the sums of waves to about 1e-6: single precision, of angles that are small, is far quicker."""
    total = np.empty(len(ground))
    for begin in range(0, len(ground), _BLOCK):
        part = slice(begin, begin + _BLOCK)
        turns = (ground[part] @ frequency + phase) / (2 * np.pi)
        angles = (2 * np.pi * (turns - np.rint(turns))).astype(np.float32)
        total[part] = np.cos(angles) @ amplitude.astype(np.float32)
    return total


def write(path: Path, values: NDArray[np.generic], grid: Grid | None, **options: object) -> Path:
    """Write bands, (rows, cols) or (bands, rows, cols), as a raster; without a grid it has no georeferencing.

    Float values are stored as 16-bit unsigned ones, times 200, unless `dtype` says otherwise.
    """
    profile: dict[str, Any] = {"driver": "GTiff", "dtype": "uint16", **options}
    if values.dtype.kind == "f" and profile["dtype"] == "uint16":
        values = np.clip(np.rint(values * 200), 1, 65535)
    elif values.dtype.kind == "f" and profile["dtype"] == "uint8":
        values = np.clip(np.rint(values), 1, 255)
    bands = values[None] if values.ndim == 2 else values
    where = {} if grid is None else {"crs": grid.crs, "transform": grid.transform}
    size = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **size, **where, **profile) as file:
            file.write(bands.astype(profile["dtype"]))
    return path


def tag_frame(path: Path, **exif: str) -> Path:
    """Give a raster without georeferencing EXIF tags, such as FocalLength="(8.5)"."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as file:
            file.update_tags(ns="EXIF", **{f"EXIF_{name}": value for name, value in exif.items()})
    return path


_EXIF_TAGS = {
    "GPSLatitudeRef": (0x8825, 1), "GPSLatitude": (0x8825, 2), "GPSLongitudeRef": (0x8825, 3),
    "GPSLongitude": (0x8825, 4), "GPSAltitudeRef": (0x8825, 5), "GPSAltitude": (0x8825, 6),
    "FocalLength": (0x8769, 0x920A), "PixelXDimension": (0x8769, 0xA002),
    "FocalPlaneXResolution": (0x8769, 0xA20E), "FocalPlaneResolutionUnit": (0x8769, 0xA210),
    "FocalLengthIn35mmFilm": (0x8769, 0xA405),
}  # fmt: skip
"""Of each tag that a JPEG can be given: the IFD that holds it, and its number (CIPA DC-008)."""


def tag_jpeg(path: Path, xmp: str = "", **exif: str | int | Sequence[float]) -> Path:
    """Give a JPEG the segments that a camera writes: EXIF tags, such as FocalLength=[8.5], and an XMP packet.

    Text is stored as ASCII, whole numbers as SHORT, and sequences as RATIONAL numbers.
    """
    segments = [b"Exif\0\0" + _exif_block(exif)] if exif else []
    segments += [b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode()] if xmp else []
    whole = path.read_bytes()
    framed = [b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content for content in segments]
    path.write_bytes(whole[:2] + b"".join(framed) + whole[2:])
    return path


def _exif_block(exif: Mapping[str, str | int | Sequence[float]]) -> bytes:
    """Return a little-endian TIFF header with the IFDs of EXIF and GPS, and the values after each."""
    pointers = sorted({_EXIF_TAGS[name][0] for name in exif})
    block = b"II*\0" + struct.pack("<IH", 8, len(pointers))
    begin, below = 8 + 2 + 12 * len(pointers) + 4, b""
    for pointer in pointers:
        block += struct.pack("<HHII", pointer, 4, 1, begin + len(below))
        entries = sorted(
            (_EXIF_TAGS[name][1], value) for name, value in exif.items() if _EXIF_TAGS[name][0] == pointer
        )
        below += _ifd(entries, begin + len(below))
    return block + bytes(4) + below


def _ifd(entries: Sequence[tuple[int, str | int | Sequence[float]]], begin: int) -> bytes:
    ifd, values = struct.pack("<H", len(entries)), b""
    for tag, value in entries:
        if isinstance(value, str):
            kind, content = 2, value.encode() + b"\0"
            count = len(content)
        elif isinstance(value, int):
            kind, content, count = 3, struct.pack("<H", value), 1
        else:
            fractions = [Fraction(number).limit_denominator(10**6) for number in value]
            content = b"".join(struct.pack("<II", each.numerator, each.denominator) for each in fractions)
            kind, count = 5, len(fractions)
        if len(content) > 4:
            where = begin + 2 + 12 * len(entries) + 4 + len(values)
            values += content
            content = struct.pack("<I", where)
        ifd += struct.pack("<HHI", tag, kind, count) + content.ljust(4, b"\0")
    return ifd + bytes(4) + values
