"""Rasters of any kind warped by a correction, to a file or in memory, onto any grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypedDict, cast

from pcwlad_geo.band_warping import WarpOptions, WarpOutput, apply, planned_grids, requested_output
from pcwlad_geo.correction.models import Correction as Model
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.events import EventCallback, Progress, Warned
from pcwlad_geo.options import OutputGrid, Resampling, Settings
from pcwlad_geo.raster import Grid, GridRequest, OutputFormat, RpcGrid, describe
from pcwlad_geo.raster.arrays import RasterLike, is_dataset, like_the_source, to_raster
from pcwlad_geo.raster.memory_warping import warp_in_memory
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.report.finished import FinishedRegistration
from pcwlad_geo.types import PathLike

GRID_OPTIONS: Final = ("grid", "like", "tr", "te", "t_srs")
"""Options that ask for another output grid than the reference's."""


class WarpKeywords(TypedDict, total=False):
    """What may be asked of a warped raster; what is absent is as in the registration."""

    grid: OutputGrid | None
    like: RasterLike | None
    tr: tuple[float, float] | None
    te: tuple[float, float, float, float] | None
    t_srs: str | None
    of: str | None
    co: Sequence[str] | None
    resampling: Resampling | None


def warp_raster(
    registration: FinishedRegistration | None,
    model: Model,
    src: RasterLike,
    dst: PathLike | None,
    keywords: Mapping[str, Any],
    overwrite: bool,
    on_event: EventCallback,
) -> Any:  # noqa: ANN401  # of the kind of `src`
    """Warp a raster; see `Correction.warp`."""
    like = keywords.get("like")
    registration = registration or _by_hand(model, src, like)
    request, fmt = _requested(registration, keywords, to_file=dst is not None)
    resampling = keywords.get("resampling") or registration.resampling
    output = WarpOutput(registration.reference_grid, request, fmt, resampling)
    scratch = Scratch(in_memory=True)
    uri = scratch.file_of(_placed(src, registration.target_grid), "array")
    if dst is not None:
        apply(registration, [uri], [Path(dst)], output, False, overwrite, on_event)
        return Path(dst)
    if Scratch.place_of(src) is None and registration.rpc is None and uri.startswith("/vsimem/"):
        warped = _in_memory(registration, uri, output, on_event)
    else:
        place = scratch.folder / "warped.tif"
        apply(registration, [uri], [place], output, False, False, on_event)
        warped = Raster.of_file(describe(place), keep=scratch)
    return like_the_source(warped, src, like)


def _in_memory(
    registration: FinishedRegistration, uri: str, output: WarpOutput, on_event: EventCallback
) -> Raster:
    (grid,) = planned_grids(registration, [uri], output)
    warped, warning = warp_in_memory(
        uri,
        registration.correction,
        grid,
        output.resampling,
        registration.target_grid,
        lambda finished, total: on_event(Progress("warping", finished, total)),
    )
    if warning is not None:
        on_event(Warned(warning))
    return warped


def _by_hand(model: Model, src: RasterLike, like: RasterLike | None) -> FinishedRegistration:
    """Return a registration by a correction made by hand: of the raster that is warped, to another's grid."""
    target = grid_of(src)
    reference = target if like is None else grid_of(like)
    if isinstance(target, RpcGrid) or isinstance(reference, RpcGrid):
        raise InputError("a correction made by hand moves pixels of a map grid, and the raster has RPCs")
    request = GridRequest("reference-exact")
    return FinishedRegistration(model, reference, target, request, OutputFormat(), Settings().resampling)


def _requested(
    registration: FinishedRegistration, keywords: Mapping[str, Any], *, to_file: bool
) -> tuple[GridRequest, OutputFormat]:
    """Return the output grid and format that are asked for; what is returned has the reference's grid."""
    like = keywords.get("like")
    options = {name: value for name, value in keywords.items() if name not in ("like", "resampling")}
    unknown = sorted(options.keys() - WarpOptions.__annotations__.keys())
    if unknown:
        known = ", ".join(WarpKeywords.__annotations__)
        raise SettingsError(f"unknown option '{unknown[0]}'; warp takes {known}")
    both = [name for name in GRID_OPTIONS if options.get(name) is not None]
    if like is not None and both:
        raise SettingsError(f"like and {both[0]} are two grids: give one of them")
    if not to_file:
        options |= {"of": "GTiff", "co": ()}
        options |= {} if both else {"grid": "reference-exact"}
    request, fmt = requested_output(registration, cast(WarpOptions, options))
    if like is None:
        return request, fmt
    grid, reference = grid_of(like), registration.reference_grid
    if grid.located:
        return GridRequest(like=grid), fmt
    if reference.located or grid.shape != reference.shape:
        raise InputError(
            f"like = {like!r:.60} has no georeferencing, and not the pixels of the reference "
            f"({reference.shape[1]} x {reference.shape[0]} px): give a raster that has"
        )
    return GridRequest("reference-exact"), fmt


def grid_of(raster: RasterLike) -> Grid:
    """Return the grid of a raster of any kind; the identity and None without georeferencing."""
    place = Scratch.place_of(raster)
    return to_raster(raster).grid if place is None else describe(place, part=True).grid


def _placed(src: RasterLike, target: Grid) -> RasterLike:
    """Return what has no place of its own as a raster on the target's pixels; the rest as it is."""
    if isinstance(src, Raster) and src.band is not None:  # one of several
        return Raster(src.array, src.transform, src.crs, src.nodata)
    if Scratch.place_of(src) is not None or is_dataset(src):
        return src
    raster = to_raster(src)
    if raster.transform is not None or raster.crs is not None:
        return raster
    if raster.shape != target.shape:
        (rows, cols), (wanted_rows, wanted_cols) = raster.shape, target.shape
        raise InputError(
            f"the array has {cols} x {rows} px, the target {wanted_cols} x {wanted_rows}: give one of "
            "that size, or pcwlad_geo.Raster(array, transform, crs)"
        )
    if isinstance(target, RpcGrid) or not target.located:
        return raster
    return Raster(raster.array, target, nodata=raster.nodata)
