from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.image import imread

from pcwlad_geo.report.figures import displacement_figure, nice_number
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


def dark_pixels(png: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the near-black pixels inside the frame's middle."""
    grey = imread(io.BytesIO(png))[..., :3].mean(axis=2)
    rows, cols = grey.shape
    inner = grey[rows // 4 : 3 * rows // 4, cols // 4 : 3 * cols // 4]
    return np.nonzero(inner < 0.3)


def test_arrow_points_where_the_target_moved() -> None:
    """Row displacements grow downwards on the page, as image rows do."""
    down = dark_pixels(displacement_figure(table([[50, 50]], [[0, 1]], "matched"), (100, 100)))
    up = dark_pixels(displacement_figure(table([[50, 50]], [[0, -1]], "matched"), (100, 100)))
    right = dark_pixels(displacement_figure(table([[50, 50]], [[1, 0]], "matched"), (100, 100)))
    assert down[0].mean() > up[0].mean() + 10
    assert np.ptp(right[1]) > 3 * np.ptp(right[0])


@pytest.mark.parametrize("displacement", [[0.0, 0.0], [1e-9, 0.0], [300.0, 40.0]])
def test_any_size_of_displacement_is_drawn(displacement: list[float]) -> None:
    png = displacement_figure(table([[50, 50], [60, 20]], [displacement] * 2, "fit"), (100, 4000))
    assert png.startswith(b"\x89PNG")


@pytest.mark.parametrize(("value", "expected"), [(1.0, 1), (0.99, 0.5), (7.3, 5), (0.2, 0.2), (23, 20)])
def test_nice_number(value: float, expected: float) -> None:
    assert nice_number(value) == pytest.approx(expected)
