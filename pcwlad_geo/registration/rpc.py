"""Images with RPCs: whether these are used, and their correction for a target and its siblings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.correction.fit import LOSSLESS
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import (
    Dem,
    Grid,
    RasterInfo,
    RpcGrid,
    RpcModel,
    RpcPlacement,
    RpcSource,
    describe,
    map_px,
    middle_pixel_size_m,
    read_rpc,
)
from pcwlad_geo.raster.crs import utm_zone_of
from pcwlad_geo.raster.file_tree import plain_uri
from pcwlad_geo.raster.rpc.bias import (
    BIAS_TOLERANCE_PX,
    apply_bias,
    bias_error_px,
    carried,
    covered_range,
    parallax,
)
from pcwlad_geo.raster.rpc.dem import Vertical
from pcwlad_geo.raster.rpc.grid import with_height_offset
from pcwlad_geo.raster.rpc.placement import place_by_rpc
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.registration.starts.alignment import Prealignment


@dataclass(frozen=True, slots=True)
class RpcParameters:
    """Numbers by which RPCs and their corrections are checked."""

    least_relief_m: float = 50.0
    """Least difference of heights of which a radar image without DEM is said to be displaced."""
    most_bias_m: float = 500.0
    """Largest error of an RPC on the ground; no sensor errs by more, so beyond it the RPC is of another
    image."""
    parallax_ratio: float = 2.0
    """Residuals so many times as large along the parallax as across it come from the DEM."""
    most_parallax: float = 0.03
    """Largest parallax of siblings, metres on the ground per metre of height; 1.7 degrees, which the focal
    planes of one telescope do not reach."""
    most_misfit_px: float = 0.05
    """Largest misfit of an affine transformation to the correction carried over to a sibling."""


@dataclass(frozen=True, slots=True)
class RpcRegistration:
    """The RPC of a target before and after the correction."""

    origin: str
    """File or tag in which it was found."""
    original: RpcGrid
    """The target's grid by its original RPC and the heights."""
    corrected: RpcGrid | None
    """The target's grid by the corrected RPC; None without a correction."""
    bias_error_px: float | None
    """Largest distance between the corrected RPC and the correction of the original one, px."""
    heights_m: tuple[float, float]
    """Lowest and highest ground below the target, above the ellipsoid."""

    @property
    def corrected_grid(self) -> RpcGrid:
        """The target's grid by the corrected RPC.

        Raises `ValueError` if there is no correction.
        """
        if self.corrected is None:
            raise ValueError("there is no correction of the RPC")
        return self.corrected


def place_reference(
    reference: RasterInfo, target: RasterInfo, settings: Settings
) -> tuple[RpcPlacement | None, tuple[str, ...]]:
    """Place `reference` by its RPC if that is used with `target` and `settings`; also return warnings.

    It is used if the user gives a DEM or asks for it, the reference has no other georeferencing than the
    control points of Sentinel-1, and the target can be placed too. Map coordinates of its ground are in the
    CRS of a georeferenced target, else of a DEM in metres, else in the UTM zone. Raises `InputError` if the
    RPC or the DEM cannot be used.
    """
    if reference.georeferenced and (settings.dem is None or reference.relief_m is None):
        return None, ()
    if settings.dem is None and settings.model != "rpc":
        return None, _unused_rpc(
            f"{reference.uri} has an RPC, which counts for a reference with a DEM only: it is not used",
            reference.uri,
        )
    source, other = read_rpc(reference.uri), read_rpc(target.uri)
    if source is None or (other is None and not target.georeferenced):
        return None, ()
    # without a DEM both are placed on the same ground, at the height offset of the target's RPC
    height_m = None if other is None else other.rpc.height_off
    how: dict[str, Any] = {"side": "reference", "height_m": height_m, "trusted": settings.trust_rpc}
    placement = _placed(reference, source, settings.dem, settings.dem_vertical, **how)
    grid = _rpc_grid(placement.info)
    crs = (target.grid.crs if other is None else None) or ground_crs(grid)
    info = replace(placement.info, grid=replace(grid, crs=crs))
    return replace(placement, info=info), placement.warnings


def ground_crs(grid: RpcGrid) -> CRS:
    """Return the CRS of a DEM in metres, else the UTM zone."""
    crs = grid.heights.grid.crs if isinstance(grid.heights, Dem) else None
    if crs is not None and crs.is_projected and crs.linear_units_factor[1] == 1.0:
        return crs
    return utm_zone_of(grid.line_of_sight(grid.middle_px)[0][0])


def place_target(
    reference: RasterInfo, target: RasterInfo, settings: Settings
) -> tuple[RpcPlacement | None, tuple[str, ...]]:
    """Place `target` by its RPC if that is used with `reference` and `settings`; also return warnings.

    It is used if the target has no other georeferencing, or the user gives a DEM or asks for it. Raises
    `InputError` if the RPC or the DEM cannot be used, or are asked for and missing, and `SettingsError` if
    the output grid or the correction model cannot be combined with an RPC.
    """
    is_wanted = settings.dem is not None or settings.model == "rpc"
    if target.georeferenced and not is_wanted:
        if target.relief_m is not None:
            return None, tuple(filter(None, [relief_note(reference, target)]))
        return None, _unused_rpc(
            f"{target.uri} has a geotransform and an RPC: the RPC is not used; give --dem to use it",
            target.uri,
        )
    source = read_rpc(target.uri)
    if source is None:
        for_others = isinstance(reference.grid, RpcGrid) or settings.fiducials is not None
        for_reference = for_others and settings.model != "rpc"
        if is_wanted and not for_reference:
            raise InputError(
                f"{target.uri} has no RPC (tag, .RPB or _RPC.TXT beside it), which --dem and --model rpc are "
                "for: give the image with its RPC, or leave these options out"
            )
        return None, ()
    if not reference.georeferenced:
        if is_wanted:
            raise InputError(
                f"{reference.uri} has no georeferencing (CRS and geotransform): the RPC of {target.uri} "
                "needs a reference that has"
            )
        return None, ()
    if settings.grid == "target":
        raise SettingsError(
            "grid = 'target': the pixels of a target with RPC are no grid on the ground; give 'reference'"
        )
    check_model(settings.model)
    placement = _placed(target, source, settings.dem, settings.dem_vertical, trusted=settings.trust_rpc)
    return placement, placement.warnings


def relief_note(
    reference: RasterInfo, target: RasterInfo, parameters: RpcParameters = RpcParameters()
) -> str:
    """Return what is said of a radar image of relief that is placed without DEM; empty of other rasters.

    Relief displaces bands of one product alike.
    """
    by_heights_m = None if isinstance(target.grid, RpcGrid) else target.relief_m
    if by_heights_m is None or by_heights_m < parameters.least_relief_m or reference.relief_m is not None:
        return ""
    return (
        f"the ground of the radar image {plain_uri(target.uri)} varies by {by_heights_m:.0f} m in height, "
        "which displaces it by as much and more: give --dem"
    )


def check_model(model: str) -> None:
    """Raise `SettingsError` where an RPC cannot take corrections of a model."""
    if model not in ("auto", "rpc", *LOSSLESS):
        raise SettingsError(
            f"model = {model!r}: an RPC takes a shift, a drift or an affine; give --model auto"
        )


def _placed(
    info: RasterInfo,
    source: RpcSource,
    dem: Path | str | None,
    vertical: Vertical,
    **how: Any,  # noqa: ANN401
) -> RpcPlacement:
    """Place a raster by its RPC; an error also mentions the warnings about that RPC, such as a second one."""
    try:
        return place_by_rpc(info, source, None if dem is None else str(dem), vertical, **how)
    except InputError as error:
        raise InputError("; ".join([str(error), *source.warnings])) from error


def _unused_rpc(warning: str, uri: str) -> tuple[str, ...]:
    """Return a warning if a raster has an RPC that can be read; nothing otherwise."""
    try:
        source = read_rpc(uri)
    except InputError:
        return ()
    return () if source is None else (warning,)


def check_start(
    placement: RpcPlacement,
    prealignment: Prealignment,
    matching_grid: Grid,
    settings: Settings,
    parameters: RpcParameters = RpcParameters(),
) -> None:
    """Raise an error if `prealignment` is so far from the position by RPC that the RPC must be another's.

    `placement` is the image, `matching_grid` has the pixels of the pre-alignment. Raises `InputError` if the
    distance is more than `MAX_BIAS_M`, unless `settings` say that the user asked for a search or trusts the
    RPC.
    """
    px_m = middle_pixel_size_m(matching_grid)
    trusted = settings.trust_rpc or settings.prealign == "search"
    if prealignment.method != "search" or trusted or px_m is None:
        return
    off_m = np.array(prealignment.shift_px) * px_m
    if np.hypot(*off_m) > parameters.most_bias_m:
        raise InputError(
            f"{placement.info.uri} was found {np.hypot(*off_m):.0f} m from where the RPC in "
            f"{placement.source.origin} puts it: it is the RPC of another image or of the one that this was "
            "cropped from; give the RPC of the image as it is (gdal_translate -srcwin adapts it), or give "
            "--trust-rpc to correct it by a shift all the same"
        )


def shifted(target: RasterInfo, shift_px: Float64) -> RasterInfo:
    """Return `target` with its RPC moved by the (2,) shift `shift_px` (col, row) of its pixels."""
    grid = _rpc_grid(target)
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), shift_px]))
    return replace(target, grid=replace(grid, rpc=apply_bias(grid.rpc, correction)))


def corrected_rpc(placement: RpcPlacement, correction: Correction | None) -> RpcRegistration:
    """Apply `correction` to the RPC of the target `placement`.

    Raises `InputError` if the corrected RPC cannot reproduce the correction to 1e-3 px, and `TypeError` if
    the correction is not at most affine.
    """
    source, grid = placement.source, _rpc_grid(placement.info)
    if correction is None:
        return RpcRegistration(source.origin, grid, None, None, placement.heights_m)
    if not isinstance(correction, AffineCorrection):
        raise TypeError(f"{correction!r} cannot be folded into an RPC")
    what = f"the {correction.name} correction of {placement.info.uri}"
    return _folded(placement, correction, what, "give --model shift")


def _folded(placement: RpcPlacement, correction: AffineCorrection, what: str, advice: str) -> RpcRegistration:
    """Return the RPC of an image with a correction, `what` in messages; raise where that does not fit."""
    source, grid, heights_m = placement.source, _rpc_grid(placement.info), placement.heights_m
    shape = grid.shape
    corrected = apply_bias(source.rpc, correction, covered_range(source.rpc, shape, heights_m))
    error_px = bias_error_px(source.rpc, corrected, correction, shape, heights_m)
    if not error_px <= BIAS_TOLERANCE_PX:
        raise InputError(f"{what} does not fit into its RPC: {error_px:.2g} px are left; {advice}")
    return RpcRegistration(source.origin, grid, replace(grid, rpc=corrected), error_px, heights_m)


def height_errors(
    reference: Grid, target: Grid, points: TiePointTable, parameters: RpcParameters = RpcParameters()
) -> str | None:
    """Return that residuals run along the parallax, as errors of the DEM make them; None where they do not.

    The `points` are those that agree, with the residuals of a correction.
    """
    if not (isinstance(target, RpcGrid) and isinstance(target.heights, Dem)):
        return None
    grids = [(with_height_offset(reference, m), with_height_offset(target, m)) for m in (0.5, -0.5)]
    up, down = (map_px(points.reference_px, *grid_pair) for grid_pair in grids)
    rate_px = np.nanmedian(up - down, axis=0)  # by a metre of height
    size_px = float(np.hypot(*rate_px))
    residual_px = points.residual_px - np.median(points.residual_px, axis=0)
    if not size_px > parameters.most_parallax / 10:
        return None
    turned = residual_px @ np.array([rate_px, [-rate_px[1], rate_px[0]]]).T / size_px
    along, across = np.percentile(np.abs(turned), 90, axis=0).tolist()
    if along < parameters.parallax_ratio * across:
        return None
    return (
        f"the residuals run along the parallax of height: a tenth of them are over {along:.1f} px along it, "
        f"{across:.1f} px across: the DEM {target.heights.uri} errs by {along / size_px:.0f} m and more "
        "there, which no correction takes out; give a finer or better one"
    )


def _rpc_grid(target: RasterInfo) -> RpcGrid:
    if not isinstance(target.grid, RpcGrid):
        raise TypeError(f"{target.uri} is not placed by an RPC")
    return target.grid


@dataclass(frozen=True, slots=True)
class CorrectedRpc:
    """The RPC of the target of a finished registration, with all that the correction of a sibling needs."""

    original: RpcModel
    corrected: RpcModel
    shape: tuple[int, int]
    """Rows and columns of the target."""
    dem: str | None
    dem_vertical: Vertical
    height_m: float | None
    """Height of all ground above the ellipsoid without a DEM."""
    trusted: bool = False
    """Whether RPCs are used however far off they place an image."""


def correct_other_image(
    uri: str, target: CorrectedRpc, parameters: RpcParameters = RpcParameters()
) -> tuple[RpcRegistration, tuple[str, ...]]:
    """Apply the correction of the RPC of `target` to that of the image `uri`; also return warnings.

    An image without georeferencing that has the target's size has its RPC too. Raises `InputError` if the
    image has no RPC, is not a sibling, or the DEM cannot be used.
    """
    info = describe(uri)
    source = _rpc_of(info, target)
    how: dict[str, Any] = {"height_m": target.height_m, "trusted": target.trusted}
    placement = _placed(info, source, target.dem, target.dem_vertical, **how)
    warnings = placement.warnings if target.dem is not None else source.warnings
    grid = _rpc_grid(placement.info)
    if source.rpc == target.original and info.grid.shape == target.shape:
        same = RpcRegistration(
            source.origin, grid, replace(grid, rpc=target.corrected), None, placement.heights_m
        )
        return same, warnings
    separation_m = parallax(target.original, source.rpc, info.grid.shape, placement.heights_m)
    if not separation_m <= parameters.most_parallax:
        raise InputError(
            f"{uri} was not taken from where the registered image was: a metre of height displaces the "
            f"ground {separation_m:.2f} m differently in the two, so that the errors of their RPCs differ; "
            "register it on its own"
        )
    correction, misfit_px = carried(
        target.original, target.corrected, source.rpc, info.grid.shape, placement.heights_m
    )
    if not misfit_px <= parameters.most_misfit_px:
        raise InputError(
            f"the correction of the registered image cannot be carried over to {uri}: {misfit_px:.2g} px "
            "are left; register it on its own"
        )
    what = f"the correction carried over to {uri}"
    return _folded(placement, correction, what, "register it on its own"), warnings


def _rpc_of(info: RasterInfo, target: CorrectedRpc) -> RpcSource:
    source = read_rpc(info.uri)
    if source is not None:
        return source
    rows, cols = target.shape
    if info.georeferenced or info.grid.shape != target.shape:
        description = (
            "a geotransform" if info.georeferenced else f"{info.grid.shape[1]} x {info.grid.shape[0]} px"
        )
        raise InputError(
            f"{info.uri} has no RPC (tag, .RPB or _RPC.TXT beside it) but {description}: give a band in the "
            f"sensor's geometry, with its RPC, or of the registered image's {cols} x {rows} px"
        )
    return RpcSource(target.original, "the registered image", ())
