"""Tiles: the tasks that each match a part of the scene, their input and their results."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final, Literal

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import (
    Candidates,
    FieldGuide,
    Image,
    MatchSettings,
    Scales,
    TiePoints,
    match_candidates,
    rematch_with,
)
from pcwlad_geo.matching.first_pass import Core, margin_px
from pcwlad_geo.matching.grey_values import Tones
from pcwlad_geo.matching.jitter import displacement_by_stripes
from pcwlad_geo.matching.local_correlation import displacement_by_surroundings
from pcwlad_geo.matching.lost_candidates import Lost, try_again
from pcwlad_geo.matching.noise import Noise
from pcwlad_geo.matching.prepare import ChannelPair, PreparedPair, prepare
from pcwlad_geo.matching.second_pass import displacement_by_windows
from pcwlad_geo.matching.types import TRAITS
from pcwlad_geo.raster import Patch, View, Window
from pcwlad_geo.types import Float64, Index

INTERPOLATED: Final = 4
"""Size of a pair with all that interpolates its maps, in sizes of the maps."""


@dataclass(slots=True)
class TileCache:
    """Cache of the prepared pairs of one scene by tile; pairs that would exceed the limit are not stored."""

    _scene: Hashable = None
    _pairs: dict[int, tuple[int, ChannelPair]] = field(default_factory=dict)
    """Size in bytes and pair of each tile."""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def keep(
        self, scene: Hashable, tile: int, pair: ChannelPair, most_bytes: int, *, alone: bool = False
    ) -> None:
        """Store the `pair` of `tile` if there is room in `most_bytes`, and remove those of any other `scene`.

        What interpolates the maps is kept too while there is room for all pairs with it: it is computed again
        sooner than the maps.
        There is always room for the tile of a scene that has no other, as the peak of the memory is its own.
        """
        with self._lock:
            if scene != self._scene:
                self._scene = scene
                self._pairs.clear()
            self._pairs[tile] = INTERPOLATED * _size(pair), pair
            if alone:
                return
            if not self._fits(most_bytes):
                plain = {number: _maps_alone(maps) for number, (_, maps) in self._pairs.items()}
                self._pairs = {number: (_size(maps), maps) for number, maps in plain.items()}
            if not self._fits(most_bytes):
                del self._pairs[tile]

    def _fits(self, most_bytes: int) -> bool:
        return sum(size for size, _ in self._pairs.values()) <= most_bytes

    def clear(self) -> None:
        """Remove all pairs."""
        with self._lock:
            self._pairs.clear()

    def take(self, scene: Hashable, tile: int) -> ChannelPair | None:
        """Return the pair of `tile` of `scene` and remove it; None if it is not stored."""
        with self._lock:
            _, pair = self._pairs.pop(tile, (0, None)) if scene == self._scene else (0, None)
        return pair


def _size(pair: ChannelPair) -> int:
    """Return the size of the maps of a pair in bytes."""
    return sum(image.maps.nbytes + image.valid.nbytes for image in (pair.reference, pair.target))


def _maps_alone(pair: ChannelPair) -> ChannelPair:
    """Return a pair without what interpolates its maps."""
    reference, target = (replace(image) for image in (pair.reference, pair.target))
    return ChannelPair(reference, target, pair.threads)


KEPT_BYTES: Final = 120 << 20
"""Size of the maps that are kept for a second pass, for each tile that is matched at a time."""
_CACHE = TileCache()


def forget_tiles() -> None:
    """Free the maps that are kept for a second pass."""
    _CACHE.clear()


@dataclass(frozen=True, slots=True)
class Scene:
    """Properties of a band that all its tiles have in common, measured once."""

    epsilon: float
    """ε of the phase congruency, see `maps.scene_epsilon`."""
    noise: Noise
    """Noise of the band."""
    tones: Tones | None = None
    """What its grey values are matched by; None where structure is."""

    def image(self, patch: Patch) -> Image:
        """Return a part of the band with these properties."""
        return Image(patch.values, patch.valid, self.epsilon, self.noise, self.tones)


@dataclass(frozen=True, slots=True)
class TileJob:
    """The task of matching a tile: small and picklable, without arrays and open files."""

    id: int
    reference: View
    target: View
    region: Window
    """Window that all tiles cover together; the lattice of the cells of corners begins at its first pixel."""
    core: Window
    """Part of the reference view whose corners are matched."""
    target_offset_px: tuple[int, int]
    """(col, row): target-view px at the start of the search minus reference-view px."""
    reference_scene: Scene
    target_scene: Scene
    settings: MatchSettings
    threads: int = 1
    """Number of threads that the tile may use."""
    kept_bytes: int = 0
    """Size of the maps that all tiles together may keep for the second pass; 0 where it runs elsewhere."""
    cell_margin_px: int = 0
    """Largest distance by which a cell of candidates that begins in the core extends beyond it."""

    @property
    def scene(self) -> Hashable:
        """What identifies the tiles of one scene and start, beside their number."""
        tones = self.reference_scene.tones, self.target_scene.tones
        return self.reference, self.target, self.target_offset_px, self.region, self.settings, tones

    @property
    def window(self) -> Window:
        """The part of the reference view whose maps are needed."""
        return self.core.padded(margin_px(self.settings) + self.cell_margin_px)

    @property
    def read_window(self) -> Window:
        """The part of the reference view that is read, including the halo of the filters."""
        return self.window.padded(TRAITS[self.settings.method].halo_px)


@dataclass(frozen=True, slots=True, eq=False)
class TileResult:
    """The result of a tile, in pixel coordinates of the two views."""

    id: int
    status: Literal["matched", "empty", "failed"]
    points: TiePoints
    """Points each matched independently, or the second pass of given points."""
    counts: dict[str, int]
    reason: str | None
    lost: Candidates = field(default_factory=Candidates.empty)
    """Candidates of the first pass without a match, reference-view px."""
    saved: TiePoints = field(default_factory=TiePoints.empty)
    """Candidates that the second pass found a match for."""
    saved_from: Index = field(default_factory=lambda: np.zeros(0, np.intp))
    """Which of those that it tried they are."""
    first_only: bool = False
    """Whether the first candidates agreed, so that no others were searched."""


def match_tile(job: TileJob) -> TileResult:
    """Run the first pass of a tile."""
    try:
        pair = _prepare(job)
    except InputError as error:
        return TileResult(job.id, "failed", TiePoints.empty(), {}, str(error))
    if pair is None:
        return TileResult(job.id, "empty", TiePoints.empty(), {}, "no valid pixels")
    window, core = job.window, job.core
    inside = Core(
        core.row - window.row,
        core.col - window.col,
        core.row_stop - window.row,
        core.col_stop - window.col,
        (window.row - job.region.row, window.col - job.region.col),
    )
    points, candidates = match_candidates(pair, inside, job.settings)
    if job.kept_bytes and len(points):
        _CACHE.keep(job.scene, job.id, pair.channels, job.kept_bytes, alone=job.core == job.region)
    return TileResult(
        job.id,
        "matched" if len(points) else "empty",
        points.shifted(*origins_of(job)),
        candidates.counts,
        None,
        candidates.lost.shifted(origins_of(job)[0]),
        first_only=not candidates.are_all,
    )


def rematch_tile(
    job: TileJob, points: TiePoints, guide: FieldGuide, scales: Scales, lost: Lost | None = None
) -> TileResult:
    """Run the second pass of the tile `job`: match its consistent `points` again, with their `guide`.

    The windows of `scales` are some of the settings. The candidates `lost` are tried once more.
    """
    try:
        channels = _CACHE.take(job.scene, job.id) or _stacks(job)
    except InputError as error:
        return TileResult(job.id, "failed", points, {}, str(error))
    if channels is None:
        return TileResult(job.id, "empty", points, {}, "no valid pixels")
    reference_origin, target_origin = origins_of(job)
    inside = points.shifted(-reference_origin, -target_origin)
    # shifts inside the arrays do not include the offset between the two windows
    between = target_origin - reference_origin
    refined = rematch_with(channels, inside, guide.moved(-between), job.settings, scales)
    result = TileResult(job.id, "matched", refined.shifted(reference_origin, target_origin), {}, None)
    if lost is None or not len(lost.limit_px):
        return result
    saved, index = try_again(channels, lost.moved(-reference_origin, -target_origin), job.settings, scales)
    return replace(result, saved=saved.shifted(reference_origin, target_origin), saved_from=index)


def compare_windows(job: TileJob, points: TiePoints, guide: FieldGuide, windows_px: Sequence[int]) -> Float64:
    """Return (k, n, 2) the displacements (col, row) of `points` of the tile `job` by each of k windows.

    The other parameters are those of `rematch_tile`, which may follow. NaN where a window gives no match.
    """
    see = partial(displacement_by_windows, settings=job.settings, windows_px=windows_px)
    return _compared(job, points, guide, see, len(windows_px))


def compare_stripes(job: TileJob, points: TiePoints, guide: FieldGuide, beside_px: Sequence[int]) -> Float64:
    """Return (2k, n, 2) what `compare_windows` does, by windows of few rows, then of few columns."""
    see = partial(displacement_by_stripes, beside_px=beside_px)
    return _compared(job, points, guide, see, 2 * len(beside_px))


def compare_surroundings(job: TileJob, points: TiePoints, guide: FieldGuide, other_px: Float64) -> Float64:
    """Return (1, n, 2) what `matcher.displacement_by_surroundings` does for `points` of the tile `job`.

    The (2,) `other_px` (col, row) is the displacement beside their own that is tried.
    """
    return _compared(job, points, guide, partial(displacement_by_surroundings, other_px=other_px), 1)


def _compared(
    job: TileJob, points: TiePoints, guide: FieldGuide, see: Callable[..., Float64], windows: int
) -> Float64:
    nothing = np.full((windows, len(points), 2), np.nan)
    try:
        channels = _CACHE.take(job.scene, job.id) or _stacks(job)
    except InputError:
        return nothing
    if channels is None:
        return nothing
    if job.kept_bytes:
        _CACHE.keep(job.scene, job.id, channels, job.kept_bytes, alone=job.core == job.region)
    reference_origin, target_origin = origins_of(job)
    between = target_origin - reference_origin
    inside = points.shifted(-reference_origin, -target_origin)
    return see(channels, inside, guide.moved(-between)) + between


def _prepare(job: TileJob) -> PreparedPair | None:
    """Read and prepare the tile's window; None if a band has no valid pixel there."""
    window, traits = job.read_window, TRAITS[job.settings.method]
    reference = job.reference.read(window)
    target = job.target.read(window.moved(job.target_offset_px[1], job.target_offset_px[0]))
    if not reference.valid.any() or not target.valid.any():
        return None
    return prepare(
        replace(job.reference_scene.image(reference), masked=job.reference.info.mask_uri is not None),
        replace(job.target_scene.image(target), masked=job.target.info.mask_uri is not None),
        channels=traits.channels,
        halo_px=traits.halo_px,
        threads=job.threads,
    )


def _stacks(job: TileJob) -> ChannelPair | None:
    pair = _prepare(job)
    return None if pair is None else pair.channels


def origins_of(job: TileJob) -> tuple[Float64, Float64]:
    """Return the (2,) corners (col, row) of the arrays of a tile, reference and target view px."""
    reference = np.array([job.window.col, job.window.row], np.float64)
    return reference, reference + job.target_offset_px
