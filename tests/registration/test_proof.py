"""The proof of a pair: its tools against exact scenes, what it tells against errors that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.correction.proof_result import Move, Proof, TrialEntry
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.events import JobLog, ignore
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.matching.noise import noise_level
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Window
from pcwlad_geo.registration.decision import Decision
from pcwlad_geo.registration.matching import match_pair
from pcwlad_geo.registration.opening import prepare_pair
from pcwlad_geo.registration.proof.classes import sigma_entry
from pcwlad_geo.registration.proof.correction_error import _full_to_sample_ratio, _leave_part_out_px
from pcwlad_geo.registration.proof.errors import PointErrors, locking, scatter
from pcwlad_geo.registration.proof.parameters import ProofParameters
from pcwlad_geo.registration.proof.resampling import Resampler, moves_of
from pcwlad_geo.registration.proof.sensitivity import DIFFICULTIES, _clouded, _limit, sensitivity
from pcwlad_geo.registration.proof.sites import _spread
from pcwlad_geo.registration.result import Matches, Registration
from pcwlad_geo.registration.run import prove_pair, register_pair
from pcwlad_geo.tiepoints.table import TiePointTable
from tests.scenes import make_grid, render, write

GRID = make_grid((240, 240))
SETTINGS = Settings(prealign="none", search_radius=6, window=81, model="shift", jobs=1)
SHIFT_PX = np.array([0.4, -0.3])


@pytest.mark.parametrize("sigma", [4.0, 12.0])
def test_the_level_of_noise_is_measured_in_a_scene(sigma: float) -> None:
    images = [render(GRID, band, noise=sigma) for band in ("red", "thermal")]
    assert noise_level(*images, np.ones(GRID.shape, bool)) == pytest.approx(sigma, rel=0.1)


def test_texture_that_both_images_show_is_no_noise() -> None:
    random = np.random.default_rng(3)
    texture = random.normal(0, 3, GRID.shape)
    images = [
        sign * (render(GRID, noise=0.0) + texture) + random.normal(0, 2, GRID.shape) for sign in (1, -1)
    ]
    valid = np.ones(GRID.shape, bool)
    assert noise_level(images[0], images[1], valid) == pytest.approx(2.0, rel=0.2)
    assert noise_level(images[0], random.normal(0, 1, GRID.shape), valid) > 3


def test_too_few_pixels_tell_of_no_noise() -> None:
    valid = np.zeros((240, 240), bool)
    valid[:20, :20] = True
    assert noise_level(render(GRID), render(GRID), valid) == 0.0


@pytest.mark.parametrize(
    "move",
    [
        Move("shift", (0.31, -0.44)),
        Move("turn", (0.2, 0.1), rotation_deg=0.5, scale=1.004),
        Move("field", (-0.2, 0.3), amplitude_px=0.5, wavelength_px=200.0),
    ],
    ids=lambda move: str(move.kind),
)
def test_a_move_shows_the_scene_where_it_says(move: Move) -> None:
    resampler = Resampler(render(GRID, noise=0.0), np.ones(GRID.shape, bool))
    centre = np.array([120.0, 120.0])
    moved, valid = resampler.moved(move, centre)
    rows, cols = GRID.shape
    at = np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5), axis=-1).reshape(-1, 2)
    displaced = at - move.source(at, centre)

    def local(predicted: np.ndarray) -> np.ndarray:
        # the displacement at the predicted pixel, as `render` takes it: some steps of its inverse
        observed = predicted.copy()
        for _ in range(8):
            observed = predicted + (observed - move.source(observed, centre))
        return np.asarray(observed - predicted)

    exact = render(GRID, noise=0.0, local=local)
    slope = np.stack(np.gradient(exact)[::-1], axis=-1)
    assert np.abs(displaced).max() > 0.3
    for corner in ((30, 30), (30, 120), (120, 30), (120, 120)):
        part = tuple(slice(start, start + 90) for start in corner)
        assert valid[part].all()
        # the scene has detail that its sampling aliases, which moves otherwise, and nowhere on the whole
        off_px, *_ = np.linalg.lstsq(slope[part].reshape(-1, 2), (moved - exact)[part].ravel())
        assert np.abs(off_px).max() < 0.005


def test_what_is_not_valid_stays_so_after_a_move() -> None:
    values, valid = render(GRID), np.ones(GRID.shape, bool)
    valid[100:120, 100:120] = False
    values[~valid] = np.nan
    moved, known = Resampler(values, valid).moved(Move("shift", (0.5, 0.5)), np.zeros(2))
    assert np.isfinite(moved).all()
    assert not known[98:122, 98:122].any()
    assert known[105, 60:90].all()


@pytest.mark.parametrize("effort", ["quick", "full"])
def test_shifts_take_every_fraction_of_a_pixel_once(effort: str) -> None:
    shifts = [move.shift_px for move in moves_of(effort, 81) if move.kind == "shift"]
    for axis in range(2):
        steps = np.diff(np.sort([shift[axis] for shift in shifts]))
        assert steps == pytest.approx(1 / len(shifts))


def pair(folder: Path, noise: float, seed: int, band: str = "red", **how: object) -> tuple[Path, Path]:
    """Write two images of one scene, the target inverted, with noise of their own."""
    random = np.random.default_rng([seed, 5])
    images = render(GRID, noise=0.0), 255 - render(GRID, band, noise=0.0, displacement_px=SHIFT_PX, **how)
    paths = []
    for number, image in enumerate(images):
        noisy = image + noise * random.standard_normal(image.shape)
        paths.append(write(folder / f"{number}_{seed}.tif", noisy, GRID))
    return paths[0], paths[1]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Proof:
    return prove_pair(*pair(tmp_path_factory.mktemp("proof"), 6.0, 0), SETTINGS, "quick")[1]


@pytest.mark.slow
def test_the_error_that_is_told_is_the_true_one(told: Proof, tmp_path: Path) -> None:
    errors = []
    for seed in range(6):
        found = register_pair(*pair(tmp_path, 6.0, seed), SETTINGS, match_only=True).tie_points.select(
            "matched"
        )
        errors.append(found.displacement_px - SHIFT_PX)
    scatter = np.sqrt(np.mean([(each.std(axis=0) ** 2).sum() for each in errors]))
    assert np.hypot(*told.scatter_px) == pytest.approx(scatter, rel=0.25)
    assert told.ce90_px == pytest.approx(np.percentile(np.hypot(*np.concatenate(errors).T), 90), rel=0.3)


@pytest.mark.slow
def test_a_proof_is_whole_and_denies_nothing(told: Proof) -> None:
    assert (told.false_matches, told.points) == (0, 96)
    assert told.resampling_px < 0.001
    # the scene has none; the noise of the pair itself, which all matches share, is in what is told
    assert np.hypot(*told.bias_px) < np.hypot(*told.scatter_px) / 2
    of_phases = sum(entry.points[0] for entry in told.phases)  # points that lost most matches have no scatter
    assert told.matches <= of_phases <= told.matches + told.lost
    assert len({point.row for point in told.map}) == len(told.map)
    assert 0 <= told.unobservable.at_least_px < told.unobservable.up_to_px
    assert told.unobservable.up_to_px >= 0.1
    assert {each.name for each in told.unobservable.evidence} == {"channels", "windows", "directions"}


def test_a_pair_that_is_not_matched_proves_nothing(tmp_path: Path) -> None:
    unlike = [write(tmp_path / f"{seed}.tif", render(GRID, seed=seed), GRID) for seed in (1, 2)]
    with pytest.raises(RegistrationRejectedError, match="nothing can be proved"):
        prove_pair(*unlike, SETTINGS, "quick")


def of_moves(moved: np.ndarray, phase: np.ndarray | None = None) -> PointErrors:
    return PointErrors(
        moved, np.zeros(moved.shape) if phase is None else phase, 0, 0, ProofParameters().least_matches
    )


def test_the_error_of_the_pair_as_it_lies_is_in_no_scatter() -> None:
    random = np.random.default_rng(1)
    moved = random.normal(0, 0.02, (8, 500, 2)) + random.normal(0, 0.3, (1, 500, 2))
    assert scatter(of_moves(moved).centred) == pytest.approx([0.02, 0.02], rel=0.05)


def test_a_wave_along_the_pixel_is_locking() -> None:
    random = np.random.default_rng(2)
    phase = random.uniform(0, 1, (8, 300, 2))
    wave = np.array([0.05, 0.0]) * np.sin(2 * np.pi * phase)
    amplitude, found = locking(of_moves(wave + random.normal(0, 0.01, phase.shape), phase))
    assert amplitude == pytest.approx([0.05, 0.0], abs=0.003)
    assert np.abs(found - wave).max() < 0.004


def test_sigmas_that_are_too_small_get_the_factor_that_makes_them_hold() -> None:
    error = np.random.default_rng(3).normal(0, 0.04, (8, 400, 2))
    told = sigma_entry(error, np.full((400, 2), 0.02))
    assert told.factor == pytest.approx(2.0, rel=0.03)
    assert told.within_68 == pytest.approx(0.383, abs=0.02)
    held = sigma_entry(error, np.full((400, 2), 0.02 * told.factor))
    assert (held.within_68, held.within_95) == pytest.approx((0.683, 0.95), abs=0.01)


@pytest.mark.parametrize(
    ("sigma", "beyond", "calibration"),
    [(0.02, 3.0, 2.0), (0.08, 1.0, 0.5), (0.08, 1.6, 0.8), (0.08, 9.0, 1.0)],
)
def test_sigmas_shrink_only_as_far_as_the_pair_scatters(
    sigma: float, beyond: float, calibration: float
) -> None:
    error = np.random.default_rng(3).normal(0, 0.04, (8, 400, 2))
    told = sigma_entry(error, np.full((400, 2), sigma), beyond)
    assert told.calibration == pytest.approx(calibration, rel=0.03)


def test_of_a_sample_an_affine_errs_more_than_of_all_points() -> None:
    random = np.random.default_rng(4)
    every = random.uniform(0, 1000, (800, 2))
    assert _full_to_sample_ratio(every[:50], every, 10.0) == pytest.approx((50 / 800) ** 0.5, rel=0.25)
    assert _full_to_sample_ratio(every[:50], every, 600.0) > 0.8  # of the same few windows


@pytest.mark.parametrize("tolerated", range(-1, 15))
def test_halving_finds_the_largest_level_that_is_tolerated(tolerated: int) -> None:
    levels = DIFFICULTIES["noise"][1]

    def attempt(level: float) -> TrialEntry:
        right = tolerated >= 0 and level <= levels[tolerated]
        return TrialEntry(level, "correct" if right else "refused", 10 * right, None)

    found = _limit("noise", DIFFICULTIES["noise"][0], levels, attempt)
    assert found.tolerated == (None if tolerated < 0 else levels[tolerated])
    assert found.failed == (None if tolerated == 14 else levels[tolerated + 1])
    assert len(found.trials) <= 5
    assert list(found.trials) == sorted(found.trials, key=lambda each: each.level)


def test_clouds_cover_the_share_that_is_told() -> None:
    image = render(GRID)
    clouded = _clouded(image, 0.3, np.random.default_rng(1))
    assert ((clouded > np.percentile(image, 99)) | (np.abs(clouded - image) > 1)).mean() == pytest.approx(
        0.35, abs=0.07
    )
    assert np.array_equal(clouded, image) is False
    assert (clouded == image).mean() > 0.5


@pytest.fixture(scope="module")
def matched(tmp_path_factory: pytest.TempPathFactory) -> Matches:
    files = pair(tmp_path_factory.mktemp("hard"), 3.0, 0)
    return match_pair(prepare_pair(*files, SETTINGS), InThisProcess())


def test_a_blind_spot_costs_what_the_model_misses_there(matched: Matches) -> None:
    table = matched.tie_points.select("matched")
    places = table.predicted_px
    share = (places - places.min(axis=0)) / np.ptp(places, axis=0)
    terms = np.column_stack([np.ones(len(places)), places])
    straight = terms @ [[0.3, -0.2], [1.001, 0.0], [0.0, 0.999]]
    for bent in (np.zeros_like(places), 4.0 * share**2):
        known = straight + bent
        whole = terms @ np.linalg.lstsq(terms, known, rcond=None)[0]
        part = np.minimum((3 * share).astype(int), 2) @ (1, 3)
        off = []
        for each in range(9):
            without = np.linalg.lstsq(terms[part != each], known[part != each], rcond=None)[0]
            off.append(np.sqrt((((terms @ without - whole)[part == each]) ** 2).sum(axis=1).mean()))
        cost_px = _leave_part_out_px(matches_of(replace(table, target_px=known), matched), "affine", 41.0, 3)
        assert cost_px == pytest.approx(max(off), rel=0.25, abs=1e-6)
    assert _leave_part_out_px(matches_of(table[:2], matched), "affine", 41.0, 3) is None


def matches_of(table: TiePointTable, matched: Matches) -> Matches:
    return replace(matched, tie_points=table)


@pytest.mark.slow
def test_a_pair_tolerates_displacements_up_to_its_search_radius(matched: Matches) -> None:
    found = sensitivity(matched, register_pair, JobLog(ignore))
    assert found is not None
    limits = {limit.name: limit for limit in found.limits}
    # by its settings, the pair is searched within 6 px and nowhere else
    assert limits["displacement"].tolerated == pytest.approx(5.66, abs=1.7)
    assert limits["rotation"].tolerated is not None
    assert limits["rotation"].tolerated < 12
    for limit in found.limits:
        for trial in limit.trials:
            assert trial.outcome != "incorrect"
            assert (trial.error_px is None) == (trial.outcome == "refused")
            assert limit.tolerated is None or (trial.level <= limit.tolerated) == (trial.outcome == "correct")
    assert found.reversal is not None
    assert found.reversal.rms_px < 0.05


def test_a_result_that_is_accepted_and_lies_elsewhere_is_wrong(matched: Matches) -> None:
    found: list[Registration] = []

    def register(reference: str, target: str, settings: Settings) -> Registration:
        if len(found) < 3:  # as it lies, there and back
            found.append(register_pair(reference, target, settings))
            return found[-1]
        table = found[0].tie_points
        return replace(found[0], tie_points=replace(table, target_px=table.target_px + np.array([1.0, 1.5])))

    told = sensitivity(matched, register, JobLog(ignore))
    assert told is not None
    assert all(limit.tolerated is None for limit in told.limits)
    outcomes = {limit.name: {trial.outcome for trial in limit.trials} for limit in told.limits}
    assert set(map(frozenset, outcomes.values())) == {frozenset({"incorrect"})}
    (noise,) = (limit for limit in told.limits if limit.name == "noise")
    assert [trial.error_px for trial in noise.trials] == pytest.approx([np.hypot(1, 1.5)] * 4, abs=0.15)


def test_a_part_that_is_refused_as_it_lies_tells_nothing(matched: Matches) -> None:
    def refuse(reference: str, target: str, settings: Settings) -> Registration:
        return replace(register_pair(reference, target, settings), decision=Decision("no"))

    assert sensitivity(matched, refuse, JobLog(ignore)) is None


def test_points_of_a_scene_slightly_larger_than_a_part_are_not_from_its_edges(matched: Matches) -> None:
    assert matched.job is not None
    job = replace(matched.job, region=Window(0, 0, 700, 700))
    places = np.random.default_rng(5).uniform(0, 700, (3000, 2))
    for effort in ("quick", "full"):
        chosen, of_part = _spread(places, job, effort, np.random.default_rng(1), ProofParameters())
        assert (places[chosen] > 640).any(axis=1).mean() < 0.3  # 16 % of the scene
        assert np.bincount(of_part).min() > 20
