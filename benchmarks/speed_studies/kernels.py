"""What the parts cost in CPU time, inside this process: filter bank, refinement, a small pair.

Compared figures are measured in turn in one run; each is the smallest of several, as anything else that the
machine does only adds to it.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import rasterio
import scipy.fft
from numpy.typing import NDArray
from rasterio.windows import Window

from benchmarks.speed_studies.scene_files import ScenePair, displacement_px
from pcwlad_geo.matching import keypoints
from pcwlad_geo.matching.phase_congruency import (
    ORIENTATIONS,
    SCALES,
    oriented_phase_congruency,
    scene_epsilon,
)
from pcwlad_geo.matching.prepare import Image, PreparedPair, prepare
from pcwlad_geo.matching.refinement import Start, refine
from pcwlad_geo.workflow import register

FILTERS: Final = SCALES * ORIENTATIONS
CONTEXT_PX: Final = 64 + 64 + 92
"""What a tile of 1024 px reads around itself for window 81: halo, cells, windows and search."""
TILE_PX: Final = 1024


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU and wall time, s."""

    cpu_s: float
    wall_s: float


def cheapest(works: Sequence[Callable[[], object]], repeats: int) -> list[Cost]:
    """Run the works in turn, `repeats` times; return the least cost of each. The first round warms up."""
    best = [Cost(math.inf, math.inf)] * len(works)
    for round_ in range(repeats + 1):
        for index, work in enumerate(works):
            wall, cpu = time.perf_counter(), time.process_time()
            work()
            cpu_s, wall_s = time.process_time() - cpu, time.perf_counter() - wall
            if round_ > 0:
                best[index] = Cost(min(best[index].cpu_s, cpu_s), min(best[index].wall_s, wall_s))
    return best


def filter_bank(rows: int, cols: int) -> Callable[[], None]:
    """Return the bare inverse FFTs of one image, complex64, one worker."""
    rng = np.random.default_rng(1)
    spectrum = rng.standard_normal((rows, cols, 2), np.float32).view(np.complex64)[..., 0]

    def work() -> None:
        for _ in range(FILTERS):
            scipy.fft.ifft2(spectrum, workers=1)

    return work


def phase_congruency(pair: ScenePair, side_px: int, repeats: int) -> tuple[Cost, Cost]:
    """Return the cost of the maps of one tile, and of its bare inverse FFTs."""
    image = _read(pair.reference, side_px)
    epsilon = scene_epsilon(image)
    maps, bare = cheapest(
        [lambda: oriented_phase_congruency(image, epsilon), filter_bank(side_px, side_px)], repeats
    )
    return maps, bare


def bare_scene_bank(side_px: int) -> Cost:
    """Return what the inverse FFTs of all windows of a scene cost, both images, one worker."""
    count = math.ceil(side_px / TILE_PX)
    padded = fast_even(math.ceil(side_px / count) + 2 * CONTEXT_PX)
    one = cheapest([filter_bank(padded, padded)], 2)[0]
    return Cost(one.cpu_s * 2 * count**2, one.wall_s * 2 * count**2)


def fast_even(length: int) -> int:
    """Return the next even length that the FFT likes."""
    fast = int(scipy.fft.next_fast_len(length))
    return fast if fast % 2 == 0 else fast_even(fast + 1)


def refinement_ms(pair: ScenePair, windows: Sequence[int], points: int, repeats: int) -> list[float]:
    """Return the CPU time a point, ms, of one direction, shift model, one pass, for each window side."""
    images = [_read(path, 1024) for path in (pair.reference, pair.target)]
    everywhere = np.ones(images[0].shape, bool)
    reference, target = (Image(image, everywhere, scene_epsilon(image)) for image in images)
    prepared = prepare(reference, target, channels="orientations")
    corners = _corners(prepared, points)
    # from the whole pixel that a coarse match would give
    shift = np.round(displacement_px(corners[:, ::-1] + 0.5))
    start = Start(shift, np.zeros((len(corners), 2, 2)))
    works = [
        lambda window=window: refine(prepared.reference, prepared.target, corners, start, window_px=window)
        for window in windows
    ]
    return [cost.cpu_s * 1000 / len(corners) for cost in cheapest(works, repeats)]


def small_pair(pair: ScenePair, side_px: int, features: int, repeats: int) -> Cost:
    """Return the cost of registering a small pair, files to files, without start-up."""
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-") as folder:
        crops = [_crop(path, Path(folder), side_px) for path in (pair.reference, pair.target)]
        out = Path(folder) / "out"

        def work() -> None:
            register(*crops, out_dir=out, overwrite=True, features=features, jobs=1)

        return cheapest([work], repeats)[0]


def _corners(pair: PreparedPair, count: int) -> NDArray[np.intp]:
    usable = np.zeros(pair.reference_moment.shape, bool)
    usable[110:-110, 110:-110] = True
    corners, response = keypoints.detect_corners(pair.reference_moment, usable, pair.contrast)
    area = float(usable.sum())
    cell_px = max(8, round(math.sqrt(keypoints.PER_CELL * area / count)))
    return keypoints.by_cell(corners, response, cell_px, (0, 0))


def _read(path: Path, side_px: int) -> NDArray[np.float64]:
    with rasterio.open(path) as file:
        image: NDArray[np.float64] = file.read(1, window=Window(0, 0, side_px, side_px)).astype(np.float64)
    return image


def _crop(path: Path, folder: Path, side_px: int) -> Path:
    out = folder / path.name
    with rasterio.open(path) as file:
        profile = file.profile | {"width": side_px, "height": side_px}
        with rasterio.open(out, "w", **profile) as crop:
            crop.write(file.read(1, window=Window(0, 0, side_px, side_px)), 1)
    return out


def one_thread() -> None:
    """Keep OpenCV to one thread, as the workers do."""
    cv2.setNumThreads(1)
