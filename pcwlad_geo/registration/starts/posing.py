"""A target that a pose places: its new grid, and the views of both on it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from affine import Affine

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import AffineTransform, ProjectiveTransform, affine_matrix
from pcwlad_geo.raster import Grid, RpcGrid, ViewPair, map_px, plan_views
from pcwlad_geo.raster.grid import TiltedGrid
from pcwlad_geo.raster.source import is_huge
from pcwlad_geo.registration.starts.alignment import Prealignment, StartingAlignment
from pcwlad_geo.registration.starts.overviews import read_overviews
from pcwlad_geo.registration.starts.pose import Pose
from pcwlad_geo.types import Float64


def posed_start(
    pair: ViewPair, matrix: Float64, search_radius_px: int, evidence: float = 0.0
) -> StartingAlignment:
    """Return a start from a pose, the target placed by it and both on a new matching grid.

    The rasters of the pair have plain geotransforms, or none, or the target was posed before. Target-view px
    are the (3, 3) `matrix`, affine or a homography, times reference-view px, corner-based (col, row); for the
    `evidence` see `Prealignment`. Raises `InputError` if the two do not overlap in this pose, or an overview
    cannot be read.
    """
    reference, target = pair.reference.info, pair.target.info
    tilted = _tilted_plane(pair, matrix)
    grid = _posed_grid(target.grid, pair, matrix, tilted)
    mask_grid = target.mask_grid
    if mask_grid == target.grid:
        mask_grid = grid
    elif mask_grid is not None and mask_grid.crs is not None:
        mask_grid = _posed_grid(mask_grid, pair, matrix, tilted)
    target = replace(target, grid=grid, mask_grid=mask_grid, georeferenced=True)
    views = plan_views(replace(reference, georeferenced=True), target)
    pose = Pose.of(_between(reference.grid, grid), reference.grid.shape)
    start = Prealignment("pose", (0.0, 0.0), search_radius_px, True, pose, evidence)
    return StartingAlignment(start, views, read_overviews(views))


def _posed_grid(grid: Grid, pair: ViewPair, matrix: Float64, plane: TiltedGrid | None) -> Grid:
    """Return a grid of the target moved by a pose, in the CRS of the reference, maybe on a tilted plane."""
    places = grid.lattice_px(9)
    xy = _posed_xy(places, grid, pair, matrix)
    affine = AffineTransform.fit(places, xy if plane is None else plane.to_px(xy))
    transform = Affine(*affine.rows.ravel().tolist())
    if plane is not None:
        return replace(plane, shape=grid.shape, transform=transform)
    return Grid(grid.shape, transform, pair.reference.info.grid.crs)


def _tilted_plane(pair: ViewPair, matrix: Float64) -> TiltedGrid | None:
    """Return the plane that a pose puts into perspective, with the identity as geotransform; None if none."""
    grid, onto = pair.target.info.grid, pair.reference.info.grid
    if type(grid) is Grid and not matrix[2, :2].any():
        return None
    places = grid.lattice_px(9)
    middle_xy = onto.to_xy(onto.middle_px)
    homography, _ = cv2.findHomography(_posed_xy(places, grid, pair, matrix) - middle_xy, places)
    if homography is None:
        raise InputError("the pose places the target on a line")
    tilt = (-homography[2, :2] / homography[2, 2]).tolist()
    return TiltedGrid(grid.shape, Affine.identity(), onto.crs, tuple(middle_xy[0].tolist()), tuple(tilt))


def _posed_xy(places: Float64, grid: Grid, pair: ViewPair, matrix: Float64) -> Float64:
    """Return (n, 2) map coordinates of the reference that a pose gives to (n, 2) px of a grid of the target.

    Raises `InputError` where there are none.
    """
    target_px = map_px(places, grid, pair.target.grid)
    to_reference = (ProjectiveTransform if matrix[2, :2].any() else AffineTransform)(inverse(matrix))
    reference_px = pair.reference.to_file_px(to_reference(target_px))
    if not np.isfinite(reference_px).all():
        raise InputError("the pose places the target where the CRS of the reference is not defined")
    return pair.reference.info.grid.to_xy(reference_px)


def _between(reference: Grid, target: Grid) -> Float64:
    """Return the (3, 3) matrix from px of one grid to those of another of the same CRS.

    In perspective it is that of the middle.
    """
    at_px = reference.middle_px if isinstance(target, TiltedGrid) else np.zeros((1, 2))
    corners = map_px(at_px + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), reference, target)
    linear = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])
    return affine_matrix(linear, corners[0] - linear @ at_px[0])


def can_be_posed(pair: ViewPair) -> bool:
    """Return whether a pose can be given to the target: both have geotransforms, or none, but no RPC.

    A search for it reads all of both, which must not be too large.
    """
    grids = pair.reference.info.grid, pair.target.info.grid
    return all(not (isinstance(grid, RpcGrid) or is_huge(grid)) for grid in grids)
