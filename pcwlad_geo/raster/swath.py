"""Swaths: images whose pixels are placed by arrays of map coordinates, from pixels to the ground and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from affine import Affine

from pcwlad_geo.correction.dense import in_chunks, positions, solve_2x2
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.raster.grid import PixelMapping
from pcwlad_geo.types import Bool, Float32, Float64, Index


@dataclass(frozen=True, slots=True)
class SwathParameters:
    """How positions in a swath are found, and the scans of its sensor."""

    samples: int = 65
    """Nodes along an axis between which the iteration starts."""
    iterations: int = 12
    """Steps of the iteration within a scan."""
    tolerance_px: float = 1e-4
    """Step at which the iteration ends."""
    largest_miss_px: float = 0.05
    """Distance from the position looked for up to which the end of an iteration counts."""
    outside_nodes: float = 2.0
    """Distance outside of the arrays from which a position need not be exact."""
    scans_tried: int = 4
    """Neighbouring scans that are tried for a position."""
    compared_rows: int = 33
    """Rows among which the step from one to the next is compared."""
    scan_jump: float = 0.2
    """Deviation of a step, of its length, from which a new scan begins there …"""
    scan_share: float = 0.2
    """… if this share of the columns deviates."""
    least_scan_rows: int = 4
    """Rows of the smallest scan: arrays with fewer do not show the scans."""


SWATHS: Final = SwathParameters()
"""Those in use."""


@dataclass(frozen=True, eq=False)
class Swath:
    """Where the pixels of an image lie by arrays of map coordinates.

    The *flat* pixels are those of the geotransform that fits the arrays best. Positions between the nodes are
    interpolated bilinearly within a scan, and its outermost nodes are continued: where scans of a sensor
    overlap, no position lies between two of them. All pixels are (col, row), corner-based.
    """

    away_px: Float32
    """(rows, cols, 2) flat pixel less pixel, at the nodes."""
    valid: Bool
    """(rows, cols) nodes that are known."""
    origin_px: tuple[float, float]
    step_px: tuple[float, float]
    """First node, and distance of the nodes."""
    transform: Affine
    """The geotransform from flat pixels to map coordinates."""

    @cached_property
    def scans(self) -> Index:
        """(n + 1,) first rows of nodes of n scans, and the number of rows."""
        from scipy.ndimage import median_filter  # slow to load, and most rasters are no swaths

        rows, cols = self.valid.shape
        whole = np.array([0, rows])
        sampled = np.unique(np.linspace(0, cols - 1, SWATHS.samples).astype(int))
        steps = 1.0 + np.diff(self.away_px[:, sampled, 1].astype(np.float64), axis=0) / self.step_px[1]
        usual = median_filter(steps, (SWATHS.compared_rows, 1), mode="nearest")
        known = self.valid[1:, sampled] & self.valid[:-1, sampled]
        jumps = known & (np.abs(steps - usual) > SWATHS.scan_jump * np.abs(usual))
        starts = np.flatnonzero(jumps.sum(axis=1) > SWATHS.scan_share * np.maximum(known.sum(axis=1), 1)) + 1
        lengths = np.diff([0, *starts, rows])
        if len(starts) == 0 or np.median(lengths) < SWATHS.least_scan_rows or lengths.min() < 2:
            return whole
        return np.array([0, *starts, rows])

    def flat_px(self, at_px: Float64, predicted: PixelMapping | None = None) -> Float64:
        """Map (n, 2) pixels `at_px` to (n, 2) flat ones; NaN where the arrays have no value.

        Those are of the pixels that `predicted` makes of them, if given, in the scans of the pixels
        themselves: a correction does not move them to the next scan, which shows other ground there.
        """
        return in_chunks(lambda px: self._flat(px, predicted), np.asarray(at_px, dtype=np.float64))

    def own_px(self, flat_px: Float64, forward: PixelMapping | None = None) -> Float64:
        """Map (n, 2) pixels `flat_px` to (n, 2) own ones; NaN where the arrays have no value.

        With `forward` they are what it makes of them, in the scan that then holds them.
        """
        return in_chunks(lambda px: self._own(px, forward), np.asarray(flat_px, dtype=np.float64))

    def within_scans(self, at_px: Float64) -> Float64:
        """Return (n, 2) pixels halfway between `at_px` and the middle rows of their scans, if any."""
        scans, scan = self.scans, self._scan_of(at_px)
        if len(scans) == 2:
            return at_px
        middle_row = self.origin_px[1] + self.step_px[1] * ((scans[scan] + scans[scan + 1] - 1) / 2)
        return np.column_stack([at_px[:, 0], (at_px[:, 1] + middle_row) / 2])

    def _flat(self, at_px: Float64, predicted: PixelMapping | None) -> Float64:
        places = at_px if predicted is None else predicted(at_px)
        flat, _ = self._continued(places, self._scan_of(at_px))
        return np.where(self._known(places)[:, None], flat, np.nan)

    def _own(self, flat_px: Float64, forward: PixelMapping | None) -> Float64:
        own = np.full(flat_px.shape, np.nan)
        finite = np.flatnonzero(np.isfinite(flat_px).all(axis=1))
        if len(finite) == 0:
            return own
        start = self._start.near(flat_px[finite])
        beyond = self._beyond(start)
        own[finite[beyond]] = start[beyond]
        scan = self._scan_of(start)
        best = np.full(len(finite), np.inf)
        waiting = np.arange(len(finite))
        for _ in range(SWATHS.scans_tried):
            places, solved = self._within(flat_px[finite[waiting]], start[waiting], scan[waiting])
            seen = places if forward is None else forward(places)
            outside = np.where(solved, self._rows_outside(seen, scan[waiting]), np.inf)
            better = outside < best[waiting]
            own[finite[waiting[better]]] = seen[better]
            best[waiting[better]] = outside[better]
            start[waiting] = np.where(solved[:, None], places, start[waiting])
            latest = np.where(solved, self._scan_of(seen), scan[waiting])
            moved = latest != scan[waiting]
            scan[waiting] = latest
            waiting = waiting[moved]
            if len(waiting) == 0:
                break
        return np.where(self._known(own)[:, None], own, np.nan)

    def _within(self, flat_px: Float64, start_px: Float64, scan: Index) -> tuple[Float64, Bool]:
        """Return the (n, 2) pixels of the given scans at (n, 2) flat ones, and whether they are solved."""
        places = start_px.copy()
        moving = np.arange(len(places))
        longest = max(self.away_px.shape[:2]) * max(self.step_px)
        for _ in range(SWATHS.iterations):
            flat, slopes = self._continued(places[moving], scan[moving])
            step = np.clip(solve_2x2(slopes, flat_px[moving] - flat), -longest, longest)
            step[~np.isfinite(step)] = 0.0
            places[moving] += step
            moving = moving[np.abs(step).max(axis=1) > SWATHS.tolerance_px]
            if len(moving) == 0:
                break
        miss = np.abs(self._continued(places, scan)[0] - flat_px).max(axis=1)
        return places, miss <= SWATHS.largest_miss_px

    def _continued(self, at_px: Float64, scan: Index) -> tuple[Float64, Float64]:
        """Return the (n, 2) flat pixels of (n, 2) pixels by the nodes of a scan, and the (n, 2, 2) slopes."""
        place = (at_px - self.origin_px) / self.step_px
        scans, last_col = self.scans, self.away_px.shape[1] - 2
        col = np.clip(np.floor(place[:, 0]), 0, last_col).astype(np.intp)
        row = np.clip(np.floor(place[:, 1]), scans[scan], scans[scan + 1] - 2).astype(np.intp)
        right, down = (place - np.column_stack([col, row]))[:, :, None].transpose(1, 0, 2)
        away = self.away_px
        upper, lower = away[row, col].astype(np.float64), away[row + 1, col].astype(np.float64)
        along_upper, along_lower = away[row, col + 1] - upper, away[row + 1, col + 1] - lower
        upper, lower = upper + right * along_upper, lower + right * along_lower
        by_col = along_upper * (1 - down) + along_lower * down
        slopes = np.stack([by_col / self.step_px[0], (lower - upper) / self.step_px[1]], axis=2)
        return at_px + upper * (1 - down) + lower * down, slopes + np.eye(2)

    def _scan_of(self, at_px: Float64) -> Index:
        """Return the (n,) scans, from 0, whose lines of the image hold (n, 2) pixels."""
        scans = self.scans
        if len(scans) == 2:
            return np.zeros(len(at_px), dtype=np.intp)
        first_px = self.origin_px[1] + self.step_px[1] * (scans[1:-1] - 0.5)
        return np.searchsorted(first_px, at_px[:, 1], side="right")

    def _rows_outside(self, at_px: Float64, scan: Index) -> Float64:
        """Return by how many px (n, 2) pixels lie outside of the lines of their (n,) scans; 0 inside."""
        scans = self.scans
        row = (at_px[:, 1] - self.origin_px[1]) / self.step_px[1]
        above = np.where(scan == 0, -np.inf, scans[scan] - 0.5)
        below = np.where(scan == len(scans) - 2, np.inf, scans[scan + 1] - 0.5)
        return np.maximum(np.maximum(above - row, row - below), 0.0) * self.step_px[1]

    def _beyond(self, at_px: Float64) -> Bool:
        """Return which (n, 2) pixels lie so far outside of the arrays that it does not matter where."""
        place, last = (at_px - self.origin_px) / self.step_px, np.array(self.valid.shape[::-1]) - 1
        margin = SWATHS.outside_nodes
        return np.asarray(((place < -margin) | (place > last + margin)).any(axis=1))

    def _known(self, at_px: Float64) -> Bool:
        """Return whether the nodes nearest (n, 2) pixels have values."""
        place = np.nan_to_num(np.rint((at_px - self.origin_px) / self.step_px))
        col, row = np.clip(place, 0, np.array(self.valid.shape[::-1]) - 1).astype(np.intp).T
        return np.asarray(self.valid[row, col])

    @cached_property
    def _start(self) -> _Start:
        """Sampled nodes; where scans overlap, of their middles."""
        rows, cols = (np.arange(size) for size in self.valid.shape)
        if len(self.scans) > 2:
            rows = (self.scans[:-1] + self.scans[1:] - 1) // 2
        row, col = (
            index.ravel()
            for index in np.meshgrid(
                *(values[_spread(len(values))] for values in (rows, cols)), indexing="ij"
            )
        )
        known = self.valid[row, col]
        row, col = row[known], col[known]
        own = np.column_stack([col, row]).astype(np.float64) * self.step_px + self.origin_px
        return _Start(np.asarray(own + self.away_px[row, col]), np.asarray(own))


class _Start:
    """Where an iteration starts, between sampled nodes."""

    def __init__(self, flat_px: Float64, own_px: Float64) -> None:
        from scipy.interpolate import LinearNDInterpolator  # slow to load, and most rasters are no swaths
        from scipy.spatial import KDTree

        self._flat_px, self._own_px = flat_px, own_px
        self._inside, self._nearest = LinearNDInterpolator(flat_px, own_px), KDTree(flat_px)

    def near(self, flat_px: Float64) -> Float64:
        """Return (n, 2) pixels near those of (n, 2) flat ones."""
        own = np.asarray(self._inside(flat_px))
        outside = np.isnan(own[:, 0])
        if outside.any():
            nearest = self._nearest.query(flat_px[outside])[1]
            own[outside] = self._own_px[nearest] + flat_px[outside] - self._flat_px[nearest]
        return own


def _spread(size: int) -> Index:
    """Return the indices of samples spread over an axis."""
    return np.unique(np.linspace(0, size - 1, SWATHS.samples).astype(np.intp))


def fitted_swath(
    xy: Float64, valid: Bool, origin_px: tuple[float, float], step_px: tuple[float, float]
) -> Swath:
    """Return the swath of the (rows, cols, 2) map coordinates `xy` of nodes, those that are `valid`.

    The mask `valid` is a (rows, cols) array. The first node lies at the pixel `origin_px` (col, row), the
    others `step_px` apart.
    """
    rows, cols = valid.shape
    if not valid.all():  # an iteration may pass there
        from scipy.ndimage import distance_transform_edt  # slow to load, and seldom needed

        nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
        xy = xy[tuple(nearest)]
    own = positions(
        *(
            np.arange(size) * step + first
            for size, step, first in zip((cols, rows), step_px, origin_px, strict=True)
        )
    )
    xy = xy.reshape(-1, 2)
    sampled = np.zeros(valid.shape, dtype=bool)
    sampled[np.ix_(_spread(rows), _spread(cols))] = True
    fit = (sampled & valid).ravel()
    best = AffineTransform.fit(own[fit], xy[fit])
    away = (in_chunks(best.apply_inverse, xy) - own).astype(np.float32).reshape(rows, cols, 2)
    return Swath(away, valid, origin_px, step_px, Affine(*best.rows.ravel().tolist()))
