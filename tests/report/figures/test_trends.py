from __future__ import annotations

import numpy as np

from pcwlad_geo.report.graphs import GRAPH_STYLE, bin_means, trend_figure
from tests.registrations import make_registration


def test_means_and_errors_are_those_of_each_stretch() -> None:
    rng = np.random.default_rng(2)
    places, values = rng.uniform(100, 700, 400), rng.normal(size=400)
    places[:3] = np.nan
    middles, means, errors = bin_means(places, values, (100, 700))
    assert len(middles) == GRAPH_STYLE.trend_bins
    for middle, mean, error in zip(middles, means, errors, strict=True):
        here = values[np.abs(places - middle) < 25]
        np.testing.assert_allclose([mean, error], [here.mean(), here.std(ddof=1) / np.sqrt(len(here))])


def test_stretches_with_few_values_are_left_out() -> None:
    middles, means, _ = bin_means(np.r_[np.full(9, 5.0), 95.0], np.ones(10), (0, 100))
    assert len(middles) == 1
    np.testing.assert_allclose(means, 1)


def test_heights_are_a_third_column_where_known() -> None:
    points = make_registration().tie_points.select("fit", "check")
    without = trend_figure(points, (400, 600), np.full(len(points), np.nan))
    assert without == trend_figure(points, (400, 600))
    assert without != trend_figure(points, (400, 600), np.linspace(0, 900, len(points)))
