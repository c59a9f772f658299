"""The error of the tool itself on a user's own pair: the target is moved by known amounts and matched again.

The error of a point is the displacement of its match less that of the target. Noise of the level that the
images have is added to each move; otherwise both matches would share the same noise. An error that both share
all the same, by structure that lies elsewhere in the other band, cannot be observed in this way:
`UnobservableError` says what is known of it.

`prove` does all of this: `set_up` chooses points and reads their surroundings, `measure` matches them after
each of `moves_of`, and the rest classifies the errors. `sensitivity` then degrades a part of the pair step by
step until it is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import cv2
import numpy as np
import scipy.fft
import scipy.ndimage

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.dense import positions
from pcwlad_geo.correction.error_statistics import (
    ClassEntry,
    CorrectionEntry,
    Difficulty,
    EvidenceEntry,
    EvidenceKind,
    FloatPair,
    LevelUnit,
    LimitEntry,
    Move,
    PhaseEntry,
    PointEntry,
    Proof,
    Reversal,
    Sensitivity,
    SigmaEntry,
    TrialEntry,
    UnobservableError,
    float_pair,
    radial_statistics,
)
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.models import affine_between
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import inverse, least_squares, pseudo_inverse
from pcwlad_geo.events import JobLog, Progress
from pcwlad_geo.matching.field import global_affine
from pcwlad_geo.matching.first_pass import Core, match_candidates
from pcwlad_geo.matching.gaps import fill_smoothly
from pcwlad_geo.matching.guidance import FieldGuide, guide_by_field
from pcwlad_geo.matching.kernels.library import fast_even, in_threads
from pcwlad_geo.matching.noise import noise_level
from pcwlad_geo.matching.outliers import consistent_points
from pcwlad_geo.matching.prepare import ChannelPair, Image, PreparedPair, prepare
from pcwlad_geo.matching.refinement import InitialEstimate, refine
from pcwlad_geo.matching.second_pass import displacement_by_windows, rematch_with
from pcwlad_geo.matching.types import TRAITS, MatchSettings, TiePoints, to_index
from pcwlad_geo.matching.windows import Scales
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.arrays import Raster, Scratch
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.view import Patch, file_px_per_px
from pcwlad_geo.registration.fitting import AssessedFit
from pcwlad_geo.registration.result import Matches, Registration
from pcwlad_geo.registration.tiles import TileJob
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float32, Float64, Index

POINTS: Final = {"quick": 96, "full": 256}
"""Number of tie points that are matched again."""
SITES: Final = {"quick": 3, "full": 8}
"""Largest number of parts of a large scene."""
SITE_PX: Final = 640
"""Largest side of such a part; a smaller scene is taken whole."""
FALSE_MATCH_PX: Final = 1.0
"""A match whose error is larger is false."""
MIN_POINTS: Final = 12
"""Least number of points for a proof."""
FRAME_PX: Final = 32
"""Width of the frame in which an image fades, so that it has no edge where its ends meet."""
EDGE_PX: Final = 3
"""Pixels of a moved image this near to nodata are left out, as filled values affect them."""


def moves_of(effort: Effort, window_px: int) -> tuple[Move, ...]:
    """Return the moves: shifts in all phases of a pixel along both axes, then a turned and a bent one."""
    count = {"quick": 8, "full": 16}[effort]
    phase = (np.arange(count) + 0.5) / count - 0.5
    other = (np.arange(count) * (3 if count == 8 else 7) + count // 2) % count  # each phase once
    shifts = [Move("shift", (float(col), float(phase[row]))) for col, row in zip(phase, other, strict=True)]
    wavelength = max(600.0, 5.0 * window_px)  # a bend that windows hardly average
    turned = Move("turn", (0.23, -0.36), rotation_deg=0.2, scale=1.002)
    return *shifts, turned, Move("field", (-0.31, 0.18), amplitude_px=0.5, wavelength_px=wavelength)


class Resampler:
    """Moves an image by a Fourier shift, or where it is turned or bent by interpolating twice as fine pixels.

    Parameters
    ----------
    values : (rows, cols) array
        Finite where valid.
    valid : (rows, cols) bool array
    """

    def __init__(self, values: Float32 | Float64, valid: Bool) -> None:
        self.values, self.valid = np.asarray(values, np.float64), valid
        self._shape = values.shape
        side = 2 * EDGE_PX + 1
        inner = cv2.erode(valid.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0)
        self._inner = np.asarray(inner, bool)
        filled = np.asarray(fill_smoothly(self.values, valid), np.float64)
        self._mean = float(filled.mean())
        ramp = np.sin(np.linspace(0, np.pi / 2, FRAME_PX + 2)[1:-1]) ** 2
        down, across = (np.concatenate([ramp, np.ones(length), ramp[::-1]]) for length in self._shape)
        framed = np.pad(filled - self._mean, FRAME_PX, mode="symmetric") * down[:, None] * across
        self._size = fast_even(framed.shape[0]), fast_even(framed.shape[1])
        self._spectrum = scipy.fft.rfft2(framed, self._size)
        # the phase of the highest frequency is not known
        self._spectrum[self._size[0] // 2] = 0.0
        self._spectrum[:, -1] = 0.0

    def frequencies(self, count: int, noise: float, random: np.random.Generator) -> Float64:
        """Draw (count, 2) frequencies (col, row), cycles a pixel, by their energy beyond that of noise."""
        energy = np.clip(np.abs(self._spectrum) ** 2 - 4 * noise**2 * self.valid.size, 0, None)
        drawn = random.choice(energy.size, count, p=(energy / energy.sum()).ravel())
        row, col = np.unravel_index(drawn, energy.shape)
        return np.column_stack(
            [scipy.fft.rfftfreq(self._size[1])[col], scipy.fft.fftfreq(self._size[0])[row]]
        )

    def moved(self, move: Move, centre_px: Float64) -> tuple[Float64, Bool]:
        """Return the image and its valid pixels after a move, two (rows, cols) arrays.

        The move is about the (2,) `centre_px` (col, row), px of the array, corner-based.
        """
        rows, cols = self._shape
        if move.kind == "shift":
            spectrum = scipy.ndimage.fourier_shift(self._spectrum, move.shift_px[::-1], self._size[1])
            plane = scipy.fft.irfft2(spectrum, self._size)
            values = plane[FRAME_PX : FRAME_PX + rows, FRAME_PX : FRAME_PX + cols]
            col, row = (np.arange(n) + 0.5 - by for n, by in zip((cols, rows), move.shift_px, strict=True))
            return values + self._mean, self._valid_at(col[None], row[:, None])
        grid = positions(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
        at = move.source(grid, centre_px).reshape(rows, cols, 2)
        return self._interpolated(at) + self._mean, self._valid_at(at[..., 0], at[..., 1])

    def _interpolated(self, at_px: Float64) -> Float64:
        """Return the values at (rows, cols, 2) places (col, row)."""
        rows, cols = self._size
        wide = np.zeros((2 * rows, cols + 1), complex)
        half = rows // 2
        wide[:half, : cols // 2 + 1] = self._spectrum[:half]
        wide[-half:, : cols // 2 + 1] = self._spectrum[-half:]
        fine = scipy.fft.irfft2(wide, (2 * rows, 2 * cols)) * 4
        at = 2 * (at_px - 0.5 + FRAME_PX)
        found = scipy.ndimage.map_coordinates(fine, (at[..., 1], at[..., 0]), order=5, mode="nearest")
        return np.asarray(found, np.float64)

    def _valid_at(self, col_px: Float64, row_px: Float64) -> Bool:
        """Return whether places, of arrays that broadcast, are at least `EDGE_PX` within valid pixels."""
        col, row = (np.floor(each).astype(np.intp) for each in (col_px, row_px))
        rows, cols = self._shape
        inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
        return np.asarray(inside & self._inner[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)])


@dataclass(frozen=True, slots=True, eq=False)
class _Site:
    """A part of the scene with some of the points, read once."""

    job: TileJob
    index: Index
    """Which of the points lie in it."""
    reference: Patch
    resampler: Resampler


@dataclass(frozen=True, slots=True, eq=False)
class ProofSetup:
    """What is needed to match some points of a pair again, on images that may differ from the files'."""

    sites: tuple[_Site, ...]
    reference_px: Float64
    """(n, 2) positions (col, row) of the points, reference view px."""
    rows: Index
    """(n,) their rows in the table of tie points."""
    sigma_px: Float64
    """(n, 2) their sigmas, target view px."""
    settings: MatchSettings
    scales: Scales
    noise: FloatPair
    """Standard deviation of the noise of the reference and of the target, in units of their values."""
    centre_px: Float64
    """(2,) centre of the moves, target view px."""
    unit_px: Float64
    """(2,) px of the target file per view px."""


def set_up(matches: Matches, effort: Effort) -> ProofSetup:
    """Choose points of a pair that is matched, and read the images around them.

    Raises `InputError` if the pair has too few points that were matched here, or a file cannot be read.
    """
    job, scales = matches.job, matches.scales
    table = matches.tie_points
    rows = np.flatnonzero(table.status == "matched")
    if job is None or scales is None or not matches.accepted or len(rows) < MIN_POINTS:
        raise InputError(
            f"nothing can be proved: {len(rows) if matches.accepted else 0} tie points were matched here "
            f"reliably, and {MIN_POINTS} are the least"
        )
    places = job.reference.from_file_px(table.reference_px[rows])
    settings = replace(job.settings, search_radius=job.settings.search_radius + 3, spare=0)  # for the moves
    job = replace(job, settings=settings)
    chosen, of_site = _spread(places, job, effort, np.random.default_rng(0))
    unit_px = file_px_per_px(job.target)
    sites = tuple(_read(job, np.flatnonzero(of_site == site), places[chosen]) for site in np.unique(of_site))
    moved_px = np.median(job.target.from_file_px(table.target_px[rows]) - places, axis=0)
    noise = [_noise(site, moved_px) for site in sites]
    reference_noise, target_noise = np.median(noise, axis=0).tolist()
    return ProofSetup(
        sites=sites,
        reference_px=places[chosen],
        rows=rows[chosen],
        sigma_px=table.sigma_px[rows[chosen]] / unit_px,
        settings=settings,
        scales=scales,
        noise=(reference_noise, target_noise),
        centre_px=places.mean(axis=0) + job.target_offset_px,
        unit_px=unit_px,
    )


def _noise(site: _Site, moved_px: Float64) -> FloatPair:
    """Return the noise of both images, each compared with the other one, shifted by the displacement."""
    col, row = (moved_px - site.job.target_offset_px).tolist()
    reference, target = Resampler(site.reference.values, site.reference.valid), site.resampler
    there, valid_there = target.moved(Move("shift", (-col, -row)), np.zeros(2))
    here, valid_here = reference.moved(Move("shift", (col, row)), np.zeros(2))
    return (
        noise_level(reference.values, there, reference.valid & valid_there),
        noise_level(target.values, here, target.valid & valid_here),
    )


def _spread(
    places: Float64, job: TileJob, effort: Effort, random: np.random.Generator
) -> tuple[Index, Index]:
    """Choose points at random, of a large scene in some parts of it; return them and the part of each.

    The most precise ones are not preferred, as the errors of all are wanted.
    """
    region, order = job.region, random.permutation(len(places))
    if max(region.shape) <= SITE_PX:
        chosen = np.sort(order[: POINTS[effort]])
        return chosen, np.zeros(len(chosen), np.intp)
    size = np.array([region.cols, region.rows])
    side_px = size / np.ceil(size / SITE_PX)  # of equal size: a narrow one at an edge would count as much
    cell = np.floor((places - (region.col, region.row)) / side_px).astype(np.intp)
    _, of_point, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    of_point = of_point.ravel()
    full = random.permutation(np.flatnonzero(counts >= min(MIN_POINTS, counts.max())))[: SITES[effort]]
    share = -(-POINTS[effort] // len(full))
    parts = [order[of_point[order] == each][:share] for each in full]
    return np.concatenate(parts), np.repeat(np.arange(len(parts)), [len(part) for part in parts])


def _read(job: TileJob, index: Index, places: Float64) -> _Site:
    """Read the part of both images that the matching of the points at an index needs."""
    low = np.floor(places[index].min(axis=0)).astype(int)
    high = np.floor(places[index].max(axis=0)).astype(int) + 1
    core = Window.from_bounds(int(low[1]), int(low[0]), int(high[1]), int(high[0]))
    job = replace(job, core=core, cell_margin_px=0)
    window, (col, row) = job.read_window, job.target_offset_px
    target = job.target.read(window.moved(row, col))
    return _Site(job, index, job.reference.read(window), Resampler(target.values, target.valid))


@dataclass(frozen=True, slots=True, eq=False)
class MatchedAgain:
    """The points of a setup, matched again as a registration matches: both passes, the windows it chose."""

    target_px: Float64
    """(n, 2) where they were found (col, row), target view px; NaN for those that were lost."""
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
        origin, target_origin = _origins(site.job)
        corners = np.floor(setup.reference_px[site.index] - origin)[:, ::-1].astype(np.intp)
        first, _ = match_candidates(pair, Core(0, 0, 0, 0, (0, 0)), settings, corners)
        pairs.append(pair.channels)
        parts.append(first.shifted(origin, target_origin))
        of_part.append(site.index[_rows_of(to_index(first), corners)])
    points, which = TiePoints.concatenate(parts), np.concatenate(of_part)
    kept = consistent_points(points, settings) if len(points) else np.zeros(0, bool)
    points, which = points[kept], which[kept]
    guide = guide_by_field(points, settings)
    again, of_site = points.target_xy_px.copy(), []
    for site, channels in zip(setup.sites, pairs, strict=True):
        some = np.flatnonzero(np.isin(which, site.index))
        origin, target_origin = _origins(site.job)
        here = guide.part(some).moved(origin - target_origin)
        found = rematch_with(
            channels, points[some].shifted(-origin, -target_origin), here, settings, setup.scales
        )
        again[some] = found.target_xy_px + target_origin
        of_site.append((channels, found, here, which[some]))
    chosen = replace(settings, window=setup.scales.window_px)
    kept = consistent_points(replace(points, target_xy_px=again), chosen) if len(points) else kept
    target_px = np.full((len(setup.rows), 2), np.nan)
    target_px[which[kept]] = again[kept]
    return MatchedAgain(target_px, tuple(of_site))


def _prepared(
    site: _Site, setup: ProofSetup, move: Move | None, random: np.random.Generator | None, threads: int
) -> PreparedPair:
    """Return the maps of a site, its target moved and both images with fresh noise."""
    job, window = site.job, site.job.read_window
    values, valid = site.resampler.values, site.resampler.valid
    if move is not None:
        corner = np.array([window.col, window.row]) + job.target_offset_px
        values, valid = site.resampler.moved(move, setup.centre_px - corner)
    images = []
    for (image, known), level, scene in zip(
        ((site.reference.values, site.reference.valid), (values, valid)),
        setup.noise,
        (job.reference_scene, job.target_scene),
        strict=True,
    ):
        fresh = 0.0 if random is None else level * random.standard_normal(image.shape)
        images.append(Image(image + fresh, known, scene.epsilon, scene.noise))
    traits = TRAITS[job.settings.method]
    return prepare(*images, channels=traits.channels, halo_px=traits.halo_px, threads=threads)


def _origins(job: TileJob) -> tuple[Float64, Float64]:
    reference = np.array([job.window.col, job.window.row], np.float64)
    return reference, reference + job.target_offset_px


def _rows_of(found: Index, corners: Index) -> Index:
    """Return which of the (m, 2) corners each of the (n, 2) found ones is."""
    place = {(row, col): index for index, (row, col) in enumerate(corners.tolist())}
    return np.array([place[row, col] for row, col in found.tolist()], np.intp)


BLOCK_PX: Final = 24
"""Side of the squares of a chessboard, whose white and black squares are one window each."""
CHESSBOARD_PX: Final = 121
"""Side of the chessboard."""
MIN_UNOBSERVABLE_PX: Final = 0.1
"""Lower limit of the reported bound on the unobservable error, px of the matching grid: between bands of the
same sensor, four matchers found 0.1 to 0.2 px."""
UNOBSERVABLE_FACTOR: Final = 3.0
"""Bound on the unobservable error, as a multiple of half the difference between two subsets of evidence."""
PHASES: Final = 8
"""Number of classes of the fraction of a pixel."""
TEXTURES: Final = 4
"""Number of classes of texture, of as many points each."""
LEAST_MATCHES: Final = 4
"""Least number of matches of a point whose scatter is counted."""
WINDOW_MOVES: Final = 6
"""Number of moves after which the points are also matched by each single window."""
ONE_SIGMA, TWO_SIGMA = 68.27, 95.0
"""Percentages of normal errors within 1 and 1.96 sigmas."""


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Errors of n points after k moves, target px."""

    moved: Float64
    """(k, n, 2) moved minus unmoved match, minus the known move; NaN for lost and false ones."""
    phase: Float64
    """(k, n, 2) fraction of a pixel, 0 to 1, of the displacement that was matched."""
    false_matches: int
    lost: int

    @property
    def centred(self) -> Float64:
        """(k, n, 2) errors about the mean of each point, scaled to the variance of a single match.

        This removes the error of the unmoved match, which is common to all moves.
        """
        count = np.isfinite(self.moved).sum(axis=0)
        scale = np.sqrt(count / np.maximum(count - 1, 1))
        return np.where(count >= LEAST_MATCHES, (self.moved - _mean(self.moved, 0)) * scale, np.nan)

    def shrunk(self, factor: float) -> _Errors:
        """Return the errors shrunk towards the mean of each point."""
        centre = _mean(self.moved, 0)
        return replace(self, moved=centre + factor * (self.moved - centre))

    def part(self, some: Bool | slice, of_points: bool = False) -> _Errors:
        """Return the errors of some moves, or of some points."""
        moved, phase = ((each[:, some] if of_points else each[some]) for each in (self.moved, self.phase))
        return replace(self, moved=moved, phase=phase)


def _mean(values: Float64, axis: int | tuple[int, ...]) -> Float64:
    """Return the mean of the finite values; NaN where there are none."""
    return np.asarray(np.ma.masked_invalid(values).mean(axis).filled(np.nan), np.float64)


def measure(
    setup: ProofSetup,
    moves: Sequence[Move],
    windows_px: Sequence[int],
    log: JobLog,
    threads: int,
    total: int,
) -> tuple[_Errors, tuple[MatchedAgain, MatchedAgain], list[_Errors]]:
    """Match the points as they lie and after each move, the first of `total` units of progress.

    Returned are the errors with the windows that a registration chooses, the matches of the points as they
    lie and after the first move, and the errors with each of the `windows_px` after the first moves.
    """
    before = match_again(setup, None, None, threads)
    unmoved, found = [before.target_px, *_positions_by_window(setup, before, windows_px)], []
    after = before

    def matched(number: int) -> tuple[list[Float64], MatchedAgain | None]:
        again = match_again(setup, moves[number], np.random.default_rng([0, number]))
        more = _positions_by_window(setup, again, windows_px) if number < WINDOW_MOVES else []
        return [again.target_px, *more], again if number == 0 else None

    for begin in range(0, len(moves), threads):
        log.on_event(Progress("proving", begin, total))
        some = [partial(matched, number) for number in range(len(moves))[begin : begin + threads]]
        for target_px, again in in_threads(some, threads):
            found.append(target_px)
            after = again or after
    log.on_event(Progress("proving", len(moves), total))
    of_each = [
        _errors(setup, moves, first, [each[number] for each in found if number < len(each)])
        for number, first in enumerate(unmoved)
    ]
    return of_each[0], (before, after), of_each[1:]


def _positions_by_window(setup: ProofSetup, again: MatchedAgain, windows_px: Sequence[int]) -> list[Float64]:
    """Return (n, 2) where each single window finds the points, target view px."""
    found = np.full((len(windows_px), len(setup.rows), 2), np.nan)
    for site, (channels, points, guide, which) in zip(setup.sites, again.of_site, strict=True):
        if windows_px:
            moved = displacement_by_windows(channels, points, guide, setup.settings, windows_px)
            found[:, which] = points.reference_xy_px + moved + _origins(site.job)[1]
    return list(found)


def _errors(
    setup: ProofSetup, moves: Sequence[Move], before_px: Float64, found: Sequence[Float64]
) -> _Errors:
    """Compare (n, 2) matches after each of the first moves with those before, target view px."""
    sources = [move.source(each, setup.centre_px) for move, each in zip(moves, found, strict=False)]
    moved = (np.stack(sources) - before_px) * setup.unit_px
    off = np.linalg.norm(moved, axis=2)
    false = off > FALSE_MATCH_PX
    lost = int((~np.isfinite(off[:, np.isfinite(before_px).all(axis=1)])).sum())
    moved[false] = np.nan
    return _Errors(moved, (np.stack(found) - setup.reference_px) % 1.0, int(false.sum()), lost)


def _locking(errors: _Errors) -> tuple[Float64, Float64]:
    """Fit a wave along the pixel to the errors; return its (2,) amplitudes and (k, n, 2) values."""
    waves = np.stack([np.sin(2 * np.pi * errors.phase), np.cos(2 * np.pi * errors.phase)])
    known = np.isfinite(errors.moved)
    within = errors.moved - _mean(errors.moved, 0)
    shape = waves - _mean(np.where(known, waves, np.nan), 1)[:, None]
    amplitude, values = np.zeros(2), np.zeros(errors.moved.shape)
    for axis in range(2):
        use = known[..., axis] & np.isfinite(shape[..., axis]).all(axis=0)
        factors = least_squares(shape[:, use, axis].T, within[use, axis])
        amplitude[axis] = np.hypot(*factors)
        values[..., axis] = np.tensordot(factors, waves[..., axis], 1)
    return amplitude, np.where(known, values, np.nan)


def _scatter(errors: Float64) -> Float64:
    """Return the (2,) standard deviation of (k, n, 2) errors about the mean of each move."""
    about = errors - _mean(errors, 1)[:, None]
    count = max(np.isfinite(errors).all(axis=2).sum(axis=1).mean(), 2.0)
    return np.asarray(np.sqrt(_mean(about**2, (0, 1)) * count / (count - 1)))


def prove(
    matches: Matches, fit: AssessedFit, effort: Effort, log: JobLog, threads: int, register: Register
) -> Proof:
    """Measure the error of the matching on a pair that was matched.

    Raises `InputError` if too few of its points were matched here, or reliably.

    Parameters
    ----------
    fit : AssessedFit
        The correction of the pair, whose model is fitted to the errors.
    effort : {"quick", "full"}
        Number of moves and of points.
    log : JobLog
        Receives progress.
    threads : int
        Number of threads.
    register : callable
        Registers two files; a full proof measures with it what a part of the pair tolerates.
    """
    setup = set_up(matches, effort)
    moves = moves_of(effort, setup.scales.window_px)
    windows_px = setup.settings.windows if effort == "full" else ()
    total = len(moves) + (MOST_TRIALS if effort == "full" else 0)
    errors, ends, by_window = measure(setup, moves, windows_px, log, threads, total)
    shifts = errors.part(np.array([move.kind == "shift" for move in moves]))
    amplitude, wave = _locking(shifts)
    without_locking = replace(shifts, moved=shifts.moved - wave)
    scatter_ratio = _scatter_ratio(matches, setup, without_locking.centred)
    shrunk = min(1.0, scatter_ratio)
    errors, centred = errors.shrunk(shrunk), shrunk * without_locking.centred
    without_locking = without_locking.shrunk(shrunk)
    mean_of_moves = _mean(without_locking.moved, 1)
    bias_error = mean_of_moves.std(axis=0, ddof=1) / np.sqrt(len(mean_of_moves))
    bias = -_mean(shifts.moved, (0, 1))
    error = centred + bias
    found = error[np.isfinite(error).all(axis=2)]
    if not len(found):
        raise InputError("nothing can be proved: no tie point is found again after a move")
    radial, windows = radial_statistics(found), zip(windows_px, by_window, strict=True)
    return Proof(
        effort=effort,
        moves=moves,
        points=len(setup.rows),
        matches=len(found),
        lost=errors.lost,
        false_matches=errors.false_matches,
        noise=setup.noise,
        resampling_px=resampling_error_px(setup, moves),
        bias_px=float_pair(bias),
        bias_error_px=float_pair(bias_error),
        scatter_px=float_pair(_scatter(centred)),
        shrunk=shrunk,
        rmse_px=radial.rmse,
        ce90_px=radial.ce90,
        locking_px=float_pair(amplitude),
        locking_error_px=float_pair(np.sqrt(2) * bias_error),
        phases=_phases(shifts, wave),
        moved=_by_kind(errors, moves),
        texture=_by_texture(setup, ends[0], without_locking),
        windows=tuple(_class(f"{each} px", part) for each, part in windows),
        sigma=_sigmas(error, setup.sigma_px * setup.unit_px, scatter_ratio),
        correction=_correction_error(error, bias, setup, matches, fit, effort),
        unobservable=_unobservable(setup, *ends),
        map=_map(error, setup, matches),
        sensitivity=sensitivity(matches, register, log, len(moves)) if effort == "full" else None,
    )


def _map(error: Float64, setup: ProofSetup, matches: Matches) -> tuple[PointEntry, ...]:
    """Return the errors of each point that was found."""
    places = matches.tie_points.reference_px[setup.rows].tolist()
    entries = []
    for number, (row, (col_px, row_px)) in enumerate(zip(setup.rows.tolist(), places, strict=True)):
        found = [float_pair(each) for each in error[:, number] if np.isfinite(each).all()]
        entries += [PointEntry(row, (col_px, row_px), tuple(found))] if found else []
    return tuple(entries)


def _scatter_ratio(matches: Matches, setup: ProofSetup, centred: Float64) -> float:
    """Return the scatter of the tie points over that of their (k, n, 2) errors, both about an affine.

    That of the tie points contains their errors, and displacements that are not affine. An affine also
    follows some of the errors, as windows are wide.
    """
    table = matches.tie_points.select("matched")
    squares = []
    for each in centred:
        known = np.isfinite(each).all(axis=1)
        if np.count_nonzero(known) >= MIN_POINTS:
            squares.append(_std_about_affine(setup.reference_px[known], each[known]) ** 2)
    if not squares:
        return 1.0
    return _std_about_affine(table.predicted_px, table.displacement_px) / float(np.sqrt(np.mean(squares)))


def _std_about_affine(places_px: Float64, values_px: Float64) -> float:
    """Return the standard deviation of (n, 2) values about an affine of the places, both axes together."""
    linear, _ = global_affine(places_px, values_px)
    left = values_px - (places_px - places_px.mean(axis=0)) @ linear.T
    left -= np.median(left, axis=0)
    return float(np.linalg.norm(left[np.linalg.norm(left, axis=1) < FALSE_MATCH_PX].std(axis=0)))


def _phases(shifts: _Errors, wave: Float64) -> tuple[PhaseEntry, ...]:
    """Return the mean errors by the fraction of a pixel, about the mean of all."""
    level = _mean(shifts.moved - wave, (0, 1))
    entries = []
    for number in range(PHASES):
        inside = np.isfinite(shifts.moved) & (np.floor(shifts.phase * PHASES) == number)
        mean = _mean(np.where(inside, shifts.moved, np.nan), (0, 1)) - level
        counts = inside.sum(axis=(0, 1)).tolist()
        entries.append(PhaseEntry((number + 0.5) / PHASES, (counts[0], counts[1]), float_pair(mean)))
    return tuple(entries)


def _class(name: str, errors: _Errors, centre: Float64 | None = None) -> ClassEntry:
    """Return the errors of a class, their scatter about the points' own means or an (n, 2) `centre`."""
    centred = errors.centred if centre is None else errors.moved - centre
    points = int(np.isfinite(centred).all(axis=2).sum())
    return ClassEntry(name, points, float_pair(_mean(errors.moved, (0, 1))), float_pair(_scatter(centred)))


def _by_kind(errors: _Errors, moves: Sequence[Move]) -> tuple[ClassEntry, ...]:
    """Return the errors after each kind of move, of the turned and bent ones about the shifts' means."""
    kinds = np.array([move.kind for move in moves])
    shifts = errors.part(kinds == "shift")
    centre = _mean(shifts.moved, 0)
    others = (_class(kind, errors.part(kinds == kind), centre) for kind in ("turn", "field"))
    return _class("shift", shifts), *others


def _by_texture(setup: ProofSetup, before: MatchedAgain, errors: _Errors) -> tuple[ClassEntry, ...]:
    """Return the errors by the structure within the window of each point."""
    structure = np.full(len(setup.rows), np.nan)
    for channels, points, _, which in before.of_site:
        energy = (channels.reference.maps**2).sum(axis=0) * channels.reference.valid
        side = setup.scales.window_px
        row, col = to_index(points).T
        structure[which] = cv2.blur(energy, (side, side), borderType=cv2.BORDER_CONSTANT)[row, col]
    known = np.isfinite(structure)
    limits = np.quantile(structure[known], np.arange(1, TEXTURES) / TEXTURES)
    level = np.where(known, np.searchsorted(limits, structure), -1)
    names = ("faintest quarter", "second quarter", "third quarter", "strongest quarter")
    parts = [errors.part(level == number, of_points=True) for number in range(TEXTURES)]
    return tuple(_class(name, part) for name, part in zip(names, parts, strict=True))


def _sigmas(error: Float64, sigma_px: Float64, scatter_ratio: float = 1.0) -> SigmaEntry:
    """Compare (k, n, 2) errors with the (n, 2) sigmas of their points.

    The tie points scatter `scatter_ratio` times as much as the errors do.
    """
    ratio = np.abs(error) / sigma_px
    ratio = ratio[np.isfinite(ratio)]
    one, two = np.percentile(ratio, (ONE_SIGMA, TWO_SIGMA)) / (1.0, 1.96)
    factor = float(np.sqrt(one * two))
    calibration = max(factor, min(1.0, factor * max(scatter_ratio, 1.0)))
    return SigmaEntry(float((ratio <= 1).mean()), float((ratio <= 1.96).mean()), factor, calibration)


def _correction_error(
    error: Float64, bias: Float64, setup: ProofSetup, matches: Matches, fit: AssessedFit, effort: Effort
) -> CorrectionEntry | None:
    """Fit the model of the correction to the errors of each move, and return the error propagated into it."""
    table, name = matches.tie_points, fit.fitted.correction.name
    everywhere = table.predicted_px[table.status == "matched"]
    footprint = matches.window_px * float(setup.unit_px[0])
    found = []
    for errors in error:
        known = np.isfinite(errors).all(axis=1)
        rows = setup.rows[known]
        placed = table.predicted_px[rows]
        try:
            fitted = MODELS[name].fit(
                placed, placed + errors[known], table.covariance_px2[rows], footprint_px=footprint
            )
        except InputError:  # the sample does not determine it
            return None
        found.append(fitted.correction.forward(everywhere) - everywhere - bias)
    ratio = _full_to_sample_ratio(table.predicted_px[setup.rows], everywhere, footprint)
    propagated = np.concatenate(found) * ratio + bias
    radial = radial_statistics(propagated[np.isfinite(propagated).all(axis=1)])
    left_out_px = _leave_part_out_px(matches, name, footprint) if effort == "full" else None
    return CorrectionEntry(name, float_pair(bias), radial.rmse, radial.ce90, left_out_px)


PARTS_ALONG: Final = 3
"""Number of parts of the scene along each axis, each of which is left out once."""


def _leave_part_out_px(matches: Matches, name: str, footprint_px: float) -> float | None:
    """Return the largest RMS change of a correction in a part of the scene whose tie points are left out."""
    table = matches.tie_points.select("matched")
    places, low = table.predicted_px, table.predicted_px.min(axis=0)
    size = np.maximum(places.max(axis=0) - low, 1e-9)
    cell = np.minimum((PARTS_ALONG * (places - low) / size).astype(np.intp), PARTS_ALONG - 1)
    part = cell @ (1, PARTS_ALONG)

    def fitted(kept: Bool) -> Float64:
        given = places[kept], table.target_px[kept], table.covariance_px2[kept]
        return MODELS[name].fit(*given, footprint_px=footprint_px).correction.forward(places)

    try:
        whole = fitted(np.ones(len(part), bool))
        off = [(fitted(part != each) - whole)[part == each] for each in np.unique(part)]
    except InputError:
        return None
    return max(float(np.sqrt((each**2).sum(axis=1).mean())) for each in off)


def _full_to_sample_ratio(sample_px: Float64, everywhere_px: Float64, footprint_px: float) -> float:
    """Return the error of an affine fitted to all points over that fitted to a sample, 0 to 1.

    The errors of two windows correlate by the share of their area that they have in common.
    """
    every = everywhere_px[:: max(1, len(everywhere_px) // 1000)]
    centre, size = every.mean(axis=0), max(float(every.std()), 1.0)

    def terms(at_px: Float64) -> Float64:
        return np.column_stack([np.ones(len(at_px)), (at_px - centre) / size])

    variances = []
    for points in (every, sample_px):
        separation = np.abs(points[:, None] - points[None]) / footprint_px
        common = np.clip(1 - separation, 0, None).prod(axis=2)
        spread = terms(every) @ pseudo_inverse(terms(points), least=1e-10)
        variances.append(((spread @ common) * spread).sum(axis=1).mean())
    return float(np.sqrt(min(variances[0] / variances[1], 1.0)))


WAVES: Final = 60
"""Number of plane waves of the image on which the error of the resampling is measured."""
TEST_PX: Final = 192
"""Side of that image."""
TEST_WINDOW_PX: Final = 48
"""Side of the windows whose displacements are compared."""


def resampling_error_px(setup: ProofSetup, moves: Sequence[Move]) -> float:
    """Return the RMS error of the resampling, on an image of the target's spectrum known at every place."""
    random = np.random.default_rng([0, len(moves)])
    frequency = setup.sites[0].resampler.frequencies(WAVES, setup.noise[1], random)
    phase = random.uniform(0, 2 * np.pi, WAVES)
    centre = np.full(2, TEST_PX / 2)
    at = positions(np.arange(TEST_PX) + 0.5, np.arange(TEST_PX) + 0.5)

    def image(places: Float64) -> Float64:
        waves = np.cos(2 * np.pi * places @ frequency.T + phase)
        return np.asarray(waves.sum(axis=1).reshape(TEST_PX, TEST_PX), np.float64)

    resampler = Resampler(image(at), np.ones((TEST_PX, TEST_PX), bool))
    squares = []
    for move in (moves[0], *(move for move in moves if move.kind != "shift")):
        values, _ = resampler.moved(move, centre)
        truth = image(move.source(at, centre))
        slopes = np.stack([np.gradient(truth, axis=axis) for axis in (1, 0)], axis=-1)
        inner = range(TEST_WINDOW_PX // 2, TEST_PX - TEST_WINDOW_PX, TEST_WINDOW_PX // 2)
        for row, col in ((row, col) for row in inner for col in inner):
            part = (slice(row, row + TEST_WINDOW_PX), slice(col, col + TEST_WINDOW_PX))
            off = least_squares(slopes[part].reshape(-1, 2), (values - truth)[part].ravel())
            squares.append((off**2).sum())
    return float(np.sqrt(np.mean(squares)))


def _unobservable(setup: ProofSetup, before: MatchedAgain, after: MatchedAgain) -> UnobservableError:
    """Compare matches by two subsets of the evidence, of the pair as it lies and with fresh noise."""
    kinds: dict[EvidenceKind, Callable[..., Float64]] = {"windows": _chessboard, "directions": _directions}
    if len(before.of_site[0][0].reference.maps) > 1:
        kinds = {"channels": _channels, **kinds}
    entries = []
    for name, compare in kinds.items():
        first, second = (_differences(compare, setup, again) * setup.unit_px for again in (before, after))
        entries.append(_evidence_entry(name, first, second, setup))
    lengths = [(np.hypot(*each.mean_px), np.hypot(*each.error_px)) for each in entries]
    least = max((length - 2 * error) / 2 for length, error in lengths)
    most = max(max(length, *each.scatter_px) for (length, _), each in zip(lengths, entries, strict=True))
    bound = max(UNOBSERVABLE_FACTOR * most / 2, MIN_UNOBSERVABLE_PX * float(setup.unit_px.max()))
    return UnobservableError(tuple(entries), float(max(least, 0.0)), float(bound))


def _evidence_entry(name: EvidenceKind, first: Float64, second: Float64, setup: ProofSetup) -> EvidenceEntry:
    known = np.isfinite(first).all(axis=1)
    noise = np.nanvar(second - first, axis=0)
    windows = len(np.unique(np.floor(setup.reference_px[known] / setup.scales.window_px), axis=0))
    spread = first[known].std(axis=0)
    return EvidenceEntry(
        name,
        int(known.sum()),
        float_pair(_mean(first, 0)),
        float_pair(spread / np.sqrt(max(windows, 1))),
        float_pair(np.sqrt(np.maximum(spread**2 - noise, 0.0))),
    )


def _differences(compare: Callable[..., Float64], setup: ProofSetup, again: MatchedAgain) -> Float64:
    """Return (n, 2) differences between two matches of the points of all sites, view px."""
    found = np.full((len(setup.rows), 2), np.nan)
    for channels, points, guide, which in again.of_site:
        found[which] = compare(setup, channels, points, guide)
    found[np.linalg.norm(found, axis=1) > FALSE_MATCH_PX] = np.nan
    return found


def _channels(setup: ProofSetup, pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    halves = []
    for first in range(2):
        images = [replace(each, maps=each.maps[first::2].copy()) for each in (pair.reference, pair.target)]
        half = ChannelPair(images[0], images[1], pair.threads)
        halves.append(rematch_with(half, points, guide, setup.settings, setup.scales).target_xy_px)
    return np.asarray(halves[0] - halves[1])


def _chessboard(setup: ProofSetup, pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    row, col = np.indices((CHESSBOARD_PX, CHESSBOARD_PX)) // BLOCK_PX
    squares = (row + col) % 2
    found, corners = [], to_index(points)
    for colour in range(2):
        weight = np.tile((squares == colour).astype(np.float32), (len(points), 1, 1))
        start = InitialEstimate(points.displacement_px, guide.linear, structure=weight)
        again = refine(
            pair.reference, pair.target, corners, start, window_px=CHESSBOARD_PX, threads=pair.threads
        )
        found.append(np.where(again.converged[:, None], again.shift_xy_px, np.nan))
    return np.asarray(found[0] - found[1])


def _directions(setup: ProofSetup, pair: ChannelPair, points: TiePoints, guide: FieldGuide) -> Float64:
    one_way = replace(guide, one_way=True)
    there = rematch_with(pair, points, one_way, setup.settings, setup.scales).displacement_px
    # the window back is centred on a whole pixel of the target
    landed = np.floor(points.target_xy_px) + 0.5
    bend = np.einsum("nij,nj->ni", guide.linear, landed - points.target_xy_px)
    begin = replace(points, reference_xy_px=landed, target_xy_px=landed - points.displacement_px - bend)
    back = replace(
        one_way,
        linear=inverse(np.eye(2) + guide.linear) - np.eye(2),
        structure_xy_px=-(guide.structure_xy_px + bend),
    )
    returned = rematch_with(pair.turned, begin, back, setup.settings, setup.scales).displacement_px
    return np.asarray(there + returned + bend)


Register = Callable[[str, str, Settings], Registration]
"""Registers a reference and a target like any pair, without writing."""
PART_PX: Final = 512
"""Largest side of the part of the pair that is degraded."""
DIFFICULTIES: Final[dict[Difficulty, tuple[LevelUnit, Float64]]] = {
    "displacement": ("px", 2.0 * 2 ** (np.arange(15) / 2)),
    "rotation": ("deg", 0.5 * 2 ** (np.arange(15) / 2)),
    "noise": ("share of the standard deviation", 0.0625 * 2 ** (np.arange(15) / 2)),
    "clouds": ("share of the pixels", np.arange(1.0, 16.0) * 0.06),
}
"""Unit and levels of each difficulty."""
BEFORE_TRIALS: Final = 3
"""Number of registrations of the part as it lies, one of them in reverse."""
TRIALS_EACH: Final = 5
"""Largest number of registrations that find the first level that is not tolerated."""
MOST_TRIALS: Final = BEFORE_TRIALS + TRIALS_EACH * len(DIFFICULTIES)
"""Largest number of registrations of the part."""
INHERITED_SETTINGS: Final = (
    *("method", "points", "keypoints", "template", "window", "search_radius", "ssim_min"),
    *("iterations", "consensus", "prealign", "start_matcher", "geometry", "tile_size"),
)
"""Settings of the pair that also hold for a part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class _TestPart:
    """A part of the pair whose target can be read beyond it, and the function that registers it."""

    job: TileJob
    window: Window
    reference: Float64
    """(rows, cols), NaN where not valid."""
    settings: Settings
    register: Register
    scratch: Scratch

    def target(self, window: Window) -> Float64:
        """Return the target's pixels in a window of the reference view; NaN where not valid."""
        col, row = self.job.target_offset_px
        return _with_nan(self.job.target.read(window.moved(row, col)))

    def registered(self, reference: Float64, target: Float64) -> Registration | None:
        """Register (rows, cols) images as files of one grid; None where they are refused."""
        grid = self.job.reference.grid.part((self.window.col, self.window.row), self.window.shape)
        transform = grid.transform if grid.located else None
        files = [
            self.scratch.file_of(Raster(image.astype(np.float32), transform, grid.crs, float("nan")), name)
            for name, image in (("reference", reference), ("target", target))
        ]
        try:
            found = self.register(files[0], files[1], self.settings)
        except InputError:  # too few pixels of an image are valid
            return None
        return None if found.status == "rejected" else found


def _with_nan(patch: Patch) -> Float64:
    return np.where(patch.valid, np.asarray(patch.values, np.float64), np.nan)


def _part(matches: Matches, register: Register) -> _TestPart:
    """Return the part of the pair that holds most tie points."""
    job, settings, table = matches.job, matches.pair.settings, matches.tie_points
    if job is None:
        raise InputError("nothing can be proved: no tie point was matched here")
    region, places = job.region, job.reference.from_file_px(table.reference_px[table.status == "matched"])
    cells, counts = np.unique(
        np.floor((places - (region.col, region.row)) / PART_PX).astype(np.intp), axis=0, return_counts=True
    )
    col, row = (cells[counts.argmax()] * PART_PX).tolist()
    window = Window(region.row + row, region.col + col, PART_PX, PART_PX).intersection(region)
    model = "auto" if settings.model == "rpc" else settings.model
    features = min(settings.candidates, 256)  # as dense as in a tile
    inherited = {name: getattr(settings, name) for name in INHERITED_SETTINGS}
    settings = Settings(**inherited, model=model, features=features)
    return _TestPart(job, window, _with_nan(job.reference.read(window)), settings, register, Scratch())


def sensitivity(
    matches: Matches, register: Register, log: JobLog, progress_offset: int = 0
) -> Sensitivity | None:
    """Register a part of a pair like any pair, degraded step by step until it is refused.

    None where the part is refused as it lies. Progress is told to `log` from `progress_offset` on.
    """
    part = _part(matches, register)
    target = part.target(part.window)
    baseline = part.registered(part.reference, target)
    if baseline is None:
        return None
    settings = replace(part.settings, features=matches.pair.settings.features)
    reversal = _reversal(replace(part, settings=settings), target)
    limits, total = [], progress_offset + MOST_TRIALS
    for number, name in enumerate(DIFFICULTIES):
        done = progress_offset + BEFORE_TRIALS + TRIALS_EACH * number
        log.on_event(Progress("proving", done, total))
        unit, levels = DIFFICULTIES[name]
        if name == "displacement":
            levels = levels[levels <= min(part.window.shape) / 2]
        limits.append(_limit(name, unit, levels, partial(_trial, part, baseline, name)))
    log.on_event(Progress("proving", total, total))
    return Sensitivity(part.window.shape, len(_kept(baseline)), tuple(limits), reversal)


def _limit(
    name: Difficulty, unit: LevelUnit, levels: Float64, attempt: Callable[[float], TrialEntry]
) -> LimitEntry:
    """Find the largest level that is tolerated, by halving the levels between it and the least that is not.

    The largest of all is tried first, which is often tolerated.
    """
    trials: list[TrialEntry] = []
    low, high, number = -1, len(levels), len(levels) - 1
    while high - low > 1:
        trials.append(attempt(float(levels[number])))
        low, high = (number, high) if trials[-1].outcome == "correct" else (low, number)
        number = (low + high) // 2
    trials.sort(key=lambda each: each.level)
    tolerated = None if low < 0 else float(levels[low])
    return LimitEntry(
        name, unit, tolerated, None if high == len(levels) else float(levels[high]), tuple(trials)
    )


def _trial(part: _TestPart, baseline: Registration, name: Difficulty, level: float) -> TrialEntry:
    """Register the part at a level of a difficulty, and compare its points with those of the baseline."""
    reference, target, move, centre = _degraded(part, name, level, np.random.default_rng([0, 77]))
    found = part.registered(reference, target)
    if found is None:
        return TrialEntry(level, "refused", 0, None)
    table, before = _kept(found), _kept(baseline)
    matrix = affine_between(before.reference_px, before.target_px)

    def off_px(reference_px: Float64, target_px: Float64) -> float:
        known = reference_px @ matrix[:, :2].T + matrix[:, 2]
        return float(np.median(np.linalg.norm(target_px - known, axis=1)))

    error = off_px(table.reference_px, move.source(table.target_px, centre))
    correct = error <= FALSE_MATCH_PX + off_px(before.reference_px, before.target_px)
    return TrialEntry(level, "correct" if correct else "incorrect", len(table), error)


def _degraded(
    part: _TestPart, name: Difficulty, level: float, random: np.random.Generator
) -> tuple[Float64, Float64, Move, Float64]:
    """Return reference and target at a level of a difficulty, and the move of the target and its centre."""
    window, reference, no_move = part.window, part.reference, Move("shift", (0.0, 0.0))
    centre = np.array([window.cols, window.rows]) / 2
    if name == "displacement":
        col, row = (round(level * share) for share in (0.8, 0.6))
        return reference, part.target(window.moved(row, col)), Move("shift", (-col, -row)), centre
    if name == "rotation":
        margin = max(window.shape) // 4  # at 45 degrees the corners come from as far outside
        values = part.target(window.padded(margin))
        turned, move = Resampler(values, np.isfinite(values)), Move("turn", (0.0, 0.0), rotation_deg=level)
        image, valid = turned.moved(move, centre + margin)
        inner = (slice(margin, -margin), slice(margin, -margin))
        return reference, np.where(valid, image, np.nan)[inner], move, centre
    target = part.target(window)
    if name == "noise":
        reference, target = (
            image + level * np.nanstd(image) * random.standard_normal(image.shape)
            for image in (reference, target)
        )
        return reference, target, no_move, centre
    return reference, _clouded(target, level, random), no_move, centre


def _clouded(image: Float64, share: float, random: np.random.Generator) -> Float64:
    """Return an image with clouds over a share of it, with soft edges and brighter than the image."""
    size = max(image.shape) / 12
    height = scipy.ndimage.gaussian_filter(random.standard_normal(image.shape), size / 2, mode="reflect")
    height = (height - np.quantile(height, 1 - share)) / height.std()
    cover = np.clip(0.5 + 5 * height, 0, 1)
    low, high = np.nanpercentile(image, (1, 99))
    cloud = high + (high - low) * np.clip(0.3 + 0.2 * height, 0.3, 1.0)
    return np.asarray((1 - cover) * image + cover * cloud)


def _kept(found: Registration) -> TiePointTable:
    return found.tie_points.select("matched", "fit", "check", "unused")


def _reversal(part: _TestPart, target: Float64) -> Reversal | None:
    """Return the inverse-consistency error of the two corrections."""
    there, back = part.registered(part.reference, target), part.registered(target, part.reference)
    if there is None or back is None or there.correction is None or back.correction is None:
        return None
    begin = _kept(there).predicted_px  # both files have the same grid
    off = back.correction.forward(there.correction.forward(begin)) - begin
    off = off[np.isfinite(off).all(axis=1)]
    rms = float(np.sqrt((off**2).sum(axis=1).mean()))
    return Reversal(there.correction.name, back.correction.name, float_pair(off.mean(axis=0)), rms)
