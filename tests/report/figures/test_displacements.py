from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from pcwlad_geo.report.maps import displacement_figure, nice_number
from pcwlad_geo.tiepoints.table import TiePointTable


def table(reference_px: list[list[float]], displacement: list[list[float]], status: str) -> TiePointTable:
    reference = np.array(reference_px, float).reshape(-1, 2)
    moved = np.array(displacement, float).reshape(-1, 2)
    n = len(reference)
    return TiePointTable(
        reference_px=reference,
        target_px=reference + moved,
        predicted_px=reference,
        xy=reference,
        displacement_m=np.full((n, 2), np.nan),
        covariance_px2=np.zeros((n, 2, 2)),
        score=np.ones(n),
        residual_px=np.full((n, 2), np.nan),
        status=np.full(n, status),
        crs=None,
    )


def arrows(svg: str) -> np.ndarray:
    """(n, 2, 2) begin and tip (x to the right, y down) of the arrows in the panel, px of the page."""
    path = re.search(r'<path d="([^"]*)" clip-path="[^"]*" [^>]*stroke="#003355"', svg)
    assert path is not None
    shafts = re.findall(r"M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)M[^L]*L[^L]*L[^L]*?(?=M|$)", path[1])
    return np.array(shafts, float).reshape(-1, 2, 2)


@pytest.mark.parametrize("moved", [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-0.6, 0.8)])
def test_arrow_points_where_the_target_moved(moved: tuple[float, float]) -> None:
    """Row displacements grow downwards on the page, as image rows do."""
    svg = displacement_figure(table([[50, 50]], [list(moved)], "matched"), (100, 100))
    ((begin, tip),) = arrows(svg)
    np.testing.assert_allclose((tip - begin) / np.hypot(*(tip - begin)), moved, atol=0.02)


def test_arrows_start_at_their_points_and_keep_their_proportions() -> None:
    points, moved = [[20.0, 30.0], [80.0, 60.0]], [[2.0, 0.0], [0.0, 1.0]]
    begin, tip = arrows(displacement_figure(table(points, moved, "fit"), (100, 100))).swapaxes(0, 1)
    px = np.diff(begin, axis=0)[0] / np.diff(points, axis=0)[0]
    np.testing.assert_allclose(px[0], px[1], rtol=0.01)  # to scale
    lengths = np.hypot(*(tip - begin).T)
    assert lengths[0] / lengths[1] == pytest.approx(2, rel=0.02)
    assert lengths.mean() == pytest.approx(0.05 * 100 * px[0], rel=0.05)  # the median is typical


@pytest.mark.parametrize("displacement", [[0.0, 0.0], [1e-9, 0.0], [300.0, 40.0]])
def test_any_size_of_displacement_is_drawn(displacement: list[float]) -> None:
    svg = displacement_figure(table([[50, 50], [60, 20]], [displacement] * 2, "fit"), (100, 4000))
    ElementTree.fromstring(svg)
    assert "nan" not in svg


@pytest.mark.parametrize(("value", "expected"), [(1.0, 1), (0.99, 0.5), (7.3, 5), (0.2, 0.2), (23, 20)])
def test_nice_number(value: float, expected: float) -> None:
    assert nice_number(value) == pytest.approx(expected)
