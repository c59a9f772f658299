from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.dense import Lattice
from pcwlad_geo.correction.models import (
    AffineCorrection,
    ProjectiveCorrection,
    SmoothCorrection,
    has_foldover,
)

from .points import affine, polynomial, projective, spline

BOX = np.zeros(2), np.array([512.0, 512.0])


@pytest.mark.parametrize("correction", [affine(3.0), projective(), polynomial(3), spline()])
def test_small_displacements_do_not_fold(correction: AffineCorrection) -> None:
    assert not has_foldover(correction, *BOX)


def test_a_mirror_turns_the_image_over() -> None:
    assert has_foldover(AffineCorrection("affine", np.array([[-1.0, 0, 512], [0, 1, 0]])), *BOX)


def test_a_half_turn_does_not() -> None:
    assert not has_foldover(AffineCorrection("affine", np.array([[-1.0, 0, 512], [0, -1, 512]])), *BOX)


def test_a_horizon_in_the_image() -> None:
    matrix = np.array([[1.0, 0, 0], [0, 1, 0], [-1 / 400, 0, 1]])
    assert has_foldover(ProjectiveCorrection("projective", matrix), *BOX)
    assert not has_foldover(ProjectiveCorrection("projective", matrix), np.zeros(2), np.array([390.0, 512.0]))


def test_a_fold_of_one_spline_cell() -> None:
    correction = spline(size_px=0.0, cells=40)
    assert not has_foldover(correction, *BOX)
    correction.coefficients_px[20, 20] = [120.0, 0.0]
    assert has_foldover(correction, *BOX)


@pytest.mark.parametrize("correction", [polynomial(2), polynomial(3), spline(), spline(cells=40)])
def test_a_lattice_is_where_its_single_nodes_are(correction: SmoothCorrection) -> None:
    lattice = Lattice.over(np.array([-90.0, -30.0]), np.array([600.0, 700.0]), 7.0)  # beyond the points too
    nodes_px = lattice.nodes_px().reshape(*lattice.shape, 2)
    singly = correction.forward(nodes_px.reshape(-1, 2)).reshape(nodes_px.shape)
    np.testing.assert_allclose(correction.at_nodes(nodes_px), singly, rtol=0, atol=1e-9)


def test_an_affine_that_squeezes_all_onto_a_line_folds() -> None:
    assert has_foldover(AffineCorrection("affine", np.array([[1.0, 2, 0], [2, 4, 0]])), *BOX)
    assert has_foldover(AffineCorrection("affine", np.full((2, 3), np.nan)), *BOX)
