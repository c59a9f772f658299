from collections import Counter
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import both_directions, first_pass, guidance, lost_candidates, second_pass
from pcwlad_geo.matching.first_pass import Core, match_candidates
from pcwlad_geo.matching.guidance import FieldGuide, guide_by_field
from pcwlad_geo.matching.lost_candidates import Lost, try_again
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.prepare import ChannelPair, Image, prepare
from pcwlad_geo.matching.types import MatchSettings, TiePoints, to_index
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.matching.windows import Scales
from tests.matching.landscape import Landscape, constant

SIDE = 230
SHIFT_XY = (2.3, -3.6)
SMALL = MatchSettings(features=90, template=61, window=MatchingWindow(61), search_radius=6)


@cache
def image(band: int, shift_xy: tuple[float, float] = (0.0, 0.0), seed: int = 21) -> NDArray:
    result = Landscape(seed).image(SIDE, band, constant(*shift_xy))
    result.flags.writeable = False
    return result


@cache
def cross_modal_points() -> TiePoints:
    return match_arrays(image(0), image(1, SHIFT_XY), settings=SMALL)


def errors(points: TiePoints, shift_xy: tuple[float, float] = SHIFT_XY) -> NDArray:
    return points.displacement_px - shift_xy


def assert_same_points(first: TiePoints, second: TiePoints, atol: float) -> None:
    assert len(first) == len(second)
    np.testing.assert_allclose(first.reference_xy_px, second.reference_xy_px, atol=1e-9)
    np.testing.assert_allclose(first.target_xy_px, second.target_xy_px, atol=atol)


def test_a_cross_modal_pair_gives_its_known_shift() -> None:
    points = cross_modal_points()
    assert len(points) > 35
    assert np.linalg.norm(errors(points), axis=1).max() < 0.5
    assert np.sqrt((errors(points) ** 2).sum(axis=1).mean()) < 0.2
    # what one band alone shows pulls all points of this scene by 0.11 px, shifted or not: see the next test
    assert np.abs(np.median(errors(points), axis=0)).max() < 0.12


def test_the_difference_of_two_results_is_the_known_shift() -> None:
    before = match_arrays(image(0), image(1), settings=SMALL)
    after = cross_modal_points()
    place = {tuple(xy): index for index, xy in enumerate(before.reference_xy_px)}
    common = [(i, place[tuple(xy)]) for i, xy in enumerate(after.reference_xy_px) if tuple(xy) in place]
    assert len(common) > 35
    here, there = np.array(common).T
    moved = np.median(after.displacement_px[here] - before.displacement_px[there], axis=0)
    np.testing.assert_allclose(moved, SHIFT_XY, atol=0.02)


def test_the_sigmas_are_of_the_size_of_the_errors() -> None:
    points = cross_modal_points()
    within = (np.abs(errors(points)) < 1.96 * points.sigma_px).mean()
    assert within > 0.8
    assert np.median(points.sigma_px) < 5 * np.abs(errors(points)).std()


def test_points_are_pixel_centres_in_corner_based_coordinates() -> None:
    points = cross_modal_points()
    np.testing.assert_array_equal(points.reference_xy_px % 1, 0.5)
    index = to_index(points)
    assert ((index >= 0) & (index < SIDE)).all()
    np.testing.assert_array_equal(index[:, ::-1] + 0.5, points.reference_xy_px)


def test_a_whole_pixel_shift_of_one_image_is_exact() -> None:
    scene = image(0)
    points = match_arrays(scene[:-4, 5:], scene[4:, :-5], settings=SMALL)
    # the target starts 4 rows lower and 5 columns to the left
    assert len(points) > 35
    assert np.abs(errors(points, (5.0, -4.0))).max() < 0.02


@pytest.mark.parametrize("method", ["gradient", "pcwlad", "pclad", "pclsm", "coarse"])
def test_every_method_finds_the_shift(method: str) -> None:
    options = MatchSettings(**{**_as_dict(SMALL), "method": method, "features": 60})
    points = match_arrays(image(0), image(0, SHIFT_XY), settings=options)
    assert len(points) >= 20
    limit = 0.75 if method == "coarse" else 0.2
    assert np.abs(np.median(errors(points), axis=0)).max() < limit


def test_gradients_match_a_cross_modal_pair_whatever_its_contrast() -> None:
    options = MatchSettings(**{**_as_dict(SMALL), "method": "gradient"})
    points = match_arrays(image(0), image(1, SHIFT_XY), settings=options)
    assert len(points) > 35
    assert np.sqrt((errors(points) ** 2).sum(axis=1).mean()) < 0.2
    inverted = match_arrays(image(0), 3000.0 - 20.0 * image(1, SHIFT_XY), settings=options)
    assert_same_points(inverted, points, 1e-3)


def _as_dict(options: MatchSettings) -> dict:
    return {name: getattr(options, name) for name in MatchSettings.__slots__}


def test_strongest_takes_no_more_than_asked() -> None:
    options = MatchSettings(**{**_as_dict(SMALL), "keypoints": "strongest", "features": 30})
    points = match_arrays(image(0), image(0, SHIFT_XY), settings=options)
    assert 10 <= len(points) <= 30


@settings(max_examples=3)
@given(gain=st.sampled_from([-1.0, -0.02, 30.0]), offset=st.floats(-500, 500))
def test_radiometry_of_the_target_does_not_matter(gain: float, offset: float) -> None:
    again = match_arrays(image(0), gain * image(1, SHIFT_XY) + offset, settings=SMALL)
    assert_same_points(again, cross_modal_points(), 1e-3)


@settings(max_examples=3)
@given(dtype=st.sampled_from(["uint8", "uint16", "int16", "float32"]))
def test_data_types_of_the_same_numbers_give_the_same_points(dtype: str) -> None:
    whole = [np.clip(np.round(im), 0, 255) for im in (image(0), image(1, SHIFT_XY))]
    expected = _of_whole_numbers()
    assert_same_points(match_arrays(*(im.astype(dtype) for im in whole), settings=SMALL), expected, 1e-3)


@cache
def _of_whole_numbers() -> TiePoints:
    return match_arrays(
        *(np.clip(np.round(im), 0, 255) for im in (image(0), image(1, SHIFT_XY))), settings=SMALL
    )


@settings(max_examples=3)
@given(dx=st.floats(-4, 4), dy=st.floats(-4, 4))
def test_any_shift_within_reach_comes_back(dx: float, dy: float) -> None:
    points = match_arrays(image(0), image(0, (dx, dy)), settings=SMALL)
    assert len(points) > 30
    assert np.abs(np.median(errors(points, (dx, dy)), axis=0)).max() < 0.02


def test_masked_and_missing_pixels_have_no_say() -> None:
    reference, target = image(0).copy(), image(1, SHIFT_XY).copy()
    mask = np.ones((SIDE, SIDE), bool)
    mask[:95, 130:] = False
    reference[~mask] = 9999.0
    target[180:, :60] = np.nan
    target[5, 5] = np.inf
    points = match_arrays(reference, target, reference_valid=mask, settings=SMALL)
    assert len(points) > 20
    assert np.sqrt((errors(points) ** 2).sum(axis=1).mean()) < 0.2
    row, col = to_index(points).T
    assert mask[row, col].all()
    untouched = match_arrays(reference * np.where(mask, 1, -3), target, reference_valid=mask, settings=SMALL)
    assert_same_points(untouched, points, 1e-6)


def test_all_points_go_back_where_a_sample_does_not_come_back_to_where_it_began() -> None:
    alike = match_arrays(image(0), image(0, SHIFT_XY), settings=SMALL)
    share = np.isfinite(alike.forward_backward_px).mean()
    assert 0.2 < share < 0.3
    assert np.nanmax(alike.forward_backward_px) < 0.02
    noisy = image(1, SHIFT_XY) + np.random.default_rng(5).normal(0, 0.6 * np.std(image(1)), (SIDE, SIDE))
    different = match_arrays(image(0), noisy, settings=SMALL)
    assert np.isfinite(different.forward_backward_px).all()
    assert np.sqrt((different.forward_backward_px**2).mean()) > 0.02


@pytest.fixture
def ways(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the list to which every refinement adds which points it matches backward."""
    noted: list[str] = []
    refine_both = both_directions.refine_both

    def note(*arguments: Any) -> Any:
        noted.append(arguments[4])
        return refine_both(*arguments)

    for module in (first_pass, second_pass):
        monkeypatch.setattr(module, "refine_both", note)
    return noted


def test_the_second_pass_goes_back_where_the_first_one_did_not_come_back(ways: list[str]) -> None:
    match_arrays(image(0), image(0, SHIFT_XY), settings=SMALL)
    assert set(ways) == {"as needed", "forward only"}
    ways.clear()
    noisy = image(1, SHIFT_XY) + np.random.default_rng(5).normal(0, 0.6 * np.std(image(1)), (SIDE, SIDE))
    match_arrays(image(0), noisy, settings=SMALL)
    assert set(ways) == {"as needed", "always"}


def test_many_points_with_a_given_structure_are_matched_one_way(
    ways: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    both_ways = cross_modal_points()  # kept by whoever asks first: before one way is enough
    ways.clear()
    monkeypatch.setattr(guidance, "GUIDANCE", replace(guidance.GUIDANCE, one_way_from=40))
    forward = match_arrays(image(0), image(1, SHIFT_XY), settings=SMALL)
    # no structure is given, and so both ways: "always"
    assert set(ways) == {"as needed", "always", "forward only"}
    ours, theirs = (np.sqrt((errors(points) ** 2).mean()) for points in (forward, both_ways))
    assert 0 < abs(ours - theirs) < 0.05 * theirs


LARGER = replace(SMALL, window=MatchingWindow(61, (121,)))
MARGIN_PX = 100


@cache
def channels() -> ChannelPair:
    """The maps of both bands, with room for windows of 121 px around every pixel."""
    valid = np.pad(np.ones((SIDE, SIDE), bool), MARGIN_PX)
    images = [np.pad(each, MARGIN_PX) for each in (image(0), image(1, SHIFT_XY))]
    first, second = (Image(each, valid, scene_epsilon(each, valid)) for each in images)
    return prepare(first, second, channels="orientations").channels


def lost_lattice(predicted_xy: tuple[float, float]) -> Lost:
    """A lattice of places without regard to corners, most of them poor for a window of 61 px."""
    place = np.stack(np.meshgrid(np.arange(150, 280, 16), np.arange(150, 280, 16)), -1).reshape(-1, 2) + 0.5
    n = len(place)
    there = np.tile(predicted_xy, (n, 1))
    return Lost(place, FieldGuide(np.zeros((n, 2, 2)), there, None, 0.0, one_way=False), np.full(n, 0.6))


def test_lost_candidates_are_found_where_they_are_expected_and_nowhere_else() -> None:
    near = SHIFT_XY[0] + 0.2, SHIFT_XY[1] - 0.1
    found, index = try_again(channels(), lost_lattice(near), LARGER, Scales.of(61))
    assert len(found) == len(index) > 40
    np.testing.assert_array_equal(found.reference_xy_px, lost_lattice(near).reference_xy_px[index])
    assert np.sqrt((errors(found) ** 2).sum(axis=1).mean()) < 0.25
    assert np.isfinite(found.forward_backward_px).all()
    beside = SHIFT_XY[0] + 5, SHIFT_XY[1] - 4
    assert len(try_again(channels(), lost_lattice(beside), LARGER, Scales.of(61))[0]) <= 1


def test_the_first_pass_takes_all_pixels_also_where_the_second_chooses_the_window() -> None:
    size = replace(SMALL, template=81, window=MatchingWindow(81))
    given, chosen = (
        match_candidates(
            prepare(
                *(Image(each, np.ones((SIDE, SIDE), bool), scene_epsilon(each)) for each in pair_of_bands()),
                channels="orientations",
            ),
            Core(60, 60, SIDE - 60, SIDE - 60, (0, 0)),
            each,
        )[0]
        for each in (size, replace(size, window=MatchingWindow(81, is_open=True)))
    )
    assert len(given) > 10
    assert_same_points(given, chosen, atol=1e-9)


def pair_of_bands() -> tuple[NDArray, NDArray]:
    return image(0), image(1, SHIFT_XY)


def test_lost_candidates_with_nothing_in_common_where_expected_are_not_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    measured: list[int] = []
    refine_both = both_directions.refine_both

    def counting(pair: ChannelPair, corners: NDArray, *others: Any) -> Any:
        measured.append(len(corners))
        return refine_both(pair, corners, *others)

    monkeypatch.setattr(lost_candidates, "refine_both", counting)
    beside = SHIFT_XY[0] + 25, SHIFT_XY[1] - 24
    every = lost_lattice(beside)
    found, _ = try_again(channels(), every, LARGER, Scales.of(61))
    assert len(found) == 0
    assert measured[0] < 0.4 * len(every.limit_px)


def test_every_second_pixel_gives_nearly_the_same_match(monkeypatch: pytest.MonkeyPatch) -> None:
    points = cross_modal_points().shifted(np.full(2, MARGIN_PX), np.full(2, MARGIN_PX))
    guide = guide_by_field(points, LARGER)
    coarse = second_pass.displacement_by_windows(channels(), points, guide, LARGER, [121])[0]
    monkeypatch.setattr(second_pass, "WINDOWS", replace(second_pass.WINDOWS, sparse_from_px=999))
    fine = second_pass.displacement_by_windows(channels(), points, guide, LARGER, [121])[0]
    both = np.isfinite(fine).all(axis=1) & np.isfinite(coarse).all(axis=1)
    assert both.sum() > 0.7 * len(points)
    assert np.linalg.norm(coarse - fine, axis=1)[both].max() < 0.15
    assert np.median(np.linalg.norm(coarse - fine, axis=1)[both]) < 0.05


def test_two_windows_are_combined_by_their_weights() -> None:
    points = cross_modal_points().shifted(np.full(2, MARGIN_PX), np.full(2, MARGIN_PX))
    guide = guide_by_field(points, LARGER)
    seen = second_pass.displacement_by_windows(channels(), points, guide, LARGER, [61, 121])
    both = np.isfinite(seen).all(axis=(0, 2))
    assert both.sum() > 0.7 * len(points)
    scales = Scales((61, 121), (1.5, -0.5))
    again = second_pass.rematch_with(channels(), points, guide, LARGER, scales)
    wanted = 1.5 * seen[0] - 0.5 * seen[1]
    np.testing.assert_allclose(again.displacement_px[both], wanted[both], atol=1e-9)
    failed = ~np.isfinite(seen[1]).all(axis=1) & np.isfinite(seen[0]).all(axis=1)
    np.testing.assert_allclose(again.displacement_px[failed], seen[0, failed], atol=1e-9)


def test_points_that_do_not_go_back_are_where_those_are_that_do() -> None:
    both = cross_modal_points()
    sampled = match_arrays(image(0), image(1, SHIFT_XY), settings=replace(SMALL, backward="sample"))
    place = {tuple(xy): index for index, xy in enumerate(both.reference_xy_px)}
    common = [i for i, xy in enumerate(sampled.reference_xy_px) if tuple(xy) in place]
    assert len(common) > 0.9 * len(both)
    there = [place[tuple(xy)] for xy in sampled.reference_xy_px[common]]
    moved = np.linalg.norm(sampled.target_xy_px[common] - both.target_xy_px[there], axis=1)
    assert np.sqrt((moved**2).mean()) < 0.03


def test_a_smooth_deformation_is_followed_point_by_point() -> None:
    def bent(x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        return 1.5 * np.sin(2 * np.pi * y / 800) + 1.2, 1.5 * np.cos(2 * np.pi * x / 800) - 0.4

    points = match_arrays(image(0), Landscape(21).image(SIDE, 0, bent), settings=SMALL)
    x, y = points.reference_xy_px.T - 0.5
    assert len(points) > 35
    error = points.displacement_px - np.stack(bent(x, y), axis=1)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.05


def test_images_of_different_size_share_their_first_pixel() -> None:
    points = match_arrays(image(0), image(0, SHIFT_XY)[:180, :210], settings=SMALL)
    assert len(points) > 30
    assert np.abs(np.median(errors(points), axis=0)).max() < 0.03


def test_a_displacement_beyond_the_radius_gives_few_points_or_none() -> None:
    points = match_arrays(image(0), image(1, (14.0, 12.0)), settings=SMALL)
    assert len(points) < 8


def test_unrelated_images_give_few_points_or_none() -> None:
    points = match_arrays(image(0), image(1, seed=22), settings=SMALL)
    assert len(points) < 10


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (np.zeros((SIDE, SIDE)), "constant"),
        (np.full((SIDE, SIDE), np.nan), "no valid pixel"),
        (np.ones((SIDE, SIDE), complex), "complex128"),
        (np.ones((3, SIDE, SIDE)), "3-dimensional"),
        (np.full((SIDE, SIDE), "a"), "two-dimensional real"),
    ],
    ids=["constant", "nan", "complex", "3-D", "text"],
)
@pytest.mark.parametrize("side", ["reference", "target"])
def test_unusable_images_are_named(wrong: NDArray, message: str, side: str) -> None:
    pair = (wrong, image(0)) if side == "reference" else (image(0), wrong)
    with pytest.raises(InputError, match=message) as caught:
        match_arrays(*pair, settings=SMALL)
    assert side in str(caught.value)


def test_all_pixels_masked_is_an_error() -> None:
    with pytest.raises(InputError, match="no valid pixel"):
        match_arrays(image(0), image(1), target_valid=np.zeros((SIDE, SIDE), bool), settings=SMALL)


@pytest.mark.parametrize("shape", [(60, 60), (60, 250), (250, 40), (1, 1), (0, 9)])
def test_images_smaller_than_a_window_are_an_error(shape: tuple[int, int]) -> None:
    small = np.random.default_rng(0).random(shape)
    with pytest.raises(InputError):
        match_arrays(small, small, settings=SMALL)


def test_a_small_image_against_a_large_one_is_an_error() -> None:
    with pytest.raises(InputError):
        match_arrays(image(0), image(1)[:30, :30], settings=SMALL)


def test_a_mask_of_another_shape_is_an_error() -> None:
    with pytest.raises(InputError, match="mask"):
        match_arrays(image(0), image(1), reference_valid=np.ones((4, 4), bool), settings=SMALL)


def test_spare_candidates_stand_in_for_those_that_fail() -> None:
    """A cell gives as many points as are wanted of it, if all of its candidates together give as many."""
    rng = np.random.default_rng(4)
    target = image(0, SHIFT_XY) + 0
    rubble = rng.random((SIDE // 10, SIDE // 10)) < 0.5
    where = np.kron(rubble, np.ones((10, 10), bool))
    target[where] = rng.permutation(target[where])
    both = [Image(band, np.ones(band.shape, bool), scene_epsilon(band)) for band in (image(0), target)]
    pair = prepare(*both, channels="gradients")
    settings = MatchSettings(
        method="gradient",
        features=80,
        per_cell=4,
        features_area_px2=120.0**2,
        template=41,
        window=MatchingWindow(25),
        search_radius=6,
    )
    core = Core(0, 0, SIDE, SIDE, (0, 0))
    every, _ = match_candidates(pair, core, settings)
    fewer, candidates = match_candidates(pair, core, replace(settings, spare=2))
    cell_px = round(np.sqrt(4 * 120**2 / 80))
    counts = [
        Counter(map(tuple, (points.reference_xy_px // cell_px).astype(int))) for points in (every, fewer)
    ]
    assert counts[1] == {cell: min(count, 2) for cell, count in counts[0].items()}
    assert len(fewer) < len(every)
    assert candidates.counts["candidates"] == len(candidates) < len(fewer) + len(candidates.lost) + 1
    assert len(candidates.lost) > 0
    there = {
        tuple(xy): xy_there for xy, xy_there in zip(every.reference_xy_px, every.target_xy_px, strict=True)
    }
    for xy, xy_there in zip(fewer.reference_xy_px, fewer.target_xy_px, strict=True):
        np.testing.assert_array_equal(there[tuple(xy)], xy_there)
