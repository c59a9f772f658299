"""The same points to the last bit, whatever else a process refines and wherever its kernel is from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.matching.refinement import InitialEstimate, Refined, refine
from tests.matching.test_refinement import SIDE, cross_modal

REPOSITORY = Path(__file__).resolve().parents[2]
LINEAR = np.array([[0.01, 0.004], [-0.006, 0.008]])

DIGEST = """
import hashlib
import cv2
import numpy as np
from pcwlad_geo.matching.refinement import ChannelMaps, InitialEstimate, refine

rng = np.random.default_rng(1)
noise = rng.normal(size=(3, 150, 150)).astype(np.float32)
noise = np.stack([np.abs(cv2.GaussianBlur(plane, (0, 0), 2)) for plane in noise])
valid = rng.random((150, 150)) > 0.1
stacks = [ChannelMaps(noise[:, i : 140 + i, i : 140 + i], valid[:140, :140]) for i in (0, 1)]
corners = rng.integers(45, 95, (40, 2))
digest = hashlib.sha256()
for window, linear, affine, fixed in (
    (41, 0.0, False, False), (81, 0.0, False, False), (61, 0.01, False, True), (61, 0.0, True, False)
):
    structure = np.zeros((40, 2)) if fixed else None
    start = InitialEstimate(np.full((40, 2), -0.8), np.full((40, 2, 2), linear), structure)
    found = refine(*stacks, corners, start, window_px=window, affine=affine, use_structure=not affine)
    for array in (found.shift_xy_px, found.linear, found.covariance_px2, found.converged):
        digest.update(array.tobytes())
    print(int(found.converged.sum()))
print(digest.hexdigest())
"""


def some_corners(n: int) -> np.ndarray:
    return np.random.default_rng(3).integers(35, SIDE - 35, (n, 2))


def assert_same_bits(found: Refined, expected: Refined, rows: np.ndarray) -> None:
    for name in ("shift_xy_px", "linear", "covariance_px2", "converged"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[rows])


@pytest.mark.parametrize("how", ["follows", "fixed", "deformed"])
def test_a_point_does_not_depend_on_the_points_beside_it(how: str) -> None:
    pair, corners = cross_modal(True, True), some_corners(24)
    shift, linear = np.full((24, 2), (1.0, -1.0)), np.zeros((24, 2, 2))
    if how == "deformed":
        linear[::2] = LINEAR
    structure = shift - 0.3 if how == "fixed" else None

    def some(rows: np.ndarray) -> Refined:
        start = InitialEstimate(shift[rows], linear[rows], None if structure is None else structure[rows])
        return refine(pair.reference, pair.target, corners[rows], start, window_px=61)

    together = some(np.arange(24))
    assert 6 < together.converged.sum() < 24
    backwards = np.arange(24)[::-1]
    assert_same_bits(some(backwards), together, backwards)
    for part in np.array_split(np.arange(24), 7):
        assert_same_bits(some(part), together, part)


@pytest.mark.slow
def test_a_kernel_from_disk_gives_what_the_one_just_compiled_gave(tmp_path: Path) -> None:
    def run() -> str:
        environment = {
            **os.environ,
            "PYTHONPATH": str(REPOSITORY),
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        }
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", DIGEST],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    compiled = run()
    kept = list((tmp_path / "cache").rglob("refinement.refine_points-*.nb*"))
    assert len(kept) == 2, "one index, one kernel: parts are not kept by themselves"
    assert run() == compiled
    assert all(int(line) > 0 for line in compiled.split()[:-1])
