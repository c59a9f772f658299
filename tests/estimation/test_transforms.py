"""The algebra of transforms: composition, inverse, fit, and what is written and read back."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import (
    AffineTransform,
    ProjectiveTransform,
    ShiftTransform,
    SimilarityTransform,
)
from pcwlad_geo.types import Float64

NEAR = np.random.default_rng(1).uniform(-300, 300, (40, 2))
FAR = NEAR + np.array([4e5, 5e6])
number = st.floats(-0.4, 0.4)


def shift(values: list[float]) -> ShiftTransform:
    return ShiftTransform.by(100 * np.array(values[:2]))


def similarity(values: list[float]) -> SimilarityTransform:
    turned = SimilarityTransform.from_angle(4 * values[2], 1 + values[3])
    result = shift(values) @ turned
    assert isinstance(result, SimilarityTransform)
    return result


def affine(values: list[float]) -> AffineTransform:
    linear = np.eye(2) + np.array(values[2:6]).reshape(2, 2)
    return AffineTransform.from_parts(linear, 100 * np.array(values[:2]))


def projective(values: list[float]) -> ProjectiveTransform:
    tilt = np.eye(3)
    tilt[2, :2] = 1e-3 * np.array(values[6:8])
    return affine(values) @ ProjectiveTransform(tilt)


MAKERS = (shift, similarity, affine, projective)
transforms = st.builds(
    lambda make, values: make(values), st.sampled_from(MAKERS), st.lists(number, min_size=8, max_size=8)
)


@given(first=transforms, middle=transforms, last=transforms)
@settings(max_examples=60)
def test_composition_is_associative(
    first: ProjectiveTransform, middle: ProjectiveTransform, last: ProjectiveTransform
) -> None:
    one, other = (last @ middle) @ first, last @ (middle @ first)
    np.testing.assert_allclose(one.matrix, other.matrix, rtol=1e-9, atol=1e-9)
    assert type(one) is type(other)


@given(first=transforms, later=transforms)
@settings(max_examples=60)
def test_a_composition_applies_one_after_the_other(
    first: ProjectiveTransform, later: ProjectiveTransform
) -> None:
    small = NEAR / 100
    np.testing.assert_allclose((later @ first)(small), later(first(small)), atol=1e-6)


@given(transform=transforms)
@settings(max_examples=60)
def test_the_inverse_round_trips(transform: ProjectiveTransform) -> None:
    np.testing.assert_allclose(transform.inverse()(transform(NEAR)), NEAR, atol=1e-6)
    np.testing.assert_allclose(transform.apply_inverse(transform(NEAR)), NEAR, atol=1e-6)
    assert type(transform.inverse()) is type(transform)
    identity = (transform.inverse() @ transform).matrix
    np.testing.assert_allclose(identity / identity[2, 2], np.eye(3), atol=1e-9)


@given(transform=transforms)
@settings(max_examples=60)
def test_a_fit_recovers_the_transform(transform: ProjectiveTransform) -> None:
    fitted = type(transform).fit(NEAR, transform(NEAR))
    np.testing.assert_allclose(fitted(NEAR), transform(NEAR), atol=1e-6)
    assert fitted.KIND == transform.KIND


@pytest.mark.parametrize("kind", [ShiftTransform, SimilarityTransform, AffineTransform])
def test_a_fit_at_map_coordinates_keeps_their_digits(
    kind: type[ShiftTransform] | type[SimilarityTransform] | type[AffineTransform],
) -> None:
    to_xy = FAR + np.array([0.25, -4.5])
    np.testing.assert_allclose(kind.fit(FAR, to_xy)(FAR), to_xy, atol=1e-6)


@given(transform=transforms)
@settings(max_examples=40)
def test_it_is_written_and_read_back(transform: ProjectiveTransform) -> None:
    values = json.loads(json.dumps(transform.to_dict()))
    assert values["type"] == transform.KIND
    result = type(transform).from_numbers(values["matrix"])
    np.testing.assert_array_equal(result.matrix, transform.matrix)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (AffineTransform, None),
        (AffineTransform, np.eye(3).tolist()),
        (AffineTransform, [[1, 2, 0], [2, 4, 0]]),
        (AffineTransform, [[1e9, 0, 0], [0, 1, 0]]),
        (ProjectiveTransform, [[1, 0, 0], [0, 1, 0], [0, 0, float("nan")]]),
        (ProjectiveTransform, np.zeros((3, 3)).tolist()),
    ],
)
def test_what_is_no_transform_is_refused(kind: type[ProjectiveTransform], values: object) -> None:
    with pytest.raises((TypeError, ValueError)):
        kind.from_numbers(values)


def test_the_kind_of_a_composition_is_the_more_general_one() -> None:
    values = [0.1] * 8
    made = [make(values) for make in MAKERS]
    for number_of_first, first in enumerate(made):
        for number_of_later, later in enumerate(made):
            assert type(later @ first) is type(made[max(number_of_first, number_of_later)])


def test_nothing_lies_beyond_the_horizon() -> None:
    transform = ProjectiveTransform(np.array([[1.0, 0, 0], [0, 1.0, 0], [-1 / 200, 0, 1.0]]))
    assert np.isfinite(transform(np.array([[100.0, 0.0]]))).all()
    assert np.isnan(transform(np.array([[200.0, 0.0], [300.0, 0.0]]))).all()


def test_points_that_determine_no_projective_are_refused() -> None:
    with pytest.raises(InputError, match="at least 4"):
        ProjectiveTransform.fit(NEAR[:3], NEAR[:3])


def test_points_in_one_place_are_shifted() -> None:
    place: Float64 = np.full((5, 2), 3.0)
    np.testing.assert_allclose(SimilarityTransform.fit(place, place + 1.5).matrix[:2, 2], [1.5, 1.5])
