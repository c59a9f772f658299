"""What people made of the land: parcels with their crops, towns, roads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from coordinate_noise import FloatArray, HashArray, Keys, fractal, hash_positions, noise, uniform

RED_SUBPARCELS = 0.13  # relative steps between parts of a parcel (tillage, soil colour), seen in red only
THERMAL_SUBPARCELS_K = 1.6  # steps between irrigated parts of a parcel, seen in thermal only

# Crops: mean and spread of red reflectance, mean and spread of (surface - air) temperature in K. Ripe and
# irrigated crops have the same contrast in both bands; dark dry soil, flowering rape and plastic invert it.
_CROPS = np.array(
    [
        [0.190, 0.030, 7.0, 2.0],  # ripe cereal
        [0.200, 0.030, 8.0, 2.0],  # stubble
        [0.055, 0.012, -2.5, 1.5],  # irrigated maize
        [0.050, 0.012, -1.5, 1.5],  # alfalfa
        [0.085, 0.018, 2.5, 2.0],  # moist soil
        [0.095, 0.020, 10.0, 2.0],  # dark dry soil
        [0.150, 0.020, -1.0, 1.5],  # flowering rape
        [0.085, 0.020, 3.0, 2.0],  # pasture
        [0.230, 0.030, 2.0, 2.0],  # plastic tunnels
    ],
    dtype=np.float32,
)
_CROP_LIMITS = np.cumsum(np.array([0.18, 0.14, 0.18, 0.10, 0.14, 0.08, 0.08, 0.08, 0.02]))[:-1]

# --- fields ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """What the parcels look like at each point."""

    red: FloatArray
    warmth: FloatArray  # surface - air, K
    border_m: FloatArray  # distance to the parcel's border


def lay_out_fields(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> Fields:
    """Divide the plane into districts of one direction and parcel size, and give each parcel a crop."""
    district = _district(x_m, y_m, keys)
    angle = np.pi * uniform(district, 0)
    cos, sin = np.cos(angle), np.sin(angle)
    along_m, across_m = cos * x_m + sin * y_m, cos * y_m - sin * x_m
    # The edges of a parcel bend a little, as real ones do.
    across_m = across_m + 22 * noise(x_m, y_m, 1500.0, keys[20])
    length_m, width_m = 470 + 800 * uniform(district, 1), 220 + 430 * uniform(district, 2)
    row, row_border = _jittered_cells(across_m / width_m, district, keys[21])
    # Each row of parcels starts elsewhere, so that the borders across the rows do not line up.
    start = uniform(hash_positions(row, district, keys[22]), 0)
    col, col_border = _jittered_cells(along_m / length_m + start, district + row.astype(np.uint64), keys[23])
    parcel = hash_positions(hash_positions(row, col, keys[24]), district, keys[25])

    crop = np.searchsorted(_CROP_LIMITS, uniform(parcel, 0))
    red = _CROPS[crop, 0] + _CROPS[crop, 1] * (uniform(parcel, 1) - 0.5) * 3.4
    warmth = _CROPS[crop, 2] + _CROPS[crop, 3] * (uniform(parcel, 2) - 0.5) * 3.4
    # Parts of the parcel are worked or watered differently; the parts of the two bands have other borders.
    tillage = uniform(hash_positions(parcel, np.floor(across_m / width_m * 3.1 + 7 * start), keys[26]), 0)
    irrigation = uniform(hash_positions(parcel, np.floor(along_m / length_m * 2.3 + 5 * start), keys[27]), 0)
    red = red * (1 + RED_SUBPARCELS * 2 * (tillage - 0.5))
    warmth = warmth + THERMAL_SUBPARCELS_K * 2 * (irrigation - 0.5)
    return Fields(red, warmth, np.minimum(row_border * width_m, col_border * length_m))


def _district(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> HashArray:
    """Return a hash per point that is constant in each cell of a warped Voronoi diagram."""
    size_m = 3300.0
    u = (x_m + 420 * noise(x_m, y_m, 2600.0, keys[28])) / size_m
    v = (y_m + 420 * noise(x_m, y_m, 2600.0, keys[29])) / size_m
    near_u, near_v = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    best = np.full(u.shape, np.inf)
    district = np.zeros(u.shape, np.uint64)
    for du in (-1, 0, 1):
        for dv in (-1, 0, 1):
            site = hash_positions(near_u + du, near_v + dv, keys[30])
            distance = (near_u + du + uniform(site, 0) - u) ** 2 + (near_v + dv + uniform(site, 1) - v) ** 2
            closer = distance < best
            best[closer] = distance[closer]
            district[closer] = site[closer]
    # Hash again: the bits that placed the district must not also shape its parcels.
    return hash_positions(district, 0, keys[31])


def _jittered_cells(t: FloatArray, group: HashArray, key: int) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Cut a line into unequal cells; return the index of the cell and the distance to its border."""
    base = np.floor(t).astype(np.int64)
    low = 0.5 * uniform(hash_positions(base, group, key), 0) - 0.25
    high = 1 + 0.5 * uniform(hash_positions(base + 1, group, key), 0) - 0.25
    offset = t - base
    index = np.where(offset < low, base - 1, np.where(offset >= high, base + 1, base))
    return index, np.minimum(np.abs(offset - low), np.abs(high - offset))


# --- towns and roads -------------------------------------------------------------------------------------

_TOWN_CELL_M = 11000.0


@dataclass(frozen=True, slots=True, eq=False)
class Town:
    """Towns and roads at each point."""

    depth: FloatArray  # positive inside a town
    street: npt.NDArray[np.bool_]
    block: HashArray
    road_m: FloatArray  # distance to the nearest road


def lay_out_towns(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> Town:
    """Place one town with a grid of streets in each cell of a coarse lattice, and join them by roads."""
    cell_u = np.floor(x_m / _TOWN_CELL_M).astype(np.int64)
    cell_v = np.floor(y_m / _TOWN_CELL_M).astype(np.int64)
    town_x, town_y, own = _town_centre(cell_u, cell_v, keys)
    radius = 700 + 1100 * uniform(own, 2)
    outline = 0.34 * fractal(x_m, y_m, 1900.0, 3, keys[41])
    depth = 1 - np.hypot(x_m - town_x, y_m - town_y) / radius + outline

    angle = np.pi * uniform(own, 3)
    cos, sin = np.cos(angle), np.sin(angle)
    along, across = (cos * x_m + sin * y_m) / 115, (cos * y_m - sin * x_m) / 80
    row, row_border = _jittered_cells(across, own, keys[42])
    col, col_border = _jittered_cells(along, own + row.astype(np.uint64), keys[43])
    street = np.minimum(row_border * 80, col_border * 115) < 9
    block = hash_positions(hash_positions(row, col, keys[44]), own, keys[45])
    return Town(depth, street, block, _road_distance(x_m, y_m, keys))


def _town_centre(
    cell_u: npt.NDArray[np.int64], cell_v: npt.NDArray[np.int64], keys: Keys
) -> tuple[FloatArray, FloatArray, HashArray]:
    """Return the centre of a cell's town, never near the cell's edge, and the hash it came from."""
    bits = hash_positions(cell_u, cell_v, keys[40])
    x_m = (cell_u + 0.28 + 0.44 * uniform(bits, 0).astype(np.float64)) * _TOWN_CELL_M
    y_m = (cell_v + 0.28 + 0.44 * uniform(bits, 1).astype(np.float64)) * _TOWN_CELL_M
    return x_m, y_m, bits


def _road_distance(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> FloatArray:
    """Return the distance to the road net, which joins each town to the towns of the four cells around."""
    x_m, y_m = np.broadcast_arrays(
        x_m + 160 * fractal(x_m, y_m, 3400.0, 3, keys[46], gain=0.4),
        y_m + 160 * fractal(x_m, y_m, 3400.0, 3, keys[47], gain=0.4),
    )
    cell_u = np.floor(x_m / _TOWN_CELL_M).astype(np.int64)
    cell_v = np.floor(y_m / _TOWN_CELL_M).astype(np.int64)
    from_x, from_y, _ = _town_centre(cell_u, cell_v, keys)
    nearest = np.full(x_m.shape, np.inf)
    for du, dv in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        to_x, to_y, _ = _town_centre(cell_u + du, cell_v + dv, keys)
        dx, dy = to_x - from_x, to_y - from_y
        t = np.clip(((x_m - from_x) * dx + (y_m - from_y) * dy) / (dx * dx + dy * dy), 0, 1)
        nearest = np.minimum(nearest, np.hypot(x_m - from_x - t * dx, y_m - from_y - t * dy))
    return nearest
