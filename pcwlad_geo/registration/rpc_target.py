"""Images with RPCs: whether these count, whether they can be believed, and the correction of a target's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.rpc_fold import FOLD_TOLERANCE_PX, covered_range, fold, fold_error_px
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.crs import utm_zone_of
from pcwlad_geo.raster.dem import Dem
from pcwlad_geo.raster.geodesy import middle_pixel_size_m
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.rpc_files import RpcSource, read_rpc
from pcwlad_geo.raster.rpc_grid import RpcGrid
from pcwlad_geo.raster.rpc_view import Placed, place_by_rpc
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.registration.result import Prealignment
from pcwlad_geo.registration.settings import Settings

MODELS: Final = ("shift", "drift", "affine")
"""Corrections in image space that an RPC can take, the simplest first."""
MOST_BIAS_M: Final = 500.0
"""No sensor with RPCs errs by as much: what is found beyond is the RPC of another image."""


@dataclass(frozen=True, slots=True)
class RpcRegistration:
    """The RPC of a target, before and after."""

    origin: str
    """Where it was found."""
    original: RpcGrid
    """Of the target: its RPC, and the heights."""
    corrected: RpcGrid | None
    """The same with the corrected RPC; None without a correction."""
    fold_error_px: float | None
    """Largest distance between the corrected RPC and the correction of the original one, px."""
    heights_m: tuple[float, float]
    """Lowest and highest ground below the target, above the ellipsoid."""

    @property
    def corrected_grid(self) -> RpcGrid:
        """The corrected one."""
        if self.corrected is None:
            raise ValueError("there is no correction of the RPC")
        return self.corrected


def place_reference(
    reference: RasterInfo, target: RasterInfo, settings: Settings
) -> tuple[Placed | None, tuple[str, ...]]:
    """Place the reference by its RPC where that counts, and return warnings.

    It counts where the user gives a DEM or wants it, the reference has no other georeferencing, and the
    target can be placed too. Map coordinates of its ground are in the CRS of a georeferenced target, else of
    a DEM in metres, else in the UTM zone.

    Raises
    ------
    InputError
        If the RPC or the DEM cannot be used.
    """
    if reference.georeferenced:
        return None, ()
    if settings.dem is None and settings.model != "rpc":
        return None, _left_aside(
            f"{reference.uri} has an RPC, which counts for a reference with a DEM only: it is not used",
            reference.uri,
        )
    source, other = read_rpc(reference.uri), read_rpc(target.uri)
    if source is None or (other is None and not target.georeferenced):
        return None, ()
    # without a DEM both see the same ground: as high as the RPC of the target says
    height_m = None if other is None else other.rpc.height_off
    placed = _placed(reference, source, settings, side="reference", height_m=height_m)
    crs = _ground_crs(placed.info, target if other is None else None)
    info = replace(placed.info, grid=replace(_rpc_grid(placed.info), crs=crs))
    return replace(placed, info=info), placed.warnings


def _ground_crs(reference: RasterInfo, target: RasterInfo | None) -> CRS:
    """Return the CRS in which the ground below a reference with RPC is given."""
    if target is not None and target.grid.crs is not None:
        return target.grid.crs
    grid = _rpc_grid(reference)
    if isinstance(grid.heights, Dem) and grid.heights.grid.crs is not None:
        crs = grid.heights.grid.crs
        if crs.is_projected and crs.linear_units_factor[1] == 1.0:
            return crs
    rows, cols = grid.shape
    middle = grid.line_of_sight(np.array([[cols / 2, rows / 2]]))[0]
    return utm_zone_of(middle[0])


def place_target(
    reference: RasterInfo, target: RasterInfo, settings: Settings
) -> tuple[Placed | None, tuple[str, ...]]:
    """Place the target by its RPC where it has one that counts, and return warnings.

    It counts where the target has no other georeferencing, or the user gives a DEM or wants it.

    Raises
    ------
    InputError
        If the RPC or the DEM cannot be used, or are asked for and missing.
    """
    wanted = settings.dem is not None or settings.model == "rpc"
    if target.georeferenced and not wanted:
        return None, _left_aside(
            f"{target.uri} has a geotransform and an RPC: the RPC is not used; give --dem to use it",
            target.uri,
        )
    source = read_rpc(target.uri)
    if source is None:
        for_reference = isinstance(reference.grid, RpcGrid) and settings.model != "rpc"
        if wanted and not for_reference:
            raise InputError(
                f"{target.uri} has no RPC (tag, .RPB or _RPC.TXT beside it), which --dem and --model rpc are "
                "for: give the image with its RPC, or leave these options out"
            )
        return None, ()
    if not reference.georeferenced:
        if wanted:
            raise InputError(
                f"{reference.uri} has no georeferencing (CRS and geotransform): the RPC of {target.uri} "
                "needs a reference that has"
            )
        return None, ()
    if settings.grid == "target":
        raise SettingsError(
            "grid = 'target': the pixels of a target with RPC are no grid on the ground; give 'reference'"
        )
    if settings.model not in ("auto", "rpc", *MODELS):
        raise SettingsError(
            f"model = {settings.model!r}: an RPC takes a shift, a drift or an affine; give --model auto"
        )
    placed = _placed(target, source, settings, side="target")
    return placed, placed.warnings


def _placed(
    info: RasterInfo,
    source: RpcSource,
    settings: Settings,
    *,
    side: Literal["reference", "target"],
    height_m: float | None = None,
) -> Placed:
    """Place a raster by its RPC; where that cannot be, say also that there is another RPC."""
    dem = None if settings.dem is None else str(settings.dem)
    try:
        return place_by_rpc(
            info,
            source,
            dem,
            settings.dem_vertical,
            side=side,
            height_m=height_m,
            trusted=settings.trust_rpc,
        )
    except InputError as error:
        raise InputError("; ".join([str(error), *source.warnings])) from error


def _left_aside(warning: str, uri: str) -> tuple[str, ...]:
    """Return a warning where a raster has an RPC that can be read; nothing otherwise."""
    try:
        source = read_rpc(uri)
    except InputError:
        return ()
    return () if source is None else (warning,)


def check_start(placed: Placed, prealignment: Prealignment, matching_grid: Grid, settings: Settings) -> None:
    """Raise where the image was found so far from where its RPC puts it that the RPC must be another's.

    Raises
    ------
    InputError
        If so, unless the user asked for a search.
    """
    px_m = middle_pixel_size_m(matching_grid)
    told = settings.trust_rpc or settings.prealign == "search"
    if prealignment.method != "search" or told or px_m is None:
        return
    off_m = np.array(prealignment.shift_px) * px_m
    if np.hypot(*off_m) > MOST_BIAS_M:
        raise InputError(
            f"{placed.info.uri} was found {np.hypot(*off_m):.0f} m from where the RPC in "
            f"{placed.source.origin} puts it: it is the RPC of another image or of the one that this was "
            "cropped from; give the RPC of the image as it is (gdal_translate -srcwin adapts it), or give "
            "--trust-rpc to correct it by a shift all the same"
        )


def shifted(target: RasterInfo, shift_px: NDArray[np.float64]) -> RasterInfo:
    """Return a target with RPC placed where a shift (col, row) of its pixels puts it."""
    grid = _rpc_grid(target)
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), shift_px]))
    return replace(target, grid=replace(grid, rpc=fold(grid.rpc, correction)))


def corrected_rpc(placed: Placed, correction: Correction | None) -> RpcRegistration:
    """Fold a correction into the RPC of a target.

    Raises
    ------
    InputError
        If the corrected RPC cannot reproduce the correction to 1e-3 px.
    """
    source, grid = placed.source, _rpc_grid(placed.info)
    if correction is None:
        return RpcRegistration(source.origin, grid, None, None, placed.heights_m)
    if not isinstance(correction, AffineCorrection):
        raise TypeError(f"{correction!r} cannot be folded into an RPC")
    shape = placed.info.grid.shape
    corrected = fold(source.rpc, correction, covered_range(source.rpc, shape, placed.heights_m))
    error_px = fold_error_px(source.rpc, corrected, correction, shape, placed.heights_m)
    if not error_px <= FOLD_TOLERANCE_PX:
        raise InputError(
            f"the {correction.name} correction of {placed.info.uri} does not fit into its RPC: "
            f"{error_px:.2g} px are left; give --model shift"
        )
    return RpcRegistration(source.origin, grid, replace(grid, rpc=corrected), error_px, placed.heights_m)


def _rpc_grid(target: RasterInfo) -> RpcGrid:
    if not isinstance(target.grid, RpcGrid):
        raise TypeError(f"{target.uri} is not placed by an RPC")
    return target.grid
