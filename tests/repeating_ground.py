"""Ten kinds of ground that repeats, and pairs of it whose displacement is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Image = NDArray[np.float64]
MARGIN_PX: Final = 160
"""Around what a pair shows, so that nothing has to be invented at its border."""


def _smooth(side: int, sigma_px: float, seed: int) -> Image:
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(side, side)), sigma_px)
    return np.asarray(noise / noise.std())


def _boxes(row: Image, col: Image, period: tuple[float, float], filled: tuple[float, float]) -> Image:
    """Return rectangles at two periods (rows, cols), which fill a share of these."""
    inside = [
        np.clip(share / 2 * step - np.abs(at % step - step / 2), 0, 1)
        for at, step, share in zip((row, col), period, filled, strict=True)
    ]
    return np.asarray(inside[0] * inside[1])


def _saw(along: Image, period_px: float) -> Image:
    return np.asarray((along / period_px) % 1)


PATTERNS: Final[dict[str, tuple[Callable[[Image, Image], Image], tuple[float, float]]]] = {
    "field trial": (lambda row, col: _boxes(row + 0.03 * col, col, (30, 90), (0.75, 0.85)), (0, 30)),
    "orchard": (lambda row, col: _boxes(row, col, (22, 22), (0.5, 0.5)), (22, 0)),
    "solar park": (lambda row, col: _boxes(row, col, (16, 96), (0.55, 0.95)), (0, 16)),
    "roofs": (
        lambda row, col: (
            _boxes(row, col, (57, 26), (0.45, 0.8)) + _boxes(row, col + 6, (57, 26), (0.45, 0.4))
        ),
        (26, 0),
    ),
    "dunes": (lambda row, col: _saw(0.9 * col + 0.3 * row + 6 * np.sin(row / 47), 28), (28 / 0.9, 0)),
    "ploughing": (lambda row, col: (_saw(0.8 * col + 0.6 * row, 10) > 0.5) * 1.0, (12.5, 0)),
    "vineyard": (lambda row, col: np.clip(np.cos(2 * np.pi * (col + 0.1 * row) / 14), 0, 1), (14, 0)),
    "greenhouses": (lambda row, col: _boxes(row, col, (180, 36), (0.95, 1.0)) * _saw(col, 36), (36, 0)),
    "car park": (lambda row, col: _boxes(row, col, (48, 12), (0.7, 0.7)), (12, 0)),
    "graves": (
        lambda row, col: (
            _boxes(row, col, (24, 18), (0.6, 0.4)) + _boxes(row + 12, col + 9, (24, 18), (0.6, 0.4))
        ),
        (18, 0),
    ),
}
"""What each kind looks like at (rows, cols), and a period (col, row), px."""


def repeating_pair(
    kind: str,
    displacement_px: tuple[float, float],
    *,
    side_px: int = 320,
    has_edges: bool = True,
    detail: float = 0.05,
    change: float = 0.03,
    seed: int = 3,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a reference and a target of one ground, displaced by (col, row).

    Parameters
    ----------
    kind : str
        One of the `PATTERNS`.
    has_edges : bool
        Whether the pattern ends somewhere, at ground of another kind, and misses some of its units.
    detail : float
        Deviation of what both images show beside the pattern, whose contrast is 1.
    change : float
        Deviation of what each shows alone: another date.
    """
    side = side_px + 2 * MARGIN_PX
    row, col = np.mgrid[:side, :side].astype(float)
    ground = PATTERNS[kind][0](row, col)
    if has_edges:
        ground = ground * (_smooth(side, 9, seed + 1) < 1.7)
        inside = ndimage.gaussian_filter((_smooth(side, 60, seed + 2) > -0.4).astype(float), 1)
        ground = inside * ground + (1 - inside) * (0.4 + 0.25 * _smooth(side, 3, seed + 3))
    ground = ground + detail * _smooth(side, 1.5, seed + 4)
    images = [ground + change * _smooth(side, 1.5, seed + date) for date in (5, 6)]
    images[1] = ndimage.shift(images[1], displacement_px[::-1], order=3)
    shown = np.s_[MARGIN_PX : MARGIN_PX + side_px, MARGIN_PX : MARGIN_PX + side_px]
    noise = np.random.default_rng(seed).normal(0, 1.5, (2, side_px, side_px))
    first, second = (
        np.clip(90 + 90 * image[shown] + grain, 1, 255).astype(np.uint8)
        for image, grain in zip(images, noise, strict=True)
    )
    return first, second
