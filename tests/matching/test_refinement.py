from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import fft2, fftfreq, ifft2

from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.prepare import ChannelPair, Image, prepare
from pcwlad_geo.matching.refinement import ChannelMaps, InitialEstimate, correlation_half_px, refine
from tests.matching.landscape import Field, Landscape, constant
from tests.oracles.refinement import refine_plain

SIDE = 200


def prepared(
    reference: NDArray, target: NDArray, *, oriented: bool = True, valid: NDArray | None = None
) -> ChannelPair:
    everything = np.ones(reference.shape, bool)
    images = (
        Image(image, valid if valid is not None else everything, scene_epsilon(image))
        for image in (reference, target)
    )
    return prepare(*images, channels="orientations" if oriented else "moment").channels


def start_at(shift_xy: tuple[float, float], n: int, **more: NDArray) -> InitialEstimate:
    return InitialEstimate(np.tile(np.asarray(shift_xy, float), (n, 1)), np.zeros((n, 2, 2)), **more)


def fourier_shift(image: NDArray, dx: float, dy: float) -> NDArray:
    """Shift a periodic band-limited image exactly."""
    ramp = fftfreq(image.shape[0])[:, None] * dy + fftfreq(image.shape[1]) * dx
    return np.real(ifft2(fft2(image) * np.exp(-2j * np.pi * ramp)))


def periodic_texture(side: int, seed: int) -> NDArray:
    noise = fft2(np.random.default_rng(seed).normal(size=(side, side)))
    frequency = np.hypot(fftfreq(side)[:, None], fftfreq(side))
    image = np.real(ifft2(noise * np.exp(-((frequency / 0.12) ** 2)) * (frequency < 0.35)))
    return 127 + 40 * image / image.std()


@cache
def cross_modal(oriented: bool, with_holes: bool) -> ChannelPair:
    scene = Landscape(5)
    valid = np.ones((SIDE, SIDE), bool)
    if with_holes:
        valid[70:90, 60:110] = False
    return prepared(
        scene.image(SIDE, 0), scene.image(SIDE, 1, constant(0.8, -0.55)), oriented=oriented, valid=valid
    )


CORNERS = np.array([[80, 95], [40, 100], [100, 30]])


@pytest.mark.parametrize(("oriented", "with_holes"), [(True, False), (False, True)])
@pytest.mark.parametrize("affine", [False, True])
@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("structure", ["follows", "fixed", "given", "none", "deformed", "a match"])
def test_the_compiled_loop_equals_its_plain_twin(
    structure: str, robust: bool, affine: bool, oriented: bool, with_holes: bool
) -> None:
    pair, n = cross_modal(oriented, with_holes), len(CORNERS)
    start = start_at((1.0, -1.0), n)
    if structure == "fixed":
        start = start_at((1.0, -1.0), n, structure_xy_px=np.tile([0.7, -0.6], (n, 1)))
    elif structure == "given":
        given = np.random.default_rng(3).random((n, 61, 61)).astype(np.float32)
        start = start_at((1.0, -1.0), n, structure=given)
    elif structure == "deformed":
        linear = np.tile([[0.01, 0.004], [-0.006, 0.008]], (n, 1, 1))
        start = InitialEstimate(start.shift_xy_px, linear)
    options = {"window_px": 61, "robust": robust, "affine": affine, "use_structure": structure != "none"}
    if structure == "a match":
        found = refine(pair.reference, pair.target, CORNERS, start, **options)
        start = InitialEstimate(found.shift_xy_px + np.array([0.012, -0.004]), found.linear, is_match=True)
    fast = refine(pair.reference, pair.target, CORNERS, start, **options)
    plain = refine_plain(pair.reference, pair.target, CORNERS, start, **options)
    np.testing.assert_array_equal(fast.converged, plain.converged)
    ok = plain.converged
    np.testing.assert_allclose(fast.shift_xy_px[ok], plain.shift_xy_px[ok], atol=1e-4)
    np.testing.assert_allclose(fast.linear[ok], plain.linear[ok], atol=1e-5)
    scale = np.trace(plain.covariance_px2[ok], axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(fast.covariance_px2[ok] / scale, plain.covariance_px2[ok] / scale, atol=1e-3)
    assert not ok[-1], "the last window leaves the image"
    if structure == "follows" and not affine:
        assert ok[:-1].all()


def test_one_short_move_confirms_a_match_and_nothing_else() -> None:
    pair, n = cross_modal(True, False), len(CORNERS)
    structure = np.tile([0.7, -0.6], (n, 1))
    start = start_at((1.0, -1.0), n, structure_xy_px=structure)
    options = {"window_px": 61, "iterations": 1}
    found = refine(pair.reference, pair.target, CORNERS, start, window_px=61)
    near = InitialEstimate(found.shift_xy_px, found.linear, structure)
    assert not refine(pair.reference, pair.target, CORNERS, near, **options).converged.any()
    again = refine(pair.reference, pair.target, CORNERS, replace(near, is_match=True), **options)
    np.testing.assert_array_equal(again.converged, found.converged)
    ok = found.converged
    np.testing.assert_allclose(again.shift_xy_px[ok], found.shift_xy_px[ok], atol=0.004)
    np.testing.assert_allclose(again.covariance_px2[ok], found.covariance_px2[ok], rtol=0.2)
    far = replace(start, is_match=True)
    assert not refine(pair.reference, pair.target, CORNERS, far, **options).converged.any()


@pytest.mark.parametrize("structure", ["follows", "fixed", "fixed where it starts", "deformed"])
@pytest.mark.parametrize(("window_px", "width"), [(61, SIDE), (101, SIDE - 1)])
def test_every_second_pixel_equals_the_plain_twin(structure: str, window_px: int, width: int) -> None:
    pair = cross_modal(True, True)
    images = [
        ChannelMaps(
            np.ascontiguousarray(each.maps[:, :, :width]), np.ascontiguousarray(each.valid[:, :width])
        )
        for each in (pair.reference, pair.target)
    ]
    corners, linear = np.array([[88, 95], [112, 90], [101, 118], [40, 101]]), np.zeros((4, 2, 2))
    if structure == "deformed":
        linear[:] = [[0.03, 0.004], [-0.006, -0.02]]
    place = {"fixed": [0.7, -0.6], "fixed where it starts": [1.0, -1.0]}.get(structure)
    start = InitialEstimate(
        np.tile([1.0, -1.0], (4, 1)), linear, None if place is None else np.tile(place, (4, 1))
    )
    fast = refine(*images, corners, start, window_px=window_px, step_px=2)
    plain = refine_plain(*images, corners, start, window_px=window_px, step_px=2)
    assert plain.converged.any()
    np.testing.assert_array_equal(fast.converged, plain.converged)
    ok = plain.converged
    np.testing.assert_allclose(fast.shift_xy_px[ok], plain.shift_xy_px[ok], atol=1e-4)
    scale = np.trace(plain.covariance_px2[ok], axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(fast.covariance_px2[ok] / scale, plain.covariance_px2[ok] / scale, atol=1e-3)
    shared = refine(*images, corners, start, window_px=window_px, step_px=2, threads=3)
    np.testing.assert_array_equal(shared.shift_xy_px, fast.shift_xy_px)
    np.testing.assert_array_equal(shared.covariance_px2, fast.covariance_px2)


@pytest.mark.parametrize("window_px", [41, 81, 101, 129])
def test_every_size_of_the_correlation_window_equals_the_plain_twin(window_px: int) -> None:
    pair, corners = cross_modal(True, False), np.array([[88, 95], [112, 90]])
    start = start_at((1.0, -1.0), 2)
    fast = refine(pair.reference, pair.target, corners, start, window_px=window_px)
    plain = refine_plain(pair.reference, pair.target, corners, start, window_px=window_px)
    assert plain.converged.any()
    np.testing.assert_array_equal(fast.converged, plain.converged)
    np.testing.assert_allclose(fast.shift_xy_px, plain.shift_xy_px, atol=1e-4)
    scale = np.trace(plain.covariance_px2, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(fast.covariance_px2 / scale, plain.covariance_px2 / scale, atol=1e-3)


@pytest.mark.parametrize("affine", [False, True])
@pytest.mark.parametrize("window_px", [(5, 61), (61, 5)])
def test_windows_of_few_rows_or_columns_equal_the_plain_twin(
    window_px: tuple[int, int], affine: bool
) -> None:
    pair, n = cross_modal(True, True), 4
    corners = np.array([[80, 95], [112, 90], [100, 36], [36, 100]])
    linear = np.tile([[0.01, 0.004], [-0.006, 0.008]], (n, 1, 1))
    start = InitialEstimate(np.tile([0.8, -0.5], (n, 1)), linear)
    options = {"window_px": window_px, "use_structure": False, "affine": affine}
    fast = refine(pair.reference, pair.target, corners, start, **options)
    plain = refine_plain(pair.reference, pair.target, corners, start, **options)
    assert affine or plain.converged.any()
    np.testing.assert_array_equal(fast.converged, plain.converged)
    ok = plain.converged
    np.testing.assert_allclose(fast.shift_xy_px[ok], plain.shift_xy_px[ok], atol=1e-4)
    scale = np.trace(plain.covariance_px2[ok], axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(fast.covariance_px2[ok] / scale, plain.covariance_px2[ok] / scale, atol=1e-3)


FRACTIONS = np.linspace(-0.5, 0.5, 11)


@pytest.mark.parametrize("oriented", [True, False])
def test_known_subpixel_shifts_come_back_at_every_fraction(oriented: bool) -> None:
    image = periodic_texture(160, 2)
    corners = np.array([[70, 70], [75, 88], [88, 72]])
    errors = []
    for dx in FRACTIONS:
        dy = 0.3 - dx / 2
        pair = prepared(image, fourier_shift(image, dx, dy), oriented=oriented)
        # from the nearest whole pixel, where the coarse match would put it
        found = refine(
            pair.reference, pair.target, corners, start_at((np.round(dx), np.round(dy)), 3), window_px=81
        )
        assert found.converged.all()
        errors.append(found.shift_xy_px - [dx, dy])
    assert np.abs(errors).max() < 0.02
    # pixel locking would pull towards the whole pixel: an error that follows the fraction
    locking = np.polyfit(FRACTIONS, np.mean(errors, axis=1)[:, 0], 1)[0]
    assert abs(locking) < 0.01


def test_the_start_does_not_show_in_the_result() -> None:
    image = periodic_texture(160, 4)
    pair = prepared(image, fourier_shift(image, 0.37, -0.21))
    corners = np.array([[80, 80]])
    found = [
        refine(pair.reference, pair.target, corners, start_at(start, 1), window_px=81).shift_xy_px
        for start in ((0, 0), (1, -1), (-0.5, 0.6))
    ]
    assert np.ptp(found, axis=0).max() < 0.01


def rotated_and_stretched(linear: NDArray, centre: float, shift: tuple[float, float]) -> Field:
    def displacement(x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        dx, dy = x - centre, y - centre
        return (
            linear[0, 0] * dx + linear[0, 1] * dy + shift[0],
            linear[1, 0] * dx + linear[1, 1] * dy + shift[1],
        )

    return displacement


LINEAR = np.array([[0.012, -0.018], [0.015, -0.008]])


def test_affine_recovers_a_known_deformation() -> None:
    scene = Landscape(2)
    pair = prepared(scene.image(SIDE), scene.image(SIDE, 0, rotated_and_stretched(LINEAR, 100, (0.4, -0.3))))
    found = refine(
        pair.reference, pair.target, np.array([[100, 100]]), start_at((0, 0), 1), window_px=81, affine=True
    )
    assert found.converged.all()
    np.testing.assert_allclose(found.shift_xy_px[0], (0.4, -0.3), atol=0.02)
    np.testing.assert_allclose(found.linear[0], LINEAR, atol=1e-3)


def test_a_given_deformation_is_held() -> None:
    scene = Landscape(2)
    pair = prepared(scene.image(SIDE), scene.image(SIDE, 0, rotated_and_stretched(LINEAR, 100, (0.4, -0.3))))
    found = refine(
        pair.reference,
        pair.target,
        np.array([[100, 100]]),
        InitialEstimate(np.zeros((1, 2)), LINEAR[None]),
        window_px=81,
    )
    np.testing.assert_array_equal(found.linear[0], LINEAR)
    np.testing.assert_allclose(found.shift_xy_px[0], (0.4, -0.3), atol=0.02)


def test_structure_weights_ignore_a_patch_that_shows_something_else() -> None:
    scene, other = Landscape(6), Landscape(7)
    corners = np.array([[95, 95], [100, 104], [108, 98]])
    reference, target = scene.image(SIDE), scene.image(SIDE, 0, constant(0.3, 0.2))
    # a third of the windows holds another scene, moved by more than a pixel
    reference[60:100, 60:125] = other.image(SIDE)[60:100, 60:125]
    target[60:100, 60:125] = other.image(SIDE, 0, constant(-1.2, -1.0))[60:100, 60:125]
    pair = prepared(reference, target)
    start = start_at((0, 0), 3)

    def error(use_structure: bool) -> float:
        found = refine(
            pair.reference,
            pair.target,
            corners,
            start,
            window_px=81,
            use_structure=use_structure,
            robust=use_structure,
        )
        return float(np.abs(found.shift_xy_px - (0.3, 0.2)).max())

    assert error(True) < 0.1
    assert error(True) < 0.4 * error(False)


def test_invalid_pixels_have_no_say() -> None:
    scene = Landscape(8)
    reference, target = scene.image(SIDE), scene.image(SIDE, 0, constant(0.45, -0.35))
    valid = np.ones((SIDE, SIDE), bool)
    valid[90:, 70:100] = False
    garbage = np.random.default_rng(0).normal(127, 60, target.shape)
    channels = []
    for image in (reference, target):
        maps = prepared(image, image).reference.maps.copy()
        channels.append(ChannelMaps(maps, valid))
    corners = np.array([[95, 100]])
    clean = refine(*channels, corners, start_at((0, 0), 1), window_px=61, use_structure=False)
    spoilt = channels[0].maps.copy()
    spoilt[:, ~valid] = garbage[~valid]
    again = refine(
        ChannelMaps(spoilt, valid),
        channels[1],
        corners,
        start_at((0, 0), 1),
        window_px=61,
        use_structure=False,
    )
    np.testing.assert_allclose(clean.shift_xy_px[0], (0.45, -0.35), atol=0.03)
    np.testing.assert_allclose(again.shift_xy_px, clean.shift_xy_px, atol=1e-6)


def test_windows_with_too_little_valid_are_not_refined() -> None:
    scene = Landscape(8)
    valid = np.ones((SIDE, SIDE), bool)
    valid[:, :110] = False
    pair = prepared(scene.image(SIDE), scene.image(SIDE), valid=valid)
    corners = np.array([[100, 100], [100, 150]])
    found = refine(pair.reference, pair.target, corners, start_at((0, 0), 2), window_px=61)
    np.testing.assert_array_equal(found.converged, (False, True))


def test_a_window_without_structure_does_not_converge() -> None:
    flat = np.zeros((1, 160, 160), np.float32)
    stack = ChannelMaps(flat, np.ones((160, 160), bool))
    found = refine(stack, stack, np.array([[80, 80]]), start_at((0, 0), 1), window_px=61)
    assert not found.converged.any()
    assert np.isfinite(found.shift_xy_px).all()


def test_a_shift_far_from_the_start_is_not_taken() -> None:
    image = Landscape(9, (30.0, 90.0)).image(SIDE)
    target = Landscape(9, (30.0, 90.0)).image(SIDE, 0, constant(5.0, 0.0))
    pair = prepared(image, target, oriented=False)
    found = refine(pair.reference, pair.target, np.array([[100, 100]]), start_at((0, 0), 1), window_px=81)
    assert not found.converged.any() or np.linalg.norm(found.shift_xy_px) <= 3.0


def test_the_covariance_grows_with_noise_and_shrinks_with_the_window() -> None:
    scene, rng = Landscape(10), np.random.default_rng(1)
    reference, target = scene.image(SIDE), scene.image(SIDE, 0, constant(0.2, 0.3))
    corners = np.array([[100, 100], [96, 106]])

    def sigma(noise: float, window_px: int) -> float:
        noisy = target + rng.normal(0, noise, target.shape)
        pair = prepared(reference + rng.normal(0, noise, target.shape), noisy)
        found = refine(pair.reference, pair.target, corners, start_at((0, 0), 2), window_px=window_px)
        return float(np.sqrt(np.trace(found.covariance_px2, axis1=1, axis2=2)).mean())

    assert sigma(6.0, 81) > 1.5 * sigma(1.0, 81)
    assert sigma(6.0, 41) > 1.3 * sigma(6.0, 101)


def test_correlation_windows_follow_the_window() -> None:
    assert [correlation_half_px(window) for window in (41, 81, 129)] == [1, 3, 5]
