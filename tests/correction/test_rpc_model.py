from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer

from pcwlad_geo.raster import RpcModel, read_rpc
from pcwlad_geo.raster.rpc.files import to_gdal
from pcwlad_geo.raster.rpc.model import derived_terms, polynomial_terms
from tests.rpc_scene import SHAPE, make_rpc

TOLERANCE_PX = 1e-6


def ground_of(rpc: RpcModel, n: int = 500) -> np.ndarray:
    middle = np.array([rpc.long_off, rpc.lat_off, rpc.height_off])
    scale = np.array([rpc.long_scale, rpc.lat_scale, rpc.height_scale])
    return middle + scale * np.random.default_rng(1).uniform(-1, 1, (n, 3))


def gdal_px(rpc: RpcModel, ground: np.ndarray) -> np.ndarray:
    options = {"RPC_PIXEL_ERROR_THRESHOLD": 1e-7, "RPC_MAX_ITERATIONS": 50}
    with RPCTransformer(RPC.from_gdal(to_gdal(rpc)), **options) as transformer:
        rows, cols = transformer.rowcol(*ground[:, :2].T, zs=ground[:, 2], op=lambda value: value)
    return np.column_stack([cols, rows])


def test_forward_is_gdals_with_corner_based_pixels() -> None:
    rpc = make_rpc()
    ground = ground_of(rpc)
    np.testing.assert_allclose(rpc.to_px(ground), gdal_px(rpc, ground), rtol=0, atol=TOLERANCE_PX)


def test_forward_is_gdals_on_a_real_rpc(shared_data: Path) -> None:
    source = read_rpc(str(shared_data / "rpc/qb2_basic1b.tif"))
    assert source is not None
    ground = ground_of(source.rpc)
    np.testing.assert_allclose(
        source.rpc.to_px(ground), gdal_px(source.rpc, ground), rtol=0, atol=TOLERANCE_PX
    )


def test_line_and_sample_zero_are_the_centre_of_the_first_pixel() -> None:
    rpc = make_rpc(line_off=0.0, samp_off=0.0)
    middle = np.array([[rpc.long_off, rpc.lat_off, rpc.height_off]])
    np.testing.assert_allclose(rpc.to_px(middle), [[0.5, 0.5]], rtol=0, atol=1e-9)


@given(
    st.floats(-0.2, 1.2),
    st.floats(-0.2, 1.2),
    st.floats(-100, 900),
    st.sampled_from([24.4, -179.99, 179.999]),
)
def test_inverse_undoes_forward(x: float, y: float, height_m: float, lon: float) -> None:
    rpc = make_rpc(long_off=lon)
    pixel = np.array([[x * SHAPE[1], y * SHAPE[0]]])
    lon_lat = rpc.to_ground(pixel, height_m)
    back = rpc.to_px(np.column_stack([lon_lat, [height_m]]))
    np.testing.assert_allclose(back, pixel, rtol=0, atol=1e-5)


def test_derivatives_are_those_of_the_terms() -> None:
    places, step = np.random.default_rng(2).uniform(-1, 1, (50, 3)), 1e-5
    for axis, derived in enumerate(derived_terms(polynomial_terms(places))):
        along = step * np.eye(3)[axis]
        sides = polynomial_terms(places + along) - polynomial_terms(places - along)
        np.testing.assert_allclose(derived, sides / (2 * step), rtol=0, atol=1e-9)


def test_the_inverse_is_the_same_wherever_it_begins() -> None:
    rpc, pixels = make_rpc(), np.random.default_rng(2).uniform((0, 0), SHAPE[::-1], (50, 2))
    found = rpc.to_ground(pixels, 400.0)
    for near in (found + 1e-4, found[::-1], np.full((50, 2), np.nan)):
        np.testing.assert_allclose(rpc.to_ground(pixels, 400.0, near), found, rtol=0, atol=1e-11)


def test_inverse_says_where_there_is_none() -> None:
    pixels = np.array([[100.0, 100.0], [np.nan, 5.0]])
    found = make_rpc().to_ground(pixels, np.array([400.0, 400.0]))
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()


def test_a_long_list_of_points_is_the_same_as_short_ones() -> None:
    rpc = make_rpc()
    ground = ground_of(rpc, 70_000)
    parts = np.concatenate([rpc.to_px(part) for part in np.array_split(ground, 7)])
    np.testing.assert_allclose(rpc.to_px(ground), parts, rtol=0, atol=1e-9)


def test_height_moves_the_image_as_two_heights_do() -> None:
    rpc = make_rpc()
    ground = ground_of(rpc, 20)
    higher = rpc.to_px(ground + np.array([0, 0, 29.0])) - rpc.to_px(ground)
    assert 29 * rpc.px_per_metre_of_height(ground) == pytest.approx(higher, abs=0.02)
