"""Points that agree closely in too few places are matched again with smaller windows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from pcwlad_geo.options import Settings
from pcwlad_geo.registration.run import register_pair
from tests.scenes import make_grid, render, write

SIDE_PX, MARGIN_PX = 128, 10
MOVED_COL, MOVED_ROW = 3, -2
GRID = make_grid((SIDE_PX, SIDE_PX))


def half_filled(folder: Path, *, target_seed: int = 0) -> tuple[Path, Path]:
    """Write two small images of fine structure whose right half is nodata."""
    side = SIDE_PX + 2 * MARGIN_PX
    grounds = [
        ndimage.gaussian_filter(np.random.default_rng(seed).normal(100, 60, (side, side)), 1.2)
        for seed in (0, target_seed)
    ]
    paths = []
    for name, ground, col, row in zip(
        ("reference", "target"), grounds, (0, MOVED_COL), (0, MOVED_ROW), strict=True
    ):
        image = np.roll(ground, (row, col), axis=(0, 1))[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
        image[:, SIDE_PX // 2 :] = 0
        paths.append(write(folder / f"{name}.tif", image.astype(np.float32), GRID, nodata=0))
    return paths[0], paths[1]


def test_a_small_image_is_matched_with_smaller_windows(tmp_path: Path) -> None:
    found = register_pair(*half_filled(tmp_path), Settings(prealign="georef"), match_only=True)
    assert found.status == "matched", found.reason
    moved = found.tie_points.select("matched").displacement_px
    np.testing.assert_allclose(np.median(moved, axis=0), (MOVED_COL, MOVED_ROW), atol=0.02)
    assert found.window_px is not None
    assert found.window_px < 60
    assert any("too few separate places" in warning for warning in found.warnings)


def test_a_window_that_is_given_is_kept(tmp_path: Path) -> None:
    found = register_pair(*half_filled(tmp_path), Settings(prealign="georef", window=77), match_only=True)
    assert found.status == "rejected"
    assert "a smaller --window" in (found.reason or "")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_small_images_of_other_ground_are_refused(tmp_path: Path, seed: int) -> None:
    pair = half_filled(tmp_path, target_seed=seed)
    assert register_pair(*pair, Settings(prealign="georef"), match_only=True).status == "rejected"


@pytest.mark.parametrize("seed", [3, 5])
def test_an_edge_of_nodata_at_the_same_pixels_of_both_pulls_no_points(tmp_path: Path, seed: int) -> None:
    """Coarse structure beside an edge of nodata, which lies at the same pixels of both images."""
    moved_px, paths = (2.5, -1.5), []
    for name, displacement_px in (("reference", (0.0, 0.0)), ("target", moved_px)):
        image = render(GRID, "red", seed=seed, displacement_px=displacement_px)
        image[:, 60:] = 0
        paths.append(write(tmp_path / f"{name}.tif", image, GRID, nodata=0))
    found = register_pair(*paths, Settings(prealign="georef"), match_only=True)
    assert found.status == "matched", found.reason
    moved = found.tie_points.select("matched").displacement_px
    np.testing.assert_allclose(np.median(moved, axis=0), moved_px, atol=0.05)
