"""The joint adjustment of RPCs, of points whose truth is known, and what it says of the DEM."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray

from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.multi.block.adjustment import BlockAdjustment, adjust_block
from pcwlad_geo.multi.block.block import BlockPair, RpcBlock
from pcwlad_geo.multi.block.dem_check import check_dem
from pcwlad_geo.multi.stack.rpc_result import adjust_rpcs
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Dem, Grid, RpcGrid, map_px
from pcwlad_geo.raster.rpc.dem import Undulation
from pcwlad_geo.raster.rpc.grid import with_height_offset
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.registration.rpc import height_errors
from tests.multi.rpc_views import grids_of_views, view_rpc
from tests.rpc_scene import (
    ORIGIN_XY_M,
    SHAPE,
    UNDULATION_M,
    decimated,
    dem_grid,
    dem_values,
    rpc_grid,
    write_dem,
)
from tests.scenes import CRS_OF_SCENE

Array = NDArray[np.float64]

STEEP = ((2.0, 1.5), (-2.0, 1.0), (0.5, -3.0))
"""Views in which ten metres of height are some tenths of a pixel."""
NOISE_PX = 0.03


@pytest.fixture(scope="module")
def grids(tmp_path_factory: pytest.TempPathFactory) -> tuple[RpcGrid, ...]:
    return grids_of_views(tmp_path_factory.mktemp("dem"), STEEP)


def observed(
    grids: tuple[RpcGrid, ...], biases: Array, ends: tuple[int, int], n: int = 300, seed: int = 0
) -> BlockPair:
    """Tie points of two images that lie beside where their RPCs say, in px (col, row)."""
    rng = np.random.default_rng(seed + 10 * ends[0] + ends[1])
    first = rng.uniform((20.0, 20.0), (SHAPE[1] - 20.0, SHAPE[0] - 20.0), (n, 2))
    second = map_px(first, grids[ends[0]], grids[ends[1]])
    known = np.isfinite(second).all(axis=1)
    first, second = first[known] + biases[ends[0]], second[known] + biases[ends[1]]
    second = second + rng.normal(0.0, NOISE_PX, second.shape)
    return BlockPair(*ends, first, second, np.tile(NOISE_PX**2 * np.eye(2), (len(second), 1, 1)))


def moved(grid: RpcGrid, by_px: tuple[float, float]) -> RpcGrid:
    """Return a grid whose DEM lies elsewhere, by so many of its pixels (col, row)."""
    assert isinstance(grid.heights, Dem)
    dem = grid.heights
    return replace(grid, heights=replace(dem, grid=dem.grid.part(by_px, dem.grid.shape)))


def shifts(found: object, count: int) -> Array:
    middle = np.array([[SHAPE[1] / 2, SHAPE[0] / 2]])
    corrections = found.corrections[:count]  # type: ignore[attr-defined]
    return np.concatenate([each.forward(middle) - middle for each in corrections])


BIASES = np.array([[2.0, -1.0], [-1.5, 2.5], [0.5, 0.5]])
PAIRS = ((0, 1), (0, 2), (1, 2))


def test_biases_are_found_where_an_image_stays(grids: tuple[RpcGrid, ...]) -> None:
    biases = BIASES - BIASES[0]
    pairs = [observed(grids, biases, ends) for ends in PAIRS]
    found = adjust_block(RpcBlock(grids, ground_grid(grids[0]), frozenset({0})), pairs)
    assert found.model == "shift"
    assert shifts(found, 3) == pytest.approx(biases, abs=0.02)
    for image in (1, 2):
        sigma = np.sqrt(np.diagonal(found.covariance(image, np.array([[100.0, 100.0]]))[0]))
        assert (np.abs(shifts(found, 3) - biases)[image] < 4 * sigma).all()


def test_without_a_reference_the_mean_stays(grids: tuple[RpcGrid, ...]) -> None:
    pairs = [observed(grids, BIASES, ends) for ends in PAIRS]
    found = adjust_block(RpcBlock(grids, ground_grid(grids[0])), pairs, ("shift",))
    assert found.datum_rank == 2
    away = shifts(found, 3) - BIASES
    assert away == pytest.approx(np.tile(away.mean(axis=0), (3, 1)), abs=0.15)  # views differ in scale
    assert shifts(found, 3).mean(axis=0) == pytest.approx(np.zeros(2), abs=0.1)


def test_a_drift_is_chosen_where_the_points_show_it(grids: tuple[RpcGrid, ...]) -> None:
    pair = observed(grids, np.zeros((3, 2)), (0, 1))
    drift = (pair.second_px[:, 1:] / SHAPE[0] - 0.5) * np.array([[0.8, -0.5]])
    found = adjust_block(
        RpcBlock(grids, ground_grid(grids[0]), frozenset({0})),
        [replace(pair, second_px=pair.second_px + drift)],
    )
    assert found.model == "drift"
    ends = np.array([[160.0, 0.0], [160.0, SHAPE[0]]])
    moved_px = found.corrections[1].forward(ends) - ends
    assert moved_px[1] - moved_px[0] == pytest.approx([0.8, -0.5], abs=0.03)


def test_a_wrong_pair_is_left_out_where_others_check_it(grids: tuple[RpcGrid, ...]) -> None:
    four = (*grids, grids[0])
    biases = np.vstack([BIASES - BIASES[0], [[1.0, 1.0]]])
    pairs = [observed(four, biases, ends) for ends in (*PAIRS, (0, 3), (1, 3), (2, 3))]
    pairs[4] = replace(pairs[4], second_px=pairs[4].second_px + np.array([4.0, -3.0]))
    found = adjust_block(RpcBlock(four, ground_grid(grids[0]), frozenset({0})), pairs, ("shift",))
    assert [fit.in_use for fit in found.edges] == [True, True, True, True, False, True]
    assert shifts(found, 4) == pytest.approx(biases, abs=0.05)
    assert found.edges[4].offset_px == pytest.approx((4.0, -3.0), abs=0.1)


def test_control_points_fix_the_block_and_a_wrong_one_hardly_counts(grids: tuple[RpcGrid, ...]) -> None:
    pairs = [observed(grids, BIASES, ends) for ends in PAIRS]
    frame = ground_grid(grids[0])
    at_px = np.random.default_rng(5).uniform(60.0, 240.0, (6, 2))
    ground = map_px(at_px, grids[1], frame)
    _, height_m = grids[1].line_of_sight(at_px)
    height_m[2:] = np.nan  # the DEM's
    seen = at_px + BIASES[1]
    seen[4] += (20.0, 0.0)
    control = BlockPair(3, 1, ground, seen, np.tile(0.05**2 * np.eye(2), (6, 1, 1)), height_m)
    found = adjust_block(RpcBlock((*grids, frame), frame), [*pairs, control], ("shift",))
    assert found.datum_rank == 0
    assert shifts(found, 3) == pytest.approx(BIASES, abs=0.06)


@pytest.mark.parametrize("too_high_m", [-300.0, pytest.param(300.0, marks=pytest.mark.slow)])
def test_a_dem_that_is_too_high_is_told(grids: tuple[RpcGrid, ...], too_high_m: float) -> None:
    pairs = [observed(grids, 0.1 * BIASES, ends) for ends in PAIRS]
    wrong = tuple(with_height_offset(grid, too_high_m) for grid in grids)
    block = RpcBlock(wrong, ground_grid(grids[0]))
    check = check_dem(block, pairs, adjust_block(block, pairs, ("shift",)), absolute=False)
    assert check is not None
    assert check.too_high_m == pytest.approx(too_high_m, abs=30.0)
    assert any("too high" if too_high_m > 0 else "too low" in each for each in check.faults)


def test_a_dem_beside_its_place_is_told_and_moved_back(grids: tuple[RpcGrid, ...]) -> None:
    biases = BIASES - BIASES[0]
    pairs = [observed(grids, biases, ends) for ends in PAIRS]
    wrong = tuple(moved(grid, (4.0, -3.0)) for grid in grids)  # 60 m px
    block = RpcBlock(wrong, ground_grid(grids[0]), frozenset({0}))
    found = adjust_block(block, pairs, ("shift",))
    check = check_dem(block, pairs, found, absolute=True)
    assert check is not None
    assert check.offset_m == pytest.approx((240.0, 180.0), abs=15.0)
    assert len(check.faults) == 1
    assert "beside" in check.faults[0]
    assert shifts(found, 3) == pytest.approx(biases, abs=0.05)


def seen_in_windows(
    grids: tuple[RpcGrid, ...], wrong: tuple[RpcGrid, ...], ends: tuple[int, int], window_px: float
) -> BlockPair:
    """Tie points of windows matched over a wrong DEM: each has the median displacement in its window."""
    rng = np.random.default_rng(ends[0] + 10 * ends[1])
    first = rng.uniform((60.0, 60.0), (SHAPE[1] - 60.0, SHAPE[0] - 60.0), (300, 2))
    aside = (np.arange(7) / 6 - 0.5) * window_px
    asides = np.stack(np.meshgrid(aside, aside), axis=-1).reshape(-1, 2)
    around = (first + asides[:, None]).reshape(-1, 2)
    true, seen = (map_px(around, each[ends[0]], each[ends[1]]) for each in (grids, wrong))
    off = (true - seen).reshape(len(asides), -1, 2)
    second = map_px(first, wrong[ends[0]], wrong[ends[1]]) + np.median(off, axis=0)
    second += rng.normal(0.0, NOISE_PX, second.shape)
    covariance_px2 = np.tile(NOISE_PX**2 * np.eye(2), (300, 1, 1))
    return BlockPair(*ends, first, second, covariance_px2, window_px=window_px)


@pytest.mark.slow
def test_windows_that_see_much_relief_tell_where_the_dem_lies(grids: tuple[RpcGrid, ...]) -> None:
    wrong, window_px = tuple(moved(grid, (4.0, -3.0)) for grid in grids), 41.0
    pairs = [seen_in_windows(grids, wrong, ends, window_px) for ends in PAIRS]
    points = [replace(pair, window_px=0.0) for pair in pairs]  # as if each told of its middle alone
    found = [
        adjust_block(RpcBlock(wrong, ground_grid(grids[0])), each, ("shift",)).dem_shift_px
        for each in (pairs, points)
    ]
    errors_px = np.hypot(*(np.array(found) - (-4.0, 3.0)).T)
    assert errors_px[0] < 0.3 < 0.5 < errors_px[1]


def test_a_right_dem_is_not_called_wrong(grids: tuple[RpcGrid, ...]) -> None:
    pairs = [observed(grids, BIASES, ends) for ends in PAIRS]
    block = RpcBlock(grids, ground_grid(grids[0]))
    check = check_dem(block, pairs, adjust_block(block, pairs, ("shift",)), absolute=False)
    assert check is not None
    assert check.faults == ()
    assert check.scale == pytest.approx(0.0, abs=0.01)


def test_heights_held_in_memory_are_those_of_the_file(tmp_path: Path) -> None:
    grid = rpc_grid(write_dem(tmp_path / "dem.tif"))
    assert isinstance(grid.heights, Dem)
    lon_lat, height_m = grid.line_of_sight(grid.lattice_px(7))
    held = grid.heights.held(lon_lat[:10])
    assert held is not grid.heights
    assert held.at(lon_lat) == pytest.approx(height_m, abs=1e-3)  # also beside what is held


FINE = 60.0
"""So many pixels of half a metre are as long as one of the scene, of which a small part is seen."""
SMALL = (500, 500)
LEANING = ((0.25, 0.15), (-0.2, 0.25))
"""Views in which a metre of height sets two images of half a metre per pixel half a pixel apart."""
SMALL_BIASES = np.array([[2.0, -1.5], [-2.0, 1.5]])


def small_views(folder: Path, spacing_m: float, noise_m: float, seed: int) -> tuple[list[RpcGrid], ...]:
    """Return the grids of two small images over the true DEM, and over a coarse one of noisy heights."""
    rng = np.random.default_rng(seed)
    side = int(6000.0 / spacing_m)
    corner = ORIGIN_XY_M + np.array([1500.0, -1500.0]) + rng.uniform(0.0, spacing_m, 2)
    coarse = Grid((side, side), Affine(spacing_m, 0.0, corner[0], 0.0, -spacing_m, corner[1]), CRS_OF_SCENE)
    values = dem_values(coarse) + rng.normal(0.0, noise_m, (side, side))
    true, given = write_dem(folder / "true.tif"), write_dem(folder / "given.tif", values, coarse)
    found: tuple[list[RpcGrid], ...] = ([], [])
    for view in LEANING:
        rpc = decimated(view_rpc(view), 1 / FINE)
        rpc = replace(rpc, samp_off=rpc.samp_off - 150 * FINE, line_off=rpc.line_off - 130 * FINE)
        for path, grid, grids in zip((true, given), (dem_grid(), coarse), found, strict=True):
            heights = Dem(str(path), grid, 1.0, Undulation.constant(UNDULATION_M))
            grids.append(replace(RpcGrid.of_file(SMALL, rpc, heights), crs=CRS_OF_SCENE))
    return found


def seen_small(true: list[RpcGrid], biases: Array, seed: int = 0) -> BlockPair:
    """Tie points of two small images with biases, px (col, row)."""
    rng = np.random.default_rng(seed)
    first = rng.uniform(40.0, 460.0, (400, 2))
    second = map_px(first, true[0], true[1]) + rng.normal(0.0, NOISE_PX, (400, 2))
    covariance_px2 = np.tile(NOISE_PX**2 * np.eye(2), (400, 1, 1))
    return BlockPair(0, 1, first + biases[0], second + biases[1], covariance_px2)


def left_over(grids: list[RpcGrid], pair: BlockPair, found: BlockAdjustment | None = None) -> Array:
    """Return by how much points lie apart over a DEM, px, without the adjustment's own equations."""
    if found is None:
        return pair.second_px - map_px(pair.first_px, grids[0], grids[1])
    one, other = found.corrections[:2]
    return other.inverse(pair.second_px) - map_px(one.inverse(pair.first_px), grids[0], grids[1])


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize(("spacing_m", "noise_m"), [(90.0, 8.0), (90.0, 0.0), (30.0, 3.0)])
def test_a_small_block_does_not_bend_to_its_dem(
    tmp_path: Path, spacing_m: float, noise_m: float, seed: int
) -> None:
    true, given = small_views(tmp_path, spacing_m, noise_m, seed)
    pair = seen_small(true, SMALL_BIASES, seed)
    block = RpcBlock(tuple(given), ground_grid(given[0]))
    found = adjust_block(block, [pair])
    check = check_dem(block, [pair], found, absolute=False)
    assert check is not None
    assert not found.dem_moved
    assert not any("beside" in each or " % too " in each for each in check.faults)
    before_px, after_px = left_over(given, pair), left_over(given, pair, found)
    assert np.hypot(*np.median(after_px, axis=0)) < 0.1
    assert found.hold_out is not None
    assert not found.hold_out.worse
    assert found.hold_out.before_px == pytest.approx(np.hypot(*before_px.T).mean(), rel=1e-3)
    assert np.hypot(*after_px.T).mean() < found.hold_out.after_px < found.hold_out.before_px
    # many points on few pixels of a DEM tell little of the biases along the parallax
    middle_px = np.array([[250.0, 250.0]])
    moved_px = [each.forward(middle_px)[0] - middle_px[0] for each in found.corrections[:2]]
    off_px = np.hypot(*(moved_px[1] - moved_px[0] - (SMALL_BIASES[1] - SMALL_BIASES[0])))
    sigma_px = [np.sqrt(np.trace(found.covariance(image, middle_px)[0])) for image in (0, 1)]
    assert off_px < 3 * sum(sigma_px)


def test_a_rough_dem_is_told_and_no_reason_for_a_drift(tmp_path: Path) -> None:
    true, given = small_views(tmp_path, 90.0, 12.0, 1)
    placed = SimpleNamespace(block=RpcBlock(tuple(given), ground_grid(given[0])), placements=[object()] * 2)
    found, check = adjust_rpcs(placed, [seen_small(true, SMALL_BIASES)], Settings())  # type: ignore[arg-type]
    assert found.model == "shift"
    assert check is not None
    assert len(check.faults) == 1
    assert "scatter" in check.faults[0]


def test_residuals_along_the_parallax_of_a_pair_are_laid_to_the_dem(tmp_path: Path) -> None:
    true, given = small_views(tmp_path, 90.0, 12.0, 1)
    pair = seen_small(true, SMALL_BIASES)

    def told(grids: list[RpcGrid]) -> str | None:
        points = SimpleNamespace(reference_px=pair.first_px, residual_px=left_over(grids, pair))
        return height_errors(*grids, points)  # type: ignore[arg-type]

    assert told(true) is None
    found = told(given) or ""
    # 1.6 times the noise of the DEM, less what is averaged between its nodes
    assert 8.0 < float(found.split("errs by ")[1].split(" m")[0]) < 20.0


def test_corrections_that_do_harm_are_refused(tmp_path: Path) -> None:
    true, given = small_views(tmp_path, 30.0, 0.0, 0)
    displaced = [moved(grid, (6.0, -6.0)) for grid in given]
    # the RPCs err by just what hides the wrong place of the DEM
    hidden = np.median(left_over(displaced, seen_small(true, np.zeros((2, 2)))), axis=0)
    assert np.hypot(*hidden) > 2.0
    pair = seen_small(true, np.array([hidden, -hidden]) / 2)
    placed = SimpleNamespace(
        block=RpcBlock(tuple(displaced), ground_grid(given[0])), placements=[object()] * 2
    )
    with pytest.raises(RegistrationRejectedError, match=r"held out lie .* px apart .* beside"):
        adjust_rpcs(placed, [pair], Settings())  # type: ignore[arg-type]


def test_another_scale_of_heights_is_told(grids: tuple[RpcGrid, ...]) -> None:
    pairs = [observed(grids, 0.1 * BIASES, ends) for ends in PAIRS]
    wrong = []
    for grid in grids:
        assert isinstance(grid.heights, Dem)
        wrong.append(replace(grid, heights=replace(grid.heights, metres_per_unit=1.1)))
    block = RpcBlock(tuple(wrong), ground_grid(grids[0]))
    check = check_dem(block, pairs, adjust_block(block, pairs, ("shift",)), absolute=False)
    assert check is not None
    assert check.scale == pytest.approx(0.1, abs=0.02)
    assert any("10 % too high" in each or "9 % too high" in each for each in check.faults)
