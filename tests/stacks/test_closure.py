"""Closure of triangles with known displacements."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pcwlad_geo.stacks.closure import Leg, close, close_triangles
from tests.stacks.stack import make_band, make_pair, refused

NAMES = ("a", "b", "c")


def leg(*rows: tuple[float, float, float, float]) -> Leg:
    table = np.array(rows)
    return Leg(table[:, :2], table[:, 2:])


def test_by_hand() -> None:
    """Two cells of 10 px with three points each, which close to (0.1, 0) and (0.3, 0)."""
    places = [(1.0, 1.0), (2.0, 2.0), (3.0, 3.0), (11.0, 1.0), (12.0, 2.0), (13.0, 3.0)]

    def of(first: float, second: float) -> Leg:
        return leg(*((col, row, first if col < 10 else second, 0.0) for col, row in places))

    found = close(NAMES, [of(1.0, 2.0), of(0.5, 0.5), of(1.4, 2.2)], 10.0, (30.0, 20.0))
    assert found.cells == 2
    assert found.mean_px == pytest.approx((0.2, 0.0))
    assert found.error_px == pytest.approx((0.1, 0.0))  # standard deviation 0.1·√2 over √2
    assert found.rms_px == pytest.approx((np.sqrt((0.01 + 0.09) / 2), 0.0))
    assert found.mean_m == pytest.approx((6.0, 0.0))


def test_only_common_ground_counts() -> None:
    """A leg with points elsewhere, displaced otherwise, does not spoil the closure."""
    here = [(1.0, 1.0, 0.2, 0.0), (2.0, 1.0, 0.2, 0.0), (1.0, 2.0, 0.2, 0.0)]
    there = [(91.0, 1.0, 9.0, 0.0), (92.0, 1.0, 9.0, 0.0), (91.0, 2.0, 9.0, 0.0)]
    still = [(1.0, 1.0, 0.0, 0.0), (2.0, 1.0, 0.0, 0.0), (1.0, 2.0, 0.0, 0.0)]
    found = close(NAMES, [leg(*here, *there), leg(*still), leg(*here)], 10.0)
    assert (found.cells, found.mean_px) == (1, (0.0, 0.0))
    assert found.error_px is None
    assert found.mean_m is None


@pytest.mark.parametrize("points", [0, 2])
def test_too_few_points_in_common_are_no_closure(points: int) -> None:
    full = leg(*((float(n), 0.0, 0.0, 0.0) for n in range(5)))
    part = Leg(full.at_px[:points], full.moved_px[:points])
    found = close(NAMES, [full, part, full], 10.0)
    assert (found.cells, found.mean_px, found.rms_px) == (0, None, None)


def test_triangles_of_bands_with_other_pixels_close_in_the_coarsest() -> None:
    """Ground offsets (m): a 0, b (3, 6), c (12, -9). 10, 10 and 30 m pixels; the last leg lies 1.5 m off."""
    a, b = make_band("a", pixel_m=10, shape=(1200, 1200)), make_band("b", pixel_m=10, shape=(1200, 1200))
    c = make_band("c", pixel_m=30)
    pairs = [
        make_pair(a, b, (0.3, 0.6), n=2000, seed=1),
        make_pair(b, c, (0.3, -0.5), seed=2),
        make_pair(a, c, (0.4 - 0.05, -0.3), seed=3),
    ]
    (found,) = close_triangles([a, b, c], pairs, 81)
    assert found.bands == ("a", "b", "c")
    assert found.px_m == pytest.approx((30.0, 30.0), rel=1e-3)
    assert found.cells == 25
    assert found.mean_px == pytest.approx((0.05, 0.0), abs=0.015)
    assert found.mean_m == pytest.approx((1.5, 0.0), abs=0.5)
    assert found.error_px is not None
    assert max(found.error_px) < 0.006


def test_every_triangle_that_was_measured() -> None:
    bands = [make_band(name) for name in "abcd"]
    pairs = [make_pair(*two) for two in combinations(bands, 2)]
    assert len(close_triangles(bands, pairs, 81)) == 4
    lost = [refused(pair.reference, pair.target) if pair.name == "a – b" else pair for pair in pairs]
    assert [found.name for found in close_triangles(bands, lost, 81)] == ["a – c – d", "b – c – d"]


def test_without_georeferencing() -> None:
    bands = [make_band(name, georeferenced=False) for name in "abc"]
    pairs = [make_pair(*two, (0.1, 0.0)) for two in combinations(bands, 2)]
    (found,) = close_triangles(bands, pairs, 81)
    assert found.mean_px == pytest.approx((0.1, 0.0), abs=0.02)
    assert found.px_m is None
