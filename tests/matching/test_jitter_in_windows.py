"""Rows that move within a matching window: what tie points average out is told, and nothing else is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.expected_error import EXPECTED_ERROR
from pcwlad_geo.matching.jitter import jitter_px
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import register_pair
from tests.scenes import make_grid, render, write

Array = NDArray[np.float64]

SIDE = 400
PERIOD_PX = 40.0


def shaken(at_px: Array, size_px: float, axis: int = 1) -> Array:
    """Return a wave along the rows (1) or the columns (0), in both components."""
    phase = 2 * np.pi * at_px[..., axis] / PERIOD_PX
    return size_px * np.stack([np.sin(phase), 0.5 * np.cos(phase)], axis=-1)


def scattered(n: int = 300) -> tuple[Array, Array]:
    """Return places, and noise of what windows of rows and of columns see there."""
    rng = np.random.default_rng(3)
    return rng.uniform(0, 500, (n, 2)), rng.normal(0, 0.2, (2, n, 2))


@pytest.mark.parametrize("axis", [0, 1])
def test_what_rows_or_columns_share_is_told_beside_noise_of_its_size(axis: int) -> None:
    at_px, beside = scattered()
    beside[1 - axis] += shaken(at_px, 0.3, axis)
    assert jitter_px(at_px, beside) == pytest.approx(0.3 * np.sqrt((1 + 0.25) / 2), rel=0.15)


def test_windows_beside_the_points_show_jitter_weaker_than_their_noise() -> None:
    rng, beside_px = np.random.default_rng(3), (-40, 0, 40)
    at_px = rng.uniform(50, 450, (240, 2))
    beside = rng.normal(0, 0.38, (6, 240, 2))
    assert jitter_px(at_px, beside, beside_px) == 0
    beside[:3] += [shaken(at_px + np.array([0, offset_px]), 0.25) for offset_px in beside_px]
    assert jitter_px(at_px, beside, beside_px) == pytest.approx(0.25 * np.sqrt((1 + 0.25) / 2), rel=0.2)
    assert jitter_px(at_px, beside[[1, 4]]) == 0


def test_noise_a_tilt_and_a_few_wrong_windows_are_no_jitter() -> None:
    at_px, beside = scattered()
    assert jitter_px(at_px, beside) == 0
    beside[:, ::20] += 3.0
    assert jitter_px(at_px, beside) == 0
    beside[:, ::3] = np.nan
    assert jitter_px(at_px, beside) == 0
    assert jitter_px(at_px, np.full_like(beside, np.nan)) == 0
    assert jitter_px(at_px[:5], beside[:, :5]) == 0


@pytest.mark.parametrize(
    ("size_px", "grade"),
    [
        pytest.param(0.0, "good", marks=pytest.mark.slow),
        pytest.param(0.3, "good", marks=pytest.mark.slow),
        (0.9, "fair"),
    ],
)
def test_a_pair_expects_the_error_of_jitter_that_its_windows_average_out(
    tmp_path: Path, size_px: float, grade: str
) -> None:
    grid = make_grid((SIDE, SIDE))
    still = render(grid, "red", seed=4, noise=3.0)
    moved = render(grid, "red", seed=4, displacement_px=(0.7, -0.4), local=lambda at: shaken(at, size_px))
    found = register_pair(
        write(tmp_path / "still.tif", still, grid), write(tmp_path / "moved.tif", moved, grid), Settings()
    )
    assert found.model is not None
    assert found.quality is not None
    axis = np.arange(20.0, SIDE - 20, 7)
    at_px = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    off = found.model.forward(at_px) - at_px - (0.7, -0.4) - shaken(at_px, size_px)
    true_px = float(np.percentile(np.linalg.norm(off, axis=1), 90))
    assert found.quality.grade == grade
    assert true_px < max(1.5 * found.quality.expected_ce90_px, 0.05)
    assert found.quality.expected_ce90_px < max(1.5 * true_px, 2.3 * EXPECTED_ERROR.least_common_px)
    assert any("jitter" in warning for warning in found.warnings) == (size_px > 0)
