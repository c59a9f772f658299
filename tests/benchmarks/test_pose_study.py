"""What the study of poses counts, and how it compares points."""

import math
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.poses import Warp, mapped
from benchmarks.runs import Job, Outcome
from benchmarks.studies.pose import (
    Ground,
    Precision,
    Trial,
    _corner_errors,
    moved,
    pooled_ratio,
    precision_of,
)

SHAPE = 400, 400
TRUTH = np.array([3.0, -2.0])
REFUSED = Outcome(None, "no", 1.0)


def ground(target_per_reference: float = 1.0) -> Ground:
    job = Job(Path("reference.tif"), Path("target.tif"))
    return Ground("pair", job, partial(moved, (float(TRUTH[0]), float(TRUTH[1]))), target_per_reference)


def with_points(positions: np.ndarray) -> Any:
    return SimpleNamespace(positions=positions)


@pytest.mark.parametrize(
    ("error_px", "right_px", "verdict"),
    [
        (math.nan, 3.0, "refused"),
        (3.0, 3.0, "registered"),
        (3.1, 3.0, "inexact"),
        (5.0, 3.0, "inexact"),
        (5.1, 3.0, "WRONG"),
        (5.0, 5.0, "registered"),
    ],
)
def test_verdict(error_px: float, right_px: float, verdict: str) -> None:
    assert Trial("pair", REFUSED, error_px, right_px).verdict == verdict


def test_a_refusal_counts_beside_the_corner_errors() -> None:
    trials = [Trial("pair", REFUSED, 1.0, corners_px=error_px) for error_px in (2.0, 4.0)]
    refused = Trial("pair", REFUSED, math.nan)
    rows = _corner_errors([("two", [*trials, refused]), ("none", [refused])]).rows
    assert rows == [["two", 3, 1, 3.0, 3.0, "135"], ["none", 1, 1, "-", "-", "-"]]


def test_scales_keep_to_those_that_are_looked_for() -> None:
    assert ground().scales == (0.6, 1.7)
    assert ground(1 / 3).scales == pytest.approx((0.75, 1.7))
    assert ground(3.0).scales == pytest.approx((0.6, 4 / 3))


def test_pooled_ratio_weighs_by_points() -> None:
    # mean squares of all points: (10 * 0.04 + 30 * 0.08) / 40 = 0.07, (20 * 0.03 + 20 * 0.05) / 40 = 0.04
    several = [Precision((10, 0.04), (20, 0.03)), Precision((30, 0.08), (20, 0.05))]
    assert pooled_ratio(several) == pytest.approx(math.sqrt(0.07 / 0.04))
    assert several[0].ratio == pytest.approx(math.sqrt(0.04 / 0.03))
    assert math.isnan(pooled_ratio([]))


@pytest.mark.parametrize(("scale", "expected"), [(0.7, 0.3 / 0.2), (1.6, 0.3 / 1.6 / 0.2)])
def test_precision_is_in_px_of_the_coarser_target(scale: float, expected: float) -> None:
    """Points 0.3 px off in the warped target: 0.3 px where that is coarser, less where it is finer."""
    rng = np.random.default_rng(1)
    reference = rng.uniform(50, 350, (500, 2))
    direction = rng.uniform(0, 2 * np.pi, 500)
    unit = np.column_stack([np.cos(direction), np.sin(direction)])
    true = reference + TRUTH
    warp = Warp(70.0, scale, 0.0, (0.0, 0.0))
    base = with_points(np.hstack([reference, true + 0.2 * unit]))
    warped = with_points(np.hstack([reference, mapped(warp.matrix(SHAPE), true) + 0.3 * unit]))
    found = precision_of(ground(), base, warp, warped, SHAPE)
    assert found is not None
    assert found.ratio == pytest.approx(expected, rel=1e-6)


def test_precision_compares_the_same_part_of_the_ground() -> None:
    """Points of the pair as it is that the warped image does not show do not count."""
    reference = np.column_stack([np.linspace(5, 395, 40), np.full(40, 200.0)])
    true = reference + TRUTH
    warp = Warp(0.0, 1.0, 0.0, (0.25, 0.0))  # the right quarter is lost
    shown = true[:, 0] < 300
    off = np.where(shown[:, None], 0.1, 1.0) * np.array([1.0, 0.0])
    warped = with_points(
        np.hstack([reference, mapped(warp.matrix(SHAPE), true) + np.array([0.1, 0.0])])[shown]
    )
    found = precision_of(ground(), with_points(np.hstack([reference, true + off])), warp, warped, SHAPE)
    assert found is not None
    assert found.as_it_is[0] == pytest.approx(shown.sum(), abs=1)
    assert found.ratio == pytest.approx(1.0, rel=1e-6)
