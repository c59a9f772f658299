"""Edges that rise or fall, or edges and grey values, lie apart: an error that all tie points share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.assessment import fit_pair
from pcwlad_geo.registration.edge_sides import shared_errors
from pcwlad_geo.registration.matching import match_pair
from pcwlad_geo.registration.opening import prepare_pair
from pcwlad_geo.registration.run import register_pair
from tests.scenes import Array, make_grid, render, write

SIDE_PX = 200
GRID = make_grid((SIDE_PX, SIDE_PX))


def things(*, wider_px: float) -> Array:
    """Return an image of smooth things on even ground whose outlines lie so far outside of the true ones."""
    noise = ndimage.gaussian_filter(np.random.default_rng(2).normal(size=(4 * SIDE_PX,) * 2), 14)
    inside = noise > np.percentile(noise, 65)
    outside_px = ndimage.distance_transform_edt(~inside) - ndimage.distance_transform_edt(inside)
    fine = np.where(outside_px < 4 * wider_px, 180.0, 60.0)
    image = fine.reshape(SIDE_PX, 4, SIDE_PX, 4).mean(axis=(1, 3))
    return image + np.random.default_rng(3).normal(0, 2, image.shape)


@pytest.mark.parametrize(("wider_px", "told_px"), [(1.0, 1.0), (0.0, 0.0)])
def test_outlines_at_different_places_are_an_error_of_all_points(
    tmp_path: Path, wider_px: float, told_px: float
) -> None:
    paths = [
        write(tmp_path / f"{name}.tif", things(wider_px=by), GRID)
        for name, by in (("image", 0.0), ("heights", wider_px))
    ]
    matches = match_pair(prepare_pair(*paths, Settings(prealign="georef")), InThisProcess())
    quality = fit_pair(matches).quality
    warned = [text for text in matches.warnings if "rising and falling edges" in text]
    if told_px == 0:
        assert not warned
        assert quality.grade == "good"
        assert quality.expected_ce90_px < 0.3
    else:
        assert len(warned) == 1
        assert quality.grade != "good"
        # of an error in each axis, 90 % lie within 2.15 times its size
        assert quality.expected_ce90_px == pytest.approx(2.15 * told_px, rel=0.4)


@pytest.mark.parametrize("off_px", [(0.0, 0.0), (0.4, -0.3)])
@pytest.mark.parametrize("band", ["red", "thermal"])
def test_grey_values_beside_the_points_are_an_error_of_all_points(
    tmp_path: Path, band: str, off_px: tuple[float, float]
) -> None:
    """Of another band they tell nothing."""
    paths = [
        write(tmp_path / f"{name}.tif", render(GRID, shown, noise=2), GRID)
        for name, shown in (("reference", "red"), ("target", band))
    ]
    at_px = np.random.default_rng(4).uniform(20, SIDE_PX - 20, (100, 2))
    points = TiePoints(
        reference_xy_px=at_px,
        target_xy_px=at_px + off_px,
        covariance_px2=np.tile(0.01 * np.eye(2), (100, 1, 1)),
        score=np.ones(100),
        forward_backward_px=np.zeros((100, 2)),
    )
    errors = shared_errors(prepare_pair(*paths, Settings()).views, points)
    expected_px = np.abs(off_px) / 2 if band == "red" else np.zeros(2)
    np.testing.assert_allclose(errors.of_light_px, expected_px, atol=0.05)


@pytest.mark.slow
def test_slopes_in_other_light_are_no_better_than_grey_values_tell(shared_data: Path) -> None:
    case = shared_data / "field" / "hirise_light"
    if not case.is_dir():
        pytest.skip(f"no {case}")
    result = register_pair(case / "before.tif", case / "after.tif", Settings())
    assert result.quality is not None
    assert 0.35 < result.quality.expected_ce90_px < 0.7
