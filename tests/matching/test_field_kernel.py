"""The compiled surfaces against their plain twin."""

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching.field import Surface, predict
from pcwlad_geo.matching.kernels.local_surfaces import fit_surfaces
from tests.oracles.local_surfaces import fit_surfaces_plain


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("count", [12, 13, 40])
def test_the_kernel_equals_its_twin(order: int, count: int) -> None:
    rng = np.random.default_rng(count)
    xy, at = rng.uniform(0, 600, (300, 2)), rng.uniform(0, 600, (25, 2))
    moved = 0.01 * xy[:, ::-1] + rng.normal(0, 0.2, xy.shape)
    moved[::7] += 5.0
    neighbours = np.argsort(((xy[None] - at[:, None]) ** 2).sum(axis=2), axis=1)[:, :count]
    usable = rng.random((25, count)) > 0.1
    usable[3, 5:] = False
    value, slope = np.full((25, 2), np.nan), np.full((25, 2, 2), np.nan)
    scale, leverage = np.full(25, np.nan), np.full(25, np.nan)
    fit_surfaces(xy, moved, at, neighbours, usable, order, value, slope, scale, leverage)
    wanted = fit_surfaces_plain(xy[neighbours] - at[:, None], moved[neighbours], usable, order)
    assert np.isnan(value[3]).all()
    found: tuple[NDArray, ...] = (value, slope, scale, leverage)
    for mine, plain in zip(found, wanted, strict=True):
        np.testing.assert_allclose(mine, plain, rtol=1e-7, atol=1e-9)


def test_neighbours_on_one_place_or_line_are_no_error() -> None:
    for xy in (np.zeros((20, 2)), np.c_[np.arange(20.0), np.zeros(20)]):
        value, slope, scale, leverage = np.empty((1, 2)), np.empty((1, 2, 2)), np.empty(1), np.empty(1)
        moved = np.tile([0.5, -0.25], (20, 1))
        everyone = np.arange(20)[None]
        fit_surfaces(xy, moved, xy[:1], everyone, np.ones((1, 20), bool), 1, value, slope, scale, leverage)
        np.testing.assert_allclose(value, [[0.5, -0.25]], atol=1e-6)


def test_the_slopes_are_those_of_the_field() -> None:
    xy = np.random.default_rng(2).uniform(0, 600, (400, 2))
    linear = np.array([[0.01, -0.004], [0.003, -0.008]])
    found = predict(xy, xy @ linear.T + (3.0, -2.0), xy[:20], Surface(48, 1))
    np.testing.assert_allclose(found.slope, np.tile(linear, (20, 1, 1)), atol=1e-6)
