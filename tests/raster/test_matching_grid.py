"""A ground point must lie at reference-view px + offset in the target view, whatever the two grids are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.grid import Grid, TiltedGrid, Window, map_px
from pcwlad_geo.raster.matching_grid import MATCHING_GRIDS, ViewPair, plan_views
from pcwlad_geo.raster.source import RasterInfo, describe

UTM33, UTM34, WGS84 = CRS.from_epsg(32633), CRS.from_epsg(32634), CRS.from_epsg(4326)
ENGINEERING = CRS.from_wkt('LOCAL_CS["mine",UNIT["metre",1]]')
X, Y = 500_000.0, 5_000_000.0
MARGIN_PX = MATCHING_GRIDS.margin_px


def info(
    transform: Affine, shape: tuple[int, int] = (100, 120), crs: CRS | None = UTM33, name: str = "a.tif"
) -> RasterInfo:
    return RasterInfo(name, 1, 1, Grid(shape, transform, crs), crs is not None, "uint8", None, None)


def north_up(px_m: float = 30.0, x: float = X, y: float = Y) -> Affine:
    return Affine(px_m, 0, x, 0, -px_m, y)


def rotated(px_m: float, angle_deg: float, x: float = X, y: float = Y) -> Affine:
    c, s = px_m * np.cos(np.radians(angle_deg)), px_m * np.sin(np.radians(angle_deg))
    return Affine(c, s, x, s, -c, y)


def assert_consistent(pair: ViewPair, atol: float = 1e-6) -> None:
    """The rule of ViewPair, against the georeferencing of the two files."""
    box = pair.overlap
    view_px = np.array(
        [
            [box.col + 0.3 * box.cols, box.row + 0.6 * box.rows],
            [box.col + 0.51 * box.cols, box.row + 0.5 * box.rows],
        ]
    )
    reference_px = pair.reference.to_file_px(view_px)
    target_px = pair.target.to_file_px(view_px + pair.offset_px)
    predicted_px = map_px(reference_px, pair.reference.info.grid, pair.target.info.grid)
    np.testing.assert_allclose(target_px, predicted_px, atol=atol)


def test_equal_grids_with_a_subpixel_offset_are_not_resampled() -> None:
    pair = plan_views(info(north_up()), info(north_up(x=X + 9, y=Y - 30 * 7)))
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "none")
    # The target begins 0.3 px further right and 7 px further down: the same ground is there at smaller px.
    assert pair.offset_px == pytest.approx((-0.3, -7))
    assert pair.offset_px[1] == -7
    assert pair.overlap == Window(7, 0, 93, 120)
    assert pair.warnings == ()
    assert_consistent(pair)


def test_sizes_that_differ_by_rounding_are_equal() -> None:
    pair = plan_views(info(north_up(30.0)), info(north_up(30.00001)))
    assert pair.target.resampling == "none"
    assert_consistent(pair, atol=1e-4)
    pair = plan_views(info(north_up(30.0)), info(north_up(30.006)))  # adds up to 0.024 px over 120
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "cubic")
    assert_consistent(pair)


def test_a_slightly_larger_pixel_is_resampled_once() -> None:
    pair = plan_views(info(north_up(30.0)), info(north_up(30.1)))
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "cubic")
    assert_consistent(pair)


def test_both_rotated_alike_or_both_south_up_keep_their_pixels() -> None:
    for first, second in (
        (rotated(30, 20), rotated(30, 20, X + 300)),
        (Affine(30, 0, X, 0, 30, Y), Affine(30, 0, X + 12, 0, 30, Y)),
    ):
        pair = plan_views(info(first), info(second))
        assert (pair.reference.resampling, pair.target.resampling) == ("none", "none")
        assert_consistent(pair)


def test_a_flipped_target_is_read_in_the_other_order() -> None:
    pair = plan_views(info(north_up()), info(Affine(30, 0, X + 9, 0, 30, Y - 3000)))
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "nearest")
    assert pair.offset_px == pytest.approx((-0.3, 0))
    assert_consistent(pair)


def test_the_finer_is_averaged_onto_the_coarser() -> None:
    fine, coarse = info(north_up(10, X - 605, Y + 405), (900, 900)), info(north_up(30))
    pair = plan_views(fine, coarse)
    assert (pair.reference.resampling, pair.target.resampling) == ("average", "none")
    assert_consistent(pair)
    pair = plan_views(coarse, fine)
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "average")
    assert pair.overlap == Window(0, 0, 100, 120)
    assert_consistent(pair)


def test_a_resampled_view_covers_the_overlap_and_a_margin_only() -> None:
    small, large = info(north_up(10, X + 3000, Y - 6000), (90, 120)), info(north_up(30), (5000, 6000))
    pair = plan_views(large, small)
    assert pair.overlap == Window(200, 100, 30, 40)
    assert pair.target.grid.shape == (30 + 2 * MARGIN_PX, 40 + 2 * MARGIN_PX)
    assert pair.offset_px == (MARGIN_PX - 100, MARGIN_PX - 200)
    assert_consistent(pair)
    pair = plan_views(small, large)
    assert pair.reference.grid.shape == (30 + 2 * MARGIN_PX, 40 + 2 * MARGIN_PX)
    assert pair.overlap == Window(MARGIN_PX, MARGIN_PX, 30, 40)
    assert pair.offset_px == (100 - MARGIN_PX, 200 - MARGIN_PX)
    assert_consistent(pair)


def test_south_up_coarser_grid_is_kept() -> None:
    pair = plan_views(info(north_up(10), (300, 300)), info(Affine(30, 0, X, 0, 30, Y - 3000)))
    assert (pair.reference.resampling, pair.target.resampling) == ("average", "none")
    assert pair.reference.grid.transform.e > 0
    assert_consistent(pair)


def test_anisotropic_pixels_compare_by_their_area() -> None:
    wide = info(Affine(20, 0, X, 0, -60, Y), (80, 200), name="wide.tif")  # 34.6 m
    pair = plan_views(info(north_up(30)), wide)
    assert pair.target.resampling == "none"
    assert pair.reference.resampling == "cubic"  # x would have to be refined, not averaged
    assert_consistent(pair)


@pytest.mark.parametrize("px_m", [10.0, 30.0, 45.0])
def test_rotated_pairs_resample_the_finer(px_m: float) -> None:
    pair = plan_views(info(north_up(30)), info(rotated(px_m, 30, X + 300, Y - 1500), (200, 200)))
    expected = ("cubic", "none") if px_m > 30 else ("none", "cubic")
    assert (pair.reference.resampling, pair.target.resampling) == expected
    assert_consistent(pair)


@pytest.mark.parametrize("px", [0.7, 1.0, 2.0])
def test_what_is_seen_from_the_side_is_interpolated(px: float) -> None:
    reference = info(Affine.identity(), crs=None)
    target = info(Affine.scale(px), crs=None)
    grid = TiltedGrid(target.grid.shape, target.grid.transform, None, (60.0, 50.0), (1e-3, -5e-4))
    pair = plan_views(
        *(replace(each, georeferenced=True) for each in (reference, replace(target, grid=grid)))
    )
    assert "cubic" in (pair.reference.resampling, pair.target.resampling)
    assert_consistent(pair)


def test_the_overlap_of_rotated_rasters_is_that_of_their_outlines() -> None:
    # A square turned by 45 degrees: its bounding box holds the reference's corner, its outline does not.
    turned = info(rotated(30, 45, X - 1800, Y + 1000), (60, 60))
    with pytest.raises(InputError, match="do not overlap"):
        plan_views(info(north_up()), turned)


@pytest.mark.parametrize(
    "target",
    [
        info(Affine(30, 0, 29_000, 0, -30, 5_014_000), (200, 200), UTM34),
        info(Affine(3e-4, 0, 15.0, 0, -3e-4, 45.15), (200, 200), WGS84),
    ],
    ids=["UTM 34N", "geographic"],
)
def test_other_crs(target: RasterInfo) -> None:
    reference = info(north_up(30), (200, 200))
    for pair in (plan_views(reference, target), plan_views(target, reference)):
        assert sorted([pair.reference.resampling, pair.target.resampling]) == ["cubic", "none"]
        assert pair.warnings == ()
        assert_consistent(pair, atol=1e-5)
    assert min(plan_views(reference, target).overlap.shape) > 80


def test_a_crs_that_differs_in_name_only_needs_no_resampling() -> None:
    etrs89 = CRS.from_epsg(25833)
    pair = plan_views(info(north_up()), info(north_up(x=X + 9), crs=etrs89))
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "none")
    assert pair.offset_px == pytest.approx((-0.3, 0), abs=1e-4)  # the ellipsoids differ by 0.1 mm


def test_a_world_wide_raster_against_a_scene() -> None:
    world = info(Affine(0.01, 0, -180, 0, -0.01, 90), (18_000, 36_000), WGS84, "world.tif")
    scene = info(north_up(30), (4000, 4000))
    for pair in (plan_views(scene, world), plan_views(world, scene)):
        assert_consistent(pair, atol=1e-4)
        assert max(pair.reference.grid.shape) < 36_000 or pair.reference.resampling == "none"
    pair = plan_views(scene, world)
    assert pair.reference.resampling == "cubic"
    assert max(pair.reference.grid.shape) < 400


def test_geographic_pair_keeps_its_pixels() -> None:
    pair = plan_views(
        info(Affine(3e-4, 0, 15, 0, -3e-4, 45), crs=WGS84),
        info(Affine(3e-4, 0, 15.0001, 0, -3e-4, 45), crs=WGS84),
    )
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "none")
    assert pair.offset_px == pytest.approx((-1 / 3, 0), abs=1e-6)


@pytest.mark.parametrize("which", ["reference", "target", "both"])
def test_without_georeferencing_pixels_are_compared_as_they_lie(which: str) -> None:
    reference = (
        info(Affine.identity(), (50, 70), None, "ref.tif")
        if which != "target"
        else info(north_up(), (50, 70))
    )
    target = (
        info(Affine.identity(), (60, 40), None, "tgt.tif")
        if which != "reference"
        else info(north_up(), (60, 40))
    )
    pair = plan_views(reference, target)
    assert (pair.reference.resampling, pair.target.resampling) == ("none", "none")
    assert pair.offset_px == (0.0, 0.0)
    assert pair.overlap == Window(0, 0, 50, 40)
    assert not pair.georeferenced
    (warning,) = pair.warnings
    assert "no georeferencing" in warning
    assert ("ref.tif" in warning) == (which != "target")
    assert ("tgt.tif" in warning) == (which != "reference")


def test_no_overlap_names_both_extents() -> None:
    with pytest.raises(InputError) as caught:
        plan_views(info(north_up(), name="ref.tif"), info(north_up(x=X + 90_000), name="tgt.tif"))
    message = str(caught.value)
    assert "ref.tif covers x 500000 to 503600, y 4997000 to 5000000" in message
    assert "tgt.tif covers x 590000 to 593600, y 4997000 to 5000000" in message
    assert "EPSG:32633" in message
    assert "\n" not in message


def test_neighbours_that_share_an_edge_do_not_overlap() -> None:
    with pytest.raises(InputError, match="do not overlap"):
        plan_views(info(north_up()), info(north_up(x=X + 120 * 30)))


def test_crs_that_cannot_be_transformed() -> None:
    with pytest.raises(InputError, match="cannot transform"):
        plan_views(info(north_up()), info(north_up(), crs=ENGINEERING))
    assert plan_views(info(north_up(), crs=ENGINEERING), info(north_up(), crs=ENGINEERING)).offset_px == (
        0,
        0,
    )


def test_ballpark_transformation_warns() -> None:
    nad27, nad83 = CRS.from_epsg(4267), CRS.from_epsg(4269)
    transform = Affine(3e-4, 0, -100, 0, -3e-4, 40)
    pair = plan_views(info(transform, crs=nad27), info(transform, crs=nad83))
    assert len(pair.warnings) == 1


def write(path: Path, values: NDArray[np.generic], transform: Affine, crs: CRS | None = UTM33) -> RasterInfo:
    rows, cols = values.shape
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=1,
        height=rows,
        width=cols,
        dtype=values.dtype,
        transform=transform,
        crs=crs,
    ) as dataset:
        dataset.write(values, 1)
    return describe(path)


@pytest.mark.parametrize(
    ("transform", "crs"),
    [
        (north_up(30, X + 9, Y + 12), UTM33),
        (Affine(30, 0, X + 9, 0, 30, Y - 5000), UTM33),
        (north_up(10, X + 5, Y + 5), UTM33),
        (north_up(70, X - 200, Y + 33), UTM33),
        (rotated(20, 30, X - 900, Y - 2000), UTM33),
        (Affine(30, 0, 29_000, 0, -30, 5_014_000), UTM34),
    ],
    ids=["offset", "flipped", "finer", "coarser", "rotated", "UTM 34N"],
)
def test_both_views_show_the_same_ground(tmp_path: Path, transform: Affine, crs: CRS) -> None:
    """A ramp seen through both views: the values agree where the rule says that the ground does."""

    def ramp(grid: Grid) -> NDArray[np.float64]:
        col, row = np.meshgrid(np.arange(grid.shape[1]) + 0.5, np.arange(grid.shape[0]) + 0.5)
        px = map_px(np.column_stack([col.ravel(), row.ravel()]), grid, Grid((1, 1), north_up(30), UTM33))
        return (px @ [1.0, 1.7]).reshape(grid.shape)  # in reference px

    grids = [Grid((150, 160), north_up(30), UTM33), Grid((400, 400), transform, crs)]
    pair = plan_views(
        *(write(tmp_path / f"{i}.tif", ramp(grid), grid.transform, grid.crs) for i, grid in enumerate(grids))
    )
    box = pair.overlap
    middle = Window(box.row + box.rows // 2 - 5, box.col + box.cols // 2 - 5, 10, 10)
    shift = np.floor(pair.offset_px).astype(int)
    seen = pair.reference.read(middle)
    target = pair.target.read(middle.moved(int(shift[1]), int(shift[0])))
    assert seen.valid.all()
    assert target.valid.all()
    part_x, part_y = np.asarray(pair.offset_px) - shift
    # Area averages of a ramp at a ratio that is not whole stray by 0.04 px, from pixel to pixel.
    # What is left of the offset is a fraction of a target-view pixel: the ramp's slope there.
    slope_x, slope_y = np.diff(target.values, axis=1).mean(), np.diff(target.values, axis=0).mean()
    np.testing.assert_allclose(
        target.values + part_x * slope_x + part_y * slope_y, seen.values, rtol=0, atol=0.12
    )


def test_files_without_georeferencing_do_not_warn_on_reading(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    with pytest.warns(NotGeoreferencedWarning):
        raster = write(tmp_path / "a.tif", np.ones((20, 20), "uint8"), Affine.identity(), None)
    recwarn.clear()
    pair = plan_views(raster, raster)
    assert pair.target.read(pair.overlap).valid.all()
    assert not recwarn.list
