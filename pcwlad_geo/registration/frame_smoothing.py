"""Frames without a pattern of single pixels that both have: a fixed pattern of a sensor.

It is alike in the finest structure at no displacement, whatever the displacement of the ground, which longer
waves show. Where ground is clear, its tie points are drawn by fractions of a pixel only, and all agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pcwlad_geo.registration.frame_cleaning import CleanedPair, frames_of, read_frames, with_frames
from pcwlad_geo.registration.frame_marks import Frames
from pcwlad_geo.registration.frame_phases import Phases, frequencies, highest, inner, spectra
from pcwlad_geo.registration.result import Pair
from pcwlad_geo.types import Bool, Float32, Float64

NOTE = "the matching leaves out what single pixels of both frames have in common, as a sensor's fixed pattern"
"""What says that frames were smoothed."""


@dataclass(frozen=True, slots=True)
class PatternParameters:
    """How a pattern of single pixels is told from ground, and taken out."""

    side_px: int = 512
    """Side of the part in the middle that is asked."""
    finest_px: float = 2.8
    """Longest wavelength of the finest structure."""
    ground_px: tuple[float, float] = (6.0, 24.0)
    """Wavelengths that show the displacement of the ground."""
    reach_px: int = 12
    """Largest displacement that is looked for along either axis."""
    steps: int = 21
    """How many places are asked from one pixel before a peak to one after, along either axis."""
    ground_z: float = 30.0
    """Least peak of the ground's phase correlation, its standard deviations: 35 and more under a pattern."""
    pattern_z: float = 40.0
    """Least correlation of the finest structure at no displacement, standard deviations of chance: 75 and
    more of a pattern."""
    pattern_ratio: float = 1.5
    """Least ratio of it to that at the displacement of the ground: 1.5 and more of a pattern beside ground
    that has moved by half a pixel; at most 1.3 of bands in place."""
    least_px: float = 0.3
    """Least displacement of the ground that the finest structure tells from none."""
    drawn: tuple[float, float] = (0.15, 0.95)
    """How far on the way from none to the displacement of the ground its tie points lie: of bands in place,
    longer waves may lie half a pixel beside tie points that are right."""
    aside_px: float = 0.3
    """Largest distance of tie points from this way."""
    smooth_px: float = 2.5
    """Standard deviation of the filter that takes the pattern out: of 0.72 px of displacement 0.4 px were
    lost without it, 0.3 with 1 px, 0.08 with 2 px and 0.03 with 3 px."""


def without_pattern(
    pair: Pair,
    points_px: Float64,
    *,
    in_memory: bool,
    parameters: PatternParameters = PatternParameters(),
) -> CleanedPair | None:
    """Return a pair without the pattern of single pixels that draws its tie points; None where none does.

    The (2,) `points_px` are the median displacement (col, row) of the tie points, px. Asked of two rasters of
    the same grid, of which all can be read. The files of the smoothed frames are held `in_memory`, where this
    process alone finds them.
    """
    drawn, distance_px = parameters.drawn, float(np.hypot(*points_px))
    farthest_px = drawn[1] * np.sqrt(2) * (parameters.reach_px + 1) + parameters.aside_px
    if not drawn[0] * parameters.least_px <= distance_px <= farthest_px:
        return None  # wherever the ground is, they are not on the way to it
    middle = read_frames(pair, most_side_px=parameters.side_px)
    ground_px = _ground_beside_pattern(frames_of(*middle), parameters) if middle else None
    if ground_px is None or not _is_drawn(points_px, ground_px, parameters):
        return None
    patches = read_frames(pair)
    if patches is None:
        return None
    smooth = [_smoothed(np.asarray(patch.values, np.float32), patch.valid, parameters) for patch in patches]
    return with_frames(pair, smooth, NOTE, in_memory=in_memory)


def _smoothed(values: Float32, valid: Bool, parameters: PatternParameters) -> Float32:
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), parameters.smooth_px)
    blurred = cv2.GaussianBlur(np.where(valid, values, 0), (0, 0), parameters.smooth_px)
    return np.where(valid, blurred / np.maximum(weight, 1e-3), np.float32(np.nan))


def _is_drawn(points_px: Float64, ground_px: Float64, parameters: PatternParameters) -> bool:
    """Return whether tie points lie on the way from no displacement to that of the ground."""
    share = float(points_px @ ground_px) / float(ground_px @ ground_px)
    aside_px = float(np.hypot(*(points_px - share * ground_px)))
    least, most = parameters.drawn
    return least <= share <= most and aside_px <= parameters.aside_px


def _ground_beside_pattern(frames: Frames, parameters: PatternParameters) -> Float64 | None:
    """Return the (2,) displacement of the ground where the finest structure agrees at none instead."""
    side = min(frames.valid.shape) // 2 * 2
    top, left = ((length - side) // 2 for length in frames.valid.shape)
    square, shape = np.s_[top : top + side, left : left + side], (side, side)
    part = Frames(frames.one[square], frames.other[square], frames.valid[square])
    phases = Phases.of(*spectra(part), inner(shape), shape)
    row, col = frequencies(shape)
    radius = np.hypot(row, col)
    shortest, longest = parameters.ground_px
    band = (radius > 1 / longest) & (radius < 1 / shortest)
    ground_px = _peak_px(replace(phases, crossed=phases.crossed * band), parameters)
    if ground_px is None or np.abs(ground_px).max() < parameters.least_px:
        return None
    fine = inner(shape) & (radius > 1 / parameters.finest_px) & (radius <= 0.5)
    to_ground = np.exp(2j * np.pi * (col * ground_px[0] + row * ground_px[1]))
    chance = np.sqrt(np.count_nonzero(fine) / 2)
    at_none, at_ground = (
        abs(float(crossed[fine].real.sum())) / chance
        for crossed in (phases.crossed, phases.crossed * to_ground)
    )
    return ground_px if at_none > max(parameters.pattern_z, parameters.pattern_ratio * at_ground) else None


def _peak_px(phases: Phases, parameters: PatternParameters) -> Float64 | None:
    """Return the (2,) displacement (col, row) at which phases agree; None where they hardly do."""
    surface = phases.surface()
    place_px, height = highest(np.abs(surface), np.zeros(2), parameters.reach_px)
    if height < parameters.ground_z * surface.std():
        return None
    return phases.peak_beside(place_px, parameters.steps)[0]
