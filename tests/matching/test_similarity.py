import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching.coarse import MaskedMap, match_coarsely, parabola_top, peak_distinctness, ssim

TEMPLATE, RADIUS = 21, 4


def masked(values: NDArray, valid: NDArray | None = None) -> MaskedMap:
    weight = np.ones(values.shape, np.float32) if valid is None else valid.astype(np.float32)
    return MaskedMap((values * weight).astype(np.float32), weight, np.float32(0.5))


def naive_ssim(first: NDArray, second: NDArray) -> float:
    """Equations 3-4 as they stand, C3 = C2 / 2."""
    c1, c2 = 0.01**2, 0.03**2
    x, y = first - first.mean(), second - second.mean()
    sx, sy = np.sqrt((x**2).mean()), np.sqrt((y**2).mean())
    luminance = (2 * first.mean() * second.mean() + c1) / (first.mean() ** 2 + second.mean() ** 2 + c1)
    contrast = (2 * sx * sy + c2) / (sx**2 + sy**2 + c2)
    structure = ((x * y).mean() + c2 / 2) / (sx * sy + c2 / 2)
    return float(luminance**0.5 * contrast**0.8 * np.sign(structure) * abs(structure) ** 1.3)


def naive_surface(
    reference: MaskedMap, target: MaskedMap, corner: NDArray, template: int, radius: int, least_valid: float
) -> NDArray:
    (row, col), half = corner, template // 2
    surface = np.empty((2 * radius + 1, 2 * radius + 1))
    for dr in range(-radius, radius + 1):
        for dc in range(-radius, radius + 1):
            here = np.s_[row - half : row + half + 1, col - half : col + half + 1]
            there = np.s_[row + dr - half : row + dr + half + 1, col + dc - half : col + dc + half + 1]
            both = (reference.valid[here] > 0) & (target.valid[there] > 0)
            surface[dr + radius, dc + radius] = -1.0
            if both.mean() >= least_valid:
                first = reference.values[here][both].astype(float) / 0.5
                surface[dr + radius, dc + radius] = naive_ssim(
                    first, target.values[there][both].astype(float) / 0.5
                )
    return surface


def distinctness(surface: NDArray, row: int, col: int) -> float:
    return float(peak_distinctness(surface[None].astype(np.float32), np.array([row]), np.array([col]))[0])


@pytest.fixture(scope="module")
def maps() -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(0)
    kernel = np.outer(np.hanning(7), np.hanning(7))
    spectrum = np.fft.fft2(rng.random((80, 80))) * np.fft.fft2(kernel / kernel.sum(), (80, 80))
    texture = np.real(np.fft.ifft2(spectrum)) - 0.3
    noise = rng.normal(0, 0.02, texture.shape)
    return texture, np.roll(texture, (2, -3), axis=(0, 1)) * 0.8 + 0.05 + noise


@pytest.mark.parametrize("masks", ["none", "reference", "target", "both"])
@pytest.mark.parametrize(("template", "radius"), [(21, 4), (31, 8), (13, 3), (17, 10)])
def test_the_best_offset_and_its_ssim_are_those_of_a_plain_loop(
    maps: tuple[NDArray, NDArray], masks: str, template: int, radius: int
) -> None:
    rng = np.random.default_rng(1)
    valid = [np.ones((80, 80), bool) for _ in range(2)]
    if masks in ("reference", "both"):
        valid[0][30:38, 20:60] = False
    if masks in ("target", "both"):
        valid[1] = rng.random((80, 80)) > 0.2
    reference, target = masked(maps[0], valid[0]), masked(maps[1], valid[1])
    corners = np.array([[30, 30], [45, 40], [40, 50]])
    found = match_coarsely(reference, target, corners, template, radius, 0.3)
    for index, corner in enumerate(corners):
        surface = naive_surface(reference, target, corner, template, radius, 0.3)
        peak = np.unravel_index(surface.argmax(), surface.shape)
        assert tuple(found.offset_rc[index] + radius) == peak
        assert found.ssim[index] == pytest.approx(surface.max(), abs=2e-4)
        assert found.distinctness[index] == pytest.approx(distinctness(surface, *peak), abs=2e-3)
    np.testing.assert_array_equal(found.offset_rc, [(2, -3)] * 3)
    np.testing.assert_array_equal(found.at_border, radius == 3)
    shared = match_coarsely(reference, target, corners, template, radius, 0.3, threads=2)
    for name in ("offset_rc", "ssim", "distinctness", "at_border", "shift_xy_px"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(found, name))


def test_a_search_that_leaves_the_maps_is_an_error(maps: tuple[NDArray, NDArray]) -> None:
    reference, target = masked(maps[0]), masked(maps[1])
    for corner in ([13, 40], [40, 13], [66, 40], [40, 66]):
        with pytest.raises(ValueError, match="less than 14 px from the edge"):
            match_coarsely(reference, target, np.array([[40, 40], corner]), TEMPLATE, RADIUS, 0.4)
    match_coarsely(reference, target, np.array([[14, 14], [65, 65]]), TEMPLATE, RADIUS, 0.4)


def test_the_peak_is_found_to_a_fraction_of_a_pixel(maps: tuple[NDArray, NDArray]) -> None:
    dx, dy = 1.3, -2.4
    ramp = np.fft.fftfreq(80)[:, None] * dy + np.fft.fftfreq(80) * dx
    moved = np.real(np.fft.ifft2(np.fft.fft2(maps[0]) * np.exp(-2j * np.pi * ramp)))
    corners = np.array([[30, 30], [45, 40], [40, 50]])
    found = match_coarsely(masked(maps[0]), masked(moved), corners, TEMPLATE, RADIUS, 0.6)
    np.testing.assert_array_equal(found.offset_rc, [(-2, 1)] * 3)
    np.testing.assert_allclose(found.shift_xy_px, [(dx, dy)] * 3, atol=0.06)


def test_the_top_of_a_parabola() -> None:
    at = np.array([-1.0, 0.0, 1.0])
    assert parabola_top(0.8 - 0.3 * (at - 0.2) ** 2) == pytest.approx(0.2)
    assert parabola_top(0.8 - 0.3 * (at + 0.5) ** 2) == pytest.approx(-0.5)
    assert parabola_top(np.array([0.4, 0.4, 0.4])) == 0.0
    assert parabola_top(np.array([-1.0, 0.4, 0.3])) == 0.0, "one side could not be compared"


def test_too_little_in_common_is_not_compared(maps: tuple[NDArray, NDArray]) -> None:
    valid = np.ones((80, 80), bool)
    valid[:, 36:] = False
    corners = np.array([[40, 20], [40, 40], [40, 60]])
    found = match_coarsely(masked(maps[0]), masked(maps[1], valid), corners, TEMPLATE, RADIUS, 0.6)
    assert found.ssim[0] > 0.5
    np.testing.assert_array_equal(found.ssim[2], -1.0)
    masked_template = match_coarsely(masked(maps[0], valid), masked(maps[1]), corners, TEMPLATE, RADIUS, 0.6)
    np.testing.assert_array_equal(masked_template.ssim[2], -1.0)
    assert masked_template.distinctness[2] == 0.0


def test_a_match_at_the_edge_of_the_search_says_so(maps: tuple[NDArray, NDArray]) -> None:
    corners = np.array([[40, 40]])
    found = match_coarsely(masked(maps[0]), masked(maps[1]), corners, TEMPLATE, 3, 0.6)
    assert found.at_border[0]


def test_the_second_of_two_peaks_makes_the_first_less_distinct() -> None:
    surface = np.zeros((21, 21), np.float32)
    surface[10, 10] = 1.0
    assert distinctness(surface, 10, 10) == pytest.approx(1.0)
    surface[10, 12] = 0.9  # part of the same peak
    assert distinctness(surface, 10, 10) == pytest.approx(1.0)
    surface[3, 4] = 0.75
    assert distinctness(surface, 10, 10) == pytest.approx(0.25)
    assert distinctness(np.ones((9, 9), np.float32), 4, 4) == 0.0


def test_ssim_of_stacks_is_that_of_each_pair() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.random((5, 9, 9)), rng.random((5, 9, 9))
    second[0] = first[0]
    second[1] = 1 - first[1]
    found = ssim(first, second)
    np.testing.assert_allclose(
        found, [naive_ssim(a, b) for a, b in zip(first, second, strict=True)], atol=1e-12
    )
    assert found[0] == pytest.approx(1.0)
    assert found[1] < -0.8
