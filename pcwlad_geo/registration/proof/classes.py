"""The errors by classes of moves, phases, texture and windows, and beside the sigmas of the points."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.proof_result import ClassEntry, Move, PhaseEntry, PointEntry, SigmaEntry
from pcwlad_geo.matching.field import global_affine
from pcwlad_geo.matching.types import to_index
from pcwlad_geo.registration.proof.errors import PointErrors, finite_mean, scatter
from pcwlad_geo.registration.proof.rematching import MatchedAgain
from pcwlad_geo.registration.proof.sites import ProofSetup
from pcwlad_geo.registration.result import Matches
from pcwlad_geo.types import Float64


def error_map(error: Float64, setup: ProofSetup, matches: Matches) -> tuple[PointEntry, ...]:
    """Return the errors of each point that was matched after a move, from the (k, n, 2) `error`."""
    places = matches.tie_points.reference_px[setup.rows].tolist()
    entries = []
    for number, (row, (col_px, row_px)) in enumerate(zip(setup.rows.tolist(), places, strict=True)):
        errors = [float_pair(pair) for pair in error[:, number] if np.isfinite(pair).all()]
        entries += [PointEntry(row, (col_px, row_px), tuple(errors))] if errors else []
    return tuple(entries)


def scatter_ratio_of(matches: Matches, setup: ProofSetup, centred: Float64) -> float:
    """Return the scatter of the tie points over that of their errors, both about an affine.

    The (k, n, 2) errors are `centred`. The scatter of the tie points contains them, and displacements that
    are not affine. An affine also follows some of the errors, as windows are wide.
    """
    table, by = matches.tie_points.select("matched"), setup.parameters
    squares = []
    for errors in centred:
        finite = np.isfinite(errors).all(axis=1)
        if np.count_nonzero(finite) >= by.least_points:
            std_px = _std_about_affine(setup.reference_px[finite], errors[finite], by.false_match_px)
            squares.append(std_px**2)
    if not squares:
        return 1.0
    std_px = _std_about_affine(table.predicted_px, table.displacement_px, by.false_match_px)
    return std_px / float(np.sqrt(np.mean(squares)))


def _std_about_affine(places_px: Float64, values_px: Float64, most_px: float) -> float:
    """Return the standard deviation of (n, 2) values about an affine of the places, both axes together.

    Values farther from it than `most_px` are left out.
    """
    linear, _ = global_affine(places_px, values_px)
    residual_px = values_px - (places_px - places_px.mean(axis=0)) @ linear.T
    residual_px -= np.median(residual_px, axis=0)
    return float(np.linalg.norm(residual_px[np.linalg.norm(residual_px, axis=1) < most_px].std(axis=0)))


def errors_by_phase(shifts: PointErrors, wave: Float64, phases: int) -> tuple[PhaseEntry, ...]:
    """Return the mean errors by the fraction of a pixel, of so many `phases`, about the mean of all.

    The (k, n, 2) `wave` is that of `locking`.
    """
    level = finite_mean(shifts.error_px - wave, (0, 1))
    entries = []
    for number in range(phases):
        inside = np.isfinite(shifts.error_px) & (np.floor(shifts.phase * phases) == number)
        mean = finite_mean(np.where(inside, shifts.error_px, np.nan), (0, 1)) - level
        counts = inside.sum(axis=(0, 1)).tolist()
        entries.append(PhaseEntry((number + 0.5) / phases, (counts[0], counts[1]), float_pair(mean)))
    return tuple(entries)


def class_entry(name: str, errors: PointErrors, centre: Float64 | None = None) -> ClassEntry:
    """Return the errors of a class, their scatter about the points' own means or an (n, 2) `centre`."""
    centred = errors.centred if centre is None else errors.error_px - centre
    points = int(np.isfinite(centred).all(axis=2).sum())
    return ClassEntry(
        name, points, float_pair(finite_mean(errors.error_px, (0, 1))), float_pair(scatter(centred))
    )


def errors_by_kind(errors: PointErrors, moves: Sequence[Move]) -> tuple[ClassEntry, ...]:
    """Return the errors after each kind of move, of the turned and bent ones about the shifts' means."""
    kinds = np.array([move.kind for move in moves])
    shifts = errors.part(kinds == "shift")
    centre = finite_mean(shifts.error_px, 0)
    distortions = (class_entry(kind, errors.part(kinds == kind), centre) for kind in ("turn", "field"))
    return class_entry("shift", shifts), *distortions


def errors_by_texture(setup: ProofSetup, before: MatchedAgain, errors: PointErrors) -> tuple[ClassEntry, ...]:
    """Return the errors by the structure within the window of each point."""
    structure = np.full(len(setup.rows), np.nan)
    for channels, points, _, which in before.of_site:
        energy = (channels.reference.maps**2).sum(axis=0) * channels.reference.valid
        side = setup.scales.window_px
        row, col = to_index(points).T
        structure[which] = cv2.blur(energy, (side, side), borderType=cv2.BORDER_CONSTANT)[row, col]
    finite, textures = np.isfinite(structure), setup.parameters.textures
    limits = np.quantile(structure[finite], np.arange(1, textures) / textures)
    level = np.where(finite, np.searchsorted(limits, structure), -1)
    names = ("faintest quarter", "second quarter", "third quarter", "strongest quarter")
    parts = [errors.part(level == number, of_points=True) for number in range(textures)]
    return tuple(class_entry(name, part) for name, part in zip(names, parts, strict=True))


def sigma_entry(error: Float64, sigma_px: Float64, scatter_ratio: float = 1.0) -> SigmaEntry:
    """Compare errors, the (k, n, 2) `error`, with the sigmas of their points, the (n, 2) `sigma_px`.

    The tie points scatter `scatter_ratio` times as much as the errors do.
    """
    ratio = np.abs(error) / sigma_px
    ratio = ratio[np.isfinite(ratio)]
    one, two = np.percentile(ratio, (68.27, 95.0)) / (1.0, 1.96)  # of normal errors
    factor = float(np.sqrt(one * two))
    calibration = max(factor, min(1.0, factor * max(scatter_ratio, 1.0)))
    return SigmaEntry(float((ratio <= 1).mean()), float((ratio <= 1.96).mean()), factor, calibration)
