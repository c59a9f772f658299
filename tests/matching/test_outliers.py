import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching.outliers import NEIGHBOURS, SCATTERS, axis_sigma_px, consistent

SIDE, WINDOW, SIGMA = 800.0, 81, 0.05


def scene(n: int = 500, seed: int = 0) -> tuple[NDArray, NDArray]:
    """Positions, and the displacement noise of good matches."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0, SIDE, (n, 2)), rng.normal(0, SIGMA, (n, 2))


def judged(xy: NDArray, displacement: NDArray, sigma: float = SIGMA) -> NDArray:
    return consistent(xy, displacement, np.full(len(xy), sigma * np.sqrt(2)), WINDOW)


FIELDS = {
    "constant": lambda xy: np.full(xy.shape, 3.0),
    "stretched": lambda xy: xy * (0.01, -0.01),
    "turned": lambda xy: xy[:, ::-1] * (0.01, -0.01),
    "wavy": lambda xy: 1.5 * np.sin(2 * np.pi * xy[:, ::-1] / 800),
}


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("n", [120, 500])
def test_good_matches_of_a_smooth_field_stay(name: str, n: int) -> None:
    xy, noise = scene(n)
    assert judged(xy, FIELDS[name](xy) + noise).mean() > 0.97


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("share", [0.1, 0.35])
def test_gross_errors_go(name: str, share: float) -> None:
    xy, noise = scene()
    rng = np.random.default_rng(5)
    wrong = rng.random(len(xy)) < share
    displacement = FIELDS[name](xy) + noise
    displacement[wrong] = rng.uniform(-10, 10, (wrong.sum(), 2))
    # a random vector may happen to be right
    wrong &= np.linalg.norm(displacement - FIELDS[name](xy), axis=1) > 1.5
    kept = judged(xy, displacement)
    assert kept[wrong].sum() <= 0.02 * wrong.sum()
    assert kept[~wrong].mean() > 0.95


def test_an_error_of_one_pixel_goes_where_the_matches_are_good_to_a_twentieth() -> None:
    xy, noise = scene()
    noise[::25] += (0.8, -0.6)
    kept = judged(xy, noise)
    assert not kept[::25].any()
    assert kept.mean() > 0.95


@pytest.mark.parametrize("offset_px", [1.0, 3.0, 8.0])
def test_a_cluster_that_errs_alike_goes(offset_px: float) -> None:
    xy, noise = scene(800)
    cluster = (np.abs(xy - (420, 380)) < WINDOW / 2).all(axis=1)
    assert cluster.sum() >= 5
    noise[cluster] += (offset_px, 0)
    kept = judged(xy, noise)
    assert not kept[cluster].any()
    assert kept[~cluster].mean() > 0.98


def test_scattered_matches_with_honest_sigmas_stay() -> None:
    rng = np.random.default_rng(7)
    xy, _ = scene()
    assert judged(xy, rng.normal(0, 0.3, xy.shape), sigma=0.3).mean() > 0.95


def test_displacements_at_random_do_not_pass() -> None:
    rng = np.random.default_rng(8)
    xy, _ = scene()
    assert judged(xy, rng.uniform(-10, 10, xy.shape)).mean() < 0.05


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_matches_vouch_for_nothing(n: int) -> None:
    assert not judged(np.arange(2.0 * n).reshape(n, 2), np.zeros((n, 2))).any()


def test_the_answer_does_not_depend_on_order_or_place() -> None:
    xy, noise = scene(300)
    noise[::7] += 4.0
    kept = judged(xy, noise)
    order = np.random.default_rng(9).permutation(300)
    np.testing.assert_array_equal(judged(xy[order], noise[order]), kept[order])
    np.testing.assert_array_equal(judged(xy, noise + 100.0), kept)


def test_the_scatter_is_the_standard_deviation_of_an_axis() -> None:
    """Lengths of round normal errors: 1.4826 times their median would be 1.75 standard deviations."""
    rng = np.random.default_rng(5)
    for sigma_px in (0.05, 0.4):
        length_px = np.linalg.norm(rng.normal(0, sigma_px, (200_000, 2)), axis=1)
        assert axis_sigma_px(length_px) == pytest.approx(sigma_px, rel=0.01)
        length_px[::10] = 50.0  # gross errors hardly change it
        assert axis_sigma_px(length_px) == pytest.approx(sigma_px, rel=0.15)


def test_the_narrow_limit_is_so_many_of_them() -> None:
    """A point just within the limit stays, one just beyond it goes."""
    rng = np.random.default_rng(6)
    xy = rng.uniform(0, 2000, (4000, 2))
    moved = rng.normal(0, 0.08, (4000, 2))
    tested = rng.choice(4000, 60, replace=False)
    about_px = 0.08 * np.sqrt(1 + np.pi / 2 / NEIGHBOURS)  # the median of the neighbours errs too
    for factor, stays in ((0.8, True), (1.25, False)):
        shifted = moved.copy()
        shifted[tested] = [factor * SCATTERS * about_px, 0.0]
        kept = consistent(xy, shifted, np.full(4000, 0.05), 41)
        assert kept[tested].all() if stays else not kept[tested].any()
