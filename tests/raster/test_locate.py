"""Tie points made from a known correspondence in the two files must come back as that correspondence."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.matching import TiePoints
from pcwlad_geo.raster.grid import Grid, map_px
from pcwlad_geo.raster.matching_grid import ViewPair, plan_views
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.tiepoints.table import locate

Array = NDArray[np.float64]
UTM33, UTM34, WGS84 = CRS.from_epsg(32633), CRS.from_epsg(32634), CRS.from_epsg(4326)
X, Y = 500_000.0, 5_000_000.0
MOVED_PX = np.array([0.7, -1.3])
UTM_SCALE = 0.9996  # map metres per metre of ground on the central meridian, where the rasters lie
REFERENCE_PX = np.array([[60.25, 70.5], [80.0, 61.75], [99.9, 90.1]])


def info(transform: Affine, crs: CRS | None = UTM33, shape: tuple[int, int] = (400, 400)) -> RasterInfo:
    return RasterInfo("a.tif", 1, 1, Grid(shape, transform, crs), crs is not None, "uint8", None, None)


def rotated(px_m: float, angle_deg: float, x: float, y: float) -> Affine:
    c, s = px_m * np.cos(np.radians(angle_deg)), px_m * np.sin(np.radians(angle_deg))
    return Affine(c, s, x, s, -c, y)


REFERENCE = info(Affine(30, 0, X, 0, -30, Y), shape=(150, 160))
TARGETS = {
    "offset": info(Affine(30, 0, X + 9, 0, -30, Y + 12)),
    "flipped": info(Affine(30, 0, X + 9, 0, 30, Y - 5000)),
    "finer": info(Affine(10, 0, X + 5, 0, -10, Y + 5)),
    "coarser": info(Affine(70, 0, X - 200, 0, -70, Y + 33)),
    "rotated": info(rotated(20, 30, X - 900, Y - 2000)),
    "UTM 34N": info(Affine(30, 0, 29_000, 0, -30, 5_014_000), UTM34),
    "geographic": info(Affine(3e-4, 0, 15.0, 0, -3e-4, 45.15), WGS84),
}


def as_matched(pair: ViewPair, target_px: Array, sigma_px: float = 0.1) -> TiePoints:
    count = len(REFERENCE_PX)
    return TiePoints(
        pair.reference.from_file_px(REFERENCE_PX),
        pair.target.from_file_px(target_px),
        np.broadcast_to(np.diag([sigma_px, 2 * sigma_px]) ** 2, (count, 2, 2)),
        np.linspace(0.5, 1, count),
        np.zeros(count),
    )


@pytest.mark.parametrize("name", list(TARGETS))
def test_known_displacement_comes_back(name: str) -> None:
    target = TARGETS[name]
    pair = plan_views(REFERENCE, target)
    predicted_px = map_px(REFERENCE_PX, REFERENCE.grid, target.grid)
    table = locate(as_matched(pair, predicted_px + MOVED_PX), pair)
    np.testing.assert_allclose(table.reference_px, REFERENCE_PX, atol=1e-5)
    np.testing.assert_allclose(table.predicted_px, predicted_px, atol=1e-5)
    np.testing.assert_allclose(table.displacement_px, np.tile(MOVED_PX, (3, 1)), atol=2e-5)
    np.testing.assert_allclose(table.xy, X + REFERENCE_PX * [30, -30] + [0, Y - X], atol=1e-3)
    assert table.crs == UTM33
    assert set(table.status) == {"matched"}
    assert np.isnan(table.residual_px).all()
    np.testing.assert_array_equal(table.score, [0.5, 0.75, 1])


@pytest.mark.parametrize(
    ("name", "expected_m"),
    [
        ("offset", (0.7 * 30, 1.3 * 30)),
        ("flipped", (0.7 * 30, -1.3 * 30)),
        ("finer", (7, 13)),
        (
            "rotated",
            (20 * (0.7 * np.sqrt(0.75) - 1.3 * 0.5), 20 * (0.7 * 0.5 + 1.3 * np.sqrt(0.75))),
        ),
    ],
)
def test_displacement_in_metres_is_east_north(name: str, expected_m: tuple[float, float]) -> None:
    target = TARGETS[name]
    pair = plan_views(REFERENCE, target)
    table = locate(as_matched(pair, map_px(REFERENCE_PX, REFERENCE.grid, target.grid) + MOVED_PX), pair)
    np.testing.assert_allclose(table.displacement_m, np.tile(expected_m, (3, 1)) / UTM_SCALE, atol=1e-3)


def test_displacement_across_crs_is_along_the_reference_axes() -> None:
    pair = plan_views(REFERENCE, TARGETS["UTM 34N"])
    moved_px = REFERENCE_PX + np.array([2.0, 0.0])  # 60 m east in the reference CRS
    table = locate(as_matched(pair, map_px(moved_px, REFERENCE.grid, TARGETS["UTM 34N"].grid)), pair)
    np.testing.assert_allclose(table.displacement_m, np.tile([60 / UTM_SCALE, 0], (3, 1)), atol=1e-3)


def test_displacement_of_a_geographic_reference_is_metric() -> None:
    reference, target = TARGETS["geographic"], REFERENCE
    pair = plan_views(reference, target)
    at = map_px(REFERENCE_PX, target.grid, reference.grid)
    points = TiePoints(
        pair.reference.from_file_px(at),
        pair.target.from_file_px(REFERENCE_PX + np.array([1.0, 0.0])),
        np.zeros((3, 2, 2)),
        np.ones(3),
        np.zeros(3),
    )
    table = locate(points, pair)
    # There the axes of UTM are turned by less than 0.1 degrees.
    np.testing.assert_allclose(table.displacement_m, np.tile([30 / UTM_SCALE, 0], (3, 1)), atol=0.05)
    assert table.crs == WGS84


def test_covariance_is_in_target_file_px() -> None:
    pair = plan_views(REFERENCE, TARGETS["finer"])  # a view px is 3 file px
    table = locate(as_matched(pair, map_px(REFERENCE_PX, REFERENCE.grid, TARGETS["finer"].grid)), pair)
    np.testing.assert_allclose(table.sigma_px, np.tile([0.3, 0.6], (3, 1)), atol=1e-9)
    pair = plan_views(REFERENCE, TARGETS["coarser"])  # the target keeps its own pixels
    table = locate(as_matched(pair, map_px(REFERENCE_PX, REFERENCE.grid, TARGETS["coarser"].grid)), pair)
    np.testing.assert_allclose(table.sigma_px, np.tile([0.1, 0.2], (3, 1)), atol=1e-9)
    pair = plan_views(REFERENCE, TARGETS["rotated"])
    table = locate(as_matched(pair, map_px(REFERENCE_PX, REFERENCE.grid, TARGETS["rotated"].grid)), pair)
    # Axes of 0.1 and 0.2 view px, each 1.5 file px, turned by 30 degrees.
    expected = (0.15**2 * 0.75 + 0.3**2 * 0.25, 0.15**2 * 0.25 + 0.3**2 * 0.75)
    np.testing.assert_allclose(table.sigma_px**2, np.tile(expected, (3, 1)), atol=1e-9)


@pytest.mark.parametrize("lacking", ["both", "target", "reference"])
def test_without_georeferencing_the_prediction_is_the_identity(lacking: str) -> None:
    plain = info(Affine.identity(), None, (150, 160))
    reference = REFERENCE if lacking == "target" else plain
    pair = plan_views(reference, REFERENCE if lacking == "reference" else plain)
    table = locate(as_matched(pair, REFERENCE_PX + MOVED_PX), pair)
    np.testing.assert_array_equal(table.predicted_px, REFERENCE_PX)
    np.testing.assert_allclose(table.displacement_px, np.tile(MOVED_PX, (3, 1)))
    if lacking == "target":  # it is predicted to lie on the reference's pixels, which have a size
        moved_m = REFERENCE.grid.to_xy(REFERENCE_PX + MOVED_PX) - REFERENCE.grid.to_xy(REFERENCE_PX)
        np.testing.assert_allclose(table.displacement_m, moved_m / UTM_SCALE, atol=1e-4)
    else:
        assert np.isnan(table.displacement_m).all()
    if lacking == "target":
        np.testing.assert_allclose(table.xy, REFERENCE.grid.to_xy(REFERENCE_PX))
    else:
        np.testing.assert_array_equal(table.xy, REFERENCE_PX * [1, -1])
        assert table.crs is None


def test_no_points() -> None:
    table = locate(TiePoints.empty(), plan_views(REFERENCE, TARGETS["UTM 34N"]))
    assert len(table) == 0
    assert table.covariance_px2.shape == (0, 2, 2)
