from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction import fit, fitted
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.fitted import Trend
from pcwlad_geo.correction.selection import choose
from pcwlad_geo.correction.selection_parameters import SELECTION
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.robust import Estimate

from .points import (
    affine,
    inside,
    isotropic,
    noise,
    polynomial,
    predicted_sigma,
    projective,
    scattered,
    waves,
    window_noise,
)

Array = NDArray[np.float64]
SIMPLE = ("shift", "affine")


@pytest.mark.slow
@pytest.mark.parametrize("n", [40, 250])
def test_a_noisy_shift_is_a_shift(n: int) -> None:
    wrong = 0
    for seed in range(30):
        predicted = scattered(seed, n)
        observed = predicted + np.array([2.0, -1.0]) + noise(seed, n, 0.1)
        wrong += choose(predicted, observed, isotropic(n, 0.1), 81).name != "shift"
    assert wrong <= 2


@pytest.mark.slow
def test_errors_that_windows_share_are_not_taken_for_deformation() -> None:
    wrong = 0
    for seed in range(20):
        predicted = scattered(seed, 200)
        observed = predicted + 0.1 * window_noise(seed, predicted, 512, 81)
        wrong += choose(predicted, observed, isotropic(200, 0.1), 81).name != "shift"
    assert wrong <= 2


@pytest.mark.parametrize(("noise_px", "expected"), [(0.12, {"shift", "affine"}), (0.02, {"polynomial2"})])
def test_a_bend_on_few_windows_must_be_far_above_the_errors(noise_px: float, expected: set[str]) -> None:
    """Points that errors of a few windows bend are no evidence of a bend, unless they agree closely."""
    predicted = scattered(0, 130, 1.0) * (740, 360)
    across = predicted[:, 0] / 370 - 1
    bend = np.column_stack([-0.9 * across**2, 0.5 * across**2])
    observed = predicted + bend + noise(0, 130, noise_px)
    selection = choose(predicted, observed, isotropic(130, noise_px), 181)
    assert selection.name in expected
    if "affine" in expected:
        assert "too many parameters" in selection.candidates[5].note


@pytest.mark.slow
def test_0_3_px_across_the_image_is_an_affine() -> None:
    for seed in range(10):
        predicted = scattered(seed, 300)
        observed = affine(0.3).forward(predicted) + noise(seed, 300, 0.1)
        selection = choose(predicted, observed, isotropic(300, 0.1), 81)
        assert selection.name == "affine"
        np.testing.assert_allclose(
            selection.fit.correction.forward(predicted), affine(0.3).forward(predicted), atol=0.07
        )
        shift, _, _, chosen = selection.candidates[:4]
        assert [score.name for score in selection.candidates if score.chosen] == ["affine"]
        assert shift.note == "affine predicts better"
        assert (shift.parameters, chosen.parameters) == (2, 6)
        # Radial RMSE: noise √2 · 0.1; the shift leaves 0.3/√12 more in col.
        assert chosen.rmse_px == pytest.approx(0.1414, rel=0.15)
        assert shift.rmse_px > chosen.rmse_px
        assert 0 < chosen.rmse_standard_error_px < 0.03


def test_outliers_neither_hide_nor_make_an_affine() -> None:
    predicted = scattered(3, 400)
    error = noise(3, 400, 0.1)
    error[::10] = np.random.default_rng(3).uniform(-30, 30, (40, 2))
    assert choose(predicted, predicted + error, isotropic(400, 0.1), 81).name == "shift"
    stretched = affine(0.6).forward(predicted) + error
    assert choose(predicted, stretched, isotropic(400, 0.1), 81).name == "affine"


@pytest.mark.parametrize("seed", range(3))
def test_a_cluster_that_errs_alike_does_not_hide_an_affine(seed: int) -> None:
    """By the mean of the blocks the shift predicts better: the affine misses the cluster by more."""
    rng = np.random.default_rng(seed)
    predicted = scattered(seed, 252)
    trend = (predicted - 256) * (0.02, -0.02)
    cluster = np.argsort(np.linalg.norm(predicted - (440, 70), axis=1))[:40]
    error = rng.normal(0, 0.7, (252, 2))
    error[cluster] -= 3 * trend[cluster].mean(axis=0)
    selection = choose(predicted, predicted + trend + error, isotropic(252, 0.2), 81, ("shift", "affine"))
    shift, chosen = selection.candidates
    assert shift.rmse_px < chosen.rmse_px
    assert selection.name == "affine"
    others = np.setdiff1d(np.arange(252), cluster)
    missed = selection.fit.correction.forward(predicted[others]) - (predicted + trend)[others]
    assert np.sqrt((missed**2).sum(axis=1).mean()) < 0.3


def test_a_strong_affine_in_a_small_image() -> None:
    predicted = scattered(4, 100, 200)
    observed = affine(3.0, 200).forward(predicted) + noise(4, 100, 0.1)
    assert choose(predicted, observed, isotropic(100, 0.1), 81).name == "affine"


def test_few_points_get_the_simplest_model_and_the_reason() -> None:
    predicted = scattered(5, 8)
    selection = choose(predicted, affine(5.0).forward(predicted), isotropic(8, 0.1), 81)
    assert selection.name == "shift"
    assert all(np.isnan(c.rmse_px) for c in selection.candidates)
    notes = [score.note for score in selection.candidates]
    assert all(any(part in note for part in ("too few", "needs at least", "not tried")) for note in notes)


def test_points_on_a_line_leave_the_shift() -> None:
    predicted = np.column_stack([np.linspace(0, 500, 60), np.full(60, 7.0)])
    selection = choose(predicted, predicted + noise(6, 60, 0.1), isotropic(60, 0.1), 41)
    assert selection.name == "shift"
    assert "on a line" in selection.candidates[3].note
    assert np.isfinite(selection.candidates[0].rmse_px)


LOCAL = {"polynomial2", "polynomial3", "tps"}


@pytest.mark.parametrize(("wavy_px", "expected"), [(0.12, {"projective"}), (0.5, LOCAL)])
def test_flat_ground_of_two_frames_is_projective(wavy_px: float, expected: set[str]) -> None:
    """A faint bend that all matches share is no reason for a polynomial, a real distortion is."""
    points, places = scattered(5, 400, 1024), inside(1024)
    truth = projective(1024)
    bend = np.sin(points[:, ::-1] * np.pi / 1024) - 0.6
    observed = truth.forward(points) + wavy_px * bend + noise(5, 400, 0.05)
    given = points, observed, isotropic(400, 0.1), 81
    found, any_pair = choose(*given, perspective=True), choose(*given)
    assert found.name in expected
    assert any_pair.name in LOCAL
    if expected == {"projective"}:
        note = next(each.note for each in found.candidates if each.name == any_pair.name)
        assert "the image of flat ground" in note
        left = found.fit.correction.forward(places) - truth.forward(places)
        assert np.sqrt((left**2).sum(axis=1).mean()) < wavy_px


@pytest.mark.parametrize("tilted", [True, False])
def test_a_photograph_of_few_windows_is_projective_where_it_is_tilted(tilted: bool) -> None:
    """On a map an affine is asked for less than a projective is; of a camera both are alike."""
    names, on_maps = [], []
    for seed in range(5):
        points = scattered(seed, 200)
        truth = projective() if tilted else affine(1.0)
        error = 0.15 * (window_noise(seed, points, 512, 155) + noise(seed, 200, 1.0))
        given = points, truth.forward(points) + error, isotropic(200, 0.2), 155
        names.append(choose(*given, perspective=True).name)
        on_maps.append(choose(*given).name)
    assert names.count("projective") == (5 if tilted else 0)
    assert on_maps.count("projective") < (5 if tilted else 1)


def test_identical_images() -> None:
    predicted = scattered(7, 60)
    selection = choose(predicted, predicted, np.zeros((60, 2, 2)), 81)
    assert selection.name == "shift"
    assert selection.candidates[0].rmse_px == pytest.approx(0, abs=1e-4)


def test_one_candidate_is_taken() -> None:
    predicted = scattered(8, 60)
    assert choose(predicted, predicted, isotropic(60, 0.1), 81, ("affine",)).name == "affine"


def test_no_candidate_can_be_fitted() -> None:
    with pytest.raises(InputError, match="2 tie points for the shift model"):
        choose(scattered(0, 2), scattered(0, 2), isotropic(2, 0.1), 81)


FIELDS: dict[str, Callable[[int, Array], Array]] = {
    "shift": lambda seed, xy: np.full_like(xy, 0.7),
    "affine": lambda seed, xy: affine(1.0, 1024).forward(xy) - xy,
    "projective": lambda seed, xy: projective(1024).forward(xy) - xy,
    "polynomial": lambda seed, xy: polynomial(2, seed, 1024, 1.0).forward(xy) - xy,
    "waves": lambda seed, xy: waves(seed, xy, 2.0, 1000),
    "faint waves": lambda seed, xy: waves(seed, xy, 0.3, 600),
}


EXPECTED = {"shift": {"shift"}, "affine": {"affine"}, "projective": {"projective"} | LOCAL}


def choose_for(kind: str, seed: int) -> tuple[bool, list[float]]:
    """Return whether the model fits the field, and the RMSE of it and of the simple ones, px."""
    points, places = scattered(seed, 300, 1024), inside(1024, 15)
    error = 0.07 * (window_noise(seed, points, 1024, 81) + noise(seed, 300, 1.0))
    observed = points + FIELDS[kind](seed, points) + error
    selection = choose(points, observed, isotropic(300, 0.1), 81)
    truth = places + FIELDS[kind](seed, places)
    models = [selection.fit, *(MODELS[name].fit(points, observed, isotropic(300, 0.1)) for name in SIMPLE)]
    squared = [((fit.correction.forward(places) - truth) ** 2).sum(axis=1).mean() for fit in models]
    return selection.name in EXPECTED.get(kind, LOCAL), [float(np.sqrt(each)) for each in squared]


@pytest.mark.parametrize("kind", FIELDS)
def test_the_model_follows_the_field(kind: str) -> None:
    """Once; below, in nine of ten other cases."""
    right, (chosen, *simpler) = choose_for(kind, 0)
    assert right
    assert chosen < min(simpler) + 0.03
    assert chosen < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", FIELDS)
def test_the_model_follows_the_field_and_is_never_worse_than_a_simpler_one(kind: str) -> None:
    cases = [choose_for(kind, seed) for seed in range(1, 11)]
    assert sum(right for right, _ in cases) >= 9
    rmse = np.array([each for _, each in cases])
    chosen, simpler = rmse[:, 0], rmse[:, 1:].min(axis=1)
    assert (chosen < simpler + 0.03).all()
    assert np.sqrt((chosen**2).mean()) < np.sqrt((simpler**2).mean()) + 0.002
    assert np.sqrt((chosen**2).mean()) < 0.08


@pytest.mark.slow
@pytest.mark.parametrize("expected", ["shift", "drift", "affine"])
def test_an_rpc_takes_the_simplest_correction_of_its_image(expected: str) -> None:
    slopes = {
        "shift": np.zeros((2, 2)),
        "drift": [[0, 8e-4], [0, -5e-4]],
        "affine": [[9e-4, 3e-4], [-6e-4, 4e-4]],
    }
    right = 0
    for seed in range(10):
        points = scattered(seed, 300, 1024)
        error = 0.07 * (window_noise(seed, points, 1024, 81) + noise(seed, 300, 1.0))
        observed = points + (points - 512) @ np.transpose(slopes[expected]) + (0.8, -1.1) + error
        selection = choose(points, observed, isotropic(300, 0.1), 81, ("shift", "drift", "affine"))
        right += selection.name == expected
    assert right >= 9


@pytest.mark.slow
def test_ten_percent_outliers_change_nothing() -> None:
    points, places = scattered(20, 600, 1024), inside(1024)
    for size in (0.0, 2.0):
        observed = points + waves(20, points, size, 1000) + noise(20, 600, 0.1)
        spoilt = observed.copy()
        spoilt[::10] += np.random.default_rng(20).uniform(-20, 20, (60, 2))
        clean, robust = (choose(points, seen, isotropic(600, 0.1), 81) for seen in (observed, spoilt))
        assert clean.name == robust.name == ("tps" if size else "shift")
        moved = robust.fit.correction.forward(places) - clean.fit.correction.forward(places)
        assert np.sqrt((moved**2).sum(axis=1).mean()) < 0.02


@pytest.mark.slow
def test_a_model_that_folds_is_never_chosen() -> None:
    points = scattered(21, 800)
    observed = points + waves(21, points, 60.0, 300) + noise(21, 800, 0.05)  # slopes of -1.26
    selection = choose(points, observed, isotropic(800, 0.05), 15)
    assert selection.name != "tps"
    (tps,) = (score for score in selection.candidates if score.name == "tps")
    assert "would fold the image" in tps.note
    with pytest.raises(InputError, match="the tps model would fold the image"):
        choose(points, observed, isotropic(800, 0.05), 15, ("tps",))


def test_the_image_must_not_fold_beyond_the_points_either() -> None:
    points = scattered(22, 300, 100) + np.array([400.0, 0.0])  # in one corner of 512 x 512
    c = (points - [450.0, 50.0]) / 50
    observed = points + np.column_stack([14 * c[:, 0] ** 2, np.zeros(300)])  # slope -0.56 at the left
    box = np.zeros(2), np.array([512.0, 512.0])
    assert choose(points, observed, isotropic(300, 0.1), 15, ("polynomial2",), box_px=box).name
    observed = points + np.column_stack([30 * c[:, 0] ** 2, np.zeros(300)])
    with pytest.raises(InputError, match="fold"):
        choose(points, observed, isotropic(300, 0.1), 15, ("polynomial2",), box_px=box)


def test_the_precision_of_a_model_chosen_by_hand_knows_what_it_misses() -> None:
    points, places = scattered(23, 400, 1024), inside(1024)
    observed = points + waves(23, points, 1.0, 700) + noise(23, 400, 0.1)
    selection = choose(points, observed, isotropic(400, 0.1), 81, ("shift",))
    missed = selection.fit.correction.forward(places) - places - waves(23, places, 1.0, 700)
    size = np.sqrt((missed**2).mean(axis=0))
    np.testing.assert_allclose(selection.sigma(places).mean(axis=0), size, rtol=0.25)
    straight = choose(points, points + noise(23, 400, 0.1), isotropic(400, 0.1), 81, ("shift",))
    assert predicted_sigma(straight.fit, places).max() < 0.015
    assert (
        straight.sigma(places).max() < SELECTION.common_sigma * 0.1 + 0.005
    )  # and what all points err alike


@pytest.mark.slow
def test_points_in_one_corner_do_not_bend_the_rest() -> None:
    for seed in range(10):
        points = scattered(seed, 200, 150)
        observed = points + 0.1 * window_noise(seed, points, 150, 41)
        selection = choose(points, observed, isotropic(200, 0.1), 41)
        assert selection.name in ("shift", "affine")
        assert selection.fit.support.extrapolated(np.array([[500.0, 500.0]]))[0]


@pytest.mark.parametrize("n", [3, 5, 12, 13, 20])
def test_few_points_get_a_simple_model(n: int) -> None:
    points = scattered(n, n)
    selection = choose(points, points + noise(n, n, 0.1), isotropic(n, 0.1), 81)
    assert selection.name in ("shift", "affine")
    assert [score.chosen for score in selection.candidates].count(True) == 1
    assert all(score.note or score.chosen for score in selection.candidates)


def test_the_robust_affine_is_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All models but the shift start from it."""
    points = scattered(0, 120)
    observed = affine(1.0).forward(points) + noise(0, 120, 0.1)
    asked, plain = [], fitted.estimate

    def counted(basis: Array, *given: Array) -> Estimate:
        asked.append(basis.shape[1])
        return plain(basis, *given)

    for module in (fitted, fit):
        monkeypatch.setattr(module, "estimate", counted)
    choose(points, observed, isotropic(120, 0.1), 0.0)
    assert sorted(asked) == [1, 3]


@pytest.mark.parametrize("name", [name for name in MODELS if name not in ("shift", "drift")])
def test_a_trend_that_is_known_changes_no_fit(name: str) -> None:
    points = scattered(1, 120)
    given = points, affine(1.0).forward(points) + noise(1, 120, 0.1), isotropic(120, 0.1)
    alone, from_trend = MODELS[name].fit(*given), MODELS[name].fit(*given, trend=Trend.of(*given))
    moved = [each.correction.forward(points) for each in (alone, from_trend)]
    np.testing.assert_array_equal(*moved)


def test_a_larger_least_gain_keeps_the_simpler_model() -> None:
    predicted = scattered(0, 200)
    observed = affine(2.0).forward(predicted) + noise(0, 200, 0.1)
    points = (predicted, observed, isotropic(200, 0.1), 81, SIMPLE)
    assert choose(*points).name == "affine"
    assert choose(*points, parameters=replace(SELECTION, min_gain_px=5.0)).name == "shift"
