"""Search the shift between two images of different modality without any prior, and judge it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.special import bdtrc

from pcwlad_geo.matching.coarse import parabola_offset
from pcwlad_geo.matching.kernels.library import fast_even
from pcwlad_geo.matching.kernels.phase_congruency import ORIENTATIONS
from pcwlad_geo.matching.maps import oriented_phase_congruency, scene_epsilon
from pcwlad_geo.matching.prepare import fill_smoothly
from pcwlad_geo.types import Bool, Float32, Float64, Index

MIN_PROBABILITY: Final = 1e-300
"""Least probability whose logarithm is taken; smaller ones may have underflowed to 0."""


def evidence_against_chance(agreeing: int, places: int, chance: float) -> float:
    """Return -log10 of the probability that at least `agreeing` of n `places` agree by chance (binomial).

    An a contrario detection, doi:10.1023/A:1026593302236. A place agrees by chance with the probability
    `chance`, independent of the others.
    """
    if agreeing < 1:
        return 0.0
    return float(-np.log10(max(float(bdtrc(agreeing - 1, places, chance)), MIN_PROBABILITY)))


FINEST_SIDE_PX: Final = 512
"""Approximate longer side of the smaller image at the finest level; modalities share coarse structure."""
LARGEST_SIDE_PX: Final = 1200
"""Longest side of the larger image at the finest level."""
LEVELS: Final = 3
"""Number of resolution levels, each half as fine as the one before."""
MIN_OVERLAP: Final = 0.25
"""Least overlap of a shift, as a share of the smaller image's valid area."""
PADDING_PX: Final = 16
"""Width of the mirrored border that the filters need, their longest wavelength."""
EDGE_PX: Final = 4
"""Channels are not used this close to the border of the image."""
NODATA_EDGE_PX: Final = 8
"""Channels are not used this close to invalid pixels."""
NORMALISATION_PX: Final = 33
"""Side of the window whose mean and deviation normalise the channels."""
BLUR_SIGMA_PX: Final = 1.0
"""Sigma of the Gaussian that smooths the channels."""
CANDIDATES_PER_LEVEL: Final = 3
"""Number of peaks of the correlation that each coarse level proposes."""
PEAK_CLEARANCE_PX: Final = 5
"""Shifts within this distance of a peak, per axis, belong to it."""

PATCH_SIDES_PX: Final = (32, 48)
"""Range of the side of a patch; small overlaps get smaller patches, so that enough of them can vote."""
PATCHES_WANTED: Final = 64
"""Number of patches at which the side of a patch aims."""
PATCH_RADIUS_PX: Final = 12
"""Search radius of a patch around the candidate, enough for parallax and a few per cent of scale."""
MIN_VALID: Final = 0.6
"""Least share of a patch that must be valid."""
MIN_PATCHES: Final = 8
"""Least number of patches that can support a shift."""
MIN_BASE_PX: Final = 96
"""Least distance of two patches from which a similarity is derived."""
TOLERANCE_PX: Final = 2.0
"""A patch agrees if its displacement is this close to that of the similarity."""
LARGEST_DISTORTION: Final = 0.06
"""Largest deviation of a similarity from the identity: change of scale and rotation, radians, combined."""
AGREEING_BY_CHANCE: Final = 0.1
"""Share of patches of unrelated images that agree with the best similarity and candidate, as measured."""
MIN_SIGNIFICANCE: Final = 5.0
"""Least significance, -log10 of the probability of chance, of an accepted shift."""
MIN_DISTINCTNESS: Final = 0.25
"""Least distinctness of an accepted shift from its best rival."""


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The shift found, and how well it is supported."""

    shift_xy: tuple[float, float]
    """(col, row) target minus reference array index, px: the middle of what the patches found."""
    spread_px: float
    """Distance from the shift within which 95 % of the agreeing patches lie: parallax, scale and rotation."""
    patches: int
    """Number of patches that were matched."""
    agreeing: int
    """Number of patches that agree on the shift."""
    significance: float
    """-log10 of the probability that as many patches agree by chance."""
    distinctness: float
    """1 minus the share of agreeing patches of the best rival elsewhere over that of the shift, 0 to 1."""
    accepted: bool
    """Whether significance and distinctness are above their thresholds."""


@dataclass(frozen=True, slots=True, eq=False)
class _Channels:
    """Orientation channels of one image at one level, zero where not valid."""

    values: Float32
    """(rows, cols, 6)."""
    valid: Float32
    """(rows, cols) 1 or 0."""


@dataclass(frozen=True, slots=True, eq=False)
class _Vote:
    """How many patches support one candidate, at the finest level."""

    shift_xy: Float64
    spread_px: float
    patches: int
    agreeing: int

    @property
    def share(self) -> float:
        return self.agreeing / max(self.patches, MIN_PATCHES)

    @property
    def significance(self) -> float:
        few = self.patches < MIN_PATCHES
        return 0.0 if few else evidence_against_chance(self.agreeing, self.patches, AGREEING_BY_CHANCE)


def search_shift(
    reference: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    reference_valid: Bool,
    target_valid: Bool,
    *,
    max_shift_px: float | None = None,
) -> SearchResult:
    """Find the shift between two images of the same resolution, to about 1 px.

    Parameters
    ----------
    reference, target : (rows, cols) float array
        The shapes may differ, best at most about 1024 px a side; the values of invalid pixels are ignored.
    reference_valid, target_valid : (rows, cols) bool array
        True where a pixel of the image is valid.
    max_shift_px : float, optional
        Largest shift per axis that is tried (patches may add a few pixels); by default all shifts with which
        a quarter of the smaller image overlaps.

    Returns
    -------
    SearchResult
        Not accepted, with shift (0, 0), where nothing could be compared.

    Notes
    -----
    Structure common to both images is taken for the ground: a common pixel pattern (two frames of one
    flawed sensor, a burnt-in overlay) stronger than the scene is accepted, at shift 0.

    References
    ----------
    .. [1] Padfield, D. (2012), doi:10.1109/TIP.2011.2181402 (masked normalised cross-correlation).
    """
    sides = max(reference.shape), max(target.shape)
    factor = max(1, round(min(sides) / FINEST_SIDE_PX), -(-max(sides) // LARGEST_SIDE_PX))
    finest = _channels(reference, reference_valid, factor), _channels(target, target_valid, factor)
    candidates: list[tuple[float, float]] = []
    for level in range(1, LEVELS):
        step = factor * 2**level
        pair = _channels(reference, reference_valid, step), _channels(target, target_valid, step)
        limit = np.inf if max_shift_px is None else max_shift_px / step
        candidates += [(x * 2**level, y * 2**level) for x, y in _propose(*pair, limit)]
    votes = [_vote(*finest, np.array(candidate)) for candidate in _distinct(candidates)]
    return _judge(votes, factor)


def _channels(image: NDArray[np.floating[Any]], valid: Bool, factor: int) -> _Channels:
    """Decimate an image and compute its locally normalised orientation channels."""
    return _Channels(*normalised_channels(*_decimate(image, valid, factor)))


def normalised_channels(values: Float32, known: NDArray[np.bool_]) -> tuple[Float32, Float32]:
    """Compute the orientation channels of an image, normalised by those around them.

    For the (rows, cols) float32 `values`, of which those in the (rows, cols) bool array `known` are valid,
    return the (rows, cols, 6) float32 channels, zero where not usable, and a (rows, cols) float32 array that
    is 1 where a channel is not disturbed by the border or by invalid pixels, else 0.
    """
    rows, cols = values.shape
    epsilon = scene_epsilon(values, known)
    if epsilon == 0.0:
        return np.zeros((rows, cols, ORIENTATIONS), np.float32), np.zeros((rows, cols), np.float32)
    sides = [fast_even(n + 2 * PADDING_PX) for n in (rows, cols)]
    below, right = sides[0] - rows - PADDING_PX, sides[1] - cols - PADDING_PX
    filled = np.asarray(fill_smoothly(values, known), np.float32)
    border = PADDING_PX, below, PADDING_PX, right
    padded: Float32 = np.asarray(cv2.copyMakeBorder(filled, *border, cv2.BORDER_REFLECT_101), np.float32)
    maps = oriented_phase_congruency(padded, epsilon)[:, PADDING_PX:-below, PADDING_PX:-right]
    usable = _usable(known)
    return _normalise(np.ascontiguousarray(maps.transpose(1, 2, 0)), usable), usable


def _decimate(image: NDArray[np.floating[Any]], valid: Bool, factor: int) -> tuple[Float32, Bool]:
    """Average the valid pixels of every block; a block counts if half of it is valid."""
    rows, cols = (max(n // factor, 1) for n in image.shape)
    inside = np.s_[: rows * factor, : cols * factor]
    blocks = (rows, -1, cols, min(factor, image.shape[1]))
    weight = valid[inside].reshape(blocks).sum(axis=(1, 3))
    total = np.where(valid[inside], image[inside], 0).reshape(blocks).sum(axis=(1, 3), dtype=np.float64)
    known = 2 * weight >= factor**2
    return (total / np.maximum(weight, 1)).astype(np.float32), known


def _usable(valid: Bool) -> Float32:
    """Return the pixels, 1 or 0, whose filters do not reach over the edge of the valid area or the image."""
    side = 2 * NODATA_EDGE_PX + 1
    eroded = cv2.erode(valid.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=1)
    result = np.zeros(valid.shape, np.float32)
    inner = np.s_[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX]
    result[inner] = eroded[inner]
    return result


def _normalise(maps: Float32, usable: Float32) -> Float32:
    """Blur, subtract the local mean of each channel and divide all by the common local deviation.

    So large differences of texture, brightness or vignetting do not correlate, and every part of the image
    has the same weight.
    """
    maps = np.asarray(cv2.GaussianBlur(maps, (0, 0), BLUR_SIGMA_PX), np.float32)
    box = (NORMALISATION_PX, NORMALISATION_PX)
    weight = np.maximum(cv2.blur(usable, box, borderType=cv2.BORDER_CONSTANT), 1e-6)[..., None]
    mean = cv2.blur(maps * usable[..., None], box, borderType=cv2.BORDER_CONSTANT) / weight
    centred = (maps - mean) * usable[..., None]
    square = (centred**2).sum(axis=2)
    local = cv2.blur(square, box, borderType=cv2.BORDER_CONSTANT) / weight[..., 0]
    floor = square.sum() / max(float(usable.sum()), 1.0)
    deviation = np.sqrt(local + np.float32(0.1 * floor + 1e-12))
    return np.asarray(centred / deviation[..., None], np.float32)


def _propose(reference: _Channels, target: _Channels, limit: float) -> list[tuple[float, float]]:
    """Return the (col, row) shifts of the highest peaks of the masked correlation at one level."""
    score = _scores(reference, target, limit)
    rows, cols = reference.valid.shape
    found = []
    for _ in range(CANDIDATES_PER_LEVEL):
        r, c = np.unravel_index(int(score.argmax()), score.shape)
        if not score[r, c] > 0:
            break
        found.append((float(c - (cols - 1)), float(r - (rows - 1))))
        score[_around(int(r), int(c))] = -np.inf
    return found


def _around(row: int, col: int) -> tuple[slice, slice]:
    """Return the part of an array that belongs to a peak."""
    k = PEAK_CLEARANCE_PX
    return slice(max(row - k, 0), row + k + 1), slice(max(col - k, 0), col + k + 1)


def _scores(reference: _Channels, target: _Channels, limit: float = np.inf) -> Float64:
    """Return the masked correlation times the root of the overlap; -inf where no shift is allowed.

    A true correlation does not depend on the overlap, a chance one falls with its root: this is its z.
    """
    correlation, overlap = _masked_correlation(reference, target)
    row, col = (
        np.arange(n) - (side - 1) for n, side in zip(correlation.shape, reference.valid.shape, strict=True)
    )
    least = MIN_OVERLAP * min(reference.valid.sum(), target.valid.sum())
    allowed = (overlap >= max(least, 1.0)) & (np.abs(row[:, None]) <= limit) & (np.abs(col) <= limit)
    return np.where(allowed, correlation * np.sqrt(np.maximum(overlap, 0)), -np.inf)


def ratio_in_place(reference: tuple[Float32, Float32], target: tuple[Float32, Float32]) -> float:
    """Return the correlation of two images that fit to a few px, over the highest with any other shift.

    The `reference` and the `target` are (rows, cols, 6) channels, and a (rows, cols) array of 1 or 0 where
    they are usable or not, see `normalised_channels`. Both correlations are times the root of the overlap; 0
    where none is positive.
    """
    score = _scores(_Channels(*reference), _Channels(*target))
    middle_r, middle_c = (side - 1 for side in reference[1].shape)
    here = _around(middle_r, middle_c)
    row, col = divmod(int(score[here].argmax()), score[here].shape[1])
    row, col = row + here[0].start, col + here[1].start
    highest = float(score[row, col])
    score[_around(row, col)] = -np.inf
    rival = float(score.max())
    return highest / rival if rival > 0 and highest > 0 else 0.0


def _masked_correlation(reference: _Channels, target: _Channels) -> tuple[Float64, Float64]:
    """Correlate the channels over the overlap at every shift, and count its pixels.

    Element (r, c) is the shift (r - rows + 1, c - cols + 1) of the target against the reference.
    """
    shape = [a + b - 1 for a, b in zip(reference.valid.shape, target.valid.shape, strict=True)]
    fast = [scipy.fft.next_fast_len(n, real=True) for n in shape]

    def transform(values: Float32) -> NDArray[np.complex128]:
        return np.asarray(scipy.fft.rfft2(values.astype(np.float64), fast))

    def inverse(spectrum: NDArray[np.complex128]) -> Float64:
        first_shift = [n - 1 for n in reference.valid.shape]
        full: Float64 = np.roll(scipy.fft.irfft2(spectrum, fast), first_shift, axis=(0, 1))
        return full[: shape[0], : shape[1]]

    def correlate(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> Float64:
        return inverse(first.conj() * second)

    mask_r, mask_t = transform(reference.valid), transform(target.valid)
    overlap = np.rint(correlate(mask_r, mask_t))
    n = np.maximum(overlap, 1.0)
    variance_r = correlate(transform((reference.values**2).sum(axis=2)), mask_t)
    variance_t = correlate(mask_r, transform((target.values**2).sum(axis=2)))
    cross = np.zeros_like(mask_r)
    covariance = np.zeros_like(n)
    for channel in range(ORIENTATIONS):
        r, t = transform(reference.values[..., channel]), transform(target.values[..., channel])
        sum_r, sum_t = correlate(r, mask_t), correlate(mask_r, t)
        cross += r.conj() * t
        covariance -= sum_r * sum_t / n
        variance_r -= sum_r**2 / n
        variance_t -= sum_t**2 / n
    covariance += inverse(cross)
    norm = np.sqrt(np.maximum(variance_r, 0) * np.maximum(variance_t, 0))
    correlation = np.divide(covariance, norm, out=np.zeros_like(n), where=norm > 1e-6 * norm.max())
    return correlation, overlap


def _distinct(candidates: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Drop candidates that lie within the search of the patches around an earlier one."""
    kept: list[tuple[float, float]] = []
    for candidate in candidates:
        if all(np.hypot(candidate[0] - x, candidate[1] - y) > PATCH_RADIUS_PX / 2 for x, y in kept):
            kept.append(candidate)
    return kept


def _vote(reference: _Channels, target: _Channels, candidate_xy: Float64) -> _Vote:
    """Match patches around a candidate and count those that agree on one similarity."""
    start = np.rint(candidate_xy).astype(int)
    patches = Patches.matched((reference.values, reference.valid), (target.values, target.valid), start)
    if patches.count == 0:
        return _Vote(candidate_xy, 0.0, 0, 0)
    agreeing = patches.displacements_px[patches.agrees]
    middle = np.median(agreeing, axis=0)
    spread = np.percentile(np.hypot(*(agreeing - middle).T), 95)
    return _Vote(start + middle, float(spread), patches.count, patches.agreeing)


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
        reference: tuple[Float32, Float32], target: tuple[Float32, Float32], start_xy: NDArray[np.intp]
    ) -> Patches:
        """Match all patches of the reference within a few pixels of a start.

        The `reference` and the `target` are (rows, cols, 6) channels, and a (rows, cols) array of 1 or 0
        where they are usable or not, see `normalised_channels`. The (2,) `start_xy` is (col, row) target px
        minus reference px.
        """
        centres, displacements = _match_patches(_Channels(*reference), _Channels(*target), start_xy)
        agrees = _agreement(centres, displacements) if len(centres) else np.zeros(0, bool)
        return Patches(centres, displacements, agrees)

    def similarity(self) -> tuple[Float64, float]:
        """Fit a similarity to the patches that agree.

        Return the (3, 3) matrix that gives target px minus the start for reference px, array indices, and the
        distance from it within which 95 % of the agreeing patches lie, px.
        """
        xy = self.centres_px[self.agrees] - 0.5
        moved = xy + self.displacements_px[self.agrees]
        matrix = similarity_between(xy, moved)
        left_px = np.percentile(np.hypot(*(mapped(matrix, xy) - moved).T), 95)
        return matrix, float(left_px)


def similarity_between(from_xy: Float64, to_xy: Float64) -> Float64:
    """Return the (3, 3) similarity of least squares between the (n, 2) points `from_xy` and `to_xy`."""
    z, moved = from_xy @ (1, 1j), to_xy @ (1, 1j)
    spread = float((np.abs(z - z.mean()) ** 2).sum())
    factor = ((z - z.mean()).conj() * (moved - moved.mean())).sum() / spread if spread > 0 else 1.0 + 0j
    origin = moved.mean() - factor * z.mean()
    rows = [factor.real, -factor.imag, origin.real], [factor.imag, factor.real, origin.imag], [0, 0, 1]
    return np.array(rows, np.float64)


def mapped(matrix: Float64, xy: Float64) -> Float64:
    """Return the (n, 2) positions to which the (3, 3) affine `matrix` takes the (n, 2) `xy`."""
    return np.asarray(xy @ matrix[:2, :2].T + matrix[:2, 2], np.float64)


def window_sums(plane: Float32, side_px: int) -> Float64:
    """Return the sums over all windows of `side_px` of the (rows, cols) `plane`, (rows - side + 1, …)."""
    integral = np.asarray(cv2.integral(plane, sdepth=cv2.CV_64F), np.float64)
    right, left = integral[:, side_px:], integral[:, :-side_px]
    result: Float64 = right[side_px:] - right[:-side_px] - left[side_px:] + left[:-side_px]
    return result


def _match_patches(reference: _Channels, target: _Channels, start_xy: Index) -> tuple[Float64, Float64]:
    """Return the centres (n, 2) and displacements (n, 2), both (col, row), of disjoint patches."""
    rows, cols = reference.valid.shape
    radius = PATCH_RADIUS_PX
    top, left, size = start_xy[1] - radius, start_xy[0] - radius, (rows + 2 * radius, cols + 2 * radius)
    values, valid = _crop(target.values, top, left, size), _crop(target.valid, top, left, size)
    overlap = float((reference.valid * valid[radius:-radius, radius:-radius]).sum())
    patch_px = int(np.clip(np.sqrt(overlap / PATCHES_WANTED), *PATCH_SIDES_PX))
    energy, count = (window_sums(plane, patch_px) for plane in ((values**2).sum(axis=2), valid))
    side, least = 2 * radius + 1, MIN_VALID * patch_px**2
    centres, displacements = [], []
    for r in range(0, rows - patch_px + 1, patch_px):
        for c in range(0, cols - patch_px + 1, patch_px):
            patch, shifts = np.s_[r : r + patch_px, c : c + patch_px], np.s_[r : r + side, c : c + side]
            if min(reference.valid[patch].sum(), count[shifts].min()) < least:
                continue
            search = values[r : r + patch_px + side - 1, c : c + patch_px + side - 1]
            cross = cv2.matchTemplate(search, reference.values[patch], cv2.TM_CCORR)
            centres.append((c + patch_px / 2, r + patch_px / 2))
            displacements.append(_peak_xy(cross / np.sqrt(np.maximum(energy[shifts], 1e-6))))
    return np.array(centres).reshape(-1, 2), np.array(displacements).reshape(-1, 2)


def _crop(values: Float32, top: int, left: int, size: tuple[int, int]) -> Float32:
    """Cut out a window that may reach over the border, where it is 0."""
    out = np.zeros((*size, *values.shape[2:]), np.float32)
    rows, cols = values.shape[:2]
    r0, r1 = max(top, 0), min(top + size[0], rows)
    c0, c1 = max(left, 0), min(left + size[1], cols)
    if r0 < r1 and c0 < c1:
        out[r0 - top : r1 - top, c0 - left : c1 - left] = values[r0:r1, c0:c1]
    return out


def _peak_xy(surface: Float64) -> tuple[float, float]:
    """Return the (col, row) displacement of the peak, by parabolas through its neighbours."""
    r, c = np.unravel_index(int(surface.argmax()), surface.shape)
    last = surface.shape[0] - 1
    x, y = float(c - PATCH_RADIUS_PX), float(r - PATCH_RADIUS_PX)
    if 0 < r < last:
        y += parabola_offset(*surface[r - 1 : r + 2, c])
    if 0 < c < last:
        x += parabola_offset(*surface[r, c - 1 : c + 2])
    return x, y


def _agreement(centres: Float64, displacements: Float64) -> Bool:
    """Return the mask of the patches that agree with the similarity, near the identity, of most support."""
    z, d = centres @ (1, 1j), displacements @ (1, 1j)
    z = z - z.mean()
    first, second = np.nonzero(np.abs(z[:, None] - z) >= MIN_BASE_PX)
    slope = (d[first] - d[second]) / (z[first] - z[second])
    small = np.abs(slope) <= LARGEST_DISTORTION
    slope = np.concatenate([np.zeros(len(d)), slope[small]])
    origin = np.concatenate([d, d[first[small]] - slope[len(d) :] * z[first[small]]])
    agrees = np.abs(d - origin[:, None] - slope[:, None] * z) <= TOLERANCE_PX
    return np.asarray(agrees[int(agrees.sum(axis=1).argmax())])


def _judge(votes: list[_Vote], factor: int) -> SearchResult:
    """Take the best vote and compare it with its best rival elsewhere."""
    if not votes:
        return SearchResult((0.0, 0.0), 0.0, 0, 0, 0.0, 0.0, False)
    best = max(votes, key=lambda vote: vote.significance)
    rivals = [vote.share for vote in votes if np.hypot(*(vote.shift_xy - best.shift_xy)) > PATCH_RADIUS_PX]
    distinctness = 1 - min(max(rivals, default=0.0) / best.share, 1.0) if best.agreeing else 0.0
    accepted = best.significance >= MIN_SIGNIFICANCE and distinctness >= MIN_DISTINCTNESS
    x, y = best.shift_xy * factor
    return SearchResult(
        (float(x), float(y)),
        best.spread_px * factor,
        best.patches,
        best.agreeing,
        best.significance,
        distinctness,
        accepted,
    )
