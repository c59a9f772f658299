"""Rasters and vectors moved together by an amount that the user gives, their pixels untouched."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.arguments import checked, shown
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.events import EventCallback, Progress, ignore
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.outputs.folder import place_with_files, stage_inside
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.raster import (
    Grid,
    GridRequest,
    OutputFormat,
    RasterInfo,
    Trust,
    describe,
    trusting,
    vrt,
)
from pcwlad_geo.raster.crs import name_of
from pcwlad_geo.raster.output_format import write_cog
from pcwlad_geo.raster.vectors import checked_vector, read_layers
from pcwlad_geo.report.finished import FinishedRegistration
from pcwlad_geo.types import PathLike
from pcwlad_geo.vector_warping import Movement, is_vector, moved_vectors, vector_place, write_vectors


class _Place(NamedTuple):
    """Where the first file lies: the movement is in its CRS and, by default, about its middle."""

    crs: CRS | None
    middle_xy: tuple[float, float]


@checked()
def shift_files(
    files: Sequence[PathLike],
    by: tuple[float, float],
    *,
    angle_deg: float = 0.0,
    about: tuple[float, float] | None = None,
    copy: bool = False,
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    allow_remote: bool = False,
    trust_vrt: bool = False,
    on_event: EventCallback = ignore,
) -> tuple[Path, ...]:
    """Move rasters and vectors by the same amount; pixels are not resampled, and nothing is matched.

    Parameters
    ----------
    files : sequence of path
        Rasters with a geotransform in one CRS, and vector files in any.
    by : (float, float)
        Movement along x and y, in the units of the CRS of the first file.
    angle_deg : float
        Rotation before that, counter-clockwise.
    about : (float, float), optional
        What the rotation leaves in place, in that CRS; the middle of the first file by default.
    copy : bool
        Write copies of the rasters (COG) instead of small VRTs that show the originals elsewhere.
    out_dir : path, optional
        Folder of ``<raster stem>_shifted.vrt`` (``.tif``) and ``<vector stem>_shifted.<suffix>``; the working
        folder by default.
    overwrite : bool
        Replace files that exist.
    allow_remote, trust_vrt : bool
        As for `register`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the work.

    Returns
    -------
    tuple of pathlib.Path
        The files written, in the order of the `files`.

    Raises
    ------
    InputError
        If a file cannot be read, or a raster has no geotransform or is in another CRS than the first file.
    OutputError
        If a result cannot be written; those before it are kept.
    """
    if not all(abs(number) <= LIMITS.coordinate for number in (*by, angle_deg, *(about or ()))):
        raise SettingsError(
            f"by = {shown(by)}, angle_deg = {shown(angle_deg)}: give finite numbers up to "
            f"{LIMITS.coordinate:.0e}"
        )
    names, folder = [os.fspath(file) for file in files], Path(out_dir or ".")
    if not names:
        raise InputError("no file to shift: give at least one")
    with trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        vectors = [name for name in names if is_vector(name)]
        infos = {name: describe(name, part=True) for name in names if name not in vectors}
        first = _place_of(names[0], infos.get(names[0]))
        grids = {name: _grid(info, first.crs) for name, info in infos.items()}
        places = {name: vector_place(name, folder, "shifted") for name in vectors}
        places |= {name: folder / f"{Path(name).stem}_shifted.{'tif' if copy else 'vrt'}" for name in grids}
        check_outputs([*places.values()], names, overwrite=overwrite)
        movement = _movement(by, angle_deg, about or first.middle_xy)
        correction = AffineCorrection("affine", np.array(movement[:6]).reshape(2, 3))
        plane = Grid((1, 1), Affine.identity(), first.crs)
        moving = FinishedRegistration(correction, plane, plane, GridRequest(), OutputFormat(), "nearest")
        how = Movement(moving, None, is_inverse=True, everywhere=True)
        moved_layers = moved_vectors(vectors, how, on_event)
        for number, (name, grid) in enumerate(grids.items()):
            on_event(Progress("rasters", number, len(grids)))
            moved_grid = Grid(grid.shape, vrt.compose(movement, grid.transform), grid.crs)
            _write_raster(name, places[name], moved_grid, copy=copy, overwrite=overwrite)
        moved_places = [places[name] for name in vectors]
        write_vectors(moved_layers, vectors, moved_places, overwrite=overwrite, on_event=on_event)
    return tuple(places[name] for name in names)


def _movement(by: tuple[float, float], angle_deg: float, about: tuple[float, float]) -> Affine:
    """Return the transformation of map coordinates: a rotation about a place, then a shift."""
    rotation = (
        Affine.translation(*about),
        Affine.rotation(angle_deg),
        Affine.translation(-about[0], -about[1]),
    )
    return vrt.compose(Affine.translation(*by), *(rotation if angle_deg else ()))


def _place_of(name: str, info: RasterInfo | None) -> _Place:
    """Return where a file lies, a raster if it is described."""
    if info is not None:
        grid = _grid(info, info.grid.crs)
        return _Place(grid.crs, tuple(grid.to_xy(grid.middle_px)[0].tolist()))
    layer = next(
        (one for one in read_layers(checked_vector(name, "objects.gpkg")) if one.geometry is not None), None
    )
    if layer is None:
        raise InputError(f"{name} has no layer with geometry: there is nothing to move")
    x_min, y_min, x_max, y_max = np.nan_to_num(
        shapely.total_bounds(shapely.from_wkb(layer.geometry))
    ).tolist()
    crs = None if layer.crs is None else CRS.from_user_input(layer.crs)
    return _Place(crs, ((x_min + x_max) / 2, (y_min + y_max) / 2))


def _grid(info: RasterInfo, crs: CRS | None) -> Grid:
    """Return the grid of a raster; raise if it has no geotransform, or is in another CRS than `crs`."""
    if info.gcp_misfit_px is not None or not (info.georeferenced or info.plane_transform):
        raise InputError(
            f"{info.uri} has no geotransform that could be moved: give it one "
            "(gdal_edit.py -a_ullr), or warp it first (gdalwarp -tps)"
        )
    if info.grid.crs != crs:
        raise InputError(
            f"{info.uri} is in {name_of(info.grid.crs)} and the first file in {name_of(crs)}, in whose "
            "units all are moved: shift it in a call of its own"
        )
    return (
        info.grid
        if info.georeferenced
        else Grid(info.grid.shape, info.plane_transform or Affine.identity(), None)
    )


def _write_raster(name: str, place: Path, grid: Grid, *, copy: bool, overwrite: bool) -> None:
    with stage_inside(place.parent) as stage:
        vrt_path = stage / ("shown.vrt" if copy else place.name)
        vrt.write_placed_vrt(vrt_path, name, grid, final_path=vrt_path if copy else place)
        if copy:
            write_cog(vrt_path, stage / place.name)
        place_with_files(stage / place.name, place, overwrite=overwrite)
