"""The error to expect of a correction, against errors that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.correction.expected_error import (
    EXPECTED_ERROR,
    Residuals,
    expected_ce90,
    local_residuals,
)
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.types import Float64

SIGMA_PX = 0.1
WINDOW_PX = 40.0


def points(n: int = 400, side_px: float = 500.0, seed: int = 1) -> Float64:
    return np.random.default_rng(seed).uniform(0, side_px, (n, 2))


def noise(n: int, seed: int = 2) -> Float64:
    return np.random.default_rng(seed).normal(0, SIGMA_PX, (n, 2))


def fitted(xy: Float64, moved: Float64, model: str) -> Selection:
    covariance = np.tile(SIGMA_PX**2 * np.eye(2), (len(xy), 1, 1))
    return choose(xy, xy + moved, covariance, WINDOW_PX, (model,))


def residuals_of(selection: Selection, xy: Float64, moved: Float64, kept: Float64 | None = None) -> Residuals:
    left = xy + moved - selection.fit.correction.forward(xy)
    every = np.ones(len(xy), bool) if kept is None else kept.astype(bool)
    return Residuals(xy, left, every, np.full_like(left, SIGMA_PX))


def grid(side_px: float = 500.0) -> Float64:
    axis = np.arange(5.0, side_px, 10.0)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def test_a_shift_that_fits_is_expected_to_hold() -> None:
    xy = points()
    moved = np.array([1.5, -0.5]) + noise(len(xy))
    selection = fitted(xy, moved, "shift")
    expected = expected_ce90(selection, residuals_of(selection, xy, moved), grid(), WINDOW_PX)
    true = np.linalg.norm(selection.fit.correction.forward(grid()) - grid() - [1.5, -0.5], axis=1).max()
    assert true < expected < 0.25


def test_points_without_noise_promise_no_more_than_two_images_allow() -> None:
    xy = points()
    selection = fitted(xy, np.tile([1.5, -0.5], (len(xy), 1)), "shift")
    residuals = residuals_of(selection, xy, np.tile([1.5, -0.5], (len(xy), 1)))
    exact = Residuals(xy, residuals.residual_px, residuals.consistent, np.full_like(xy, 1e-3))
    expected = expected_ce90(selection, exact, grid(), WINDOW_PX)
    assert 2.1 * EXPECTED_ERROR.least_common_px < expected < 0.2


def test_displacements_that_the_model_does_not_follow_are_expected() -> None:
    """Waves of 2 px on which a shift is fitted: the truth is known everywhere."""

    def waves(at: Float64) -> Float64:
        return np.asarray(2 * np.sin(2 * np.pi * at[:, ::-1] / 400))

    xy = points()
    moved = waves(xy) + noise(len(xy))
    selection = fitted(xy, moved, "shift")
    error = selection.fit.correction.forward(grid()) - grid() - waves(grid())
    true = np.percentile(np.linalg.norm(error, axis=1), 90)
    expected = expected_ce90(selection, residuals_of(selection, xy, moved), grid(), WINDOW_PX)
    assert expected == pytest.approx(true, rel=0.15)


@pytest.mark.parametrize(("agree", "expected_px"), [(True, 7.0), (False, 0.2)])
def test_rejected_matches_count_where_they_agree_among_themselves(agree: bool, expected_px: float) -> None:
    """A second layer of the ground over a quarter of the scene; wrong matches in all directions there."""
    xy = points(600)
    layer = (xy < 250).all(axis=1)
    wrong = np.array([7.0, 0.0]) if agree else np.random.default_rng(3).uniform(-12, 12, (600, 2))
    moved = np.where(layer[:, None], wrong, 0.0) + noise(len(xy))
    selection = fitted(xy[~layer], moved[~layer], "shift")
    found = residuals_of(selection, xy, moved, ~layer)
    expected = expected_ce90(selection, found, grid(), WINDOW_PX)
    assert expected == pytest.approx(expected_px, abs=0.5 if agree else 0.2)


@pytest.mark.parametrize("known", [True, False])
def test_noise_that_the_sigmas_tell_is_no_error_of_the_correction(known: bool) -> None:
    """A shift of many points is right, however they scatter; what sigmas do not tell may be the ground."""
    xy = points()
    moved = 4 * noise(len(xy))
    selection = fitted(xy, moved, "shift")
    found = residuals_of(selection, xy, moved)
    found = replace(found, sigma_px=np.full_like(xy, SIGMA_PX * (4 if known else 1)))
    expected = expected_ce90(selection, found, grid(), WINDOW_PX)
    true = np.linalg.norm(selection.fit.correction.forward(np.zeros((1, 2))))
    assert true < 0.1
    assert true < expected < 0.45 if known else expected > 0.5


def test_where_the_ground_is_displaced_rejected_matches_count() -> None:
    """Patches at another depth; a spline follows some of their points, and the others are rejected."""
    xy = points(1500)
    patch = np.floor(xy / 60).sum(axis=1) % 2 == 0
    moved = np.where(patch[:, None], [2.0, 0.0], 0.0) + noise(len(xy)) / 4
    kept = ~patch | (np.random.default_rng(5).uniform(size=len(xy)) < 0.4)
    selection = fitted(xy[kept], moved[kept] * 0.5, "shift")
    found = replace(residuals_of(selection, xy, moved, kept), sigma_px=np.full((len(xy), 2), SIGMA_PX / 4))
    places = grid()
    ground = np.where((np.floor(places / 60).sum(axis=1) % 2 == 0)[:, None], [2.0, 0.0], 0.0)
    error = selection.fit.correction.forward(places) - places - ground
    true = np.percentile(np.linalg.norm(error, axis=1), 90)
    assert expected_ce90(selection, found, places, WINDOW_PX) == pytest.approx(true, rel=0.15)


def test_many_points_of_one_place_are_one_witness() -> None:
    """One wrong peak that many overlapping windows see says nothing of the ground around it."""
    xy = points(200)
    middle = 18.5 * WINDOW_PX / EXPECTED_ERROR.cells_per_window
    cluster = middle + np.random.default_rng(4).uniform(-4, 4, (100, 2))
    every = np.concatenate([xy, cluster])
    left = np.concatenate([noise(200), np.full((100, 2), 6.0)])
    found = Residuals(every, left, np.arange(300) < 200, np.full_like(left, SIGMA_PX))
    left = local_residuals(found, grid(), WINDOW_PX).median_px
    assert np.linalg.norm(left, axis=1).max() < 0.5


def test_a_bending_correction_is_expected_to_err_beyond_its_points() -> None:
    def waves(at: Float64) -> Float64:
        return np.asarray(2 * np.sin(2 * np.pi * at[:, ::-1] / 300))

    xy = points(300, 200.0)
    moved = waves(xy) + noise(len(xy))
    selection = fitted(xy, moved, "polynomial3")
    found = residuals_of(selection, xy, moved)
    inside, everywhere = (
        expected_ce90(selection, found, places, WINDOW_PX) for places in (grid(200.0), grid(500.0))
    )
    assert inside < 0.5
    assert everywhere > 2.0


def test_wrong_matches_beyond_the_points_say_nothing_of_a_curved_correction() -> None:
    """Ground without structure beside the points: windows there find something, in any direction."""
    xy = points(400, 300.0)
    moved = np.asarray(0.5 * np.sin(2 * np.pi * xy[:, ::-1] / 400)) + noise(len(xy))
    selection = fitted(xy, moved, "polynomial3")
    draw = np.random.default_rng(7)
    beyond, off = draw.uniform((320, 0), (500, 300), (15, 2)), draw.uniform(-12, 12, (15, 2))
    every, kept = np.concatenate([xy, beyond]), np.arange(415) < 400
    alone = residuals_of(selection, xy, moved)
    among_wrong = residuals_of(selection, every, np.concatenate([moved, off]), kept)
    places = np.stack(np.meshgrid(np.arange(5.0, 400, 10), np.arange(5.0, 300, 10)), axis=-1).reshape(-1, 2)
    expected = expected_ce90(selection, alone, places, WINDOW_PX)
    assert expected < 3.0
    assert expected_ce90(selection, among_wrong, places, WINDOW_PX) == pytest.approx(expected, rel=0.05)


def test_a_larger_common_error_is_expected_to_show() -> None:
    xy = points()
    moved = np.array([1.5, -0.5]) + noise(len(xy))
    selection = fitted(xy, moved, "shift")
    residuals = residuals_of(selection, xy, moved)
    larger = replace(EXPECTED_ERROR, least_common_px=0.5)
    expected = expected_ce90(selection, residuals, grid(), WINDOW_PX, parameters=larger)
    assert expected == pytest.approx(2.146 * 0.5, rel=0.1)
