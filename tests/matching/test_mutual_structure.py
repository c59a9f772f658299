from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pcwlad_geo.matching.mutual_structure import mutual_structure
from pcwlad_geo.matching.paper import PAPER, PaperParameters

SIDE = 81
SHARED, INVERTED, REFERENCE_ONLY, TARGET_ONLY, FLAT = (20, 20), (20, 60), (60, 20), (60, 60), (40, 40)


def disc(centre: tuple[int, int]) -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE]
    return gaussian_filter((np.hypot(y - centre[0], x - centre[1]) < 6).astype(float), 0.7)


def windows(noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    reference = 0.3 + 0.4 * (disc(SHARED) + disc(INVERTED) + disc(REFERENCE_ONLY))
    target = 0.5 + 0.3 * (disc(SHARED) - disc(INVERTED) + disc(TARGET_ONLY))
    noises = np.random.default_rng(seed).standard_normal((2, SIDE, SIDE)) * noise
    return reference + noises[0], target + noises[1]


def on_edge(weight: np.ndarray, centre: tuple[int, int]) -> float:
    y, x = np.mgrid[:SIDE, :SIDE]
    distance = np.hypot(y - centre[0], x - centre[1])
    return float(weight[np.abs(distance - 6) < 2].mean())


def energy(g: np.ndarray, i: np.ndarray, g0: np.ndarray, i0: np.ndarray) -> float:
    """The functional itself, each local line fitted by brute force over its cut-off neighbourhood."""
    total = PAPER.lambda_target * ((i - i0) ** 2).sum() + PAPER.lambda_reference * ((g - g0) ** 2).sum()
    for r in range(g.shape[0]):
        for c in range(g.shape[1]):
            near = np.s_[
                max(r - PAPER.filter_radius_px, 0) : r + PAPER.filter_radius_px + 1,
                max(c - PAPER.filter_radius_px, 0) : c + PAPER.filter_radius_px + 1,
            ]
            local_g, local_i = g[near].ravel(), i[near].ravel()
            covariance = np.cov(local_g, local_i, bias=True)
            a1 = covariance[0, 1] / (covariance[1, 1] + PAPER.epsilon_target)
            b1 = covariance[0, 1] / (covariance[0, 0] + PAPER.epsilon_reference)
            a0, b0 = local_g.mean() - a1 * local_i.mean(), local_i.mean() - b1 * local_g.mean()
            total += ((a1 * local_i + a0 - local_g) ** 2 + (b1 * local_g + b0 - local_i) ** 2).sum()
            total += local_g.size * (PAPER.epsilon_target * a1**2 + PAPER.epsilon_reference * b1**2)
    return float(total)


def steps(number: int) -> PaperParameters:
    return replace(PAPER, filter_iterations=number)


def test_the_energy_falls_monotonically() -> None:
    g0, i0 = (window[8:40, 8:40] for window in windows(0.05))
    energies = []
    for iterations in range(8):
        g, i, _ = mutual_structure(g0, i0, steps(iterations))
        energies.append(energy(g, i, g0, i0))
    assert (np.diff(energies) < 0).all()
    assert energies[-1] < 0.8 * energies[0]


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_shared_structure_weighs_much_single_structure_little(noise: float) -> None:
    weight = mutual_structure(*windows(noise))[2]
    assert weight.min() >= 0
    assert weight.max() <= 1
    assert on_edge(weight, SHARED) > 0.9
    assert on_edge(weight, INVERTED) > 0.9
    assert on_edge(weight, REFERENCE_ONLY) < 0.15
    assert on_edge(weight, TARGET_ONLY) < 0.15
    assert weight[36:45, 36:45].mean() < 0.15


def test_filtering_makes_shared_edges_stand_out_of_noise() -> None:
    before = mutual_structure(*windows(0.06), steps(0))[2]
    after = mutual_structure(*windows(0.06))[2]
    assert on_edge(after, SHARED) > on_edge(before, SHARED) + 0.08


def test_the_filter_removes_what_only_the_target_has() -> None:
    reference, target = windows(0.01)
    _, filtered, _ = mutual_structure(reference, target)
    y, x = FLAT
    assert filtered[y - 4 : y + 5, x - 4 : x + 5].std() < 0.5 * target[y - 4 : y + 5, x - 4 : x + 5].std()
    inside = np.s_[SHARED[0] - 2 : SHARED[0] + 3, SHARED[1] - 2 : SHARED[1] + 3]
    assert filtered[inside].mean() - filtered[36:45, 36:45].mean() == pytest.approx(0.3, abs=0.05)


def test_inverting_the_target_inverts_the_result_and_keeps_the_weight() -> None:
    reference, target = windows(0.02)
    filtered_r, filtered_t, weight = mutual_structure(reference, target)
    inverted_r, inverted_t, inverted_weight = mutual_structure(reference, 1 - target)
    np.testing.assert_allclose(inverted_r, filtered_r, atol=1e-10)
    np.testing.assert_allclose(inverted_t, 1 - filtered_t, atol=1e-10)
    np.testing.assert_allclose(inverted_weight, weight, atol=1e-9)


def test_a_stack_gives_what_each_window_gives() -> None:
    pairs = [windows(0.02, seed) for seed in range(3)]
    stacked = mutual_structure(np.stack([a for a, _ in pairs]), np.stack([b for _, b in pairs]), steps(3))
    for k, pair in enumerate(pairs):
        for whole, single in zip(stacked, mutual_structure(*pair, steps(3)), strict=True):
            np.testing.assert_array_equal(whole[k], single)


def test_the_input_is_left_alone() -> None:
    reference, target = windows(0.02)
    kept = reference.copy(), target.copy()
    mutual_structure(reference, target, steps(2))
    np.testing.assert_array_equal(reference, kept[0])
    np.testing.assert_array_equal(target, kept[1])


def test_unequal_windows_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(9, 9\), \(9, 8\)"):
        mutual_structure(np.zeros((9, 9)), np.zeros((9, 8)))
