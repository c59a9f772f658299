"""A synthetic scene that is defined at every point of the plane, seen in bands of different radiometry.

Bands are smooth functions of the same few random fields, each a sum of plane waves: evaluated where a
displacement says, they give displaced images without any resampling. A saturating function makes edges.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Field = Callable[[Array, Array], tuple[Array, Array]]

FIELDS = 5
WAVES = 40
EDGE_STEEPNESS = 4.0


class Landscape:
    """A scene; `band` 0 and 1 share the edges, not the contrast, and each has a texture of its own."""

    def __init__(self, seed: int = 0, wavelengths_px: tuple[float, float] = (9.0, 60.0)) -> None:
        rng = np.random.default_rng(seed)
        count = (FIELDS, WAVES)
        wavelength = np.exp(rng.uniform(*np.log(wavelengths_px), count))
        direction = rng.uniform(0, np.pi, count)
        self.frequency = 2 * np.pi / wavelength * np.stack([np.cos(direction), np.sin(direction)])
        self.phase = rng.uniform(0, 2 * np.pi, count)
        self.amplitude = np.sqrt(wavelength) / np.sqrt((wavelength / 2).sum(axis=1, keepdims=True))
        # the last two fields are seen by one band each
        self.contrasts = np.array([[50.0, 40.0, 30.0, 12.0, 0.0], [-40.0, 45.0, -30.0, 0.0, 12.0]])

    def sample(self, x: Array, y: Array, band: int) -> Array:
        """Return the band's values at (x, y), about 0 to 255."""
        value = np.full(x.shape, 127.0)
        for field, contrast in enumerate(self.contrasts[band]):
            if contrast:
                total = np.zeros(x.shape)
                for wave in range(WAVES):
                    fx, fy = self.frequency[:, field, wave]
                    total += self.amplitude[field, wave] * np.cos(fx * x + fy * y + self.phase[field, wave])
                value += contrast * np.tanh(EDGE_STEEPNESS * total) / 2
        return value

    def image(self, side: int, band: int = 0, displacement: Field | None = None) -> Array:
        """Return a (side, side) image: what the plain image has at (x, y) is at (x, y) + displacement(x, y).

        Coordinates are array indices, x along columns.
        """
        y, x = np.meshgrid(np.arange(side, dtype=float), np.arange(side, dtype=float), indexing="ij")
        if displacement is None:
            return self.sample(x, y, band)
        source_x, source_y = x.copy(), y.copy()
        for _ in range(12):
            dx, dy = displacement(source_x, source_y)
            source_x, source_y = x - dx, y - dy
        return self.sample(source_x, source_y, band)


def constant(dx: float, dy: float) -> Field:
    """Displace everything by (dx, dy) px."""
    return lambda x, y: (np.full(x.shape, dx), np.full(x.shape, dy))
