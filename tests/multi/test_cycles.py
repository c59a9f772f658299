"""Cycles of pairs: what they leave over, and the pair to blame."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.multi.stack.closure import closure_of
from pcwlad_geo.multi.stack.pair import PairStatus, StackPair


def pair(
    one: str, other: str, offset: tuple[float, float] = (0.0, 0.0), status: PairStatus = "used"
) -> StackPair:
    return StackPair(one, other, status, None, Path("x"), 100, offset, 0.01, 0.5, 0.1)


def test_a_wrong_pair_opens_its_cycles_and_is_blamed() -> None:
    pairs = [pair(one, other) for one, other in combinations("abcd", 2)]
    pairs[0] = pair("a", "b", (3.0, -4.0), "left out")
    found = closure_of(pairs)
    assert found.cycles == 4
    assert [each.blame for each in found.open] == [("a", "b")] * 2
    np.testing.assert_allclose(found.open[0].closure_px, (3.0, -4.0))
    assert found.before_px == pytest.approx(np.sqrt(2 * 25 / 4))
    assert found.after_px == 0.0


def test_pairs_are_gone_backwards_where_the_cycle_asks() -> None:
    pairs = [pair("a", "b", (1.0, 0.0)), pair("b", "c", (1.0, 0.0)), pair("a", "c", (2.0, 0.0))]
    assert closure_of(pairs).before_px == pytest.approx(0.0)


def test_without_triangles_cycles_of_four_count() -> None:
    ring = [pair("a", "b"), pair("b", "c"), pair("c", "d"), pair("a", "d", (0.5, 0.0))]
    found = closure_of(ring)
    assert found.cycles == 1
    assert found.open[0].blame == ("a", "d")
    assert closure_of(ring[:3]).before_px is None


def test_refused_pairs_are_in_no_cycle() -> None:
    pairs = [pair("a", "b"), pair("b", "c"), StackPair("a", "c", "refused", "no better", Path("x"))]
    assert closure_of(pairs).cycles == 0
