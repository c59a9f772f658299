"""Pairs whose structure tells too little, and whose grey values depend on each other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from pcwlad_geo.options import Settings
from pcwlad_geo.registration.opening import prepare_pair
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.registration.starts.alignment import StartingAlignment, direct_start
from pcwlad_geo.registration.starts.overviews import read_overviews
from tests.scenes import Array, make_grid, write

SIDE = 400
GRID = make_grid((SIDE, SIDE))
SHIFT_PX = np.array([2.3, -1.6])


def blobs(seed: int, sigma_px: float, side: int = SIDE) -> Array:
    values = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(side, side)), sigma_px)
    return values / values.std()


def bands(ground: int, target_ground: int | None = None) -> tuple[Array, Array]:
    """Return two bands of a ground: bright in the one is bright or dark in the other; textures differ."""
    first = blobs(ground, 5.0, SIDE + 80)
    other = first if target_ground is None else blobs(target_ground, 5.0, SIDE + 80)
    col, row = SHIFT_PX
    moved = ndimage.shift(np.abs(other), (row, col), order=3)
    inside = np.s_[40:-40, 40:-40]
    return 100 + 5 * (first[inside] + 0.5 * blobs(8, 1.2)), 100 + 5 * (moved[inside] + 0.5 * blobs(9, 1.2))


def pair(folder: Path, bands: tuple[Array, Array], grid: bool = True) -> tuple[Path, Path]:
    where = GRID if grid else None
    return write(folder / "ref.tif", bands[0], where), write(folder / "tgt.tif", bands[1], where)


def error_px(found: Registration) -> Array:
    points = found.tie_points
    return points.displacement_px[points.status != "rejected"] - SHIFT_PX


@pytest.mark.parametrize(
    "settings",
    [
        Settings(prealign="georef", features=600),
        pytest.param(Settings(), marks=pytest.mark.slow),
        pytest.param(Settings(tile_size=256), marks=pytest.mark.slow),
    ],
    ids=["few", "whole", "tiles"],
)
def test_grey_values_register_what_structure_does_not(settings: Settings, tmp_path: Path) -> None:
    found = register_pair(*pair(tmp_path, bands(1)), settings)
    assert found.status == "registered"
    assert found.prealignment.matched_by == "grey values"
    assert any("their grey values" in text for text in found.warnings)
    error = error_px(found)
    assert len(error) > 300
    assert np.hypot(*np.median(error, axis=0)) < 0.3
    assert np.percentile(np.hypot(*error.T), 90) < 2 * found.quality.expected_ce90_px
    assert found.tie_points.sigma_px.mean() > 0.2  # which they share


def test_grey_values_of_other_ground_are_refused(tmp_path: Path) -> None:
    assert register_pair(*pair(tmp_path, bands(1, 2)), Settings(prealign="georef")).status == "rejected"


@pytest.mark.parametrize("method", ["gradient", pytest.param("pcwlad", marks=pytest.mark.slow)])
def test_a_method_that_was_chosen_is_kept_to(method: str, tmp_path: Path) -> None:
    settings = Settings(prealign="georef", method=method, features=300)  # type: ignore[arg-type]
    assert register_pair(*pair(tmp_path, bands(1)), settings).prealignment.matched_by == "structure"


def test_the_relation_is_measured_where_both_lie_over_each_other(tmp_path: Path) -> None:
    """As the grids place them, which differ by 60 and 40 px."""
    first, second = bands(1)
    reference, _ = pair(tmp_path, (first, second))
    moved = make_grid((SIDE - 80, SIDE - 60), offset_m=(60 * 30, 40 * 30))
    target = write(tmp_path / "moved.tif", second[40:-40, 60:], moved)
    tones = []
    for each in (tmp_path / "tgt.tif", target):
        described = prepare_pair(reference, each, Settings())
        overviews = read_overviews(described.views)
        start = StartingAlignment(direct_start(described.views, Settings()), described.views, overviews)
        by_tones = start.by_tones(Settings())
        assert by_tones is not None
        assert by_tones.matches_tones
        assert not start.matches_tones
        scenes = by_tones.overviews.scenes
        assert replace(scenes[0], tones=None) == start.overviews.scenes[0]
        tones.append([np.array(scene.tones.weights) for scene in scenes if scene.tones])
    for one, other in zip(*tones, strict=True):
        np.testing.assert_allclose(np.abs(one), np.abs(other), atol=0.2)
