"""Application of a finished registration to other bands of the target and to vectors drawn on it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

from pcwlad_geo.arguments import checked
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore
from pcwlad_geo.options import OutputGrid, Resampling, Settings
from pcwlad_geo.outputs.bands import BandOutput, orthorectify_band, warp_band
from pcwlad_geo.outputs.files import OUTPUT_NAMES
from pcwlad_geo.outputs.folder import place_output, stage_inside
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.raster import (
    FileIdentity,
    Grid,
    GridRequest,
    OutputFormat,
    Trust,
    check_unchanged,
    describe,
    identify,
    map_px,
    output_grids,
    trusting,
    warping,
)
from pcwlad_geo.raster.matching_grid import grid_on_plane_of
from pcwlad_geo.raster.output_format import check_format
from pcwlad_geo.raster.output_grid import check_covered
from pcwlad_geo.raster.rpc.files import to_gdal, write_rpc_text
from pcwlad_geo.raster.rpc.ortho import requested_ortho_grids
from pcwlad_geo.raster.vrt import write_rpc_vrt
from pcwlad_geo.registration import CorrectedRpc, RpcRegistration, requested_grid
from pcwlad_geo.registration.inputs import check_placed
from pcwlad_geo.registration.rpc import correct_other_image
from pcwlad_geo.report.finished import FinishedRegistration, read_registration
from pcwlad_geo.types import PathLike
from pcwlad_geo.vector_warping import (
    Movement,
    is_vector,
    moved_vectors,
    precision_in_metres,
    vector_place,
    write_vectors,
)


@dataclass(frozen=True, slots=True)
class WarpOutput:
    """How warped rasters are written."""

    reference_grid: Grid
    """Grid to which outputs are aligned unless another is requested."""
    request: GridRequest
    format: OutputFormat
    resampling: str
    """A name of `rasterio.enums.Resampling`."""


WriteBand = Callable[[int, Mapping[str, Path]], None]
"""Writes the files of a raster, given its number and their staged paths by kind."""


def _by_rpc(
    sources: Sequence[str],
    places: Sequence[Mapping[str, Path]],
    target: CorrectedRpc,
    output: WarpOutput,
    on_event: EventCallback,
) -> WriteBand:
    """Transfer the correction of the registered RPC to other rasters; return what orthorectifies them."""
    if output.request.mode == "target":
        raise SettingsError("grid = 'target': the pixels of an image with RPC are no grid on the ground")
    if output.format.is_vrt:
        raise SettingsError("of = 'VRT': a VRT cannot hold an orthorectified image; give --of COG or GTiff")
    siblings: list[RpcRegistration] = []
    for source in sources:
        sibling, warnings = correct_other_image(source, target)
        siblings.append(sibling)
        for warning in warnings:
            on_event(Warned(warning))
    grids = _ortho_grids(target, siblings, output)
    for source, grid in zip(sources, grids, strict=True):
        check_format(output.format, source, grid)

    def write(number: int, staged: Mapping[str, Path]) -> None:
        corrected = siblings[number].corrected_grid
        how = BandOutput(grids[number], output.resampling, output.format, places[number]["raster"])
        orthorectify_band(sources[number], staged["raster"], corrected, how, on_event)
        if "rpc" in staged:
            final_path = places[number]["rpc"]
            write_rpc_vrt(staged["rpc"], sources[number], to_gdal(corrected.rpc), final_path=final_path)
        if "rpc_text" in staged:
            write_rpc_text(corrected.rpc, staged["rpc_text"])

    return write


def _ortho_grids(target: CorrectedRpc, siblings: Sequence[RpcRegistration], output: WarpOutput) -> list[Grid]:
    """Return the output grids: one extent for all, the target's; raise where one shows nothing."""
    corrected = [sibling.corrected_grid for sibling in siblings]
    registered = replace(corrected[0], shape=target.shape, rpc=target.corrected)
    grids = requested_ortho_grids(output.reference_grid, registered, output.request, corrected)
    if output.request.needs_ground or output.request.fixed(output.reference_grid):
        for raster, grid in zip(corrected, grids, strict=True):
            check_covered(grid, raster.to_xy(raster.boundary_px()), raster.crs)
    return grids


class WarpOptions(TypedDict, total=False):
    """What may be asked of a warped raster; None and what is absent: as in the registration."""

    grid: OutputGrid | None
    like: PathLike | None
    tr: tuple[float, float] | None
    te: tuple[float, float, float, float] | None
    t_srs: str | None
    of: str | None
    co: Sequence[str] | None


@checked()
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
    inverse: bool = False,
    write_sigma: bool = False,
    overwrite: bool = False,
    allow_remote: bool = False,
    trust_vrt: bool = False,
    on_event: EventCallback = ignore,
) -> tuple[Path, ...]:
    """Apply a finished registration to other bands of the target, and to vectors that were drawn on it.

    Each raster is warped once from its original pixels by the correction of the registration. Nothing is
    matched, and the registered pair is not needed. If the target has an RPC, the correction is transferred to
    the RPC of each raster, and ``<raster stem>_rpc.vrt`` and ``_rpc_RPC.TXT`` are written beside the
    orthorectified raster; the DEM is needed again.

    Vertices of vector files move from where the target drew them to where they belong. Layers, attributes,
    CRS and heights stay, and new vertices are inserted where the correction bends a segment by 0.05 px or
    more.

    Parameters
    ----------
    registration : path
        The output folder of `register`.
    rasters : sequence of path
        Rasters of the target's geometry, in its CRS or without georeferencing and of its size; for a target
        with an RPC, images taken with it that have their own RPCs. Also vector files in any CRS (GeoPackage,
        GeoJSON, Shapefile, FlatGeobuf; with `trust_vrt` all that OGR reads).
    out_dir : path, optional
        Folder of ``<raster stem>_registered.tif`` and ``<vector stem>_registered.<suffix>``; the working
        folder by default.
    output_raster : path, optional
        Path of the only raster instead, with no other files.
    grid : {"reference", "reference-exact", "target"}, optional
        Output grid: the reference's CRS and alignment with the raster's own pixel size, exactly the
        reference's grid, or the raster's own. With the reference's alignment all rasters share the extent of
        the corrected target, in whole pixels of the coarsest raster.
    like, tr, te, t_srs : optional
        As for `register`. If neither these nor `grid` are given, the output grid is as in the registration.
    of, co : optional
        Format and creation options as for `register`; by default as in the registration.
    resampling : str, optional
        Resampling; by default as in the registration.
    inverse : bool
        Move vectors from where they belong to where the target draws them; there must be no rasters.
    write_sigma : bool
        Give each feature of the vectors a field `sigma_m`: the largest standard deviation of its vertices
        along an axis, metres, by the covariance of the correction, which is fitted again to the tie points of
        the folder for it.
    overwrite : bool
        Replace files that exist.
    allow_remote, trust_vrt : bool
        As for `register`.
    on_event : callable
        Receives `Progress` events; an exception that it raises ends the work.

    Returns
    -------
    tuple of pathlib.Path
        The files written, in the order of the rasters.

    Raises
    ------
    InputError
        If the folder holds no finished registration, or one that does not meet its requirements and was made
        without `keep`, or a raster cannot be used; raised before anything is written.
    OutputError
        If a result cannot be written; those before it are kept.
    """
    output: WarpOptions = {"grid": grid, "like": like, "tr": tr, "te": te, "t_srs": t_srs, "of": of, "co": co}
    with trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        finished = read_registration(registration)
        names = [os.fspath(raster) for raster in rasters]
        vectors = [name for name in names if is_vector(name)]
        sources = [name for name in names if name not in vectors]
        if inverse and sources:
            raise SettingsError(f"inverse moves vectors alone, and {sources[0]} is a raster: leave it out")
        if vectors and output_raster is not None:
            raise SettingsError(
                f"output_raster names a raster, and {vectors[0]} is a vector file: give out_dir"
            )
        if write_sigma and (sources or finished.target_grid.crs is None):
            what = f"{sources[0]} is a raster" if sources else "metres need the CRS of the target"
            raise SettingsError(f"write_sigma is of vectors alone, and {what}: leave it out")
        request, fmt = requested_output(finished, output)
        places = _warped_paths(sources, out_dir, output_raster, fmt.extension)
        moved_places = [vector_place(vector, Path(out_dir or ".")) for vector in vectors]
        check_outputs([*places, *moved_places], names, overwrite=overwrite)
        warp_output = WarpOutput(finished.reference_grid, request, fmt, resampling or finished.resampling)
        precision = None
        if write_sigma:
            precision = precision_in_metres(registration, finished)
        movement = Movement(finished, None, inverse, precision=precision)
        moved = moved_vectors(vectors, movement, on_event)
        warped: tuple[Path, ...] = ()
        if sources or not vectors:
            warped = apply(finished, sources, places, warp_output, output_raster is None, overwrite, on_event)
        write_vectors(moved, vectors, moved_places, overwrite=overwrite, on_event=on_event)
        return (*warped, *moved_places)


def apply(
    finished: FinishedRegistration,
    sources: Sequence[str],
    places: Sequence[Path],
    output: WarpOutput,
    rpc_sidecar: bool,
    overwrite: bool,
    on_event: EventCallback,
) -> tuple[Path, ...]:
    """Warp rasters of the target's geometry by a registration, each to its place; return the files written.

    The `sources` are paths or GDAL URIs, in the order of their `places`. With `rpc_sidecar`, those of a
    target with an RPC get theirs beside them. Errors are those of `warp`.
    """
    if not sources:
        raise InputError("no raster to warp: give at least one")
    inputs = [identify(source) for source in sources]
    _warn_of_changes(inputs, finished, on_event)
    files = _rpc_paths(sources, places, with_rpc=rpc_sidecar and finished.rpc is not None)
    every = [place for paths in files for place in paths.values()]
    check_outputs(every, sources, overwrite=overwrite)
    if finished.rpc is None:
        write = _by_correction(sources, files, finished, output, on_event)
    else:
        write = _by_rpc(sources, files, finished.rpc, output, on_event)
    with stage_inside(places[0].parent) as stage:
        for number, paths in enumerate(files):
            on_event(Progress("rasters", number, len(sources)))
            staged = {kind: stage / place.name for kind, place in paths.items()}
            write(number, staged)
            check_unchanged(inputs[number])
            for kind, place in paths.items():
                place_output(kind, staged[kind], place, overwrite=overwrite)
    on_event(Progress("rasters", len(sources), len(sources)))
    return tuple(every)


def _warn_of_changes(
    files: Sequence[Sequence[FileIdentity]], finished: FinishedRegistration, on_event: EventCallback
) -> None:
    """Warn about a raster that has changed since it was registered itself."""
    registered = {identity.path: identity for identity in finished.inputs}
    for identity in (identity for identities in files for identity in identities):
        before = registered.get(identity.path)
        difference = before.difference(identity) if before else None
        if difference is not None:
            on_event(
                Warned(
                    f"{identity.path} was changed ({difference}) since the registration was made: register "
                    "it again unless its pixels lie as they did"
                )
            )


def requested_output(finished: FinishedRegistration, output: WarpOptions) -> tuple[GridRequest, OutputFormat]:
    """Return the output grid and the format that are asked for, else those of the registration.

    Raises `SettingsError` if an option has no such value, or two contradict each other.
    """
    of, co = output.get("of"), output.get("co")
    options = {name: value for name, value in output.items() if value is not None and name != "co"}
    if output.get("like"):
        options["like"] = str(output["like"])
    settings = Settings.from_options(options | ({} if co is None else {"co": tuple(co)}))
    request = requested_grid(settings) if set(options) - {"of"} else finished.request
    if of is None:
        return request, finished.fmt if co is None else OutputFormat.of(finished.fmt.driver, settings.co)
    return request, OutputFormat.of(of, settings.co)


def planned_grids(finished: FinishedRegistration, sources: Sequence[str], output: WarpOutput) -> list[Grid]:
    """Return the output grids of rasters; raise if one of them cannot be used or shows nothing."""
    correction, target, request = finished.correction, finished.target_grid, output.request
    own_grids = [grid_on_plane_of(describe(source), target) for source in sources]
    for source, raster in zip(sources, own_grids, strict=True):
        warping.check_geometry(source, raster, target)
    located = {"the reference": finished.reference_grid.located, "the target": target.located}
    check_placed(request, located, finished.reference_grid)
    grids = output_grids(finished.reference_grid, target, correction, request, own_grids)
    for raster, grid in zip(own_grids, grids, strict=True):
        if request.needs_ground or request.fixed(finished.reference_grid):
            observed_px = map_px(raster.boundary_px(), raster, target)
            check_covered(grid, target.to_xy(correction.inverse(observed_px)), target.crs)
    return grids


def _by_correction(
    sources: Sequence[str],
    places: Sequence[Mapping[str, Path]],
    finished: FinishedRegistration,
    output: WarpOutput,
    on_event: EventCallback,
) -> WriteBand:
    """Return what warps the rasters; raise if one cannot be used, shows nothing or cannot be written so."""
    correction, target = finished.correction, finished.target_grid
    if output.format.is_vrt and not isinstance(correction, AffineCorrection):
        raise SettingsError(
            f"of = 'VRT': a VRT cannot hold the {correction.name} correction of this registration; give --of "
            "COG or GTiff"
        )
    grids = planned_grids(finished, sources, output)
    for source, grid in zip(sources, grids, strict=True):
        check_format(output.format, source, grid)

    def write(number: int, staged: Mapping[str, Path]) -> None:
        how = BandOutput(grids[number], output.resampling, output.format, places[number]["raster"])
        warp_band(sources[number], staged["raster"], correction, target, how, on_event)

    return write


def _warped_paths(
    rasters: Sequence[str], out_dir: PathLike | None, output_raster: PathLike | None, extension: str
) -> tuple[Path, ...]:
    """Return the paths of the warped rasters, in order; of the only one, where the user wants it."""
    if output_raster is None:
        names = [
            OUTPUT_NAMES["raster"].format(stem=Path(raster).stem, ending=extension) for raster in rasters
        ]
        return tuple(Path(out_dir or ".") / name for name in names)
    if len(rasters) > 1:
        raise SettingsError(
            f"--output-raster names one file, and there are {len(rasters)} rasters: give --out-dir"
        )
    return (Path(output_raster),)


def _rpc_paths(sources: Sequence[str], rasters: Sequence[Path], *, with_rpc: bool) -> list[dict[str, Path]]:
    """Return the output paths by kind of each source, with those of its corrected RPC beside the raster."""
    kinds = ("rpc", "rpc_text") if with_rpc else ()
    return [
        {"raster": raster}
        | {kind: raster.with_name(OUTPUT_NAMES[kind].format(stem=Path(source).stem)) for kind in kinds}
        for source, raster in zip(sources, rasters, strict=True)
    ]
