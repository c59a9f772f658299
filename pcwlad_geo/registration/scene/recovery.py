"""Candidates without a match that the second pass tries once more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcwlad_geo.matching import FieldGuide, MatchSettings, TiePoints
from pcwlad_geo.matching.guidance import GUIDANCE, Predictor
from pcwlad_geo.matching.lost_candidates import Lost, can_try_again, expect_lost
from pcwlad_geo.matching.outliers import confirmed
from pcwlad_geo.registration.scene.first_pass import FirstPass
from pcwlad_geo.types import Bool, Index


@dataclass(frozen=True, slots=True, eq=False)
class Retry:
    """Candidates that the second pass tries once more: those without a match, and inconsistent matches."""

    candidates: Lost
    tile_of: Index
    """(n,) their tiles."""
    match_of: Index
    """(n,) see `SecondPass`."""
    lost_of: Index
    """(n,) likewise."""


def retry_candidates(
    first: FirstPass,
    matches: TiePoints,
    consistent: Bool,
    guide: FieldGuide,
    matching: MatchSettings,
    predictor: Predictor,
) -> Retry | None:
    """Return what is matched once more; None if the neighbours cannot predict where it lies.

    The (n,) mask `consistent` is of the matches of the first pass.
    """
    if np.count_nonzero(consistent) < GUIDANCE.least_points or not can_try_again(matching):
        return None
    candidates, off = first.lost, np.flatnonzero(~consistent)
    places = np.concatenate([candidates.reference_xy_px, matches.reference_xy_px[off]])
    expected = expect_lost(places, matches[consistent], guide, matching, predictor)
    predicted = expected.guide.structure_xy_px[len(candidates) :]
    moving = confirmed(
        matches.reference_xy_px, matches.displacement_px, off, predicted, matching.window.side_px
    )
    selection = np.concatenate([np.ones(len(candidates), bool), ~moving])
    return Retry(
        expected.part(np.flatnonzero(selection)),
        np.concatenate([first.lost_tile_of, first.tile_of[off]])[selection],
        np.concatenate([np.full(len(candidates), -1), off])[selection],
        np.concatenate([np.arange(len(candidates)), np.full(len(off), -1)])[selection],
    )
