"""The correlation at one shift is that of the surface of all shifts."""

from __future__ import annotations

import numpy as np
import pytest

from pcwlad_geo.matching.channels import Channels
from pcwlad_geo.matching.masked_correlation import correlation_at, masked_correlation


def _channels(shape: tuple[int, int], seed: int) -> Channels:
    rng = np.random.default_rng(seed)
    valid = (rng.random(shape) > 0.2).astype(np.float32)
    values = rng.normal(size=(*shape, 6)).astype(np.float32) + 0.3
    return Channels(values * valid[..., None], valid)


@pytest.mark.parametrize("shift", [(0, 0), (7, -5), (-12, 9), (25, 18), (-20, -22)])
def test_one_shift_is_that_of_the_surface(shift: tuple[int, int]) -> None:
    reference, target = _channels((24, 31), 1), _channels((30, 28), 2)
    surface, _ = masked_correlation(reference, target)
    col, row = shift
    # the surface is in single precision
    np.testing.assert_allclose(
        correlation_at(reference, target, shift), surface[row + 23, col + 30], rtol=0, atol=1e-6
    )


def test_shifts_without_an_overlap_correlate_with_nothing() -> None:
    reference = _channels((24, 31), 1)
    assert correlation_at(reference, reference, (40, 0)) == 0.0
    assert correlation_at(reference, Channels(reference.values, 0 * reference.valid), (0, 0)) == 0.0
