"""The windows of the second pass, chosen by what a sample of the points shows with each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pcwlad_geo.events import only_warnings
from pcwlad_geo.matching import FieldGuide, Scales, TiePoints
from pcwlad_geo.matching.jitter import jitter_px
from pcwlad_geo.matching.window import WINDOWS
from pcwlad_geo.matching.windows import WindowErrors, choose_scales, sample_size
from pcwlad_geo.registration.motions import share_displaced
from pcwlad_geo.registration.scene.first_pass import FirstPass
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.tiles import compare_stripes, compare_surroundings, compare_windows
from pcwlad_geo.types import Float64, Index


@dataclass(frozen=True, slots=True, eq=False)
class WindowChoice:
    """The windows of the second pass, and what they average out."""

    scales: Scales
    errors: WindowErrors | None = None
    """Those of the windows; None where too few points show them."""
    jitter_px: float = 0.0
    """By how much rows and columns move within a window, RMS, view px."""
    displaced_share: float = 0.0
    """Share of the points around which another displacement fits better."""


def choose_windows(
    first: FirstPass,
    points: TiePoints,
    tile_of: Index,
    guide: FieldGuide,
    other_px: Float64 | None,
    context: SceneContext,
) -> WindowChoice:
    """Choose the windows of the second pass by a sample of the points, whose tiles are spread over the scene.

    The `points` are the consistent ones, in the (n,) tiles `tile_of`, with their guide. The (2,) `other_px`
    (col, row) is a displacement beside their own of which the share of the points is wanted.
    """
    window = first.jobs[0].settings.window
    wanted = sample_size(points.reference_xy_px, window)
    if not wanted:
        return WindowChoice(Scales.of(window.side_px))
    tiles, counts = np.unique(tile_of, return_counts=True)
    # multiples of the golden ratio are spread evenly, however many are taken
    spread = np.argsort((5**0.5 - 1) / 2 * np.arange(len(tiles)) % 1, kind="stable")
    enough = int(np.searchsorted(np.cumsum(counts[spread]), wanted)) + 1
    selection = np.sort(spread[:enough])
    step = max(1, int(counts[selection].sum() / wanted))
    members = [np.flatnonzero(tile_of == tile) for tile in tiles[selection]]
    on_event = partial(only_warnings, context.log.on_event)  # the progress is no stage's own

    def measured(
        compare: Callable[..., Float64], samples: Sequence[Index], *windows_px: Sequence[int]
    ) -> Float64:
        calls = [
            (first.jobs[tile], points[sample], guide.part(sample), *windows_px)
            for tile, sample in zip(tiles[selection], samples, strict=True)
        ]
        return np.concatenate(context.runner.run(compare, calls, "refining", on_event), axis=1)

    samples = [index[::step] for index in members]
    scales, errors = choose_scales(partial(measured, compare_windows, samples), window)
    step = max(1, int(counts[selection].sum() / WINDOWS.sample))  # jitter shows in many points only
    larger = [index[:: max(1, step // 2)] for index in members]
    sample = np.concatenate(larger)
    xy, displacement_px = points.reference_xy_px[sample], points.displacement_px[sample]
    beside_px = context.parameters.stripes_beside_px
    stripes_px = measured(partial(compare_stripes, beside_px=beside_px), larger)
    jitter, share = jitter_px(xy, stripes_px - displacement_px, beside_px), 0.0
    if other_px is not None:
        best_px = measured(partial(compare_surroundings, other_px=other_px), larger)[0]
        share = share_displaced(best_px - displacement_px, other_px, context.parameters.motions)
    return WindowChoice(scales, errors, jitter, share)
