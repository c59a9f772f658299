"""Distances between poses, and the choice of those that differ."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pcwlad_geo.estimation.transforms import scale_of
from pcwlad_geo.types import Float64


def mean_distance_px(first: Float64, second: Float64, shape: tuple[int, ...]) -> float:
    """Return how far apart two transformations place the pixels of an image on average.

    The affine `first` and `second`, (2, 3) or (3, 3), are of px (col, row).
    """
    return float(np.hypot(*((first - second)[:2] @ _lattice(shape))).mean())


def distinct_poses(poses: Iterable[Float64], shape: tuple[int, ...], count: int, least: float) -> list[int]:
    """Return the indices of the first `count` of (3, 3) `poses` that differ from all those selected before.

    Two do if they place an image `least`, a share of its longer side, apart on average.
    """
    lattice = _lattice(shape)
    selection: list[int] = []
    selected_xy = np.empty((0, 2, lattice.shape[1]))
    for index, pose in enumerate(poses):
        xy = (pose[:2] @ lattice)[None]
        distances = np.hypot(*np.moveaxis(selected_xy - xy, 1, 0)).mean(axis=1)
        if (distances > least * max(shape) * scale_of(pose)).all():
            selection.append(index)
            selected_xy = np.concatenate([selected_xy, xy])
        if len(selection) == count:
            break
    return selection


def _lattice(shape: tuple[int, ...]) -> Float64:
    """Return (3, 81) places (col, row, 1) that are spread evenly over an image."""
    row, col = np.mgrid[0 : shape[0] : 9j, 0 : shape[1] : 9j]
    return np.stack([col.ravel(), row.ravel(), np.ones(row.size)])
