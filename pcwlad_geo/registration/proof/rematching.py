"""The points of a proof matched again, as a registration matches: both passes, the same windows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.correction.proof_result import Move
from pcwlad_geo.matching import (
    FieldGuide,
    Image,
    TiePoints,
    guide_by_field,
    match_candidates,
    rematch_with,
)
from pcwlad_geo.matching.first_pass import Core
from pcwlad_geo.matching.outliers import consistent_points
from pcwlad_geo.matching.prepare import ChannelPair, PreparedPair, prepare
from pcwlad_geo.matching.types import TRAITS, to_index
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.registration.proof.sites import ProofSetup, Site
from pcwlad_geo.registration.tiles import origins_of
from pcwlad_geo.types import Float64, Index


@dataclass(frozen=True, slots=True, eq=False)
class MatchedAgain:
    """The points of a setup, matched again as a registration matches: both passes, the windows it chose."""

    target_px: Float64
    """(n, 2) positions of their matches (col, row), target view px; NaN for those that were lost."""
    of_site: tuple[tuple[ChannelPair, TiePoints, FieldGuide, Index], ...]
    """For each site its maps, the points found (px of the arrays), their guide, their rows of `target_px`."""


def match_again(
    setup: ProofSetup, move: Move | None, random: np.random.Generator | None, threads: int = 1
) -> MatchedAgain:
    """Match the points of a setup again.

    The `move` is that of the target (None: as it lies). Noise of the level of each image is drawn by `random`
    and added to it (None: none is).
    """
    settings, pairs, parts, of_part = setup.settings, [], [], []
    for site in setup.sites:
        pair = _prepared(site, setup, move, random, threads)
        origin, target_origin = origins_of(site.job)
        corners = np.floor(setup.reference_px[site.index] - origin)[:, ::-1].astype(np.intp)
        first, _ = match_candidates(pair, Core(0, 0, 0, 0, (0, 0)), settings, corners)
        pairs.append(pair.channels)
        parts.append(first.shifted(origin, target_origin))
        of_part.append(site.index[_rows_of(to_index(first), corners)])
    points, which = TiePoints.concatenate(parts), np.concatenate(of_part)
    consistent = consistent_points(points, settings) if len(points) else np.zeros(0, bool)
    points, which = points[consistent], which[consistent]
    guide = guide_by_field(points, settings)
    target_px, of_site = points.target_xy_px.copy(), []
    for site, channels in zip(setup.sites, pairs, strict=True):
        members = np.flatnonzero(np.isin(which, site.index))
        origin, target_origin = origins_of(site.job)
        local_guide = guide.part(members).moved(origin - target_origin)
        inside = points[members].shifted(-origin, -target_origin)
        refined = rematch_with(channels, inside, local_guide, settings, setup.scales)
        target_px[members] = refined.target_xy_px + target_origin
        of_site.append((channels, refined, local_guide, which[members]))
    if len(points):
        points = replace(points, target_xy_px=target_px)
        consistent = consistent_points(
            points, replace(settings, window=MatchingWindow(setup.scales.window_px))
        )
    of_rows = np.full((len(setup.rows), 2), np.nan)
    of_rows[which[consistent]] = target_px[consistent]
    return MatchedAgain(of_rows, tuple(of_site))


def _prepared(
    site: Site, setup: ProofSetup, move: Move | None, random: np.random.Generator | None, threads: int
) -> PreparedPair:
    """Return the maps of a site, its target moved and both images with fresh noise."""
    job, window = site.job, site.job.read_window
    values, valid = site.resampler.values, site.resampler.valid
    if move is not None:
        corner = np.array([window.col, window.row]) + job.target_offset_px
        values, valid = site.resampler.moved(move, setup.centre_px - corner)
    images = []
    for (image, valid_pixels), level, scene in zip(
        ((site.reference.values, site.reference.valid), (values, valid)),
        setup.noise,
        (job.reference_scene, job.target_scene),
        strict=True,
    ):
        fresh = 0.0 if random is None else level * random.standard_normal(image.shape)
        images.append(Image(image + fresh, valid_pixels, scene.epsilon, scene.noise))
    traits = TRAITS[job.settings.method]
    return prepare(*images, channels=traits.channels, halo_px=traits.halo_px, threads=threads)


def _rows_of(points: Index, corners: Index) -> Index:
    """Return which of the (m, 2) corners each of the (n, 2) points is."""
    place = {(row, col): index for index, (row, col) in enumerate(corners.tolist())}
    return np.array([place[row, col] for row, col in points.tolist()], np.intp)
