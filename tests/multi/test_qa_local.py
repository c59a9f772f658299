"""Local means and their maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.multi.qa.band_pairs import LocalMean, local_means
from pcwlad_geo.multi.qa.numbers import BandPairEntry, summarise
from pcwlad_geo.multi.qa.page import displacement_maps
from tests.multi.measured_bands import make_band, make_pair
from tests.multi.test_qa_page import make_result

A, B = make_band("a"), make_band("b", shape=(400, 200))


def test_means_of_the_squares() -> None:
    """Displaced by col / 100 px: each square has the value of its middle, about."""
    points = make_pair(A, B, noise_px=0.0, n=3000).points
    assert points is not None
    shift = np.column_stack([points.predicted_px[:, 0] / 100, np.zeros(len(points))])
    found = local_means(replace(points, target_px=points.predicted_px + shift), (400, 200))
    assert len(found) == 8 * 4
    assert sum(each.n for each in found) == 3000
    assert {each.at_px[0] for each in found} == {25.0, 75.0, 125.0, 175.0}
    for each in found:
        assert each.mean_px == pytest.approx((each.at_px[0] / 100, 0.0), abs=0.06)


def test_squares_with_few_points_are_left_out() -> None:
    points = make_pair(A, B, n=3000).points
    assert points is not None
    inside = (points.predicted_px < 50).all(axis=1)
    first = np.flatnonzero(inside)
    assert len(local_means(points[first[:2]], (400, 200))) == 0
    assert [each.n for each in local_means(points[first[:3]], (400, 200))] == [3]


def test_an_arrow_lies_about_the_middle_of_its_square_and_points_where_it_must() -> None:
    def pair(name: str, ce90_px: float, mean_px: tuple[float, float]) -> BandPairEntry:
        made = summarise(make_result([A, B], [make_pair(A, B)]), []).pairs[0]
        px = made.displacement["px"]
        assert px is not None
        statistics = replace(px, radial=replace(px.radial, ce90=ce90_px))
        local = (LocalMean((100.0, 300.0), 9, mean_px),)
        return replace(made, name=name, local=local, displacement={"px": statistics})

    worst, best = displacement_maps(
        [pair("best", 0.1, (0.0, 0.01)), pair("worst", 0.9, (-0.5, 0.0))], {"b": (400, 200)}
    )
    assert (worst.name, best.name) == ("worst", "best")
    assert (worst.width, worst.height) == (110.0 + 16, 220.0 + 16)
    (arrow,) = worst.arrows
    assert (arrow.x + arrow.dx / 2, arrow.y + arrow.dy / 2) == pytest.approx((63.0, 173.0), abs=0.1)
    assert (arrow.dx, arrow.dy, arrow.turn_deg) == (pytest.approx(-0.85 * 27.5, abs=0.1), 0.0, 180)
    assert best.arrows[0].dy == pytest.approx(0.85 * 27.5 / 5, abs=0.1)  # a fifth of the least scale
