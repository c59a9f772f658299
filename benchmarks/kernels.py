"""Print the CPU time of the maps of one image beside that of the bare inverse transforms.

Usage::

    python benchmarks/kernels.py [SIDE ...]

Everything runs in this process, one thread, the stages in turn; the least time of several rounds counts.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.tables import Check, Table, as_text, at_most
from benchmarks.timing import cheapest
from pcwlad_geo.execution.runner import one_opencv_thread
from pcwlad_geo.matching import Image
from pcwlad_geo.matching.kernels.library import fast_even
from pcwlad_geo.matching.kernels.phase_congruency import ORIENTATIONS, SCALES
from pcwlad_geo.matching.maps import (
    maximum_moment,
    oriented_gradients,
    oriented_phase_congruency,
    scene_epsilon,
)
from pcwlad_geo.matching.noise import NOISE
from pcwlad_geo.matching.prepare import prepare

SIDES_PX: Final = (512, 1300, 2048)
ROUNDS: Final = 5
LIMIT: Final = 2.5
"""Phase congruency over its inverse transforms."""


@dataclass(frozen=True, slots=True)
class PhaseCongruencyCost:
    """CPU time of the maps of one image, seconds."""

    side_px: int
    padded_px: int
    transforms: float
    """The 24 inverse FFTs: complex64, padded size, scipy.fft, one worker, in place."""
    transforms_copied: float
    """The same, each into memory of its own."""
    oriented: float
    """The six oriented maps."""
    moment: float
    """The maximum moment of the six."""
    preparation: float
    """All that is computed of an image before it is matched: half of a pair."""
    gradients: float
    """The six oriented gradients and their strength, the stand-in of the oriented maps."""

    @property
    def ratio(self) -> float:
        """Oriented maps and moment over the transforms in place."""
        return (self.oriented + self.moment) / self.transforms


def phase_congruency_cost(side_px: int = SIDES_PX[-1], rounds: int = ROUNDS) -> PhaseCongruencyCost:
    """Measure the phase congruency of a square image against its bare inverse transforms.

    Parameters
    ----------
    side_px : int
        Side of the image.
    rounds : int
        The stages run in turn so often; the least time of each counts.
    """
    image = _texture(side_px)
    epsilon = scene_epsilon(image)
    padded_px = fast_even(side_px)
    padded = np.pad(image, (0, padded_px - side_px), mode="reflect")
    whole = Image(image, np.ones(image.shape, bool), epsilon)
    maps = oriented_phase_congruency(padded, epsilon)
    response = scipy.fft.fft2(padded).astype(np.complex64)

    def transform(overwrite: bool) -> None:
        for _ in range(SCALES * ORIENTATIONS):
            scipy.fft.ifft2(response, norm="ortho", workers=1, overwrite_x=overwrite)

    stages: list[Callable[[], object]] = [
        lambda: transform(True),
        lambda: transform(False),
        lambda: oriented_phase_congruency(padded, epsilon),
        lambda: maximum_moment(maps),
        lambda: prepare(whole, whole, channels="orientations"),
        lambda: oriented_gradients(image, epsilon, NOISE.least_smoothing_px),
    ]
    with one_opencv_thread():
        costs = cheapest(stages, rounds)
    in_place, copied, oriented, moment, pair, gradients = (cost.cpu_s for cost in costs)
    return PhaseCongruencyCost(side_px, padded_px, in_place, copied, oriented, moment, pair / 2, gradients)


def _texture(side_px: int) -> NDArray[np.float32]:
    noise = np.random.default_rng(0).normal(size=(side_px, side_px)).astype(np.float32)
    return np.asarray(1000 + 300 * cv2.GaussianBlur(noise, (0, 0), 1.5), np.float32)


def main() -> int:
    """Measure and print."""
    sides = [int(text) for text in sys.argv[1:]] or list(SIDES_PX)
    rows, checks = [], list[Check]()
    for cost in map(phase_congruency_cost, sides):
        seconds = (
            cost.transforms,
            cost.transforms_copied,
            cost.oriented,
            cost.moment,
            cost.preparation,
            cost.gradients,
        )
        phase_congruency = cost.oriented + cost.moment
        ratios = (cost.ratio, cost.preparation / cost.transforms, cost.gradients / phase_congruency)
        rows.append([f"{cost.side_px} ({cost.padded_px})", *seconds, *(f"{ratio:.2f}" for ratio in ratios)])
        what = f"{cost.side_px} px: phase congruency over its transforms"
        checks.append(at_most(what, cost.ratio, LIMIT, digits=2))
    header = (
        "side (padded), px",
        "24 inverse FFTs",
        "copied",
        "oriented maps",
        "moment",
        "preparation",
        "gradients",
        "phase congruency / FFTs",
        "preparation / FFTs",
        "gradients / phase congruency",
    )
    print(as_text(Table("Maps of one image, seconds of CPU", header, rows, checks)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
