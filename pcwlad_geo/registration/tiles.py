"""Tiles: what one task needs to match a part of the scene, and the task itself."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.candidates import Candidates
from pcwlad_geo.matching.field import Surface
from pcwlad_geo.matching.guidance import FieldGuide, guide_by_field
from pcwlad_geo.matching.matcher import (
    Core,
    consistent_points,
    margin_px,
    match_candidates,
    rematch,
)
from pcwlad_geo.matching.noise import Noise
from pcwlad_geo.matching.prepare import Image, PreparedPair, StackPair, prepare
from pcwlad_geo.matching.settings import TRAITS, MatchSettings
from pcwlad_geo.matching.tie_points import TiePoints
from pcwlad_geo.raster.view import View
from pcwlad_geo.raster.windows import Window
from pcwlad_geo.registration.kept_pairs import KeptPairs

_KEPT = KeptPairs()


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
    guides_itself: bool = False
    """It holds enough neighbours for its own second pass."""
    returns: bool = False
    """Its second pass comes to the same worker, which keeps the maps if it can."""
    cell_margin_px: int = 0
    """How far a cell of candidates that begins in the core may reach beyond it."""

    @property
    def scene(self) -> tuple[View, View, tuple[int, int], Window, MatchSettings]:
        """What tells the tiles of one scene and start from others of the same number."""
        return self.reference, self.target, self.target_offset_px, self.region, self.settings

    @property
    def window(self) -> Window:
        """The part of the reference view whose maps are needed."""
        return self.core.padded(margin_px(self.settings) + self.cell_margin_px)

    @property
    def read_window(self) -> Window:
        """The part of the reference view that is read: with the halo of the filters."""
        return self.window.padded(TRAITS[self.settings.method].halo_px)


@dataclass(frozen=True, slots=True, eq=False)
class Guided:
    """Second pass of a tile that guides itself."""

    index: NDArray[np.intp]
    """(n,) which of the tile's points."""
    points: TiePoints
    """n, covariances formal."""
    surface: Surface | None
    """See `guidance.FieldGuide`."""
    shared_variance_px2: float


@dataclass(frozen=True, slots=True, eq=False)
class TileResult:
    """What a tile gave, in pixel coordinates of the two views."""

    id: int
    status: Literal["matched", "empty", "failed"]
    points: TiePoints
    """Each found on its own, or the second pass of the points given."""
    counts: dict[str, int]
    reason: str | None
    seconds: float
    guided: Guided | None = None
    lost: Candidates = field(default_factory=Candidates.empty)
    """Of the first pass: those that found no match, reference-view px."""


def match_tile(job: TileJob) -> TileResult:
    """First pass of a tile; the second one too where the tile guides itself."""
    begun = time.perf_counter()
    try:
        pair = _prepare(job)
    except InputError as error:
        return TileResult(job.id, "failed", TiePoints.empty(), {}, str(error), time.perf_counter() - begun)
    if pair is None:
        return TileResult(
            job.id, "empty", TiePoints.empty(), {}, "no valid pixels", time.perf_counter() - begun
        )
    window, core = job.window, job.core
    inside = Core(
        core.row - window.row,
        core.col - window.col,
        core.row_stop - window.row,
        core.col_stop - window.col,
        (window.row - job.region.row, window.col - job.region.col),
    )
    points, candidates = match_candidates(pair, inside, job.settings)
    if job.returns and len(points):
        _KEPT.keep(job.scene, job.id, pair.stacks)
    guided = _guided(job, pair, points) if job.guides_itself else None
    return TileResult(
        job.id,
        "matched" if len(points) else "empty",
        points.shifted(*_origins(job)),
        candidates.counts,
        None,
        time.perf_counter() - begun,
        guided,
        candidates.lost.shifted(_origins(job)[0]),
    )


def rematch_tile(job: TileJob, points: TiePoints, guide: FieldGuide) -> TileResult:
    """Second pass of a tile: its consistent points again, guided by the displacement field."""
    begun = time.perf_counter()
    try:
        stacks = _KEPT.take(job.scene, job.id) or _stacks(job)
    except InputError as error:
        return TileResult(job.id, "failed", points, {}, str(error), time.perf_counter() - begun)
    if stacks is None:
        return TileResult(job.id, "empty", points, {}, "no valid pixels", time.perf_counter() - begun)
    reference_origin, target_origin = _origins(job)
    inside = points.shifted(-reference_origin, -target_origin)
    # shifts inside the arrays leave out the offset between the two windows
    between = target_origin - reference_origin
    again = rematch(stacks, inside, guide.moved(-between), job.settings)
    moved = again.shifted(reference_origin, target_origin)
    return TileResult(job.id, "matched", moved, {}, None, time.perf_counter() - begun)


def _guided(job: TileJob, pair: PreparedPair, points: TiePoints) -> Guided:
    reference_origin, target_origin = _origins(job)
    # in pixels of the views: which points agree must not depend on where the tile begins
    seen = points.shifted(reference_origin, target_origin)
    index = np.flatnonzero(consistent_points(seen, job.settings))
    guide = guide_by_field(seen[index], job.settings)
    again = rematch(pair.stacks, points[index], guide.moved(reference_origin - target_origin), job.settings)
    moved = again.shifted(reference_origin, target_origin)
    return Guided(index, moved, guide.surface, guide.shared_variance_px2)


def _prepare(job: TileJob) -> PreparedPair | None:
    """Read and prepare the tile's window; None where a band shows nothing of it."""
    window, traits = job.read_window, TRAITS[job.settings.method]
    reference = job.reference.read(window)
    target = job.target.read(window.moved(job.target_offset_px[1], job.target_offset_px[0]))
    if not reference.valid.any() or not target.valid.any():
        return None
    return prepare(
        Image(reference.values, reference.valid, job.reference_scene.epsilon, job.reference_scene.noise),
        Image(target.values, target.valid, job.target_scene.epsilon, job.target_scene.noise),
        channels=traits.channels,
        halo_px=traits.halo_px,
    )


def _stacks(job: TileJob) -> StackPair | None:
    pair = _prepare(job)
    return None if pair is None else pair.stacks


def _origins(job: TileJob) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    reference = np.array([job.window.col, job.window.row], np.float64)
    return reference, reference + job.target_offset_px
