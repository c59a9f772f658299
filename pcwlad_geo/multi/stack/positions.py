"""The position, the precision and the correction of each image, from an adjustment of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.polynomials import PolynomialBasis, PolynomialCorrection
from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.estimation.solving import inverse, least_squares
from pcwlad_geo.multi.stack.adjustment import Adjustment
from pcwlad_geo.multi.stack.bases import Basis, polynomial_over
from pcwlad_geo.multi.stack.closure import closure_of, misfit_sigmas, root_mean_square
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.homographies import FrameAdjustment
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.pairs import MeasuredPair
from pcwlad_geo.multi.stack.parameters import SPLINES
from pcwlad_geo.multi.stack.quality import residual_ce90
from pcwlad_geo.multi.stack.result import Chosen, Stack, StackImage
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import OutputFormat, at_mean_height, pixel_sizes_m
from pcwlad_geo.types import Float64

POSITION_NODES: Final = 15
"""Number of nodes along each axis of an image at which its correction is fitted and its sigma averaged."""
SWATH_ORDER: Final = 3
"""Order of the polynomial that is fitted to the correction of a swath."""


def stack_of(
    frame: StackFrame,
    measured: Sequence[MeasuredPair],
    adjustment: Adjustment,
    folder: Path,
    settings: Settings,
    warnings: list[str],
    unreadable: Mapping[str, str],
    choice: Chosen = "auto",
) -> Stack:
    """Return the results of an adjustment for each pair and each image."""
    fits = iter(adjustment.edges)
    pairs = []
    for measurement in measured:
        edge, pair = measurement.edge, measurement.pair
        if edge is not None:
            ground = adjustment.to_ground(edge.first, edge.first_xy)
            residual_px = edge.second_xy - adjustment.displacement(edge.second, ground) - ground
            fit = next(fits)
            pair = replace(
                with_offset(pair, fit.in_use, fit.offset, warnings),
                points=len(edge),
                sigma_px=fit.sigma,
                redundancy=fit.redundancy,
                scatter_px=fit.scatter,
                ce90_px=residual_ce90(edge.second_xy, residual_px),
            )
        pairs.append(pair)
    pairs_in_use = [pair for pair in pairs if pair.status == "used"]
    names, rasters = [*frame.names, "control points"], raster_paths(frame, folder, settings)
    images = tuple(
        _image(frame, number, adjustment, raster, pairs_in_use) for number, raster in enumerate(rasters)
    )
    return Stack(
        images=images,
        pairs=tuple(pairs),
        shared=adjustment.shared,
        datum="mean" if adjustment.datum is None else names[adjustment.datum],
        out_dir=folder,
        warnings=tuple(warnings),
        adjustment=adjustment,
        unreadable=unreadable,
        reference=names[frame.reference],
        chosen=choice,
        closure=closure_of(pairs),
    )


def with_offset(
    pair: StackPair, in_use: bool, offset_px: tuple[float, float], warnings: list[str]
) -> StackPair:
    """Return a pair with its offset from the adjustment, px of the frame; one left out adds a warning."""
    pair = replace(pair, offset_px=offset_px)
    if in_use:
        return replace(pair, status="used", reason=None)
    reason = f"its points lie {np.hypot(*offset_px):.2f} px off what the other pairs tell"
    warnings.append(f"{pair.reference} – {pair.target}: left out: {reason}")
    return replace(pair, status="left out", reason=reason)


def _image(
    frame: StackFrame,
    number: int,
    adjustment: Adjustment,
    registered: Path,
    pairs_in_use: Sequence[StackPair],
) -> StackImage:
    own_grid = frame.infos[number].grid
    at_px = own_grid.within_scans(own_grid.lattice_px(POSITION_NODES))
    ground = frame.from_image(number, at_px)
    observed_px = frame.to_image(number, ground + adjustment.displacement(number, ground))
    scale = inverse(frame.scale(number, at_px))
    covariance = scale @ adjustment.covariance(number, ground) @ scale.transpose(0, 2, 1)
    correction = (
        adjustment.correction(number)
        if isinstance(adjustment, FrameAdjustment)
        else _correction(at_px, observed_px, adjustment.basis, on_map=own_grid.swath_uri is None)
    )
    frame_px, group = float(abs(np.linalg.det(scale)).mean() ** -0.5), int(adjustment.group[number])
    values = position_values(frame, number, observed_px - at_px, covariance, pairs_in_use, group)
    return StackImage(**values, correction=correction, registered=registered, frame_px=frame_px)


def position_values(
    frame: StackFrame,
    number: int,
    moved_px: Float64,
    covariance: Float64,
    pairs_in_use: Sequence[StackPair],
    group: int,
) -> dict[str, Any]:
    """Return the fields of `PlacedImage` by their names.

    The (n, 2) displacements `moved_px` and their (n, 2, 2) `covariance`, px² of the image, are averaged over
    the image; `pairs_in_use` are all pairs in use.
    """
    info, name = frame.infos[number], frame.names[number]
    sigma_px = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0).clip(0.0))
    sizes_m = pixel_sizes_m(at_mean_height(info.grid), info.grid.middle_px)
    image_pairs = [pair for pair in pairs_in_use if name in (pair.reference, pair.target)]
    return {
        "name": name,
        "path": info.uri,
        "shift_px": float_pair(np.mean(moved_px, axis=0)),
        "sigma_px": float_pair(sigma_px),
        "sigma_m": None if sizes_m is None else float_pair(sigma_px * sizes_m[0]),
        "pairs": len(image_pairs),
        "misfit_sigmas": root_mean_square([misfit_sigmas(pair) for pair in image_pairs]) or 0.0,
        "group": group,
        "given": frame.given(number),
        "pixel_size_m": None if sizes_m is None else float_pair(sizes_m[0]),
    }


def _correction(at_px: Float64, observed_px: Float64, basis: Basis, *, on_map: bool) -> Correction:
    """Return the correction in px of the file, fitted to (n, 2) positions `at_px` and their `observed_px`.

    The pixels of a swath, which is not on a map grid, grow to its sides: what is a shift on the ground bends.
    """
    if not isinstance(basis, PolynomialBasis):
        low, high = at_px.min(axis=0), at_px.max(axis=0)
        spacing = float((high - low).min()) / (2 * SPLINES.cells)  # finer, as the two grids do not coincide
        across, down = np.ceil((high - low) / spacing - 1e-9).astype(int).tolist()
        grid = SplineGrid(float_pair(low), spacing, (across, down))
        fitted = least_squares(grid.design(at_px).toarray(), observed_px - at_px)
        return SplineCorrection("tps", grid, np.asarray(fitted.reshape(*grid.shape, 2)))
    if basis.order == 0 and on_map:
        shift = np.mean(observed_px - at_px, axis=0)
        return AffineCorrection("shift", np.column_stack([np.eye(2), shift]))
    if basis.order == 1 and on_map:
        return AffineCorrection.fit(at_px, observed_px)
    image_basis = polynomial_over([at_px], basis.order if on_map else SWATH_ORDER)
    return PolynomialCorrection(
        f"polynomial{image_basis.order}",
        image_basis,
        least_squares(image_basis.values(at_px), observed_px - at_px),
    )


def raster_paths(frame: StackFrame, folder: Path, settings: Settings) -> list[Path]:
    """Return the paths of the corrected images in a folder."""
    extension = OutputFormat.of(settings.of, settings.co).extension
    return [folder / f"{name}_registered.{extension}" for name in frame.names]
