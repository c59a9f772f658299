"""Each statistic against numpy, scipy or a calculation by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from pcwlad_geo.correction.error_statistics import ErrorStatistics, without_noise

NO_NOISE = np.zeros((4, 2))
BY_HAND = np.array([[3.0, 4.0], [-3.0, 4.0], [0.0, 0.0], [1.0, -2.0]])


def of(errors: np.ndarray, sigma: float = 0.0) -> ErrorStatistics:
    found = ErrorStatistics.of(errors, np.full(errors.shape, sigma))
    assert found is not None
    return found


def test_by_hand() -> None:
    found = of(BY_HAND)
    assert found.n == 4
    assert (found.col.mean, found.col.median, found.col.min, found.col.max) == (0.25, 0.5, -3.0, 3.0)
    assert found.col.rmse == pytest.approx((19 / 4) ** 0.5)
    assert found.col.std == pytest.approx((19 / 4 - 1 / 16) ** 0.5)
    assert found.row.mean == 1.5
    assert found.row.median == 2.0
    assert found.radial.rmse == pytest.approx(((25 + 25 + 0 + 5) / 4) ** 0.5)
    # lengths 0, √5, 5, 5: the 90th percentile lies at rank 2.7 of 0…3
    assert found.radial.ce90 == pytest.approx(5.0)
    # |col| 0, 1, 3, 3 and |row| 0, 2, 4, 4
    assert (found.col.le90, found.row.le90) == (3.0, 4.0)


def test_against_scipy() -> None:
    errors = np.random.default_rng(1).gamma(2.0, 0.3, (501, 2)) - [0.2, 0.5]
    found = of(errors)
    for axis, values in ((found.col, errors[:, 0]), (found.row, errors[:, 1])):
        described = stats.describe(values, ddof=0)
        assert (axis.min, axis.max) == described.minmax
        assert axis.mean == pytest.approx(described.mean)
        assert axis.std == pytest.approx(described.variance**0.5)
        assert axis.rmse == pytest.approx((described.variance + described.mean**2) ** 0.5)
        assert axis.median == pytest.approx(stats.scoreatpercentile(values, 50))
        assert axis.le90 == pytest.approx(stats.scoreatpercentile(np.abs(values), 90))
    length = np.linalg.norm(errors, axis=1)
    radial = found.radial
    assert radial.rmse == pytest.approx((found.col.rmse**2 + found.row.rmse**2) ** 0.5)
    for value, percent in ((radial.ce90, 90), (radial.ce95, 95), (radial.ce99_7, 99.73)):
        assert value == pytest.approx(stats.scoreatpercentile(length, percent))


def test_circular_errors_of_a_normal_distribution() -> None:
    """The factors of equal sigmas about zero: 2.1460, 2.4477 and 3.4393 sigma (Rayleigh)."""
    found = of(np.random.default_rng(2).normal(0, 0.1, (400_000, 2)))
    rayleigh = stats.rayleigh(scale=0.1)
    assert found.radial.ce90 == pytest.approx(rayleigh.ppf(0.90), rel=0.01)
    assert found.radial.ce90 == pytest.approx(1.5175 * found.radial.rmse, rel=0.01)
    assert found.radial.ce95 == pytest.approx(1.7308 * found.radial.rmse, rel=0.01)
    assert found.radial.ce99_7 == pytest.approx(rayleigh.ppf(0.9973), rel=0.02)
    assert found.col.le90 == pytest.approx(0.1 * stats.norm.ppf(0.95), rel=0.01)


def test_noise_taken_out_leaves_the_statistics_of_the_truth() -> None:
    rng = np.random.default_rng(3)
    truth = rng.normal((0.1, -0.05), (0.15, 0.1), (200_000, 2))
    sigma = rng.uniform(0.05, 0.3, truth.shape)
    found = ErrorStatistics.of(truth + rng.normal(0, sigma), sigma)
    assert found is not None
    true = of(truth)
    assert found.radial.ce90 > 1.3 * true.radial.ce90
    assert found.net.ce90 == pytest.approx(true.radial.ce90, rel=0.02)
    assert found.net.ce95 == pytest.approx(true.radial.ce95, rel=0.02)
    assert found.net.ce99_7 == pytest.approx(true.radial.ce99_7, rel=0.04)
    assert found.net.rmse == pytest.approx(true.radial.rmse, rel=0.02)
    assert found.net.std_xy == pytest.approx((0.15, 0.1), rel=0.03)
    assert found.net.le90_xy == pytest.approx((true.col.le90, true.row.le90), rel=0.02)
    assert found.net.noise_xy == pytest.approx(np.sqrt((sigma**2).mean(axis=0)))


def test_nothing_but_noise_leaves_the_mean() -> None:
    errors = np.array([[0.3, 0.0], [0.5, 0.0], [0.4, 0.0]])
    found = of(errors, sigma=0.2)
    assert found.net.std_xy == (0.0, 0.0)
    assert found.net.ce90 == pytest.approx(0.4)
    assert found.net.ce99_7 == pytest.approx(0.4)


def test_no_noise_changes_nothing() -> None:
    found = of(BY_HAND)
    assert found.net.ce90 == pytest.approx(found.radial.ce90)
    np.testing.assert_allclose(without_noise(BY_HAND, NO_NOISE), BY_HAND)


def test_rows_that_are_not_finite_do_not_count() -> None:
    errors = np.vstack([BY_HAND, [[np.nan, 1.0]], [[np.inf, 0.0]]])
    assert of(errors) == of(BY_HAND)
    assert ErrorStatistics.of(np.full((3, 2), np.nan), np.ones((3, 2))) is None
    assert ErrorStatistics.of(np.empty((0, 2)), np.empty((0, 2))) is None


@given(
    st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=40),
    st.floats(0.01, 100),
    st.floats(0, 5),
)
def test_scale_and_order(points: list[tuple[float, float]], scale: float, sigma: float) -> None:
    """In another unit all statistics are the same times the factor, and percentiles do not fall."""
    errors = np.array(points)
    one, other = of(errors, sigma), of(errors * scale, sigma * scale)
    close = {"rel": 1e-6, "abs": 1e-5 * scale}
    assert other.radial.ce90 == pytest.approx(scale * one.radial.ce90, **close)
    assert other.net.ce90 == pytest.approx(scale * one.net.ce90, **close)
    assert other.col.le90 == pytest.approx(scale * one.col.le90, **close)
    assert one.radial.ce90 <= one.radial.ce95 <= one.radial.ce99_7
    assert one.net.rmse <= one.radial.rmse + 1e-9
