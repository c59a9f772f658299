"""Where the pixels of an output lie and how large they are: round sizes, shared corners, wishes."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.crs import CRS

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.grid import Grid, map_px
from pcwlad_geo.raster.output_grid import (
    GridRequest,
    check_covered,
    corrected_outline,
    output_grid,
    output_grids,
)

UTM32, UTM33 = CRS.from_epsg(32632), CRS.from_epsg(32633)
WGS84, MERCATOR = CRS.from_epsg(4326), CRS.from_epsg(3857)
LAEA, FEET = CRS.from_epsg(3035), CRS.from_epsg(2263)
REFERENCE = Grid((400, 420), Affine(30.0, 0.0, 412_185.0, 0.0, -30.0, 5_278_215.0), UTM33)
NONE = AffineCorrection("shift", np.array([[1.0, 0, 0], [0, 1.0, 0]]))
SHIFT = AffineCorrection("shift", np.array([[1.0, 0, 1.37], [0, 1.0, -0.61]]))


def at(crs: CRS, size: float, shape: tuple[int, int] = (300, 320), *, rotated: bool = False) -> Grid:
    """Return a grid over the reference, in another CRS, with its corner anywhere."""
    x, y = transform_xy(np.array([[413_000.0, 5_277_000.0]]), UTM33, crs)[0]
    place = Affine.translation(x, y) @ Affine.rotation(30.0 if rotated else 0.0) @ Affine.scale(size, -size)
    return Grid(shape, place, crs)


def corners(grid: Grid) -> list[tuple[float, float]]:
    rows, cols = grid.shape
    return [tuple(xy) for xy in grid.to_xy(np.array([[0.0, 0.0], [cols, rows]])).tolist()]


@pytest.mark.parametrize("size", [15.0, 0.3, 7.5, 0.1, 30.0, 12.0, 60.0])
def test_pixel_sizes_of_the_source_are_kept_exactly(size: float) -> None:
    target = Grid((40, 50), Affine(30.0, 0.0, 412_072.5, 0.0, -30.0, 5_278_297.5), UTM33)
    band = Grid((40, 50), Affine(size, 0.0, 412_080.0, 0.0, -size, 5_278_290.0), UTM33)
    (grid,) = output_grids(REFERENCE, target, SHIFT, None, [band])
    assert (grid.transform.a, grid.transform.e) == (size, -size)
    assert (grid.transform.b, grid.transform.d) == (0.0, 0.0)


def test_bands_of_a_target_share_their_corners() -> None:
    """Of Landsat: the corner of the 15 m band lies 7.5 m from that of the others."""
    target = Grid((80, 90), Affine(30.0, 0.0, 412_072.5, 0.0, -30.0, 5_278_297.5), UTM33)
    pan = Grid((159, 179), Affine(15.0, 0.0, 412_080.0, 0.0, -15.0, 5_278_290.0), UTM33)
    thermal = Grid((27, 30), Affine(90.0, 0.0, 412_072.5, 0.0, -90.0, 5_278_297.5), UTM33)
    for correction in (NONE, SHIFT):
        grids = output_grids(REFERENCE, target, correction, None, [target, pan])
        assert corners(grids[0]) == corners(grids[1])
        assert grids[1].shape == (2 * grids[0].shape[0], 2 * grids[0].shape[1])
        # one by one they are the same: a band that is warped later fits to what is there
        assert output_grids(REFERENCE, target, correction, None, [pan]) == grids[1:]
        assert output_grid(REFERENCE, target, correction) == grids[0]
        wider = output_grids(REFERENCE, target, correction, None, [target, pan, thermal])
        assert len({tuple(corners(grid)) for grid in wider}) == 1
        offset = REFERENCE.to_px(np.array(corners(wider[0]))) / 3  # aligned at the coarsest, 90 m
        assert offset == pytest.approx(np.rint(offset), abs=1e-9)


@settings(max_examples=60)
@given(
    sizes=st.lists(st.sampled_from([10.0, 20.0, 30.0, 60.0, 15.0, 5.0, 2.5]), min_size=1, max_size=4),
    shift=st.tuples(st.floats(-40, 40), st.floats(-40, 40)),
    corner=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
)
def test_bands_share_an_extent_that_holds_the_target(
    sizes: list[float], shift: tuple[float, float], corner: tuple[float, float]
) -> None:
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), shift]))
    x, y = 413_000 + corner[0], 5_277_000 + corner[1]
    bands = [Grid((round(3600 / size),) * 2, Affine(size, 0, x, 0, -size, y), UTM33) for size in sizes]
    target = Grid((120, 120), Affine(30.0, 0, x, 0, -30.0, y), UTM33)
    target_out, *grids = output_grids(REFERENCE, target, correction, None, [target, *bands])
    inside = map_px(correction.inverse(target.boundary_px()), target, target_out)
    slack = 2e-3 * max([30.0, *sizes]) / 30.0
    assert (inside >= -slack).all()
    assert (inside <= np.array(target_out.shape[::-1]) + slack).all()
    divisible = [grid for grid, size in zip(grids, sizes, strict=True) if max([30.0, *sizes]) % size == 0]
    assert len({tuple(corners(grid)) for grid in divisible}) <= 1
    assert len({corners(grid)[0] for grid in grids}) == 1


def test_a_band_that_reaches_far_beyond_the_target_keeps_what_it_shows() -> None:
    target = Grid((80, 90), Affine(30.0, 0.0, 412_785.0, 0.0, -30.0, 5_277_015.0), UTM33)
    whole = Grid((400, 500), Affine(15.0, 0.0, 411_885.0, 0.0, -15.0, 5_278_215.0), UTM33)
    first, second = output_grids(REFERENCE, target, NONE, None, [target, whole])
    assert corners(first) == corners(second) == corners(whole)


@pytest.mark.parametrize("reference_m", [10.0, 12.0, 20.0, 25.0, 30.0, 100.0])
@pytest.mark.parametrize("crs", [UTM32, LAEA], ids=["UTM 32", "LAEA"])
@pytest.mark.parametrize("rotated", [False, True])
def test_metres_stay_metres_in_another_crs(reference_m: float, crs: CRS, rotated: bool) -> None:
    reference = Grid((900, 900), Affine(reference_m, 0.0, 412_185.0, 0.0, -reference_m, 5_278_215.0), UTM33)
    grid = output_grid(reference, at(crs, 30.0, rotated=rotated), NONE)
    assert (grid.transform.a, grid.transform.e) == (30.0, -30.0)
    steps = (np.array(corners(grid)[0]) - [412_185.0, 5_278_215.0]) / 30.0
    assert steps == pytest.approx(np.rint(steps), abs=1e-9)


def test_metres_stay_metres_on_turned_axes() -> None:
    grid = output_grid(REFERENCE, at(UTM33, 20.0, rotated=True), NONE)
    assert (grid.transform.a, grid.transform.e) == (20.0, -20.0)


@pytest.mark.parametrize(
    ("target", "reference", "size"),
    [
        # 0.000397 degrees east and 0.00027 north are 30 m at 47.6°
        pytest.param(at(UTM33, 30.0), at(WGS84, 1e-3, (80, 80)), 0.00027, id="metres to degrees"),
        pytest.param(at(WGS84, 2.7e-4, (90, 90)), REFERENCE, 20.0, id="degrees to metres"),
        # a metre of Web Mercator is 0.675 m there
        pytest.param(at(MERCATOR, 30.0), at(UTM33, 7.0), 20.0, id="Web Mercator to metres"),
        pytest.param(at(UTM33, 30.0), at(MERCATOR, 7.0), 44.0, id="metres to Web Mercator"),
    ],
)
def test_other_units_get_square_round_pixels(target: Grid, reference: Grid, size: float) -> None:
    grid = output_grid(reference, target, NONE)
    assert (grid.transform.a, grid.transform.e) == (size, -size)


def test_the_references_own_size_is_taken_where_it_is_near() -> None:
    reference = at(WGS84, 2.7e-4, (300, 300))
    reference = Grid(reference.shape, reference.transform @ Affine.scale(1.4815, 1.0), WGS84)
    grid = output_grid(reference, at(UTM33, 30.0), NONE)
    ratio = np.abs(np.array(grid.transform)[[0, 4]] / np.array(reference.transform)[[0, 4]])
    assert ratio == pytest.approx([1.0, 1.0], abs=1e-12)


def test_bands_keep_their_ratio_in_other_units() -> None:
    target, pan = at(UTM33, 30.0, (90, 100)), at(UTM33, 15.0, (180, 200))
    first, second = output_grids(at(WGS84, 1e-3, (80, 80)), target, NONE, None, [target, pan])
    assert first.transform.a == 2 * second.transform.a
    assert np.array(corners(first)) == pytest.approx(np.array(corners(second)), abs=1e-12)
    assert second.shape == (2 * first.shape[0], 2 * first.shape[1])


def test_like_and_reference_exact_are_those_grids() -> None:
    like = at(LAEA, 17.0)
    target, pan = at(UTM33, 30.0), at(UTM33, 15.0)
    assert output_grids(REFERENCE, target, SHIFT, GridRequest(like=like), [target, pan]) == [like, like]
    exact = GridRequest("reference-exact")
    assert output_grids(REFERENCE, target, SHIFT, exact, [target, pan]) == [REFERENCE, REFERENCE]


@pytest.mark.parametrize(
    ("extent", "size", "shape", "made"),
    [
        # with -tr the extent's corner stays and the other one gives way, to whole pixels
        ((412_100.5, 5_270_000.0, 412_400.0, 5_270_299.0), (20.0, 30.0), (10, 15), (20.0, 30.0)),
        ((412_100.0, 5_270_000.0, 412_149.0, 5_270_051.0), (20.0, 20.0), (3, 2), (20.0, 20.0)),
        # without it the extent stays, and the size gives way
        ((412_100.0, 5_270_000.0, 412_400.0, 5_270_310.0), None, (10, 10), (30.0, 31.0)),
        ((412_100.0, 5_270_000.0, 412_115.0, 5_270_005.0), None, (1, 1), (15.0, 5.0)),
    ],
)
def test_extents_are_those_of_gdalwarp(
    extent: tuple[float, float, float, float],
    size: tuple[float, float] | None,
    shape: tuple[int, int],
    made: tuple[float, float],
) -> None:
    """The arithmetic of gdalwarp -te, without -tap: count = int((x_max - x_min + size / 2) / size)."""
    target = Grid((80, 90), Affine(30.0, 0.0, 412_072.5, 0.0, -30.0, 5_278_297.5), UTM33)
    grid = output_grid(REFERENCE, target, SHIFT, GridRequest(extent=extent, pixel_size=size))
    assert grid.shape == shape
    assert grid.transform == Affine(made[0], 0.0, extent[0], 0.0, -made[1], extent[3])


def test_a_pixel_size_alone_covers_the_target_from_the_references_corner() -> None:
    target = Grid((80, 90), Affine(30.0, 0.0, 412_072.5, 0.0, -30.0, 5_278_297.5), UTM33)
    grid = output_grid(REFERENCE, target, SHIFT, GridRequest(pixel_size=(20.0, 25.0)))
    assert (grid.transform.a, grid.transform.e) == (20.0, -25.0)
    (left, top), (right, bottom) = corners(grid)
    assert ((left - 412_185.0) % 20, (top - 5_278_215.0) % 25) == (0.0, 0.0)
    outline = corrected_outline(target, SHIFT)
    low, high = outline.min(axis=0), outline.max(axis=0)
    assert 0 <= low[0] - left < 20
    assert 0 <= right - high[0] < 20
    assert 0 <= low[1] - bottom < 25
    assert 0 <= top - high[1] < 25


def test_another_crs_has_whole_pixels_from_its_origin() -> None:
    target = at(UTM33, 30.0, (90, 100))
    grid = output_grid(REFERENCE, target, SHIFT, GridRequest(crs=LAEA))
    assert (grid.crs, grid.transform.a, grid.transform.e) == (LAEA, 30.0, -30.0)
    assert np.array(corners(grid)) % 30.0 == pytest.approx(np.zeros((2, 2)))
    degrees = output_grid(REFERENCE, target, SHIFT, GridRequest(crs=WGS84))
    assert (degrees.transform.a, degrees.transform.e) == (0.00027, -0.00027)


def test_bands_share_an_extent_that_is_given() -> None:
    target, pan = at(UTM33, 30.0), at(UTM33, 15.0)
    request = GridRequest(extent=(412_100.0, 5_270_000.0, 412_520.0, 5_270_290.0))
    first, second = output_grids(REFERENCE, target, SHIFT, request, [target, pan])
    assert second.shape == (2 * first.shape[0], 2 * first.shape[1])
    assert corners(first) == corners(second) == [(412_100.0, 5_270_290.0), (412_520.0, 5_270_000.0)]


def test_grids_without_a_pixel_or_with_too_many_are_refused() -> None:
    target = at(UTM33, 30.0)
    narrow = GridRequest(extent=(412_100.0, 5_270_000.0, 412_104.0, 5_270_310.0), pixel_size=(10.0, 10.0))
    with pytest.raises(InputError, match=r"would have 0 x 31 pixels of 10 x 10: check --te and --tr"):
        output_grid(REFERENCE, target, SHIFT, narrow)
    with pytest.raises(InputError, match="in units of EPSG:32633"):
        output_grid(REFERENCE, target, SHIFT, GridRequest(pixel_size=(1e-7, 1e-7)))


def test_a_grid_that_shows_nothing_of_the_target_is_refused() -> None:
    target = at(UTM33, 30.0, (100, 100))
    outline = corrected_outline(target, SHIFT)
    near = Grid((10, 10), target.transform @ Affine.translation(120, 0), UTM33)
    with pytest.raises(InputError, match=r"shows nothing of the target: in EPSG:32633 it covers x .*--te"):
        check_covered(near, outline, UTM33)
    check_covered(near, outline, UTM33, tolerance=0.5)
    check_covered(at(LAEA, 30.0, (10, 10)), outline, UTM33)
    with pytest.raises(InputError, match="in EPSG:3035"):
        check_covered(Grid((10, 10), Affine(30, 0, 4e6, 0, -30, 3e6), LAEA), outline, UTM33, tolerance=1.0)


@pytest.mark.parametrize("size", [(2147483647.0, 0.03), (3e8, 3e8)])
def test_pixels_of_nonsense_are_refused(size: tuple[float, float]) -> None:
    grid = Grid((96, 120), Affine(30, 0, 500000, 0, -30, 4600000), CRS.from_epsg(32633))
    request = GridRequest(pixel_size=size)
    with pytest.raises(InputError, match="pixels of the target long, and at most 10000"):
        output_grid(grid, grid, NONE, request)
