"""What the options say of the registered raster, and whether it can be had: before the work."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.boundary import LIBRARY_ERRORS
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.output_format import OutputFormat, check_format
from pcwlad_geo.raster.output_grid import GridRequest, check_covered, output_lattice
from pcwlad_geo.raster.rpc_grid import RpcGrid
from pcwlad_geo.raster.rpc_view import ground_grid
from pcwlad_geo.raster.shared_plane import share_plane
from pcwlad_geo.raster.source import RasterInfo, describe
from pcwlad_geo.registration.inputs import resolve
from pcwlad_geo.registration.rpc_target import place_reference, place_target
from pcwlad_geo.registration.settings import Settings

PathLike = str | os.PathLike[str]

BEYOND = 1.0
"""How far a target may turn out to lie from where its georeferencing puts it, as a share of its size."""


def grid_request(
    mode: Literal["reference", "reference-exact", "target"],
    like: Path | str | None,
    tr: tuple[float, float] | None,
    te: tuple[float, float, float, float] | None,
    t_srs: str | None,
) -> GridRequest:
    """Return the output grid that the options of these names ask for.

    Raises
    ------
    SettingsError
        If `t_srs` is no CRS.
    InputError
        If the raster of `like` cannot be read, or has no georeferencing.
    """
    crs = None
    if t_srs is not None:
        try:
            crs = CRS.from_user_input(t_srs)
        except LIBRARY_ERRORS as error:
            raise SettingsError(f"t_srs = {t_srs!r}: give a CRS such as EPSG:32633 ({error})") from error
    found = None if like is None else describe(os.fspath(like))
    if found is not None and not found.georeferenced:
        raise InputError(
            f"{found.uri} has no georeferencing (CRS and geotransform): --like needs a raster with"
        )
    return GridRequest(mode, found.grid if found else None, tr, te, crs)


def requested_grid(settings: Settings) -> GridRequest:
    """Return the output grid that settings ask for, see `grid_request`."""
    return grid_request(settings.grid, settings.like, settings.tr, settings.te, settings.t_srs)


def check_output(reference: PathLike, target: PathLike, settings: Settings) -> None:
    """Check what is asked of the registered raster before a pair is matched.

    Raises
    ------
    SettingsError
        If format or creation options cannot be used.
    InputError
        If a raster cannot be read, has no georeferencing that the grid needs, or lies far from that grid.
    """
    request = requested_grid(settings)
    made = OutputFormat.of(settings.of, settings.co)
    if request == GridRequest(settings.grid) and made == OutputFormat():
        return
    inputs = resolve(reference, target, settings)
    ref, tgt = _as_placed(describe(inputs.reference), describe(inputs.target), inputs.settings)
    ground = ground_grid(ref.grid)
    check_placed(request, {ref.uri: ref.georeferenced, tgt.uri: tgt.georeferenced}, ground)
    if made.is_vrt and isinstance(tgt.grid, RpcGrid):
        raise SettingsError("of = 'VRT': a VRT cannot hold the correction of an RPC; give --of COG or GTiff")
    check_near(request, ground, tgt.grid)
    check_format(made, tgt.uri, request.fixed(ground) or (tgt.grid if request.mode == "target" else ground))


def _as_placed(
    reference: RasterInfo, target: RasterInfo, settings: Settings
) -> tuple[RasterInfo, RasterInfo]:
    """Return the two as the job places them: by RPCs that count, or in one plane."""
    placed_reference, _ = place_reference(reference, target, settings)
    reference = placed_reference.info if placed_reference else reference
    placed, _ = place_target(reference, target, settings)
    if placed or placed_reference:
        return reference, placed.info if placed else target
    return share_plane(reference, target)[:2]


def check_placed(request: GridRequest, georeferenced: Mapping[str, bool], reference: Grid) -> None:
    """Raise where map coordinates are asked for that a pair does not have.

    Parameters
    ----------
    request : GridRequest
    georeferenced : mapping
        By the names of reference and target, whether it has a place.
    reference : Grid
        On the ground; without a CRS both lie in a plane.

    Raises
    ------
    InputError
        Then.
    """
    if not request.needs_ground:
        return
    for name, has_place in georeferenced.items():
        if not has_place:
            raise InputError(
                f"{name} has no georeferencing (CRS and geotransform, or an RPC with --dem), which --like, "
                "--tr, --te and --t-srs need: leave them out, and the output has the reference's pixels"
            )
    if reference.crs is None and (request.like is not None or request.crs is not None):
        raise InputError(
            f"neither {' nor '.join(georeferenced)} has a CRS, which --like and --t-srs need: assign both "
            "theirs (gdal_edit.py -a_srs), or give --tr and --te in the units of their geotransforms"
        )


def check_near(request: GridRequest, reference: Grid, target: Grid) -> None:
    """Raise where the grid that is asked for lies far from where a target's georeferencing puts it.

    Raises
    ------
    InputError
        Then.
    """
    grid, place = request.fixed(reference), output_lattice(reference, request)
    if grid is None and request.extent is not None:
        x_min, y_min, x_max, y_max = request.extent
        corners_px = place.to_px(np.array([[x_min, y_max], [x_max, y_min]]))
        (left, top), (right, bottom) = corners_px.tolist()
        one = ((right - left, 0.0), (0.0, bottom - top))
        grid = place.remade(one, (left, top), (1, 1))
    if grid is not None:
        check_covered(grid, target.to_xy(target.boundary_px()), target.crs, beyond=BEYOND)
