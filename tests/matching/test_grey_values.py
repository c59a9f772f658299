"""Channels of grey values: what depends most on each other in two images, whatever the relation is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from pcwlad_geo.matching.grey_values import GREY, Ranks, Tones, local_deviation
from tests.matching.landscape import Landscape

SIDE = 160
ALL = np.ones((SIDE, SIDE), bool)
Change = Callable[[NDArray], NDArray]


@pytest.fixture(scope="module")
def image() -> NDArray:
    """Blobs whose tones vary within a few pixels and over the whole image."""
    noise = np.random.default_rng(0).normal(size=(SIDE, SIDE))
    return 100 + 30 * ndimage.gaussian_filter(noise, 5) / 0.06 + np.linspace(0, 40, SIDE)


def measured(reference: NDArray, target: NDArray, valid: NDArray = ALL) -> tuple[Tones, Tones]:
    found = Tones.of_pair((reference, target), valid, GREY.reach_px)
    assert found is not None
    return found


def test_ranks_are_those_of_the_sorted_values() -> None:
    values = np.random.default_rng(1).normal(3, 2, 5000).astype(np.float32)
    values -= values.mean()
    first, second = Ranks.of(values).polynomials(values).T
    rank = 2 * (np.argsort(np.argsort(values)) + 0.5) / len(values) - 1
    np.testing.assert_allclose(first, rank, atol=5e-3)
    np.testing.assert_allclose(second, 1.5 * rank**2 - 0.5, atol=0.02)


@pytest.mark.parametrize(
    "change",
    [np.negative, lambda v: (v - 115) ** 2, lambda v: 3 * v + 1000, lambda v: np.sin(v / 20)],
    ids=["negative", "folded", "gain", "wave"],
)
def test_channels_correlate_whatever_the_relation_is(image: NDArray, change: Change) -> None:
    local = local_deviation(image, ALL, GREY.reach_px) + 115
    noise = np.random.default_rng(2).normal(0, 3, (SIDE, SIDE))
    tones = measured(image, change(local + noise))
    one, other = (
        each.maps(of, ALL)[0][:, 40:-40, 40:-40].reshape(2, -1)
        for each, of in zip(tones, (image, change(local + noise)), strict=True)
    )
    correlation = np.corrcoef(np.concatenate([one, other]))[:2, 2:]
    assert correlation[0, 0] > 0.7
    assert abs(correlation[0, 1]) < 0.35 < correlation[0, 0]
    # both are as strong as what they share
    assert one[0].std() == pytest.approx(GREY.scale * np.sqrt(correlation[0, 0]), rel=0.15)


def test_other_images_have_weak_channels(image: NDArray) -> None:
    tones = measured(image, np.roll(image.T, 70, axis=0))
    related = measured(image, -image)
    strength = [each[0].maps(image, ALL)[0].std() for each in (tones, related)]
    assert strength[0] < 0.5 * strength[1]


def test_units_and_invalid_pixels_do_not_matter(image: NDArray) -> None:
    valid = ALL.copy()
    valid[:30] = False
    spoiled = np.where(valid, image, 1e4)
    tones = measured(spoiled, -image, valid)
    same = measured(1000 * spoiled + 5e4, -image, valid)
    filled = np.where(valid, image, image.mean())
    expected = tones[0].maps(filled, valid)
    found = same[0].maps(1000 * filled + 5e4, valid)
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_allclose(one[..., 40:, :], other[..., 40:, :], atol=0.02)


def test_too_few_pixels_tell_nothing() -> None:
    few = np.zeros((SIDE, SIDE), bool)
    few[:60, :60] = True
    landscape = Landscape(3).image(SIDE)
    assert Tones.of_pair((landscape, landscape), few, GREY.reach_px) is None
