"""A target that the user places, whatever its file says of where it lies."""

from __future__ import annotations

from dataclasses import replace

from affine import Affine

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.georeferencing import check_place
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.vrt import compose


def place_by_hand(
    reference: RasterInfo, target: RasterInfo, geotransform: tuple[float, ...]
) -> tuple[RasterInfo, RasterInfo]:
    """Return the two rasters, the target with a GDAL geotransform in the CRS of the reference.

    Its mask moves with it. Raises `InputError` if the reference has no georeferencing.
    """
    if not reference.georeferenced and reference.plane_transform is None:
        raise InputError(
            f"{reference.uri} has no georeferencing (CRS and geotransform), in which --place could place "
            f"{target.uri}: give a reference that has"
        )
    if not reference.georeferenced and reference.plane_transform is not None:
        plane = replace(reference.grid, transform=reference.plane_transform)
        reference = replace(reference, grid=plane, georeferenced=True)
    before, crs, mask = target.grid, reference.grid.crs, target.mask_grid
    transform = Affine.from_gdal(*geotransform)
    grid = Grid(before.shape, transform, crs, by_hand=True)
    check_place("--place", grid, None)
    if mask is not None and mask.crs is not None and target.georeferenced:
        moved = compose(transform, ~before.transform, mask.transform)
        if mask.crs != before.crs:
            raise InputError(
                f"the mask {target.mask_uri} is in another CRS than {target.uri}, which --place moves: give "
                "it on the pixels of the target"
            )
        mask = Grid(mask.shape, moved, crs)
    elif mask is not None:  # it has the target's pixels
        mask = Grid(mask.shape, transform, crs)
    placed = replace(
        target, grid=grid, mask_grid=mask, georeferenced=True, plane_transform=None, gcp_misfit_px=None
    )
    return reference, placed
