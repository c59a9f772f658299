"""Apply a finished registration to other bands of its target."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from pcwlad_geo.errors import InputError, OutputError, SettingsError
from pcwlad_geo.outputs import warp_band
from pcwlad_geo.raster import warping
from pcwlad_geo.raster.output_grid import GridRequest, output_grids
from pcwlad_geo.raster.source import describe
from pcwlad_geo.registration.progress import EventCallback, Progress, ignore
from pcwlad_geo.registration.settings import OutputGrid, Resampling
from pcwlad_geo.report.finished import FinishedRegistration, read_registration
from pcwlad_geo.staging import place_file, stage_inside

PathLike = str | os.PathLike[str]


def warp(
    registration: PathLike,
    rasters: Sequence[PathLike],
    *,
    out_dir: PathLike | None = None,
    output_raster: PathLike | None = None,
    grid: OutputGrid | None = None,
    resampling: Resampling | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
) -> tuple[Path, ...]:
    """Apply a finished registration to other bands of the target, also of other pixel sizes.

    Each raster is warped once, from its original pixels, by the correction of the registration; nothing is
    matched, and the registered pair itself is not needed.

    Parameters
    ----------
    registration : path
        The output folder of `register`.
    rasters : sequence of path
        Rasters of the target's geometry: in its CRS, or without georeferencing and of its size.
    out_dir : path, optional
        Where ``<raster stem>_registered.tif`` is written; the working folder by default.
    output_raster : path, optional
        Write the one raster there instead.
    grid : {"reference", "target"}, optional
        Output grid: the reference's CRS and alignment with the raster's own pixel size, or the raster's own
        grid. By default as in the registration. On the reference's alignment all rasters share the extent of
        the corrected target, in whole pixels of the coarsest of them and the target.
    resampling : str, optional
        By default as in the registration.
    overwrite : bool
        Replace files that exist.
    on_event : callable
        Receives `Progress` events; an exception that it raises ends the work.

    Returns
    -------
    tuple of pathlib.Path
        The files written, in the order of the rasters.

    Raises
    ------
    InputError
        If the folder holds no finished registration, or a raster cannot be used; before anything is written.
    OutputError
        If a result cannot be written; those before it stay.
    """
    finished = read_registration(registration)
    sources = [os.fspath(raster) for raster in rasters]
    places = warped_paths(sources, out_dir, output_raster)
    _check(sources, places, finished, overwrite)
    grids = output_grids(
        finished.reference_grid,
        finished.target_grid,
        finished.correction,
        GridRequest(grid or finished.grid),
        [describe(source).grid for source in sources],
    )
    with stage_inside(places[0].parent) as stage:
        for number, (source, place) in enumerate(zip(sources, places, strict=True)):
            on_event(Progress("rasters", number, len(sources)))
            staged = stage / place.name
            warp_band(
                source,
                staged,
                finished.correction,
                finished.target_grid,
                grids[number],
                resampling or finished.resampling,
                on_event,
            )
            place_file(staged, place, overwrite=overwrite)
    on_event(Progress("rasters", len(sources), len(sources)))
    return places


def warped_paths(
    rasters: Sequence[PathLike], out_dir: PathLike | None, output_raster: PathLike | None = None
) -> tuple[Path, ...]:
    """Return where the warped rasters go, in order.

    Raises
    ------
    SettingsError
        If several rasters would go to the one `output_raster`.
    """
    if output_raster is None:
        return tuple(Path(out_dir or ".") / f"{Path(raster).stem}_registered.tif" for raster in rasters)
    if len(rasters) > 1:
        raise SettingsError(
            f"--output-raster names one file, and there are {len(rasters)} rasters: give --out-dir"
        )
    return (Path(output_raster),)


def _check(
    sources: Sequence[str], places: Sequence[Path], finished: FinishedRegistration, overwrite: bool
) -> None:
    """Raise where a raster or an output cannot be used: before hours of work, not after them."""
    if not sources:
        raise InputError("no raster to warp: give at least one")
    for source, place in zip(sources, places, strict=True):
        warping.check_geometry(source, describe(source).grid, finished.target_grid)
        if places.count(place) > 1:
            raise InputError(f"two of the rasters would be written to {place}: warp them into two folders")
        if place.exists() and Path(source).exists() and place.samefile(source):
            raise OutputError(f"the output {place} is an input too: choose another output folder")
        if place.exists() and not overwrite:
            raise OutputError(f"{place} exists: give --overwrite to replace it, or another folder")
