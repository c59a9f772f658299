"""The adjustment of the images of a block, and what it says of each pair and each image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcwlad_geo.correction.fit import LOSSLESS
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.multi.block.adjustment import BlockAdjustment, BlockFit, adjust_block
from pcwlad_geo.multi.block.block import BlockPair
from pcwlad_geo.multi.block.dem_check import DemCheck, check_dem
from pcwlad_geo.multi.stack.closure import closure_of
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.pairs import MeasuredPair
from pcwlad_geo.multi.stack.positions import POSITION_NODES, position_values, raster_paths, with_offset
from pcwlad_geo.multi.stack.quality import residual_ce90
from pcwlad_geo.multi.stack.result import BlockNumbers, Chosen, ImageRpc, Misfit, Stack, StackImage
from pcwlad_geo.multi.stack.rpc_images import PlacedImages
from pcwlad_geo.multi.stack.rpc_outputs import rpc_names
from pcwlad_geo.multi.stack.rpc_points import pixel_m
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, at_mean_height, jacobian
from pcwlad_geo.registration.rpc import corrected_rpc
from pcwlad_geo.types import Bool, Float64


def adjust_rpcs(
    images: PlacedImages, pairs: Sequence[BlockPair], settings: Settings
) -> tuple[BlockAdjustment, DemCheck | None]:
    """Adjust a block, and ask the tie points what they say of the DEM.

    A wrong DEM looks like RPCs that drift: with one, a shift of each is all that is told. Raises
    `RegistrationRejectedError` if points held out lie farther apart with the corrections than without.
    """
    block = images.block
    control = any(pair.height_m is not None for pair in pairs)
    absolute = control or images.placements[0] is None
    if control:
        block = replace(block, fixed=frozenset())
    adjustment = adjust_block(block, pairs, ("shift",))
    check = check_dem(block, pairs, adjustment, absolute)
    left_open = settings.model in ("auto", "rpc")
    if settings.model != "shift" and not (left_open and check is not None and check.faults):
        adjustment = adjust_block(
            block, pairs, tuple(LOSSLESS) if left_open else (settings.model,), adjustment
        )
    unused = adjustment.hold_out
    if unused is not None and unused.worse:
        raise RegistrationRejectedError(
            f"tie points held out lie {unused.after_px:.2f} px apart with the corrected RPCs and "
            f"{unused.before_px:.2f} px with those of the files, over the DEM as it is: nothing is written; "
            + "; ".join((check and check.faults) or ["check the DEM and the pairs"])
        )
    return adjustment, check


def block_stack(
    block: PlacedImages,
    measured: Sequence[MeasuredPair],
    pairs: Sequence[BlockPair],
    adjustment: BlockAdjustment,
    check: DemCheck | None,
    folder: Path,
    settings: Settings,
    warnings: list[str],
    unreadable: Mapping[str, str],
    choice: Chosen,
) -> Stack:
    """Return what the adjustment of a block says of each pair and each image."""
    frame = block.frame
    fits = dict(zip((id(pair) for pair in pairs), adjustment.edges, strict=True))
    tied = iter([pair for pair in pairs if pair.height_m is None])
    warnings, stacked = list(warnings), []
    for measurement in measured:
        pair = measurement.pair
        tie_points = None if measurement.edge is None else next(tied)
        stacked.append(
            pair if tie_points is None else _pair(block, pair, tie_points, fits[id(tie_points)], warnings)
        )
    in_use = [pair for pair in stacked if pair.status == "used"]
    rasters = raster_paths(frame, folder, settings)
    images = tuple(_image(block, number, adjustment, raster, in_use) for number, raster in enumerate(rasters))
    control = any(pair.height_m is not None for pair in pairs)
    own_datum = "mean" if block.datum_image is None else frame.names[block.datum_image]
    numbers = BlockNumbers(
        model=adjustment.model,
        scores_px={model: round(score, 4) for model, score in adjustment.scores.items()},
        dem=check,
        misfits=tuple(_misfits(block, pairs, adjustment)),
        hold_out=adjustment.hold_out,
        warnings=((check and check.faults) or ()) + tuple(control_warnings(block, pairs, adjustment)),
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
        chosen=choice,
        closure=closure_of(stacked),
        block=numbers,
    )


def _pair(
    block: PlacedImages, pair: StackPair, points: BlockPair, fit: BlockFit, warnings: list[str]
) -> StackPair:
    """Return a pair with how it agrees with the adjustment, px of the frame."""
    frame = block.frame
    scale = _to_frame(frame, frame.infos[points.second].grid)
    offset, size = scale @ np.array(fit.offset_px), float(np.sqrt(abs(np.linalg.det(scale))))
    return replace(
        with_offset(pair, fit.in_use, (float(offset[0]), float(offset[1])), warnings),
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
    block: PlacedImages,
    number: int,
    adjustment: BlockAdjustment,
    registered: Path,
    pairs_in_use: Sequence[StackPair],
) -> StackImage:
    frame, placement = block.frame, block.placements[number]
    info, correction = frame.infos[number], adjustment.corrections[number]
    at_px = info.grid.lattice_px(POSITION_NODES)
    covariance = adjustment.covariance(number, at_px)
    rpc = None
    if placement is not None:
        corrected = corrected_rpc(placement, correction)
        exact = corrected.original.shifts is None
        vrt, text = rpc_names([frame.names[number]]) if exact else (None, None)
        rpc = ImageRpc(
            corrected.origin, corrected.bias_error_px, vrt, text, corrected.corrected_grid.rpc, corrected
        )
    return StackImage(
        **position_values(frame, number, correction.forward(at_px) - at_px, covariance, pairs_in_use, 0),
        correction=correction,
        registered=registered,
        rpc=rpc,
        frame_px=float(abs(np.linalg.det(_to_frame(frame, info.grid)))) ** 0.5,
    )


def _misfits(block: PlacedImages, pairs: Sequence[BlockPair], adjustment: BlockAdjustment) -> list[Misfit]:
    """Return how the images fit what the block lies on: the reference's tie points and control points."""
    frame, misfits = block.frame, []
    for pair, fit in zip(pairs, adjustment.edges, strict=True):
        control = pair.height_m is not None
        ends = (pair.first, pair.second)
        if not control and (block.placements[0] is not None or 0 not in ends):
            continue
        valid = fit.weight.any(axis=(1, 2)) & ~(_off(pair, fit) if control else False)
        residual_px = fit.residual_px[valid]
        residuals_px = tuple((float(col), float(row)) for col, row in fit.residual_px)
        size_m = pixel_m(frame.infos[pair.second].grid)
        rmse = float(np.sqrt((residual_px**2).sum(axis=1).mean())) if len(residual_px) else float("nan")
        mean = np.median(residual_px, axis=0) if len(residual_px) else np.full(2, np.nan)
        misfits.append(
            Misfit(
                kind="control points" if control else "reference",
                image=frame.names[max(number for number in ends if number < len(frame.names))],
                points=int(valid.sum()),
                median_px=(float(mean[0]), float(mean[1])),
                rmse_px=rmse,
                rmse_m=rmse * size_m,
                residuals_px=residuals_px if control else None,
            )
        )
    return misfits


def _off(pair: BlockPair, fit: BlockFit) -> Bool:
    """Return the (n,) mask of the control points that contradict all others."""
    off = np.hypot(*fit.residual_px.T) / np.sqrt(np.trace(pair.covariance_px2, axis1=1, axis2=2) / 2)
    return np.asarray(off > 5.0 * max(1.0, float(np.nanmedian(off))))


def control_warnings(
    block: PlacedImages, pairs: Sequence[BlockPair], adjustment: BlockAdjustment
) -> list[str]:
    """Name the control points that contradict the others."""
    warnings = []
    for pair, fit in zip(pairs, adjustment.edges, strict=True):
        if pair.height_m is None:
            continue
        for index in np.flatnonzero(_off(pair, fit)).tolist():
            (col, row), length = pair.second_px[index], float(np.hypot(*fit.residual_px[index]))
            name = block.frame.names[pair.second]
            warnings.append(
                f"the control point at ({col:.1f}, {row:.1f}) px (col, row) of {name} lies {length:.1f} "
                "px off where all others put it: check its coordinates"
            )
    return warnings
