"""Starts from searches over the overviews: for a shift, and for a pose."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import scale_of, square
from pcwlad_geo.matching import search_shift
from pcwlad_geo.matching.pose.grey_search import poses_by_grey_values
from pcwlad_geo.matching.pose.parameters import POSE
from pcwlad_geo.matching.pose.proposal import PoseProposal
from pcwlad_geo.matching.pose.search import search_pose
from pcwlad_geo.matching.shift_search import SearchResult
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import ViewPair
from pcwlad_geo.raster.cameras import expected_scale, guessed_scale
from pcwlad_geo.registration.starts.alignment import Prealignment, StartingAlignment
from pcwlad_geo.registration.starts.overviews import Overviews
from pcwlad_geo.registration.starts.parameters import START, StartParameters
from pcwlad_geo.registration.starts.posing import posed_start


def by_search(
    pair: ViewPair,
    overviews: Overviews,
    search_radius: int | None,
    parameters: StartParameters = START,
) -> tuple[Prealignment | None, SearchResult]:
    """Search the shift on the overviews; the alignment is None if no shift is accepted.

    The radius of the coarse match afterwards, `search_radius`, follows by default from the precision of the
    search.
    """
    result = search_shift(
        overviews.reference.values.astype(np.float64),
        overviews.target.values.astype(np.float64),
        overviews.reference.valid,
        overviews.target.valid,
    )
    if not result.accepted:
        return None, result
    absolute = np.asarray(result.shift_xy) * overviews.factor
    shift = absolute - np.asarray(pair.offset_px)
    uncertainty = parameters.search_error_px * (overviews.factor - 1) + result.spread_px * overviews.factor
    radius = search_radius or parameters.radius_after_search_px + math.ceil(uncertainty)
    return Prealignment("search", (float(shift[0]), float(shift[1])), radius), result


def scales_of_frames(pair: ViewPair) -> tuple[float | None, float | None]:
    """Return the scale of two frames that their cameras' data tell, and otherwise a guess of it.

    Both are target px per reference px; None where there is none, and where the pair is georeferenced.
    """
    if pair.georeferenced:
        return None, None
    infos = pair.reference.info, pair.target.info
    expected, _ = expected_scale(infos[0].camera, infos[1].camera)
    if expected is not None:
        return expected, None
    shapes = infos[0].grid.shape, infos[1].grid.shape
    return None, guessed_scale(infos[0].camera, infos[1].camera, shapes)


class PoseStarts:
    """Starts from poses, which are searched on the overviews, by the grey values when they are asked for.

    The search radius of the settings is that of the coarse match afterwards; None: by the precision of the
    pose. Scales are searched for about the expected one, target px per reference px; None: about 1.
    """

    def __init__(
        self,
        pair: ViewPair,
        overviews: Overviews,
        settings: Settings,
        expected: float | None = None,
        parameters: StartParameters = START,
    ) -> None:
        self._pair, self._settings, self._expected, self._by = pair, settings, expected, parameters
        if expected is None:
            self._factors = [overviews.factor] * 2
            reference, target = overviews.reference, overviews.target
        else:  # each at its own resolution: the two may differ much
            views = pair.reference, pair.target
            self._factors = [max(1.0, max(view.grid.shape) / parameters.overview_side_px) for view in views]
            factors = zip(views, self._factors, strict=True)
            reference, target = (view.reduced(factor) for view, factor in factors)
        by_px = (self._expected or 1.0) * self._factors[0] / self._factors[1]
        self._search = search_pose(
            reference.values,
            target.values,
            reference.valid,
            target.valid,
            scales=(POSE.structure.scales[0] * by_px, POSE.structure.scales[1] * by_px),
            stretched=not pair.georeferenced or pair.by_hand,  # a geotransform that errs is seldom stretched
        )

    def by_structure(self) -> StartingAlignment | None:
        """Return the start in which the structure agrees best; None if none is accepted."""
        return self._start(self._search.proposal)

    def by_grey_values(self) -> Iterator[StartingAlignment]:
        """Yield those that grey values tell: their patches, then all of them together with the structure.

        What patches agreed on is matched by the grey values, too.
        """
        for proposal, matches_tones in zip(poses_by_grey_values(self._search), (True, False), strict=True):
            start = self._start(proposal)
            start = start.by_tones(self._settings) if start is not None and matches_tones else start
            if start is not None:
                yield replace(start, must_stand=True)

    def _start(self, proposal: PoseProposal | None) -> StartingAlignment | None:
        if proposal is None or not proposal.accepted:
            return None
        pair, factors = self._pair, self._factors
        # from array indices of the overviews to corner-based px of the views
        to_views = [np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1 / factor]]) for factor in factors]
        pose = square(proposal.matrix)
        if proposal.homography is not None and pair.in_perspective:
            pose = proposal.homography
        matrix = to_views[1] @ pose @ inverse(to_views[0])
        matrix /= matrix[2, 2]
        if self._expected is None:
            error_px = proposal.spread_px + self._by.pose_error_px
            coarse_px = factors[0] * max(1.0, proposal.scale) * error_px
        else:  # of the coarser of the two
            scale = scale_of(matrix)
            px = factors[0] * min(1.0, scale), factors[1] * min(1.0, 1 / scale)
            coarse_px = px[0] * proposal.spread_px + max(px) * self._by.pose_error_px
        radius = self._settings.search_radius or self._by.radius_after_search_px + math.ceil(coarse_px)
        try:
            start = posed_start(pair, matrix, radius, proposal.evidence)
            return replace(start, prealignment=replace(start.prealignment, expected_scale=self._expected))
        except InputError:  # too little in common to be matched
            return None
