"""Stacks of images with RPCs: their places over a DEM, the points between them, and what is written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import betainc

from pcwlad_geo.band_warping import WarpOutput, apply
from pcwlad_geo.correction.fit import LOSSLESS
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.points import thin
from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.estimation.robust import sigma_of
from pcwlad_geo.events import EventCallback, Progress, Warned, only_warnings
from pcwlad_geo.limits import check_coordinates, check_grid
from pcwlad_geo.multi.control_points import (
    CONTROL_COLUMNS,
    CONTROL_SIGMA_PX,
    LEAST_CONTROL_SIGMA_PX,
    check_place,
    control_point,
)
from pcwlad_geo.multi.cycles import closure_of, residual_ce90
from pcwlad_geo.multi.image_positions import NODES, compared, placed_values, raster_paths
from pcwlad_geo.multi.rpc_block import (
    PLACE_SIGMAS,
    BlockAdjustment,
    BlockFit,
    BlockPair,
    RpcBlock,
    adjust_block,
    implied_heights,
    pixel_in_frame,
)
from pcwlad_geo.multi.stack_frame import StackFrame
from pcwlad_geo.multi.stack_inputs import StackInput, check_reference, number_of, read_table
from pcwlad_geo.multi.stack_pairs import Measured, StackPair
from pcwlad_geo.multi.stack_result import BlockNumbers, Chosen, DemCheck, ImageRpc, Misfit, Stack, StackImage
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.write import NAMES, BandOutput, orthorectify_band
from pcwlad_geo.raster.crs import WGS84, transform_xy
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px, pixel_sizes_m
from pcwlad_geo.raster.identity import identify
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import OUTPUT_GRIDS, GridRequest
from pcwlad_geo.raster.rpc.dem import Dem, relief
from pcwlad_geo.raster.rpc.files import RpcSource, read_rpc, to_gdal, write_rpc_text
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height, image_px
from pcwlad_geo.raster.rpc.ortho import ortho_grid
from pcwlad_geo.raster.rpc.placement import PLACEMENT, RpcPlacement, place_by_rpc
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.vrt import write_rpc_vrt
from pcwlad_geo.registration import requested_grid
from pcwlad_geo.registration.rpc import check_model, corrected_rpc, ground_crs
from pcwlad_geo.report.finished import FinishedRegistration, read_report
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Bool, Float64, PathLike

POINTS: Final = 3000
"""Largest number of tie points of a pair in the adjustment, spread evenly."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedImages:
    """The images of a block over the ground."""

    frame: StackFrame
    """Its grid is that of all orthorectified images."""
    placements: tuple[RpcPlacement | None, ...]
    """Of each image; None for the reference, which lies on the map."""
    datum_image: int | None
    """Number of the image that stays; None: the mean of all does, or control points tell."""

    @property
    def block(self) -> RpcBlock:
        """The images and, last, the ground itself."""
        grids = (*(info.grid for info in self.frame.infos), self.frame.grid)
        fixed = frozenset(() if self.datum_image is None else (self.datum_image,))
        return RpcBlock(grids, self.frame.grid, fixed)


def has_rpcs(infos: Sequence[RasterInfo], settings: Settings) -> bool:
    """Return whether images are to be placed by RPCs: one has no other georeferencing, or there is a DEM."""
    return settings.dem is not None or any(_rpc_of(info) is not None for info in infos)


def _rpc_of(info: RasterInfo) -> RpcSource | None:
    return None if info.georeferenced else read_rpc(info.uri)


def place_images(
    inputs: Sequence[StackInput],
    infos: Sequence[RasterInfo],
    reference: str | None,
    settings: Settings,
    unreadable: dict[str, str],
    tell: EventCallback,
) -> PlacedImages:
    """Place the images of a block over the DEM; those that cannot be are named and left out.

    An image on the map is the reference, the one of that name or the first. Raises `InputError` if there is
    no DEM, no image with an RPC, or fewer than two images are left.
    """
    if settings.dem is None:
        given = [each.name for each, info in zip(inputs, infos, strict=True) if _rpc_of(info) is not None]
        raise InputError(
            f"{', '.join(given)}: images with RPCs lie on the ground by a DEM only: give --dem "
            "(and --dem-vertical)"
        )
    check_model(settings.model)
    names = [each.name for each in inputs]
    check_reference(reference, names)
    on_map = [
        name
        for name, info in zip(names, infos, strict=True)
        if info.georeferenced and info.grid.crs is not None
    ]
    base = reference if reference in on_map else on_map[0] if on_map else None
    kept: list[tuple[StackInput, RasterInfo, RpcPlacement | None]] = []
    notes: list[str] = []
    for each, info in zip(inputs, infos, strict=True):
        try:
            placed = None if each.name == base else _placed(each, info, base, settings)
            kept.append((each, info if placed is None else placed.info, placed))
        except InputError as error:
            unreadable[each.path] = str(error)
            notes.append(f"{each.name} is left out: {error}")
            continue
        notes += placed.warnings if placed else ()
    if len(kept) < 2 or not any(placed for _, _, placed in kept):
        raise InputError(
            f"{len(kept)} of {len(names)} images can be placed, and with RPCs and a DEM two are "
            f"needed, one of them with an RPC: {'; '.join(dict.fromkeys(unreadable.values())) or 'give more'}"
        )
    for note in notes:
        tell(Warned(note))
    kept.sort(key=lambda image: image[2] is not None)  # the reference first
    return _framed(kept, reference)


def _placed(given: StackInput, info: RasterInfo, base: str | None, settings: Settings) -> RpcPlacement:
    """Place an image by its RPC, with the heights around it in memory."""
    source = _rpc_of(info)
    if source is None:
        why = f"and {base} is the reference" if info.georeferenced else "nor a geotransform"
        raise InputError(f"{given.path} has no RPC that counts (tag, .RPB or _RPC.TXT), {why}")
    placed = place_by_rpc(info, source, str(settings.dem), settings.dem_vertical, trusted=settings.trust_rpc)
    grid = placed.info.grid
    if isinstance(grid, RpcGrid) and isinstance(grid.heights, Dem):
        lon_lat, _ = grid.line_of_sight(grid.lattice_px(PLACEMENT.lattice))
        grid = replace(grid, heights=grid.heights.held(lon_lat))
    return replace(placed, info=replace(placed.info, grid=grid))


def _framed(
    kept: Sequence[tuple[StackInput, RasterInfo, RpcPlacement | None]], reference: str | None
) -> PlacedImages:
    """Return the images in the CRS and on the grid of all results."""
    grids = [info.grid for _, info, _ in kept]
    own = kept[0][2] is None
    raw = [grid for grid in grids if isinstance(grid, RpcGrid)]
    crs = grids[0].crs if own else ground_crs(raw[0])
    raw = [replace(grid, crs=crs) for grid in raw]
    common = common_grid(grids[0] if own else ground_grid(raw[0]), raw)
    placed_at = iter(raw)
    infos, placements = [], []
    for _, info, placed in kept:
        grid = info.grid if placed is None else next(placed_at)
        infos.append(replace(info, grid=grid))
        placements.append(None if placed is None else replace(placed, info=infos[-1]))
    names = [given.name for given, _, _ in kept]
    number = 0 if own else names.index(reference) if reference else None
    frame = StackFrame(names, infos, common, True, tuple(given for given, _, _ in kept), number or 0)
    return PlacedImages(frame, tuple(placements), number)


def common_grid(base: Grid, images: Sequence[RpcGrid]) -> Grid:
    """Return the grid of all orthorectified images: the lattice of a map grid, at the finest pixel size.

    Raises `InputError` if an image cannot be placed in its CRS, or the grid has too many pixels.
    """
    own = [ortho_grid(base, image) for image in images]
    finest = min(own, key=lambda grid: abs(float(np.linalg.det(linear_part(grid.transform)))))
    outlines = np.concatenate([map_px(grid.boundary_px(), grid, finest) for grid in own])
    sliver_px = OUTPUT_GRIDS.sliver_px
    low, high = np.floor(outlines.min(axis=0) + sliver_px), np.ceil(outlines.max(axis=0) - sliver_px)
    pixels = sum(grid.shape[0] * grid.shape[1] for grid in images)
    check_grid("the common grid of all images", (high - low).tolist(), pixels)
    cols, rows = (high - low).astype(int).tolist()
    return finest.part((float(low[0]), float(low[1])), (rows, cols))


def without_ground(
    placed: PlacedImages, pairs: Sequence[tuple[int, int]], unreadable: dict[str, str], tell: EventCallback
) -> list[int]:
    """Return the numbers of the images that share ground with another; the others are named.

    Raises `InputError` if no two images do.
    """
    frame = placed.frame
    shown = {image for pair in pairs for image in pair}
    if not shown:
        raise InputError(
            f"{', '.join(frame.names)}: no two of the images share ground, where their RPCs put them: give "
            "images of one ground, each with its own RPC"
        )
    for number, name in enumerate(frame.names):
        if number not in shown:
            reason = f"{name} shares no ground with any other image, where its RPC puts it"
            unreadable[frame.given(number).path] = reason
            tell(Warned(f"{reason}: it is left out"))
    return sorted(shown)


def part_of_images(placed: PlacedImages, chosen: Sequence[int]) -> PlacedImages:
    """Return a block of some of its images."""
    frame = placed.frame
    datum_image = chosen.index(placed.datum_image) if placed.datum_image in chosen else None
    part = replace(
        frame,
        names=[frame.names[number] for number in chosen],
        infos=[frame.infos[number] for number in chosen],
        inputs=tuple(frame.inputs[number] for number in chosen),
        reference=datum_image or 0,
    )
    return PlacedImages(part, tuple(placed.placements[number] for number in chosen), datum_image)


def tie_points_of(measured: Sequence[Measured]) -> list[BlockPair]:
    """Return the tie points of the pairs that were matched, in the pixels of their files."""
    found = []
    for edge, pair in measured:
        if edge is None:
            continue
        points = read_point_file(pair.folder / "tiepoints.csv")
        sigma_px = points.sigma_px
        if sigma_px is None:
            raise InputError(f"{pair.folder} has tie points without sigma: remove it, and run again")
        good = points.enabled & (sigma_px > 0).all(axis=1)
        chosen = np.flatnonzero(good)[thin(points.target[good], np.hypot(*sigma_px[good].T), POINTS)]
        covariance = np.einsum("na,ab->nab", sigma_px[chosen] ** 2, np.eye(2))
        ends = edge.first, edge.second
        window_px = float(read_report(pair.folder)["window_px"])
        found.append(
            BlockPair(*ends, points.reference[chosen], points.target[chosen], covariance, window_px=window_px)
        )
    return found


def control_points_of(table: PathLike, placed: PlacedImages) -> list[BlockPair]:
    """Return the control points of a table, image by image, as points between the ground and the image.

    It has the columns image, col, row (px of the file, corner-based), x, y (CRS of the reference; without
    one, of the DEM) and, if known, z (metres above the ellipsoid; else the DEM's height) and sigma (metres
    along an axis). Raises `InputError` if it cannot be used.
    """
    frame, dem = placed.frame, placed.block.dem
    rows = read_table(Path(table), CONTROL_COLUMNS)
    points = [control_point(row, str(table)) for row in rows]
    heights = np.array([number_of(row, "z") if row.get("z") else np.nan for row in rows])
    check_coordinates(str(table), heights[np.array([bool(row.get("z")) for row in rows], bool)].tolist())
    crs = frame.grid.crs if placed.placements[0] is None or dem is None else dem.grid.crs
    found = []
    for name in dict.fromkeys(point.image for point in points):
        image = frame.names.index(name) if name in frame.names else None
        if image is None or placed.placements[image] is None:
            raise InputError(f"{table} names {name}, which is none of the images with RPCs")
        own = [number for number, point in enumerate(points) if point.image == name]
        at = np.array([(points[k].col, points[k].row, points[k].x, points[k].y) for k in own])
        grid = frame.infos[image].grid
        sigma_m = np.array([points[k].sigma or np.nan for k in own])
        sigma_px = np.nan_to_num(sigma_m / _pixel_m(grid), nan=CONTROL_SIGMA_PX)
        covariance = np.maximum(sigma_px, LEAST_CONTROL_SIGMA_PX)[:, None, None] ** 2 * np.eye(2)
        ground_px = frame.grid.to_px(transform_xy(at[:, 2:], crs, frame.grid.crs))
        placed_px = image_px(grid, frame.grid, ground_px, heights[own])
        check_place(name, at[:, :2], placed_px, sum(frame.grid.shape) + sum(grid.shape))
        found.append(BlockPair(len(frame.names), image, ground_px, at[:, :2], covariance, heights[own]))
    return found


def _pixel_m(grid: Grid) -> float:
    sizes = pixel_sizes_m(at_mean_height(grid), grid.middle_px)
    return 1.0 if sizes is None else float(np.mean(sizes[0]))


def adjusted(
    placed: PlacedImages, pairs: Sequence[BlockPair], settings: Settings
) -> tuple[BlockAdjustment, DemCheck | None]:
    """Adjust a block, and ask the tie points what they say of the DEM.

    A wrong DEM looks like RPCs that drift: with one, a shift of each is all that is told. Raises
    `RegistrationRejectedError` if points held out lie farther apart with the corrections than without.
    """
    block = placed.block
    control = any(pair.height_m is not None for pair in pairs)
    absolute = control or placed.placements[0] is None
    if control:
        block = replace(block, fixed=frozenset())
    found = adjust_block(block, pairs, ("shift",))
    check = check_dem(block, pairs, found, absolute)
    left_open = settings.model in ("auto", "rpc")
    if settings.model != "shift" and not (left_open and check is not None and check.faults):
        found = adjust_block(block, pairs, tuple(LOSSLESS) if left_open else (settings.model,), found)
    unused = found.hold_out
    if unused is not None and unused.worse:
        raise RegistrationRejectedError(
            f"tie points held out lie {unused.after_px:.2f} px apart with the corrected RPCs and "
            f"{unused.before_px:.2f} px with those of the files, over the DEM as it is: nothing is written; "
            + "; ".join((check and check.faults) or ["check the DEM and the pairs"])
        )
    return found, check


def block_stack(
    placed: PlacedImages,
    measured: Sequence[Measured],
    pairs: Sequence[BlockPair],
    adjustment: BlockAdjustment,
    check: DemCheck | None,
    folder: Path,
    settings: Settings,
    warnings: list[str],
    unreadable: Mapping[str, str],
    chosen: Chosen,
) -> Stack:
    """Return what the adjustment of a block says of each pair and each image."""
    frame = placed.frame
    fits = dict(zip((id(pair) for pair in pairs), adjustment.edges, strict=True))
    tied = iter([pair for pair in pairs if pair.height_m is None])
    warnings, stacked = list(warnings), []
    for edge, pair in measured:
        own = None if edge is None else next(tied)
        stacked.append(pair if own is None else _pair(placed, pair, own, fits[id(own)], warnings))
    used = [pair for pair in stacked if pair.status == "used"]
    rasters = raster_paths(frame, folder, settings)
    images = tuple(_image(placed, number, adjustment, each, used) for number, each in enumerate(rasters))
    control = any(pair.height_m is not None for pair in pairs)
    own_datum = "mean" if placed.datum_image is None else frame.names[placed.datum_image]
    numbers = BlockNumbers(
        model=adjustment.model,
        scores_px={model: round(score, 4) for model, score in adjustment.scores.items()},
        dem=check,
        misfits=tuple(_misfits(placed, pairs, adjustment)),
        hold_out=adjustment.hold_out,
        warnings=((check and check.faults) or ()) + tuple(control_warnings(placed, pairs, adjustment)),
    )
    return Stack(
        images=images,
        pairs=tuple(stacked),
        shared=adjustment.shared_px,
        datum="control points" if control else own_datum,
        out_dir=folder,
        warnings=tuple(warnings),
        adjustment=adjustment,
        unreadable=unreadable,
        reference=frame.names[frame.reference],
        chosen=chosen,
        closure=closure_of(stacked),
        block=numbers,
    )


def _pair(
    placed: PlacedImages, pair: StackPair, points: BlockPair, fit: BlockFit, warnings: list[str]
) -> StackPair:
    """Return a pair with how it agrees with the adjustment, px of the frame."""
    frame = placed.frame
    scale = _to_frame(frame, frame.infos[points.second].grid)
    offset, size = scale @ np.array(fit.offset_px), float(np.sqrt(abs(np.linalg.det(scale))))
    return replace(
        compared(pair, fit.used, (float(offset[0]), float(offset[1])), warnings),
        points=len(points),
        sigma_px=fit.sigma_px * size,
        redundancy=fit.redundancy,
        scatter_px=fit.scatter_px * size,
        ce90_px=residual_ce90(points.second_px, fit.residual_px) * size,
    )


def _to_frame(frame: StackFrame, grid: Grid) -> Float64:
    """Return the (2, 2) derivatives of the frame's px by those of an image, in its middle."""
    level = at_mean_height(grid)
    return np.asarray(jacobian(level.middle_px, level, frame.grid)[0])


def _image(
    placed: PlacedImages,
    number: int,
    adjustment: BlockAdjustment,
    registered: Path,
    used: Sequence[StackPair],
) -> StackImage:
    frame, placement = placed.frame, placed.placements[number]
    info, correction = frame.infos[number], adjustment.corrections[number]
    at_px = info.grid.lattice_px(NODES)
    covariance = adjustment.covariance(number, at_px)
    rpc = None
    if placement is not None:
        corrected = corrected_rpc(placement, correction)
        vrt, text = rpc_names([frame.names[number]])
        rpc = ImageRpc(
            corrected.origin, corrected.bias_error_px, vrt, text, corrected.corrected_grid.rpc, corrected
        )
    return StackImage(
        **placed_values(frame, number, correction.forward(at_px) - at_px, covariance, used, 0),
        correction=correction,
        registered=registered,
        rpc=rpc,
        frame_px=float(abs(np.linalg.det(_to_frame(frame, info.grid)))) ** 0.5,
    )


def _misfits(placed: PlacedImages, pairs: Sequence[BlockPair], adjustment: BlockAdjustment) -> list[Misfit]:
    """Return how the images fit what the block lies on: the reference's tie points and control points."""
    frame, found = placed.frame, []
    for pair, fit in zip(pairs, adjustment.edges, strict=True):
        control = pair.height_m is not None
        ends = (pair.first, pair.second)
        if not control and (placed.placements[0] is not None or 0 not in ends):
            continue
        known = fit.weight.any(axis=(1, 2)) & ~(_off(pair, fit) if control else False)
        left = fit.residual_px[known]
        residuals_px = tuple((float(col), float(row)) for col, row in fit.residual_px)
        size_m = _pixel_m(frame.infos[pair.second].grid)
        rmse = float(np.sqrt((left**2).sum(axis=1).mean())) if len(left) else float("nan")
        mean = np.median(left, axis=0) if len(left) else np.full(2, np.nan)
        found.append(
            Misfit(
                kind="control points" if control else "reference",
                image=frame.names[max(number for number in ends if number < len(frame.names))],
                points=int(known.sum()),
                median_px=(float(mean[0]), float(mean[1])),
                rmse_px=rmse,
                rmse_m=rmse * size_m,
                residuals_px=residuals_px if control else None,
            )
        )
    return found


def _off(pair: BlockPair, fit: BlockFit) -> Bool:
    """Return the (n,) mask of the control points that contradict all others."""
    off = np.hypot(*fit.residual_px.T) / np.sqrt(np.trace(pair.covariance_px2, axis1=1, axis2=2) / 2)
    return np.asarray(off > 5.0 * max(1.0, float(np.nanmedian(off))))


def control_warnings(placed: PlacedImages, pairs: Sequence[BlockPair], found: BlockAdjustment) -> list[str]:
    """Name the control points that contradict the others."""
    warnings = []
    for pair, fit in zip(pairs, found.edges, strict=True):
        if pair.height_m is None:
            continue
        for index in np.flatnonzero(_off(pair, fit)).tolist():
            (col, row), length = pair.second_px[index], float(np.hypot(*fit.residual_px[index]))
            name = placed.frame.names[pair.second]
            warnings.append(
                f"the control point at ({col:.1f}, {row:.1f}) px (col, row) of {name} lies {length:.1f} "
                "px off what all others tell: check its coordinates"
            )
    return warnings


def output_grid_of(placed: PlacedImages, settings: Settings) -> Grid:
    """Return the grid on which all images are written."""
    fmt = OutputFormat.of(settings.of, settings.co)
    if fmt.is_vrt:
        raise SettingsError("of = 'VRT': a VRT cannot hold an orthorectified image; give --of COG or GTiff")
    if settings.grid == "target":
        raise SettingsError("grid = 'target': the pixels of an image with RPC are no grid on the ground")
    return requested_grid(settings).fixed(placed.frame.grid) or placed.frame.grid


def write_images(
    found: Stack, placed: PlacedImages, folder: Path, settings: Settings, on_event: EventCallback
) -> None:
    """Write each image on the common grid, and the corrected RPCs with the original pixels.

    The files will lie in `folder`, wherever `found` says that they are made.
    """
    grid, fmt = output_grid_of(placed, settings), OutputFormat.of(settings.of, settings.co)
    wanted = WarpOutput(grid, GridRequest(like=grid), fmt, settings.resampling)
    still, quiet = AffineCorrection("shift", np.eye(2, 3)), partial(only_warnings, on_event)
    for number, image in enumerate(found.images):
        on_event(Progress("images", number, len(found.images)))
        if image.rpc is None:  # the reference
            info = placed.frame.infos[placed.frame.names.index(image.name)]
            warp_image(info, image.registered, still, wanted, quiet)
            continue
        how = BandOutput(grid, settings.resampling, fmt, folder / image.registered.name)
        corrected, stage = image.rpc.registration.corrected_grid, image.registered.parent
        orthorectify_band(image.path, image.registered, corrected, how, quiet)
        vrt = image.rpc.vrt
        write_rpc_vrt(stage / vrt, image.path, to_gdal(corrected.rpc), final_path=folder / vrt)
        write_rpc_text(corrected.rpc, stage / image.rpc.text)
    on_event(Progress("images", len(found.images), len(found.images)))


def warp_image(
    info: RasterInfo, place: Path, correction: Correction, wanted: WarpOutput, on_event: EventCallback
) -> None:
    """Resample an image with a geotransform by a correction, to a file."""
    done = FinishedRegistration(
        correction,
        wanted.reference_grid,
        info.grid,
        wanted.request,
        wanted.format,
        wanted.resampling,
        inputs=tuple(identify(info.uri)),
    )
    apply(done, [info.uri], [place], wanted, False, True, on_event)


def rpc_names(images: Sequence[str]) -> list[str]:
    """Return the names of the files of corrected RPCs that images of these names would have."""
    return [NAMES[kind].format(stem=name) for name in images for kind in ("rpc", "rpc_text")]


SIGNIFICANCE_LEVEL: Final = 0.1
"""Probability below which biases that all lie along the parallax are not taken for those of RPCs."""
LEAST_SEPARATION_PX: Final = 4.0
"""Least disagreement of two images, px, by which a DEM is called too high or too low."""
OFFSET_PX: Final = 3.0
"""A DEM is called displaced by at least so many of its pixels, or of the images', if that is significant."""
SCALE: Final = 0.03
"""Least error of the scale of heights that is told."""
SCALE_SIGMAS: Final = 5.0
"""It is told beyond so many sigmas."""
MIN_RELIEF: Final = 10.0
"""Least relief, in standard deviations of a point's height, that tells of the scale."""
ROUGH_PX: Final = 2.0
"""Least distance of two orthoimages that the scatter of a DEM's heights makes for them to be told of."""


def check_dem(
    block: RpcBlock, pairs: Sequence[BlockPair], found: BlockAdjustment, absolute: bool
) -> DemCheck | None:
    """Return what the tie points of a block say of its DEM; None without one.

    One that is wrong by a constant looks like RPCs that err along the lines of parallax alone, each as its
    view asks for, which chance hardly brings about. One that lies beside its place, or has another scale of
    heights, leaves residuals along these lines that follow its slopes, or its heights. The block is
    `absolute` if a reference or control points fix it.
    """
    dem = block.dem
    if dem is None:
        return None
    height_m, chance, separation_px = _too_high(block, pairs, found)
    offset_m, sigma_m = _horizontal_offset(block, dem, found, absolute)
    scale, scale_sigma = _scale(block, pairs, found)
    reasons: list[str] = []
    if (
        chance is not None
        and chance < SIGNIFICANCE_LEVEL
        and separation_px is not None
        and separation_px >= LEAST_SEPARATION_PX
    ):
        reasons.append(_height_message(dem, height_m or 0.0, separation_px))
    if offset_m is not None and found.dem_moved and np.hypot(*offset_m) > _least_m(block, dem, absolute):
        reasons.append(
            f"the relief of the DEM {dem.uri} lies ({offset_m[0]:+.1f}, {offset_m[1]:+.1f}) m (x, y) beside "
            "the relief that the tie points show: check its position"
            + ("" if absolute else ", unless the RPCs of all images err by that")
        )
    if scale is not None and abs(scale) > max(SCALE, SCALE_SIGMAS * (scale_sigma or 0.0)):
        reasons.append(
            f"the relief of the DEM {dem.uri} is {100 * abs(scale):.0f} % too "
            f"{'high' if scale > 0 else 'low'}: check the unit of its heights, and whether it is smoothed"
        )
    rough_px = found.sigma_height_m * _parallax_px(found)
    if rough_px > ROUGH_PX:
        reasons.append(
            f"the heights of the DEM {dem.uri} scatter by {found.sigma_height_m:.1f} m about those of the "
            f"tie points, which sets orthoimages {rough_px:.1f} px apart from place to place"
        )
    return DemCheck(
        uri=dem.uri,
        too_high_m=height_m,
        by_chance=chance,
        separation_px=separation_px,
        offset_m=offset_m,
        offset_sigma_m=sigma_m,
        scale=scale,
        scale_sigma=scale_sigma,
        scatter_m=found.sigma_height_m,
        off_m=_off_m(block, found),
        faults=tuple(reasons),
    )


def _off_m(block: RpcBlock, found: BlockAdjustment) -> float:
    """Return `DemCheck.off_m`: what a DEM that stays beside its place does to the heights of points."""
    if not found.dem_moved:
        return 0.0
    ground_px = np.concatenate([fit.linear.ground_px for fit in found.edges])
    higher_m, _ = relief(block.dem, block.frame, ground_px, 0.0, found.dem_shift_px)
    return float(np.percentile(np.abs(higher_m - np.mean(higher_m)), 90))


def _height_message(dem: Dem, height_m: float, separation_px: float) -> str:
    side = "high" if height_m > 0 else "low"
    return (
        f"the DEM {dem.uri} lies about {abs(height_m):.1f} m too {side} by the parallax of the tie points, "
        f"or the RPCs err along the parallax alone, by up to {separation_px:.1f} px: check --dem-vertical "
        "(what its heights are above) and its position"
    )


def _too_high(
    block: RpcBlock, pairs: Sequence[BlockPair], found: BlockAdjustment
) -> tuple[float | None, float | None, float | None]:
    """Return how much too high the DEM seems, the chance of that, and what it sets images apart by, px."""
    size = {image: pixel_in_frame(block, image) for image in found.free}
    by_height, by_image = [], []
    for image in found.free:
        middle = block.grids[image].middle_px
        by_height.append(found.by_height_px[image] * size[image])
        by_image.append((found.corrections[image].forward(middle) - middle)[0] * size[image])
    response, biases = np.concatenate(by_height), np.concatenate(by_image)
    freedom = 2 * len(found.free) - min(found.datum_rank, 2)
    power = float(response @ response)
    rate = _parallax_px(found)
    if freedom < 2 or not rate > 1e-3 or not power > 0 or not np.any(biases):
        return None, None, None
    height_m = float(response @ biases) / power
    alike = height_m**2 * power / float(biases @ biases)
    chance = 1.0 - float(betainc(0.5, (freedom - 1) / 2, min(alike, 1.0)))
    return height_m, chance, abs(height_m) * rate


def _parallax_px(found: BlockAdjustment) -> float:
    """Return by how much a metre of height sets two images apart, at most."""
    derivatives = [np.nanmedian(fit.linear.height_derivative, axis=0) for fit in found.edges]
    return max((float(np.hypot(*each)) for each in derivatives), default=0.0)


def _horizontal_offset(
    block: RpcBlock, dem: Dem, found: BlockAdjustment, absolute: bool
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return where the relief of the DEM lies, and its standard deviation; None where it cannot tell."""
    sizes = pixel_sizes_m(dem.grid, dem.grid.middle_px)
    if sizes is None:
        return None, None
    off, sigma = -found.dem_shift_px * sizes[0], found.dem_sigma_px * sizes[0]
    if not found.dem_moved and PLACE_SIGMAS * np.hypot(*sigma) > _least_m(block, dem, absolute):
        return None, None
    down = -1.0 if dem.grid.transform.e < 0 else 1.0
    return (float(off[0]), float(down * off[1])), (float(sigma[0]), float(sigma[1]))


def _least_m(block: RpcBlock, dem: Dem, absolute: bool) -> float:
    """Return the least displacement of a DEM that is told, metres."""
    sizes = [pixel_sizes_m(grid, grid.middle_px) for grid in (dem.grid, block.frame)]
    least = OFFSET_PX * max(float(each.max()) for each in sizes if each is not None)
    return max(least, 3.0 if absolute else 10.0)  # without a reference RPCs may all miss alike


def _scale(
    block: RpcBlock, pairs: Sequence[BlockPair], found: BlockAdjustment
) -> tuple[float | None, float | None]:
    """Return the share by which the relief of the DEM is too high, and its standard deviation."""
    above, at_m, cell = (np.concatenate(each) for each in zip(*_points(block, pairs, found), strict=True))
    known = np.isfinite(above) & np.isfinite(at_m)
    above, at_m, cell = above[known], at_m[known], cell[known]
    noise = sigma_of(above) if len(above) else 0.0
    numbers = np.unique(cell)
    if len(numbers) < 6 or np.ptp(at_m) < MIN_RELIEF * max(noise, 1e-3):
        return None, None
    near = np.abs(above - np.median(above)) <= 4 * max(noise, 1e-3)

    def slope(chosen: Float64) -> float:
        return float(np.polyfit(at_m[chosen] - at_m.mean(), above[chosen], 1)[0])

    left = np.array([slope(near & (cell != number)) for number in numbers])
    sigma = 1.4 * float(np.sqrt((len(left) - 1) * left.var()))
    scale = -slope(near)
    significant = max(SCALE, abs(scale)) > SCALE_SIGMAS * sigma
    return (scale, sigma) if significant else (None, None)


def _points(
    block: RpcBlock, pairs: Sequence[BlockPair], found: BlockAdjustment
) -> Iterator[tuple[Float64, Float64, Float64]]:
    """Yield for each pair by how much its points lie above the DEM, where that is, and their cells."""
    dem = block.dem
    for pair, fit in zip(pairs, found.edges, strict=True):
        ground_px = fit.linear.ground_px
        above, _ = implied_heights(pair, fit.linear, fit.residual_px)
        lon_lat = transform_xy(block.frame.to_xy(ground_px), block.frame.crs, WGS84)
        cell = np.floor(6 * ground_px / max(block.frame.shape)) @ np.array([1.0, 100.0])
        used = fit.weight.any(axis=(1, 2)) & (pair.height_m is None)
        at_m = dem.at(lon_lat) if dem is not None else np.full(len(pair), np.nan)
        yield np.where(used, above, np.nan), at_m, cell
