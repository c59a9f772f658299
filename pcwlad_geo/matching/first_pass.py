"""The first pass: corners, their coarse matches, and the refinement of each on its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching import keypoints
from pcwlad_geo.matching.both_directions import refine_both
from pcwlad_geo.matching.calibration import CALIBRATION
from pcwlad_geo.matching.coarse import match_coarsely
from pcwlad_geo.matching.gaps import least_share
from pcwlad_geo.matching.keypoints import OUTCOMES, Candidates
from pcwlad_geo.matching.outliers import consistent_points
from pcwlad_geo.matching.prepare import ChannelPair, PreparedPair
from pcwlad_geo.matching.refinement import InitialEstimate, Refined
from pcwlad_geo.matching.rounds import are_hopeless, suffice
from pcwlad_geo.matching.types import TRAITS, MatchSettings, TiePoints
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class Core:
    """The part of a window, in array indices, whose corners are wanted; the rest is halo."""

    row: int
    col: int
    row_stop: int
    col_stop: int
    origin_rc: tuple[int, int]
    """Row, column of the window's first pixel minus that of all cores, where the lattice of cells begins."""

    def holds(self, places_rc: Index) -> Bool:
        """Return the (n,) mask of the (n, 2) `places_rc` (row, col) in the core."""
        low, high = (self.row, self.col), (self.row_stop, self.col_stop)
        return np.asarray(((places_rc >= low) & (places_rc < high)).all(axis=1))


def margin_px(settings: MatchSettings) -> int:
    """Return how far beyond a corner the windows reach, search included, px."""
    return max(settings.template, *settings.window.all_px) // 2 + settings.search_radius + 16


def match_candidates(
    pair: PreparedPair, core: Core, settings: MatchSettings, also: Index | None = None
) -> tuple[TiePoints, Candidates]:
    """Run the first pass: match every candidate independently, of a small image some first.

    Corners are taken in the `core`; the (n, 2) int array `also` holds more candidates (row, col), which need
    be no corners. Return the matches in pixel coordinates of the two arrays, not yet checked against one
    another, covariances formal, and all corners that were searched, with the stage that rejected each.
    """
    if settings.first_features is not None:
        fewer = replace(settings, features=settings.first_features, per_cell=1)
        points, candidates = _match_corners(pair, core, fewer, also)
        is_consistent = consistent_points(points, settings) if len(points) else np.zeros(0, bool)
        if suffice(points, is_consistent, len(candidates)):
            return points, replace(candidates, are_all=False)
        if are_hopeless(int(is_consistent.sum()), len(points)):
            return points, candidates
    return _match_corners(pair, core, settings, also)


def _match_corners(
    pair: PreparedPair, core: Core, settings: MatchSettings, also: Index | None
) -> tuple[TiePoints, Candidates]:
    traits = TRAITS[settings.method]
    corners = np.concatenate([*([] if also is None else [also]), _corners(pair, core, settings)])
    reaches = settings.template, settings.search_radius
    channels = pair.channels
    least = least_share(settings.least_valid, channels.reference.open_share, channels.target.open_share)
    coarse = match_coarsely(pair.reference_map, pair.target_map, corners, *reaches, least, channels.threads)
    compared = coarse.ssim > -1.0
    similar = compared & (coarse.ssim >= settings.ssim_min)
    inside = similar & ~coarse.at_border
    rejected = {"not_comparable": ~compared, "not_similar": ~similar, "at_search_border": coarse.at_border}
    outcome = _outcome(rejected)
    # the paper starts at the whole pixel; a start at the fitted peak needs fewer steps
    whole = coarse.offset_rc[:, ::-1].astype(np.float64)
    shift = coarse.shift_xy_px if traits.structure == "local" else whole
    index, score = np.flatnonzero(inside), coarse.distinctness
    if not traits.refined:
        covariance = np.tile(CALIBRATION.coarse_sigma_px**2 * np.eye(2), (len(index), 1, 1))
        whole_px = Refined(shift[index], np.zeros_like(covariance), covariance, np.ones(len(index), bool))
        points = points_at(corners[index], whole_px, score[index], np.full(len(index), np.nan))
        return points, Candidates(centres(corners), outcome)

    def match(part: Index) -> tuple[TiePoints, Bool]:
        start = InitialEstimate(shift[part], np.zeros((len(part), 2, 2)))
        refined, agree, forward_backward = refine_both(
            pair.channels, corners[part], start, settings, settings.backward
        )
        valid = on_valid_target(pair.channels, corners[part], refined.shift_xy_px)
        failed = {
            "not_converged": ~refined.converged,
            "directions_disagree": ~agree,
            "not_comparable": ~valid,
        }
        outcome[part] = _outcome(failed)
        points = points_at(corners[part], refined, score[part], forward_backward)
        good = refined.converged & agree & valid
        return points[good], good

    if settings.spare == 0 or settings.features_area_px2 is None:
        return match(index)[0], Candidates(centres(corners), outcome)
    cell_px = keypoints.cell_side_px(settings.candidates, settings.per_cell, settings.features_area_px2)
    order, rank = keypoints.rank_in_cell(corners[index], score[index], cell_px, core.origin_rc)
    points, unneeded = _match_in_turns(match, index[order], rank, settings.per_cell - settings.spare)
    candidates = np.delete(np.arange(len(corners)), unneeded)
    return points, Candidates(centres(corners[candidates]), outcome[candidates])


def _outcome(rejected: dict[str, Bool]) -> NDArray[np.uint8]:
    """Return the (n,) index of the first outcome whose mask is true, in their order; 0 if none is."""
    return np.select([*rejected.values()], [*map(OUTCOMES.index, rejected)]).astype(np.uint8)


def _match_in_turns(
    match: Callable[[Index], tuple[TiePoints, Bool]], candidates: Index, rank: Index, count: int
) -> tuple[TiePoints, Index]:
    """Match the best candidates of every cell, then, where there is one, another for each that fails.

    The candidates are sorted by cell, the best of each first, with their rank in it. Returned are the points
    and the candidates that were not tried.
    """
    first, cell = rank < count, np.cumsum(rank == 0) - 1
    points, matched = match(candidates[first])
    missing = count - np.bincount(cell[first], matched)
    second = ~first & (rank - count < missing[cell])
    more, _ = match(candidates[second])
    return TiePoints.concatenate([points, more]), candidates[~first & ~second]


def on_valid_target(pair: ChannelPair, corners: Index, shift_xy_px: Float64) -> Bool:
    """Return whether matches lie on valid pixels of the target: a large window sees across a small cloud.

    The result is an (n,) mask for the (n, 2) `corners` (row, col) and their (n, 2) `shift_xy_px` (col, row).
    """
    valid = pair.target.valid
    place = np.floor(np.nan_to_num(centres(corners) + shift_xy_px)).astype(np.intp)[:, ::-1]
    row, col = np.clip(place, 0, np.array(valid.shape) - 1).T
    return np.asarray(valid[row, col])


def _corners(pair: PreparedPair, core: Core, settings: MatchSettings) -> Index:
    """Return the candidates of the core: row, column array indices."""
    if core.row >= core.row_stop:
        return np.zeros((0, 2), np.intp)
    side = max(settings.template, settings.window.side_px)
    share = cv2.blur(pair.reference_map.valid, (side, side), borderType=cv2.BORDER_CONSTANT)
    least = least_share(settings.least_valid, pair.channels.reference.open_share)
    usable = (share >= least) & (pair.reference_map.valid > 0)
    reach = margin_px(settings) - 8
    usable[:reach], usable[-reach:], usable[:, :reach], usable[:, -reach:] = False, False, False, False
    usable &= pair.contrast >= 0
    corners, response = keypoints.detect_corners(pair.reference_map.values, usable, pair.contrast)
    if settings.keypoints == "strongest":
        inside = core.holds(corners)
        return keypoints.strongest(corners[inside], response[inside], settings.candidates)
    inner = usable[core.row : core.row_stop, core.col : core.col_stop]
    area = settings.features_area_px2 or float(inner.sum())
    cell_px = keypoints.cell_side_px(settings.candidates, settings.per_cell, area)
    by_cell = keypoints.by_cell(corners, response, cell_px, core.origin_rc, settings.per_cell)
    # a cell belongs to the core that holds its first pixel, so that neighbouring tiles share no cell
    first = (by_cell + np.asarray(core.origin_rc)) // cell_px * cell_px - np.asarray(core.origin_rc)
    return by_cell[core.holds(first)]


def points_at(corners: Index, refined: Refined, score: Float64, forward_backward_px: Float64) -> TiePoints:
    """Return the refined tie points of the (n, 2) `corners` (row, col).

    Their (n,) `score` and (n,) `forward_backward_px` are taken as they are, and covariances are formal.
    """
    centre = centres(corners)
    return TiePoints(centre, centre + refined.shift_xy_px, refined.covariance_px2, score, forward_backward_px)


def centres(corners: Index) -> Float64:
    """Return the (n, 2) centres (col, row) of the pixels of the (n, 2) `corners` (row, col)."""
    return corners[:, ::-1].astype(np.float64) + 0.5
