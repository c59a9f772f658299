"""The joint adjustment of images: exact truth, wrong pairs, datum, sigma."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.stack.adjustment import Adjustment, adjust
from pcwlad_geo.multi.stack.edges import Edge

Array = NDArray[np.float64]

SIDE = 1000.0
GRID = np.stack(np.meshgrid(*[np.linspace(50.0, 950.0, 6)] * 2), axis=-1).reshape(-1, 2)
RING = (1, 2, 5)
"""Each image is paired with those that follow it by so many places."""


@dataclass(frozen=True)
class Truth:
    """Images with known displacements."""

    terms: Array
    """(images, 3, 2) shift, and slopes along x and y over half a side."""

    def displacement(self, image: int, xy: Array) -> Array:
        u = (xy - SIDE / 2) / (SIDE / 2)
        return np.asarray(np.column_stack([np.ones(len(xy)), u]) @ self.terms[image])

    def edge(
        self,
        rng: np.random.Generator,
        one: int,
        other: int,
        *,
        shared: float,
        sigma: float,
        off: Array | float = 0.0,
    ) -> Edge:
        ground = rng.uniform(0.0, SIDE, (200, 2))
        error = rng.normal(0.0, shared, 2) + rng.normal(0.0, sigma or 1e-9, ground.shape) + off
        covariance = np.tile(np.eye(2) * max(sigma, 0.01) ** 2, (len(ground), 1, 1))
        first = ground + self.displacement(one, ground)
        return Edge(one, other, first, ground + self.displacement(other, ground) + error, covariance)


def make(rng: np.random.Generator, images: int, *, slopes: float = 0.5) -> Truth:
    terms = rng.normal(0.0, slopes, (images, 3, 2))
    terms[:, 0] = rng.uniform(-5.0, 5.0, (images, 2))
    return Truth(terms)


def ring(images: int) -> list[tuple[int, int]]:
    found = {tuple(sorted((one, (one + step) % images))) for one in range(images) for step in RING}
    return sorted((pair[0], pair[1]) for pair in found)


def errors(found: Adjustment, truth: Truth, datum: int | None) -> Array:
    """Return the (images, places, 2) errors of the displacements, up to the datum."""
    images = len(truth.terms)
    off = np.stack([found.displacement(k, GRID) - truth.displacement(k, GRID) for k in range(images)])
    return off - (off.mean(axis=0) if datum is None else off[datum])


@pytest.mark.parametrize("datum", [0, 3, None])
def test_exact_points_give_exact_displacements(datum: int | None) -> None:
    rng = np.random.default_rng(0)
    truth = make(rng, 6)
    edges = [truth.edge(rng, *pair, shared=0.0, sigma=0.0) for pair in ring(6)]
    found = adjust(edges, 6, datum=datum)
    # the linear part of the datum bends the frame by the product of two slopes: 1e-3 of 5 px
    assert np.abs(errors(found, truth, datum)).max() < 0.01
    assert all(fit.in_use for fit in found.edges)
    if datum is not None:
        assert np.abs(found.displacement(datum, GRID)).max() == 0.0


def test_shifts_alone_are_exact() -> None:
    rng = np.random.default_rng(1)
    truth = make(rng, 5, slopes=0.0)
    found = adjust([truth.edge(rng, *pair, shared=0.0, sigma=0.0) for pair in ring(5)], 5, model="shift")
    assert np.abs(errors(found, truth, 0)).max() < 1e-6


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]
)
def test_wrong_pairs_are_found_and_no_good_one_is_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, pairs = make(rng, 24), ring(24)
    wrong = set(rng.choice(len(pairs), 6, replace=False).tolist())
    turn = rng.uniform(0.0, 2 * np.pi, len(pairs))
    size = rng.uniform(1.0, 8.0, len(pairs))
    off = np.column_stack([size * np.cos(turn), size * np.sin(turn)])
    edges = [
        truth.edge(rng, *pair, shared=0.02, sigma=0.08, off=off[k] if k in wrong else 0.0)
        for k, pair in enumerate(pairs)
    ]
    found = adjust(edges, 24, datum=None)
    assert {k for k, fit in enumerate(found.edges) if not fit.in_use} == wrong
    worst_px = np.sqrt((errors(found, truth, None) ** 2).sum(axis=-1).mean(axis=1)).max()
    assert worst_px < 0.035
    assert np.median([fit.shared for fit in found.edges]) == pytest.approx(0.02, rel=0.3)


def test_an_image_whose_wrong_pairs_are_fewer_than_its_right_ones_is_placed_by_those() -> None:
    rng = np.random.default_rng(5)
    truth, pairs = make(rng, 12), ring(12)
    of_one = [k for k, pair in enumerate(pairs) if 1 in pair]
    off = {of_one[0]: np.array([2.0, 3.0]), of_one[1]: np.array([-4.0, 1.0])}
    edges = [
        truth.edge(rng, *pair, shared=0.02, sigma=0.08, off=off.get(k, 0.0)) for k, pair in enumerate(pairs)
    ]
    found = adjust(edges, 12)
    assert {k for k, fit in enumerate(found.edges) if not fit.in_use} == set(off)


@pytest.mark.slow
def test_sigma_covers_the_errors() -> None:
    within = []
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        truth = make(rng, 8)
        edges = [truth.edge(rng, *pair, shared=0.03, sigma=0.08) for pair in ring(8)]
        found = adjust(edges, 8)
        off = errors(found, truth, 0)
        for image in range(1, 8):
            sigma = np.sqrt(np.diagonal(found.covariance(image, GRID), axis1=1, axis2=2))
            within.append(np.abs(off[image]) / sigma)
    ratio = np.array(within)
    assert 0.60 < (ratio < 1).mean() < 0.80
    assert 0.91 < (ratio < 1.96).mean() < 0.99


def seen_otherwise(rng: np.random.Generator, xy: Array, sigma: float) -> Array:
    """Return an error field of (n, 2) places whose neighbours within an eighth of a side are alike."""
    nodes = rng.normal(0.0, sigma, (9, 9, 2))
    col, row = np.clip(xy / SIDE * 8, 0, 7.999).T
    c, r = col.astype(int), row.astype(int)
    u, v = (col - c)[:, None], (row - r)[:, None]
    upper = nodes[r, c] * (1 - u) + nodes[r, c + 1] * u
    lower = nodes[r + 1, c] * (1 - u) + nodes[r + 1, c + 1] * u
    return np.asarray(upper * (1 - v) + lower * v)


def test_sigma_holds_what_all_images_of_a_kind_see_otherwise() -> None:
    """Images 3 to 5 see other edges than the datum, all the same ones: no cycle shows it."""
    within = []
    for seed in range(12):
        rng = np.random.default_rng(300 + seed)
        truth = make(rng, 6)
        edges, field = [], int(rng.integers(1 << 30))
        for one, other in combinations(range(6), 2):
            edge = truth.edge(rng, one, other, shared=0.002, sigma=0.02)
            if (one < 3) != (other < 3):
                same = seen_otherwise(np.random.default_rng(field), edge.first_xy, 0.2)
                edge = replace(edge, second_xy=edge.second_xy + same)
            edges.append(edge)
        found = adjust(edges, 6)
        off = errors(found, truth, 0)
        for image in (3, 5):
            sigma = np.sqrt(np.diagonal(found.covariance(image, GRID), axis1=1, axis2=2))
            within.append(np.abs(off[image]) / sigma)
            near = np.sqrt(np.trace(found.covariance(image, GRID, 4), axis1=1, axis2=2))
            assert (near < np.sqrt(2) * sigma.max(axis=1)).all()
    ratio = np.array(within)
    assert 0.58 < (ratio < 1).mean() < 0.85
    assert 0.88 < (ratio < 1.96).mean() < 0.99


def test_groups_of_images_each_have_their_own_datum() -> None:
    rng = np.random.default_rng(10)
    truth = make(rng, 6)
    pairs = [(0, 1), (1, 2), (0, 2), (3, 4), (4, 5), (3, 5)]
    edges = [truth.edge(rng, *pair, shared=0.0, sigma=0.01) for pair in pairs]
    found = adjust(edges, 6, datum=1, split=True)
    assert found.group.tolist() == [0, 0, 0, 1, 1, 1]
    assert found.fixed == (1, 3)
    off = errors(found, truth, 1)
    np.testing.assert_allclose(off[0], 0.0, atol=0.02)
    assert np.abs(found.displacement(3, GRID)).max() == 0.0
    assert np.abs(found.covariance(3, GRID)).max() == 0.0


@pytest.mark.parametrize("away_px", [300.0, 3_000.0])
def test_a_slope_of_the_matches_is_no_shift_wherever_a_pair_lies(away_px: float) -> None:
    """The error that a pair's points share is about their middle, not about that of all ground."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(-100.0, 100.0, (150, 2))
    observed = (1.0, -2.0) + (xy - xy.mean(axis=0)) * 0.001 + rng.normal(0.0, 0.1, (150, 2))
    covariance = np.tile(np.eye(2) * 0.01, (150, 1, 1))
    away = np.array([away_px, 0.0])
    edges = [Edge(0, 1, xy, xy + observed, covariance)]
    edges += [Edge(2, 3, xy + away, xy + away + observed, covariance)]
    found = adjust(edges, 4, model="shift", split=True)
    for image, middle in ((1, np.zeros((1, 2))), (3, away[None])):
        np.testing.assert_allclose(found.displacement(image, middle), [[1.0, -2.0]], atol=0.025)


def test_the_relative_sigma_of_neighbours_is_smaller_than_that_of_far_images() -> None:
    rng = np.random.default_rng(7)
    truth = make(rng, 12)
    edges = [
        truth.edge(rng, k, k + step, shared=0.03, sigma=0.08) for step in (1, 2) for k in range(12 - step)
    ]
    found = adjust(edges, 12)
    near, far = (np.trace(found.covariance(1, GRID, other)[0]) for other in (2, 11))
    assert near < far / 2
    np.testing.assert_allclose(found.covariance(4, GRID, 0), found.covariance(4, GRID))


def test_pairs_whose_points_scatter_more_count_for_less() -> None:
    """Images 0 to 3 are of one sensor, 4 to 7 of another: pairs across have a tenfold error."""
    worst = []
    for seed in range(5):
        rng = np.random.default_rng(200 + seed)
        truth = make(rng, 8)
        edges = []
        for one, other in combinations(range(8), 2):
            factor = 10.0 if (one < 4) != (other < 4) else 1.0
            edges.append(truth.edge(rng, one, other, shared=0.01 * factor, sigma=0.03 * factor))
        off = errors(adjust(edges, 8), truth, 0)
        worst.append(np.sqrt((off[1:4] ** 2).sum(axis=-1).mean()))
    assert np.mean(worst) < 0.018


def test_a_pair_that_nothing_checks_is_told() -> None:
    rng = np.random.default_rng(8)
    truth = make(rng, 4)
    edges = [truth.edge(rng, *pair, shared=0.02, sigma=0.05) for pair in ((0, 1), (1, 2), (0, 2), (2, 3))]
    found = adjust(edges, 4, model="shift")
    assert found.edges[3].redundancy < 0.01
    assert min(fit.redundancy for fit in found.edges[:3]) > 0.2


def test_images_without_a_connection_are_named() -> None:
    rng = np.random.default_rng(9)
    truth = make(rng, 4)
    edges = [truth.edge(rng, *pair, shared=0.0, sigma=0.1) for pair in ((0, 1), (2, 3))]
    with pytest.raises(InputError, match=r"2 groups .* images \[2, 3\]"):
        adjust(edges, 4)


@pytest.mark.parametrize("seed", range(5))
def test_pairs_of_one_cause_do_not_outvote_those_of_more_evidence(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = make(rng, 7, slopes=0.1)
    edges = []
    for one, other in combinations(range(7), 2):
        cloud = other == 6 and one >= 2  # four of the six pairs of the thermal band
        off = np.array([4.9, -11.4]) if cloud else 0.0
        edge = truth.edge(rng, one, other, shared=0.05, sigma=0.1, off=off)
        edges.append(replace(edge, evidence=1.5 if cloud else 15.0))
    found = adjust(edges, 7)
    assert np.abs(errors(found, truth, 0)).max() < 0.3
    left_out = {
        (edge.first, edge.second) for edge, fit in zip(edges, found.edges, strict=True) if not fit.in_use
    }
    assert left_out == {(one, 6) for one in range(2, 6)}
    alike = adjust([replace(edge, evidence=10.0) for edge in edges], 7)  # four against two: the many
    assert np.abs(errors(alike, truth, 0)[6]).max() > 10.0


def test_an_image_that_hangs_on_one_whose_pairs_are_replaced_goes_with_it() -> None:
    rng = np.random.default_rng(1)
    truth = make(rng, 8, slopes=0.1)
    edges = []
    for one, other in combinations(range(7), 2):
        wrong = other == 6 and one >= 2
        edge = truth.edge(rng, one, other, shared=0.05, sigma=0.1, off=np.array([4.9, -11.4]) * wrong)
        edges.append(replace(edge, evidence=1.5 if wrong else 15.0))
    edges.append(replace(truth.edge(rng, 6, 7, shared=0.05, sigma=0.1), evidence=1.0))
    adjustment = adjust(edges, 8)
    assert np.abs(errors(adjustment, truth, 0)).max() < 0.3
    assert adjustment.edges[-1].in_use


def test_what_is_known_of_a_product_settles_pairs_that_contradict_each_other() -> None:
    rng = np.random.default_rng(4)
    truth = Truth(np.zeros((3, 3, 2)))
    clouds = {(0, 1): np.array([0.2, -0.6]), (0, 2): np.array([0.1, -0.2]), (1, 2): np.array([0.1, 0.1])}
    edges = [truth.edge(rng, *pair, shared=0.0, sigma=0.3, off=off) for pair, off in clouds.items()]
    sigma = np.array([np.inf, 0.1, 0.1])
    alone, known = adjust(edges, 3), adjust(edges, 3, sigma_known=sigma)
    assert np.abs(errors(alone, truth, 0)).max() > 0.4
    assert np.abs(errors(known, truth, 0)).max() < 0.3


def test_what_is_known_of_a_product_does_not_hide_a_band_that_has_moved() -> None:
    rng = np.random.default_rng(5)
    truth = make(rng, 4, slopes=0.0)
    edges = [truth.edge(rng, *pair, shared=0.0, sigma=0.05) for pair in combinations(range(4), 2)]
    found = adjust(edges, 4, sigma_known=np.array([np.inf, 0.17, 0.17, 0.17]))
    assert np.abs(errors(found, truth, 0)).max() < 0.02
