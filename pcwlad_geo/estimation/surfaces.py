"""The terms of planes and of surfaces of second order."""

from __future__ import annotations

import numpy as np

from pcwlad_geo.types import Float64


def surface_terms(at: Float64, order: int = 2) -> Float64:
    """Return the (..., terms) 1, x, y, and of `order` 2 also x², x y and y², at the (..., 2) places (x, y)."""
    x, y = np.moveaxis(at, -1, 0)
    second = [x * x, x * y, y * y] if order == 2 else []
    return np.stack([np.ones_like(x), x, y, *second], axis=-1)
