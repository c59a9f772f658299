"""What two images of one size share on the same pixels: patterns, lines, and ground beside them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import scipy.fft

from pcwlad_geo.registration.frame_marks import Frames, SpeckParameters, structure_band
from pcwlad_geo.registration.frame_phases import (
    Phases,
    Spectrum,
    flattened,
    frequencies,
    highest,
    inner,
    spectra,
)
from pcwlad_geo.types import Bool, Float32, Float64


@dataclass(frozen=True, slots=True)
class FrameParameters:
    """How the ground is told from what belongs to the frame."""

    identity_px: float = 0.1
    """Largest median distance of tie points from the same pixel of the other file, per axis."""
    scatter_px: float = 0.3
    """Distance within which most of them lie there: what stands still agrees far better than bands do."""
    pulled_px: float = 0.6
    """The largest such distances where ground that has moved draws the points: there it must be seen."""
    most: float = 0.7
    """Share of the points that are most."""
    largest_px: int = 800
    """Largest side of the part that is read, in the middle of large files."""
    smooth_px: float = 2.5
    """Standard deviation of the filter that takes out the pattern of single pixels."""
    window_px: int = 81
    """Side of the places that are asked; of small frames without georeferencing a quarter of theirs."""
    smallest_window_px: int = 41
    """Least such side."""
    reach_px: int = 12
    """Largest displacement that is compared with none, along both axes."""
    step_px: int = 3
    """Distance of these displacements; a neighbour of none counts as none, so that 11 % agree by chance."""
    structured: float = 0.4
    """Share of the places, those with most structure in either image, that are asked."""
    min_places: int = 8
    """Least number of such places that tell."""
    ground_share: float = 0.55
    """Share of these places that agree at no displacement from which the ground does: 0.6 to 1 of bands and
    dates that truly lie so."""
    frame_share: float = 0.45
    """Share below which it does not: 0.11 of two frames of a thermal camera in flight, at most 0.4 of other
    ground under a fixed pattern."""
    common_grey: float = 0.1
    """Least correlation of the grey values of frames that share a pattern: 0.54 of the two thermal ones, at
    most 0.03 of 30 maps over images of the same ground, of which the share says nothing."""
    finest_px: float = 4.0
    """Wavelength of the finest structure in which ground that has moved is sought."""
    coarsest_px: float = 50.0
    """Wavelength of the coarsest one."""
    rival_z: float = 25.0
    """Least significance of another displacement of the ground, in standard deviations of the cepstrum: 48 to
    190 of ground that has moved, 44 at most of bands in place."""
    rival_ratio: float = 2.5
    """Least ratio of this to the significance in the images' own cepstra: 4 and more of ground that has
    moved, at most 1.6 of bands in place."""
    same_correlation: float = 0.95
    """Correlation of both images in these wavelengths from which their difference holds no ground."""
    rival_min_px: int = 5
    """Least displacement that is distinguished from none so, and largest one of points that are asked."""
    fine_z: float = 8.0
    """Least correlation of the finest structure at no displacement, times the root of the number of pixels,
    of frames with a common pattern: 10 and more."""
    near_z: float = 6.0
    """Least peak of the smoothed structure, standard deviations of its correlation: 6.6 and more of ground
    that has moved by 1 to 5 px; at most 3.5 of other ground."""
    near_ratio: float = 1.2
    """Least ratio of this peak to the value at no displacement: 1.24 and more of ground that has moved by
    1.7 px, at most 1.08 of bands in place."""
    pixel_noise_px: float = 2.6
    """Longest wavelength at which nothing but what belongs to single pixels is as strong as longer waves."""
    pixel_coherence: float = 0.2
    """Least coherence of both images there of a pattern of single pixels: 0.46 and more."""
    ground_by_pixel: float = 3.0
    """Least ratio of the cross spectrum of longer waves to that there from which ground shows beside the
    pattern: at most 2.5 where the ground cannot be seen, 19 and more of bands without a pattern."""
    drawn_share: float = 0.75
    """Largest part of the way from no displacement to this peak at which tie points are drawn back."""
    beside_px: float = 0.4
    """Least distance of the ground, seen without stripes and waves, from tie points that miss it."""
    beside_scatter: float = 3.0
    """The same in scatters of the points about their median: 4 and more of points drawn by stripes, lines
    or waves; where points follow ground that is bent or turned, they scatter as far as it goes."""
    beside_steps: int = 21
    """How many places are asked from one pixel before its peak to one after, along either axis."""
    beside_z: float = 25.0
    """Least peak of the ground's phase correlation, its standard deviations: 70 and more of ground drawn by
    stripes, at most 17 of bands in place."""
    beside_ratio: float = 1.5
    """Least ratio of this peak to the value at the points, where they lie beyond the width of the peak."""
    specks: SpeckParameters = field(default_factory=SpeckParameters)
    """Those of specks."""


def _structure(values: Float32, valid: Bool, parameters: FrameParameters) -> Float32:
    """Return the (2, rows, cols) orientation of slopes at twice its angle, times their size."""
    band = structure_band(values, parameters.smooth_px)
    x, y = cv2.Sobel(band, cv2.CV_32F, 1, 0), cv2.Sobel(band, cv2.CV_32F, 0, 1)
    inner = cv2.erode(valid.astype(np.uint8), np.ones((2 * round(3 * parameters.smooth_px) + 1,) * 2)) > 0
    return np.asarray(np.stack([x * x - y * y, 2 * x * y]) * (inner / (np.hypot(x, y) + 1e-12)), np.float32)


def share_at(at_px: Float64, frames: Frames, window: int, parameters: FrameParameters) -> float | None:
    """Return the share of the places with structure that fit best at the (2,) displacement `at_px`."""
    one, other, valid = frames
    first, second = _structure(one, valid, parameters), _structure(other, valid, parameters)
    col_px, row_px = np.rint(at_px).astype(int).tolist()
    second = np.roll(second, (-row_px, -col_px), axis=(1, 2))
    reach, step = parameters.reach_px, parameters.step_px
    (rows, cols), margin = one.shape, window // 2 + reach
    at = np.s_[margin : rows - margin : window // 2, margin : cols - margin : window // 2]

    def sums(product: Float32) -> Float32:
        return np.asarray(cv2.boxFilter(product, -1, (window, window), normalize=False)[at])

    power = sums((first**2).sum(axis=0)), (second**2).sum(axis=0)
    scores, offsets = [], range(-reach, reach + 1, step)
    for row, col in ((row, col) for row in offsets for col in offsets):
        shifted = np.roll(second, (-row, -col), axis=(1, 2))
        energy = sums(np.roll(power[1], (-row, -col), axis=(0, 1)))
        scores.append(sums((first * shifted).sum(axis=0)) / np.sqrt(np.maximum(energy, 1e-20)))
    best = np.argmax(scores, axis=0)
    middle, side = len(offsets) // 2, len(offsets)
    at_none = np.maximum(abs(best // side - middle), abs(best % side - middle)) <= 1
    return _share_of_structured(np.asarray(at_none), (power[0], sums(power[1])), parameters)


def _share_of_structured(
    at_none: Bool, powers: Sequence[Float32], parameters: FrameParameters
) -> float | None:
    """Return the share of places that agree, of those with most structure in either image."""
    positive = np.logical_and.reduce([power > 0 for power in powers])
    if np.count_nonzero(positive) * parameters.structured < parameters.min_places:
        return None
    relative = np.max([power[positive] / np.median(power[positive]) for power in powers], axis=0)
    selection = relative >= np.quantile(relative, 1 - parameters.structured)
    return float(at_none[positive][selection].mean())


def rival(frames: Frames, parameters: FrameParameters) -> tuple[float, float] | None:
    """Return the displacement of ground that has moved, from the difference of both, if there is any.

    What stands still cancels in the difference. Ground that has moved by d is in it twice, with opposite
    signs, so that its power is multiplied by 2 - 2 cos(2πfd) at the frequency f: its cepstrum has a negative
    peak at d. The images' own cepstra show whether the ground only repeats.
    """
    rows, cols = frames.one.shape
    first, second = spectra(frames)
    band = _band(frames, parameters)
    crossed = np.conj(first) * second * band
    correlation = crossed.real.sum() / max(
        np.linalg.norm(first * band) * np.linalg.norm(second * band), 1e-12
    )
    if abs(correlation) > parameters.same_correlation:
        return None
    sign = 1.0 if correlation >= 0 else -1.0
    peaks = _cepstrum(first - np.float32(sign) * second, band, cols)
    far = [np.abs(np.fft.fftfreq(side) * side) >= parameters.rival_min_px for side in (rows, cols)]
    distant = far[0][:, None] | far[1]
    at = np.unravel_index(np.argmax(np.where(distant, peaks, 0)), peaks.shape)
    cepstra = peaks, _cepstrum(first, band, cols), _cepstrum(second, band, cols)
    depth, *own_depths = (
        float(cepstrum[at] / (1.4826 * np.median(np.abs(cepstrum[distant])))) for cepstrum in cepstra
    )
    if depth < max(parameters.rival_z, parameters.rival_ratio * max(own_depths)):
        return None
    phase = sign * Phases.of(first, second, band, frames.valid.shape).surface()
    both = [(int(at[0]), int(at[1])), (-int(at[0]) % rows, -int(at[1]) % cols)]
    down, right = max(both, key=lambda place: phase[place])
    return float(right - cols * (2 * right > cols)), float(down - rows * (2 * down > rows))


def near_rival(
    frames: Frames, middle_px: Float64, parameters: FrameParameters, *, on_the_way: bool
) -> tuple[float, float] | None:
    """Return a displacement of the ground too small for the cepstrum, if points at (2,) `middle_px` miss it.

    A pattern of single pixels shows in the finest structure, which correlates best at no displacement.
    Smoothing takes most of it out, and what whole rows and columns have. The rest correlates where the
    ground lies. If `on_the_way`, only points on the way from none to there miss it.
    """
    one, other, valid = frames
    if not _has_common_pattern(one, other, valid, parameters.fine_z):
        return None
    first, second = (scipy.fft.rfft2(_structure(values, valid, parameters)) for values in (one, other))
    surface = scipy.fft.irfft2((np.conj(first) * second).sum(axis=0), one.shape)
    ground_px, height = highest(surface, np.zeros(2), parameters.reach_px)
    least = max(parameters.near_z * surface.std(), parameters.near_ratio * surface[0, 0])
    is_drawn = ground_px @ middle_px < parameters.drawn_share * (ground_px @ ground_px)
    if on_the_way:  # from no displacement to that of the ground
        way = ground_px / max(float(np.hypot(*ground_px)), 1.0)
        is_drawn &= bool(np.hypot(*(middle_px - (middle_px @ way) * way)) <= parameters.pulled_px)
    if height < least or not is_drawn:
        return None
    return float(ground_px[0]), float(ground_px[1])


def ground_beside(
    frames: Frames, displacement_px: Float64, parameters: FrameParameters
) -> tuple[float, float] | None:
    """Return where the ground lies if it lies beside tie points of (n, 2) displacements that agree.

    Rows, columns and waves that stand still draw the points, but are few frequencies. Phase correlation
    counts all alike.

    Parameters
    ----------
    displacement_px : (n, 2) array
        Displacements (col, row) of the tie points, px.
    """
    phases = Phases.of(*spectra(frames), _band(frames, parameters), frames.valid.shape)
    surface, middle_px = phases.surface(), np.median(displacement_px, axis=0)
    place_px, height = highest(np.abs(surface), middle_px, parameters.reach_px)
    if height < parameters.beside_z * surface.std():
        return None
    ground_px, peak = phases.peak_beside(place_px, parameters.beside_steps)
    beside_px = float(np.hypot(*(ground_px - middle_px)))
    scatter_px = float(np.quantile(np.hypot(*(displacement_px - middle_px).T), parameters.most))
    at_points = float(phases.size_at(*middle_px[:, None])[0, 0])
    is_other_peak = beside_px > parameters.finest_px and peak < parameters.beside_ratio * at_points
    is_pattern = np.hypot(*ground_px) < parameters.pulled_px  # a sensor's, which stands still itself
    least_px = max(parameters.beside_px, parameters.beside_scatter * scatter_px)
    if is_pattern or is_other_peak or beside_px < least_px:
        return None
    return float(ground_px[0]), float(ground_px[1])


def _band(frames: Frames, parameters: FrameParameters) -> Bool:
    """Return the frequencies in which ground is sought, without those of whole rows and columns."""
    radius = np.hypot(*frequencies(frames.valid.shape))
    band = (radius < 1 / parameters.finest_px) & (radius > 1 / parameters.coarsest_px)
    return np.asarray(band & inner(frames.valid.shape))


def is_of_single_pixels(frames: Frames, parameters: FrameParameters) -> bool:
    """Return whether all that both images share is as strong in single pixels as in longer waves.

    Ground never is: its spectrum falls by two orders of magnitude between waves of 10 and of 2 px.
    """
    first, second = spectra(frames)
    radius, crossed = np.hypot(*frequencies(frames.valid.shape)), (np.conj(first) * second).real
    band = inner(frames.valid.shape)
    fine = band & (radius > 1 / parameters.pixel_noise_px) & (radius <= 0.5)
    power = float(np.linalg.norm(first[fine]) * np.linalg.norm(second[fine]))
    if crossed[fine].sum() < parameters.pixel_coherence * max(power, 1e-12):
        return False
    longest_px = 8.0 * np.array([1.0, 2.0, 4.0])
    octaves = [
        band & (radius > 1 / coarse) & (radius <= 1 / finer)
        for finer, coarse in itertools.pairwise(longest_px)
    ]
    least = parameters.ground_by_pixel * float(crossed[fine].mean())
    return all(abs(float(crossed[octave].mean())) < least for octave in octaves if octave.any())


def _has_common_pattern(one: Float32, other: Float32, valid: Bool, least_z: float) -> bool:
    """Return whether the finest structure of both correlates best at no displacement."""
    fine = [np.clip(_finest(values, valid), -4, 4) for values in (one, other)]
    inner = np.s_[1:-1, 1:-1]
    offsets = [(row, col) for row in (-1, 0, 1) for col in (-1, 0, 1)]
    products = [float((fine[0] * np.roll(fine[1], offset, axis=(0, 1)))[inner].sum()) for offset in offsets]
    power = np.linalg.norm(fine[0]) * np.linalg.norm(fine[1])
    at_none = products.pop(len(offsets) // 2)
    least = least_z / max(int(np.count_nonzero(valid)), 1) ** 0.5 * float(power)
    return bool(at_none > max(least, *products))


def _finest(values: Float32, valid: Bool) -> Float32:
    """Return the finest structure of an image, robust standard deviations."""
    fine = (values - cv2.GaussianBlur(values, (0, 0), 1)) * valid
    return np.asarray(fine / max(1.4826 * float(np.median(np.abs(fine[valid]))), 1e-9), np.float32)


def common_grey(frames: Frames) -> float:
    """Return the correlation of the grey values without shading, or of their finest structure if higher."""
    one, other, valid = frames
    pairs = (
        tuple(flattened(values, valid)[valid] for values in (one, other)),
        tuple((values - cv2.GaussianBlur(values, (0, 0), 1))[valid] for values in (one, other)),
    )
    return max((float(np.corrcoef(*pair)[0, 1]) for pair in pairs if min(map(np.ptp, pair)) > 0), default=0.0)


def _cepstrum(spectrum: Spectrum, band: Bool, cols: int) -> Float64:
    """Return the (rows, cols) cepstrum of a spectrum in the frequencies that are `band`, its sign turned."""
    power = np.abs(spectrum).astype(np.float64) ** 2
    log = np.log(power + 1e-9 * power.max() + 1e-300)
    shape = len(spectrum), cols
    return np.asarray(-scipy.fft.irfft2(np.where(band, log - log[band].mean(), 0), shape))
