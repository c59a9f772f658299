"""Which parts of a scene are matched: tiles that cover it, or small windows where they serve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from pcwlad_geo.matching.keypoints import cell_side_px
from pcwlad_geo.matching.settings import MatchSettings
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.windows import Window
from pcwlad_geo.registration.forecast import tiles_along
from pcwlad_geo.registration.prealign import Look
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.registration.sites import find_sites, lattice_places, lattice_shape, small_window
from pcwlad_geo.registration.tiles import TileJob, TileResult

FEATURE_AREA_PX: Final = 1024
"""`features` candidates lie in a square of this side, or in the scene where that is smaller."""
POINTS_OF_A_SCENE: Final = 1000
"""Tie points of a scene of several tiles, where the user does not say."""
CANDIDATES_PER_POINT: Final = 1.25
POOR: Final = 1 / 3
"""A small window in which a smaller share of the candidates agrees is followed by another."""
ENOUGH: Final = 0.95
"""Of the points wanted."""
AGREE_PX: Final = 1.0
"""Of the typical displacement in a small window."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The tiles to match first, and what may follow."""

    first: list[TileJob]
    wanted: int | None = None
    """Tie points wanted from small windows; None: the tiles cover the scene."""
    sites: tuple[tuple[TileJob, ...], ...] = ()
    """Small windows: one tuple for each place of the lattice, the best window first."""
    barren: tuple[Window, ...] = ()
    """Places of the lattice that show no structure, so that they have no window."""

    def following(self, results: Sequence[TileResult]) -> list[TileJob]:
        """Return the windows to match next, given what all so far gave.

        A window that gave little is followed by the next of its place. Where that cannot be enough, places
        that gave most get another window.
        """
        if self.wanted is None:
            return []
        gave = {result.id: agreeing(result) for result in results}
        poor: list[TileJob] = []
        rich: list[tuple[int, TileJob]] = []
        good = [count for count in gave.values() if count] or [1]
        for site in self.sites:
            upcoming = [job for job in site if job.id not in gave]
            most = max((gave[job.id] for job in site if job.id in gave), default=0)
            if upcoming and most < POOR * upcoming[0].settings.features:
                poor.append(upcoming[0])
            elif upcoming:
                rich.append((most, upcoming[0]))
        missing = ENOUGH * self.wanted - sum(gave.values())
        windows = max(0, int(np.ceil(missing / np.median(good))) - len(poor))
        rich.sort(key=lambda entry: (-entry[0], entry[1].id))
        return poor + [job for _, job in rich[:windows]]


def agreeing(result: TileResult) -> int:
    """Count the points of a small window that moved alike."""
    moved = result.points.displacement_px
    if len(moved) == 0:
        return 0
    return int((np.linalg.norm(moved - np.median(moved, axis=0), axis=1) < AGREE_PX).sum())


def plan(
    pair: ViewPair, look: Look, target_offset_px: tuple[int, int], matching: MatchSettings, settings: Settings
) -> Plan:
    """Decide which windows of the overlap are matched.

    A scene of one tile is matched whole, and so is one of which all points are wanted. Else as many
    candidates as the points need are spread over tiles that cover the scene, or over small windows,
    whichever has fewer pixels to filter.

    Parameters
    ----------
    pair : ViewPair
    look : Look
        Both bands at a glance.
    target_offset_px : (int, int)
        (col, row) from reference view to target view, pre-alignment included.
    matching : MatchSettings
        Its `features_area_px2` is the usable area; the plan replaces the number and spread of candidates.
    settings : Settings
        Its `points`, `features` and `tile_size` count.
    """
    region = common_region(pair, target_offset_px)
    area = matching.features_area_px2 or float(max(region.area_px2, 1))
    base = TileJob(0, pair.reference, pair.target, region, region, target_offset_px, *look.scenes, matching)
    wanted = POINTS_OF_A_SCENE if settings.points is None else settings.points
    candidates = np.inf if wanted == "all" else CANDIDATES_PER_POINT * wanted
    densest = settings.features / min(area, FEATURE_AREA_PX**2)
    one_tile = tiles_along(max(region.shape), settings.tile_size) == 1
    if one_tile or candidates >= densest * area:
        tiles = _cover(base, densest, settings.tile_size)
        return Plan([replace(tile, guides_itself=len(tiles) == 1) for tile in tiles])
    tiles = _cover(base, candidates / area, settings.tile_size)
    window = small_window(base, round(candidates), int(wanted))
    count = int(np.prod(lattice_shape(region, round(candidates))))
    if count * window.read_window.area_px2 >= sum(job.read_window.area_px2 for job in tiles):
        return Plan(tiles)
    sites = find_sites(window, look, round(candidates))
    places = lattice_places(region, round(candidates))
    barren = tuple(place for place, site in zip(places, sites, strict=True) if not site)
    return Plan([site[0] for site in sites if site], int(wanted), sites, barren)


def count_tiles(pair: ViewPair, settings: Settings) -> int:
    """Return about how many tiles a pair makes at least, before it is known where to start."""
    region = common_region(pair, (round(pair.offset_px[0]), round(pair.offset_px[1])))
    return math.prod(tiles_along(length, settings.tile_size) for length in region.shape)


def common_region(pair: ViewPair, target_offset_px: tuple[int, int]) -> Window:
    """Return the part of the reference view that the target view covers at an offset."""
    col, row = target_offset_px
    rows, cols = pair.reference.grid.shape
    target_rows, target_cols = pair.target.grid.shape
    top, left = max(0, -row), max(0, -col)
    bottom, right = min(rows, target_rows - row), min(cols, target_cols - col)
    return Window(top, left, max(0, bottom - top), max(0, right - left))


def _cover(base: TileJob, density: float, tile_size: int) -> list[TileJob]:
    """Cover the region with tiles that hold so many candidates a square pixel."""
    settings = replace(base.settings, features_area_px2=base.settings.features / density)
    margin = cell_side_px(settings.features, settings.per_cell, settings.features / density)
    cores = [
        Window(row, col, rows, cols)
        for row, rows in _spans(base.region.row, base.region.rows, tile_size)
        for col, cols in _spans(base.region.col, base.region.cols, tile_size)
    ]
    return [
        replace(base, id=index, core=core, settings=settings, cell_margin_px=margin)
        for index, core in enumerate(cores)
    ]


def _spans(start: int, length: int, tile_size: int) -> list[tuple[int, int]]:
    """Split a range into the tiles along it."""
    count = tiles_along(length, tile_size)
    edges = np.linspace(start, start + length, count + 1).round().astype(int)
    return [(int(a), int(b - a)) for a, b in pairwise(edges)]
