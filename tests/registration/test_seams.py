"""Lines at which the displacement of a pair steps, told from displacements that vary smoothly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.registration.seams import seam_of
from pcwlad_geo.tiepoints.table import TiePointTable

Array = NDArray[np.float64]

SIDE_PX, WINDOW_PX, NOISE_PX = 512.0, 81.0, 0.1


def points_of(displacement: Callable[[Array], Array], count: int = 600) -> TiePointTable:
    """Return tie points, each the mean displacement within its window, with noise."""
    rng = np.random.default_rng(5)
    at_px = rng.uniform(20, SIDE_PX - 20, (count, 2))
    within = rng.uniform(-WINDOW_PX / 2, WINDOW_PX / 2, (40, count, 2))
    moved = np.mean([displacement(at_px + away) for away in within], axis=0)
    moved += rng.normal(0, NOISE_PX, moved.shape)
    unknown = np.full((count, 2), np.nan)
    return TiePointTable(
        reference_px=at_px,
        target_px=at_px + moved,
        predicted_px=at_px,
        xy=unknown,
        displacement_m=unknown,
        covariance_px2=np.tile(np.eye(2) * NOISE_PX**2, (count, 1, 1)),
        score=np.ones(count),
        residual_px=unknown,
        status=np.full(count, "fit"),
        crs=None,
    )


def step(at_px: Array, step_px: float, normal: tuple[float, float] = (1.0, 0.0)) -> Array:
    beyond = at_px @ normal > 282
    return np.stack([11.2 + step_px * beyond, np.zeros(len(at_px))], axis=1)


@pytest.mark.parametrize(("step_px", "normal"), [(1.0, (1.0, 0.0)), (2.2, (1.0, 0.0)), (1.0, (0.5, 0.866))])
def test_a_step_is_found_where_it_is(step_px: float, normal: tuple[float, float]) -> None:
    found = seam_of(points_of(lambda at_px: step(at_px, step_px, normal)), WINDOW_PX)
    assert found is not None
    np.testing.assert_allclose(found.step_px, [step_px, 0], atol=0.1)
    assert abs(found.position_px - 282) < 15
    assert found.normal @ normal > 0.95


def test_what_a_smooth_correction_leaves_is_told() -> None:
    points = points_of(lambda at_px: step(at_px, 1.0))
    found = seam_of(points, WINDOW_PX)
    assert found is not None
    middle = AffineCorrection("shift", np.array([[1, 0, 11.7], [0, 1, 0]]))
    at_px = np.random.default_rng(1).uniform(0, SIDE_PX, (500, 2))
    assert found.off_px(middle, at_px) == pytest.approx(0.5, abs=0.1)
    text = found.text(at_px, WINDOW_PX)
    assert "the displacement steps by (" in text
    assert "within 40 px of it" in text


def waves(at_px: Array, length_px: float, most_px: float) -> Array:
    return most_px * np.sin(2 * np.pi * (at_px @ np.array([[0.6, 0.8], [0.8, -0.6]])) / length_px + 0.3)


SMOOTH: dict[str, Callable[[Array], Array]] = {
    "shift": lambda at_px: 0 * at_px + [2.0, -1.0],
    "rotation": lambda at_px: at_px @ np.array([[0, 0.005], [-0.005, 0]]),
    "quadratic": lambda at_px: (at_px / 256 - 1) ** 2,
    "cubic": lambda at_px: (at_px / 256 - 1) ** 3,
    "waves of 1500 px": lambda at_px: waves(at_px, 1500, 2.0),
    "waves of 800 px": lambda at_px: waves(at_px, 800, 1.0),
    "waves of 400 px": lambda at_px: waves(at_px, 400, 1.5),
    "waves of 150 px": lambda at_px: waves(at_px, 150, 2.5),
    "slope": lambda at_px: np.tanh((at_px - 256) / 200),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_displacements_have_no_seam(name: str) -> None:
    assert seam_of(points_of(SMOOTH[name]), WINDOW_PX) is None


def test_few_points_tell_nothing() -> None:
    assert seam_of(points_of(lambda at_px: step(at_px, 2.0), 40), WINDOW_PX) is None
