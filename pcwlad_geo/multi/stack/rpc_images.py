"""The images of a block over the ground: placed by their RPCs and a DEM, on one grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Warned
from pcwlad_geo.limits import check_grid
from pcwlad_geo.multi.block.block import RpcBlock
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.inputs import StackInput, check_reference
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Dem, Grid, RasterInfo, RpcGrid, RpcPlacement, RpcSource, map_px, read_rpc
from pcwlad_geo.raster.grid import linear_part
from pcwlad_geo.raster.output_grid import OUTPUT_GRIDS
from pcwlad_geo.raster.rpc.ortho import ortho_grid
from pcwlad_geo.raster.rpc.placement import PLACEMENT, place_by_rpc
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.registration.rpc import check_model, ground_crs


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
    unplaced = (info for info in infos if not info.georeferenced)
    return settings.dem is not None or any(_rpc_of(info) is not None for info in unplaced)


def _is_on_map(info: RasterInfo) -> bool:
    """Whether an image has a place by more than control points of radar, which know no heights."""
    return info.georeferenced and info.relief_m is None


def _rpc_of(info: RasterInfo) -> RpcSource | None:
    return None if _is_on_map(info) else read_rpc(info.uri)


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
        names_with_rpc = [
            image_input.name
            for image_input, info in zip(inputs, infos, strict=True)
            if _rpc_of(info) is not None
        ]
        raise InputError(
            f"{', '.join(names_with_rpc)}: images with RPCs lie on the ground by a DEM only: give --dem "
            "(and --dem-vertical)"
        )
    check_model(settings.model)
    names = [image_input.name for image_input in inputs]
    check_reference(reference, names)
    on_map = [
        name
        for name, info in zip(names, infos, strict=True)
        if _is_on_map(info) and info.grid.crs is not None
    ]
    base = reference if reference in on_map else on_map[0] if on_map else None
    images: list[tuple[StackInput, RasterInfo, RpcPlacement | None]] = []
    notes: list[str] = []
    for image_input, info in zip(inputs, infos, strict=True):
        try:
            placement = None if image_input.name == base else _placed(image_input, info, base, settings)
            images.append((image_input, info if placement is None else placement.info, placement))
        except InputError as error:
            unreadable[image_input.path] = str(error)
            notes.append(f"{image_input.name} is left out: {error}")
            continue
        notes += placement.warnings if placement else ()
    if len(images) < 2 or not any(placement for _, _, placement in images):
        raise InputError(
            f"{len(images)} of {len(names)} images can be placed, and with RPCs and a DEM two are "
            f"needed, one of them with an RPC: {'; '.join(dict.fromkeys(unreadable.values())) or 'give more'}"
        )
    for note in notes:
        tell(Warned(note))
    images.sort(key=lambda image: image[2] is not None)  # the reference first
    return _framed(images, reference)


def _placed(image_input: StackInput, info: RasterInfo, base: str | None, settings: Settings) -> RpcPlacement:
    """Place an image by its RPC, with the heights around it in memory."""
    source = _rpc_of(info)
    if source is None:
        why = f"and {base} is the reference" if info.georeferenced else "nor a geotransform"
        raise InputError(f"{image_input.path} has no RPC that counts (tag, .RPB or _RPC.TXT), {why}")
    placement = place_by_rpc(
        info, source, str(settings.dem), settings.dem_vertical, trusted=settings.trust_rpc
    )
    grid = placement.info.grid
    if isinstance(grid, RpcGrid) and isinstance(grid.heights, Dem):
        lon_lat, _ = grid.line_of_sight(grid.lattice_px(PLACEMENT.lattice))
        grid = replace(grid, heights=grid.heights.held(lon_lat))
    return replace(placement, info=replace(placement.info, grid=grid))


def _framed(
    images: Sequence[tuple[StackInput, RasterInfo, RpcPlacement | None]], reference: str | None
) -> PlacedImages:
    """Return the images in the CRS and on the grid of all results."""
    grids = [info.grid for _, info, _ in images]
    on_map = images[0][2] is None
    raw = [grid for grid in grids if isinstance(grid, RpcGrid)]
    crs = grids[0].crs if on_map else ground_crs(raw[0])
    raw = [replace(grid, crs=crs) for grid in raw]
    common = common_grid(grids[0] if on_map else ground_grid(raw[0]), raw)
    placed_at = iter(raw)
    infos, placements = [], []
    for _, info, placement in images:
        grid = info.grid if placement is None else next(placed_at)
        infos.append(replace(info, grid=grid))
        placements.append(None if placement is None else replace(placement, info=infos[-1]))
    names = [image_input.name for image_input, _, _ in images]
    number = 0 if on_map else names.index(reference) if reference else None
    frame = StackFrame(
        names, infos, common, True, tuple(image_input for image_input, _, _ in images), number or 0
    )
    return PlacedImages(frame, tuple(placements), number)


def common_grid(base: Grid, images: Sequence[RpcGrid]) -> Grid:
    """Return the grid of all orthorectified images: the lattice of a map grid, at the finest pixel size.

    Raises `InputError` if an image cannot be placed in its CRS, or the grid has too many pixels.
    """
    ortho_grids = [ortho_grid(base, image) for image in images]
    finest = min(ortho_grids, key=lambda grid: abs(float(np.linalg.det(linear_part(grid.transform)))))
    outlines = np.concatenate([map_px(grid.boundary_px(), grid, finest) for grid in ortho_grids])
    sliver_px = OUTPUT_GRIDS.sliver_px
    low, high = np.floor(outlines.min(axis=0) + sliver_px), np.ceil(outlines.max(axis=0) - sliver_px)
    pixels = sum(grid.shape[0] * grid.shape[1] for grid in images)
    check_grid("the common grid of all images", (high - low).tolist(), pixels)
    cols, rows = (high - low).astype(int).tolist()
    return finest.part((float(low[0]), float(low[1])), (rows, cols))


def without_ground(
    block: PlacedImages, pairs: Sequence[tuple[int, int]], unreadable: dict[str, str], tell: EventCallback
) -> list[int]:
    """Return the numbers of the images that share ground with another; the others are named.

    Raises `InputError` if no two images do.
    """
    frame = block.frame
    overlapping = {image for pair in pairs for image in pair}
    if not overlapping:
        raise InputError(
            f"{', '.join(frame.names)}: no two of the images share ground, where their RPCs put them: give "
            "images of one ground, each with its own RPC"
        )
    for number, name in enumerate(frame.names):
        if number not in overlapping:
            reason = f"{name} shares no ground with any other image, where its RPC puts it"
            unreadable[frame.given(number).path] = reason
            tell(Warned(f"{reason}: it is left out"))
    return sorted(overlapping)


def part_of_images(block: PlacedImages, numbers: Sequence[int]) -> PlacedImages:
    """Return a block of some of its images."""
    frame = block.frame
    datum_image = numbers.index(block.datum_image) if block.datum_image in numbers else None
    part = replace(
        frame,
        names=[frame.names[number] for number in numbers],
        infos=[frame.infos[number] for number in numbers],
        inputs=tuple(frame.inputs[number] for number in numbers),
        reference=datum_image or 0,
    )
    return PlacedImages(part, tuple(block.placements[number] for number in numbers), datum_image)
