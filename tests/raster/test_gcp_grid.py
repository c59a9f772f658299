from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from rasterio.control import GroundControlPoint

from pcwlad_geo.raster.georeferencing import geotransform_of
from pcwlad_geo.raster.grid import apply

TRANSFORM = Affine(8.0, 3.0, 512_345.25, 2.5, -9.0, 5_123_456.75)
RNG = np.random.default_rng(3)


def gcps(px: np.ndarray, xy: np.ndarray) -> list[GroundControlPoint]:
    return [
        GroundControlPoint(row=row, col=col, x=x, y=y)
        for (col, row), (x, y) in zip(px.tolist(), xy.tolist(), strict=True)
    ]


@pytest.mark.parametrize("n", [3, 4, 50])
def test_an_affine_is_found_exactly(n: int) -> None:
    px = RNG.uniform(0, 5000, (n, 2))
    found = geotransform_of(gcps(px, apply(TRANSFORM, px)))
    assert found is not None
    corners = np.array([[0.0, 0], [5000, 0], [5000, 5000]])
    assert apply(found[0], corners) == pytest.approx(apply(TRANSFORM, corners), abs=1e-6)
    assert found[1] < 1e-6


def test_the_misfit_is_in_pixels() -> None:
    px = np.array([[0.0, 0], [100, 0], [0, 100], [100, 100]])
    moved = px + np.array([[1.0, 0], [-1, 0], [-1, 0], [1, 0]])  # no affine has any of it
    found = geotransform_of(gcps(px, apply(TRANSFORM, moved)))
    assert found is not None
    assert found[1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    "px", [[[0, 0], [1, 1]], [[0, 0], [10, 10], [20, 20], [35, 35]], [[5, 5], [5, 5], [5, 5]]]
)
def test_too_few_or_on_a_line(px: list[list[float]]) -> None:
    at = np.array(px, float)
    assert geotransform_of(gcps(at, apply(TRANSFORM, at))) is None


def test_points_that_determine_no_direction_are_missed_without_bound() -> None:
    """Not on a line, in the image or on the map; yet the best geotransform turns rows into nothing."""
    col, row = (axis.ravel() for axis in np.meshgrid([0.0, 48.0, 96.0], [0.0, 48.0, 96.0]))
    found = geotransform_of(gcps(np.column_stack([col, row]), np.column_stack([30 * col, (col - 48.0) ** 2])))
    assert found is not None
    assert not found[1] <= 96.0
