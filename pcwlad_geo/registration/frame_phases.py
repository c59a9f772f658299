"""The displacement of two images of one size by the phases of their spectra."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pcwlad_geo.registration.frame_marks import Frames, SpeckParameters, filled
from pcwlad_geo.types import Bool, Float32, Float64

Spectrum = NDArray[np.complex64]
"""That of a real image: (rows, cols // 2 + 1), as `rfft2` has it."""


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """The phases of a cross spectrum, 0 at frequencies that do not count: all that do count alike."""

    crossed: Spectrum
    shape: tuple[int, int]
    """Rows and columns of the images."""

    @staticmethod
    def of(first: Spectrum, second: Spectrum, band: Bool, shape: tuple[int, int]) -> Phases:
        """Return the phases of two spectra at some frequencies.

        The spectra `first` and `second` are (rows, cols // 2 + 1), of images of that `shape`. So is the
        (rows, cols // 2 + 1) mask `band` of the frequencies.
        """
        crossed = np.conj(first) * second
        return Phases(crossed / (np.abs(crossed) + np.float32(1e-9)) * band, shape)

    def surface(self) -> Float32:
        """Return the (rows, cols) correlation by displacement."""
        return np.asarray(scipy.fft.irfft2(self.crossed, self.shape))

    def size_at(self, col_px: Float64, row_px: Float64) -> Float64:
        """Return the (n, m) size of the correlation at (m,) `col_px` and (n,) `row_px`, also between pixels.

        Its sign does not count, as bands may be each other's negative.
        """
        row, col = frequencies(self.shape)
        down, right = np.exp(2j * np.pi * row_px[:, None] * row.T), np.exp(2j * np.pi * col.T * col_px)
        return np.asarray(np.abs((down @ self.crossed @ right).real), np.float64)

    def peak_beside(self, place_px: Float64, steps: int) -> tuple[Float64, float]:
        """Return the (2,) place (col, row) and the size of the highest correlation beside a (2,) `place_px`.

        It is the highest of `steps` places along each axis, from a pixel before to one after.
        """
        col_px, row_px = place_px[:, None] + np.linspace(-1, 1, steps)
        sizes = self.size_at(col_px, row_px)
        row, col = np.unravel_index(int(sizes.argmax()), sizes.shape)
        return np.array([col_px[col], row_px[row]]), float(sizes[row, col])


def highest(surface: Float32, middle_px: Float64, reach_px: int) -> tuple[Float64, float]:
    """Return the (2,) place (col, row) and the value of the highest place of a (rows, cols) `surface`.

    It lies at most `reach_px` from the (2,) `middle_px` along either axis.
    """
    first_col, first_row = (np.rint(middle_px).astype(int) - reach_px).tolist()
    side = 2 * reach_px + 1
    window = np.roll(surface, (-first_row, -first_col), axis=(0, 1))[:side, :side]
    row, col = np.unravel_index(int(window.argmax()), window.shape)
    return np.array([int(col) + first_col, int(row) + first_row], np.float64), float(window[row, col])


def frequencies(shape: tuple[int, int]) -> tuple[Float64, Float64]:
    """Return the (rows, 1) and the (1, cols // 2 + 1) frequencies of a spectrum along rows and columns."""
    rows, cols = shape
    return scipy.fft.fftfreq(rows)[:, None], scipy.fft.rfftfreq(cols)[None]


def inner(shape: tuple[int, int]) -> Bool:
    """Return the (rows, cols // 2 + 1) frequencies of a spectrum but those of whole rows and columns."""
    row, col = frequencies(shape)
    return np.asarray((np.abs(row) > 2 / shape[0]) & (col > 2 / shape[1]))


def spectra(frames: Frames) -> tuple[Spectrum, Spectrum]:
    """Return the (rows, cols // 2 + 1) spectra of both without shading, tapered to their borders."""
    rows, cols = (np.hanning(side).astype(np.float32) for side in frames.valid.shape)
    first, second = (
        scipy.fft.rfft2(flattened(values, frames.valid) * rows[:, None] * cols)
        for values in (frames.one, frames.other)
    )
    return first, second


def flattened(values: Float32, valid: Bool) -> Float32:
    """Return (rows, cols) `values` without shading and what whole rows or columns have.

    They are in standard deviations. Those that are not (rows, cols) `valid` are filled from around them, or
    their outlines would agree in both images.
    """
    if not valid.any():
        return np.zeros_like(values)
    whole = filled(values, ~valid, SpeckParameters())
    flat = whole - cv2.GaussianBlur(whole, (0, 0), 12)
    flat -= np.median(flat, axis=0)
    flat -= np.median(flat, axis=1)[:, None]
    return np.asarray(np.clip(flat / max(float(flat.std()), 1e-9), -4, 4), np.float32)
