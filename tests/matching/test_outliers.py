import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.estimation.robust import axis_sigma
from pcwlad_geo.matching.clusters import CLUSTERS, contradicted_clusters
from pcwlad_geo.matching.outliers import OUTLIERS, confirmed, consistent

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
        assert axis_sigma(length_px) == pytest.approx(sigma_px, rel=0.01)
        length_px[::10] = 50.0  # gross errors hardly change it
        assert axis_sigma(length_px) == pytest.approx(sigma_px, rel=0.15)


def test_the_narrow_limit_is_so_many_of_them() -> None:
    """A point just within the limit stays, one just beyond it goes."""
    rng = np.random.default_rng(6)
    xy = rng.uniform(0, 2000, (4000, 2))
    moved = rng.normal(0, 0.08, (4000, 2))
    tested = rng.choice(4000, 60, replace=False)
    about_px = 0.08 * np.sqrt(1 + np.pi / 2 / OUTLIERS.neighbours)  # the median of the neighbours errs too
    for factor, stays in ((0.8, True), (1.25, False)):
        shifted = moved.copy()
        shifted[tested] = [factor * OUTLIERS.scatters * about_px, 0.0]
        kept = consistent(xy, shifted, np.full(4000, 0.05), 41)
        assert kept[tested].all() if stays else not kept[tested].any()


FRAME = np.array([640.0, 512.0])
AFFINE = np.array([[0.966 - 1, -0.02], [0.02, 0.966 - 1]])
"""A pose that the start has missed: displacements up to 14 px, and 1.1 px of noise beside them."""


def with_cluster(
    seed: int, members: int = 26, off_px: float = 15.0, n: int = 226, radius_px: float = 70.0
) -> tuple[NDArray, NDArray, NDArray]:
    """Positions and displacements of an affine with a round cluster beside it, and which are the cluster."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(0.15, 0.85, 2) * FRAME
    others = rng.uniform(0, FRAME, (3 * n, 2))
    others = others[np.linalg.norm(others - centre, axis=1) > radius_px][:n]
    angle, share = rng.uniform(0, 2 * np.pi, members), rng.random(members)
    inside = centre + radius_px * np.sqrt(share)[:, None] * np.c_[np.cos(angle), np.sin(angle)]
    xy = np.concatenate([others, inside])
    displacement = (xy - FRAME / 2) @ AFFINE.T + (3.0, -2.0) + rng.normal(0, 0.8, xy.shape)
    direction = rng.uniform(0, 2 * np.pi)
    displacement[n:] += off_px * np.array([np.cos(direction), np.sin(direction)])
    return xy, displacement, np.arange(len(xy)) >= n


def rejected(xy: NDArray, displacement: NDArray, unit_px: float = 1.0) -> NDArray:
    mask = np.zeros(len(xy), bool)
    for cluster in contradicted_clusters(xy, displacement, WINDOW * unit_px, unit_px):
        mask[cluster.index] = True
    return mask


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("members", "radius_px"), [(9, 40.0), (26, 70.0), (26, 120.0), (50, 90.0)])
def test_a_cluster_beside_what_all_others_predict_is_found(seed: int, members: int, radius_px: float) -> None:
    xy, displacement, wrong = with_cluster(seed, members, radius_px=radius_px)
    np.testing.assert_array_equal(rejected(xy, displacement), wrong)


def test_it_survives_the_neighbours_and_is_told_with_its_offset() -> None:
    survived = 0
    for seed in range(6):
        xy, displacement, wrong = with_cluster(seed, 60, n=500, radius_px=110.0)
        kept = consistent(xy, displacement, np.full(len(xy), 1.1), WINDOW)
        if np.count_nonzero(kept & wrong) < 6:
            continue
        survived += 1
        (cluster,) = contradicted_clusters(xy[kept], displacement[kept], WINDOW)
        np.testing.assert_array_equal(np.flatnonzero(kept)[cluster.index], np.flatnonzero(kept & wrong))
        beside = displacement - (xy - FRAME / 2) @ AFFINE.T - (3.0, -2.0)
        truth = np.median(beside[wrong], axis=0)
        assert np.linalg.norm(cluster.offset_px - truth) < 0.5
    assert survived >= 3


def test_two_clusters_are_told_apart() -> None:
    xy, displacement, wrong = with_cluster(0, 15, n=300)
    far = np.linalg.norm(xy - xy[wrong].mean(axis=0), axis=1)
    second = np.linalg.norm(xy - xy[far.argmax()], axis=1) < 60
    assert 6 <= second.sum() <= 30
    displacement[second] -= 12.0
    found = contradicted_clusters(xy, displacement, WINDOW)
    assert sorted(len(cluster.index) for cluster in found) == sorted([wrong.sum(), second.sum()])


@pytest.mark.parametrize("off_px", [0.0, 2.0])
def test_a_small_offset_is_no_contradiction(off_px: float) -> None:
    xy, displacement, _ = with_cluster(1, off_px=off_px)
    assert contradicted_clusters(xy, displacement, WINDOW) == []


def test_the_least_offset_counts_in_pixels_of_the_matching() -> None:
    xy, displacement, wrong = with_cluster(2, off_px=15.0)
    np.testing.assert_array_equal(rejected(xy * 4, displacement * 4, 4.0), wrong)
    assert not rejected(xy, displacement, 6.0).any()  # 15 px are two and a half of them


@pytest.mark.parametrize("size_px", [5.0, 15.0])
@pytest.mark.parametrize("radius_px", [80.0, 150.0])
@pytest.mark.parametrize("seed", range(3))
def test_ground_that_bends_smoothly_is_kept(size_px: float, radius_px: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, SIDE, (900, 2))
    squared = ((xy - rng.uniform(200, 600, 2)) ** 2).sum(axis=1) / radius_px**2
    bend = size_px * np.exp(-squared / 2)
    displacement = np.c_[bend, -0.4 * bend] + 0.01 * xy + rng.normal(0, 0.2, xy.shape)
    assert contradicted_clusters(xy, displacement, WINDOW) == []


@pytest.mark.parametrize("wavelength_px", [200, 500, 1000])
def test_a_rough_field_is_kept(wavelength_px: float) -> None:
    xy, noise = scene(700)
    waves = 12 * np.sin(2 * np.pi * xy[:, ::-1] / wavelength_px)
    assert contradicted_clusters(xy, waves + noise, WINDOW) == []


@pytest.mark.parametrize(("strait_px", "kept"), [(100.0, False), (600.0, True)])
def test_an_island_contradicts_nobody(strait_px: float, kept: bool) -> None:
    xy, noise = scene(300)
    island = np.arange(len(xy)) < 40
    xy[island] = (SIDE + strait_px, 300.0) + xy[island] / 6
    noise[island] += 9.0
    assert (contradicted_clusters(xy, noise, WINDOW) == []) is kept


def test_a_part_that_is_no_minority_is_kept() -> None:
    """A block beyond a fault: more than a fifth of the scene is not outvoted."""
    xy, noise = scene(500)
    for share in (CLUSTERS.most_share + 0.05, 0.5):
        block = xy[:, 0] < share * SIDE
        assert contradicted_clusters(xy, np.where(block[:, None], 9.0, 0.0) + noise, WINDOW) == []


@pytest.mark.parametrize("n", [0, 1, 5, 30])
def test_clusters_of_few_matches_or_on_a_line(n: int) -> None:
    line = np.column_stack([np.arange(2.0 * n), np.zeros(2 * n)])
    moved = np.where(line[:, :1] > 1.8 * n, 20.0, 0.0) + np.zeros((2 * n, 2))
    assert contradicted_clusters(line, moved, WINDOW) == []


def test_ground_that_moved_by_itself_confirms_its_matches_and_scattered_errors_do_not() -> None:
    rng = np.random.default_rng(4)
    xy = rng.uniform(0, 400, (600, 2))
    slide = np.abs(xy - 200).max(axis=1) < 60
    wrong = ~slide & (rng.random(600) < 0.1)
    displacement = rng.normal(0, 0.05, (600, 2)) + slide[:, None] * np.array([5.0, -3.0])
    displacement[wrong] += rng.uniform(-6, 6, (int(wrong.sum()), 2))
    index = np.flatnonzero(slide | wrong)
    found = confirmed(xy, displacement, index, np.zeros((len(index), 2)), 81)
    assert found[slide[index]].all()
    assert found[wrong[index]].mean() < 0.05
    assert not confirmed(xy[:2], displacement[:2], np.array([0]), np.zeros((1, 2)), 81).any()
