"""Water beyond the tie points is not counted in the expected error, ground that failed to match is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.assessment import fit_pair
from pcwlad_geo.registration.matching import match_pair
from pcwlad_geo.registration.opening import prepare_pair
from pcwlad_geo.registration.result import Matches
from tests.scenes import make_grid, render, write

SIDE_PX = 320
SHORE_PX = 110
GRID = make_grid((SIDE_PX, SIDE_PX))


def matched(folder: Path, *, water: bool) -> Matches:
    """Match a pair whose left is land; the right is water, or ground with nothing in common."""
    paths = []
    for number, moved_px in enumerate([(0.0, 0.0), (2.3, -1.4)]):
        image = render(GRID, "red", seed=1, displacement_px=moved_px)
        other = render(GRID, "red", seed=10 + number)
        if water:
            other = np.random.default_rng(number).normal(40, 1, other.shape)
        image[:, SHORE_PX:] = other[:, SHORE_PX:]
        paths.append(write(folder / f"{number}.tif", image, GRID))
    matches = match_pair(prepare_pair(*paths, Settings(prealign="georef", features=400)), InThisProcess())
    assert matches.accepted, matches.reason
    return matches


@pytest.fixture(scope="module")
def coast(tmp_path_factory: pytest.TempPathFactory) -> Matches:
    """Return a coast, matched."""
    return matched(tmp_path_factory.mktemp("coast"), water=True)


def test_water_is_not_counted_and_said(coast: Matches) -> None:
    assessed = fit_pair(coast)
    quality, warnings = assessed.quality, assessed.warnings
    assert quality.grade in ("good", "fair")
    assert quality.expected_ce90_px < 1.0
    assert quality.extrapolated_share < 0.5
    (said,) = [text for text in warnings if "such as water" in text]
    assert "% of the common ground" in said
    assert not any("bends beyond" in text for text in warnings)


def test_a_correction_that_bends_on_over_water_is_not_good(coast: Matches) -> None:
    points = coast.every
    along = points.predicted_px[:, :1] / SHORE_PX
    curved = replace(points, target_px=points.target_px + 1.5 * along**2 * [1.0, 0.5])
    assessed = fit_pair(
        replace(coast, tie_points=curved, every=curved), replace(coast.pair.settings, model="polynomial")
    )
    assert assessed.quality.grade != "good"
    assert any("bends beyond the tie points" in reason.text for reason in assessed.quality.reasons)


def test_ground_that_failed_to_match_is_counted(tmp_path: Path) -> None:
    assessed = fit_pair(matched(tmp_path, water=False))
    quality, warnings = assessed.quality, assessed.warnings
    assert quality.grade == "poor" or quality.extrapolated_share > 0.4
    assert not any("such as water" in text for text in warnings)
