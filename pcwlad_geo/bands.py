"""Apply a finished registration to other bands of its target."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.output_names import check_places, rpc_paths, warped_paths
from pcwlad_geo.outputs import BandOutput, warp_band
from pcwlad_geo.raster import warping
from pcwlad_geo.raster.grid import Grid, map_px
from pcwlad_geo.raster.identity import FileIdentity, check_unchanged, identify
from pcwlad_geo.raster.output_format import OutputFormat, check_format
from pcwlad_geo.raster.output_grid import GridRequest, check_covered, output_grids
from pcwlad_geo.raster.shared_plane import grid_beside
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.trust import Trust, trusting
from pcwlad_geo.registration.output_wishes import check_placed, requested_grid
from pcwlad_geo.registration.progress import EventCallback, Progress, Warned, ignore
from pcwlad_geo.registration.settings import OutputGrid, Resampling, Settings
from pcwlad_geo.report.finished import FinishedRegistration, read_registration
from pcwlad_geo.rpc_bands import OrthoOutput, warp_by_rpc
from pcwlad_geo.staging import place_with_files, stage_inside

PathLike = str | os.PathLike[str]


def warp(
    registration: PathLike,
    rasters: Sequence[PathLike],
    *,
    out_dir: PathLike | None = None,
    output_raster: PathLike | None = None,
    grid: OutputGrid | None = None,
    like: PathLike | None = None,
    tr: tuple[float, float] | None = None,
    te: tuple[float, float, float, float] | None = None,
    t_srs: str | None = None,
    of: str | None = None,
    co: Sequence[str] | None = None,
    resampling: Resampling | None = None,
    overwrite: bool = False,
    allow_remote: bool = False,
    trust_vrt: bool = False,
    on_event: EventCallback = ignore,
) -> tuple[Path, ...]:
    """Apply a finished registration to other bands of the target, also of other pixel sizes.

    Each raster is warped once, from its original pixels, by the correction of the registration; nothing is
    matched, and the registered pair itself is not needed. Where the target has an RPC, the correction is
    carried over to that of each raster, and ``<raster stem>_rpc.vrt`` and ``_rpc_RPC.TXT`` are written
    beside the orthorectified raster; the DEM is needed again.

    Parameters
    ----------
    registration : path
        The output folder of `register`.
    rasters : sequence of path
        Rasters of the target's geometry: in its CRS, or without georeferencing and of its size; images with
        RPCs of their own, taken with the target, where that has one.
    out_dir : path, optional
        Where ``<raster stem>_registered.tif`` is written; the working folder by default.
    output_raster : path, optional
        Write the one raster there instead, and nothing beside it.
    grid : {"reference", "reference-exact", "target"}, optional
        Output grid: the reference's CRS and alignment with the raster's own pixel size, exactly the
        reference's grid, or the raster's own. On the reference's alignment all rasters share the extent of
        the corrected target, in whole pixels of the coarsest of them and the target.
    like, tr, te, t_srs : optional
        As `register` takes them. Where neither these nor `grid` are given, the output grid is as in the
        registration.
    of, co : optional
        Format and creation options, as `register` takes them; by default as in the registration.
    resampling : str, optional
        By default as in the registration.
    overwrite : bool
        Replace files that exist.
    allow_remote, trust_vrt : bool
        As `register` takes them.
    on_event : callable
        Receives `Progress` events; an exception that it raises ends the work.

    Returns
    -------
    tuple of pathlib.Path
        The files written, in the order of the rasters.

    Raises
    ------
    InputError
        If the folder holds no finished registration, or one that does not meet its requirements and was not
        kept, or a raster cannot be used; before anything is written.
    OutputError
        If a result cannot be written; those before it stay.
    """
    with trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        finished = read_registration(registration)
        sources = [os.fspath(raster) for raster in rasters]
        inputs = [identify(source) for source in sources]
        _tell_changed(inputs, finished, on_event)
        request, made = _wishes(finished, grid, like, tr, te, t_srs, of, co)
        places = warped_paths(sources, out_dir, output_raster, made.extension)
        if finished.rpc is not None:
            files = rpc_paths(sources, places, beside=output_raster is None)
            _check_rpc(sources, files, request, made, overwrite)
            how = resampling or finished.resampling
            return warp_by_rpc(
                sources,
                files,
                inputs,
                finished.rpc,
                OrthoOutput(finished.reference_grid, request, made, how),
                overwrite=overwrite,
                on_event=on_event,
            )
        _check(sources, places, finished, overwrite)
        grids = _grids(sources, finished, request, made)
        with stage_inside(places[0].parent) as stage:
            for number, (source, place) in enumerate(zip(sources, places, strict=True)):
                on_event(Progress("rasters", number, len(sources)))
                staged = stage / place.name
                warp_band(
                    source,
                    staged,
                    finished.correction,
                    finished.target_grid,
                    BandOutput(grids[number], resampling or finished.resampling, made, place),
                    on_event,
                )
                check_unchanged(inputs[number])
                place_with_files(staged, place, overwrite=overwrite)
        on_event(Progress("rasters", len(sources), len(sources)))
        return places


def _tell_changed(
    files: Sequence[Sequence[FileIdentity]], finished: FinishedRegistration, on_event: EventCallback
) -> None:
    """Warn of a raster that is not what it was when it was registered itself."""
    registered = {each.path: each for each in finished.inputs}
    for each in (identity for identities in files for identity in identities):
        before = registered.get(each.path)
        difference = before.difference(each) if before else None
        if difference is not None:
            on_event(
                Warned(
                    f"{each.path} was changed ({difference}) since the registration was made: register it "
                    "again unless its pixels lie as they did"
                )
            )


def _check_rpc(
    sources: Sequence[str],
    places: Sequence[Mapping[str, Path]],
    request: GridRequest,
    made: OutputFormat,
    overwrite: bool,
) -> None:
    """Raise where a raster with RPC cannot be written as is asked for: before the work."""
    if not sources:
        raise InputError("no raster to warp: give at least one")
    if request.mode == "target":
        raise SettingsError("grid = 'target': the pixels of an image with RPC are no grid on the ground")
    if made.is_vrt:
        raise SettingsError("of = 'VRT': a VRT cannot hold an orthorectified image; give --of COG or GTiff")
    check_places(sources, [place for files in places for place in files.values()], overwrite=overwrite)


def _wishes(
    finished: FinishedRegistration,
    grid: OutputGrid | None,
    like: PathLike | None,
    tr: tuple[float, float] | None,
    te: tuple[float, float, float, float] | None,
    t_srs: str | None,
    of: str | None,
    co: Sequence[str] | None,
) -> tuple[GridRequest, OutputFormat]:
    """Return the output grid and the format that are asked for, else those of the registration."""
    given = {"grid": grid, "like": like and os.fspath(like), "tr": tr, "te": te, "t_srs": t_srs, "of": of}
    options = {name: value for name, value in given.items() if value is not None}
    settings = Settings.from_options(options | ({} if co is None else {"co": tuple(co)}))
    request = requested_grid(settings) if set(options) - {"of"} else finished.request
    if of is None:
        return request, finished.made if co is None else OutputFormat.of(finished.made.driver, settings.co)
    return request, OutputFormat.of(of, settings.co)


def _grids(
    sources: Sequence[str], finished: FinishedRegistration, request: GridRequest, made: OutputFormat
) -> list[Grid]:
    """Return the output grids of the rasters; raise where one shows nothing, or cannot be written."""
    correction, target = finished.correction, finished.target_grid
    if made.is_vrt and not isinstance(correction, AffineCorrection):
        raise SettingsError(
            f"of = 'VRT': a VRT cannot hold the {correction.name} correction of this registration; give --of "
            "COG or GTiff"
        )
    own = [grid_beside(describe(source), target) for source in sources]
    places = {"the reference": finished.reference_grid.located, "the target": target.located}
    check_placed(request, places, finished.reference_grid)
    grids = output_grids(finished.reference_grid, target, correction, request, own)
    for source, raster, grid in zip(sources, own, grids, strict=True):
        if request.needs_ground or request.fixed(finished.reference_grid):
            observed_px = map_px(raster.boundary_px(), raster, target)
            check_covered(grid, target.to_xy(correction.inverse(observed_px)), target.crs)
        check_format(made, source, grid)
    return grids


def _check(
    sources: Sequence[str], places: Sequence[Path], finished: FinishedRegistration, overwrite: bool
) -> None:
    """Raise where a raster or an output cannot be used: before hours of work, not after them."""
    if not sources:
        raise InputError("no raster to warp: give at least one")
    for source in sources:
        own_grid = grid_beside(describe(source), finished.target_grid)
        warping.check_geometry(source, own_grid, finished.target_grid)
    check_places(sources, places, overwrite=overwrite)
