"""The warping of a band to a file, and the grids of the bands of a registration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.events import EventCallback, Progress, Warned
from pcwlad_geo.products.product import ProductBand
from pcwlad_geo.raster import Grid, OutputFormat, RpcGrid, describe, output_grids, warping
from pcwlad_geo.raster.matching_grid import grid_on_plane_of
from pcwlad_geo.raster.output_grid import check_covered, corrected_outline
from pcwlad_geo.raster.rpc import ortho as rpc_warping
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.registration import requested_grid

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.registration import Registration


def output_grids_of(registration: Registration, bands: Sequence[ProductBand]) -> list[Grid]:
    """Return the grids of the registered raster and then of other `bands` of its product, with one extent.

    Raises `InputError` if the requested grid does not overlap the corrected target.
    """
    reference, target = ground_grid(registration.reference.grid), registration.target.grid
    request = requested_grid(registration.settings)
    if registration.rpc is not None:
        corrected = registration.rpc.corrected_grid
        grids = rpc_warping.requested_ortho_grids(reference, corrected, request, [corrected])
        outline_xy = corrected.to_xy(corrected.boundary_px())
    else:
        correction = correction_of(registration)
        rasters = [target, *(grid_on_plane_of(describe(band.opened_as()), target) for band in bands)]
        grids = output_grids(reference, target, correction, request, rasters)
        outline_xy = corrected_outline(target, correction)
    for grid in grids if request.needs_ground or request.fixed(reference) else ():
        check_covered(grid, outline_xy, target.crs)
    return grids


@dataclass(frozen=True, slots=True)
class BandOutput:
    """Grid, resampling and format with which a band is written."""

    grid: Grid
    resampling: str
    fmt: OutputFormat
    final_path: Path
    """Final path of the file."""


def warp_band(
    source: str,
    path: Path,
    correction: Correction,
    target_grid: Grid,
    how: BandOutput,
    on_event: EventCallback,
) -> None:
    """Warp the raster `source`, of the geometry of `target_grid`, to `path` by the target's `correction`."""
    warning = warping.warp(
        source,
        path,
        correction,
        how.grid,
        how.resampling,
        target_grid=target_grid,
        fmt=how.fmt,
        final_path=how.final_path,
        progress=lambda finished, total: on_event(Progress("warping", finished, total)),
    )
    if warning is not None:
        on_event(Warned(warning))


def orthorectify_band(
    source: str, path: Path, corrected: RpcGrid, how: BandOutput, on_event: EventCallback
) -> None:
    """Orthorectify the raster `source` by its `corrected` RPC to `path`."""
    warning = rpc_warping.orthorectify(
        source,
        path,
        corrected,
        how.grid,
        how.resampling,
        fmt=how.fmt,
        progress=lambda finished, total: on_event(Progress("warping", finished, total)),
    )
    if warning is not None:
        on_event(Warned(warning))


def correction_of(registration: Registration) -> Correction:
    """Return the correction of a registration that has one."""
    if registration.model is None:
        raise TypeError(f"a pair that is {registration.status} has no correction")
    return registration.model
