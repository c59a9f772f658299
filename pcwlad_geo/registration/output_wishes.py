"""What the options say of the registered raster, and whether it can be had: before the work."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import numpy as np
from rasterio.crs import CRS
from rasterio.errors import CRSError

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.output_format import OutputFormat, check_format
from pcwlad_geo.raster.output_grid import GridRequest, check_covered, output_lattice
from pcwlad_geo.raster.rpc_files import read_rpc
from pcwlad_geo.raster.source import RasterInfo, describe
from pcwlad_geo.registration.inputs import resolve
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
        except CRSError as error:
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
    ref, tgt = describe(inputs.reference), describe(inputs.target)
    if request.needs_ground:
        _check_placed(ref, tgt)
    by_rpc = settings.dem is not None or settings.model == "rpc" or not tgt.georeferenced
    if made.is_vrt and by_rpc and read_rpc(tgt.uri) is not None:
        raise SettingsError("of = 'VRT': a VRT cannot hold the correction of an RPC; give --of COG or GTiff")
    if not by_rpc:
        check_near(request, ref, tgt)
    grid = request.fixed(ref.grid) or (tgt.grid if request.mode == "target" else ref.grid)
    check_format(made, tgt.uri, grid)


def check_near(request: GridRequest, reference: RasterInfo, target: RasterInfo) -> None:
    """Raise where the grid that is asked for lies far from a target with a geotransform.

    Raises
    ------
    InputError
        Then.
    """
    grid, place = request.fixed(reference.grid), output_lattice(reference.grid, request)
    if grid is None and request.extent is not None:
        x_min, y_min, x_max, y_max = request.extent
        corners_px = place.to_px(np.array([[x_min, y_max], [x_max, y_min]]))
        (left, top), (right, bottom) = corners_px.tolist()
        one = ((right - left, 0.0), (0.0, bottom - top))
        grid = place.remade(one, (left, top), (1, 1))
    if grid is not None:
        check_covered(grid, target.grid.to_xy(target.grid.boundary_px()), target.grid.crs, beyond=BEYOND)


def _check_placed(reference: RasterInfo, target: RasterInfo) -> None:
    for info in (reference, target):
        if not info.georeferenced and (info is reference or read_rpc(info.uri) is None):
            raise InputError(
                f"{info.uri} has no georeferencing (CRS and geotransform), which --like, --tr, --te and "
                "--t-srs need: leave them out, and the output has the reference's pixels"
            )
