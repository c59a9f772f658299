"""Print the CPU time of the coarse search and of the refinement of a tie point.

Usage::

    python benchmarks/kernels_refinement.py [--data FOLDER]

With the folder of real image pairs on those, else on the sample pair. Everything runs in this process, one
thread, the stages in turn; the least time of several rounds counts.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.pairs import landsat, read, rgbnir
from benchmarks.tables import Cell, Check, Table, as_text, at_most
from benchmarks.timing import cheapest
from pcwlad_geo.execution.runner import one_opencv_thread
from pcwlad_geo.matching import Image, MatchSettings, keypoints
from pcwlad_geo.matching.coarse import CoarseMatches, match_coarsely
from pcwlad_geo.matching.first_pass import margin_px
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.noise import measure_noise
from pcwlad_geo.matching.prepare import PreparedPair, prepare
from pcwlad_geo.matching.refinement import InitialEstimate, refine
from pcwlad_geo.matching.window import MatchingWindow

REPOSITORY: Final = Path(__file__).resolve().parents[1]
LIMITS_MS: Final = {81: 1.0, 129: 2.5}
COARSE_LIMIT_MS: Final = 0.3
WIDEST_PX: Final = 129
POINTS: Final = 300
ROUNDS: Final = 8
DEFORMATION: Final = np.array([[0.004, 0.003], [-0.002, 0.003]])

Index = NDArray[np.intp]
Files = tuple[Path, Path]


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """A prepared pair with coarse matches of corners that are whole in both images."""

    pair: PreparedPair
    corners_rc: Index
    coarse: CoarseMatches


def refinement_cost(window_px: int, files: Files | None = None) -> float:
    """Measure the refinement alone: one direction, shift model, one pass, structure following.

    Parameters
    ----------
    window_px : int
        Side of the window, up to 129.
    files : pair of paths, optional
        Reference and target; the sample pair by default.

    Returns
    -------
    float
        Milliseconds of CPU a point.
    """
    return costs(window_px, files or _sample())[0]


def costs(window_px: int, files: Files) -> list[float]:
    """Return the cost of the first pass, of the second one, and of the first with deformation; ms a point."""
    found = matches(files)
    none = np.zeros((len(found.corners_rc), 2, 2))
    run = partial(
        refine,
        found.pair.channels.reference,
        found.pair.channels.target,
        found.corners_rc,
        window_px=window_px,
    )
    shift = found.coarse.shift_xy_px
    first = run(InitialEstimate(shift, none))
    centre = np.median(first.shift_xy_px[first.converged], axis=0)
    starts = [
        InitialEstimate(shift, none),
        InitialEstimate(first.shift_xy_px, none, structure_xy_px=np.broadcast_to(centre, shift.shape)),
        InitialEstimate(shift, none + DEFORMATION),
    ]
    return _ms_a_point([partial(run, start) for start in starts], len(shift))


def coarse_cost(files: Files) -> float:
    """Return the cost of the coarse search, ms a point."""
    found = matches(files)
    return _ms_a_point([partial(_search, found.pair, found.corners_rc)], len(found.corners_rc))[0]


@cache
def matches(files: Files) -> Matches:
    """Prepare a pair and find its coarse matches."""
    images = [np.asarray(read(path), np.float64) for path in files]
    rows, cols = np.minimum(*(image.shape for image in images))
    reference, target = (_whole(image[:rows, :cols]) for image in images)
    pair = prepare(reference, target, channels="orientations")
    usable = np.zeros((rows, cols), bool)
    margin = margin_px(MatchSettings(window=MatchingWindow(WIDEST_PX)))
    usable[margin:-margin, margin:-margin] = True
    corners, response = keypoints.detect_corners(pair.reference_map.values, usable, pair.contrast)
    corners = keypoints.strongest(corners, response, POINTS)
    coarse = _search(pair, corners)
    inside = ~coarse.at_border
    return Matches(
        pair, corners[inside], CoarseMatches(*(getattr(coarse, name)[inside] for name in coarse.__slots__))
    )


def _search(pair: PreparedPair, corners: Index) -> CoarseMatches:
    settings = MatchSettings()
    return match_coarsely(
        pair.reference_map,
        pair.target_map,
        corners,
        settings.template,
        settings.search_radius,
        settings.least_valid,
    )


def _whole(image: NDArray[np.float64]) -> Image:
    everything = np.ones(image.shape, bool)
    return Image(image, everything, scene_epsilon(image), measure_noise(image, everything))


def _ms_a_point(works: list[Callable[[], object]], points: int) -> list[float]:
    with one_opencv_thread():
        return [1000 * cost.cpu_s / points for cost in cheapest(works, ROUNDS)]


def _sample() -> Files:
    return REPOSITORY / "sample_data/landsat_b4.tif", REPOSITORY / "sample_data/landsat_b10.tif"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Print the CPU time of the refinement of a tie point.")
    parser.add_argument("--data", type=Path, help="folder of the real image pairs; else the sample pair")
    data = parser.parse_args().data
    pairs = {"sample": _sample()}
    if data is not None:
        pairs = {pair.name: (pair.reference, pair.target) for pair in (landsat(data), rgbnir(data))}
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for name, files in pairs.items():
        coarse = coarse_cost(files)
        checks.append(at_most(f"{name}: coarse search", coarse, COARSE_LIMIT_MS, "ms"))
        for window_px, limit in LIMITS_MS.items():
            first, *others = costs(window_px, files)
            rows.append([name, len(matches(files).corners_rc), window_px, coarse, first, *others])
            checks.append(at_most(f"{name}: refinement, window {window_px}", first, limit, "ms"))
    header = ("pair", "points", "window", "coarse search", "first pass", "second pass", "first, deformed")
    print(as_text(Table("Milliseconds of CPU a point; refinement in one direction", header, rows, checks)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
