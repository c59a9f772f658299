"""Geotransforms without a CRS: one plane for two rasters, where that can be told."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import shapely

from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.source import RasterInfo

LEAST_SHARED: Final = 0.1
"""Part of the smaller extent that must lie in the other for coordinates to be taken as those of its CRS."""


def share_plane(reference: RasterInfo, target: RasterInfo) -> tuple[RasterInfo, RasterInfo, tuple[str, ...]]:
    """Place two rasters by geotransforms that have no CRS.

    - Neither has a CRS: both geotransforms count, in one plane of unknown units.
    - One has a CRS, and the coordinates of the other lie there: they are taken to be in that CRS.
    - Otherwise both stay as they are.

    Returns
    -------
    reference, target : RasterInfo
        With the grids that follow.
    warnings : tuple of str
        What was taken to be so.
    """
    if reference.plane_transform is not None and target.plane_transform is not None:
        warning = (
            f"neither {reference.uri} nor {target.uri} has a CRS: their geotransforms are taken to be in one "
            "plane, and metres are not known; assign both their CRS (gdal_edit.py -a_srs) to have them"
        )
        return _placed(reference, None), _placed(target, None), (warning,)
    for lacking, other in ((reference, target), (target, reference)):
        grid = grid_beside(lacking, other.grid)
        if grid.crs is not None and not lacking.georeferenced:
            warning = (
                f"{lacking.uri} has a geotransform and no CRS: it is taken to be in {name_of(grid.crs)} as "
                f"{other.uri}, where its coordinates lie; assign it its CRS (gdal_edit.py -a_srs)"
            )
            found = _placed(lacking, grid)
            return (found, target, (warning,)) if lacking is reference else (reference, found, (warning,))
    return reference, target, ()


def grid_beside(info: RasterInfo, grid: Grid) -> Grid:
    """Return where a raster lies, its geotransform without a CRS taken to be in the coordinates of a grid.

    Its own grid where it has no such geotransform, the grid has no place, or the two lie apart.
    """
    if info.plane_transform is None or info.georeferenced or not grid.located:
        return info.grid
    own = Grid(info.grid.shape, info.plane_transform, grid.crs)
    extents = [shapely.Polygon(each.to_xy(each.boundary_px())) for each in (own, grid)]
    least = min(extent.area for extent in extents)
    shared = extents[0].intersection(extents[1]).area
    return own if shared >= LEAST_SHARED * least > 0 else info.grid


def _placed(info: RasterInfo, grid: Grid | None) -> RasterInfo:
    if grid is None and info.plane_transform is not None:
        grid = Grid(info.grid.shape, info.plane_transform, None)
    return replace(info, grid=grid or info.grid, georeferenced=True)
