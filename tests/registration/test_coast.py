"""Water beyond the tie points is not counted in the expected error, ground that failed to match is."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.assessment import fit_pair
from pcwlad_geo.registration.matching import match_pair
from pcwlad_geo.registration.opening import prepare_pair
from pcwlad_geo.registration.quality import Quality
from tests.scenes import make_grid, render, write

SIDE_PX = 320
SHORE_PX = 110
GRID = make_grid((SIDE_PX, SIDE_PX))


def graded(folder: Path, *, water: bool) -> tuple[Quality, tuple[str, ...]]:
    """Register a pair whose left is land; the right is water, or ground with nothing in common."""
    paths = []
    for number, moved_px in enumerate([(0.0, 0.0), (2.3, -1.4)]):
        image = render(GRID, "red", seed=1, displacement_px=moved_px)
        other = render(GRID, "red", seed=10 + number)
        if water:
            other = np.random.default_rng(number).normal(40, 1, other.shape)
        image[:, SHORE_PX:] = other[:, SHORE_PX:]
        paths.append(write(folder / f"{number}.tif", image, GRID))
    matches = match_pair(prepare_pair(*paths, Settings(prealign="georef")), InThisProcess())
    assert matches.accepted, matches.reason
    assessed = fit_pair(matches)
    return assessed.quality, assessed.warnings


def test_water_is_not_counted_and_said(tmp_path: Path) -> None:
    quality, warnings = graded(tmp_path, water=True)
    assert quality.grade in ("good", "fair")
    assert quality.expected_ce90_px < 1.0
    assert quality.extrapolated_share < 0.5
    (said,) = [text for text in warnings if "such as water" in text]
    assert "% of the common ground" in said


def test_ground_that_failed_to_match_is_counted(tmp_path: Path) -> None:
    quality, warnings = graded(tmp_path, water=False)
    assert quality.grade == "poor" or quality.extrapolated_share > 0.4
    assert not any("such as water" in text for text in warnings)
