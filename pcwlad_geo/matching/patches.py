"""Patches of an image that are matched one by one, and agree on one similarity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.estimation.transforms import SimilarityTransform
from pcwlad_geo.matching.channels import Channels
from pcwlad_geo.matching.coarse import parabola_offset
from pcwlad_geo.types import Bool, Float32, Float64, Index


@dataclass(frozen=True, slots=True)
class PatchParameters:
    """How patches are matched, and when they agree."""

    sides_px: tuple[int, int] = (32, 48)
    """Range of the side of a patch; small overlaps get smaller patches, so that enough of them can
    vote."""
    count: int = 64
    """Number of patches at which the side of a patch aims."""
    radius_px: int = 12
    """Search radius of a patch around the candidate, enough for parallax and a few per cent of scale."""
    least_valid: float = 0.6
    """Least share of a patch that must be valid."""
    least: int = 8
    """Least number of patches that can support a shift."""
    least_base_px: int = 96
    """Least distance of two patches from which a similarity is derived."""
    tolerance_px: float = 2.0
    """A patch agrees if its displacement is this close to that of the similarity."""
    largest_distortion: float = 0.06
    """Largest deviation of a similarity from the identity: change of scale and rotation, radians,
    combined."""


PATCHES: Final = PatchParameters()
"""Those that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Disjoint patches of a reference, each matched on its own with a target."""

    centres_px: Float64
    """(n, 2) centres (col, row) in the reference, corner-based."""
    displacements_px: Float64
    """(n, 2) (col, row), from the start."""
    agrees: NDArray[np.bool_]
    """(n,) mask of those that agree with the similarity, near the identity, of most support."""

    @property
    def count(self) -> int:
        """Number of patches."""
        return len(self.centres_px)

    @property
    def agreeing(self) -> int:
        """Number of patches that agree."""
        return int(np.count_nonzero(self.agrees))

    @staticmethod
    def matched(
        reference: tuple[Float32, Float32],
        target: tuple[Float32, Float32],
        start_xy: NDArray[np.intp],
        by: PatchParameters = PATCHES,
    ) -> Patches:
        """Match all patches of the reference within a few pixels of a start.

        The `reference` and the `target` are (rows, cols, 6) channels, and a (rows, cols) array of 1 or 0
        where they are usable or not, see `normalised_channels`. The (2,) `start_xy` is (col, row) target px
        minus reference px.
        """
        centres, displacements = _match_patches(Channels(*reference), Channels(*target), start_xy, by)
        agrees = _agreement(centres, displacements, by) if len(centres) else np.zeros(0, bool)
        return Patches(centres, displacements, agrees)

    def similarity(self) -> tuple[Float64, float]:
        """Fit a similarity to the patches that agree.

        Return the (3, 3) matrix that gives target px minus the start for reference px, array indices, and the
        distance from it within which 95 % of the agreeing patches lie, px.
        """
        xy = self.centres_px[self.agrees] - 0.5
        target_xy = xy + self.displacements_px[self.agrees]
        similarity = SimilarityTransform.fit(xy, target_xy)
        spread_px = np.percentile(np.hypot(*(similarity(xy) - target_xy).T), 95)
        return similarity.matrix, float(spread_px)


def window_sums(plane: Float32, side_px: int) -> Float64:
    """Return the sums over all windows of `side_px` of the (rows, cols) `plane`, (rows - side + 1, …)."""
    integral = np.asarray(cv2.integral(plane, sdepth=cv2.CV_64F), np.float64)
    last, first = integral[:, side_px:], integral[:, :-side_px]
    result: Float64 = last[side_px:] - last[:-side_px] - first[side_px:] + first[:-side_px]
    return result


def _match_patches(
    reference: Channels, target: Channels, start_xy: Index, by: PatchParameters
) -> tuple[Float64, Float64]:
    """Return the centres (n, 2) and displacements (n, 2), both (col, row), of disjoint patches."""
    rows, cols = reference.valid.shape
    radius = by.radius_px
    corner, size = start_xy[::-1] - radius, (rows + 2 * radius, cols + 2 * radius)
    values, valid = _crop(target.values, corner, size), _crop(target.valid, corner, size)
    overlap = float((reference.valid * valid[radius:-radius, radius:-radius]).sum())
    patch_px = int(np.clip(np.sqrt(overlap / by.count), *by.sides_px))
    energy, count = (window_sums(plane, patch_px) for plane in ((values**2).sum(axis=2), valid))
    side, least = 2 * radius + 1, by.least_valid * patch_px**2
    centres, displacements = [], []
    for r in range(0, rows - patch_px + 1, patch_px):
        for c in range(0, cols - patch_px + 1, patch_px):
            patch, shifts = np.s_[r : r + patch_px, c : c + patch_px], np.s_[r : r + side, c : c + side]
            if min(reference.valid[patch].sum(), count[shifts].min()) < least:
                continue
            search = values[r : r + patch_px + side - 1, c : c + patch_px + side - 1]
            cross = cv2.matchTemplate(search, reference.values[patch], cv2.TM_CCORR)
            centres.append((c + patch_px / 2, r + patch_px / 2))
            displacements.append(_peak_xy(cross / np.sqrt(np.maximum(energy[shifts], 1e-6)), radius))
    return np.array(centres).reshape(-1, 2), np.array(displacements).reshape(-1, 2)


def _crop(values: Float32, corner: Index, size: tuple[int, int]) -> Float32:
    """Cut out a window that may reach over the border, where it is 0."""
    out = np.zeros((*size, *values.shape[2:]), np.float32)
    (top, first), (rows, cols) = corner.tolist(), values.shape[:2]
    r0, r1 = max(top, 0), min(top + size[0], rows)
    c0, c1 = max(first, 0), min(first + size[1], cols)
    if r0 < r1 and c0 < c1:
        out[r0 - top : r1 - top, c0 - first : c1 - first] = values[r0:r1, c0:c1]
    return out


def _peak_xy(surface: Float64, radius_px: int) -> tuple[float, float]:
    """Return the (col, row) displacement of the peak, by parabolas through its neighbours."""
    r, c = np.unravel_index(int(surface.argmax()), surface.shape)
    last = surface.shape[0] - 1
    x, y = float(c - radius_px), float(r - radius_px)
    if 0 < r < last:
        y += parabola_offset(*surface[r - 1 : r + 2, c])
    if 0 < c < last:
        x += parabola_offset(*surface[r, c - 1 : c + 2])
    return x, y


def _agreement(centres: Float64, displacements: Float64, by: PatchParameters) -> Bool:
    """Return the mask of the patches that agree with the similarity, near the identity, of most support."""
    z, d = centres @ (1, 1j), displacements @ (1, 1j)
    z = z - z.mean()
    first, second = np.nonzero(np.abs(z[:, None] - z) >= by.least_base_px)
    slope = (d[first] - d[second]) / (z[first] - z[second])
    small = np.abs(slope) <= by.largest_distortion
    slope = np.concatenate([np.zeros(len(d)), slope[small]])
    origin = np.concatenate([d, d[first[small]] - slope[len(d) :] * z[first[small]]])
    agrees = np.abs(d - origin[:, None] - slope[:, None] * z) <= by.tolerance_px
    return np.asarray(agrees[int(agrees.sum(axis=1).argmax())])
