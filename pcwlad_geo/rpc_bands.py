"""Apply a registration of a target with RPC to its siblings: corrected RPCs, orthorectified rasters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.identity import FileIdentity, check_unchanged
from pcwlad_geo.raster.output_format import OutputFormat, check_format
from pcwlad_geo.raster.output_grid import GridRequest, check_covered
from pcwlad_geo.raster.rpc_files import to_gdal, write_rpc_text
from pcwlad_geo.raster.rpc_warping import orthorectify, requested_ortho_grids
from pcwlad_geo.raster.vrt import write_rpc_vrt
from pcwlad_geo.registration.progress import EventCallback, Progress, Warned
from pcwlad_geo.registration.rpc_sibling import CorrectedRpc, correct_sibling
from pcwlad_geo.registration.rpc_target import RpcRegistration
from pcwlad_geo.staging import place_file, place_with_files, stage_inside


@dataclass(frozen=True, slots=True)
class OrthoOutput:
    """How orthorectified rasters are written."""

    reference_grid: Grid
    """On whose lattice they lie where nothing else is asked for."""
    request: GridRequest
    format: OutputFormat
    resampling: str
    """A name of `rasterio.enums.Resampling`."""


def warp_by_rpc(
    sources: Sequence[str],
    places: Sequence[Mapping[str, Path]],
    inputs: Sequence[Sequence[FileIdentity]],
    target: CorrectedRpc,
    made: OrthoOutput,
    *,
    overwrite: bool,
    on_event: EventCallback,
) -> tuple[Path, ...]:
    """Correct the RPCs of rasters as that of the registered one, and orthorectify them.

    Parameters
    ----------
    sources : sequence of str
        Paths or GDAL URIs.
    places : sequence of mapping
        Where the files of each go, by kind, see `output_names.rpc_paths`; what is not named is not written.
    inputs : sequence of sequence of FileIdentity
        The files of each source as they were before any was opened.
    target : CorrectedRpc
        Of the registration.
    made : OrthoOutput
        Grid and format; the rasters share an extent.
    overwrite : bool
        Replace files that exist.
    on_event : callable
        Receives `Progress` and `Warned` events.

    Returns
    -------
    tuple of pathlib.Path
        The files written, those of each raster together.

    Raises
    ------
    InputError
        If a raster cannot be used, before anything is written; if one is changed meanwhile, those before it
        stay.
    OutputError
        If a result cannot be written; those before it stay.
    """
    siblings: list[RpcRegistration] = []
    for source in sources:
        sibling, warnings = correct_sibling(source, target)
        siblings.append(sibling)
        for warning in warnings:
            on_event(Warned(warning))
    grids = _grids(target, siblings, made)
    for source, grid in zip(sources, grids, strict=True):
        check_format(made.format, source, grid)
    with stage_inside(places[0]["raster"].parent) as stage:
        for number, (source, files, sibling) in enumerate(zip(sources, places, siblings, strict=True)):
            on_event(Progress("rasters", number, len(sources)))
            staged = {kind: stage / place.name for kind, place in files.items()}
            unread = orthorectify(
                source,
                staged["raster"],
                sibling.corrected_grid,
                grids[number],
                made.resampling,
                made=made.format,
                progress=lambda done, total: on_event(Progress("warping", done, total)),
            )
            if unread is not None:
                on_event(Warned(unread))
            rpc = sibling.corrected_grid.rpc
            if "rpc" in files:
                write_rpc_vrt(staged["rpc"], source, to_gdal(rpc), final_path=files["rpc"])
            if "rpc_text" in files:
                write_rpc_text(rpc, staged["rpc_text"])
            check_unchanged(inputs[number])
            for kind, place in files.items():
                put = place_with_files if kind == "raster" else place_file
                put(staged[kind], place, overwrite=overwrite)
    on_event(Progress("rasters", len(sources), len(sources)))
    return tuple(place for files in places for place in files.values())


def _grids(target: CorrectedRpc, siblings: Sequence[RpcRegistration], made: OrthoOutput) -> list[Grid]:
    """Return the output grids: one extent for all, the target's; raise where one shows nothing."""
    own = [sibling.corrected_grid for sibling in siblings]
    registered = replace(own[0], shape=target.shape, rpc=target.corrected)
    grids = requested_ortho_grids(made.reference_grid, registered, made.request, own)
    if made.request.needs_ground or made.request.fixed(made.reference_grid):
        for raster, grid in zip(own, grids, strict=True):
            check_covered(grid, raster.to_xy(raster.boundary_px()), raster.crs)
    return grids
