"""The same points to the last bit, whatever else a process refines."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.matching.refinement import InitialEstimate, Refined, refine
from tests.matching.test_refinement import SIDE, cross_modal

LINEAR = np.array([[0.01, 0.004], [-0.006, 0.008]])


def some_corners(n: int) -> np.ndarray:
    return np.random.default_rng(3).integers(35, SIDE - 35, (n, 2))


def assert_same_bits(found: Refined, expected: Refined, rows: np.ndarray) -> None:
    for name in ("shift_xy_px", "linear", "covariance_px2", "converged"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[rows])


@pytest.mark.parametrize("how", ["follows", "fixed", "deformed"])
def test_a_point_does_not_depend_on_the_points_beside_it(how: str) -> None:
    pair, corners = cross_modal(True, True), some_corners(24)
    shift, linear = np.full((24, 2), (1.0, -1.0)), np.zeros((24, 2, 2))
    if how == "deformed":
        linear[::2] = LINEAR
    structure = shift - 0.3 if how == "fixed" else None

    def some(rows: np.ndarray) -> Refined:
        start = InitialEstimate(shift[rows], linear[rows], None if structure is None else structure[rows])
        return refine(pair.reference, pair.target, corners[rows], start, window_px=61)

    together = some(np.arange(24))
    assert 6 < together.converged.sum() < 24
    backwards = np.arange(24)[::-1]
    assert_same_bits(some(backwards), together, backwards)
    for part in np.array_split(np.arange(24), 7):
        assert_same_bits(some(part), together, part)
