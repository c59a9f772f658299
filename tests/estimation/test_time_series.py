"""Steps, drifts and seasons of series, and velocities of the ground, put in and found again."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.estimation.time_series import SERIES, analyse
from pcwlad_geo.estimation.velocities import Motions, displacements, velocities
from pcwlad_geo.types import Float64

SIGMA_PX = 0.03


def make_series(count: int, seed: int, span_years: float = 4.0) -> tuple[Float64, Float64, Float64]:
    """Times, displacements of nothing but noise, and their sigmas."""
    random = np.random.default_rng(seed)
    years = 50 + np.sort(random.uniform(0, span_years, count))
    return years, random.normal(size=(count, 2)) * SIGMA_PX, np.full(count, SIGMA_PX)


@pytest.mark.parametrize("seed", range(12))
def test_of_noise_nothing_is_made(seed: int) -> None:
    model = analyse(*make_series(40, seed))
    assert model.terms == ()
    assert not model.outliers.any()
    assert np.hypot(*model.level_px) < 5 * SIGMA_PX / 40**0.5
    assert 0.7 * SIGMA_PX < model.noise_px < 1.4 * SIGMA_PX


@pytest.mark.parametrize(("at", "size"), [(6, (0.2, -0.1)), (20, (0.1, 0.1)), (34, (-0.25, 0.0))])
def test_a_step_is_found_with_its_date_and_size(at: int, size: tuple[float, float]) -> None:
    years, moved_px, sigma_px = make_series(40, 3)
    moved_px[at:] += size
    (found,) = analyse(years, moved_px, sigma_px).terms
    assert (found.term.kind, found.term.at) == ("step", at)
    assert np.abs(found.size_px[0] - size).max() < 3.5 * found.sigma_px < 0.06


def test_two_steps_in_a_season_are_found() -> None:
    years, moved_px, sigma_px = make_series(60, 4)
    moved_px += 0.08 * np.column_stack([np.cos(2 * np.pi * years), np.sin(2 * np.pi * years)])
    moved_px[18:] += (0.15, 0.1)
    moved_px[42:] -= (0.3, 0.0)
    found = analyse(years, moved_px, sigma_px).terms
    assert [(each.term.kind, each.term.at) for each in found] == [("step", 18), ("step", 42), ("season", 0)]
    waves = found[2].size_px
    assert np.abs(waves - [[0.08, 0.0], [0.0, 0.08]]).max() < 4 * found[2].sigma_px < 0.04


def test_a_drift_is_no_row_of_steps() -> None:
    years, moved_px, sigma_px = make_series(40, 5)
    moved_px += (years - years[0])[:, None] * (0.05, -0.02)
    model = analyse(years, moved_px, sigma_px)
    (found,) = model.terms
    assert found.term.kind == "drift"
    assert np.abs(found.size_px[0] - (0.05, -0.02)).max() < 4 * found.sigma_px < 0.02
    last = (years[-1] - years[0]) * np.array([0.05, -0.02])
    assert np.abs(model.level_px - last).max() < 4 * model.level_sigma_px


def test_clouds_are_outliers_and_no_steps() -> None:
    years, moved_px, sigma_px = make_series(40, 6)
    moved_px[[7, 21, 39]] += (0.6, -0.4)
    model = analyse(years, moved_px, sigma_px)
    assert model.terms == ()
    assert np.flatnonzero(model.outliers).tolist() == [7, 21, 39]


def test_sigmas_that_are_too_small_make_no_steps() -> None:
    """What neighbours differ by beyond their sigmas is noise, too."""
    years, moved_px, sigma_px = make_series(40, 7)
    assert analyse(years, moved_px, sigma_px / 100).terms == ()


def test_a_step_of_fewer_images_than_tell_is_none() -> None:
    years, moved_px, sigma_px = make_series(40, 8)
    moved_px[40 - SERIES.min_side + 1 :] += (0.5, 0.5)
    model = analyse(years, moved_px, sigma_px)
    assert model.terms == ()
    assert model.outliers[40 - SERIES.min_side + 1 :].all()


@pytest.mark.parametrize("count", [8, 10, 12])
def test_a_clear_step_in_a_short_series_is_found(count: int) -> None:
    years, moved_px, sigma_px = make_series(count, 13)
    moved_px[4:] += (1.0, -0.8)
    (found,) = analyse(years, moved_px, sigma_px).terms
    assert (found.term.kind, found.term.at) == ("step", 4)


def test_of_short_noise_nothing_is_made() -> None:
    alarms = sum(bool(analyse(*make_series(8 + seed % 5, seed)).terms) for seed in range(200))
    assert alarms <= 3  # 1.2 expected at most


@pytest.mark.parametrize("count", [1, 2, SERIES.min_images - 1])
def test_short_series_have_a_level_only(count: int) -> None:
    years, moved_px, sigma_px = make_series(count, 9)
    model = analyse(years, moved_px + np.array([5.0, 0.0]), sigma_px)
    assert model.terms == ()
    assert np.abs(model.level_px - (5.0, 0.0)).max() < 5 * SIGMA_PX


def network(count: int, seed: int) -> tuple[Float64, Float64, Float64]:
    """Times, displacements whose errors come from a chain of pairs alone, and their covariance."""
    random = np.random.default_rng(seed)
    pairs = np.array([(i, j) for i in range(count) for j in (i + 1, i + 2) if j < count])
    design = np.zeros((len(pairs), count))
    design[np.arange(len(pairs)), pairs[:, 0]], design[np.arange(len(pairs)), pairs[:, 1]] = -1.0, 1.0
    places = np.linalg.pinv(design) * 0.03
    return (
        np.sort(random.uniform(0, 4, count)),
        places @ random.normal(size=(len(pairs), 2)),
        places @ places.T,
    )


@pytest.mark.slow
def test_errors_that_hang_together_make_no_steps() -> None:
    """A chain of pairs lets errors grow along it; where that is known, it is no step."""
    alarms, blind, found = 0, 0, 0
    for seed in range(20):
        years, moved_px, covariance = network(40, seed)
        sigma_px = np.sqrt(np.diag(covariance))
        alarms += bool(analyse(years, moved_px, sigma_px, covariance).terms)
        blind += bool(analyse(years, moved_px, sigma_px).terms)
        moved_px[20:] += (0.2, -0.2)
        terms = [each.term for each in analyse(years, moved_px, sigma_px, covariance).terms]
        found += any(term.kind == "step" and term.at == 20 for term in terms)
    assert alarms <= 1
    assert blind >= 10  # what it would be without the covariance
    assert found >= 18


@pytest.mark.parametrize("seed", range(6))
def test_a_drift_in_a_season_is_no_row_of_steps(seed: int) -> None:
    years, moved_px, sigma_px = make_series(36, seed)
    moved_px += 0.1 * np.column_stack([np.cos(2 * np.pi * years), np.sin(2 * np.pi * years)])
    moved_px += (years - years[0])[:, None] * (0.08, -0.06)
    assert {each.term.kind for each in analyse(years, moved_px, sigma_px).terms} == {"drift", "season"}


def test_no_step_lies_within_a_day() -> None:
    years, moved_px, sigma_px = make_series(24, 12)
    years[:] = np.repeat([50.0, 51.0], 12)
    moved_px[6:] += (0.3, 0.0)
    assert all(each.term.at == 12 for each in analyse(years, moved_px, sigma_px).terms)


def test_images_of_one_day_and_sigmas_of_zero_are_borne() -> None:
    years, moved_px, _ = make_series(20, 10)
    model = analyse(np.full(20, years[0]), moved_px, np.zeros(20))
    assert model.terms == ()
    assert np.isfinite(model.fitted_px).all()


IMAGES, CELLS = 16, 4


def make_motions(velocity_px: tuple[float, float], seed: int = 1) -> Motions:
    """Tie points of many pairs; cell 2 moves, and every image is off by itself, differently in each cell."""
    random = np.random.default_rng(seed)
    years = np.sort(random.uniform(0, 3, IMAGES))
    own_px = random.normal(size=(IMAGES, CELLS, 2)) * 0.05
    ends = np.array([(i, j) for i in range(IMAGES) for j in range(i + 1, IMAGES)])
    ends = np.repeat(ends, 5 * CELLS, axis=0)
    cell = np.tile(np.arange(CELLS), len(ends) // CELLS)
    span = years[ends[:, 1]] - years[ends[:, 0]]
    moved = own_px[ends[:, 1], cell] - own_px[ends[:, 0], cell] + random.normal(size=(len(ends), 2)) * 0.1
    moved += np.where(cell == 2, span, 0.0)[:, None] * velocity_px
    wrong = random.random(len(ends)) < 0.05
    moved[wrong] += random.normal(size=(int(wrong.sum()), 2)) * 2
    return Motions(cell, ends, span, moved, np.full(len(ends), 0.1))


def test_what_moves_is_found_with_its_velocity() -> None:
    found = velocities(make_motions((0.4, -0.3)), CELLS + 1, IMAGES)
    assert found.moving.tolist() == [False, False, True, False, False]
    assert np.abs(found.velocity_px[2] - (0.4, -0.3)).max() < 3.5 * found.sigma_px[2] < 0.2
    assert np.isnan(found.velocity_px[4]).all()  # without tie points


def test_errors_of_images_are_no_motion() -> None:
    """The sigma of a cell is that of its images, far above that of its points."""
    off, moving = [], 0
    for seed in range(60):
        found = velocities(make_motions((0.0, 0.0), seed), CELLS, IMAGES)
        off.append(found.velocity_px / found.sigma_px[:, None])
        moving += int(found.moving.sum())
    assert moving <= 3  # 0.6 expected: 1 of 100 scenes
    assert 0.6 < float(np.sqrt(np.mean(np.square(off)))) < 1.4


def test_few_points_make_no_motion() -> None:
    """Where cells have few points, few images tell their velocity, whatever the number of all of them."""
    random, moving, tested = np.random.default_rng(4), 0, 0
    years = np.sort(random.uniform(0, 2, 24))
    ends = np.array([(i, j) for i in range(24) for j in (i + 1, i + 3, i + 12) if j < 24])
    for _ in range(20):
        count = random.poisson(0.3 * 300 * len(ends))
        pair = random.integers(0, len(ends), count)
        span = years[ends[pair, 1]] - years[ends[pair, 0]]
        moved = random.normal(size=(count, 2)) * 0.1
        motions = Motions(random.integers(0, 300, count), ends[pair], span, moved, np.full(count, 0.1))
        found = velocities(motions, 300, 24)
        moving += int(found.moving.any())
        tested += int(np.isfinite(found.sigma_px).sum())
    assert tested > 20 * 100
    assert moving <= 1


def test_too_few_images_tell_no_velocity() -> None:
    motions = make_motions((0.4, -0.3))
    few = (motions.ends < 4).all(axis=1)
    part = Motions(*(getattr(motions, name)[few] for name in Motions.__slots__))
    assert np.isnan(velocities(part, CELLS, IMAGES).velocity_px).all()


def test_displacements_of_a_cell_follow_from_pairs() -> None:
    """Their errors are those told; a wrong point does little, and what no pair connects is unknown."""
    random, images = np.random.default_rng(8), 12
    true = random.normal(size=(images, 2))
    ends = np.array([(i, j) for i in range(10) for j in (i + 1, i + 3) if j < 10] + [(10, 11)])
    ends = np.repeat(ends, 6, axis=0)
    in_sigmas = []
    for _ in range(40):
        moved = true[ends[:, 1]] - true[ends[:, 0]] + 0.1 * random.normal(size=(len(ends), 2))
        moved[7] += 5.0
        motions = Motions(np.zeros(len(ends), int), ends, np.ones(len(ends)), moved, np.full(len(ends), 0.1))
        found, sigma_px = displacements(motions, images)
        assert np.isnan(found[10:]).all()
        assert np.isnan(sigma_px[10:]).all()
        assert abs(found[:10].mean()) < 1e-9
        in_sigmas.append((found[:10] - true[:10] + true[:10].mean(axis=0)) / sigma_px[:10, None])
    assert 0.85 < np.sqrt(np.mean(np.square(in_sigmas))) < 1.15
