"""Equations that leave something open: the one place where all are solved, and control that is singular."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array

from pcwlad_geo.correction.agreement import agreement
from pcwlad_geo.correction.dense import invert
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import (
    BandedFactor,
    NormalEquations,
    banded,
    check_observations,
    check_rank,
    factorised,
    inverse,
    least_squares,
    pseudo_inverse,
    solve,
    triangular,
    undetermined,
)
from pcwlad_geo.multi.stack.adjustment import adjust
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.homographies import homographies
from pcwlad_geo.multi.stack.network import UndeterminedImageError, named
from pcwlad_geo.rigs.lens import homography_residual

Array = NDArray[np.float64]

REGULAR = np.array([[2.0, 1.0], [1.0, 3.0]])
SINGULAR = np.array([[1.0, 2.0], [2.0, 4.0]])
NEEDS = "the model needs a second point"


def test_regular_equations_are_solved_to_the_bits_of_numpy() -> None:
    right = np.array([1.0, 2.0])
    assert (solve(REGULAR, right, NEEDS, least=1e-6) == np.linalg.solve(REGULAR, right)).all()
    assert (inverse(REGULAR) == np.linalg.inv(REGULAR)).all()
    assert (triangular(REGULAR, NEEDS) == np.linalg.cholesky(REGULAR)).all()
    assert (pseudo_inverse(SINGULAR) == np.linalg.pinv(SINGULAR)).all()
    assert (least_squares(SINGULAR, right) == np.linalg.lstsq(SINGULAR, right, rcond=None)[0]).all()
    assert factorised(csc_array(REGULAR), NEEDS).solve(right) == pytest.approx([0.2, 0.6])


@pytest.mark.parametrize(
    "solved",
    [
        lambda: solve(SINGULAR, np.ones(2), NEEDS),
        lambda: solve(SINGULAR + np.diag([0.0, 1e-9]), np.ones(2), NEEDS, least=1e-6),
        lambda: solve(np.stack([REGULAR, SINGULAR]), np.ones((2, 2, 1)), NEEDS),
        lambda: inverse(SINGULAR, NEEDS),
        lambda: inverse(REGULAR * 1e-310, NEEDS),
        lambda: triangular(-REGULAR, NEEDS),
        lambda: factorised(csc_array(SINGULAR), NEEDS),
        lambda: BandedFactor(banded(csc_array(-REGULAR), np.arange(2)), np.arange(2), NEEDS),
        lambda: check_rank(np.ones((5, 2)), 1e-6, NEEDS),
        lambda: check_rank(np.ones((1, 2)), 1e-6, NEEDS),
        lambda: check_rank(np.zeros((3, 2)), 1e-6, NEEDS),
    ],
)
def test_what_is_open_names_the_observation_that_is_missing(solved: Callable[[], object]) -> None:
    with pytest.raises(InputError, match=NEEDS):
        solved()


@pytest.mark.parametrize("width", [1, 3, 12])
def test_a_banded_factor_solves_as_a_dense_one_whatever_the_order(width: int) -> None:
    random = np.random.default_rng(width)
    root = np.tril(np.triu(random.normal(size=(12, 12)), 1 - width)) + 4 * np.eye(12)
    order = random.permutation(12)
    matrix = (root @ root.T)[np.ix_(order, order)]
    factor = BandedFactor(banded(csc_array(matrix), order), order, NEEDS)
    for right in (random.normal(size=12), random.normal(size=(12, 3))):
        np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, right), rtol=1e-10)


def test_the_rank_that_was_found_is_told() -> None:
    with pytest.raises(InputError, match="determines 1 of 2 unknowns"):
        check_rank(SINGULAR, 1e-6, NEEDS)


def test_numbers_beyond_measure_are_an_error_and_what_is_unknown_is_not() -> None:
    with pytest.raises(InputError, match="ordinary size"):
        least_squares(np.diag([1.0, np.inf]), np.ones(2))
    assert np.isnan(solve(REGULAR, np.array([1.0, np.nan]))).all()
    check_observations("points", np.full(3, -1e10))
    for value in (np.nan, np.inf, -2e10):
        with pytest.raises(InputError, match="points have numbers"):
            check_observations("points", np.zeros(2), np.array([0.0, value]))


@pytest.mark.parametrize("open_one", range(4))
def test_the_unknown_that_nothing_determines_is_found(open_one: int) -> None:
    rows = np.random.default_rng(open_one).normal(size=(9, 4))
    rows[:, open_one] *= 1e-9
    normal = csc_array(rows.T @ rows)
    assert undetermined(normal) is None  # only smaller: scaled, it is determined
    rows[:, open_one] = 0.0
    assert undetermined(csc_array(rows.T @ rows)) == open_one


def test_an_image_is_named_through_all_that_number_it_anew() -> None:
    match = r"points of image c\.tif do not determine"
    with pytest.raises(InputError, match=match), named(["a.tif", "b.tif", "c.tif"]), named([0, 2]):
        raise UndeterminedImageError(1)


def controls() -> dict[str, tuple[Array, Array, Array]]:
    """Tie points of which each kind leaves something open, or is beyond measure."""
    rng, n = np.random.default_rng(0), 40
    t = np.linspace(0.0, 1.0, n)[:, None]
    spread = rng.uniform(0.0, 1000.0, (n, 2))
    places = {
        "on a line": t * [800.0, 600.0],
        "nearly on a line": t * [800.0, 600.0] + rng.normal(0.0, 1e-6, (n, 2)),
        "in one place": np.full((n, 2), 77.7),
        "in two places": np.repeat([[10.0, 10.0], [500.0, 20.0]], n // 2, axis=0),
        "one far": np.vstack([spread[1:], [[1e308, 1e308]]]),
        "all far": spread * 1e305,
        "tiny": spread * 1e-200,
    }
    unit = np.tile(np.eye(2), (n, 1, 1))
    found = {
        name: (xy, xy + 0.5 + rng.normal(0.0, 0.05, xy.shape), 0.01 * unit) for name, xy in places.items()
    }
    there = spread + rng.normal(0.0, 0.1, spread.shape)
    for name, size in (
        ("sigma 0", 0.0),
        ("sigma 1e-150", 1e-300),
        ("sigma 1e-15", 1e-30),
        ("negative", -1.0),
    ):
        found[name] = (spread, there, size * unit)
    found["sigma of one axis"] = (spread, there, unit * [[0.01, 0.0], [0.0, 0.0]])
    found["seen in one place"] = (spread, np.full((n, 2), 5.0), 0.01 * unit)
    found["scattered far"] = (spread, spread + rng.normal(0.0, 1e9, (n, 2)), 0.01 * unit)
    return found


CONTROLS = controls()


IMPOSSIBLE = ("one far", "all far")


def said(function: Callable[[], object]) -> str:
    """Return the message of the error that a function raises, if it raises one."""
    try:
        function()
    except InputError as error:
        return str(error)
    return ""


def names_what_is_missing(message: str) -> bool:
    """Return whether a message names points, or says what a transformation or a trend needs."""
    return any(word in message for word in ("points", "scale above 0"))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("model", MODELS)
def test_a_fit_to_singular_control_is_finite_or_an_error(model: str, control: str) -> None:
    at = np.array([[500.0, 500.0]])

    def fitted() -> None:
        found = MODELS[model].fit(*CONTROLS[control], footprint_px=51.0)
        assert np.isfinite(found.correction.forward(at)).all()
        assert found.correction.inverse(at).shape == (1, 2)

    message = said(fitted)
    assert names_what_is_missing(message) or (not message and control not in IMPOSSIBLE)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("model", ["shift", "affine", "polynomial2", "homography"])
def test_a_stack_of_singular_control_is_finite_or_an_error(model: str, control: str) -> None:
    edges = [Edge(0, 1, *CONTROLS[control]), Edge(1, 2, *CONTROLS[control])]
    at = np.array([[500.0, 500.0]])

    def adjusted() -> None:
        found: Any = homographies(edges, 3) if model == "homography" else adjust(edges, 3, model=model)
        for image in range(3):
            assert np.isfinite(found.displacement(image, at)).all()
            assert np.isfinite(found.covariance(image, at)).all()

    message = said(adjusted)
    impossible = (*IMPOSSIBLE, "variance 0", "sigma of one axis")
    assert names_what_is_missing(message) or (not message and control not in impossible)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("function", [agreement, homography_residual])
def test_what_is_beside_the_fits_takes_singular_control(
    function: Callable[..., object], control: str
) -> None:
    message = said(lambda: function(*CONTROLS[control][:2]))
    assert not message or names_what_is_missing(message)


def test_a_way_back_that_runs_away_is_nowhere() -> None:
    found = invert(lambda xy: 0 * xy, lambda xy: np.zeros((len(xy), 2, 2)), np.ones((1, 2)))
    assert np.isnan(found).all()


def test_normal_equations_are_those_of_all_observations_and_what_is_known_before() -> None:
    rng = np.random.default_rng(0)
    design, values = rng.normal(size=(30, 5)), rng.normal(size=30)
    weight, sigma, known = rng.uniform(0.5, 2.0, 30), 0.7, rng.normal(size=2)
    equations = NormalEquations(5)
    equations.observe_rows(csr_array(design[:10]), weight[:10], values[:10])
    for pair in range(10, 30, 2):  # two observations of the first three unknowns, correlated
        design[pair : pair + 2, 3:] = 0.0
        block = np.diag(weight[pair : pair + 2])
        of_some = design[None, pair : pair + 2, :3]
        equations.observe(np.arange(3), of_some, block[None], values[None, pair : pair + 2])
    equations.expect(np.array([3, 4]), sigma, known)
    prior = np.diag([0.0, 0.0, 0.0, sigma**-2, sigma**-2])
    normal = design.T @ (weight[:, None] * design) + prior
    right = design.T @ (weight * values) + prior @ np.concatenate([np.zeros(3), known])
    np.testing.assert_allclose(equations.matrix.toarray(), normal, atol=1e-12)
    np.testing.assert_allclose(equations.solve(NEEDS), np.linalg.solve(normal, right))
    np.testing.assert_allclose(equations.covariance(NEEDS), np.linalg.inv(normal))


def test_eliminated_unknowns_leave_the_solution_of_the_others() -> None:
    rng = np.random.default_rng(1)
    own, of_point = rng.normal(size=(12, 2)), np.repeat(np.eye(6), 2, axis=0) * rng.normal(size=(12, 1))
    equations = NormalEquations(8)
    equations.observe_rows(csr_array(np.hstack([own, of_point])), np.ones(12), rng.normal(size=12))
    equations.expect(np.arange(2, 8), 0.5)
    np.testing.assert_allclose(np.linalg.solve(*equations.reduced(2)), equations.solve(NEEDS)[:2])
