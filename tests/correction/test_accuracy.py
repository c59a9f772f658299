from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.error_statistics import Accuracy


def test_figures_of_four_residuals() -> None:
    accuracy = Accuracy.of(np.array([[3.0, 4.0], [-3.0, 4.0], [3.0, -4.0], [3.0, 0.0]]))
    assert accuracy.n == 4
    assert accuracy.mean_xy == (1.5, 1.0)
    assert accuracy.rmse_xy == pytest.approx((3.0, np.sqrt(12.0)))
    assert accuracy.rmse == pytest.approx(np.sqrt(21.0))


def test_percentiles_of_normal_errors() -> None:
    residuals = np.random.default_rng(0).normal(0, 0.2, (20000, 2))
    accuracy = Accuracy.of(residuals)
    assert accuracy.le90_xy == pytest.approx((0.329, 0.329), abs=0.01)
    # ASPRS: 1.5175 and 1.7308 of the RMSE of both axes together, for equal sigma and no bias.
    assert accuracy.ce90 == pytest.approx(1.5175 * accuracy.rmse, rel=0.02)
    assert accuracy.ce95 == pytest.approx(1.7308 * accuracy.rmse, rel=0.02)


def test_nan_rows_are_left_out() -> None:
    accuracy = Accuracy.of(np.array([[np.nan, 1.0], [1.0, 1.0]]))
    assert accuracy.n == 1
    assert accuracy.rmse == pytest.approx(np.sqrt(2))


def test_no_residuals() -> None:
    accuracy = Accuracy.of(np.empty((0, 2)))
    assert accuracy.n == 0
    assert np.isnan(accuracy.rmse)
