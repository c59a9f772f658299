"""What is known of an error that all matches share: how matches of two subsets of the evidence differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.proof_result import EvidenceEntry, EvidenceKind, UnobservableError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching import FieldGuide, TiePoints, rematch_with
from pcwlad_geo.matching.prepare import ChannelPair
from pcwlad_geo.matching.refinement import InitialEstimate, refine
from pcwlad_geo.matching.types import to_index
from pcwlad_geo.registration.proof.errors import finite_mean
from pcwlad_geo.registration.proof.rematching import MatchedAgain
from pcwlad_geo.registration.proof.sites import ProofSetup
from pcwlad_geo.types import Float64


def unobservable_error(setup: ProofSetup, before: MatchedAgain, after: MatchedAgain) -> UnobservableError:
    """Compare matches by two subsets of the evidence, of the pair as it lies and with fresh noise."""
    kinds: dict[EvidenceKind, Callable[..., Float64]] = {"windows": _chessboard, "directions": _directions}
    if len(before.of_site[0][0].reference.maps) > 1:
        kinds = {"channels": _channels, **kinds}
    entries = []
    for name, compare in kinds.items():
        first, second = (_differences(compare, setup, match) * setup.unit_px for match in (before, after))
        entries.append(_evidence_entry(name, first, second, setup))
    lengths = [(np.hypot(*entry.mean_px), np.hypot(*entry.error_px)) for entry in entries]
    least = max((length - 2 * error) / 2 for length, error in lengths)
    most = max(max(length, *entry.scatter_px) for (length, _), entry in zip(lengths, entries, strict=True))
    least_px = setup.parameters.least_unobservable_px * float(setup.unit_px.max())
    bound = max(setup.parameters.unobservable_factor * most / 2, least_px)
    return UnobservableError(tuple(entries), float(max(least, 0.0)), float(bound))


def _evidence_entry(name: EvidenceKind, first: Float64, second: Float64, setup: ProofSetup) -> EvidenceEntry:
    finite = np.isfinite(first).all(axis=1)
    noise = np.nanvar(second - first, axis=0)
    windows = len(np.unique(np.floor(setup.reference_px[finite] / setup.scales.window_px), axis=0))
    spread = first[finite].std(axis=0)
    return EvidenceEntry(
        name,
        int(finite.sum()),
        float_pair(finite_mean(first, 0)),
        float_pair(spread / np.sqrt(max(windows, 1))),
        float_pair(np.sqrt(np.maximum(spread**2 - noise, 0.0))),
    )


def _differences(compare: Callable[..., Float64], setup: ProofSetup, rematch: MatchedAgain) -> Float64:
    """Return (n, 2) differences between two matches of the points of all sites, view px."""
    difference_px = np.full((len(setup.rows), 2), np.nan)
    for channels, points, guide, which in rematch.of_site:
        difference_px[which] = compare(setup, channels, points, guide)
    difference_px[np.linalg.norm(difference_px, axis=1) > setup.parameters.false_match_px] = np.nan
    return difference_px


def _channels(setup: ProofSetup, pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    halves = []
    for first in range(2):
        images = [replace(image, maps=image.maps[first::2].copy()) for image in (pair.reference, pair.target)]
        half = ChannelPair(images[0], images[1], pair.threads)
        halves.append(rematch_with(half, points, guide, setup.settings, setup.scales).target_xy_px)
    return np.asarray(halves[0] - halves[1])


def _chessboard(setup: ProofSetup, pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    side = setup.parameters.chessboard_px
    row, col = np.indices((side, side)) // setup.parameters.block_px
    squares = (row + col) % 2
    shifts_px, corners = [], to_index(points)
    for colour in range(2):
        weight = np.tile((squares == colour).astype(np.float32), (len(points), 1, 1))
        start = InitialEstimate(points.displacement_px, guide.linear, structure=weight)
        refined = refine(pair.reference, pair.target, corners, start, window_px=side, threads=pair.threads)
        shifts_px.append(np.where(refined.converged[:, None], refined.shift_xy_px, np.nan))
    return np.asarray(shifts_px[0] - shifts_px[1])


def _directions(setup: ProofSetup, pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    one_way = replace(guide, one_way=True)
    forward_px = rematch_with(pair, points, one_way, setup.settings, setup.scales).displacement_px
    # the window back is centred on a whole pixel of the target
    landed = np.floor(points.target_xy_px) + 0.5
    bend = np.einsum("nij,nj->ni", guide.linear, landed - points.target_xy_px)
    begin = replace(points, reference_xy_px=landed, target_xy_px=landed - points.displacement_px - bend)
    reverse = replace(
        one_way,
        linear=inverse(np.eye(2) + guide.linear) - np.eye(2),
        structure_xy_px=-(guide.structure_xy_px + bend),
    )
    backward_px = rematch_with(pair.turned, begin, reverse, setup.settings, setup.scales).displacement_px
    return np.asarray(forward_px + backward_px + bend)
