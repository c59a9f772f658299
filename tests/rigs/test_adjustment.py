"""The adjustment: tie points of known lenses and ground, without images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.rigs.adjustment import Observations, State, adjust, predict
from pcwlad_geo.rigs.rig import Lens, lattice

SHAPE = (480, 640)
SIGMA_PX = 0.1


def truth(captures: int = 4) -> State:
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
    return State(("brown",) * 3, lenses, poses.astype(float), planes)


def observed(state: State, random: np.random.Generator, relief: float = 0.03) -> Observations:
    """Return noisy tie points of every lens in every capture."""
    parts = []
    for capture in range(len(state.planes)):
        places = lattice(SHAPE, 32) + random.uniform(-4, 4, (len(lattice(SHAPE, 32)), 2))
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


def started(true: State, random: np.random.Generator) -> tuple[State, State]:
    """Return a start off the truth, and how far off it may be."""
    sigma = State(
        true.models,
        np.tile([4.0, 2.0, 2.0, 0.01, 0.02, 0.02, 2e-4, 2e-4], (3, 1)),
        np.vstack([np.zeros(6), np.tile([0.01] * 3 + [2e-3] * 3, (2, 1))]),
        np.tile([0.2, 0.05, 0.05], (len(true.planes), 1)),
    )
    vector = true.vector + sigma.vector * random.normal(size=len(true.vector))
    return true.with_vector(vector), sigma


def mapped(state: State, lens: int) -> np.ndarray:
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


def test_sigma_of_the_parameters_holds() -> None:
    ratios = []
    for seed in range(6):
        random, true = np.random.default_rng(100 + seed), truth()
        first, sigma = started(true, random)
        found = adjust(first, first, sigma, observed(true, random), 1.0)
        free = sigma.vector > 0
        deviation = np.sqrt(np.diag(found.covariance)[free])
        ratios.append((found.state.vector - true.vector)[free] / deviation)
    spread = np.concatenate(ratios)
    assert 0.4 < np.mean(np.abs(spread) < 1) < 0.95
    assert np.mean(np.abs(spread) < 2) > 0.85


def test_gross_errors_do_not_count() -> None:
    random, true = np.random.default_rng(4), truth()
    first, sigma = started(true, random)
    seen = observed(true, random)
    wrong = random.random(len(seen)) < 0.1
    shifted = seen.lens_px + np.where(wrong[:, None], random.uniform(3, 9, (len(seen), 2)), 0.0)
    found = adjust(first, first, sigma, replace(seen, lens_px=shifted), 1.0)
    assert found.kept[wrong].mean() < 0.02
    assert found.kept[~wrong].mean() > 0.98
    assert max(np.median(np.abs(mapped(found.state, k) - mapped(true, k))) for k in (1, 2)) < 0.04


def test_captures_that_overlap_tell_the_distortion_that_all_lenses_share() -> None:
    random, true = np.random.default_rng(5), truth()
    pair = np.array([[0.0, 0.0, 0.3, 0.15, 0.05, 0.0]])
    with_pair = replace(true, poses=np.vstack([true.poses, pair]), overlaps=((0, 1),))
    places = np.round(lattice(SHAPE, 24) * 8) / 8
    part = Observations(
        *(np.full(len(places), number) for number in (0, 3, 0)),
        places,
        places,
        np.full(len(places), SIGMA_PX),
    )
    seen = predict(with_pair, part, 0.03 * random.normal(size=len(places)))
    inside = Lens("brown", SHAPE, true.lenses[0]).inside(seen)
    tied = replace(part, lens_px=seen + SIGMA_PX * random.normal(size=seen.shape))
    tied = Observations(
        *(getattr(tied, name)[inside] for name in ("capture", "pose", "lens", "reference_px", "lens_px")),
        tied.sigma_px[inside],
    )
    first, sigma = started(true, random)
    # all lenses bent alike: frames of one moment can hardly tell
    bent = first.lenses.copy()
    bent[:, 3:] = true.lenses[:, 3:] + np.array([0.03, -0.02, 0.01, 0, 0])
    poses = np.vstack([first.poses, pair])
    start = replace(first, lenses=bent, poses=poses, planes=true.planes, overlaps=((0, 1),))
    loose = replace(sigma, poses=np.vstack([sigma.poses, [0.1] * 6]), overlaps=((0, 1),))
    loose = replace(loose, lenses=np.tile([4.0, 2.0, 2.0, 0.05, 0.05, 0.05, 2e-4, 2e-4], (3, 1)))
    found = adjust(start, start, loose, Observations.joined([observed(true, random), tied]), 1.0)
    known = Lens("brown", SHAPE, true.lenses[0])
    before = np.hypot(*known.distortion_px(Lens("brown", SHAPE, bent[0])).T).max()
    after = np.hypot(*known.distortion_px(Lens("brown", SHAPE, found.state.lenses[0])).T).max()
    assert before > 1.0
    assert after < 0.5 * before


def test_lenses_that_are_known_are_held_while_the_ground_is_found() -> None:
    random, true = np.random.default_rng(6), truth(1)
    seen = observed(true, random)
    held = State(true.models, np.zeros((3, 8)), np.zeros((3, 6)), np.array([[0.3, 0.1, 0.1]]))
    off = replace(true, planes=true.planes + np.array([[0.2, 0.02, -0.02]]))
    found = adjust(off, off, held, seen, 1.0, unit=False)
    assert found.state.lenses == pytest.approx(true.lenses)
    assert found.state.planes[0, 0] == pytest.approx(true.planes[0, 0], abs=0.06)
