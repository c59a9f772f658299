"""Models of the images of a stack: which is chosen, splines, and points that several pairs share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.polynomials import PolynomialBasis
from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.stack.adjustment import adjust, critical, extend
from pcwlad_geo.multi.stack.bases import SplineBasis, basis_over, penalty_of, terms_of
from pcwlad_geo.multi.stack.edges import Edge, linked
from pcwlad_geo.multi.stack.model_choice import choose_basis
from pcwlad_geo.multi.stack.pair_choice import Candidate, asked_by_sigma
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT
from tests.multi.test_adjustment import GRID, SIDE, make

Array = NDArray[np.float64]
Field = Callable[[int, Array], Array]


def edge(rng: np.random.Generator, one: int, other: int, field: Field, sigma: float = 0.03) -> Edge:
    """A pair of images that place the ground beside itself by a field of image and place."""
    ground = rng.uniform(0.0, SIDE, (300, 2))
    noise = rng.normal(0.0, sigma, ground.shape) + rng.normal(0.0, sigma / 5, 2)
    covariance = np.tile(np.eye(2) * sigma**2, (len(ground), 1, 1))
    return Edge(one, other, ground + field(one, ground), ground + field(other, ground) + noise, covariance)


def shift(image: int, xy: Array) -> Array:
    return np.tile([0.7 * image, -0.4 * image], (len(xy), 1))


def affine(image: int, xy: Array) -> Array:
    return shift(image, xy) + image * np.column_stack([xy[:, 1], -xy[:, 0]]) * 3e-4


def cubic(image: int, xy: Array) -> Array:
    u = (xy - SIDE / 2) / SIDE
    return shift(image, xy) + 2.0 * image * np.column_stack([u[:, 0] ** 3, u[:, 0] * u[:, 1] ** 2])


def wavy(image: int, xy: Array) -> Array:
    waves = np.column_stack([np.sin(xy[:, 0] / 110.0 + image), np.cos(xy[:, 1] / 110.0 - image)])
    return shift(image, xy) + 0.4 * (image > 0) * waves


@pytest.mark.parametrize(("field", "terms"), [(shift, 1), (affine, 3), (cubic, 10), (wavy, None)])
def test_the_simplest_model_that_fits_is_chosen(field: Field, terms: int | None) -> None:
    rng = np.random.default_rng(0)
    edges = [edge(rng, *pair, field) for pair in combinations(range(4), 2)]
    basis = choose_basis(edges, 4, "auto")
    if terms is None:
        assert isinstance(basis, SplineBasis)
    else:
        assert terms_of(basis) == terms
    found = adjust(edges, 4, basis=basis)
    truth = field(3, GRID) - field(0, GRID)
    off = np.sqrt(((found.displacement(3, GRID) - truth) ** 2).sum(axis=1).mean())
    assert off < (0.03 if terms else 0.12)
    assert np.isfinite(found.covariance(3, GRID)).all()


def test_what_is_asked_for_is_given() -> None:
    rng = np.random.default_rng(1)
    edges = [edge(rng, *pair, shift) for pair in combinations(range(3), 2)]
    assert terms_of(choose_basis(edges, 3, "affine")) == 3
    assert isinstance(choose_basis(edges, 3, "tps"), SplineBasis)
    chosen = choose_basis(edges, 3, "polynomial")
    assert isinstance(chosen, PolynomialBasis)
    assert chosen.order == 2


def test_of_many_images_those_near_the_datum_decide() -> None:
    few_images = replace(ADJUSTMENT, max_images_to_choose=3)
    rng = np.random.default_rng(2)
    pairs = [(k, k + step) for step in (1, 2) for k in range(6 - step)]
    edges = [edge(rng, *pair, affine) for pair in pairs]
    assert terms_of(choose_basis(edges, 6, "auto", datum=3, parameters=few_images)) == 3


def test_a_few_control_points_do_not_choose_a_cubic() -> None:
    rng = np.random.default_rng(3)
    control = edge(rng, 2, 1, affine)
    few = Edge(2, 1, control.first_xy[:5], control.second_xy[:5], control.covariance[:5])
    edges = [edge(rng, 0, 1, affine), few]
    assert terms_of(choose_basis(edges, 3, "auto", datum=2)) == 3
    on_a_line = replace(few, first_xy=np.column_stack([np.arange(5.0), np.arange(5.0)]))
    with pytest.raises(InputError, match="do not determine"):
        adjust([edge(rng, 0, 1, affine), on_a_line], 3, model="polynomial3", datum=2)


def test_a_spline_bends_as_little_as_the_points_ask() -> None:
    places = [np.array([[0.0, 0.0], [900.0, 400.0]])]
    basis = basis_over(places, "tps", 1.0)
    assert isinstance(basis, SplineBasis)
    assert basis.grid.cells == (4, 2)
    plane = 2.0 + basis.grid.nodes_px() @ [0.01, -0.02]
    at = np.random.default_rng(4).uniform((0, 0), (900, 400), (50, 2))
    np.testing.assert_allclose(basis.values(at) @ plane, 2.0 + at @ [0.01, -0.02], atol=1e-9)
    assert abs(plane @ penalty_of(basis) @ plane) < 1e-9
    bent = plane + (basis.grid.nodes_px()[:, 0] / 900) ** 2
    assert bent @ penalty_of(basis) @ bent > 0.01


def test_points_of_one_feature_are_one_track() -> None:
    place = np.array([[100.0, 100.0], [500.0, 300.0], [800.0, 900.0]])
    covariance = np.tile(np.eye(2), (3, 1, 1))
    edges = [
        Edge(0, 1, place, place + 1.0, covariance),
        Edge(0, 2, place + np.array([[0.3, 0.0], [5.0, 0.0], [0.0, 0.0]]), place + 7.0, covariance),
        Edge(1, 2, place + np.array([[1.0, 41.0], [1.0, 41.0], [1.0, 1.1]]), place + 7.0, covariance),
    ]
    images = [each.images for each in linked(edges, ADJUSTMENT.feature_px)]
    np.testing.assert_array_equal(images[0], [3, 2, 3])
    np.testing.assert_array_equal(images[1], [3, 3, 3])  # the second by what images 1 and 2 see
    np.testing.assert_array_equal(images[2], [3, 3, 3])


def test_pairs_of_the_same_points_tell_no_more_than_their_images() -> None:
    """Every image errs by itself at each place: however many pairs there are, sigma is that of its points."""
    rng = np.random.default_rng(5)
    ground = rng.uniform(0.0, SIDE, (400, 2))
    sigma, images = 0.05, 6
    seen = [ground + rng.normal(0.0, sigma, ground.shape) for _ in range(images)]
    covariance = np.tile(2 * sigma**2 * np.eye(2), (len(ground), 1, 1))
    edges = [Edge(a, b, seen[a], seen[b], covariance) for a, b in combinations(range(images), 2)]
    ratio = []
    for kept in (edges, edges[: images - 1]):  # all pairs; those of the first image alone
        told = adjust(kept, images, model="shift").covariance(3, GRID[:1])[0]
        ratio.append(np.sqrt(np.trace(told) / 2) / (np.sqrt(2) * sigma / np.sqrt(len(ground))))
    assert 0.8 < ratio[0] < 2.0
    assert 0.8 < ratio[1] < 3.0


def test_images_are_added_to_splines_and_to_control_points() -> None:
    rng = np.random.default_rng(6)
    edges = [edge(rng, *pair, wavy) for pair in combinations(range(3), 2)]
    ground = rng.uniform(0.0, SIDE, (60, 2))
    control = Edge(3, 1, ground, ground + wavy(1, ground), np.tile(0.02**2 * np.eye(2), (60, 1, 1)))
    before = adjust([*edges, control], 4, model="tps", datum=3)
    more = [edge(rng, one, 3, wavy) for one in range(3)]
    found = extend(before, [*edges, control], more, 5, ground=True)
    assert (found.datum, found.fixed, len(found.edges)) == (4, (4,), 7)
    for image in range(3):
        np.testing.assert_array_equal(found.coefficients[image], before.coefficients[image])
    off = found.displacement(3, GRID) - wavy(3, GRID)
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.15
    assert np.trace(found.covariance(3, GRID)[14]) > np.trace(before.covariance(1, GRID)[14])


def test_the_limit_of_a_pair_grows_with_their_number() -> None:
    assert 4.0 < critical(3) < critical(30) < critical(300) < 12.0


@pytest.mark.slow
def test_of_right_pairs_hardly_any_is_left_out() -> None:
    """A pair's error is known to a quarter only: of 40 stacks, all right, at most two lose a pair."""
    lost = 0
    for seed in range(40):
        rng = np.random.default_rng(400 + seed)
        truth = make(rng, 10)
        edges = [
            truth.edge(rng, *pair, shared=0.02 * np.exp(rng.normal(0, 0.25)), sigma=0.05)
            for pair in combinations(range(10), 2)
            if sum(pair) % 2
        ]
        lost += not all(fit.in_use for fit in adjust(edges, 10).edges)
    assert lost <= 2


def test_further_pairs_go_to_kinds_with_few_pairs() -> None:
    found = [Candidate(pair, 0.1 * number) for number, pair in enumerate([(0, 4), (1, 4), (2, 4), (3, 4)])]
    sigma = np.array([0.0, 0.01, 0.01, 0.01, 0.1])
    assert asked_by_sigma(found, [(0, 4)], sigma, ["one"] * 5) == [(1, 4), (2, 4)]
    kinds = ["red", "red", "red", "coarse", "thermal"]
    assert asked_by_sigma(found, [(0, 4)], sigma, kinds) == [(3, 4), (1, 4)]


def test_turns_that_leave_nothing_out_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = np.full(9, np.nan)
    errors = iter([nothing, np.array([1.0, 2.0, *nothing[2:]])])
    monkeypatch.setattr("pcwlad_geo.multi.stack.model_choice._errors", lambda *_: next(errors, nothing))
    pair = edge(np.random.default_rng(5), 0, 1, affine)
    assert terms_of(choose_basis([pair], 2, "auto", datum=0)) == 1
