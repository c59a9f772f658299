"""Grades of registrations whose faults are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.options import Model, Settings
from pcwlad_geo.registration.fitting import fit_correction
from pcwlad_geo.registration.quality import Quality, assess, shared_residual_px
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64
from tests.registrations import make_registration

WINDOW_PX = 40.0
SIGMA_PX = 0.1


def table_of(
    displacement_px: Float64 | float,
    *,
    n: int = 400,
    noise_px: float = SIGMA_PX,
    rejected: Float64 | None = None,
) -> TiePointTable:
    """Return matched points over 600 x 400 px with a displacement each, and sigmas of 0.1 px."""
    made = make_registration("matched", n=n).tie_points
    noise = np.random.default_rng(5).normal(0, noise_px, (n, 2))
    status = np.full(n, "matched", dtype="<U8")
    if rejected is not None:
        status[rejected] = "rejected"
    return replace(
        made,
        target_px=made.predicted_px + displacement_px + noise,
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (n, 1, 1)),
        status=status,
    )


def graded(table: TiePointTable, model: Model = "auto", places: Float64 | None = None) -> Quality:
    fitted = fit_correction(table, Settings(model=model), WINDOW_PX, None)
    places = everywhere() if places is None else places
    return assess(fitted.table, table, fitted.selection, places, WINDOW_PX)


def everywhere(cols: float = 600.0, rows: float = 400.0) -> Float64:
    return np.stack(np.meshgrid(np.arange(5, cols, 10), np.arange(5, rows, 10)), axis=-1).reshape(-1, 2)


def places_of(n: int = 400) -> Float64:
    return make_registration("matched", n=n).tie_points.predicted_px


def waves(at: Float64, size_px: float, wavelength_px: float) -> Float64:
    return np.asarray(size_px * np.sin(2 * np.pi * at[:, ::-1] / wavelength_px))


def test_a_shift_that_holds_is_good() -> None:
    quality = graded(table_of(1.5))
    assert quality.grade == "good"
    assert quality.reasons == ()
    assert 0 < quality.expected_ce90_px < 0.25
    assert quality.extrapolated_share == 0
    assert quality.refusal is None


@pytest.mark.parametrize(("size_px", "grade"), [(0.6, "fair"), (3.0, "poor")])
def test_displacements_that_the_model_leaves_are_told_with_their_figure(size_px: float, grade: str) -> None:
    quality = graded(table_of(waves(places_of(), size_px, 300)), "shift")
    assert quality.grade == grade
    assert any("parallax" in reason.text for reason in quality.reasons)
    true = np.percentile(np.linalg.norm(waves(everywhere(), size_px, 300), axis=1), 90)
    assert quality.expected_ce90_px == pytest.approx(true, rel=0.2)
    assert quality.refusal is None  # the points are good: the reader decides


def test_what_windows_average_away_is_expected_and_named_and_counts_once_beside_jitter() -> None:
    table = table_of(1.5)
    fitted = fit_correction(table, Settings(model="shift"), WINDOW_PX, None)

    def expected(jitter_px: float, bend_px: float) -> Quality:
        return assess(
            fitted.table, table, fitted.selection, everywhere(), WINDOW_PX, jitter_px, bend_px=bend_px
        )

    quality = expected(0.0, 0.5)  # 0.5 px RMS of a length are 0.76 px at 90 %
    assert quality.expected_ce90_px == pytest.approx(0.76, rel=0.05)
    assert "bends by 0.50 px" in quality.reasons[0].text
    both = expected(0.6, 0.5)
    assert both.expected_ce90_px == expected(0.6, 0.0).expected_ce90_px
    assert "jitter" in both.reasons[0].text


def test_noise_beyond_the_sigmas_is_not_called_parallax() -> None:
    quality = graded(table_of(1.5, noise_px=0.45))
    (reason,) = [each for each in quality.reasons if "check points" in each.text]
    assert "parallax" not in reason.text
    assert "noise" in reason.text


def test_a_second_layer_is_not_good_although_its_points_were_rejected() -> None:
    at = places_of()
    layer = (at < 300).all(axis=1)
    quality = graded(table_of(np.where(layer[:, None], 7.0, 0.0), rejected=layer))
    assert quality.grade == "poor"
    assert quality.expected_ce90_px == pytest.approx(7 * np.sqrt(2), abs=0.5)


def test_ground_beyond_the_points_is_told() -> None:
    at = places_of()
    corner = (at < [200, 130]).all(axis=1)
    table = table_of(1.5)[corner]
    quality = graded(table)
    assert quality.grade == "fair"
    assert quality.extrapolated_share > 0.5
    assert any("beyond the tie points" in reason.text for reason in quality.reasons)
    assert graded(table, places=everywhere(200, 130)).grade == "good"


def test_an_island_in_a_flat_sea_is_told_not_refused() -> None:
    """Good points over a twentieth of the ground: nothing speaks against the correction."""
    at = places_of()
    island = (at < [140, 100]).all(axis=1)
    quality = graded(table_of(1.5)[island])
    assert quality.extrapolated_share > 0.8
    assert quality.grade == "fair"
    assert quality.refusal is None


def test_a_part_that_moves_on_its_own_is_told_from_noise() -> None:
    at = places_of()
    part = (at < [270, 200]).all(axis=1)
    quality = graded(table_of(np.where(part[:, None], 7.0, 0.0)), "shift")
    (reason,) = [each for each in quality.reasons if "check points" in each.text]
    assert "at another depth" in reason.text
    assert "noise" not in reason.text


@pytest.mark.parametrize(("share", "grade"), [(0.02, "good"), (0.08, "fair")])
def test_parts_at_another_depth_are_told_by_the_matches_that_find_it(share: float, grade: str) -> None:
    """Parts smaller than a window, all over the scene: their neighbours reject these matches."""
    n = 400
    elsewhere = np.random.default_rng(5).random(n) < share
    quality = graded(table_of(np.where(elsewhere[:, None], [4.0, 0.0], 0.0), n=n, rejected=elsewhere))
    assert quality.grade == grade
    assert any("another displacement, (+4.0, +0.0) px" in each.text for each in quality.reasons) == (
        share > 0.05
    )


def test_wrong_matches_agree_on_nothing() -> None:
    n = 400
    random = np.random.default_rng(6)
    wrong = random.random(n) < 0.3
    moved = np.where(wrong[:, None], random.uniform(-12, 12, (n, 2)), 0.0)
    quality = graded(table_of(moved, n=n, rejected=wrong))
    assert not any("another displacement" in each.text for each in quality.reasons)


def near_field() -> TiePointTable:
    """Return what two depths 20 px apart leave: 27 of 223 matches kept, in one corner, and not alike."""
    n = 223
    at = places_of(n)
    near = np.argsort(at.sum(axis=1))[:27]
    rejected = np.ones(n, bool)
    rejected[near] = False
    moved = np.random.default_rng(8).uniform(-12, 12, (n, 2))
    moved[near] = 0.0
    moved[near[::3]] = [20.0, 2.0]
    return table_of(moved, n=n, rejected=rejected)


def test_a_correction_of_few_points_that_does_not_fit_them_is_refused() -> None:
    quality = graded(near_field(), "shift")
    assert quality.grade == "poor"
    assert quality.refusal is not None
    assert "12 % of the matches agree" in quality.refusal


def test_a_poor_correction_of_good_points_is_not_refused() -> None:
    moved = np.where(places_of()[:, :1] < 300, 0.0, 20.0)
    quality = graded(table_of(np.hstack([moved, moved])), "shift")
    assert quality.grade == "poor"
    assert quality.refusal is None


def residuals(displacement_px: Float64 | float, noise_px: float = SIGMA_PX) -> TiePointTable:
    table = table_of(displacement_px, noise_px=noise_px)
    return replace(table, residual_px=table.displacement_px, status=np.full(len(table), "fit", dtype="<U8"))


def test_residuals_that_neighbours_share_are_told_from_noise() -> None:
    assert shared_residual_px(residuals(0.0), WINDOW_PX) == 0.0
    assert shared_residual_px(residuals(0.0, noise_px=1.0), WINDOW_PX) == 0.0
    relief = residuals(waves(places_of(), 2.0, 300))
    size = np.percentile(np.linalg.norm(relief.residual_px, axis=1), 68)
    assert shared_residual_px(relief, WINDOW_PX) == pytest.approx(size)
    assert shared_residual_px(relief[:6], WINDOW_PX) == 0.0


def test_noise_that_overlapping_windows_share_is_no_displacement() -> None:
    """A noisy thermal band: points of one window err alike, points of the next one on their own."""
    at = places_of()
    rng = np.random.default_rng(9)
    cells = rng.normal(0, 1.0, (40, 40, 2))
    col, row = np.floor(at / WINDOW_PX).astype(int).T
    noisy = residuals(cells[row, col])
    assert shared_residual_px(noisy, WINDOW_PX) == 0.0


def test_shared_residuals_within_their_sigmas_are_no_displacement() -> None:
    relief = residuals(waves(places_of(), 0.2, 400))
    unsure = replace(relief, covariance_px2=relief.covariance_px2 * 4)
    assert shared_residual_px(unsure, WINDOW_PX) == 0.0
