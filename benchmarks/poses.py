"""Poses that are known: truths of real pairs, images warped by drawn poses, errors against them.

Positions are (col, row) px, corner-based, as in results; matrices are (3, 3) and act on (col, row, 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.stats import rankdata

from benchmarks.pairs import Image
from benchmarks.runs import Array

Bool = NDArray[np.bool_]

SUBSAMPLES: Final = 3
"""Samples per axis whose mean is a pixel of a warped image that is coarser than the original."""
KERNEL_PX: Final = 2
"""Distance from pixels without data within which a spline is not used."""
NODES: Final = 15
"""Places along each axis at which a correction is compared with the truth."""
ROTATIONS_DEG: Final = (2.0, 180.0)
SCALES: Final = (0.6, 1.7)
TO_CORNERS: Final = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
"""From px counted from the centre of the first to px counted from its corner."""
MAX_SHEAR: Final = 0.05
SMOOTHED_PX: Final = 1.0
"""Sigma of the Gaussian that images are smoothed by before their grey values are compared."""
GREY_BINS: Final = 16
COLLAR_SHARE: Final = 0.03
"""Darker values, as a share of the range, are taken for the collar of a rotated image, without meaning."""
STRETCHES: Final = (1.0, 1.5)
PERSPECTIVES: Final = (0.01, 0.15)
MAX_SHIFT: Final = 1 / 3
"""Of the sides of the image."""


@dataclass(frozen=True, slots=True)
class Warp:
    """A pose that a target is given."""

    rotation_deg: float
    """Clockwise, as seen on a screen."""
    scale: float
    """Px of the warped image per px of the original."""
    shear: float
    """Columns by which a place moves for each row."""
    shift: tuple[float, float]
    """(col, row) of the middle, in sides of the image."""
    stretch: float = 1.0
    """Ratio of the singular values, their product being 1."""
    stretch_deg: float = 0.0
    """Direction of the stretch in the original, clockwise from the columns."""
    perspective: tuple[float, float] = (0.0, 0.0)
    """Change of scale across the image along columns and rows, as a share."""

    def canvas(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return rows and columns of the warped image: the original's, scaled, so that corners are lost."""
        rows, cols = (round(side * self.scale) for side in shape)
        return rows, cols

    def matrix(self, shape: tuple[int, int]) -> Array:
        """Return the (3, 3) matrix from px of an image of a shape to px of the warped image."""
        angle = math.radians(self.rotation_deg)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        along = math.radians(self.stretch_deg)
        axes = np.array([[math.cos(along), -math.sin(along)], [math.sin(along), math.cos(along)]])
        stretched = axes @ np.diag([self.stretch**0.5, self.stretch**-0.5]) @ axes.T
        rows, cols = self.canvas(shape)
        matrix = np.eye(3)
        matrix[:2, :2] = self.scale * turn @ [[1.0, self.shear], [0.0, 1.0]] @ stretched
        there = np.array([cols, rows]) * (0.5 + np.array(self.shift))
        middle = np.array([shape[1] / 2, shape[0] / 2])
        matrix[:2, 2] = there - matrix[:2, :2] @ middle
        tilt = np.eye(3)
        tilt[2, :2] = self.perspective / (2 * middle)
        about = np.eye(3)
        about[:2, 2] = -middle
        return np.asarray(matrix @ np.linalg.inv(about) @ tilt @ about)

    def inverse(self, shape: tuple[int, int]) -> Array:
        """Return the (3, 3) matrix from px of the warped image to px of the original."""
        return np.asarray(np.linalg.inv(self.matrix(shape)), dtype=np.float64)

    def __str__(self) -> str:
        col, row = (f"{100 * part:+.0f}" for part in self.shift)
        return (
            f"rotation {self.rotation_deg:+.1f} degrees, scale {self.scale:.2f}, "
            f"shear {100 * self.shear:+.1f} %, shift ({col}, {row}) %"
            + (f", stretch {self.stretch:.2f}" if self.stretch != 1 else "")
            + (f", perspective {100 * math.hypot(*self.perspective):.0f} %" if any(self.perspective) else "")
        )


def draw_warp(rng: np.random.Generator, scales: tuple[float, float] = SCALES) -> Warp:
    """Draw a rotation either way, a scale, a shear and a shift."""
    rotation = rng.uniform(*ROTATIONS_DEG) * rng.choice([-1.0, 1.0])
    scale = math.exp(rng.uniform(*np.log(scales)))
    shift_col, shift_row = rng.uniform(-MAX_SHIFT, MAX_SHIFT, 2).tolist()
    return Warp(float(rotation), scale, float(rng.uniform(-MAX_SHEAR, MAX_SHEAR)), (shift_col, shift_row))


def draw_stretch(rng: np.random.Generator, scales: tuple[float, float]) -> Warp:
    """Draw a pose with a stretch, in any direction."""
    stretch, along_deg = float(rng.uniform(*STRETCHES)), float(rng.uniform(0.0, 180.0))
    return replace(_draw_nearer(rng, scales), stretch=stretch, stretch_deg=along_deg)


def draw_perspective(rng: np.random.Generator, scales: tuple[float, float]) -> Warp:
    """Draw a pose seen from the side: the scale changes across the image."""
    size, angle = rng.uniform(*PERSPECTIVES), rng.uniform(0.0, 2 * math.pi)
    tilt = float(size * math.cos(angle)), float(size * math.sin(angle))
    return replace(_draw_nearer(rng, scales), perspective=tilt)


def _draw_nearer(rng: np.random.Generator, scales: tuple[float, float]) -> Warp:
    """Draw any rotation, with no shear, and half the shift and change of scale of `draw_warp`."""
    warp = draw_warp(rng, scales)
    shift = warp.shift[0] / 2, warp.shift[1] / 2
    return replace(warp, shear=0.0, shift=shift, scale=math.sqrt(warp.scale))


def warp_image(image: Image, valid: Bool, warp: Warp) -> tuple[Image, Bool]:
    """Resample an image once, by cubic splines.

    Where the warped image is coarser, its pixels are means of samples, as a sensor would take them.

    Parameters
    ----------
    image : (rows, cols) array
    valid : (rows, cols) bool array
    warp : Warp

    Returns
    -------
    (rows, cols) float64 array
        The warped image.
    (rows, cols) bool array
        Where it shows something.
    """
    shape = image.shape[0], image.shape[1]
    to_original = warp.inverse(shape)
    rows, cols = warp.canvas(shape)
    centres = np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5), axis=-1)
    count = SUBSAMPLES if warp.scale < 1 else 1
    steps = (np.arange(count) + 0.5) / count - 0.5
    spline = ndimage.spline_filter(image.astype(np.float64), order=3, mode="mirror")
    total = np.zeros((rows, cols))
    for step in np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2):
        index = _indices(to_original, centres + step)
        total += ndimage.map_coordinates(spline, index, order=3, mode="mirror", prefilter=False)
    usable = ndimage.binary_erosion(valid, iterations=KERNEL_PX, border_value=1)
    seen = ndimage.map_coordinates(usable.astype(np.float64), _indices(to_original, centres), order=1)
    return total / count**2, np.asarray(seen > 1 - 1e-6)


def _indices(matrix: Array, at_px: Array) -> Array:
    """Return (row, col) array indices of places, as (2, rows, cols)."""
    original = mapped(matrix, at_px.reshape(-1, 2)).reshape(at_px.shape)
    return np.moveaxis(original[..., ::-1] - 0.5, -1, 0)


def mapped(matrix: Array, at_px: Array) -> Array:
    """Return (n, 2) places, mapped by a (3, 3) matrix."""
    places = at_px @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(places[:, :2] / places[:, 2:])


def grid_px(shape: tuple[int, int]) -> Array:
    """Return (n, 2) places spread over an image of a shape, its corners included."""
    rows, cols = shape
    axes = np.linspace(0.0, cols, NODES), np.linspace(0.0, rows, NODES)
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def inside(at_px: Array, shape: tuple[int, int]) -> Bool:
    """Return (n,) which places lie in an image of a shape."""
    return np.asarray(((at_px >= 0) & (at_px < shape[::-1])).all(axis=1))


def read_similarity(path: Path) -> Array:
    """Return the (3, 3) matrix of a file that holds a (2, 3) one for 0-based pixel centres."""
    centre_based = np.vstack([np.loadtxt(path), [0.0, 0.0, 1.0]])
    return np.asarray(TO_CORNERS @ centre_based @ np.linalg.inv(TO_CORNERS))


def nearest_rotation(unturned_px: Array, found_px: Array, about_px: tuple[float, float]) -> Array:
    """Return where places lie after that rotation which brings them nearest to where they were found.

    The rotation has the least mean square distance (orthogonal Procrustes; Schönemann 1966,
    doi:10.1007/BF02289451).

    Parameters
    ----------
    unturned_px, found_px : (n, 2) array
    about_px : (float, float)
        The place about which is rotated.

    Returns
    -------
    (n, 2) array
    """
    here, there = unturned_px - about_px, found_px - about_px
    across = (here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0]).sum()
    angle = math.atan2(across, (here * there).sum())
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return np.asarray(here @ turn.T + about_px)


def mean_distance_px(first_px: Array, second_px: Array) -> float:
    """Return the mean distance between (n, 2) places; NaN where there are none."""
    if not len(first_px):
        return math.nan
    return float(np.linalg.norm(first_px - second_px, axis=1).mean())


def spread_sample(count: int, share: float, seed: int) -> list[int]:
    """Return indices below `count`: about this share of them, one at random of each equal part, at least one.

    Where the whole is asked for, these are all.
    """
    wanted = min(count, max(1, round(count * share)))
    edges = np.linspace(0, count, wanted + 1)
    rng = np.random.default_rng(seed)
    low, high = np.ceil(edges[:-1] - 1e-9).astype(int), np.ceil(edges[1:] - 1e-9).astype(int)
    return [int(rng.integers(first, max(first + 1, last))) for first, last in zip(low, high, strict=True)]


def share_of(flags: Sequence[bool]) -> float:
    """Return the percentage that holds; NaN of none."""
    return 100 * sum(flags) / len(flags) if flags else math.nan


def mutual_information(reference: Image, target: Image, matrix: Array) -> float:
    """Return how much the grey values of two images tell of each other where a pose puts the target, nats.

    It uses nothing of what the tool matches, so it can tell whether a truth that disagrees is to be believed.

    Parameters
    ----------
    reference, target : (rows, cols) array
    matrix : (2, 3) array
        Target px = matrix · reference px, corner-based (col, row).
    """
    rows, cols = reference.shape
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    x, y = np.tensordot(matrix, np.stack([col, row, np.ones_like(row)]), axes=1)
    smooth = [ndimage.gaussian_filter(image.astype(float), SMOOTHED_PX) for image in (reference, target)]
    seen = (x > 0) & (x < target.shape[1]) & (y > 0) & (y < target.shape[0])
    values = ndimage.map_coordinates(smooth[1], [y[seen] - 0.5, x[seen] - 0.5], order=1, mode="nearest")
    dark = values < np.ptp(values) * COLLAR_SHARE + values.min()
    ranks = [rankdata(each[~dark]) / (~dark).sum() for each in (smooth[0][seen], values)]
    joint = np.histogram2d(*ranks, bins=GREY_BINS)[0] / (~dark).sum()
    alone = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0, keepdims=True)
    both = joint > 0
    return float((joint[both] * np.log(joint[both] / alone[both])).sum())
