"""How many candidates are matched: of a small image some first, and the others only where they are needed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.estimation.surfaces import surface_terms
from pcwlad_geo.matching.types import TRAITS, MatchSettings, TiePoints
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class RoundParameters:
    """How many candidates come first, and when they suffice; see the tuning log."""

    least: int = 140
    """Least number of candidates that are matched first."""
    area_px2: float = 1000.0
    """Area for each of them: with more the correction hardly gets better, as their windows share pixels."""
    most_share: float = 0.7
    """Where they would be more than this share of all, all are matched at once."""
    least_agreeing: int = 60
    """Least number of them that must give points that agree."""
    agreeing_share: float = 0.8
    """Least share of them that must do so."""
    bent_px: float = 0.5
    """Largest distance of 68 % of these from a surface of second order: beyond it the displacement has detail
    that few points are too sparse to tell."""
    strays: int = 3
    """Number of the others from which all are matched, where they agree on another displacement: patches of
    a sixth of the ground, smaller than a window, leave four of 168."""
    stray_px: float = 2.0
    """Least distance of these from their neighbours, and largest from each other."""
    least_matched: int = 12
    """Least number of their matches from which others are in vain where none of these agree."""


ROUNDS: Final = RoundParameters()
"""Those that are used."""


def in_rounds(settings: MatchSettings, area_px2: float) -> MatchSettings:
    """Return the settings with the number of candidates for an area, and of those that are matched first.

    Where their number is given, and where the area is so large that it tells as many, all are matched at
    once.
    """
    is_open = settings.features is None and settings.keypoints == "cells"
    settings = replace(settings, features=settings.candidates)
    if not is_open or TRAITS[settings.method].structure != "local":
        return settings
    first = max(ROUNDS.least, round(area_px2 / ROUNDS.area_px2))
    in_two_rounds = first < ROUNDS.most_share * settings.candidates
    return replace(settings, first_features=first if in_two_rounds else None)


def suffice(points: TiePoints, is_consistent: Bool, candidates: int) -> bool:
    """Return whether the first candidates, of which (n,) `points` were matched, need no others.

    The (n,) mask `is_consistent` has those points that agree with their neighbours.

    They need none where most of them agree, in numbers that tell the window and the model of the correction,
    a smooth surface holds their displacements, and the rest agrees on nothing else. A flexible model follows
    sparse points of ground with relief, and only dense ones tell how far it departs from them.
    """
    agreeing = points[is_consistent]
    if len(agreeing) < max(ROUNDS.least_agreeing, ROUNDS.agreeing_share * candidates):
        return False
    place = agreeing.reference_xy_px - agreeing.reference_xy_px.mean(axis=0)
    design = surface_terms(place / max(float(np.abs(place).max()), 1.0))
    values_px = agreeing.displacement_px
    residual_px = values_px - design @ least_squares(design, values_px)
    is_smooth = float(np.percentile(np.hypot(*residual_px.T), 68)) <= ROUNDS.bent_px
    return is_smooth and not _stray_together(points.offsets_px(is_consistent))


def _stray_together(offset_px: Float64) -> bool:
    """Return whether most points with (k, 2) offsets from their neighbours lie off by the same."""
    offset_px = offset_px[np.hypot(*offset_px.T) > ROUNDS.stray_px]
    if len(offset_px) < ROUNDS.strays:
        return False
    alike = np.hypot(*(offset_px - np.median(offset_px, axis=0)).T) < ROUNDS.stray_px
    return int(alike.sum()) >= max(ROUNDS.strays, len(offset_px) / 2)


def are_hopeless(agreeing: int, matches: int) -> bool:
    """Return whether the first candidates have matches, but none that agree, so that others are in vain.

    They are spread over the whole area: of pairs that the verdict barely accepts, some 20 of them agree.
    """
    return agreeing == 0 and matches >= ROUNDS.least_matched
