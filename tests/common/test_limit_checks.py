"""Each limit of pcwlad_geo/limits.py: what is just within it passes, what is just beyond is refused."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

import pytest

from pcwlad_geo import limits
from pcwlad_geo.errors import ExecutionError, InputError, SettingsError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster import OutputFormat
from pcwlad_geo.tiepoints.cells import check_sigma

UTM = (30.0, 0.0, 5e5, 0.0, -30.0, 4.6e6)


def refused(check: Callable[[], None], *said: str) -> None:
    with pytest.raises(InputError) as caught:
        check()
    for each in said:
        assert each in str(caught.value)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not limit the address space")
def test_address_space(monkeypatch: pytest.MonkeyPatch) -> None:
    import resource

    def check(most: int) -> None:
        monkeypatch.setattr(resource, "getrlimit", lambda which: (most, resource.RLIM_INFINITY))
        limits.check_address_space()

    for enough in (resource.RLIM_INFINITY, 2**31, 2**40):
        check(enough)
    for most, said in ((2**31 - 1, "may use 2 GiB"), (2**29, "may use 0.5 GiB")):
        with pytest.raises(ExecutionError, match=f"{said} of address space, and at least 2 GiB of memory"):
            check(most)


@pytest.mark.parametrize(
    ("value", "within"), [(1e-4, True), (1e4, True), (0.99e-4, False), (1.01e4, False), (math.nan, False)]
)
def test_sigma(value: float, within: bool) -> None:
    def check() -> None:
        check_sigma("points.csv", 7, "sigma_col", str(value), value)

    if within:
        check()
    else:
        refused(check, "points.csv, line 7: sigma_col", "from 0.0001 to 10000 px, or leave it empty")


def test_shape() -> None:
    limits.check_shape("a.tif", (2**18, 2**18), 4096)
    refused(lambda: limits.check_shape("a.tif", (2**18, 2**18 + 1), 1), "a.tif", "262145 x 262144 pixels")
    refused(lambda: limits.check_shape("a.tif", (10, 10), 4097), "4097 bands", "at most 4096")


def test_pixels_of_an_output_grid() -> None:
    limits.check_output_pixel((1e-4, 3.0))
    refused(
        lambda: limits.check_output_pixel((3.0, 0.99e-4)), "1.01e+04 pixels of the target", "at most 10000"
    )
    refused(lambda: limits.check_output_pixel((3.0, 0.0)), "at most 10000")
    limits.check_output_pixel((math.nan, math.nan))  # beside the target: told elsewhere


def test_blocks_that_are_written() -> None:
    for side in ("1", "8192", "0000000512"):
        limits.check_created_block("BLOCKSIZE", side)
    for value in ("8193", "0", "-5", "9" * 5000, "512.5", "²", ""):
        refused(lambda value=value: limits.check_created_block("BLOCKSIZE", value), "co = BLOCKSIZE=", "8192")
    with pytest.raises(SettingsError, match="BLOCKYSIZE=-5"):
        OutputFormat.of("GTiff", ["blockysize=-5"])


def test_bytes_for_the_pixels() -> None:
    side = 2**14
    limits.check_stored("a.tif", (side, side), 0)  # small enough to be read at any rate
    limits.check_stored("a.tif", (20_000, 20_000), 200_000)
    refused(lambda: limits.check_stored("a.tif", (20_000, 20_000), 199_999), "199999 bytes", "2000 pixels")
    refused(lambda: limits.check_stored("a.tif", (side, side + 1), 0), "16385 x 16384")


def test_one_block() -> None:
    limits.check_block("a.tif", (2**14, 2**14), 4)
    refused(lambda: limits.check_block("a.tif", (2**14, 2**14 + 1), 4), "16385 x 16384", "1073741824")
    refused(lambda: limits.check_block("a.tif", (2**14, 2**14), 5), "1342177280 bytes")


@pytest.mark.parametrize("at", range(6))
def test_a_geotransform_stays_on_the_map(at: int) -> None:
    limits.check_geotransform("a.tif", UTM, (100, 200))
    for wild in (1.01e10, -1.01e10, math.nan, math.inf):
        numbers = [wild if i == at else number for i, number in enumerate(UTM)]
        refused(
            lambda numbers=numbers: limits.check_geotransform("a.tif", numbers, (100, 200)),
            "a.tif has map coordinates up to",
            "correct the geotransform (gdal_edit.py -a_ullr)",
        )


@pytest.mark.parametrize(
    ("numbers", "shape"),
    [
        ((1.0, 0, 1e10 - 200, 0, -1, 0), (100, 200)),
        ((0.0, 1, 1e10 - 100, 1, 0, 0), (100, 200)),
        ((1.0, 0, 0, 0, -1, 1e10 - 100), (100, 200)),
        ((0.0, 1, 0, 1, 0, 1e10 - 200), (100, 200)),
    ],
)
def test_the_far_corner_counts(numbers: tuple[float, ...], shape: tuple[int, int]) -> None:
    limits.check_geotransform("a.tif", numbers, shape)
    larger = (shape[0] + 1, shape[1] + 1)
    refused(lambda: limits.check_geotransform("a.tif", numbers, larger), "up to 1e+10, and at most 1e+10")


@pytest.mark.parametrize(("c", "f"), [(1e6, 0.0), (0.0, 1e6), (-1e6, 0.0), (5.0, -1e6)])
@pytest.mark.parametrize("turned", [False, True])
def test_pixels_that_numbers_can_tell_apart(c: float, f: float, turned: bool) -> None:
    def numbers(pixel: float, other: float) -> tuple[float, ...]:
        return (0.0, pixel, c, other, 0.0, f) if turned else (pixel, 0.0, c, 0.0, -other, f)

    limits.check_geotransform("a.tif", numbers(1e-5, 1e-5), (10, 10))
    for tiny in ((0.99e-5, 1.0), (1.0, 0.99e-5)):
        refused(
            lambda tiny=tiny: limits.check_geotransform("a.tif", numbers(*tiny), (10, 10)),
            "9.9e-06 map units at coordinates of 1000000, which",
            "cannot tell apart",
        )


def test_a_pixel_is_as_long_as_its_side_whatever_its_direction() -> None:
    limits.check_geotransform("a.tif", (0.8e-5, 0.8e-5, 1e6, 0.8e-5, -0.8e-5, 0.0), (10, 10))


def test_coordinates() -> None:
    limits.check_coordinates("p.csv", [1e10, -1e10, 0.0])
    for wild in (1.01e10, -1.01e10, math.nan, math.inf):
        refused(lambda wild=wild: limits.check_coordinates("p.csv", [0.0, wild, 1.0]), "p.csv", f"{wild:.3g}")


def test_latitudes() -> None:
    limits.check_latitudes("a.tif", -90.5, 90.5, 0.5)
    refused(lambda: limits.check_latitudes("a.tif", -90.51, 0.0, 0.5), "from -90.51 to 0 degrees")
    refused(lambda: limits.check_latitudes("a.tif", 0.0, 90.51, 0.5), "to 90.51 degrees")


def test_pixels_of_a_pair() -> None:
    for steps in ((1000.0, 1000.0), (1e-3, 1e-3), (16.0, 1.0), (1.0, 16.0), (0.0, 5e4), (math.nan, 1.0)):
        limits.check_pixel_ratio("r.tif", "t.tif", steps)
    limits.check_pixel_ratio("r.tif", "t.tif", (1.0, math.inf))
    for steps, said in (((1001.0, 999.0), "1e+03 times"), ((0.00099, 0.001), "1.01e+03 times")):
        refused(lambda steps=steps: limits.check_pixel_ratio("r.tif", "t.tif", steps), said, "in size")
    for steps in ((16.5, 1.0), (2.0, 33.0)):
        refused(lambda steps=steps: limits.check_pixel_ratio("r.tif", "t.tif", steps), "16.5 times", "shape")


def test_control_points_that_fit() -> None:
    limits.check_gcp_misfit("a.tif", 50.0, (100, 200))
    refused(lambda: limits.check_gcp_misfit("a.tif", 50.1, (100, 200)), "50.1 px", "25%")
    refused(lambda: limits.check_gcp_misfit("a.tif", math.nan, (100, 200)), "a.tif")


def test_a_grid_that_is_made() -> None:
    limits.check_grid("the grid", (2.0**17, 2.0**17))
    refused(lambda: limits.check_grid("the grid", (2.0**17, 2.0**17 + 1)), "131072 x 131073", "the grid")
    limits.check_grid("the grid", (2.0**14, 2.0**14), 100.0)
    refused(lambda: limits.check_grid("the grid", (2.0**14, 2.0**14 + 1), 100.0), "at most 268435456")
    limits.check_grid("the grid", (2.0**20, 1.0))
    refused(lambda: limits.check_grid("the grid", (1.0, 2.0**20 + 1)), "at most 1048576 a side")
    limits.check_grid("the grid", (8e4, 8e4), 1e8)
    refused(lambda: limits.check_grid("the grid", (8e4, 8.01e4), 1e8), "at most 6400000000")
    refused(lambda: limits.check_grid("the grid", (2.0**17, 2.0**17 + 1), 1e12), "at most 17179869184")
    refused(lambda: limits.check_grid("the grid", (math.nan, 1.0)), "nan")


def test_counts() -> None:
    limits.check_count("p.csv", 7, 7, "points")
    refused(lambda: limits.check_count("p.csv", 8, 7, "points"), "p.csv holds more than 7 points")


def test_what_an_archive_unpacks_to() -> None:
    limits.check_unpacked("a.zip", 2**30, 1)
    refused(lambda: limits.check_unpacked("a.zip", 2**30 + 1, 1), "a.zip", "1073741825")
    limits.check_unpacked("a.zip", 2_000_000_000, 10_000_000)
    refused(lambda: limits.check_unpacked("a.zip", 2_000_000_001, 10_000_000), "at most 200 times")


@pytest.mark.parametrize(
    ("name", "most"),
    [
        *((name, 1e7) for name in ("line_off", "samp_off", "line_scale", "samp_scale")),
        *((name, 90.0) for name in ("lat_off", "lat_scale")),
        *((name, 360.0) for name in ("long_off", "long_scale")),
        *((name, 2e4) for name in ("height_off", "height_scale")),
        ("line_num_coeff", 1e6),
    ],
)
def test_numbers_of_an_rpc(name: str, most: float) -> None:
    limits.check_rpc("a_RPC.TXT", name, most)
    limits.check_rpc("a_RPC.TXT", name, -most)
    for wild in (1.01 * most, -1.01 * most, math.nan):
        refused(lambda wild=wild: limits.check_rpc("a_RPC.TXT", name, wild), "a_RPC.TXT", name.upper())


def test_limits_that_are_compared_elsewhere() -> None:
    """As docs/development/limits.md names them."""
    assert (LIMITS.search_radius_px, LIMITS.tile_px, LIMITS.features) == (1024, 4096, 100_000)
    assert (LIMITS.iterations, LIMITS.jobs, LIMITS.unread_parts) == (1000, 1024, 500)
    assert (LIMITS.points, LIMITS.batch_rows, LIMITS.members) == (250_000, 100_000, 100_000)
    assert (LIMITS.options_bytes, LIMITS.rpc_bytes, LIMITS.metadata_bytes) == (2**14, 2**16, 2**24)
    assert (LIMITS.vrt_bytes, LIMITS.trend_figures) == (2**25, 100_000)
    assert (LIMITS.text_bytes, LIMITS.min_stored, LIMITS.name_bytes) == (2**26, 1 / 128, 255)
