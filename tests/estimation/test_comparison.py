"""The comparison of models: the simplest that no other beats, by gains that are more than chance."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.estimation.comparison import is_significant, simplest_unbeaten


@pytest.mark.parametrize(
    ("errors", "expected"), [((3.0, 2.0, 1.0), 2), ((1.0, 2.0, 3.0), 0), ((3.0, 1.0, 2.0), 1), ((1.0,), 0)]
)
def test_the_last_model_that_beats_the_one_before_is_selected(
    errors: tuple[float, ...], expected: int
) -> None:
    assert simplest_unbeaten(range(len(errors)), lambda model, simpler: errors[model] < errors[simpler]) == (
        expected
    )


def test_a_gain_must_exceed_its_standard_errors_and_a_least_gain() -> None:
    gain = np.array([0.0, 2.0, 0.0, 2.0])  # mean 1, standard error 0.58
    assert is_significant(gain, 1.0)
    assert not is_significant(gain, 2.0)
    assert not is_significant(gain, 1.0, least=1.0)
    assert not is_significant(-gain, 0.0)
