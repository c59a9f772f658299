"""Synthetic scenes with an exactly known displacement: the ground is evaluated where it says."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_data"))
from landscape import ground

Array = NDArray[np.float64]
Texture = Callable[[Array, int, int], Array]
"""Positions (rows, cols, 2) in px, band (0, 1) and seed to values of about unit spread."""

SIDE_PX: Final = 512
SAMPLES: Final = 2
"""Ground samples a pixel and axis; a pixel is their mean."""
MEAN_XY_PX: Final = (1.35, -0.75)
AMPLITUDE_PX: Final = 0.5
WAVELENGTH_PX: Final = 750.0


def displacement_px(xy_px: Array) -> Array:
    """Return the displacement at positions (..., 2) px: what is predicted at p is seen at p + d(p)."""
    x, y = np.moveaxis(xy_px, -1, 0)
    turn = 2 * np.pi / WAVELENGTH_PX
    waves = (np.sin(turn * (0.7 * x + 0.7 * y) + 0.9), np.sin(turn * (0.9 * x - 0.45 * y) + 2.4))
    return np.asarray(np.stack(waves, axis=-1) * AMPLITUDE_PX + MEAN_XY_PX)


def image_pair(
    texture: Texture, bands: tuple[int, int], seed: int, field: Callable[[Array], Array] = displacement_px
) -> tuple[Array, Array]:
    """Return a reference and a target displaced by a field, of (SIDE_PX, SIDE_PX), unit spread."""
    centres = (np.arange(SIDE_PX * SAMPLES) + 0.5) / SAMPLES
    seen = np.stack(np.meshgrid(centres, centres), axis=-1)
    source = seen - field(seen)
    for _ in range(6):
        source = seen - field(source)
    images = [_pixels(texture(where, band, seed)) for where, band in zip((seen, source), bands, strict=True)]
    return images[0], images[1]


def countryside(xy_px: Array, band: int, seed: int) -> Array:
    """Fields, woods, roads and towns in red light (0) or the thermal infrared (1), 30 m a pixel."""
    values = ground(xy_px[..., 0] * 30.0, -xy_px[..., 1] * 30.0, seed)
    return np.asarray(values.red if band == 0 else values.thermal, dtype=np.float64)


def folds(xy_px: Array, band: int, seed: int) -> Array:
    """Soft folds and sharp ridges; the two bands share some of them, with other contrasts."""
    rng = np.random.default_rng(seed)
    weights = np.array([[1.0, 0.8, 0.6, 0.5, 0.0], [-0.9, 0.7, -0.6, 0.0, 0.5]])[band]
    total = np.zeros(xy_px.shape[:-1])
    for weight in weights:
        wavelength = np.exp(rng.uniform(np.log(8.0), np.log(90.0), 30))
        direction, phase = rng.uniform(0, 2 * np.pi, (2, 30))
        layer = np.zeros_like(total)
        if weight:
            for length, angle, start in zip(wavelength, direction, phase, strict=True):
                along = xy_px[..., 0] * np.cos(angle) + xy_px[..., 1] * np.sin(angle)
                layer += np.sqrt(length) * np.cos(2 * np.pi * along / length + start)
            layer /= np.sqrt((wavelength / 2).sum())
        total += weight * np.abs(layer)
    return total


def _pixels(samples: Array) -> Array:
    means = samples.reshape(SIDE_PX, SAMPLES, SIDE_PX, SAMPLES).mean(axis=(1, 3))
    return np.asarray((means - means.mean()) / means.std())
