"""Control points of any kind are used or refused with a sentence, within little memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.stack.adjustment import adjust
from pcwlad_geo.multi.stack.control_points import ControlPoint, check_control
from pcwlad_geo.multi.stack.edges import Edge, _near_pairs
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT
from pcwlad_geo.types import Float64, Index


def groups(pairs: Index, count: int) -> Index:
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def equal_groups(one: Index, other: Index) -> bool:
    return len({*zip(one.tolist(), other.tolist(), strict=True)}) == one.max() + 1 == other.max() + 1


@given(st.integers(1, 80), st.floats(0.3, 30), st.integers(0, 10_000))
def test_points_are_connected_as_by_all_their_pairs(count: int, spread: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    at = random.uniform(0, spread, (count, 2))
    at = at[random.integers(0, count, count)]  # some several times
    every = cKDTree(at).query_pairs(ADJUSTMENT.feature_px, output_type="ndarray")
    assert equal_groups(groups(_near_pairs(at, ADJUSTMENT.feature_px), count), groups(every, count))


def test_many_points_in_one_place_take_little_memory() -> None:
    at = np.full((20_000, 2), 12.5)
    tracemalloc.start()
    pairs = _near_pairs(at, ADJUSTMENT.feature_px)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    assert len(set(groups(pairs, len(at)).tolist())) == 1


def edge(first_xy: Float64) -> Edge:
    covariance = np.broadcast_to(0.01 * np.eye(2), (len(first_xy), 2, 2))
    return Edge(0, 1, first_xy, first_xy + 0.3, covariance)


def test_points_on_a_line_are_refused_with_a_sentence() -> None:
    along = np.linspace(10, 60, 30)
    with pytest.raises(InputError, match="do not determine"):
        adjust([edge(np.column_stack([along, along]))], 2, model="affine").covariance(
            1, np.array([[90.0, 5.0]])
        )


def test_points_on_a_line_determine_a_shift() -> None:
    along = np.linspace(10, 60, 30)
    found = adjust([edge(np.column_stack([along, along]))], 2, model="shift")
    assert np.abs(found.displacement(1, np.array([[30.0, 30.0]])) - 0.3).max() < 1e-9


@pytest.mark.parametrize(
    "point",
    [
        ControlPoint("a", 1, 1, 1e308, 1),
        ControlPoint("a", float("nan"), 1, 1, 1),
        ControlPoint("a", 1, 1, 1, 1, 0.0),
        ControlPoint("a", 1, 1, 1, 1, -1.0),
        ControlPoint("a", 1, 1, 1, 1, float("inf")),
    ],
)
def test_numbers_of_control_points(point: ControlPoint) -> None:
    with pytest.raises(InputError, match=r"control\.csv"):
        check_control(point, "control.csv")
