"""Where the matching starts from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid, ViewPair, describe, plan_views
from pcwlad_geo.registration.starts.alignment import Prealignment, by_georeferencing, target_offset_px
from pcwlad_geo.registration.starts.overviews import read_overviews
from pcwlad_geo.registration.starts.parameters import START
from pcwlad_geo.registration.starts.searches import by_search
from tests.scenes import Array, make_grid, render, write

GRID = make_grid((240, 260))


def views(folder: Path, target: Array, grid: Grid | None = GRID, reference: Array | None = None) -> ViewPair:
    values = render(GRID) if reference is None else reference
    first = write(folder / "ref.tif", values, None if grid is None else GRID)
    return plan_views(describe(first), describe(write(folder / "tgt.tif", target, grid)))


def test_georeferencing_is_believed_within_a_radius() -> None:
    assert by_georeferencing(None) == Prealignment("georeferencing", (0.0, 0.0), START.radius_px)
    assert by_georeferencing(30).search_radius_px == 30


@pytest.mark.parametrize("georeferenced", [True, False])
@pytest.mark.parametrize("shift_px", [(52.3, -31.8), (-44.0, 20.6)])
def test_search_finds_the_shift(georeferenced: bool, shift_px: tuple[float, float], tmp_path: Path) -> None:
    target = render(GRID, "thermal", displacement_px=shift_px)
    pair = views(tmp_path, target, GRID if georeferenced else None)
    found, result = by_search(pair, read_overviews(pair), None)
    assert found is not None
    assert result.accepted
    assert found.method == "search"
    # the matching looks that far around it
    assert np.abs(np.array(found.shift_px) - shift_px).max() < 2 < found.search_radius_px


def test_search_is_on_top_of_the_georeferencing(tmp_path: Path) -> None:
    """Its shift is the displacement, not the offset between the two grids."""
    grid = make_grid((240, 260), offset_m=(1215, -300))
    pair = views(tmp_path, render(grid, displacement_px=(25.0, 14.0)), grid)
    assert pair.offset_px == (-40.5, 10.0)
    found, _ = by_search(pair, read_overviews(pair), None)
    assert found is not None
    np.testing.assert_allclose(found.shift_px, (25, 14), atol=2)
    np.testing.assert_allclose(target_offset_px(pair, found), (-15.5, 24), atol=2.6)


def test_search_finds_nothing_in_another_scene(tmp_path: Path) -> None:
    pair = views(tmp_path, render(GRID, seed=9))
    found, result = by_search(pair, read_overviews(pair), None)
    assert found is None
    assert not result.accepted


def test_a_given_radius_is_kept_after_the_search(tmp_path: Path) -> None:
    pair = views(tmp_path, render(GRID, displacement_px=(30.0, 10.0)))
    found, _ = by_search(pair, read_overviews(pair), 5)
    assert found is not None
    assert found.search_radius_px == 5


def test_the_look_has_one_resolution_and_is_small(tmp_path: Path) -> None:
    wide = make_grid((100, 2300))
    pair = plan_views(
        describe(write(tmp_path / "ref.tif", render(GRID), GRID)),
        describe(write(tmp_path / "tgt.tif", render(wide), wide)),
    )
    look = read_overviews(pair)
    assert look.factor == pytest.approx(2300 / START.overview_side_px)
    assert max(look.target.values.shape) <= START.overview_side_px
    for patch, view in ((look.reference, pair.reference), (look.target, pair.target)):
        np.testing.assert_allclose(np.array(view.grid.shape) / patch.values.shape, look.factor, rtol=0.02)


def test_nothing_to_match_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"tgt\.tif is constant where the two overlap.*another band"):
        read_overviews(views(tmp_path, np.full(GRID.shape, 7.0)))
    empty = np.full(GRID.shape, np.nan)
    first = write(tmp_path / "ref.tif", empty, GRID, dtype="float32")
    pair = plan_views(describe(first), describe(write(tmp_path / "tgt.tif", render(GRID), GRID)))
    with pytest.raises(InputError, match=r"ref\.tif has no valid pixel.*nodata"):
        read_overviews(pair)


@pytest.mark.parametrize("shift_px", [(0.4, -0.4), (3.6, 2.2)])
def test_the_start_is_a_whole_pixel(shift_px: tuple[float, float], tmp_path: Path) -> None:
    grid = make_grid((240, 260), offset_m=(12, 99))  # (0.4, 3.3) px
    pair = views(tmp_path, render(grid), grid)
    start = target_offset_px(pair, Prealignment("search", shift_px, 8))
    np.testing.assert_array_equal(start, np.round(np.array([-0.4, -3.3]) + shift_px))
