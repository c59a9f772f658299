"""Control points of a stack: positions in images whose ground positions are known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_coordinates
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.inputs import number_of, read_table
from pcwlad_geo.multi.stack.parameters import CONTROL, ControlParameters
from pcwlad_geo.raster.grid import linear_part
from pcwlad_geo.types import Float64, PathLike

CONTROL_COLUMNS: Final = ("image", "col", "row", "x", "y")
"""Columns that a table of control points must have."""


@dataclass(frozen=True, slots=True)
class ControlPoint:
    """A position in an image whose ground position is known."""

    image: str
    """Name of the image."""
    col: float
    """Position in the file, px, corner-based."""
    row: float
    x: float
    """Position on the ground, CRS of the reference."""
    y: float
    sigma: float | None = None
    """Standard deviation along an axis, units of x and y; null: half a pixel of the reference."""


def control_points(table: PathLike) -> tuple[ControlPoint, ...]:
    """Read control points from a table with the columns image, col, row, x, y and, if known, sigma.

    Raises `InputError` if it cannot be used.
    """
    rows = read_table(Path(table), CONTROL_COLUMNS)
    return tuple(control_point(row, str(table)) for row in rows)


def control_point(row: Mapping[str, str], origin: str) -> ControlPoint:
    """Return the control point of a line of the table `origin`; raises `InputError` if it cannot be used."""
    col_px, row_px, x, y = (number_of(row, column) for column in CONTROL_COLUMNS[1:])
    sigma = number_of(row, "sigma") if row.get("sigma") else None
    point = ControlPoint(row["image"], col_px, row_px, x, y, sigma)
    check_control(point, origin)
    return point


def check_control(point: ControlPoint, origin: str) -> None:
    """Raise `InputError` if a control point of the file `origin` holds no usable numbers."""
    values = (point.col, point.row, point.x, point.y, 1.0 if point.sigma is None else point.sigma)
    if not all(math.isfinite(value) for value in values) or values[4] <= 0:
        raise InputError(
            f"{origin}: the control points of {point.image} need finite numbers and sigmas above 0"
        )
    check_coordinates(origin, values)


def control_edges(
    points: Sequence[ControlPoint],
    frame: StackFrame,
    ground: int | None = None,
    parameters: ControlParameters = CONTROL,
) -> list[Edge]:
    """Return the control points of each image as a pair of the ground itself and the image.

    The number of the `ground` is that after the last image by default. Raises `InputError` if they name no
    image of the frame or are too few, or the images are not georeferenced.
    """
    if points and not frame.georeferenced:
        raise InputError("images without georeferencing have no place for control points")
    unit = abs(float(np.linalg.det(linear_part(frame.grid.transform)))) ** 0.5
    edges = []
    for name in dict.fromkeys(point.image for point in points):
        if name not in frame.names:
            raise InputError(
                f"control points are of {name}, which is none of the images {', '.join(frame.names)}"
            )
        image_points = [point for point in points if point.image == name]
        if len(image_points) < parameters.min_points:
            raise InputError(
                f"there are {len(image_points)} control points of {name}: give {parameters.min_points}"
            )
        image = frame.names.index(name)
        at_px = frame.from_image(image, np.array([(point.col, point.row) for point in image_points]))
        on_ground = frame.grid.to_px(np.array([(point.x, point.y) for point in image_points]))
        check_place(name, at_px, on_ground, sum(frame.grid.shape) + sum(frame.infos[image].grid.shape))
        sigmas = [point.sigma / unit if point.sigma else parameters.sigma_px for point in image_points]
        covariance = np.maximum(sigmas, parameters.min_sigma_px)[:, None, None] ** 2 * np.eye(2)
        number = len(frame.names) if ground is None else ground
        edges.append(Edge(number, image, on_ground, at_px, covariance, evidence=parameters.evidence))
    return edges


def check_place(name: str, at_px: Float64, placed_px: Float64, size_px: int) -> None:
    """Raise `InputError` if the control points of the image `name` do not lie on it.

    Their (n, 2) positions in it are `at_px`, and the (n, 2) `placed_px` are those of their ground positions
    by its georeferencing; `size_px` is the largest median difference.
    """
    check = "check the order of x and y, their CRS, which is that of the reference, and heights"
    for col, row in at_px[~np.isfinite(placed_px).all(axis=1)][:1]:
        raise InputError(
            f"the ground of the control point at ({col:.1f}, {row:.1f}) px (col, row) of {name} is nowhere "
            f"in it by its georeferencing: {check}"
        )
    off_px = float(np.hypot(*np.median(placed_px - at_px, axis=0)))
    if not off_px <= size_px:
        raise InputError(
            f"the control points of {name} lie {off_px:.3g} px of the frame from where its georeferencing "
            f"places them: {check}"
        )


def datum_of(frame: StackFrame, datum: str, control: Sequence[Edge], count: int) -> int | None:
    """Return what stays: None, the mean; control points, which follow `count` images; or the reference."""
    return None if datum == "mean" else count if control else frame.reference
