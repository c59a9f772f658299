"""Tie points and control points of images with RPCs, in the pixels of their files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcwlad_geo.correction.points import thin
from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_coordinates
from pcwlad_geo.multi.block.block import BlockPair
from pcwlad_geo.multi.block.parameters import BLOCK, BlockParameters
from pcwlad_geo.multi.stack.control_points import (
    CONTROL_COLUMNS,
    check_place,
    control_point,
)
from pcwlad_geo.multi.stack.inputs import number_of, read_table
from pcwlad_geo.multi.stack.pairs import MeasuredPair
from pcwlad_geo.multi.stack.parameters import CONTROL, ControlParameters
from pcwlad_geo.multi.stack.rpc_images import PlacedImages
from pcwlad_geo.raster import Grid, at_mean_height, pixel_sizes_m, transform_xy
from pcwlad_geo.raster.rpc.grid import image_px
from pcwlad_geo.types import PathLike


def tie_points_of(measured: Sequence[MeasuredPair], parameters: BlockParameters = BLOCK) -> list[BlockPair]:
    """Return the tie points of the pairs that were matched, in the pixels of their files."""
    pairs = []
    for measurement in measured:
        edge, points = measurement.edge, measurement.points
        if edge is None or points is None:
            continue
        sigma_px = points.sigma_px
        if sigma_px is None:
            folder = measurement.pair.folder
            raise InputError(f"{folder} has tie points without sigma: remove it, and run again")
        good = points.enabled & (sigma_px > 0).all(axis=1)
        selection = np.flatnonzero(good)[
            thin(points.target[good], np.hypot(*sigma_px[good].T), parameters.max_pair_points)
        ]
        covariance = np.einsum("na,ab->nab", sigma_px[selection] ** 2, np.eye(2))
        places_px = points.reference[selection], points.target[selection]
        window_px = measurement.window_px
        pairs.append(BlockPair(edge.first, edge.second, *places_px, covariance, window_px=window_px))
    return pairs


def control_points_of(
    table: PathLike, block: PlacedImages, parameters: ControlParameters = CONTROL
) -> list[BlockPair]:
    """Return the control points of a table, image by image, as points between the ground and the image.

    It has the columns image, col, row (px of the file, corner-based), x, y (CRS of the reference; without
    one, of the DEM) and, if known, z (metres above the ellipsoid; else the DEM's height) and sigma (metres
    along an axis). Raises `InputError` if it cannot be used.
    """
    frame, dem = block.frame, block.block.dem
    rows = read_table(Path(table), CONTROL_COLUMNS)
    points = [control_point(row, str(table)) for row in rows]
    heights = np.array([number_of(row, "z") if row.get("z") else np.nan for row in rows])
    check_coordinates(str(table), heights[np.array([bool(row.get("z")) for row in rows], bool)].tolist())
    crs = frame.grid.crs if block.placements[0] is None or dem is None else dem.grid.crs
    pairs = []
    for name in dict.fromkeys(point.image for point in points):
        image = frame.names.index(name) if name in frame.names else None
        if image is None or block.placements[image] is None:
            raise InputError(f"{table} names {name}, which is none of the images with RPCs")
        numbers = [number for number, point in enumerate(points) if point.image == name]
        at = np.array([(points[k].col, points[k].row, points[k].x, points[k].y) for k in numbers])
        grid = frame.infos[image].grid
        sigma_m = np.array([points[k].sigma or np.nan for k in numbers])
        sigma_px = np.nan_to_num(sigma_m / pixel_m(grid), nan=parameters.sigma_px)
        covariance = np.maximum(sigma_px, parameters.min_sigma_px)[:, None, None] ** 2 * np.eye(2)
        ground_px = frame.grid.to_px(transform_xy(at[:, 2:], crs, frame.grid.crs))
        placed_px = image_px(grid, frame.grid, ground_px, heights[numbers])
        check_place(name, at[:, :2], placed_px, sum(frame.grid.shape) + sum(grid.shape))
        pairs.append(BlockPair(len(frame.names), image, ground_px, at[:, :2], covariance, heights[numbers]))
    return pairs


def pixel_m(grid: Grid) -> float:
    """Return the side of a pixel in the middle of an image, metres; 1 without a CRS."""
    sizes = pixel_sizes_m(at_mean_height(grid), grid.middle_px)
    return 1.0 if sizes is None else float(np.mean(sizes[0]))
