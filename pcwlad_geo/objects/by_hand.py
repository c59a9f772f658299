"""Corrections made by hand."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import ArrayLike

from pcwlad_geo.arguments import checked, shown
from pcwlad_geo.correction.models import AffineCorrection, ProjectiveCorrection
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import (
    AffineTransform,
    ProjectiveTransform,
    ShiftTransform,
    SimilarityTransform,
    finite_array,
)
from pcwlad_geo.objects.correction import Correction


@checked()
def shift(cols: float, rows: float) -> Correction:
    """Return the correction of a target that shows all `cols` px right of and `rows` px below its place.

    It is made by hand, and taken to be exact: ``shift(1.0, 0.0) @ correction`` corrects one px more along the
    columns.
    """
    offset = _numbers([cols, rows], (2,), "shift")
    return Correction(AffineCorrection("shift", ShiftTransform.by(offset).rows))


@checked("about")
def similarity(
    angle_deg: float = 0.0,
    scale: float = 1.0,
    *,
    cols: float = 0.0,
    rows: float = 0.0,
    about: ArrayLike = (0.0, 0.0),
) -> Correction:
    """Return the correction of a target that is turned, scaled and shifted.

    Parameters
    ----------
    angle_deg : float
        Angle by which the target is turned from its columns towards its rows, clockwise as it is seen.
    scale : float
        Factor by which it shows everything larger.
    cols, rows : float
        Shift after that, px.
    about : (2,) array
        Place (col, row) about which it is turned and scaled, px.
    """
    centre, offset = _numbers(about, (2,), "about"), _numbers([cols, rows], (2,), "cols, rows")
    angle, factor = _numbers([angle_deg, scale], (2,), "angle_deg, scale").tolist()
    if factor <= 0:
        raise InputError(f"scale = {factor:g}: give a scale above 0")
    turned = SimilarityTransform.from_angle(math.radians(angle), factor)
    similarity = ShiftTransform.by(centre + offset) @ turned @ ShiftTransform.by(-centre)
    return affine(similarity.matrix[:2], name="similarity")


@checked("matrix")
def affine(matrix: ArrayLike, *, name: str = "affine") -> Correction:
    """Return the correction whose observed px are ``matrix · (predicted col, predicted row, 1)``.

    Parameters
    ----------
    matrix : (2, 3) array
        The last column in px.
    name : str
        What it is called.
    """
    rows = _numbers(matrix, (2, 3), "matrix")
    return Correction(AffineCorrection(name, _checked_transform(AffineTransform, rows).matrix[:2]))


@checked("matrix")
def projective(matrix: ArrayLike) -> Correction:
    """Return the correction whose observed px are those of a homography.

    Parameters
    ----------
    matrix : (3, 3) array
        (w·observed col, w·observed row, w) = matrix · (predicted col, predicted row, 1), of positive w over
        the target.
    """
    rows = _numbers(matrix, (3, 3), "matrix")
    return Correction(
        ProjectiveCorrection("projective", _checked_transform(ProjectiveTransform, rows).matrix)
    )


def _checked_transform(kind: type[ProjectiveTransform], rows: Any) -> ProjectiveTransform:  # noqa: ANN401
    try:
        return kind.from_numbers(rows)
    except ValueError as error:
        raise InputError(f"matrix = {rows.tolist()}: {error}: give that of an image") from error


def _numbers(values: ArrayLike, shape: tuple[int, ...], name: str) -> Any:  # noqa: ANN401
    """Return finite numbers as an array of a shape; raise `InputError` with the name if they are none."""
    try:
        return finite_array(values, shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} = {shown(values):.200}: give finite numbers of shape {shape}") from error
