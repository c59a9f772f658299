"""Whether a pair that agrees at no displacement agrees in its ground, or in what stands still in both frames.

A sensor's fixed pattern, dust, vignetting and burnt-in text lie on the same pixels of all frames of a camera,
wherever the ground is. They are asked for only where the tie points lie on the same pixels of both files, or
at most a few pixels beside: what stands still draws the points of ground that has moved by so little.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import RasterInfo, RpcGrid, View, Window
from pcwlad_geo.registration.frame_marks import Frames, without_marked, without_specks
from pcwlad_geo.registration.frame_structure import (
    FrameParameters,
    common_grey,
    ground_beside,
    is_of_single_pixels,
    near_rival,
    rival,
    share_at,
)
from pcwlad_geo.types import Bool, Float32, Float64

SAME_PIXELS: Final = "the two agree at exactly the same pixels of both files, and "
"""How the doubt of such a pair begins."""
WITHOUT_SPECKS: Final = "without small specks that both have"
"""How small specks are left out."""
WITHOUT_LINES: Final = "without what whole columns or rows share"
"""How stripes and dead columns are left out."""
WITHOUT_PATTERN: Final = "without what differs from pixel to pixel as a sensor's pattern does"
"""How a pattern of single pixels is left out."""


@dataclass(frozen=True, slots=True)
class FrameEvidence:
    """What speaks for the ground where two files agree pixel by pixel."""

    share: float
    """Share of the places with structure that agree at no displacement."""
    rival_px: tuple[float, float] | None
    """Another displacement (col, row) of the ground, target px, that the difference of both shows."""
    manner: str = "once smoothed"
    """What was done to both before the share was taken."""
    parameters: FrameParameters = FrameParameters()

    @property
    def ground_px(self) -> tuple[float, float] | None:
        """The displacement (col, row) at which the ground can be matched apart from what stands still."""
        is_near = self.rival_px is None or max(map(abs, self.rival_px)) < self.parameters.rival_min_px
        return None if is_near else self.rival_px

    @property
    def is_frame(self) -> bool:
        """Whether the ground does not lie where the two agree."""
        return self.rival_px is not None or self.share < self.parameters.frame_share

    @property
    def doubt(self) -> str | None:
        """Why the ground may not lie where the two agree; None where nothing speaks against it."""
        if self.rival_px is None and self.share >= self.parameters.ground_share:
            return None
        evidence = f"only {100 * self.share:.0f} % of the places with structure agree there {self.manner}"
        if self.rival_px is not None:
            col, row = self.rival_px
            evidence = f"without it there is ground that has moved by about ({col:+.2g}, {row:+.2g}) px"
        still = "only in what stands still in both frames"
        if not self.is_frame:
            still = "perhaps only in what stands still in both frames"
        return (
            f"{SAME_PIXELS}{still}: a fixed pattern of the sensor, dust, vignetting, or text, lines and "
            f"masks burnt in ({evidence}); mask it, correct the frames for it, or give their georeferencing"
        )


def frame_evidence(
    reference: RasterInfo,
    target: RasterInfo,
    reference_px: Float64,
    target_px: Float64,
    parameters: FrameParameters = FrameParameters(),
    within: Window | None = None,
) -> FrameEvidence | None:
    """Return what speaks for the ground of a pair whose tie points lie on about the same pixels of both.

    None where they do not, where the images have too few places with structure, or where their grey values
    have nothing in common: then they are of different bands, and share no pattern of a sensor.

    Parameters
    ----------
    reference, target : RasterInfo
        The files.
    reference_px, target_px : (n, 2) arrays
        Tie points (col, row), px of the files.
    within : Window, optional
        The part of both files that may be read; by default all.
    """
    rpc = isinstance(reference.grid, RpcGrid) or isinstance(target.grid, RpcGrid)
    if rpc or reference.grid.shape != target.grid.shape or len(reference_px) == 0:
        return None
    displacement_px = target_px - reference_px
    middle_px = np.median(displacement_px, axis=0)
    raw = not (reference.georeferenced or target.georeferenced)  # others are no frames of a camera
    distant = np.abs(middle_px).max() > min(reference.grid.shape) / 4
    if distant or (_is_beyond(middle_px, parameters) and not raw):
        return None
    with suppress(InputError):
        (one, valid_in_one), (other, valid_in_other) = (
            _middle_of(info, parameters, within) for info in (reference, target)
        )
        return _evidence_of(
            displacement_px, Frames(one, other, valid_in_one & valid_in_other), raw, parameters
        )
    return None


def _is_beyond(middle_px: Float64, parameters: FrameParameters) -> bool:
    """Return whether points at (2,) `middle_px` lie farther off than what stands still draws them."""
    size_px = np.abs(middle_px)
    return bool(size_px.max() > parameters.rival_min_px and size_px.min() > parameters.identity_px)


def _evidence_of(
    displacement_px: Float64, frames: Frames, raw: bool, parameters: FrameParameters
) -> FrameEvidence | None:
    """Return what speaks for the ground of two (rows, cols) images whose points have (n, 2) displacements."""
    middle_px = np.median(displacement_px, axis=0)
    most_px = float(np.quantile(np.hypot(*displacement_px.T), parameters.most))
    unmarked = without_marked(frames, parameters.specks)
    if not unmarked.valid.any():
        return None
    marked = frames._replace(valid=unmarked.valid)
    is_alike = common_grey(marked) >= parameters.common_grey
    unspecked = None
    if raw and is_alike:
        unspecked = without_specks(unmarked, parameters.specks, parameters.smooth_px)
    near_px = None
    if not _is_beyond(middle_px, parameters):  # beside the way, clouds of a map have moved
        near_px = near_rival(marked, middle_px, parameters, on_the_way=not raw)
    if near_px is None and raw and is_alike:  # ground that is bent, or moves in part, is no frame's
        near_px = ground_beside(unspecked or unmarked, displacement_px, parameters)
    on_axis = (np.abs(middle_px) <= parameters.identity_px) & (
        np.quantile(np.abs(displacement_px), parameters.most, axis=0) <= parameters.scatter_px
    )
    pulled = max(float(np.abs(middle_px).max()), most_px) > parameters.pulled_px
    if pulled and near_px is not None:
        return FrameEvidence(1.0, near_px, parameters=parameters)
    if pulled and not on_axis.any():
        return None
    window, quarter = parameters.window_px, min(frames.one.shape) // 8 * 2 + 1
    window = max(parameters.smallest_window_px, min(quarter, window)) if raw else window
    if pulled:  # whole columns or rows place the points along one axis alone
        share = share_at(middle_px, unmarked, window, parameters)
        if share is None or share >= parameters.frame_share:
            return None
        return FrameEvidence(share, None, WITHOUT_LINES, parameters)
    rival_px = near_px or rival(unmarked, parameters)
    if rival_px is None and is_of_single_pixels(frames, parameters):
        return FrameEvidence(0.0, None, WITHOUT_PATTERN, parameters)
    exact = bool(on_axis.all()) and most_px <= parameters.scatter_px
    if rival_px is None and not (exact and is_alike):
        return None
    share = share_at(middle_px, unmarked, window, parameters)
    if share is None:
        return None
    if rival_px is None and unspecked is not None:
        rest = share_at(middle_px, unspecked, window, parameters)
        if rest is not None and rest < share:
            return FrameEvidence(rest, None, WITHOUT_SPECKS, parameters)
    return FrameEvidence(share, rival_px, parameters=parameters)


def _middle_of(info: RasterInfo, parameters: FrameParameters, within: Window | None) -> tuple[Float32, Bool]:
    """Return the (rows, cols) values and validity of the middle of a file, the invalid ones as the median."""
    rows, cols = (min(n, parameters.largest_px) for n in info.grid.shape)
    window = Window((info.grid.shape[0] - rows) // 2, (info.grid.shape[1] - cols) // 2, rows, cols)
    if within is not None:
        window = window.intersection(within)
    patch = View(info, info.grid, "none").read(window)
    values = patch.values.astype(np.float32)
    if patch.valid.any():
        values[~patch.valid] = np.median(values[patch.valid])
    return values, patch.valid
