"""From matched points to a correction with an honest accuracy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.fitting import fit_correction
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64
from tests.registrations import make_registration

MATRIX = np.array([[1.003, -0.002, 1.25], [0.001, 0.996, -0.5]])


def table_of(
    n: int = 300, *, noise_px: float = 0.1, matrix: Float64 = MATRIX, seed: int = 1
) -> TiePointTable:
    """Return matched points of an affine displacement, every tenth rejected and 5 px off."""
    made = make_registration("matched", n=n).tie_points
    rng = np.random.default_rng(seed)
    target = made.predicted_px @ matrix[:, :2].T + matrix[:, 2] + rng.normal(0, noise_px, (n, 2))
    target[made.status == "rejected"] += 5
    return replace(made, target_px=target, covariance_px2=np.tile(noise_px**2 * np.eye(2), (n, 1, 1)))


def test_the_affine_truth_comes_back_and_residuals_are_observed_minus_model() -> None:
    table = table_of()
    fitted = fit_correction(table, Settings(), 41.0, (30.0, 30.0))
    assert fitted.correction.name == "affine"
    corners = np.array([[0.0, 0], [600, 0], [600, 400], [0, 400]])
    truth = corners @ MATRIX[:, :2].T + MATRIX[:, 2]
    assert np.abs(fitted.correction.forward(corners) - truth).max() < 0.06
    residual = table.target_px - fitted.correction.forward(table.predicted_px)
    np.testing.assert_allclose(fitted.table.residual_px, residual, atol=1e-12)


def test_a_shift_is_enough_for_a_shift() -> None:
    shift = np.array([[1.0, 0, 1.25], [0, 1, -0.5]])
    fitted = fit_correction(table_of(matrix=shift), Settings(), 41.0, None)
    assert fitted.correction.name == "shift"
    np.testing.assert_allclose(fitted.correction.forward(np.zeros((1, 2))), [[1.25, -0.5]], atol=0.03)


@pytest.mark.parametrize("name", ["shift", "affine", "projective", "tps"])
def test_the_model_can_be_given(name: str) -> None:
    fitted = fit_correction(table_of(), Settings(model=name), 41.0, None)
    assert fitted.correction.name == name
    assert [candidate.name for candidate in fitted.selection.candidates] == [name]


def test_the_order_of_a_polynomial_is_chosen() -> None:
    table = table_of()
    fitted = fit_correction(table, Settings(model="polynomial"), 41.0, None)
    assert fitted.correction.name == "polynomial2"
    u = (table.predicted_px - [300, 200]) / 200
    bent = replace(table, target_px=table.target_px + np.column_stack([u[:, 0] ** 3, u[:, 1] ** 3]))
    assert fit_correction(bent, Settings(model="polynomial"), 41.0, None).correction.name == "polynomial3"


def test_waves_get_a_spline_and_the_reasons_are_told() -> None:
    table = table_of(600)
    bumps = 2 * np.sin(2 * np.pi * table.predicted_px / 400)
    fitted = fit_correction(replace(table, target_px=table.target_px + bumps), Settings(), 41.0, None)
    assert fitted.correction.name == "tps"
    assert fitted.accuracy["check_px"].rmse < 0.25
    candidates = fitted.selection.candidates
    assert [candidate.name for candidate in candidates if candidate.chosen] == ["tps"]
    assert all(candidate.note for candidate in candidates if not candidate.chosen)


def test_the_target_must_not_fold_beyond_the_points() -> None:
    table = table_of()
    u = (table.predicted_px - [300, 200]) / 300
    bent = replace(table, target_px=table.target_px + np.column_stack([60 * u[:, 0] ** 2, 0 * u[:, 1]]))
    settings = Settings(model="projective")
    assert fit_correction(bent, settings, 41.0, None).correction.name == "projective"
    with pytest.raises(InputError, match="fold"):
        fit_correction(bent, settings, 41.0, None, shape=(400, 40000))


def test_check_points_are_held_out_and_used_for_the_figures_only() -> None:
    table = table_of()
    fitted = fit_correction(table, Settings(), 41.0, (30.0, 20.0))
    status = fitted.table.status
    assert set(status) <= {"fit", "check", "rejected", "unused"}  # unused: too near to check points
    assert (status == "check").sum() >= 30
    np.testing.assert_array_equal(status == "rejected", table.status == "rejected")
    residual = fitted.table.residual_px[status == "check"]
    check = fitted.accuracy["check_px"]
    assert check.n == len(residual)
    assert check.rmse == pytest.approx(np.sqrt((residual**2).sum(axis=1).mean()))
    assert check.rmse == pytest.approx(0.1 * np.sqrt(2), rel=0.25)
    metres = np.sqrt(((residual * [30, 20]) ** 2).sum(axis=1).mean())
    assert fitted.accuracy["check_m"].rmse == pytest.approx(metres)
    # the check points are no part of the fit
    spoilt = replace(table, target_px=table.target_px + (status == "check")[:, None] * [3.0, 3.0])
    again = fit_correction(spoilt, Settings(), 41.0, None)
    assert again.correction.to_dict() == fitted.correction.to_dict()


def test_without_a_crs_metres_are_not_known() -> None:
    assert np.isnan(fit_correction(table_of(), Settings(), 41.0, None).accuracy["fit_m"].rmse)


def test_points_too_near_to_a_check_point_are_unused_and_nothing_else_is() -> None:
    """Which points are wanted is decided before the fit."""
    fitted = fit_correction(table_of(), Settings(points=40), 41.0, None)
    assert (
        fitted.table.status.tolist()
        == fit_correction(table_of(), Settings(), 41.0, None).table.status.tolist()
    )
    corners = np.array([[0.0, 0], [600, 400]])
    truth = corners @ MATRIX[:, :2].T + MATRIX[:, 2]
    assert np.abs(fitted.correction.forward(corners) - truth).max() < 0.15


def test_few_points_still_fit() -> None:
    fitted = fit_correction(table_of(16), Settings(), 41.0, None)
    assert fitted.accuracy["fit_px"].rmse < 1
    assert (fitted.table.status == "fit").sum() >= 8
