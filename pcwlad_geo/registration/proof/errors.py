"""The errors of points whose target is moved by known amounts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pcwlad_geo.correction.proof_result import Move
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.events import JobLog, Progress
from pcwlad_geo.matching.kernels.library import in_threads
from pcwlad_geo.matching.second_pass import displacement_by_windows
from pcwlad_geo.registration.proof.rematching import MatchedAgain, match_again
from pcwlad_geo.registration.proof.sites import ProofSetup
from pcwlad_geo.registration.tiles import origins_of
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True, eq=False)
class PointErrors:
    """Errors of n points after k moves, target px."""

    error_px: Float64
    """(k, n, 2) moved minus unmoved match, minus the known move; NaN for lost and false ones."""
    phase: Float64
    """(k, n, 2) fraction of a pixel, 0 to 1, of the displacement that was matched."""
    false_matches: int
    lost: int
    least_matches: int
    """Least number of matches of a point whose scatter is counted."""

    @property
    def centred(self) -> Float64:
        """(k, n, 2) errors about the mean of each point, scaled to the variance of a single match.

        This removes the error of the unmoved match, which is common to all moves.
        """
        count = np.isfinite(self.error_px).sum(axis=0)
        scale = np.sqrt(count / np.maximum(count - 1, 1))
        return np.where(
            count >= self.least_matches, (self.error_px - finite_mean(self.error_px, 0)) * scale, np.nan
        )

    def shrunk(self, factor: float) -> PointErrors:
        """Return the errors shrunk towards the mean of each point."""
        centre = finite_mean(self.error_px, 0)
        return replace(self, error_px=centre + factor * (self.error_px - centre))

    def part(self, mask: Bool | slice, of_points: bool = False) -> PointErrors:
        """Return the errors of some moves, by the (k,) `mask`, or of some points, by an (n,) one."""
        index = (slice(None), mask) if of_points else mask
        return replace(self, error_px=self.error_px[index], phase=self.phase[index])


def finite_mean(values: Float64, axis: int | tuple[int, ...]) -> Float64:
    """Return the mean of the finite values of the (..., n) `values`; NaN where there are none."""
    return np.asarray(np.ma.masked_invalid(values).mean(axis).filled(np.nan), np.float64)


def measure(
    setup: ProofSetup,
    moves: Sequence[Move],
    windows_px: Sequence[int],
    log: JobLog,
    threads: int,
    total: int,
) -> tuple[PointErrors, tuple[MatchedAgain, MatchedAgain], list[PointErrors]]:
    """Match the points as they lie and after each move, the first of `total` units of progress.

    Returned are the errors with the windows that a registration chooses, the matches of the points as they
    lie and after the first move, and the errors with each of the `windows_px` after the first moves.
    """
    before = match_again(setup, None, None, threads)
    unmoved, positions_px = [before.target_px, *_positions_by_window(setup, before, windows_px)], []
    after, window_moves = before, setup.parameters.window_moves

    def matched(number: int) -> tuple[list[Float64], MatchedAgain | None]:
        rematch = match_again(setup, moves[number], np.random.default_rng([0, number]))
        by_window = _positions_by_window(setup, rematch, windows_px) if number < window_moves else []
        return [rematch.target_px, *by_window], rematch if number == 0 else None

    for begin in range(0, len(moves), threads):
        log.on_event(Progress("proving", begin, total))
        calls = [partial(matched, number) for number in range(len(moves))[begin : begin + threads]]
        for target_px, rematch in in_threads(calls, threads):
            positions_px.append(target_px)
            after = rematch or after
    log.on_event(Progress("proving", len(moves), total))
    of_each = [
        _errors(setup, moves, first, [ends[number] for ends in positions_px if number < len(ends)])
        for number, first in enumerate(unmoved)
    ]
    return of_each[0], (before, after), of_each[1:]


def _positions_by_window(
    setup: ProofSetup, rematch: MatchedAgain, windows_px: Sequence[int]
) -> list[Float64]:
    """Return (n, 2) where each single window finds the points, target view px."""
    target_px = np.full((len(windows_px), len(setup.rows), 2), np.nan)
    for site, (channels, points, guide, which) in zip(setup.sites, rematch.of_site, strict=True):
        if windows_px:
            displacement_px = displacement_by_windows(channels, points, guide, setup.settings, windows_px)
            target_px[:, which] = points.reference_xy_px + displacement_px + origins_of(site.job)[1]
    return list(target_px)


def _errors(
    setup: ProofSetup, moves: Sequence[Move], before_px: Float64, after_px: Sequence[Float64]
) -> PointErrors:
    """Compare (n, 2) matches after each of the first moves with those before, target view px."""
    sources = [move.source(at_px, setup.centre_px) for move, at_px in zip(moves, after_px, strict=False)]
    error_px = (np.stack(sources) - before_px) * setup.unit_px
    off = np.linalg.norm(error_px, axis=2)
    false = off > setup.parameters.false_match_px
    lost = int((~np.isfinite(off[:, np.isfinite(before_px).all(axis=1)])).sum())
    error_px[false] = np.nan
    phase = (np.stack(after_px) - setup.reference_px) % 1.0
    return PointErrors(error_px, phase, int(false.sum()), lost, setup.parameters.least_matches)


def locking(errors: PointErrors) -> tuple[Float64, Float64]:
    """Fit a wave along the pixel to the errors; return its (2,) amplitudes and (k, n, 2) values."""
    waves = np.stack([np.sin(2 * np.pi * errors.phase), np.cos(2 * np.pi * errors.phase)])
    finite = np.isfinite(errors.error_px)
    within = errors.error_px - finite_mean(errors.error_px, 0)
    shape = waves - finite_mean(np.where(finite, waves, np.nan), 1)[:, None]
    amplitude, values = np.zeros(2), np.zeros(errors.error_px.shape)
    for axis in range(2):
        use = finite[..., axis] & np.isfinite(shape[..., axis]).all(axis=0)
        factors = least_squares(shape[:, use, axis].T, within[use, axis])
        amplitude[axis] = np.hypot(*factors)
        values[..., axis] = np.tensordot(factors, waves[..., axis], 1)
    return amplitude, np.where(finite, values, np.nan)


def scatter(errors: Float64) -> Float64:
    """Return the (2,) standard deviation of the (k, n, 2) `errors` about the mean of each move."""
    about = errors - finite_mean(errors, 1)[:, None]
    count = max(np.isfinite(errors).all(axis=2).sum(axis=1).mean(), 2.0)
    return np.asarray(np.sqrt(finite_mean(about**2, (0, 1)) * count / (count - 1)))
