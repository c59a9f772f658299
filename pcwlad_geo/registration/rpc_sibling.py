"""Other images taken with a target with RPC, bands or pan and multispectral: their RPCs, corrected alike."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from pcwlad_geo.correction.rpc_carry import carried, parallax
from pcwlad_geo.correction.rpc_fold import FOLD_TOLERANCE_PX, covered_range, fold, fold_error_px
from pcwlad_geo.correction.rpc_model import RpcModel
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.dem_vertical import Vertical
from pcwlad_geo.raster.rpc_files import RpcSource, read_rpc
from pcwlad_geo.raster.rpc_grid import RpcGrid
from pcwlad_geo.raster.rpc_view import place_by_rpc
from pcwlad_geo.raster.source import RasterInfo, describe
from pcwlad_geo.registration.rpc_target import RpcRegistration

MOST_PARALLAX: Final = 0.03
"""Metres on the ground a metre of height, 1.7 degrees: focal planes of one telescope stay below."""
MOST_MISFIT_PX: Final = 0.05
"""Of an affine transformation to what is carried over."""


@dataclass(frozen=True, slots=True)
class CorrectedRpc:
    """What a finished registration knows of its target's RPC: enough to correct that of a sibling."""

    original: RpcModel
    corrected: RpcModel
    shape: tuple[int, int]
    """Rows and columns of the target."""
    dem: str | None
    dem_vertical: Vertical
    height_m: float | None
    """Of all ground, above the ellipsoid, without a DEM."""
    trusted: bool = False
    """Whether RPCs are used wherever they put an image."""


def correct_sibling(uri: str, target: CorrectedRpc) -> tuple[RpcRegistration, tuple[str, ...]]:
    """Carry the correction of a target's RPC over to that of another image, and return warnings.

    An image without georeferencing that has the target's size has its RPC too.

    Raises
    ------
    InputError
        If the image has no RPC, is not a sibling, or the DEM cannot be used.
    """
    info = describe(uri)
    source = _rpc_of(info, target)
    try:
        placed = place_by_rpc(
            info,
            source,
            target.dem,
            target.dem_vertical,
            height_m=target.height_m,
            trusted=target.trusted,
        )
    except InputError as error:
        raise InputError("; ".join([str(error), *source.warnings])) from error
    warnings = placed.warnings if target.dem is not None else source.warnings
    grid = placed.info.grid
    if not isinstance(grid, RpcGrid):
        raise TypeError(f"{uri} is not placed by an RPC")
    if source.rpc == target.original and info.grid.shape == target.shape:
        same = RpcRegistration(
            source.origin, grid, replace(grid, rpc=target.corrected), None, placed.heights_m
        )
        return same, warnings
    apart_m = parallax(target.original, source.rpc, info.grid.shape, placed.heights_m)
    if not apart_m <= MOST_PARALLAX:
        raise InputError(
            f"{uri} was not taken from where the registered image was: what is a metre higher is seen "
            f"{apart_m:.2f} m aside of where that sees it, so that its RPC errs in another way; register "
            "it on its own"
        )
    correction, misfit_px = carried(
        target.original, target.corrected, source.rpc, info.grid.shape, placed.heights_m
    )
    if not misfit_px <= MOST_MISFIT_PX:
        raise InputError(
            f"the correction of the registered image cannot be carried over to {uri}: {misfit_px:.2g} px "
            "are left; register it on its own"
        )
    covered = covered_range(source.rpc, info.grid.shape, placed.heights_m)
    corrected = fold(source.rpc, correction, covered)
    error_px = fold_error_px(source.rpc, corrected, correction, info.grid.shape, placed.heights_m)
    if not error_px <= FOLD_TOLERANCE_PX:
        raise InputError(
            f"the correction carried over to {uri} does not fit into its RPC: {error_px:.2g} px are left; "
            "register it on its own"
        )
    carried_over = replace(grid, rpc=corrected)
    return RpcRegistration(source.origin, grid, carried_over, error_px, placed.heights_m), warnings


def _rpc_of(info: RasterInfo, target: CorrectedRpc) -> RpcSource:
    source = read_rpc(info.uri)
    if source is not None:
        return source
    rows, cols = target.shape
    if info.georeferenced or info.grid.shape != target.shape:
        found = "a geotransform" if info.georeferenced else f"{info.grid.shape[1]} x {info.grid.shape[0]} px"
        raise InputError(
            f"{info.uri} has no RPC (tag, .RPB or _RPC.TXT beside it) but {found}: give a band in the "
            f"sensor's geometry, with its RPC, or of the registered image's {cols} x {rows} px"
        )
    return RpcSource(target.original, "the registered image", ())
