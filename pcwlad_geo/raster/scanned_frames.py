"""Borders of scanned frames: film of one tone, with fiducial marks, clocks and text in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcwlad_geo.raster.collars import Collar, Read
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class FrameParameters:
    """What counts as the border of a scanned frame."""

    overview_px: int = 1024
    """Largest side of the overview that is looked at."""
    strip_px: int = 3
    """Rows at the top, in the middle and at the bottom that show whether a raster may be a framed scan."""
    even: float = 0.25
    """Largest spread of the outer ones of these strips, as a share of the spread of the middle one."""
    tolerance: float = 0.08
    """Difference from its tone, as a share of that spread, that the border of a scan may have at least."""
    depth: float = 0.2
    """Largest depth of a border, as a share of the image."""
    edge_px: int = 8
    """Depth of the strips on both sides of the border's end, px of the overview."""
    outside: float = 0.7
    """Least share of the border that has its tone: fiducial marks, clocks and text have the rest."""
    inside: float = 0.4
    """Largest share of the image just inside that has the tone of the border."""
    blended_px: float = 1.5
    """Width of the edge that counts as border, px of the overview."""


@np.errstate(over="ignore", invalid="ignore")
def find_frame(
    read: Read, shape: tuple[int, int], parameters: FrameParameters = FrameParameters()
) -> Collar | None:
    """Find the border of a scanned frame: film of one tone, with fiducial marks, clocks and text in it.

    All frames of a camera have the same one, on which they would agree whatever they show. Its tone is that
    of the outermost pixels, and at least three sides of it must end on a straight line beyond which hardly
    a pixel has that tone. Scans are of unsigned numbers. The band has `shape` rows and columns and is read
    by `read`.
    """
    rows, cols = shape
    if min(shape) < 8 * parameters.edge_px:
        return None
    across = parameters.strip_px, min(cols, parameters.overview_px)
    begins = (0, (rows - parameters.strip_px) // 2, rows - parameters.strip_px)
    read_strips = [read(Window(row, 0, parameters.strip_px, cols), across) for row in begins]
    strips = [strip.astype(np.float64) for strip in read_strips]
    top, middle, bottom = (float(np.ptp(np.percentile(strip, (10, 90)))) for strip in strips)
    if read_strips[0].dtype.kind != "u" or max(top, bottom) > parameters.even * middle or middle == 0:
        return None
    factor = max(1.0, max(shape) / parameters.overview_px)
    small = round(rows / factor), round(cols / factor)
    overview = read(Window.whole(shape), small).astype(np.float64)
    views = {(0, -1): overview, (0, 1): overview[::-1], (-1, 0): overview.T, (1, 0): overview.T[::-1]}
    sides = []
    for outward, view in views.items():
        ends = _border_end(view, parameters.tolerance * middle, parameters)
        if ends is not None:
            sides.append(_side_of(outward, np.add(ends, parameters.blended_px) * factor, shape))
    if len(sides) < 3:  # of the four of a scan
        return None
    value = float(np.median([np.median(strips[0]), np.median(strips[2])]))
    return Collar(shape, value, tuple(sides)).measured(small)


def _border_end(
    overview: Float64, tolerance: float, parameters: FrameParameters
) -> tuple[float, float] | None:
    """Return how deep the border at the top of an image reaches at its left and at its right side, px.

    None where there is none. `tolerance` is the least difference from its tone that it may have.
    """
    outermost = overview[: parameters.strip_px]
    tone = float(np.median(outermost))
    spread = float(np.median(np.abs(outermost - tone)))
    same = np.abs(overview[:, ::2] - tone) <= max(6 * spread, tolerance)
    depth = np.arange(int(parameters.depth * len(overview)))
    col = np.arange(same.shape[1])
    edge = np.ones(parameters.edge_px) / parameters.edge_px
    best, best_ends = 0.0, None
    for slope in np.linspace(-0.03, 0.03, 25):  # a scan is laid down within two degrees
        tilt = slope * (2 * col - overview.shape[1] / 2)
        at = np.clip(np.rint(depth[:, None] + tilt).astype(int), 0, len(overview) - 1)
        share = same[at, col].mean(axis=1)
        mean = np.convolve(share, edge, "valid")
        outer, inner = mean[: -parameters.edge_px - 2], mean[parameters.edge_px + 2 :]
        ends = depth[: len(outer)] + parameters.edge_px
        all_of_it = np.cumsum(share)[ends - 1] / ends
        step = np.where(
            (np.minimum(outer, all_of_it) >= parameters.outside) & (inner <= parameters.inside),
            outer - inner,
            0,
        )
        if step.max() > best:
            best, end = float(step.max()), float(ends[step.argmax()])
            best_ends = end + 2 - slope * overview.shape[1] / 2, end + 2 + slope * overview.shape[1] / 2
    return best_ends


def _side_of(
    outward: tuple[int, int], ends_px: Float64, shape: tuple[int, int]
) -> tuple[float, float, float]:
    """Return the side of a collar (see `Collar.sides`) whose (2,) depths at both ends of a border are given.

    `outward` is the direction (col, row) of the border.
    """
    rows, cols = shape
    along = np.array([0.0, cols if outward[1] else rows])
    opposite = cols if outward == (1, 0) else rows if outward == (0, 1) else 0
    depth = opposite - ends_px if opposite else ends_px
    places = np.column_stack([along, depth] if outward[1] else [depth, along])
    edge = places[1] - places[0]
    normal = np.array([edge[1], -edge[0]]) / np.hypot(*edge)
    normal *= np.sign(normal @ outward)
    a, b = normal.tolist()
    return a, b, float(normal @ places[0])
