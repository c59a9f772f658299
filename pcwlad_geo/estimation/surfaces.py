"""The terms of planes and of surfaces of second order."""

from __future__ import annotations

import numpy as np

from pcwlad_geo.types import Float64


def surface_terms(xy: Float64, order: int = 2) -> Float64:
    """Return the (..., terms) 1, x, y, and of `order` 2 x², x y, y² too, at the (..., 2) `xy`."""
    x, y = np.moveaxis(xy, -1, 0)
    second = [x * x, x * y, y * y] if order == 2 else []
    return np.stack([np.ones_like(x), x, y, *second], axis=-1)
