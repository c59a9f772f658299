"""The paper's figures against values by hand."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.scores import (
    distance_to_lines,
    epipolar_errors,
    read_envi_points,
    score,
    translation_errors,
)


def test_translation_errors_are_target_minus_reference_minus_truth() -> None:
    points = np.array([[10.0, 20.0, 18.5, 23.5], [0.0, 0.0, 8.3, 3.6]])
    np.testing.assert_allclose(translation_errors(points, (8.3, 3.6)), [[0.2, -0.1], [0.0, 0.0]], atol=1e-12)


def test_score_by_hand() -> None:
    # the last two are 2.0 px and 3.0 px off: not below 2, so they count in CMR alone
    errors = np.array([[0.3, 0.4], [-0.3, 0.4], [0.0, -1.0], [2.0, 0.0], [0.0, -3.0]])
    scored = score(errors)
    assert (scored.points, scored.correct) == (5, 3)
    assert scored.share_correct == pytest.approx(0.6)
    assert scored.rmse_px == pytest.approx(np.sqrt((0.25 + 0.25 + 1.0) / 3))
    assert scored.bias_px == pytest.approx((0.0, -0.2 / 3))
    # about the mean (0, -0.2/3): variance 0.06 along x, 0.44 - (0.2/3)² along y
    assert scored.scatter_px == pytest.approx(np.sqrt(0.06 + 0.44 - (0.2 / 3) ** 2))


def test_scatter_leaves_the_bias_out() -> None:
    scored = score(np.full((4, 2), 0.5))
    assert scored.rmse_px == pytest.approx(np.sqrt(0.5))
    assert scored.scatter_px == pytest.approx(0.0)


@pytest.mark.parametrize("errors", [np.full((3, 2), 5.0), np.empty((0, 2))], ids=["all wrong", "none"])
def test_no_correct_point(errors: np.ndarray) -> None:
    scored = score(errors)
    assert scored.correct == 0
    assert np.isnan(scored.rmse_px)
    assert np.isnan(scored.scatter_px)


def test_distance_to_lines_by_hand() -> None:
    # this matrix makes of a point (x, y) the line 3x' + 4y' - 5y = 0
    fundamental = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, 4.0], [0.0, -5.0, 0.0]])
    points = np.array([[7.0, 2.0, 2.0, 1.0], [7.0, 2.0, 3.0, 4.0]])
    np.testing.assert_allclose(distance_to_lines(points, fundamental), [[0.0], [3.0]], atol=1e-12)


def two_views(rng: np.random.Generator) -> np.ndarray:
    """Pixels of 60 points of a relief seen by two cameras, the second one moved along x: rows are equal."""
    ground = rng.uniform((-50, -50, 100), (50, 50, 160), (60, 3))
    first = 500 * ground[:, :2] / ground[:, 2:] + 300
    second = 500 * (ground[:, :2] - [20.0, 0.0]) / ground[:, 2:] + 300
    return np.hstack([first, second])


def test_epipolar_errors_of_a_perfect_geometry_vanish() -> None:
    assert np.abs(epipolar_errors(two_views(np.random.default_rng(3)))).max() < 1e-3


def test_epipolar_error_is_the_distance_across_the_line() -> None:
    points = two_views(np.random.default_rng(3))
    points[5, 2] += 30.0  # along its line, a row: not seen
    points[6, 3] += 5.0  # across it
    error = np.abs(epipolar_errors(points))[:, 0]
    assert error[5] == pytest.approx(0.0, abs=0.01)
    assert error[6] == pytest.approx(5.0, abs=0.01)


def test_read_envi_points(tmp_path: Path) -> None:
    path = tmp_path / "peer.pts"
    path.write_text("; ENVI Image to Image GCP File\n; base file: a b\n;\n 1.5 2 3 4.25 \n\n5\t6\t7\t8\n")
    np.testing.assert_array_equal(read_envi_points(path), [[1.5, 2, 3, 4.25], [5, 6, 7, 8]])
