"""Displacements beside the one found: of ground that repeats, and of ground that the search did not reach."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pcwlad_geo.matching import search_shift
from pcwlad_geo.matching.repeats import Rival, rivals_of
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.quality import FAIR_PX, Doubt
from pcwlad_geo.registration.starts.alignment import StartingAlignment
from pcwlad_geo.registration.starts.parameters import START
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class RivalParameters:
    """Numbers of the search for other displacements."""

    most_named: int = 4
    """Largest number of displacements that a message names."""
    least_radius_px: int = 4
    """Least search radius around a rival, matching-grid px."""
    least_share: float = 0.05
    """Least share of the ground, in one part, without tie points that is searched for elsewhere."""
    least_candidates: int = 3
    """Least number of candidates in a square of half a window that is said to be without tie points."""
    least_distance_px: float = 1.5
    """Least distance of the displacement of such ground, unless it lies at the border of the search, px of
    the overview: a search errs by 1."""
    largest_radius_px: int = 48
    """Largest search radius with which two displacements are matched together, matching-grid px."""


@dataclass(frozen=True, slots=True)
class Unreached:
    """Connected ground with structure that lies elsewhere than the tie points say."""

    shift_px: Float64
    """(2,) (col, row) target view px minus reference view px."""
    distance_px: float
    """From the displacement of the tie points."""
    share: float
    """Of the ground with structure."""


def may_move(settings: Settings) -> bool:
    """Return whether any displacement may be taken, as the user has set no bound."""
    unbounded = settings.prealign == "auto" and settings.search_radius is None
    return unbounded or settings.prealign == "search"


def rivals_in(start: StartingAlignment, displacement_px: Float64) -> list[Rival]:
    """Return the rivals, px of the views, of the (2,) `displacement_px` (col, row) from a start."""
    images, unit_px = start.overviews, start.overviews.factor
    reference, target = (
        (image.values.astype(np.float32), image.valid) for image in (images.reference, images.target)
    )
    rivals = rivals_of(reference, target, displacement_px / unit_px)
    return [replace(rival, shift_xy=rival.shift_xy * unit_px) for rival in rivals]


def unreached_in(
    start: StartingAlignment,
    displacement_px: Float64,
    lost_px: Float64,
    points_px: Float64,
    window_px: int,
    parameters: RivalParameters = RivalParameters(),
) -> Unreached | None:
    """Return the largest part without tie points, the search for which finds it elsewhere; None if none is.

    The (2,) `displacement_px` (col, row) is that of the tie points; the (n, 2) `lost_px` and (m, 2)
    `points_px` are the candidates without and with a tie point, px of the reference view.
    """
    first, second, factor = start.overviews.reference, start.overviews.target, start.overviews.factor
    cell_px = max(1.0, window_px / 2 / factor)
    edges = [np.arange(math.ceil(side / cell_px) + 1) * cell_px * factor for side in first.valid.shape]
    lost, points = (np.histogramdd(at_px[:, ::-1], bins=edges)[0] for at_px in (lost_px, points_px))
    empty = (points == 0) & (lost >= parameters.least_candidates)
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(empty.astype(np.uint8), connectivity=4)
    largest = 1 + int(sizes[1:, cv2.CC_STAT_AREA].argmax()) if empty.any() else 0
    share = float(sizes[largest, cv2.CC_STAT_AREA] / max(np.count_nonzero(empty | (points > 0)), 1))
    if largest == 0 or share < parameters.least_share:
        return None
    row, col = (np.arange(side) / cell_px for side in first.valid.shape)
    inside = first.valid & (labels == largest)[np.ix_(row.astype(int), col.astype(int))]
    search = search_shift(first.values, second.values, inside, second.valid)
    shift_px = np.asarray(search.shift_xy) * factor
    distance_px = float(np.hypot(*(shift_px - displacement_px)))
    error_px = parameters.least_distance_px * factor
    beyond_px = np.abs(shift_px - start.pair.offset_px - start.prealignment.shift_px).max()
    is_elsewhere = distance_px >= error_px or beyond_px + error_px > start.prealignment.search_radius_px
    return Unreached(shift_px, distance_px, share) if search.accepted and is_elsewhere else None


def start_at(
    start: StartingAlignment,
    shift_px: Float64,
    distance_px: float,
    *,
    separately: bool,
    parameters: RivalParameters = RivalParameters(),
) -> StartingAlignment | None:
    """Return a start around the (2,) `shift_px` (col, row), target view px minus reference view px.

    What lies at half the distance on either side is beyond its search, if it is to be matched `separately`,
    or within; None where that search would be too large.
    """
    before, by = start.prealignment, parameters
    error_px = START.radius_after_search_px + math.ceil(START.search_error_px * (start.overviews.factor - 1))
    bound_px = max(by.least_radius_px, int(distance_px / 2))
    radius_px = min(error_px, bound_px) if separately else error_px + bound_px
    if not separately and radius_px > by.largest_radius_px:
        return None
    col, row = (shift_px - start.pair.offset_px).tolist()
    method = "search" if before.pose is None else before.method
    shifted = replace(before, method=method, shift_px=(col, row), search_radius_px=radius_px, searched=True)
    return replace(start, prealignment=shifted)


def doubt_of_rivals(
    start: StartingAlignment,
    displacement_px: Float64,
    rivals: Sequence[Rival],
    parameters: RivalParameters = RivalParameters(),
) -> Doubt:
    """Return why the (2,) `displacement_px` (col, row) with rivals, at least one, is no good one."""
    places = ", ".join(
        "({:+.0f}, {:+.0f})".format(*(rival.shift_xy - start.pair.offset_px))
        for rival in rivals[: parameters.most_named]
    )
    more = f" and {len(rivals) - parameters.most_named} more" if len(rivals) > parameters.most_named else ""
    if rivals[0].is_better:
        return Doubt(
            "poor",
            f"the ground repeats, and the whole scene fits better at {places}{more} px (col, row) from the "
            "georeferencing: the tie points are probably one or more periods off; give --prealign search, "
            "or a better geotransform",
            float(np.hypot(*(rivals[0].shift_xy - displacement_px))),
        )
    return Doubt(
        "fair",
        f"the ground repeats, and the whole scene fits about as well at {places}{more} px (col, row) from "
        "the "
        "georeferencing: the tie points may be one or more periods off; check a place that does not repeat",
    )


def doubt_of_unreached(start: StartingAlignment, ground: Unreached) -> Doubt:
    """Return why tie points that leave out some ground make no good registration."""
    off_px = ground.distance_px if ground.share > 0.1 else 0.0
    col, row = ground.shift_px - start.pair.offset_px
    return Doubt(
        "poor" if off_px > FAIR_PX else "fair",
        f"{100 * ground.share:.0f} % of the ground with structure, in one part, has no tie points and lies "
        f"at about ({col:+.0f}, {row:+.0f}) px (col, row) from the georeferencing, {ground.distance_px:.0f} "
        "px from the rest: a seam of a mosaic, what has moved, or clouds; there the correction does not "
        "hold. Where it is ground, raise --search-radius",
        off_px,
    )
