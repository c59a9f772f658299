"""The compiled loops of the search for a pose against plain twins."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from pcwlad_geo.matching.kernels.pose_search import cross_spectra, place_layer, weigh_by_overlap

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("opposite", [False, True])
@pytest.mark.parametrize("cols", [7, 600])
def test_cross_spectra_are_summed_over_harmonics(opposite: bool, cols: int) -> None:
    moving = RNG.normal(size=(3, 2, 4, cols)).astype(np.float32)
    fixed = RNG.normal(size=(5, 3, 2, 4, cols)).astype(np.float32)
    one, others = moving[:, 0] + 1j * moving[:, 1], fixed[:, :, 0] + 1j * fixed[:, :, 1]
    wanted = (one.conj() * (others.conj() if opposite else others)).sum(axis=1)
    found = cross_spectra(moving, fixed, opposite=opposite)
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)


def test_scores_are_weighed_and_the_highest_is_told() -> None:
    scores = RNG.normal(size=(3, 20, 20)).astype(np.float32)
    scores[2] -= 10  # all below 0: the highest is where too little overlaps
    overlaps = RNG.uniform(0, 40, (3, 5, 5)).astype(np.float32)
    overlaps[:2, 0, 0], overlaps[2, 4, 4] = 0.5, 0.0
    cells = np.repeat(np.repeat(overlaps, 4, axis=1), 4, axis=2)
    for least in (10.0, 0.25):
        wanted = np.where(cells >= least, scores / np.sqrt(np.maximum(cells, 1)), 0)
        found = scores.copy()
        highest = weigh_by_overlap(found, overlaps, least)
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
        flat = wanted.reshape(3, -1)
        np.testing.assert_allclose(
            np.take_along_axis(flat, highest[:, None], 1)[:, 0], flat.max(axis=1), rtol=1e-6
        )


@pytest.mark.parametrize("turn_rad", [0.0, 0.7])
def test_a_layer_is_placed_turned_and_masked(turn_rad: float) -> None:
    layer = RNG.normal(size=(13, 17, 4)).astype(np.float32)
    layer[..., 3] = RNG.random((13, 17)) > 0.2
    usable = (RNG.random((11, 9)) > 0.1).astype(np.float32)
    # beyond the layer on three sides
    matrix = np.array([[1.713, 0.619, -3.217], [-0.527, 1.431, 2.909]])
    known, planes = np.full((11, 9), np.nan, np.float32), np.full((3, 11, 9), np.nan, np.float32)
    place_layer(layer, matrix, turn_rad, usable, known, planes)
    rows, cols = np.mgrid[:11, :9]
    x, y = matrix @ np.stack([cols.ravel(), rows.ravel(), np.ones(99)])
    mean, cosine, sine, weight = (
        map_coordinates(plane, [y, x], order=1, mode="grid-constant").reshape(11, 9)
        for plane in np.moveaxis(layer.astype(np.float64), -1, 0)
    )
    there = usable * (weight > 0.5)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    assert 20 < there.sum() < 80
    np.testing.assert_array_equal(known, there)
    wanted = np.stack([mean, c * cosine - s * sine, s * cosine + c * sine]) * there
    np.testing.assert_allclose(planes, wanted, atol=1e-5)
