"""One image of a search: harmonics of its orientation channels, at several resolutions, rotated, in cells.

Rotating an image rotates its orientation channels and shifts them cyclically, so that the channels of one
resolution serve all rotations. With harmonics of the orientation the cyclic shift is a product with a phase.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import cv2
import numpy as np
import scipy.fft

from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.estimation.transforms import affine_matrix, rotation, scale_of
from pcwlad_geo.matching.channels import normalised_channels
from pcwlad_geo.matching.kernels.phase_congruency import ORIENTATIONS
from pcwlad_geo.matching.kernels.pose_search import LAYER_HARMONICS, MASK_STEP
from pcwlad_geo.matching.pose.parameters import POSE, StructureParameters
from pcwlad_geo.matching.pose.resampling import shrunk, warped
from pcwlad_geo.types import Bool, Float32, Float64

_ROOT_2 = math.sqrt(2.0)
_ANGLES = np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS
_HARMONICS = np.stack(
    [
        np.ones(ORIENTATIONS),
        _ROOT_2 * np.cos(2 * _ANGLES),
        _ROOT_2 * np.sin(2 * _ANGLES),
        _ROOT_2 * np.cos(4 * _ANGLES),
        _ROOT_2 * np.sin(4 * _ANGLES),
    ]
).astype(np.float32)
"""Mean, second and fourth harmonic of the orientations; the sixth has no phase."""

Layer: TypeAlias = tuple[list[Float32], Float64]
"""Harmonics and then what is usable, as (rows, cols, 3 or 4) arrays of several of these planes, which are
warped together, and the (3, 3) matrix from px."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """One image in cells, transformed for the correlation."""

    spectra: Float32
    """(harmonics, 2, rows, half the cols) real and imaginary part."""
    mask: Float32
    """(1, 2, …) spectrum of the mask, of a coarser lattice."""
    shape: tuple[int, int]
    """Rows and columns before the zeros that the transform adds."""
    area: float
    """Number of valid cells."""
    from_px: Float64
    """(3, 3) px of the image to cells, array indices."""


@dataclass(slots=True, eq=False)
class PoseImage:
    """One image, with its channels at the resolutions that were asked for so far."""

    values: Float32
    valid: Bool
    parameters: StructureParameters = POSE.structure
    _levels: dict[int, tuple[Float32, Float32, Float64]] = field(default_factory=dict)
    _averages: dict[tuple[float, tuple[float, ...]], list[Layer]] = field(default_factory=dict)

    @property
    def side_px(self) -> int:
        """Longer side."""
        return int(max(self.values.shape))

    @property
    def middle_px(self) -> Float64:
        """(2,) middle (col, row), array indices."""
        return (np.array(self.values.shape[::-1]) - 1) / 2

    def canvas_side(self, side_cells: float) -> int:
        """Return the side of a square that holds the image however it is rotated, cells."""
        rows, cols = self.values.shape
        return math.ceil(math.hypot(rows, cols) * side_cells / self.side_px) + 1

    def rotations(
        self, side_cells: float, size: int, angles_rad: Sequence[float], per_cell: Sequence[float]
    ) -> Iterator[Cells]:
        """Yield the image with its longer side of so many cells, rotated about its middle by angles."""
        canvas = (self.canvas_side(side_cells),) * 2
        layers = self.averaged(side_cells, per_cell)
        for angle_rad in angles_rad:
            yield self._in_cells(layers, side_cells, size, rotation(angle_rad), canvas, angle_rad)

    def stretched(
        self, side_cells: float, size: int, stretches: Sequence[Float64], per_cell: Sequence[float]
    ) -> Iterator[Cells]:
        """Yield the image with its longer side of so many cells, deformed by (2, 2) matrices `stretches`."""
        per_px = side_cells / self.side_px
        layers = self.averaged(side_cells, per_cell)
        for stretch in stretches:
            cols, rows = (max(8, round(n * per_px)) for n in np.abs(stretch) @ self.values.shape[::-1])
            yield self._in_cells(layers, side_cells, size, stretch, (rows, cols), 0.0)

    def _in_cells(
        self,
        layers: Sequence[Layer],
        side_cells: float,
        size: int,
        change: Float64,
        shape: tuple[int, int],
        angle_rad: float,
    ) -> Cells:
        """Return layers, changed by a (2, 2) matrix and orientations turned, in the middle of a shape."""
        linear = side_cells / self.side_px * change
        from_px = affine_matrix(linear, (np.array(shape[::-1]) - 1) / 2 - linear @ self.middle_px)
        values = []
        for packs, to_map in layers:
            warp = from_px @ inverse(to_map)
            planes = np.concatenate([warped(pack, warp, shape).transpose(2, 0, 1) for pack in packs])
            mask = (planes[-1] > 0.5).astype(np.float32)
            values.append(_turned(planes[:-1] * mask, angle_rad))
        spectra = _spectra(np.concatenate(values), (size, size))
        return Cells(spectra, _mask_spectrum(mask, size), shape, float(mask.sum()), from_px)

    def averaged(self, side_cells: float, per_cell: Sequence[float]) -> list[Layer]:
        """Return harmonics averaged over half a cell, so that nothing between two samples is missed.

        There is a layer for each number of px `per_cell`, with which channels are computed. Of several, each
        has fewer harmonics, and the same weight. The last ones asked for are remembered.
        """
        key = side_cells, tuple(per_cell)
        layers = self._averages.pop(key, None)
        layers = layers or [self._layer(side_cells, per_cell, count) for count in per_cell]
        self._averages[key] = layers
        if len(self._averages) > self.parameters.remembered:
            del self._averages[next(iter(self._averages))]
        return layers

    def _layer(self, side_cells: float, per_cell: Sequence[float], count: float) -> Layer:
        maps, usable, to_map = self._level(side_cells * count / self.parameters.pixels_per_cell[0])
        sigma_px = 0.5 * scale_of(to_map) * self.side_px / side_cells
        several = len(per_cell) > 1
        harmonics = maps[:LAYER_HARMONICS] if several else maps
        planes = [np.asarray(cv2.GaussianBlur(plane, (0, 0), sigma_px), np.float32) for plane in harmonics]
        if several:
            deviation = np.float32(max(float(np.std(planes)), 1e-6))
            planes = [plane / deviation for plane in planes]
        planes.append(usable)
        pack = LAYER_HARMONICS + 1 if several else 3
        starts = range(0, len(planes), pack)
        return [np.stack(planes[start : start + pack], axis=-1) for start in starts], to_map

    def _level(self, side_cells: float) -> tuple[Float32, Float32, Float64]:
        """Return channels, usable px and the (3, 3) matrix from px, at the nearest half octave."""
        cells, per_cell = self.parameters.cells, self.parameters.pixels_per_cell[0]
        step = round(2 * math.log2(side_cells / cells))
        if step not in self._levels:
            factor = min(1.0, per_cell * cells * 2 ** (step / 2) / self.side_px)
            values, valid, to_map = shrunk(self.values, self.valid, factor)
            channels, usable = normalised_channels(values, valid)
            maps = np.einsum("rco,ho->hrc", channels, _HARMONICS / ORIENTATIONS)
            self._levels[step] = np.ascontiguousarray(maps), usable, to_map
        return self._levels[step]


def _turned(maps: Float32, angle_rad: float) -> Float32:
    """Rotate the orientations of (harmonics, rows, cols) maps; rows count downwards, orientations upwards."""
    if angle_rad == 0.0:
        return maps
    result = maps.copy()
    for index, order in ((1, 2), (3, 4))[: len(maps) // 2]:
        cos, sin = math.cos(order * angle_rad), -math.sin(order * angle_rad)
        result[index] = cos * maps[index] - sin * maps[index + 1]
        result[index + 1] = sin * maps[index] + cos * maps[index + 1]
    return result


def _spectra(maps: Float32, shape: tuple[int, int]) -> Float32:
    """Transform (n, rows, cols) maps; return (n, 2, rows, half the cols), the real and the imaginary part."""
    spectra = scipy.fft.rfft2(maps, shape)
    return np.stack([spectra.real, spectra.imag], axis=1)


def _mask_spectrum(mask: Float32, size: int) -> Float32:
    """Transform a mask summed over blocks, for a count of the overlap that may be coarse."""
    padded = np.zeros((size, size), np.float32)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    sums = padded.reshape((size // MASK_STEP, MASK_STEP) * 2).sum(axis=(1, 3))
    return _spectra(sums[None], sums.shape)
