"""The stages in order: maps, corners, coarse match, refinement, consistency, field, consensus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import keypoints
from pcwlad_geo.matching.candidates import FATES, Candidates
from pcwlad_geo.matching.guidance import (
    FieldGuide,
    calibrate,
    guide_by_field,
    one_way_is_enough,
)
from pcwlad_geo.matching.noise import measure_noise
from pcwlad_geo.matching.outliers import consistent
from pcwlad_geo.matching.phase_congruency import scene_epsilon
from pcwlad_geo.matching.prepare import Image, PreparedPair, StackPair, prepare
from pcwlad_geo.matching.refinement import Refined, Start, refine
from pcwlad_geo.matching.settings import TRAITS, MatchSettings, MethodTraits
from pcwlad_geo.matching.similarity import match_coarsely
from pcwlad_geo.matching.structure_filter import passes_paper, shared_structure
from pcwlad_geo.matching.tie_points import TiePoints

Float64 = NDArray[np.float64]
Index = NDArray[np.intp]
Bool = NDArray[np.bool_]

DISAGREEMENT_PX: Final = 0.5
"""Largest difference between the forward and the backward match."""
COARSE_SIGMA_PX: Final = 0.35
SAMPLED: Final = 5
"""One of so many points is of the sample that is matched back, from target to reference (they are ordered by
cell and rank: a divisor of a cell's points would sample one rank only);"""
LEAST_TO_SAMPLE: Final = 16
"""all are where they are fewer, unless a sample was asked for."""

Back = Literal["never", "sample", "as needed", "always"]


@dataclass(frozen=True, slots=True)
class Core:
    """The part of a window whose corners are wanted; the rest is halo. Row, column, stops in array index."""

    row: int
    col: int
    row_stop: int
    col_stop: int
    origin_rc: tuple[int, int]
    """Window's first pixel minus the first of all cores: there the cells begin, whatever the tiles."""


def match_arrays(
    reference: NDArray[Any],
    target: NDArray[Any],
    *,
    reference_valid: Bool | None = None,
    target_valid: Bool | None = None,
    settings: MatchSettings | None = None,
) -> TiePoints:
    """Match two images of the same ground on the same grid.

    Parameters
    ----------
    reference, target : (rows, cols) arrays
        Any real dtype; shapes may differ, the top-left pixels coincide up to the search radius.
    reference_valid, target_valid : (rows, cols) bool arrays, optional
        Pixels that count; non-finite values never do.
    settings : MatchSettings, optional

    Returns
    -------
    TiePoints
        Consistent matches, pixel coordinates (col, row), corner-based.

    Raises
    ------
    InputError
        If an image is not a real two-dimensional array, is constant, or is smaller than a window.
    """
    settings = settings or MatchSettings()
    ref, tgt = _image(reference, reference_valid, "reference"), _image(target, target_valid, "target")
    rows = max(ref.values.shape[0], tgt.values.shape[0])
    cols = max(ref.values.shape[1], tgt.values.shape[1])
    common = np.minimum(ref.values.shape, tgt.values.shape)
    if common.min() < settings.template:
        raise InputError(
            f"the images share {common[0]} x {common[1]} px: less than the matching window of "
            f"{settings.template} px; use larger images or a smaller template and window"
        )
    margin = margin_px(settings)
    pair = prepare(
        _on_canvas(ref, rows, cols, margin),
        _on_canvas(tgt, rows, cols, margin),
        channels=_traits(settings).channels,
    )
    core = Core(margin, margin, margin + rows, margin + cols, (-margin, -margin))
    first, _ = match_candidates(pair, core, settings)
    kept = first[consistent_points(first, settings)]
    final = second_pass(pair.stacks, kept, settings)
    return final.shifted(np.array([-margin, -margin]), np.array([-margin, -margin]))


def to_index(points: TiePoints) -> Index:
    """Return row, column array indices of the reference points: the pixel whose centre they are."""
    return np.floor(points.reference_xy_px[:, ::-1]).astype(np.intp)


def margin_px(settings: MatchSettings) -> int:
    """Return how far beyond a corner the windows reach, search included."""
    return max(settings.template, settings.window) // 2 + settings.search_radius + 16


def match_candidates(pair: PreparedPair, core: Core, settings: MatchSettings) -> tuple[TiePoints, Candidates]:
    """First pass: every candidate on its own.

    Parameters
    ----------
    pair : PreparedPair
    core : Core
        Where corners are taken.
    settings : MatchSettings

    Returns
    -------
    points : TiePoints
        In pixel coordinates of the two arrays; not yet checked against one another, covariances formal.
    candidates : Candidates
        All corners looked for, and the stage that lost each.
    """
    traits = _traits(settings)
    corners = _corners(pair, core, settings)
    coarse = match_coarsely(
        pair.reference_map,
        pair.target_map,
        corners,
        settings.template,
        settings.search_radius,
        settings.least_valid,
    )
    compared = coarse.ssim > -1.0
    similar = compared & (coarse.ssim >= settings.ssim_min)
    inside = similar & ~coarse.at_border
    fate = np.select(
        [~compared, ~similar, coarse.at_border],
        [FATES.index(name) for name in ("not_comparable", "not_similar", "at_search_border")],
    ).astype(np.uint8)
    # the paper begins at the whole pixel; nearer to the place fewer steps are needed
    whole = coarse.offset_rc[:, ::-1].astype(np.float64)
    shift = coarse.shift_xy_px if traits.structure == "local" else whole
    index, score = np.flatnonzero(inside), coarse.distinctness
    if not traits.refined:
        covariance = np.tile(COARSE_SIGMA_PX**2 * np.eye(2), (len(index), 1, 1))
        way_back = np.full(len(index), np.nan)
        points = _points(corners[index], shift[index], covariance, score[index], way_back)
        return points, Candidates(_centres(corners), fate)

    def match(some: Index) -> tuple[TiePoints, Bool]:
        start = Start(shift[some], np.zeros((len(some), 2, 2)))
        refined, agree, way_back = _refine_both(
            pair.stacks, corners[some], start, settings, settings.backward
        )
        fate[some] = np.select(
            [~refined.converged, ~agree],
            [FATES.index(name) for name in ("not_converged", "directions_disagree")],
        )
        points = _points(corners[some], refined.shift_xy_px, refined.covariance_px2, score[some], way_back)
        found = refined.converged & agree
        return points[found], found

    if settings.spare == 0 or settings.features_area_px2 is None:
        return match(index)[0], Candidates(_centres(corners), fate)
    cell_px = keypoints.cell_side_px(settings.features, settings.per_cell, settings.features_area_px2)
    order, rank = keypoints.rank_in_cell(corners[index], score[index], cell_px, core.origin_rc)
    points, unneeded = _match_in_turns(match, index[order], rank, settings.per_cell - settings.spare)
    tried = np.delete(np.arange(len(corners)), unneeded)
    return points, Candidates(_centres(corners[tried]), fate[tried])


def _match_in_turns(
    match: Callable[[Index], tuple[TiePoints, Bool]], candidates: Index, rank: Index, wanted: int
) -> tuple[TiePoints, Index]:
    """Match the best candidates of every cell, then one more for each of these that fails, if there is one.

    Parameters
    ----------
    match : callable
        Matches some candidates; returns the points found, and for which candidates.
    candidates, rank : (n,) intp arrays
        By cell, the best of each first, and the rank in the cell.
    wanted : int
        Matches of a cell.

    Returns
    -------
    points : TiePoints
    unneeded : (m,) intp array
        Candidates that were not tried.
    """
    first, cell = rank < wanted, np.cumsum(rank == 0) - 1
    points, found = match(candidates[first])
    missing = wanted - np.bincount(cell[first], found)
    second = ~first & (rank - wanted < missing[cell])
    more, _ = match(candidates[second])
    return TiePoints.concatenate([points, more]), candidates[~first & ~second]


def rematch(pair: StackPair, points: TiePoints, guide: FieldGuide, settings: MatchSettings) -> TiePoints:
    """Second pass: points again, with the deformation and the structure that the field gives.

    Parameters
    ----------
    pair : StackPair
    points : TiePoints
        In pixel coordinates of the arrays.
    guide : FieldGuide
        Of these points.
    settings : MatchSettings

    Returns
    -------
    TiePoints
        As many, covariances formal; a point that fails here keeps its first position.
    """
    target, covariance = points.target_xy_px.copy(), points.covariance_px2.copy()
    again, led = matched_again(guide, settings), guide.leads
    # the two directions differ where each follows its own structure, hardly where the field says which
    own: Back = "never" if guide.one_way else "always"
    given: Back = "sample" if settings.backward == "sample" and not guide.one_way else own
    for some, structure, back in ((again & ~led, None, own), (again & led, guide.structure_xy_px, given)):
        index = np.flatnonzero(some)
        start = Start(
            target[index] - points.reference_xy_px[index],
            guide.linear[index],
            None if structure is None else structure[index],
            is_match=structure is not None,
        )
        refined, agree, _ = _refine_both(pair, to_index(points[index]), start, settings, back)
        good = refined.converged & agree
        target[index[good]] = points.reference_xy_px[index[good]] + refined.shift_xy_px[good]
        covariance[index[good]] = refined.covariance_px2[good]
    return replace(points, target_xy_px=target, covariance_px2=covariance)


def matched_again(guide: FieldGuide, settings: MatchSettings) -> Bool:
    """Tell which points the second pass matches again, (n,); for the others the guide says nothing new."""
    traits = _traits(settings)
    if not (traits.refined and traits.structure == "local"):
        return np.zeros_like(guide.leads)
    return guide.leads | (guide.deforms or (settings.backward == "sample" and not guide.one_way))


def second_pass(pair: StackPair, points: TiePoints, settings: MatchSettings) -> TiePoints:
    """Guide, rematch, check and calibrate the points of one prepared pair."""
    guide = guide_by_field(points, settings)
    again = rematch(pair, points, guide, settings)
    good = again[consistent_points(again, settings)]
    return calibrate(good, guide.surface, guide.shared_variance_px2, settings)


def consistent_points(points: TiePoints, settings: MatchSettings) -> Bool:
    """Tell which points agree with their neighbours, see `outliers.consistent`."""
    sigma = np.sqrt(np.trace(points.covariance_px2, axis1=1, axis2=2))
    return consistent(points.reference_xy_px, points.displacement_px, sigma, settings.window)


def _refine_both(
    pair: StackPair, corners: Index, start: Start, settings: MatchSettings, back: Back
) -> tuple[Refined, Bool, Float64]:
    """Refine forward and, where the method asks for it, backward.

    Returns
    -------
    refined : Refined
        The mean of both directions where there are two.
    agree : (n,) bool array
        Whether the two agree.
    way_back_px : (n,) array
        By how much they differ; infinite where only one was found, NaN where only one was looked for.
    """
    forward = _refine_one_way(pair, corners, start, settings)
    way_back = np.full(len(corners), np.nan)
    if not _traits(settings).backward:
        ok = np.ones(len(corners), bool)
        if settings.method == "pcwlad":
            ok = passes_paper(pair, corners, start, forward, settings.window, settings.ssim_min)
        return forward, ok, way_back
    mean, covariance = forward.shift_xy_px.copy(), forward.covariance_px2.copy()

    def walk_back(some: Index) -> None:
        there, moved = forward.shift_xy_px[some], forward.linear[some]
        structure = None if start.structure_xy_px is None else start.structure_xy_px[some]
        returned, backward = _refine_back(pair, corners[some], there, moved, structure, settings)
        mean[some] = (there + returned) / 2
        covariance[some] = (covariance[some] + backward.covariance_px2) / 2
        way_back[some] = np.where(backward.converged, np.linalg.norm(there - returned, axis=1), np.inf)

    # what did not converge on its way there needs no way back
    arrived = np.flatnonzero(forward.converged)
    all_of_them = back == "always" or (back == "as needed" and len(arrived) < LEAST_TO_SAMPLE)
    if back != "never":
        walk_back(arrived[:: 1 if all_of_them else SAMPLED])
    if back == "as needed" and not one_way_is_enough(way_back, settings):
        walk_back(arrived[np.isnan(way_back[arrived])])
    converged = forward.converged & ~np.isinf(way_back)
    return Refined(mean, forward.linear, covariance, converged), ~(way_back >= DISAGREEMENT_PX), way_back


def _refine_back(
    pair: StackPair,
    corners: Index,
    shift_xy: Float64,
    linear: Float64,
    structure_xy: Float64 | None,
    settings: MatchSettings,
) -> tuple[Float64, Refined]:
    """Refine from the target back to where the corners came from; the shifts as seen forward, and all."""
    landed = corners + np.round(shift_xy[:, ::-1]).astype(np.intp)
    # the backward window sits on a whole target pixel; the field between it and the true landing place
    # differs by deformation times the remainder
    remainder = (landed - corners)[:, ::-1] - shift_xy
    deformation = np.einsum("nij,nj->ni", linear, remainder)
    start = Start(
        -(shift_xy + deformation),
        np.linalg.inv(np.eye(2) + linear) - np.eye(2),
        None if structure_xy is None else -(structure_xy + deformation),
        is_match=structure_xy is not None,
    )
    backward = _refine_one_way(pair.turned, landed, start, settings)
    return -backward.shift_xy_px - deformation, backward


def _refine_one_way(pair: StackPair, corners: Index, start: Start, settings: MatchSettings) -> Refined:
    traits = _traits(settings)
    if traits.structure == "filter":
        start = replace(start, structure=shared_structure(pair, corners, start, settings.window))
    result = refine(
        pair.reference,
        pair.target,
        corners,
        start,
        window_px=settings.window,
        use_structure=traits.structure == "local",
        robust=traits.robust,
        affine=traits.affine,
        iterations=settings.iterations,
        least_valid=settings.least_valid,
    )
    if traits.structure == "filter":
        # taken once, at the whole-pixel match, the structure would pull the answer towards that pixel
        moved = Start(result.shift_xy_px, result.linear)
        moved = replace(moved, structure=shared_structure(pair, corners, moved, settings.window))
        result = refine(
            pair.reference,
            pair.target,
            corners,
            moved,
            window_px=settings.window,
            affine=traits.affine,
            iterations=settings.iterations,
            least_valid=settings.least_valid,
        )
    return result


def _corners(pair: PreparedPair, core: Core, settings: MatchSettings) -> Index:
    """Return the candidates of the core: row, column array indices."""
    side = max(settings.template, settings.window)
    share = cv2.blur(pair.reference_map.valid, (side, side), borderType=cv2.BORDER_CONSTANT)
    usable = (share >= settings.least_valid) & (pair.reference_map.valid > 0)
    reach = margin_px(settings) - 8
    usable[:reach], usable[-reach:], usable[:, :reach], usable[:, -reach:] = False, False, False, False
    corners, response = keypoints.detect_corners(pair.reference_moment, usable, pair.contrast)
    inside = (corners >= (core.row, core.col)).all(axis=1) & (corners < (core.row_stop, core.col_stop)).all(
        axis=1
    )
    if settings.keypoints == "strongest":
        return keypoints.strongest(corners[inside], response[inside], settings.features)
    area = settings.features_area_px2 or float(
        usable[core.row : core.row_stop, core.col : core.col_stop].sum()
    )
    cell_px = keypoints.cell_side_px(settings.features, settings.per_cell, area)
    chosen = keypoints.by_cell(corners, response, cell_px, core.origin_rc, settings.per_cell)
    # a cell belongs to the core that holds its first pixel, so that neighbouring tiles share no cell
    first = (chosen + np.asarray(core.origin_rc)) // cell_px * cell_px - np.asarray(core.origin_rc)
    owned = (first >= (core.row, core.col)).all(axis=1) & (first < (core.row_stop, core.col_stop)).all(axis=1)
    result: Index = chosen[owned]
    return result


def _points(
    corners: Index, shift_xy: Float64, covariance: Float64, score: Float64, way_back_px: Float64
) -> TiePoints:
    centre = _centres(corners)
    return TiePoints(centre, centre + shift_xy, covariance, score, way_back_px)


def _centres(corners: Index) -> Float64:
    return corners[:, ::-1].astype(np.float64) + 0.5


def _image(values: NDArray[Any], valid: Bool | None, which: str) -> Image:
    array = np.asarray(values)
    if array.ndim != 2 or array.dtype.kind not in "uifb":
        raise InputError(
            f"the {which} is a {array.ndim}-dimensional array of {array.dtype}: "
            "give a two-dimensional real one"
        )
    if valid is not None and np.shape(valid) != array.shape:
        raise InputError(
            f"the mask of the {which} has shape {np.shape(valid)}, the image {array.shape}: "
            "give one of the image's shape"
        )
    good = np.isfinite(array) if valid is None else np.isfinite(array) & valid
    numbers = np.where(good, array, 0).astype(np.float64)
    if not good.any() or np.ptp(numbers[good]) == 0:
        raise InputError(f"the {which} is constant or has no valid pixel: there is nothing to match")
    return Image(numbers, good, scene_epsilon(numbers, good), measure_noise(numbers, good))


def _on_canvas(image: Image, rows: int, cols: int, margin: int) -> Image:
    after = (margin + rows - image.values.shape[0], margin + cols - image.values.shape[1])
    widths = [(margin, after[0]), (margin, after[1])]
    return replace(image, values=np.pad(image.values, widths), valid=np.pad(image.valid, widths))


def _traits(settings: MatchSettings) -> MethodTraits:
    return TRAITS[settings.method]
