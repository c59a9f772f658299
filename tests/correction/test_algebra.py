"""The algebra of corrections: inverses, compositions, and what they are elsewhere."""

from __future__ import annotations

import json

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st

from pcwlad_geo.correction.models import AffineCorrection, Composition, Correction
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.errors import InputError

from .points import affine, polynomial, projective, scattered, spline

PLACES = scattered(1, 60, 512)
MADE = {
    "shift": AffineCorrection("shift", np.array([[1.0, 0.0, 1.25], [0.0, 1.0, -2.5]])),
    "affine": affine(2.0),
    "projective": projective(),
    "polynomial3": polynomial(3),
    "tps": spline(),
}
name = st.sampled_from(sorted(MADE))


@given(first=name, later=name)
@settings(max_examples=40)
def test_a_composition_applies_one_after_the_other(first: str, later: str) -> None:
    one, other = MADE[first], MADE[later]
    expected = other.forward(one.forward(PLACES))
    np.testing.assert_allclose((other @ one).forward(PLACES), expected, atol=1e-9)
    assert np.abs(expected - PLACES).max() > 0.1


@given(first=name, later=name)
@settings(max_examples=40)
def test_the_inverse_of_a_composition_is_that_of_its_steps_the_other_way(first: str, later: str) -> None:
    both = MADE[later] @ MADE[first]
    moved = both.forward(PLACES)
    np.testing.assert_allclose(both.invert().forward(moved), PLACES, atol=1e-6)
    steps = MADE[first].invert() @ MADE[later].invert()
    np.testing.assert_allclose(steps.forward(moved), PLACES, atol=1e-6)
    np.testing.assert_allclose(both.inverse(moved), PLACES, atol=1e-6)
    np.testing.assert_allclose(both.invert().inverse(PLACES), moved, atol=1e-6)


@given(first=name, middle=name, last=name)
@settings(max_examples=20)
def test_brackets_do_not_matter(first: str, middle: str, last: str) -> None:
    a, b, c = MADE[last], MADE[middle], MADE[first]
    np.testing.assert_allclose(((a @ b) @ c).forward(PLACES), (a @ (b @ c)).forward(PLACES), atol=1e-9)


@pytest.mark.parametrize("kind", MADE)
def test_the_inverse_of_the_inverse_is_the_correction(kind: str) -> None:
    again = MADE[kind].invert().invert()
    np.testing.assert_allclose(again.forward(PLACES), MADE[kind].forward(PLACES), atol=1e-9)
    assert type(again) is type(MADE[kind])


def test_affines_stay_affines() -> None:
    assert (MADE["shift"] @ MADE["shift"]).name == "shift"
    assert isinstance(MADE["shift"] @ MADE["affine"], AffineCorrection)
    assert (MADE["shift"] @ MADE["affine"]).name == "affine"
    assert (MADE["affine"] @ MADE["projective"]).name == "projective"


@pytest.mark.parametrize("correction", [MADE["tps"].invert(), MADE["tps"] @ MADE["polynomial3"].invert()])
def test_a_composition_is_read_back(correction: Correction) -> None:
    again = from_dict(json.loads(json.dumps(correction.to_dict(), allow_nan=False)))
    np.testing.assert_array_equal(again.forward(PLACES), correction.forward(PLACES))


@pytest.mark.parametrize("count", [0, 21])
def test_a_composition_of_no_or_many_steps_is_refused(count: int) -> None:
    with pytest.raises(InputError, match="steps"):
        from_dict(Composition("tps", ((MADE["shift"], False),) * count).to_dict())


def test_a_composition_of_compositions_is_refused() -> None:
    with pytest.raises(InputError, match="none of them a composition"):
        from_dict(Composition("tps", ((MADE["tps"].invert(), False),)).to_dict())


@pytest.mark.parametrize("kind", ["shift", "affine"])
def test_a_geotransform_places_observed_at_predicted_pixels(kind: str) -> None:
    transform = Affine.from_gdal(*MADE[kind].to_gdal())
    cols, rows = MADE[kind].forward(PLACES).T
    found = [transform @ (col, row) for col, row in zip(cols, rows, strict=True)]
    np.testing.assert_allclose(found, PLACES, atol=1e-9)


@pytest.mark.parametrize("kind", ["projective", "polynomial3", "tps"])
def test_a_geotransform_holds_no_other_model(kind: str) -> None:
    with pytest.raises(InputError, match=f"a geotransform holds no {kind} model"):
        MADE[kind].to_gdal()


@pytest.mark.parametrize("kind", MADE)
def test_scikit_image_counts_from_the_centre_of_a_pixel(kind: str) -> None:
    transform = MADE[kind].to_skimage()
    np.testing.assert_allclose(transform(PLACES), MADE[kind].forward(PLACES + 0.5) - 0.5, atol=1e-9)
    np.testing.assert_allclose(transform.inverse(transform(PLACES)), PLACES, atol=1e-6)
