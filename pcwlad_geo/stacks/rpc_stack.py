"""Stacks of images with RPCs: their places over a DEM, the points between them, and what is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.band_warping import WarpOutput, apply
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.points import thin
from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.events import EventCallback, Progress, Warned, only_warnings
from pcwlad_geo.limits import check_grid
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.write import NAMES, BandOutput, orthorectify_band
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.geodesy import pixel_sizes_m
from pcwlad_geo.raster.grid import Grid, jacobian, linear_part, map_px
from pcwlad_geo.raster.identity import identify
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import GridRequest
from pcwlad_geo.raster.rpc.dem import Dem
from pcwlad_geo.raster.rpc.files import RpcSource, read_rpc, to_gdal, write_rpc_text
from pcwlad_geo.raster.rpc.grid import RpcGrid, at_mean_height
from pcwlad_geo.raster.rpc.ortho import SLIVER_PX, ortho_grid
from pcwlad_geo.raster.rpc.view import LATTICE, RpcPlacement, ground_grid, place_by_rpc
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.raster.vrt import write_rpc_vrt
from pcwlad_geo.registration.inputs import requested_grid
from pcwlad_geo.registration.rpc import MODELS, check_model, corrected_rpc, ground_crs
from pcwlad_geo.report.finished import FinishedRegistration, read_report
from pcwlad_geo.stacks.cycles import closure_of, left_ce90
from pcwlad_geo.stacks.inputs import StackInput, check_reference, number_of, read_table
from pcwlad_geo.stacks.pairs import CONTROL_SIGMA_PX, Frame, Measured, StackPair
from pcwlad_geo.stacks.result import (
    NODES,
    BlockNumbers,
    Chosen,
    ImageRpc,
    Misfit,
    Stack,
    StackImage,
    compared,
    placed_values,
    raster_paths,
)
from pcwlad_geo.stacks.rpc_block import Block, BlockAdjustment, BlockFit, BlockPair, adjust_block
from pcwlad_geo.stacks.rpc_heights import DemCheck, check_dem
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Bool, Float64, PathLike

POINTS: Final = 3000
"""Largest number of tie points of a pair in the adjustment, spread evenly."""
CONTROL_OFF: Final = 5.0
"""A control point that lies off by more sigmas is named."""
RPC_FILES: Final = ("rpc", "rpc_text")
"""Kinds of the files of a corrected RPC."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedImages:
    """The images of a block over the ground."""

    frame: Frame
    """Its grid is that of all orthorectified images."""
    placements: tuple[RpcPlacement | None, ...]
    """Of each image; None for the reference, which lies on the map."""
    stays: int | None
    """Number of the image that stays; None: the mean of all does, or control points tell."""

    @property
    def block(self) -> Block:
        """The images and, last, the ground itself."""
        grids = (*(info.grid for info in self.frame.infos), self.frame.grid)
        return Block(grids, self.frame.grid, frozenset(() if self.stays is None else (self.stays,)))


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
        lon_lat, _ = grid.line_of_sight(grid.lattice_px(LATTICE))
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
    frame = Frame(names, infos, common, True, tuple(given for given, _, _ in kept), number or 0)
    return PlacedImages(frame, tuple(placements), number)


def common_grid(base: Grid, images: Sequence[RpcGrid]) -> Grid:
    """Return the grid of all orthorectified images: the lattice of a map grid, at the finest pixel size.

    Raises `InputError` if an image cannot be placed in its CRS, or the grid has too many pixels.
    """
    own = [ortho_grid(base, image) for image in images]
    finest = min(own, key=lambda grid: abs(float(np.linalg.det(linear_part(grid.transform)))))
    outlines = np.concatenate([map_px(grid.boundary_px(), grid, finest) for grid in own])
    low, high = np.floor(outlines.min(axis=0) + SLIVER_PX), np.ceil(outlines.max(axis=0) - SLIVER_PX)
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
    stays = chosen.index(placed.stays) if placed.stays in chosen else None
    part = replace(
        frame,
        names=[frame.names[number] for number in chosen],
        infos=[frame.infos[number] for number in chosen],
        inputs=tuple(frame.inputs[number] for number in chosen),
        reference=stays or 0,
    )
    return PlacedImages(part, tuple(placed.placements[number] for number in chosen), stays)


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
    frame, block = placed.frame, placed.block
    rows = read_table(Path(table), ("image", "col", "row", "x", "y"))
    dem = block.dem
    crs = frame.grid.crs if placed.placements[0] is None or dem is None else dem.grid.crs
    found = []
    for name in dict.fromkeys(row["image"] for row in rows):
        number = frame.names.index(name) if name in frame.names else None
        if number is None or placed.placements[number] is None:
            raise InputError(f"{table} names {name}, which is none of the images with RPCs")
        own = [row for row in rows if row["image"] == name]
        at = np.array([[number_of(row, column) for column in ("col", "row", "x", "y")] for row in own])
        height = np.array([number_of(row, "z") if row.get("z") else np.nan for row in own])
        size_m = _pixel_m(frame.infos[number].grid)
        sigma_px = np.array(
            [number_of(row, "sigma") / size_m if row.get("sigma") else CONTROL_SIGMA_PX for row in own]
        )
        if not (np.isfinite(at).all() and (sigma_px > 0).all()):
            raise InputError(f"{table}: the control points of {name} need finite numbers and sigmas above 0")
        ground_px = frame.grid.to_px(transform_xy(at[:, 2:], crs, frame.grid.crs))
        covariance = sigma_px[:, None, None] ** 2 * np.eye(2)
        found.append(BlockPair(len(frame.names), number, ground_px, at[:, :2], covariance, height))
    return found


def _pixel_m(grid: Grid) -> float:
    sizes = pixel_sizes_m(at_mean_height(grid), grid.middle_px)
    return 1.0 if sizes is None else float(np.mean(sizes[0]))


def adjusted(
    placed: PlacedImages, pairs: Sequence[BlockPair], settings: Settings
) -> tuple[BlockAdjustment, DemCheck | None]:
    """Adjust a block, and ask the tie points what they say of the DEM.

    A wrong DEM looks like RPCs that drift: with one, a shift of each is all that is told. Raises
    `RegistrationRejectedError` if points left aside lie farther apart with the corrections than without.
    """
    block = placed.block
    control = any(pair.height_m is not None for pair in pairs)
    absolute = control or placed.placements[0] is None
    if control:
        block = replace(block, fixed=frozenset())
    found = adjust_block(block, pairs, ("shift",))
    check = check_dem(block, pairs, found, absolute)
    left_open = settings.model in ("auto", "rpc")
    if settings.model != "shift" and not (left_open and check is not None and check.wrong):
        found = adjust_block(block, pairs, MODELS if left_open else (settings.model,), found)
    unused = found.left_aside
    if unused is not None and unused.worse:
        raise RegistrationRejectedError(
            f"tie points left aside lie {unused.after_px:.2f} px apart with the corrected RPCs and "
            f"{unused.before_px:.2f} px with those of the files, over the DEM as it is: nothing is written; "
            + "; ".join((check and check.wrong) or ["check the DEM and the pairs"])
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
    own_datum = "mean" if placed.stays is None else frame.names[placed.stays]
    numbers = BlockNumbers(
        adjustment.model,
        {model: round(score, 4) for model, score in adjustment.scores.items()},
        check,
        tuple(_misfits(placed, pairs, adjustment)),
        adjustment.left_aside,
        ((check and check.wrong) or ()) + tuple(control_warnings(placed, pairs, adjustment)),
    )
    datum = "control points" if control else own_datum
    return Stack(
        *(images, tuple(stacked), adjustment.shared_px, datum, folder, tuple(warnings), adjustment),
        *(unreadable, frame.names[frame.reference], chosen, closure_of(stacked)),
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
        ce90_px=left_ce90(points.second_px, fit.left_px) * size,
    )


def _to_frame(frame: Frame, grid: Grid) -> Float64:
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
        left = fit.left_px[known]
        size_m = _pixel_m(frame.infos[pair.second].grid)
        rmse = float(np.sqrt((left**2).sum(axis=1).mean())) if len(left) else float("nan")
        mean = np.median(left, axis=0) if len(left) else np.full(2, np.nan)
        found.append(
            Misfit(
                "control points" if control else "reference",
                frame.names[max(number for number in ends if number < len(frame.names))],
                int(known.sum()),
                (float(mean[0]), float(mean[1])),
                rmse,
                rmse * size_m,
                tuple((float(col), float(row)) for col, row in fit.left_px) if control else None,
            )
        )
    return found


def _off(pair: BlockPair, fit: BlockFit) -> Bool:
    """Return the (n,) mask of the control points that contradict all others."""
    off = np.hypot(*fit.left_px.T) / np.sqrt(np.trace(pair.covariance_px2, axis1=1, axis2=2) / 2)
    return np.asarray(off > CONTROL_OFF * max(1.0, float(np.nanmedian(off))))


def control_warnings(placed: PlacedImages, pairs: Sequence[BlockPair], found: BlockAdjustment) -> list[str]:
    """Name the control points that contradict the others."""
    warnings = []
    for pair, fit in zip(pairs, found.edges, strict=True):
        if pair.height_m is None:
            continue
        for index in np.flatnonzero(_off(pair, fit)).tolist():
            (col, row), length = pair.second_px[index], float(np.hypot(*fit.left_px[index]))
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
            warp_image(placed.frame, image, still, wanted, quiet)
            continue
        how = BandOutput(grid, settings.resampling, fmt, folder / image.registered.name)
        _write_image(folder, image, image.rpc, how, quiet)
    on_event(Progress("images", len(found.images), len(found.images)))


def _write_image(
    folder: Path, image: StackImage, rpc: ImageRpc, how: BandOutput, on_event: EventCallback
) -> None:
    grid = rpc.registration.corrected_grid
    orthorectify_band(image.path, image.registered, grid, how, on_event)
    staged = image.registered.parent
    write_rpc_vrt(staged / rpc.vrt, image.path, to_gdal(grid.rpc), final_path=folder / rpc.vrt)
    write_rpc_text(grid.rpc, staged / rpc.text)


def warp_image(
    frame: Frame, image: StackImage, correction: Correction, wanted: WarpOutput, on_event: EventCallback
) -> None:
    """Resample an image with a geotransform by a correction."""
    info = frame.infos[frame.names.index(image.name)]
    done = FinishedRegistration(
        correction,
        wanted.reference_grid,
        info.grid,
        wanted.request,
        wanted.format,
        wanted.resampling,
        inputs=tuple(identify(info.uri)),
    )
    apply(done, [info.uri], [image.registered], wanted, False, True, on_event)


def rpc_names(images: Sequence[str]) -> list[str]:
    """Return the names of the files of corrected RPCs that images of these names would have."""
    return [NAMES[kind].format(stem=name) for name in images for kind in RPC_FILES]
