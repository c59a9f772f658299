"""On ground that repeats, the whole scene tells displacements a period apart, or says that it cannot."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

from pcwlad_geo.matching.repeats import rivals_of
from tests.repeating_ground import PATTERNS, repeating_pair

FROM_PX = np.array([5.0, -3.0])
pair_of = cache(repeating_pair)


def _image(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return values.astype(np.float32), np.ones(values.shape, bool)


def _rivals(kind: str, periods: int, **options: object) -> list:
    """Return the rivals of a displacement that is wrong by so many periods."""
    reference, target = pair_of(kind, (5.0, -3.0), side_px=260, **options)  # type: ignore[arg-type]
    return rivals_of(_image(reference), _image(target), FROM_PX + periods * np.array(PATTERNS[kind][1]))


@pytest.mark.parametrize("kind", ["field trial", "solar park", "roofs", "car park"])
def test_the_right_displacement_has_no_rival_where_something_breaks_the_period(kind: str) -> None:
    assert _rivals(kind, 0) == []


@pytest.mark.parametrize("kind", ["field trial", "solar park", "roofs"])
@pytest.mark.parametrize("periods", [-1, 2])
def test_a_displacement_that_is_periods_off_has_the_right_one_as_better(kind: str, periods: int) -> None:
    best = _rivals(kind, periods)[0]
    assert best.is_better
    assert_allclose(best.shift_xy, FROM_PX, atol=1.0)


@pytest.mark.parametrize("periods", [0, 1])
def test_rivals_are_named_where_nothing_breaks_the_period(periods: int) -> None:
    rivals = _rivals("solar park", periods, has_edges=False, detail=0.0)
    assert rivals
    assert not rivals[0].is_better
    apart = (np.array([rival.shift_xy for rival in rivals[:8]]) - FROM_PX)[:, 1]
    assert_allclose(apart, 16 * np.rint(apart / 16), atol=1.5)


def test_ground_that_does_not_repeat_has_no_rivals() -> None:
    noise = np.random.default_rng(1).normal(size=(2, 300, 300))
    image = _image(
        sum(gaussian_filter(one, sigma) * sigma for one, sigma in zip(noise, (1.5, 8), strict=True))
    )
    assert rivals_of(image, image, np.zeros(2)) == []
    assert rivals_of(image, image, np.array([40.0, 0.0])) == []


def test_a_scene_larger_than_what_is_compared() -> None:
    reference, target = repeating_pair("field trial", (4.0, 6.0), side_px=900)
    rivals = rivals_of(_image(reference), _image(target), np.array([4.0, 36.0]))
    assert rivals[0].is_better
    assert_allclose(rivals[0].shift_xy, (4.0, 6.0), atol=2.0)


@pytest.mark.parametrize("kind", PATTERNS)
@pytest.mark.parametrize("periods", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_what_is_left_out_for_speed_holds_no_rival(
    kind: str, periods: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit of 0 at the displacement leaves nothing out."""
    quick = _rivals(kind, periods)
    monkeypatch.setattr("pcwlad_geo.matching.repeats.correlation_at", lambda *_: 0.0)
    whole = _rivals(kind, periods)
    assert [(*rival.shift_xy, rival.is_better) for rival in quick] == [
        (*rival.shift_xy, rival.is_better) for rival in whole
    ]


def test_ground_that_hardly_repeats_is_not_compared_at_all_shifts(monkeypatch: pytest.MonkeyPatch) -> None:
    values = gaussian_filter(np.random.default_rng(0).normal(size=(200, 220)), 2)
    calls: list[object] = []
    monkeypatch.setattr("pcwlad_geo.matching.repeats.masked_correlation", lambda *_: calls.append(1))
    assert (
        rivals_of(_image(values), _image(np.roll(values, (3, -4), axis=(0, 1))), np.array([-4.0, 3.0])) == []
    )
    assert not calls
