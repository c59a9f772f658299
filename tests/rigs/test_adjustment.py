"""The adjustment: tie points of known lenses and ground, without images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.rigs.adjustment import Adjusted, Observations, RigState, adjust, predict
from pcwlad_geo.rigs.learning import _precision
from pcwlad_geo.rigs.lens import Lens, lattice

SHAPE = (480, 640)
SIGMA_PX = 0.1


def truth(captures: int = 4) -> RigState:
    lenses = np.array(
        [
            [720.0, 318.0, 243.0, -0.1, 0.14, -0.02, 3e-4, -2e-4],
            [726.0, 322.0, 238.0, -0.104, 0.13, -0.01, -3e-4, 3e-4],
            [715.0, 316.0, 244.0, -0.097, 0.15, -0.03, 2e-4, 4e-4],
        ]
    )
    poses = np.array([[0] * 6, [0.006, -0.004, 0.003, 1e-3, 0, 0], [-0.005, 0.002, -0.002, 0, 1e-3, 0]])
    near = np.linspace(0.5, 1.5, captures)
    planes = np.column_stack([near, 0.02 * np.sin(np.arange(captures)), 0.02 * np.cos(np.arange(captures))])
    return RigState(("brown",) * 3, lenses, poses.astype(float), planes)


def observed(
    state: RigState, random: np.random.Generator, relief: float = 0.03, spacing_px: int = 32
) -> Observations:
    """Return noisy tie points of every lens in every capture."""
    parts = []
    for capture in range(len(state.planes)):
        places = lattice(SHAPE, spacing_px)
        places = places + random.uniform(-4, 4, places.shape)
        places = np.round(places * 8) / 8
        bumps = relief * random.normal(size=len(places))
        for lens in range(1, len(state.models)):
            full = np.full(len(places), lens)
            part = Observations(
                np.full(len(places), capture), full, full, places, places, np.full(len(places), SIGMA_PX)
            )
            seen = predict(state, part, bumps) + SIGMA_PX * random.normal(size=places.shape)
            parts.append(replace(part, lens_px=seen))
    return Observations.joined(parts)


def started(true: RigState, random: np.random.Generator) -> tuple[RigState, RigState]:
    """Return a start off the truth, and how far off it may be."""
    sigma = RigState(
        true.models,
        np.tile([4.0, 2.0, 2.0, 0.01, 0.02, 0.02, 2e-4, 2e-4], (3, 1)),
        np.vstack([np.zeros(6), np.tile([0.01] * 3 + [2e-3] * 3, (2, 1))]),
        np.tile([0.2, 0.05, 0.05], (len(true.planes), 1)),
    )
    vector = true.vector + sigma.vector * random.normal(size=len(true.vector))
    return true.with_vector(vector), sigma


def mapped(state: RigState, lens: int) -> np.ndarray:
    places = lattice(SHAPE, 40)
    full = np.full(len(places), lens)
    seen = Observations(np.zeros(len(places), int), full, full, places, places, np.ones(len(places)))
    level = replace(state, planes=np.array([[1.0, 0.0, 0.0]]))
    return predict(level, seen, np.zeros(len(places)))


def test_lenses_are_mapped_onto_each_other_to_a_fraction_of_the_noise() -> None:
    random, true = np.random.default_rng(3), truth()
    first, sigma = started(true, random)
    before = max(np.abs(mapped(first, lens) - mapped(true, lens)).max() for lens in (1, 2))
    found = adjust(first, first, sigma, observed(true, random), 1.0)
    errors = [np.abs(mapped(found.state, lens) - mapped(true, lens)) for lens in (1, 2)]
    assert before > 3.0
    assert max(np.median(each) for each in errors) < 0.04
    assert max(each.max() for each in errors) < 0.2  # in a corner, beyond the last points


@pytest.mark.slow
def test_sigma_of_the_parameters_holds() -> None:
    ratios = []
    for seed in range(6):
        random, true = np.random.default_rng(100 + seed), truth()
        first, sigma = started(true, random)
        found = adjust(first, first, sigma, observed(true, random, spacing_px=56), 1.0)
        free = sigma.vector > 0
        deviation = np.sqrt(np.diag(found.covariance)[free])
        ratios.append((found.state.vector - true.vector)[free] / deviation)
    spread = np.concatenate(ratios)
    assert 0.4 < np.mean(np.abs(spread) < 1) < 0.95
    assert np.mean(np.abs(spread) < 2) > 0.85


@pytest.mark.parametrize("wild", [np.nan, np.inf, 1e10, 1e308])
@pytest.mark.parametrize("field", ["reference_px", "lens_px", "sigma_px"])
def test_tie_points_beyond_all_frames_are_refused(field: str, wild: float) -> None:
    true = truth()
    seen = observed(true, np.random.default_rng(7), spacing_px=56)
    values = getattr(seen, field).copy()
    values[3] = wild
    first, sigma = started(true, np.random.default_rng(8))
    with pytest.raises(InputError, match="needs tie points of all lenses"):
        adjust(first, first, sigma, replace(seen, **{field: values}), 1.0)


def test_no_tie_points_are_refused() -> None:
    true = truth()
    first, sigma = started(true, np.random.default_rng(8))
    seen = observed(true, np.random.default_rng(7))
    with pytest.raises(InputError, match="needs tie points of all lenses"):
        adjust(first, first, sigma, seen.selected(np.zeros(len(seen), bool)), 1.0)


@pytest.mark.parametrize("places", ["on a line", "in one place", "sigma 0"])
def test_what_singular_tie_points_leave_open_is_as_uncertain_as_expected(places: str) -> None:
    true, random = truth(), np.random.default_rng(9)
    seen = observed(true, random, spacing_px=56)
    line = seen.reference_px.mean(axis=1, keepdims=True) * [0.8, 0.6]
    at = {"on a line": line, "in one place": np.full_like(line, 100.0)}.get(places, seen.reference_px)
    part = replace(seen, reference_px=at)
    noisy = predict(true, part, np.zeros(len(seen))) + SIGMA_PX * random.normal(size=at.shape)
    sigma_px = np.zeros(len(seen)) if places == "sigma 0" else seen.sigma_px
    first, sigma = started(true, random)
    found = adjust(first, first, sigma, replace(part, lens_px=noisy, sigma_px=sigma_px), 1.0)
    free = sigma.vector > 0
    off = (found.state.vector - true.vector)[free] / np.sqrt(np.diag(found.covariance)[free])
    assert np.abs(off).max() < 5


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_precision_is_that_over_the_frame_of_the_reference_for_a_lens_of_few_px_too(share: float) -> None:
    reference = Lens("brown", SHAPE, np.array([720.0, 320.0, 240.0, 0, 0, 0, 0, 0]))
    shape = round(SHAPE[0] * share), round(SHAPE[1] * share)
    lens = Lens("brown", shape, reference.vector * share)
    vectors = np.stack([reference.vector, lens.vector])
    state = RigState(("brown",) * 2, vectors, np.zeros((2, 6)), np.array([[1.0, 0, 0]]))
    covariance = np.zeros((31, 31))
    covariance[24, 24] = 1e-6  # of the rotation of the lens about its axis
    found = Adjusted(state, covariance, np.empty((0, 2)), np.empty(0, bool))
    median_px, largest_px = _precision(found, 1, reference, lens)[0]
    radii_px = share * np.hypot(*(lattice(SHAPE, 80) - [320.0, 240.0]).T)
    assert median_px / largest_px == pytest.approx(np.median(radii_px) / radii_px.max(), rel=0.01)
    assert largest_px == pytest.approx(1e-3 * radii_px.max() / np.sqrt(2), rel=0.2)


def test_gross_errors_do_not_count() -> None:
    random, true = np.random.default_rng(4), truth()
    first, sigma = started(true, random)
    seen = observed(true, random)
    wrong = random.random(len(seen)) < 0.1
    shifted = seen.lens_px + np.where(wrong[:, None], random.uniform(3, 9, (len(seen), 2)), 0.0)
    found = adjust(first, first, sigma, replace(seen, lens_px=shifted), 1.0)
    assert found.inliers[wrong].mean() < 0.02
    assert found.inliers[~wrong].mean() > 0.98
    assert max(np.median(np.abs(mapped(found.state, k) - mapped(true, k))) for k in (1, 2)) < 0.04


def test_lenses_that_are_known_are_held_while_the_ground_is_found() -> None:
    random, true = np.random.default_rng(6), truth(1)
    seen = observed(true, random)
    held = RigState(true.models, np.zeros((3, 8)), np.zeros((3, 6)), np.array([[0.3, 0.1, 0.1]]))
    off = replace(true, planes=true.planes + np.array([[0.2, 0.02, -0.02]]))
    found = adjust(off, off, held, seen, 1.0, unit_mean_depth=False)
    assert found.state.lenses == pytest.approx(true.lenses)
    assert found.state.planes[0, 0] == pytest.approx(true.planes[0, 0], abs=0.06)


FLOWN = np.array(
    [
        [0.02, -0.03, 0.3, 0.2, 0.05, 0.05],
        [-0.03, 0.02, -0.4, -0.04, 0.22, -0.06],
        [0.01, 0.01, 0.2, 0.15, -0.2, 0.03],
    ]
)
"""Poses between three captures that overlap."""


def flown_over(relief: float, random: np.random.Generator) -> tuple[RigState, Observations]:
    """Return three captures over ground of a relief, and their points, those between captures too."""
    true = truth(len(FLOWN))
    true = replace(true, poses=np.vstack([true.poses, FLOWN]), overlaps=((0, 1), (1, 2), (0, 2)))
    parts = [observed(true, random, relief)]
    for pose, (one, _) in enumerate(true.overlaps, len(true.models)):
        places = lattice(SHAPE, 20) + random.uniform(-4, 4, (len(lattice(SHAPE, 20)), 2))
        places = np.round(places * 8) / 8
        numbers = (np.full(len(places), number) for number in (one, pose, 0))
        part = Observations(*numbers, places, places, np.full(len(places), 0.03))
        seen = predict(true, part, relief * random.normal(size=len(places)))
        inside = Lens("brown", SHAPE, true.lenses[0]).inside(seen, 12.0)
        noisy = seen + 0.03 * random.normal(size=seen.shape)
        names = ("capture", "pose", "lens", "reference_px")
        own = (getattr(part, name)[inside] for name in names)
        parts.append(Observations(*own, noisy[inside], part.sigma_px[inside]))
    return true, Observations.joined(parts)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
@pytest.mark.parametrize(("relief", "within_px"), [(0.03, 0.3), (0.1, 0.12)])
def test_captures_that_overlap_tell_the_distortion_that_all_lenses_share(
    relief: float, within_px: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    true, seen = flown_over(relief, random)
    first, sigma = started(replace(true, poses=true.poses[: len(true.models)], overlaps=()), random)
    # all lenses bent alike: frames of one moment can hardly tell
    bent = first.lenses.copy()
    bent[:, 3:] = true.lenses[:, 3:] + np.array([0.03, -0.02, 0.01, 0, 0])
    # the directions of the parallax, across which points tell of it, are known about
    poses = np.vstack([first.poses, 1.02 * FLOWN])
    start = replace(first, lenses=bent, poses=poses, overlaps=true.overlaps)
    weak = np.tile([4.0, 2.0, 2.0, 0.05, 0.05, 0.05, 2e-4, 2e-4], (len(bent), 1))
    sigma = replace(sigma, lenses=weak, poses=np.vstack([sigma.poses, np.full_like(FLOWN, 0.1)]))
    found = adjust(start, start, sigma, seen, 1.0, sigma_by_lens=True)
    assert largest_px(true, start) > 1.0
    assert largest_px(true, found.state) < within_px
    free = sigma.vector > 0
    off = (found.state.vector - true.vector)[free] / np.sqrt(np.diag(found.covariance)[free])
    assert np.abs(off).max() < 4


def largest_px(true: RigState, found: RigState) -> float:
    """Return the largest error of the distortion of any lens, px."""
    pairs = [
        [Lens("brown", SHAPE, vector) for vector in vectors]
        for vectors in zip(true.lenses, found.lenses, strict=True)
    ]
    return max(float(np.hypot(*one.distortion_px(other).T).max()) for one, other in pairs)
