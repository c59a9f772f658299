"""Rising and falling edges that lie apart make an error that all tie points share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.assessment import fit_pair
from pcwlad_geo.registration.matching import match_pair
from pcwlad_geo.registration.opening import prepare_pair
from tests.scenes import Array, make_grid, write

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
