"""A landscape at any position, compiled: fields, towns, roads, woods, water, hills, in two bands.

Red reflectance and surface temperature follow from land cover, texture and sun; neither is computed from the
other, and each has structures of its own. Distances are in pixels of 10 m.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.speed_studies.coordinate_noise import (
    Float32,
    Float64,
    add_noise,
    hash_position,
    part,
    smoothstep,
)

RED: Final = 0
THERMAL: Final = 1

DISTRICT_PX: Final = 640.0
ROAD_PX: Final = 1.3
"""Half width of a road."""
HEDGE_PX: Final = 0.7
_DETECTOR_PX: Final = np.array([0.5, 0.7])
"""Half width of what a pixel sees; the thermal band is the coarser one."""

# Red reflectance and surface minus air temperature, K, of what grows on a parcel; their spread; how often.
# Dark dry soil and flowering rape invert the contrast that the others share.
_CROPS: Final = np.array(
    [
        [0.190, 7.0, 0.050, 3.5, 0.21],  # ripe cereal
        [0.200, 8.0, 0.050, 3.5, 0.16],  # stubble
        [0.055, -2.5, 0.020, 2.5, 0.20],  # irrigated maize
        [0.050, -1.5, 0.020, 2.5, 0.12],  # alfalfa
        [0.085, 2.5, 0.030, 3.5, 0.15],  # moist soil
        [0.095, 10.0, 0.034, 3.5, 0.04],  # dark dry soil
        [0.150, -1.0, 0.034, 2.5, 0.04],  # flowering rape
        [0.085, 3.0, 0.034, 3.5, 0.08],  # pasture
    ]
)
_CROP_LIMITS: Final = np.cumsum(_CROPS[:-1, 4])
_OWN_SPREAD: Final = 0.5
"""Share of the spread among parcels of one crop that the bands do not have in common."""
_ROAD: Final = np.array([0.165, 7.0])
_HEDGE: Final = np.array([0.035, -1.5])
_HEATH: Final = np.array([0.120, 4.0])
_WOOD: Final = np.array([0.034, -2.5])
_STANDS: Final = np.array([0.020, 1.2])  # change from one kind of trees to the other
_WATER: Final = np.array([0.028, -7.0])

_TEXTURE: Final = np.array([0.17, 1.6])  # of one band alone: relative, and K
_VIGOUR: Final = np.array([-0.13, -1.4])  # lush ground is darker and cooler: seen by both
_PATCHES: Final = np.array([0.06, 1.5])  # haze, passed cloud shadows: soft, of one band alone
_SUN: Final = np.array([[0.62, -0.78], [0.90, 0.43]])  # towards the light: noon, the morning's warmth
_SHADE: Final = np.array([7.0, 80.0])  # effect of a slope of 1 towards the sun: relative, and K

# One row an octave, 4096 px to 4 px: the amplitudes of four fields.
_WAVELENGTHS_PX: Final = 4096.0 / 2.0 ** np.arange(11)
_TERRAIN: Final = np.array(  # height (in px), valley, wood, vigour
    [
        [22.0, 1.00, 0.0, 0.0],
        [12.0, 0.60, 0.5, 0.0],
        [6.5, 0.30, 0.7, 0.3],
        [3.5, 0.14, 0.5, 0.4],
        [1.8, 0.06, 0.4, 0.5],
        [0.9, 0.03, 0.28, 0.5],
        [0.45, 0.01, 0.20, 0.50],
        [0.2, 0.0, 0.12, 0.50],
        [0.0, 0.0, 0.07, 0.50],
        [0.0, 0.0, 0.0, 0.50],
        [0.0, 0.0, 0.0, 0.50],
    ],
    np.float32,
)
_BENDS: Final = np.array(  # of the borders along x and y in px, upland, stands of trees
    [
        [0.0, 0.0, 1.0, 0.0],
        [12.0, 12.0, 0.5, 0.0],
        [7.0, 7.0, 0.2, 0.6],
        [4.0, 4.0, 0.0, 0.6],
        [1.6, 1.6, 0.0, 0.5],
        [0.0, 0.0, 0.0, 0.4],
    ],
    np.float32,
)
_OWN: Final = np.array(  # texture and patches of the red band, of the thermal band
    [
        [0.0, 0.0, 0.0, 0.0],
        [0.0, 0.3, 0.0, 0.3],
        [0.0, 0.8, 0.0, 0.8],
        [0.3, 0.6, 0.3, 0.6],
        [0.4, 0.4, 0.4, 0.4],
        [0.5, 0.2, 0.5, 0.2],
        [0.45, 0.0, 0.45, 0.0],
        [0.35, 0.0, 0.35, 0.0],
        [0.30, 0.0, 0.30, 0.0],
        [0.20, 0.0, 0.20, 0.0],
        [0.10, 0.0, 0.10, 0.0],
    ],
    np.float32,
)


def land_row(x_px: Float64, y_px: Float64, band: int, seed: int) -> Float64:
    """Evaluate a band along a row of positions.

    Parameters
    ----------
    x_px, y_px : (n,) float64 arrays
        Positions, corner-based; neighbours near each other.
    band : int
        RED: reflectance, about 0.02 to 0.4. THERMAL: surface minus air temperature, K, about -10 to 20.
    seed : int
        Selects the landscape.

    Returns
    -------
    (n,) float64 array
    """
    terrain, bends, own = (np.zeros((6, len(x_px)), np.float32) for _ in range(3))
    wanted = np.repeat(np.arange(2) == band, 2).astype(np.float32)
    tables = ((_TERRAIN, terrain), (_BENDS, bends), (_OWN * wanted, own))
    for group, (table, fields) in enumerate(tables):
        for octave, gain in enumerate(table):
            if gain.any():
                key = seed * 1000 + group * 100 + octave
                add_noise(x_px, y_px, _WAVELENGTHS_PX[octave], key, gain, fields)
    values = np.empty(len(x_px))
    _paint(x_px, y_px, terrain, bends, own[2 * band : 2 * band + 2], band, seed * 1000 + 900, values)
    return values


@njit(cache=True, nogil=True)
def _paint(
    x_px: Float64,
    y_px: Float64,
    terrain: Float32,
    bends: Float32,
    own: Float32,
    band: int,
    key: int,
    out: Float64,
) -> None:
    """Put together what is at each position."""
    sites, last_i, last_j = np.empty((9, 2)), 1 << 60, 1 << 60
    bits = np.empty(9, np.uint64)
    for n in range(len(x_px)):
        x, y = x_px[n] + bends[0, n], y_px[n] + bends[1, n]
        i, j = int(np.floor(x / DISTRICT_PX)), int(np.floor(y / DISTRICT_PX))
        if i != last_i or j != last_j:
            last_i, last_j = i, j
            _place_districts(i, j, key, sites, bits)
        nearest, border_px = _district(x, y, sites)
        upland = smoothstep(bends[2, n], 0.6, 1.4)
        value = _ground(x, y, bits[nearest], band, key)
        value += (_HEATH[band] - value) * upland
        wood = smoothstep(terrain[2, n] + 0.6 * upland, 0.95, 1.05)
        stand = smoothstep(bends[3, n], 0.15, 0.30)
        value += (_WOOD[band] + stand * _STANDS[band] - value) * wood
        road = _coverage(ROAD_PX - border_px, band) * (1.0 - upland)
        value += (_ROAD[band] - value) * road
        water = smoothstep(-abs(terrain[1, n] + 0.3), -0.030, -0.022)
        water = max(water, smoothstep(terrain[1, n], 1.95, 1.97))
        value = _lit(value, terrain[:, n], own[:, n], upland, band)
        out[n] = value + (_WATER[band] - value) * water


@njit(cache=True, nogil=True)
def _lit(value: float, terrain: Float32, own: Float32, upland: float, band: int) -> float:
    """Add texture, and what the slope does with the sun."""
    slope = terrain[4] * _SUN[band, 0] + terrain[5] * _SUN[band, 1]
    change = _TEXTURE[band] * own[0] + _PATCHES[band] * own[1] + _VIGOUR[band] * terrain[3]
    change += _SHADE[band] * slope * (0.3 + upland)
    return value * max(1.0 + change, 0.2) if band == RED else value + change


@njit(cache=True, nogil=True)
def _place_districts(i: int, j: int, key: int, sites: Float64, bits: NDArray[np.uint64]) -> None:
    """Fill the sites of the 3 x 3 cells around a cell."""
    for n in range(9):
        col, row = i + n % 3 - 1, j + n // 3 - 1
        bits[n] = hash_position(col, row, key)
        sites[n, 0] = (col + 0.15 + 0.7 * part(bits[n], 0)) * DISTRICT_PX
        sites[n, 1] = (row + 0.15 + 0.7 * part(bits[n], 1)) * DISTRICT_PX
        bits[n] = hash_position(col, row, key + 1)


@njit(cache=True, nogil=True)
def _district(x: float, y: float, sites: Float64) -> tuple[int, float]:
    """Return the nearest site and the distance to the border of its Voronoi cell, px."""
    first, second, nearest, next_one = np.inf, np.inf, 0, 0
    for n in range(9):
        distance = (sites[n, 0] - x) ** 2 + (sites[n, 1] - y) ** 2
        if distance < first:
            first, second, nearest, next_one = distance, first, n, nearest
        elif distance < second:
            second, next_one = distance, n
    apart = np.hypot(sites[nearest, 0] - sites[next_one, 0], sites[nearest, 1] - sites[next_one, 1])
    return nearest, (second - first) / (2.0 * apart)


@njit(cache=True, nogil=True)
def _ground(x: float, y: float, district: np.uint64, band: int, key: int) -> float:
    """Return what a district shows: fields, a town, or heath, in parcels along its own direction."""
    angle = np.pi * part(district, 0)
    kind = part(district, 3)
    if kind < 0.10:
        return float(_HEATH[band])
    town = kind < 0.20
    width = 9.0 + 6.0 * part(district, 1) if town else 24.0 + 50.0 * part(district, 1)
    length = 12.0 + 9.0 * part(district, 2) if town else 50.0 + 90.0 * part(district, 2)
    along = (np.cos(angle) * x + np.sin(angle) * y) / length
    across = (np.cos(angle) * y - np.sin(angle) * x) / width
    row, border, beyond = _cell(across, district, key)
    border *= width
    value = _strip(row, along, length, district, town, band, key)
    seen_beyond = _coverage(-border, band)
    if seen_beyond > 0.0:  # a pixel on the border sees both sides
        other = _strip(beyond, along, length, district, town, band, key)
        value += (other - value) * seen_beyond
    if kind > 0.6:
        value += (_HEDGE[band] - value) * _coverage(HEDGE_PX - border, band)
    return value


@njit(cache=True, nogil=True)
def _strip(
    row: int, along: float, length: float, district: np.uint64, town: bool, band: int, key: int
) -> float:
    """Return what a row of parcels shows at a place along it; each row starts elsewhere."""
    own = hash_position(row, key, int(district >> np.uint64(32)))
    col, border, beyond = _cell(along + part(own, 0), own, key)
    value = _parcel(col, own, town, band)
    seen_beyond = _coverage(-border * length, band)
    if seen_beyond > 0.0:
        value += (_parcel(beyond, own, town, band) - value) * seen_beyond
    return value


@njit(cache=True, nogil=True)
def _coverage(inside_px: float, band: int) -> float:
    """Return how much of a pixel lies inside an edge this far away: exact for a box of the band's width."""
    return min(max(0.5 + 0.5 * inside_px / _DETECTOR_PX[band], 0.0), 1.0)


@njit(cache=True, nogil=True)
def _cell(t: float, group: np.uint64, key: int) -> tuple[int, float, int]:
    """Cut a line into unequal cells: the cell of t, the distance to its nearer border, the cell beyond."""
    base = int(np.floor(t))
    stream = int(group & np.uint64(0xFFFFFFFF)) + key
    low = 0.5 * part(hash_position(base, 1, stream), 0) - 0.25
    high = 1.0 + 0.5 * part(hash_position(base + 1, 1, stream), 0) - 0.25
    offset = t - base
    if offset < low:
        return base - 1, low - offset, base
    if offset >= high:
        return base + 1, offset - high, base
    if offset - low < high - offset:
        return base, offset - low, base - 1
    return base, high - offset, base + 1


@njit(cache=True, nogil=True)
def _parcel(col: int, row: np.uint64, town: bool, band: int) -> float:
    """Return what a parcel shows: a crop, or a roof, a yard, a park."""
    bits = hash_position(col, 2, int(row >> np.uint64(20)))
    spread = (1.0 - _OWN_SPREAD) * part(bits, 3) + _OWN_SPREAD * part(bits, 1 + band) - 0.5
    if not town:
        crop = _CROPS[np.searchsorted(_CROP_LIMITS, part(bits, 0))]
        return float(crop[band] + crop[2 + band] * 2.0 * spread)
    if part(bits, 0) < 0.2:
        return float(_WOOD[band] + 0.02)
    base, width = (0.17, 0.16) if band == RED else (6.0, 9.0)
    return base + width * spread
