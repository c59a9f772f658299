"""Tiles: what one task needs to match a part of the scene, and the task itself."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.guidance import FieldGuide
from pcwlad_geo.matching.matcher import (
    HALO_PX,
    Core,
    margin_px,
    match_candidates,
    rematch,
)
from pcwlad_geo.matching.noise import Noise
from pcwlad_geo.matching.prepare import Image, PreparedPair, prepare
from pcwlad_geo.matching.settings import TRAITS, MatchSettings
from pcwlad_geo.matching.tie_points import TiePoints
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.view import View
from pcwlad_geo.raster.windows import Window

CELL_MARGIN_PX: Final = 64
"""A cell that begins in the core may reach beyond it."""
ONE_TILE: Final = 1.3
"""A scene is one tile up to this many tile sizes."""


@dataclass(frozen=True, slots=True)
class Scene:
    """What all tiles of a band have in common, measured once."""

    epsilon: float
    noise: Noise


@dataclass(frozen=True, slots=True)
class TileJob:
    """A tile: small and picklable, no arrays, no open files."""

    id: int
    reference: View
    target: View
    region: Window
    """What all tiles cover together; the cells of the corners are laid out from its first pixel."""
    core: Window
    """Part of the reference view whose corners are matched."""
    target_offset_px: tuple[int, int]
    """(col, row): target-view px at the start of the search minus reference-view px."""
    reference_scene: Scene
    target_scene: Scene
    settings: MatchSettings


@dataclass(frozen=True, slots=True, eq=False)
class TileResult:
    """What a tile gave."""

    id: int
    status: Literal["matched", "empty", "failed"]
    points: TiePoints
    """In pixel coordinates of the two views."""
    counts: dict[str, int]
    reason: str | None
    seconds: float


def plan_tiles(
    pair: ViewPair,
    target_offset_px: tuple[int, int],
    scenes: tuple[Scene, Scene],
    settings: MatchSettings,
    tile_size: int,
) -> list[TileJob]:
    """Cover the part of the reference that the shifted target covers.

    Parameters
    ----------
    pair : ViewPair
    target_offset_px : (int, int)
        (col, row) from reference view to target view, pre-alignment included.
    scenes : (Scene, Scene)
        Of reference and target.
    settings : MatchSettings
    tile_size : int
        Core of a tile, px.
    """
    region = common_region(pair, target_offset_px)
    jobs: list[TileJob] = []
    for row, rows in _spans(region.row, region.rows, tile_size):
        for col, cols in _spans(region.col, region.cols, tile_size):
            core = Window(row, col, rows, cols)
            jobs.append(
                TileJob(
                    len(jobs),
                    pair.reference,
                    pair.target,
                    region,
                    core,
                    target_offset_px,
                    *scenes,
                    settings,
                )
            )
    return jobs


def common_region(pair: ViewPair, target_offset_px: tuple[int, int]) -> Window:
    """Return the part of the reference view that the target view covers at an offset."""
    col, row = target_offset_px
    rows, cols = pair.reference.grid.shape
    target_rows, target_cols = pair.target.grid.shape
    top, left = max(0, -row), max(0, -col)
    bottom, right = min(rows, target_rows - row), min(cols, target_cols - col)
    return Window(top, left, max(0, bottom - top), max(0, right - left))


def match_tile(job: TileJob) -> TileResult:
    """First pass of a tile."""
    begun = time.perf_counter()
    try:
        prepared = _prepare(job)
    except InputError as error:
        return TileResult(job.id, "failed", TiePoints.empty(), {}, str(error), time.perf_counter() - begun)
    if prepared is None:
        return TileResult(
            job.id, "empty", TiePoints.empty(), {}, "no valid pixels", time.perf_counter() - begun
        )
    pair, window = prepared
    core = Core(
        job.core.row - window.row,
        job.core.col - window.col,
        job.core.row - window.row + job.core.rows,
        job.core.col - window.col + job.core.cols,
        (window.row - job.region.row, window.col - job.region.col),
    )
    points, counts = match_candidates(pair, core, job.settings)
    moved = points.shifted(*_origins(job, window))
    status: Literal["matched", "empty"] = "matched" if len(points) else "empty"
    return TileResult(job.id, status, moved, counts, None, time.perf_counter() - begun)


def rematch_tile(job: TileJob, points: TiePoints, guide: FieldGuide) -> TileResult:
    """Second pass of a tile: its consistent points again, guided by the displacement field."""
    begun = time.perf_counter()
    prepared = _prepare(job)
    if prepared is None:
        return TileResult(job.id, "empty", points, {}, "no valid pixels", time.perf_counter() - begun)
    pair, window = prepared
    reference_origin, target_origin = _origins(job, window)
    inside = points.shifted(-reference_origin, -target_origin)
    # shifts inside the arrays leave out the offset between the two windows
    between = target_origin - reference_origin
    again = rematch(pair, inside, guide.moved(-between), job.settings)
    return TileResult(
        job.id,
        "matched",
        again.shifted(reference_origin, target_origin),
        {},
        None,
        time.perf_counter() - begun,
    )


def _prepare(job: TileJob) -> tuple[PreparedPair, Window] | None:
    window = job.core.padded(HALO_PX + margin_px(job.settings) + CELL_MARGIN_PX)
    reference = job.reference.read(window)
    target = job.target.read(window.moved(job.target_offset_px[1], job.target_offset_px[0]))
    if not reference.valid.any() or not target.valid.any():
        return None
    pair = prepare(
        Image(reference.values, reference.valid, job.reference_scene.epsilon, job.reference_scene.noise),
        Image(target.values, target.valid, job.target_scene.epsilon, job.target_scene.noise),
        channels=TRAITS[job.settings.method].channels,
    )
    return pair, window


def _origins(job: TileJob, window: Window) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    reference = np.array([window.col, window.row], np.float64)
    return reference, reference + job.target_offset_px


def _spans(start: int, length: int, tile_size: int) -> list[tuple[int, int]]:
    """Split a range into about equal parts of at most ONE_TILE tile sizes."""
    count = 1 if length <= ONE_TILE * tile_size else int(np.ceil(length / tile_size))
    edges = np.linspace(start, start + length, count + 1).round().astype(int)
    return [(int(a), int(b - a)) for a, b in pairwise(edges)]
