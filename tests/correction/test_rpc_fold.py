from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.rpc_fold import FOLD_TOLERANCE_PX, fold, fold_error_px
from tests.rpc_scene import SHAPE, make_rpc

HEIGHTS_M = (0.0, 800.0)


def correction(matrix: object) -> AffineCorrection:
    return AffineCorrection("affine", np.array(matrix, dtype=np.float64))


@pytest.mark.parametrize(
    "matrix", [[[1, 0, 3.3], [0, 1, -7.1]], [[1.0004, 0, 3.3], [0, 0.9997, -7.1]]], ids=["shift", "own gain"]
)
def test_shift_and_the_gain_of_an_axis_are_exact(matrix: object) -> None:
    rpc = make_rpc()
    folded = fold(rpc, correction(matrix))
    assert fold_error_px(rpc, folded, correction(matrix), SHAPE, HEIGHTS_M) < 1e-9
    assert folded.samp_num_coeff == rpc.samp_num_coeff
    assert folded.line_num_coeff == rpc.line_num_coeff


@settings(deadline=None)
@given(*[st.floats(-2e-3, 2e-3)] * 4, st.floats(-50, 50), st.floats(-50, 50))
def test_an_affine_folds_to_a_thousandth_of_a_pixel(
    a: float, b: float, d: float, e: float, col: float, row: float
) -> None:
    rpc, affine = make_rpc(), correction([[1 + a, b, col], [d, 1 + e, row]])
    assert fold_error_px(rpc, fold(rpc, affine), affine, SHAPE, HEIGHTS_M) <= FOLD_TOLERANCE_PX


def test_the_folded_rpc_gives_observed_pixels_at_any_ground() -> None:
    rpc, affine = make_rpc(), correction([[1.0002, 3e-4, 5], [-2e-4, 0.9999, -3]])
    rng = np.random.default_rng(2)
    heights = rng.uniform(*HEIGHTS_M, 300)
    pixels = rng.uniform((0, 0), SHAPE[::-1], (300, 2))
    ground = np.column_stack([rpc.to_ground(pixels, heights), heights])
    observed = fold(rpc, affine).to_px(ground)
    np.testing.assert_allclose(observed, affine.forward(pixels), rtol=0, atol=FOLD_TOLERANCE_PX)


def test_the_error_is_that_of_the_worst_place() -> None:
    rpc, affine = make_rpc(), correction([[1, 0, 0.25], [0, 1, 0]])
    assert fold_error_px(rpc, rpc, affine, SHAPE, HEIGHTS_M) == pytest.approx(0.25, abs=1e-9)


def test_on_the_real_rpc(shared_data: Path) -> None:
    from pcwlad_geo.raster.rpc_files import read_rpc

    source = read_rpc(str(shared_data / "rpc/qb2_basic1b.tif"))
    assert source is not None
    affine = correction([[1.0003, 1e-4, 3], [-1e-4, 0.9998, -4]])
    error = fold_error_px(source.rpc, fold(source.rpc, affine), affine, (1450, 850), (150.0, 900.0))
    assert error < 1e-5
