from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcwlad_geo.registration.result import Registration
from pcwlad_geo.report.coverage import Coverage
from pcwlad_geo.report.figures.coverage import coverage_figure

Make = Callable[..., Registration]


def test_every_point_is_counted_in_its_square(registration: Make) -> None:
    table = registration(n=300).tie_points
    coverage = Coverage.of(table, (400, 600), None)
    assert coverage.kept.shape == (8, 12)
    assert coverage.kept.sum() == np.count_nonzero(table.status != "rejected")
    assert coverage.rejected.sum() == np.count_nonzero(table.status == "rejected")
    assert coverage.kept.sum() == 270
    here = (table.reference_px // 50 == [3, 5]).all(axis=1) & (table.status != "rejected")
    assert coverage.kept[5, 3] == here.sum()


def test_squares_without_data_are_not_missed(registration: Make) -> None:
    table = registration(n=300).tie_points
    table = table[table.reference_px[:, 0] > 300]
    valid = np.ones((40, 60), bool)
    valid[:, :25] = False
    coverage = Coverage.of(table, (400, 600), valid)
    assert coverage.without_data.sum() == 5 * 8
    assert coverage.empty[:, :5].sum() == 0
    assert coverage.empty[:, 5].all()
    assert coverage.empty_share == coverage.empty.sum() / 56
    assert coverage_figure(coverage, None).startswith(b"\x89PNG")


def test_a_strip_and_no_points(registration: Make) -> None:
    coverage = Coverage.of(registration("rejected", n=0).tie_points, (10, 5000), np.ones((1, 350), bool))
    assert coverage.kept.shape == (1, 12)
    assert coverage.empty_share == 1.0
    assert coverage_figure(coverage).startswith(b"\x89PNG")
