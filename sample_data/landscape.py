"""A synthetic landscape, defined at every point of the plane, seen in red light and in the thermal infrared.

`ground` evaluates the landscape at any world coordinates, so a displaced image is made by sampling the
ground where the displacement says, without resampling an image; and a block of a large scene equals the
same part of the whole. Every random number is a hash of the seed and of a position.

Red reflectance and surface temperature are two consequences of land cover, texture, height and sun; neither
is computed from the other, and each has structures of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt
from coordinate_noise import FloatArray, Keys, fractal, noise, smoothstep, uniform
from land_use import Fields, Town, lay_out_fields, lay_out_towns

# What the two bands share and where they differ: these constants, and those of land_use.py,
# set how hard they are to match.
VIGOUR_RED = 0.11  # lush vegetation and moist soil are darker (relative) ...
VIGOUR_K = 1.2  # ... and cooler
RED_TEXTURE = 0.08  # relative variation of reflectance inside a cover class, red only
THERMAL_TEXTURE_K = 0.6  # variation of temperature inside a cover class, thermal only
THERMAL_PATCHES_K = 2.0  # passed cloud shadows and advected warm air: soft, thermal only

SUN_ELEVATION_DEG = 46.0
SUN_AZIMUTH_DEG = 142.0
HEATING_AZIMUTH_DEG = 118.0  # the ground's temperature remembers the morning sun
LAPSE_K_PER_M = -0.0065
AIR_K = 298.0  # at height 0

_BLOCK = 384  # samples a side of one evaluation: the temporaries stay in the processor's cache


class Cover(IntEnum):
    """Land cover classes."""

    CROP = 0
    MEADOW = 1
    FOREST = 2
    ROCK = 3
    TOWN = 4
    ROAD = 5
    WATER = 6


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The landscape at a set of points.

    Attributes
    ----------
    red : ndarray of float32
        Red reflectance, about 0.02 to 0.4.
    thermal : ndarray of float32
        Surface temperature, K.
    height : ndarray of float32
        Height, m.
    cover : ndarray of uint8
        Land cover, values of `Cover`.
    """

    red: npt.NDArray[np.float32]
    thermal: npt.NDArray[np.float32]
    height: npt.NDArray[np.float32]
    cover: npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Landscape(Ground):
    """The landscape on a grid of square pixels, row 0 in the north; the arrays are (rows, cols)."""

    pixel_m: float
    origin_xy_m: tuple[float, float]


def landscape(
    shape: tuple[int, int],
    seed: int,
    *,
    pixel_m: float = 30.0,
    oversample: int = 1,
    origin_xy_m: tuple[float, float] = (0.0, 0.0),
) -> Landscape:
    """Average the ground over the pixels of a grid.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    seed : int
        Selects the landscape.
    pixel_m : float
        Pixel size, m.
    oversample : int
        Ground samples per pixel and axis; above 1 each pixel is the mean of its samples (its cover and height
        those of one sample near its centre).
    origin_xy_m : (float, float)
        World coordinates of the top-left corner, x east and y north. A grid whose origin lies a whole number
        of pixels away gives the same pixels where the two overlap.

    Returns
    -------
    Landscape
        Arrays of `shape`.

    Raises
    ------
    ValueError
        If the shape, the pixel size or the oversampling is not positive.
    """
    if min(shape) < 1 or pixel_m <= 0 or oversample < 1:
        raise ValueError(f"shape {shape}, pixel_m {pixel_m} and oversample {oversample} must be positive")
    out = Landscape(
        red=np.empty(shape, np.float32),
        thermal=np.empty(shape, np.float32),
        height=np.empty(shape, np.float32),
        cover=np.empty(shape, np.uint8),
        pixel_m=pixel_m,
        origin_xy_m=origin_xy_m,
    )
    step = max(1, _BLOCK // oversample)
    for row in range(0, shape[0], step):
        for col in range(0, shape[1], step):
            part = np.s_[row : min(row + step, shape[0]), col : min(col + step, shape[1])]
            x_m = origin_xy_m[0] + pixel_m * _sample_positions(part[1], oversample)
            y_m = origin_xy_m[1] - pixel_m * _sample_positions(part[0], oversample)
            block = ground(x_m[None, :], y_m[:, None], seed)
            centre = np.s_[oversample // 2 :: oversample, oversample // 2 :: oversample]
            out.red[part] = _block_mean(block.red, oversample)
            out.thermal[part] = _block_mean(block.thermal, oversample)
            out.height[part] = block.height[centre]
            out.cover[part] = block.cover[centre]
    return out


def _sample_positions(pixels: slice, oversample: int) -> npt.NDArray[np.float64]:
    """Return the sample positions of a run of pixels in pixels, corner-based."""
    return (np.arange(pixels.start * oversample, pixels.stop * oversample) + 0.5) / oversample


def _block_mean(values: FloatArray, factor: int) -> FloatArray:
    rows, cols = values.shape
    return np.asarray(values.reshape(rows // factor, factor, cols // factor, factor).mean(axis=(1, 3)))


def ground(x_m: FloatArray, y_m: FloatArray, seed: int) -> Ground:
    """Evaluate the landscape at world coordinates.

    Parameters
    ----------
    x_m, y_m : ndarray of float64
        World coordinates, m, x east and y north, of shapes that broadcast to (rows, cols). Shapes (1, cols)
        and (rows, 1), a regular grid, are several times faster than two full arrays.
    seed : int
        Selects the landscape.

    Returns
    -------
    Ground
        Arrays of shape (rows, cols).
    """
    keys = Keys(seed)
    terrain = _terrain(x_m, y_m, keys)
    soil = _soil(x_m, y_m, keys)
    stands = _stands(x_m, y_m, keys)
    fields = lay_out_fields(x_m, y_m, keys)
    town = lay_out_towns(x_m, y_m, keys)
    cover = _cover(x_m, y_m, terrain, town, keys)

    red = _red_of_cover(cover, fields, town, stands) * np.maximum(soil.red, 0.3)
    shade = np.maximum(terrain.sun + 0.12, 0.05) / (np.sin(np.radians(SUN_ELEVATION_DEG)) + 0.12)
    red = np.where(cover == Cover.WATER, red, red * shade)

    warming = 11.0 * (terrain.heating - np.sin(np.radians(SUN_ELEVATION_DEG)))
    thermal = _warmth_of_cover(cover, fields, town, stands) + soil.thermal + warming
    # Water keeps its own temperature: no sun, no soil, little texture.
    thermal = np.where(cover == Cover.WATER, -7.0 + 0.15 * soil.thermal, thermal)
    thermal += AIR_K + LAPSE_K_PER_M * terrain.height
    return Ground(
        red=red.astype(np.float32),
        thermal=thermal.astype(np.float32),
        height=terrain.height.astype(np.float32),
        cover=cover,
    )


# --- relief and rivers -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Terrain:
    height: FloatArray
    upland: FloatArray  # 0 in the plain, 1 in the mountains
    river_m: FloatArray  # distance to the middle of the river
    sun: FloatArray  # cosine of the sun's incidence
    heating: FloatArray  # the same for the sun that warmed the ground


def _terrain(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> _Terrain:
    step_m = 20.0
    height, valley = _height(x_m, y_m, keys)
    height_east, valley_east = _height(x_m + step_m, y_m, keys)
    height_north, valley_north = _height(x_m, y_m + step_m, keys)
    slope = (height_east - height) / step_m, (height_north - height) / step_m
    # The river runs where `valley` is zero; value over gradient is the distance to it, to first order.
    gradient = np.hypot(valley_east - valley, valley_north - valley) / step_m
    return _Terrain(
        height=height,
        upland=_upland(valley),
        river_m=np.abs(valley) / np.maximum(gradient, 1e-6),
        sun=_incidence(slope, SUN_AZIMUTH_DEG),
        heating=_incidence(slope, HEATING_AZIMUTH_DEG),
    )


def _upland(valley: FloatArray) -> FloatArray:
    return smoothstep(np.abs(valley), 0.55, 1.8)


def _height(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> tuple[FloatArray, FloatArray]:
    """Return the height and the valley function: zero along the river, larger towards the mountains."""
    valley = fractal(x_m, y_m, 22000.0, 5, keys[1], gain=0.38)
    ridges = np.zeros_like(valley)
    amplitude = 1.0
    for octave in range(6):
        crest = 1 - np.minimum(np.abs(noise(x_m, y_m, 7500.0 / 2**octave, keys[2] + octave)), 1.6) / 1.6
        # Finer ridges only where the coarser ones are high: valleys stay smooth.
        ridges += np.float32(amplitude) * crest**2 * (1 if octave == 0 else np.clip(0.35 + ridges, 0, 1))
        amplitude *= 0.46
    rolling = fractal(x_m, y_m, 3600.0, 4, keys[3])
    upland = _upland(valley)
    return 210 + 26 * rolling * (0.3 + upland) + upland * (120 + 620 * ridges), valley


def _incidence(slope: tuple[FloatArray, FloatArray], azimuth_deg: float) -> FloatArray:
    elevation, azimuth = np.radians(SUN_ELEVATION_DEG), np.radians(azimuth_deg)
    east, north = np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth)
    facing = np.sin(elevation) - east * slope[0] - north * slope[1]
    return np.asarray(facing / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class _Texture:
    red: FloatArray  # factor
    thermal: FloatArray  # K


def _soil(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> _Texture:
    """Texture inside the classes: a common part, and parts of each band alone."""
    texture = fractal(x_m, y_m, 900.0, 4, keys[10], gain=0.75)
    moisture = fractal(x_m, y_m, 1200.0, 3, keys[11], gain=0.75)
    patches = fractal(x_m, y_m, 3800.0, 3, keys[12], gain=0.45)
    vigour = fractal(x_m, y_m, 1000.0, 4, keys[15], gain=0.7)
    # Only the tops of the noise: separate patches with soft borders, some warm, some cool.
    patches = np.sign(patches) * smoothstep(np.abs(patches), 0.7, 1.7)
    return _Texture(
        red=1 + RED_TEXTURE * texture - VIGOUR_RED * vigour,
        thermal=THERMAL_TEXTURE_K * moisture - VIGOUR_K * vigour + THERMAL_PATCHES_K * patches,
    )


def _stands(x_m: FloatArray, y_m: FloatArray, keys: Keys) -> _Texture:
    """Stands of broad-leaved trees, of conifers and young ones: patches with fairly sharp borders."""
    species = fractal(x_m, y_m, 1700.0, 4, keys[13], gain=0.6)
    age = fractal(x_m, y_m, 1300.0, 4, keys[14], gain=0.6)
    return _Texture(
        red=1 + 0.55 * smoothstep(species, 0.1, 0.35) + 0.5 * smoothstep(age, 0.9, 1.15),
        thermal=0.9 * smoothstep(species, 0.1, 0.35) + 2.5 * smoothstep(age, 0.9, 1.15),
    )


# --- cover and what it looks like ------------------------------------------------------------------------


def _cover(
    x_m: FloatArray, y_m: FloatArray, terrain: _Terrain, town: Town, keys: Keys
) -> npt.NDArray[np.uint8]:
    wood = fractal(x_m, y_m, 3000.0, 5, keys[50], gain=0.55)
    lake = fractal(x_m, y_m, 6500.0, 4, keys[51], gain=0.35)
    width_m = 62 + 16 * noise(x_m, y_m, 2400.0, keys[52])
    wild = np.clip(terrain.upland * 4, 0, 1)  # where the slopes begin, no fields

    cover = np.where(wild > 0.55 + 0.25 * wood, Cover.MEADOW, Cover.CROP).astype(np.uint8)
    # Woods are patches in the plain, most of the slopes, a strip on some banks; they end at the tree line.
    banks = (terrain.river_m < 190) & (wood > 0.35)
    glades = fractal(x_m, y_m, 1100.0, 4, keys[53], gain=0.6)
    cover[((wood > 1.3 - 1.45 * wild) & (glades < 1.15)) | banks] = Cover.FOREST
    cover[(terrain.height > 700 + 90 * wood) & (cover != Cover.CROP)] = Cover.MEADOW
    cover[terrain.height > 860 + 110 * wood] = Cover.ROCK
    low = terrain.upland < 0.3
    cover[(town.depth > 0) & low] = Cover.TOWN
    cover[(town.road_m < 19) & (cover != Cover.ROCK)] = Cover.ROAD
    cover[(terrain.river_m < width_m) | (lake > 1.75 + 12 * terrain.upland)] = Cover.WATER
    return cover


def _red_of_cover(
    cover: npt.NDArray[np.uint8], fields: Fields, town: Town, stands: _Texture
) -> npt.NDArray[np.float32]:
    red = np.array([0.0, 0.085, 0.032, 0.17, 0.0, 0.165, 0.028], np.float32)[cover]
    red *= np.where(cover == Cover.FOREST, stands.red, 1)
    crop = cover == Cover.CROP
    red[crop] = np.where(fields.border_m < 5, 0.12, fields.red)[crop]
    built = uniform(town.block, 0)
    blocks = np.where(built < 0.14, 0.07, 0.11 + 0.13 * uniform(town.block, 1) ** 2)  # parks among the roofs
    in_town = cover == Cover.TOWN
    red[in_town] = np.where(town.street, 0.105, blocks)[in_town]
    return red


def _warmth_of_cover(
    cover: npt.NDArray[np.uint8], fields: Fields, town: Town, stands: _Texture
) -> npt.NDArray[np.float32]:
    """Return surface minus air temperature, K."""
    warmth = np.array([0.0, 3.0, -2.5, 7.5, 0.0, 7.0, -7.0], np.float32)[cover]
    warmth += np.where(cover == Cover.FOREST, stands.thermal, 0)
    crop = cover == Cover.CROP
    warmth[crop] = fields.warmth[crop]
    built = uniform(town.block, 0)
    blocks = np.where(built < 0.14, -0.5, 3.5 + 7 * uniform(town.block, 2))
    blocks = np.where(built > 0.93, -2.0, blocks)  # bare metal roofs emit little and look cold
    in_town = cover == Cover.TOWN
    warmth[in_town] = np.where(town.street, 8.0, blocks)[in_town]
    return warmth
