"""Values that nothing measures: every map stays finite, and the match is that of the image without them."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.estimation.plausible import LARGEST_VALUE, is_plausible, plausible_limits
from pcwlad_geo.matching.channels import normalised_channels
from pcwlad_geo.matching.grey_values import Tones
from pcwlad_geo.matching.keypoints import contrast_weight
from pcwlad_geo.matching.maps import oriented_gradients, oriented_phase_congruency, scene_epsilon
from pcwlad_geo.matching.matcher import match_arrays
from pcwlad_geo.matching.noise import measure_noise
from pcwlad_geo.matching.prepare import Image, prepare
from pcwlad_geo.matching.shift_search import search_shift
from pcwlad_geo.matching.types import Channels, MatchSettings
from pcwlad_geo.matching.window import MatchingWindow
from tests.matching.landscape import Landscape, constant

SHIFT_XY = (2.3, -1.6)
SETTINGS = MatchSettings(features=40, template=61, window=MatchingWindow(61), search_radius=6)
EXTREMES = {
    "float32": (3.4028235e38, -3.4028235e38, 1e20, 1e30, -1e15, 1e10, np.inf, np.nan),
    "float64": (1.7e308, -1.7976931348623157e308, 1e100, 1e20, np.inf),
    "int32": (2**31 - 1, -(2**31)),
    "int64": (2**63 - 1, -(2**63)),
}
CASES = [(dtype, value) for dtype, values in EXTREMES.items() for value in values]


@pytest.fixture(scope="module")
def pair() -> tuple[NDArray, NDArray]:
    scene = Landscape(21)
    return scene.image(200, 0), scene.image(200, 1, constant(*SHIFT_XY))


@pytest.mark.parametrize(("dtype", "value"), CASES)
def test_only_the_extreme_values_are_implausible(dtype: str, value: float) -> None:
    values = np.random.default_rng(0).normal(100, 30, (80, 90)).astype(dtype)
    values[3, 4] = value
    values[60:62, 7] = value
    wrong = ~is_plausible(values, plausible_limits(values))
    assert np.argwhere(wrong).tolist() == [[3, 4], [60, 7], [61, 7]]


@pytest.mark.parametrize("limits", [(-1e9, 1e9), (0, 255), (1, 255), (0, 254.0)])
def test_whole_numbers_are_implausible_as_others_are(limits: tuple[float, float]) -> None:
    values = np.arange(256, dtype=np.uint8)
    assert (is_plausible(values, limits) == is_plausible(values.astype(np.float64), limits)).all()


def test_an_image_of_one_value_has_no_narrower_limits() -> None:
    flat = np.zeros(5000, np.float32)
    flat[7] = 1e5
    assert is_plausible(flat, plausible_limits(flat)).all()
    assert is_plausible(np.full(3, 1e19), plausible_limits(np.array([np.nan, np.inf]))).all()


@pytest.mark.parametrize(("dtype", "value"), CASES)
def test_arrays_are_matched_as_without_them(pair: tuple[NDArray, NDArray], dtype: str, value: float) -> None:
    reference, target = (image.astype(dtype) for image in pair)
    target[90:93, 100], target[20, 30] = value, value
    found = match_arrays(reference, target, settings=SETTINGS).displacement_px
    assert len(found) > 15
    assert np.abs(np.median(found, axis=0) - SHIFT_XY).max() < 0.15  # as of this scene without them


@pytest.mark.parametrize("scale", [1.0, 1e10, 1e15, 0.9 * LARGEST_VALUE / 400])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_map_of_large_numbers_is_that_of_small_ones(
    pair: tuple[NDArray, NDArray], scale: float, dtype: type
) -> None:
    small, large = pair[0].astype(dtype), (scale * pair[0]).astype(dtype)
    other = (scale * pair[1]).astype(dtype)
    valid = np.ones(small.shape, bool)
    epsilons = scene_epsilon(small), scene_epsilon(large)
    for one, two in zip(
        (
            oriented_phase_congruency(small, epsilons[0]),
            oriented_gradients(small, epsilons[0], 1.0)[0],
            contrast_weight(small, epsilons[0]),
            normalised_channels(small.astype(np.float32), valid)[0],
        ),
        (
            oriented_phase_congruency(large, epsilons[1]),
            oriented_gradients(large, epsilons[1], 1.0)[0],
            contrast_weight(large, epsilons[1]),
            normalised_channels(large.astype(np.float32), valid)[0],
        ),
        strict=True,
    ):
        np.testing.assert_allclose(two, one, atol=2e-3 * np.abs(one).max())
    assert np.isfinite(measure_noise(large, valid).sigma)
    tones = Tones.of_pair((large, other), valid, 16.0)
    assert tones is not None
    assert np.isfinite([tones[0].ranks.largest, *np.ravel(tones[0].weights)]).all()
    plain = [Image(image, valid, scene_epsilon(image)) for image in (large, other)]
    for images in (plain, [replace(image, tones=by) for image, by in zip(plain, tones, strict=True)]):
        for channels in get_args(Channels):
            prepared = prepare(images[0], images[1], channels=channels)
            assert np.isfinite(prepared.channels.reference.maps).all()
    found = search_shift(large.astype(float), other.astype(float), valid, valid)
    assert np.hypot(*np.subtract(found.shift_xy, SHIFT_XY)) < 2
