from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pcwlad_geo.correction.models import AffineCorrection

from .points import affine, scattered

small = st.floats(-0.3, 0.3, allow_nan=False)
offset = st.floats(-1e4, 1e4, allow_nan=False)


@given(small, small, small, small, offset, offset)
@settings(deadline=None)
def test_inverse_undoes_forward(a: float, b: float, c: float, d: float, col: float, row: float) -> None:
    correction = AffineCorrection("affine", np.array([[1 + a, b, col], [c, 1 + d, row]]))
    points = scattered(0, 20, 10000)
    np.testing.assert_allclose(correction.inverse(correction.forward(points)), points, atol=1e-7)
    np.testing.assert_allclose(correction.forward(correction.inverse(points)), points, atol=1e-7)


def test_forward_maps_predicted_to_observed() -> None:
    correction = AffineCorrection("shift", np.array([[1, 0, 0.5], [0, 1, -2.0]]))
    np.testing.assert_array_equal(correction.forward(np.array([[10.0, 20.0]])), [[10.5, 18.0]])


def test_the_dictionary_alone_is_enough_to_warp() -> None:
    correction, points = affine(2.0), scattered(1, 10)
    matrix = np.array(correction.to_dict()["forward"]["matrix"])  # type: ignore[index]
    homogeneous = np.column_stack([points, np.ones(10)])
    np.testing.assert_allclose(homogeneous @ matrix.T, correction.forward(points), atol=1e-12)
