"""Match two rasters with OpenCV or scikit-image alone: `peers.py` runs this in a process of its own.

Usage::

    python peer_call.py METHOD REFERENCE TARGET POINTS OUT.csv

Each method is told that the files lie within 3 px of each other, and how many points are wanted. Writes
the tie points that it keeps, and prints what the work cost as JSON.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.windows import Window

Points = NDArray[np.float64]
"""(n, 4): col and row in the reference and in the target, px, corner-based."""

TILE_PX: Final = 2048
"""Images are read in parts of this side: nothing here holds 16,384² in memory."""
WINDOW_PX: Final = 128
"""Side of the windows of the phase correlation, as those of AROSICS."""
LARGEST_PX: Final = 3.0
RATIO: Final = 0.8
"""Largest ratio of the distances of the best and the second-best descriptor."""
FEATURES_A_POINT: Final = 10
FLOW_RADIUS_PX: Final = 64
"""Windows of 129 px; the default, 7, finds next to nothing between unlike bands."""


def main() -> None:
    """Match, write, print."""
    method, reference, target, points, out = sys.argv[1:]
    begun, cpu_begun = time.perf_counter(), time.process_time()
    found = METHODS[method](reference, target, int(points))
    cost = {"wall_s": time.perf_counter() - begun, "cpu_s": time.process_time() - cpu_begun}
    rows = ["ref_col,ref_row,tgt_col,tgt_row,status"]
    rows += [",".join(map(str, row)) + ",matched" for row in found.tolist()]
    Path(out).write_text("\n".join(rows) + "\n", encoding="utf-8")
    print(json.dumps(cost))


def sift(reference: str, target: str, points: int) -> Points:
    """Match SIFT descriptors with the ratio test; keep what agrees with one homography (MAGSAC++)."""
    found = []
    for images, corner, share in _tiles(reference, target):
        detector = cv2.SIFT_create(nfeatures=math.ceil(share * points * FEATURES_A_POINT))
        (one, first), (other, second) = (detector.detectAndCompute(_byte(image), None) for image in images)
        if first is None or second is None or len(second) < 2:
            continue
        pairs = cv2.BFMatcher().knnMatch(first, second, k=2)
        good = [best for best, next_one in pairs if best.distance < RATIO * next_one.distance]
        tie = [[*one[match.queryIdx].pt, *other[match.trainIdx].pt] for match in good]
        found.append(np.reshape(tie, (-1, 4)) + 0.5 + np.tile(corner, 2))
    every = np.concatenate(found)
    if len(every) < 4:
        return every[:0]
    _, kept = cv2.findHomography(every[:, :2], every[:, 2:], cv2.USAC_MAGSAC, LARGEST_PX, maxIters=10_000)
    return every[kept.ravel() > 0] if kept is not None else every[:0]


def phase_cross_correlation(reference: str, target: str, points: int) -> Points:
    """Correlate windows on a grid; keep displacements that are not beyond the largest one possible."""
    from skimage.registration import phase_cross_correlation as correlate

    half, found = WINDOW_PX // 2, []
    for (one, other), corner, share in _tiles(reference, target):
        for position in _grid(one.shape, points * share):
            low = np.maximum(position - half, 0)
            high = np.minimum(position + half, one.shape[::-1])
            part = tuple(slice(*ends) for ends in zip(low[::-1], high[::-1], strict=True))
            shift, _, _ = correlate(one[part], other[part], upsample_factor=100)
            if np.abs(shift).max() <= LARGEST_PX:
                centre = corner + (low + high) / 2
                found.append([*centre, *(centre - shift[::-1])])  # it tells how to move the target back
    return np.reshape(found, (-1, 4))


def optical_flow_ilk(reference: str, target: str, points: int) -> Points:
    """Take the dense flow of both images, scaled to unit variance, at the points of a grid."""
    from skimage.registration import optical_flow_ilk as flow_of

    found = []
    for images, corner, share in _tiles(reference, target):
        one, other = ((image - image.mean()) / image.std() for image in images)
        flow = flow_of(one, other, radius=FLOW_RADIUS_PX, dtype=np.float32)
        for col, row in _grid(one.shape, points * share):
            centre = corner + np.array([col, row]) + 0.5
            found.append([*centre, *(centre + flow[::-1, row, col])])
    return np.reshape(found, (-1, 4))


METHODS: Final = {one.__name__: one for one in (sift, phase_cross_correlation, optical_flow_ilk)}


def _tiles(reference: str, target: str) -> Iterator[tuple[list[NDArray[np.float32]], Points, float]]:
    """Yield parts of both images, their upper left corner (col, row), and their share of the scene."""
    with rasterio.open(reference) as one, rasterio.open(target) as other:
        for row in range(0, one.height, TILE_PX):
            for col in range(0, one.width, TILE_PX):
                window = Window(col, row, min(TILE_PX, one.width - col), min(TILE_PX, one.height - row))
                images = [file.read(1, window=window).astype(np.float32) for file in (one, other)]
                yield images, np.array([col, row]), window.width * window.height / (one.width * one.height)


def _grid(shape: tuple[int, ...], points: float) -> NDArray[np.intp]:
    """Return col and row (n, 2) of about so many pixels, evenly spaced."""
    step = math.sqrt(shape[0] * shape[1] / points)
    counts = [max(round(side / step), 1) for side in shape[::-1]]
    axes = [(np.arange(n) + 0.5) * side / n for n, side in zip(counts, shape[::-1], strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2).astype(np.intp)


def _byte(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    low, high = np.percentile(image, (2, 98))
    return np.clip((image - low) / (high - low) * 255, 0, 255).astype(np.uint8)


if __name__ == "__main__":
    main()
