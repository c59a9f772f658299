from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.raster.rpc.bias import BIAS_TOLERANCE_PX, apply_bias, bias_error_px, covered_range
from tests.rpc_scene import SHAPE, make_rpc, of_a_product

HEIGHTS_M = (0.0, 800.0)


def correction(matrix: object) -> AffineCorrection:
    return AffineCorrection("affine", np.array(matrix, dtype=np.float64))


@pytest.mark.parametrize(
    "matrix", [[[1, 0, 3.3], [0, 1, -7.1]], [[1.0004, 0, 3.3], [0, 0.9997, -7.1]]], ids=["shift", "own gain"]
)
def test_shift_and_the_gain_of_an_axis_are_exact(matrix: object) -> None:
    rpc = make_rpc()
    biased = apply_bias(rpc, correction(matrix))
    assert bias_error_px(rpc, biased, correction(matrix), SHAPE, HEIGHTS_M) < 1e-9
    assert biased.samp_num_coeff == rpc.samp_num_coeff
    assert biased.line_num_coeff == rpc.line_num_coeff


@given(*[st.floats(-2e-3, 2e-3)] * 4, st.floats(-50, 50), st.floats(-50, 50))
def test_an_affine_folds_to_a_thousandth_of_a_pixel(
    a: float, b: float, d: float, e: float, col: float, row: float
) -> None:
    rpc, affine = make_rpc(), correction([[1 + a, b, col], [d, 1 + e, row]])
    assert bias_error_px(rpc, apply_bias(rpc, affine), affine, SHAPE, HEIGHTS_M) <= BIAS_TOLERANCE_PX


def test_the_folded_rpc_gives_observed_pixels_at_any_ground() -> None:
    rpc, affine = make_rpc(), correction([[1.0002, 3e-4, 5], [-2e-4, 0.9999, -3]])
    rng = np.random.default_rng(2)
    heights = rng.uniform(*HEIGHTS_M, 300)
    pixels = rng.uniform((0, 0), SHAPE[::-1], (300, 2))
    ground = np.column_stack([rpc.to_ground(pixels, heights), heights])
    observed = apply_bias(rpc, affine).to_px(ground)
    np.testing.assert_allclose(observed, affine.forward(pixels), rtol=0, atol=BIAS_TOLERANCE_PX)


def test_the_error_is_that_of_the_worst_place() -> None:
    rpc, affine = make_rpc(), correction([[1, 0, 0.25], [0, 1, 0]])
    assert bias_error_px(rpc, rpc, affine, SHAPE, HEIGHTS_M) == pytest.approx(0.25, abs=1e-9)


def test_on_the_real_rpc(shared_data: Path) -> None:
    from pcwlad_geo.raster import read_rpc

    source = read_rpc(str(shared_data / "rpc/qb2_basic1b.tif"))
    assert source is not None
    affine = correction([[1.0003, 1e-4, 3], [-1e-4, 0.9998, -4]])
    error = bias_error_px(source.rpc, apply_bias(source.rpc, affine), affine, (1450, 850), (150.0, 900.0))
    assert error < 1e-5


def test_what_an_image_covers_is_where_it_lies() -> None:
    rpc = of_a_product(make_rpc())
    low, high = covered_range(rpc, SHAPE, HEIGHTS_M)
    lattice = np.stack(np.meshgrid([0, 320.0], [0, 300.0]), axis=-1).reshape(-1, 2)
    for height in HEIGHTS_M:
        found = rpc.normalised(np.column_stack([rpc.to_ground(lattice, height), np.full(4, height)]))
        assert (found >= low - 1e-9).all()
        assert (found <= high + 1e-9).all()
    assert (high - low)[0] < 0.1  # a twenty-fifth of the product, and what heights add


def test_a_part_of_a_product_is_folded_over_the_part() -> None:
    rpc, affine = of_a_product(make_rpc()), correction([[1.0005, 1e-3, 3.3], [-1e-3, 0.9998, -7.1]])
    biased = apply_bias(rpc, affine, covered_range(rpc, SHAPE, HEIGHTS_M))
    assert bias_error_px(rpc, biased, affine, SHAPE, HEIGHTS_M) < 1e-7
    # over the whole product, most of which is beside the image, it would be a hundred times as much
    assert bias_error_px(rpc, apply_bias(rpc, affine), affine, SHAPE, HEIGHTS_M) > 1e-6


def test_on_real_parts_of_products(shared_data: Path) -> None:
    from pcwlad_geo.raster import read_rpc

    affine = correction([[1.0003, 1e-3, 3], [-1e-3, 0.9998, -4]])
    for name in ("img_01", "img_02"):
        source = read_rpc(str(shared_data / f"rpc_pair/{name}.tif"))
        assert source is not None
        covered = covered_range(source.rpc, (1102, 1031), (2270.0, 2377.0))
        biased = apply_bias(source.rpc, affine, covered)
        assert bias_error_px(source.rpc, biased, affine, (1102, 1031), (2270.0, 2377.0)) < 1e-6
