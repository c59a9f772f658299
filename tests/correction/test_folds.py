from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.correction.cross_validation import cross_validation_blocks, spatial_blocks

from .points import scattered


def test_blocks_are_compact_and_equal() -> None:
    points = scattered(9, 320)
    blocks = spatial_blocks(points, 16)
    assert np.bincount(blocks).tolist() == [20] * 16
    for number in range(16):
        assert (np.ptp(points[blocks == number], axis=0) < 300).all()


@pytest.mark.parametrize(
    ("n", "side", "window", "blocks"),
    [
        (1000, 512.0, 81, 32),  # one window wide, to the next power of two below
        (1000, 2048.0, 81, 256),  # three points a block
        (3000, 200.0, 81, 16),
        (40, 512.0, 81, 8),
        (9000, 512.0, 0, 1024),
    ],
)
def test_number_of_blocks(n: int, side: float, window: int, blocks: int) -> None:
    has_foldover = cross_validation_blocks(scattered(0, n, side), window)
    assert len(np.unique(has_foldover.block)) == blocks
    assert len(has_foldover.tests) == min(blocks, 16)
    np.testing.assert_array_equal(np.sum(has_foldover.tests, axis=0), 1)


def test_the_blocks_of_a_fold_lie_apart() -> None:
    points = scattered(1, 4000, 4000)
    has_foldover = cross_validation_blocks(points, 81)
    nearest = []
    for test in has_foldover.tests:
        centres = [
            points[has_foldover.block == number].mean(axis=0)
            for number in np.unique(has_foldover.block[test])
        ]
        distance = np.abs(np.array(centres)[:, None] - np.array(centres)[None]).max(axis=2)
        nearest += np.sort(distance, axis=1)[:, 1].tolist()
    assert np.percentile(nearest, 5) > 200  # blocks of 125 px
