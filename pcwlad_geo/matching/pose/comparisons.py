"""How a patch of the reference is compared with the target: by structure, or by grey values."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np

from pcwlad_geo.matching.channels import normalised_channels
from pcwlad_geo.matching.patches import window_sums
from pcwlad_geo.matching.pose.dependence import rank_polynomials
from pcwlad_geo.matching.pose.parameters import ChanceParameters, PoseParameters
from pcwlad_geo.types import Bool, Float32, Float64


class Comparison(Protocol):
    """What patches are compared by."""

    chance: ChanceParameters

    def planes(self, values: Float32, valid: Bool) -> tuple[Float32, Float32]:
        """Return the (rows, cols, n) planes that are compared, and where they are usable, 1 or 0.

        The (rows, cols) `values` are those of an image, of which the (rows, cols) bool array `valid` counts.
        """

    def norms(self, planes: Float32, usable: Float32) -> Float64:
        """Return by what the windows of the target are normalised, of shape (…, rows, cols).

        The (rows, cols, n) `planes` and the (rows, cols) `usable` are those of the target.
        """

    def surface(self, patch: Float32, usable: Float32, search: Float32, norms: Float64) -> Float64:
        """Return how well a patch of the reference fits at each displacement, (rows, cols).

        The (side, side, n) `patch` and the (side, side) `usable` are of the reference. The (rows + side - 1,
        cols + side - 1, n) `search` and the (…, rows, cols) `norms` are of the target.
        """


class StructureComparison:
    """Correlation of the orientation channels."""

    def __init__(self, shape: tuple[int, int], parameters: PoseParameters) -> None:
        self.chance, self._by = parameters.votes.by_structure, parameters.votes

    def planes(self, values: Float32, valid: Bool) -> tuple[Float32, Float32]:
        """Return (rows, cols, 6) smoothed channels of (rows, cols) `values` and `valid`, see `Comparison`."""
        channels, usable = normalised_channels(values, valid)
        return np.asarray(cv2.GaussianBlur(channels, (0, 0), self._by.blur_px), np.float32), usable

    def norms(self, planes: Float32, usable: Float32) -> Float64:
        """Return (rows, cols) inverse roots of the energy of (rows, cols, 6) `planes`, wherever `usable` is.

        The (rows, cols) `usable` does not count.
        """
        return 1 / np.sqrt(np.maximum(window_sums((planes**2).sum(axis=2), self._by.patch_px), 1e-6))

    def surface(self, patch: Float32, usable: Float32, search: Float32, norms: Float64) -> Float64:
        """Return the (rows, cols) correlation of a (side, side, 6) `patch`, see `Comparison`.

        The (side, side) `usable` does not count; `search` and the (rows, cols) `norms` are of the target,
        `search` of shape (rows + side - 1, cols + side - 1, 6).
        """
        return np.asarray(cv2.matchTemplate(search, patch, cv2.TM_CCORR) * norms)


class GreyComparison:
    """Dependence of the grey values, as `GreyDependence`, in patches of a reference of a `shape`."""

    def __init__(self, shape: tuple[int, int], parameters: PoseParameters) -> None:
        self.chance, self._patch_px = parameters.votes.by_grey_values, parameters.votes.patch_px
        self._reach_px = parameters.grey.reach * max(shape)

    def planes(self, values: Float32, valid: Bool) -> tuple[Float32, Float32]:
        """Return polynomials of the ranks, see `Comparison`: (rows, cols, 2) of (rows, cols) `values`.

        Those of the (rows, cols) bool array `valid` count.
        """
        planes = rank_polynomials(values, valid, self._reach_px)
        return np.ascontiguousarray(planes[..., :2]), np.ascontiguousarray(planes[..., 2])

    def norms(self, planes: Float32, usable: Float32) -> Float64:
        """Return (2, rows, cols) inverse sums of squared deviations of the (rows, cols, 2) `planes`.

        They are summed over the pixels that the (rows, cols) `usable` counts.
        """
        count = np.maximum(window_sums(usable, self._patch_px), 1)
        sums = [
            (window_sums(plane, self._patch_px), window_sums(plane**2, self._patch_px))
            for plane in planes.transpose(2, 0, 1)
        ]
        return np.stack([1 / np.maximum(square - total**2 / count, 1e-3) for total, square in sums])

    def surface(self, patch: Float32, usable: Float32, search: Float32, norms: Float64) -> Float64:
        """Return the (rows, cols) root of the dependence of a (side, side, 2) `patch`, see `Comparison`.

        The (side, side) `usable` tells which of its pixels count; `search`, (rows + side - 1, cols + side -
        1, 2), and `norms`, (2, rows, cols), are of the target.
        """
        dependence = np.zeros(norms.shape[1:])
        mask = usable > 0
        target_planes = [np.ascontiguousarray(plane) for plane in search.transpose(2, 0, 1)]
        for plane in patch.transpose(2, 0, 1):
            # without its mean the patch needs none of the windows that it is compared with
            deviations = np.where(mask, plane - plane[mask].mean(), 0).astype(np.float32)
            energy = max(float((deviations**2).sum()), 1e-3)
            for target_plane, norm in zip(target_planes, norms, strict=True):
                correlation = cv2.matchTemplate(target_plane, deviations, cv2.TM_CCORR)
                dependence += correlation**2 * norm / energy
        return np.sqrt(dependence)
