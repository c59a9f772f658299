from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.errors import InputError

from .points import affine, inside, polynomial, projective, scattered, spline

small = st.floats(-0.3, 0.3, allow_nan=False)
offset = st.floats(-1e4, 1e4, allow_nan=False)
seed = st.integers(0, 1000)
ALL = {
    "affine": affine(2.0),
    "projective": projective(),
    "polynomial2": polynomial(2),
    "polynomial3": polynomial(3),
    "tps": spline(),
}


@given(small, small, small, small, offset, offset)
def test_inverse_of_an_affine_undoes_forward(
    a: float, b: float, c: float, d: float, col: float, row: float
) -> None:
    correction = AffineCorrection("affine", np.array([[1 + a, b, col], [c, 1 + d, row]]))
    points = scattered(0, 20, 10000)
    np.testing.assert_allclose(correction.inverse(correction.forward(points)), points, atol=1e-7)
    np.testing.assert_allclose(correction.forward(correction.inverse(points)), points, atol=1e-7)


@pytest.mark.parametrize("kind", ["projective", "polynomial2", "polynomial3", "tps"])
@given(seed=seed, side=st.floats(200, 40000))
@settings(max_examples=20)
def test_forward_and_inverse_undo_each_other(kind: str, seed: int, side: float) -> None:
    made = {
        "projective": lambda: projective(side),
        "polynomial2": lambda: polynomial(2, seed, side),
        "polynomial3": lambda: polynomial(3, seed, side),
        "tps": lambda: spline(seed, side),
    }
    correction: Correction = made[kind]()
    # A quarter of the image beyond its sides too, where polynomial and spline are continued.
    points = scattered(seed, 200, 1.5 * side) - side / 4
    np.testing.assert_allclose(correction.inverse(correction.forward(points)), points, atol=1e-6, rtol=0)
    np.testing.assert_allclose(correction.forward(correction.inverse(points)), points, atol=1e-6, rtol=0)


def test_forward_maps_predicted_to_observed() -> None:
    correction = AffineCorrection("shift", np.array([[1, 0, 0.5], [0, 1, -2.0]]))
    np.testing.assert_array_equal(correction.forward(np.array([[10.0, 20.0]])), [[10.5, 18.0]])


def test_a_projective_divides_by_the_third_row() -> None:
    correction = projective()
    column, row, w = correction.matrix @ [100.0, 50.0, 1.0]
    np.testing.assert_allclose(correction.forward(np.array([[100.0, 50.0]])), [[column / w, row / w]])


def test_there_is_nothing_beyond_the_horizon() -> None:
    correction = projective(side_px=1)  # w = 0 along a line through the image
    points = scattered(0, 500) - 256
    w = points @ correction.matrix[2, :2] + 1
    moved = correction.forward(points)
    np.testing.assert_array_equal(np.isfinite(moved).all(axis=1), w > 0)
    np.testing.assert_allclose(correction.inverse(moved[w > 0]), points[w > 0], atol=1e-6)


@pytest.mark.parametrize("name", ALL)
def test_the_dictionary_alone_is_enough_to_warp(name: str) -> None:
    correction, points = ALL[name], scattered(1, 100, 1000) - 200
    document = json.loads(json.dumps(correction.to_dict() | {"candidates": []}, allow_nan=False))
    again = from_dict(document)
    assert again.name == correction.name == name
    np.testing.assert_array_equal(again.forward(points), correction.forward(points))
    np.testing.assert_array_equal(again.inverse(points), correction.inverse(points))


def test_the_numbers_of_an_affine_can_be_read_by_hand() -> None:
    correction, points = affine(2.0), scattered(1, 10)
    matrix = np.array(correction.to_dict()["forward"]["matrix"])  # type: ignore[index]
    homogeneous = np.column_stack([points, np.ones(10)])
    np.testing.assert_allclose(homogeneous @ matrix.T, correction.forward(points), atol=1e-12)


def test_the_numbers_of_a_polynomial_can_be_read_by_hand() -> None:
    correction, points = polynomial(3), inside()
    stored: Any = correction.to_dict()["forward"]
    u = (points - stored["centre"]) / stored["radius"]
    terms = np.stack([u[:, 0] ** i * u[:, 1] ** j for i, j in stored["exponents"]], axis=1)
    moved = points + terms @ np.array(stored["coefficients"])
    np.testing.assert_allclose(moved, correction.forward(points), atol=1e-10)


def stored(correction: Correction, **changes: object) -> dict[str, Any]:
    """Return a correction as report.json holds it, with other numbers."""
    document: dict[str, Any] = correction.to_dict()
    return document | {"forward": document["forward"] | changes}


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"name": "shift"},
        {"name": "shift", "forward": None},
        {"name": "rpc", "forward": {"type": "rpc"}},
        {"name": "affine", "forward": {"type": "affine", "matrix": [[1, 0], [0, 1]]}},
        {"name": "affine", "forward": {"type": "affine", "matrix": [[1, 0, None], [0, 1, 0]]}},
        {"name": "affine", "forward": {"type": "affine", "matrix": [[1, 0, float("nan")], [0, 1, 0]]}},
        {"name": "tps", "forward": {"type": "bicubic_spline", "origin": [0, 0], "spacing": 1, "cells": [4]}},
        {"name": "affine", "forward": {"type": "affine", "matrix": [[1, 1, 0], [1, 1, 0]]}},
        {"name": "affine", "forward": {"type": "affine", "matrix": [[1e200, 0, 0], [0, 1e200, 0]]}},
        {"name": "affine", "forward": {"type": "affine", "matrix": [[1, 0, 0], [0, 1e-9, 0]]}},
        {"name": "projective", "forward": {"type": "projective", "matrix": [[1, 1, 1]] * 3}},
        {"name": "projective", "forward": {"type": "projective", "matrix": [[0, 0, 0]] * 3}},
        stored(polynomial(2), order=10**9),
        stored(polynomial(2), order=0),
        stored(polynomial(2), radius=0.0),
        stored(polynomial(2), radius=float("nan")),
        stored(spline(), spacing=0.0),
        stored(spline(), spacing=float("inf")),
        stored(spline(), cells=[10**400, 1]),
        stored(spline(), cells=[-3, -3], coefficients=np.zeros((0, 0, 2)).tolist()),
    ],
)
def test_what_is_no_model_is_refused(document: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"no correction model .*report\.json"):
        from_dict(document)
