"""Images moved by known amounts: shifted, turned or bent, and the error of doing so."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import scipy.fft
import scipy.ndimage

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.dense import positions
from pcwlad_geo.correction.proof_result import Move
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.matching.gaps import fill_smoothly
from pcwlad_geo.matching.kernels.library import fast_even
from pcwlad_geo.registration.proof.parameters import ProofParameters
from pcwlad_geo.types import Bool, Float32, Float64


def moves_of(
    effort: Effort, window_px: int, parameters: ProofParameters = ProofParameters()
) -> tuple[Move, ...]:
    """Return the moves: shifts in all phases of a pixel along both axes, then a turned and a bent one."""
    count = parameters.of(parameters.shifts, effort)
    phase = (np.arange(count) + 0.5) / count - 0.5
    rows = (np.arange(count) * (3 if count == 8 else 7) + count // 2) % count  # each phase once
    shifts = [Move("shift", (float(col), float(phase[row]))) for col, row in zip(phase, rows, strict=True)]
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

    def __init__(
        self, values: Float32 | Float64, valid: Bool, parameters: ProofParameters = ProofParameters()
    ) -> None:
        self.values, self.valid = np.asarray(values, np.float64), valid
        self._shape, self._frame_px = values.shape, parameters.frame_px
        side = 2 * parameters.edge_px + 1
        inner = cv2.erode(valid.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0)
        self._inner = np.asarray(inner, bool)
        filled = np.asarray(fill_smoothly(self.values, valid), np.float64)
        self._mean = float(filled.mean())
        ramp = np.sin(np.linspace(0, np.pi / 2, self._frame_px + 2)[1:-1]) ** 2
        down, across = (np.concatenate([ramp, np.ones(length), ramp[::-1]]) for length in self._shape)
        framed = np.pad(filled - self._mean, self._frame_px, mode="symmetric") * down[:, None] * across
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
            frame_px = self._frame_px
            values = plane[frame_px : frame_px + rows, frame_px : frame_px + cols]
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
        at = 2 * (at_px - 0.5 + self._frame_px)
        values = scipy.ndimage.map_coordinates(fine, (at[..., 1], at[..., 0]), order=5, mode="nearest")
        return np.asarray(values, np.float64)

    def _valid_at(self, col_px: Float64, row_px: Float64) -> Bool:
        """Return whether places, of arrays that broadcast, are at least `edge_px` within valid pixels."""
        col, row = (np.floor(place).astype(np.intp) for place in (col_px, row_px))
        rows, cols = self._shape
        inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
        return np.asarray(inside & self._inner[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)])


def resampling_error_px(
    resampler: Resampler, noise: float, moves: Sequence[Move], parameters: ProofParameters
) -> float:
    """Return the RMS error of the resampling, on an image that is known at every place.

    It has the spectrum of the image of the `resampler`, whose `noise` is a standard deviation.
    """
    random, side, width = (
        np.random.default_rng([0, len(moves)]),
        parameters.wave_side_px,
        parameters.wave_window_px,
    )
    frequency = resampler.frequencies(parameters.waves, noise, random)
    phase = random.uniform(0, 2 * np.pi, parameters.waves)
    centre = np.full(2, side / 2)
    at = positions(np.arange(side) + 0.5, np.arange(side) + 0.5)

    def image(places: Float64) -> Float64:
        waves = np.cos(2 * np.pi * places @ frequency.T + phase)
        return np.asarray(waves.sum(axis=1).reshape(side, side), np.float64)

    known_image = Resampler(image(at), np.ones((side, side), bool), parameters)
    squares = []
    for move in (moves[0], *(move for move in moves if move.kind != "shift")):
        values, _ = known_image.moved(move, centre)
        truth = image(move.source(at, centre))
        slopes = np.stack([np.gradient(truth, axis=axis) for axis in (1, 0)], axis=-1)
        inner = range(width // 2, side - width, width // 2)
        for row, col in ((row, col) for row in inner for col in inner):
            part = (slice(row, row + width), slice(col, col + width))
            off = least_squares(slopes[part].reshape(-1, 2), (values - truth)[part].ravel())
            squares.append((off**2).sum())
    return float(np.sqrt(np.mean(squares)))
