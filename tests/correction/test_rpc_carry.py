"""Corrections carried over to siblings, whose images are related to the target's in a way known here."""

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.raster import RpcModel
from pcwlad_geo.raster.rpc.bias import apply_bias, carried, covered_range, parallax
from tests.rpc_scene import SHAPE, decimated, make_rpc, oblique_rpc, of_a_product

HEIGHTS_M = (100.0, 700.0)
SHIFT = AffineCorrection("shift", np.array([[1.0, 0.0, 2.6], [0.0, 1.0, -1.4]]))
AFFINE = AffineCorrection("affine", np.array([[1.001, 2e-3, 2.6], [-1e-3, 0.9995, -1.4]]))


def turned(rpc: RpcModel) -> RpcModel:
    """Return the RPC of the image whose columns are the rows and whose rows are the columns."""
    axes = {"samp": "line", "line": "samp"}
    names = ("{}_off", "{}_scale", "{}_num_coeff", "{}_den_coeff")
    return replace(
        rpc,
        **{name.format(new): getattr(rpc, name.format(old)) for new, old in axes.items() for name in names},
    )


def carry(
    correction: AffineCorrection, sibling: RpcModel, shape: tuple[int, int]
) -> tuple[AffineCorrection, float]:
    rpc = make_rpc()
    corrected = apply_bias(rpc, correction, covered_range(rpc, SHAPE, HEIGHTS_M))
    return carried(rpc, corrected, sibling, shape, HEIGHTS_M)


@pytest.mark.parametrize("factor", [0.25, 1.0, 4.0])
def test_a_shift_scales_with_the_pixels(factor: float) -> None:
    shape = (round(SHAPE[0] / factor), round(SHAPE[1] / factor))
    found, misfit_px = carry(SHIFT, decimated(make_rpc(), factor), shape)
    assert found.name == "shift"
    np.testing.assert_allclose(found.matrix[:, 2], SHIFT.matrix[:, 2] / factor, rtol=0, atol=1e-5)
    assert misfit_px < 1e-4


def test_a_shift_follows_the_axes() -> None:
    found, _ = carry(SHIFT, turned(make_rpc()), SHAPE[::-1])
    np.testing.assert_allclose(found.matrix[:, 2], SHIFT.matrix[::-1, 2], rtol=0, atol=1e-5)


def test_an_affine_is_one_in_the_siblings_pixels() -> None:
    factor = 4.0
    found, misfit_px = carry(AFFINE, decimated(make_rpc(), factor), (SHAPE[0] // 4, SHAPE[1] // 4))
    assert found.name == "affine"
    assert misfit_px < 1e-3
    corners = np.array([[0.0, 0.0], [80.0, 0.0], [80.0, 75.0], [0.0, 75.0]])
    expected = AFFINE.forward(corners * factor) / factor
    np.testing.assert_allclose(found.forward(corners), expected, rtol=0, atol=1e-3)


def test_another_normalisation_is_no_matter() -> None:
    found, _ = carry(SHIFT, of_a_product(make_rpc()), SHAPE)
    np.testing.assert_allclose(found.matrix, SHIFT.matrix, rtol=0, atol=1e-5)


def test_parallax_tells_another_viewpoint() -> None:
    rpc = make_rpc()
    assert parallax(rpc, decimated(rpc, 4.0), (75, 80), HEIGHTS_M) < 1e-6
    # 0.02 and 0.042 px of 30 m a metre of height
    assert parallax(rpc, oblique_rpc(), SHAPE, HEIGHTS_M) == pytest.approx(1.4, abs=0.1)
