"""Tiles: the tasks that each match a part of the scene, their input and their results."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final, Literal

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Warned
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.matching.field import Surface, predict
from pcwlad_geo.matching.guidance import FieldGuide, Lost, Scales
from pcwlad_geo.matching.kernels.compiled import can_be_cached, is_cached
from pcwlad_geo.matching.kernels.local_surfaces import fit_surfaces
from pcwlad_geo.matching.kernels.phase_congruency import combine_orientations, combine_scales, filter_rows
from pcwlad_geo.matching.kernels.refinement import PARTS, compile_refinement, refine_points
from pcwlad_geo.matching.keypoints import Candidates
from pcwlad_geo.matching.maps import maximum_moment, oriented_phase_congruency
from pcwlad_geo.matching.matcher import (
    Core,
    displacement_by_stripes,
    displacement_by_surroundings,
    displacement_by_windows,
    margin_px,
    match_arrays,
    match_candidates,
    rematch_with,
    try_again,
)
from pcwlad_geo.matching.prepare import ChannelPair, Image, Noise, PreparedPair, prepare
from pcwlad_geo.matching.refinement import ChannelMaps
from pcwlad_geo.matching.types import TRAITS, MatchSettings, Method, TiePoints
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.view import View
from pcwlad_geo.types import Float64, Index

MAX_BYTES: Final = 240 << 20
"""Largest size of the maps that a worker's tile cache holds."""
INTERPOLATED: Final = 4
"""Size of a pair with all that interpolates its maps, in sizes of the maps."""


@dataclass(slots=True)
class TileCache:
    """Cache of the prepared pairs of one scene by tile; pairs that would exceed the limit are not stored."""

    most_bytes: int = MAX_BYTES
    _scene: Hashable = None
    _pairs: dict[int, tuple[int, ChannelPair]] = field(default_factory=dict)
    """Size in bytes and pair of each tile."""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def keep(self, scene: Hashable, tile: int, pair: ChannelPair) -> None:
        """Store the `pair` of `tile` if there is room, and remove those of any other `scene`.

        What interpolates its maps is kept too where there is room for it; else it is computed again.
        """
        images = pair.reference, pair.target
        size = sum(image.maps.nbytes + image.valid.nbytes for image in images)
        with self._lock:
            if scene != self._scene:
                self._scene = scene
                self._pairs.clear()
            room = self.most_bytes - sum(kept for kept, _ in self._pairs.values())
            if INTERPOLATED * size <= room:
                self._pairs[tile] = INTERPOLATED * size, pair
            elif size <= room:
                reference, target = (ChannelMaps(image.maps, image.valid) for image in images)
                self._pairs[tile] = size, ChannelPair(reference, target, pair.threads)

    def take(self, scene: Hashable, tile: int) -> ChannelPair | None:
        """Return the pair of `tile` of `scene` and remove it; None if it is not stored."""
        with self._lock:
            _, pair = self._pairs.pop(tile, (0, None)) if scene == self._scene else (0, None)
        return pair


_CACHE = TileCache()


@dataclass(frozen=True, slots=True)
class Scene:
    """Properties of a band that all its tiles have in common, measured once."""

    epsilon: float
    """ε of the phase congruency, see `maps.scene_epsilon`."""
    noise: Noise
    """Noise of the band."""


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
    returns: bool = False
    """Whether the second pass goes to the same worker, which caches the maps if it can."""
    cell_margin_px: int = 0
    """Largest distance by which a cell of candidates that begins in the core extends beyond it."""

    @property
    def scene(self) -> tuple[View, View, tuple[int, int], Window, MatchSettings]:
        """What identifies the tiles of one scene and start, beside their number."""
        return self.reference, self.target, self.target_offset_px, self.region, self.settings

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
    if job.returns and len(points):
        _CACHE.keep(job.scene, job.id, pair.channels)
    return TileResult(
        job.id,
        "matched" if len(points) else "empty",
        points.shifted(*_origins(job)),
        candidates.counts,
        None,
        candidates.lost.shifted(_origins(job)[0]),
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
    reference_origin, target_origin = _origins(job)
    inside = points.shifted(-reference_origin, -target_origin)
    # shifts inside the arrays do not include the offset between the two windows
    between = target_origin - reference_origin
    again = rematch_with(channels, inside, guide.moved(-between), job.settings, scales)
    result = TileResult(job.id, "matched", again.shifted(reference_origin, target_origin), {}, None)
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


def compare_stripes(job: TileJob, points: TiePoints, guide: FieldGuide) -> Float64:
    """Return (2, n, 2) what `compare_windows` does, by windows of few rows, then of few columns."""
    return _compared(job, points, guide, displacement_by_stripes, 2)


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
    if job.returns:
        _CACHE.keep(job.scene, job.id, channels)
    reference_origin, target_origin = _origins(job)
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
        Image(reference.values, reference.valid, job.reference_scene.epsilon, job.reference_scene.noise),
        Image(target.values, target.valid, job.target_scene.epsilon, job.target_scene.noise),
        channels=traits.channels,
        halo_px=traits.halo_px,
        threads=job.threads,
    )


def _stacks(job: TileJob) -> ChannelPair | None:
    pair = _prepare(job)
    return None if pair is None else pair.channels


def _origins(job: TileJob) -> tuple[Float64, Float64]:
    reference = np.array([job.window.col, job.window.row], np.float64)
    return reference, reference + job.target_offset_px


COMPILED_ONCE: Final = "first start: the inner loops are compiled now, which takes some seconds, once"
"""Warning before kernels are compiled and cached on disk."""
COMPILED_ALWAYS: Final = (
    "the inner loops are compiled at every start, which takes some ten seconds, as there is no folder "
    "to keep them in: set NUMBA_CACHE_DIR to one that can be written"
)
"""Warning before kernels are compiled that cannot be cached on disk."""


def load_kernels(method: Method, runner: Runner, on_event: EventCallback) -> None:
    """Have the workers load the kernels of a method, after they have compiled those not on disk.

    They share the kernels to compile, as threads of one process cannot. `on_event` receives a warning before
    anything is compiled, and the progress of that.
    """
    if not kernels_are_cached(method):
        kept = kernels_can_be_cached(method)
        on_event(Warned(COMPILED_ONCE if kept else COMPILED_ALWAYS))
        if kept:
            calls = [(method, number) for number in range(len(_compilations(method)))]
            runner.run(compile_some, calls, "compiling", on_event)
        compile_kernels(method)
    runner.prepare(compile_kernels, (method,))


def compile_some(method: Method, number: int) -> None:
    """Compile one share of the kernels of a method, or load it."""
    _compilations(method)[number]()


def _compilations(method: Method) -> list[Callable[[], object]]:
    """Return what compiles the kernels of a method, the longest first."""
    parts = [part.__wrapper_address__ for part in PARTS]
    phase = [] if TRAITS[method].channels == "gradients" else [_compile_phase_congruency]
    return [compile_refinement, *parts, load_own_kernel, *phase]


def _compile_phase_congruency() -> None:
    maximum_moment(oriented_phase_congruency(_blobs(0.0).astype(np.float32), 1.0))


def load_own_kernel() -> None:
    """Load the kernel that this process itself calls between the passes, while the workers match."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 0.0], [0.0, 2.0]])
    predict(corners, corners, corners[:1], Surface(6, 1))


SIDE_PX: Final = 128
"""Side of the synthetic images that are matched to compile the kernels."""
WINDOW_PX: Final = 21
"""Side of the template and of the refinement window in that match."""
POINTS: Final = 60
"""Candidates in that match, enough for a displacement field to be fitted to the tie points."""


def kernels_are_cached(method: Method) -> bool:
    """Return whether all kernels of a method are in the cache on disk, so that starting is quick."""
    return all(is_cached(kernel) for kernel in kernels_of(method))


def kernels_can_be_cached(method: Method) -> bool:
    """Tell whether the kernels of a method are kept on disk once they are compiled."""
    return all(can_be_cached(kernel) for kernel in kernels_of(method))


def kernels_of(method: Method) -> tuple[Callable[..., Any], ...]:
    """Return the kernels that a method may call."""
    always = (refine_points, *(part.kernel for part in PARTS), fit_surfaces)
    phase = (filter_rows, combine_scales, combine_orientations)
    return always if TRAITS[method].channels == "gradients" else always + phase


def compile_kernels(method: Method) -> None:
    """Match a small pair of images, so that every kernel of the method is compiled or loaded.

    Parameters
    ----------
    method : str
        Matching method.
    """
    settings = MatchSettings(
        method=method,
        template=WINDOW_PX,
        window=WINDOW_PX,
        features=POINTS,
        search_radius=3,
        consensus="auto",
    )
    match_arrays(_blobs(0.0), _blobs(0.4), settings=settings)


def _blobs(shift_px: float) -> Float64:
    """Return an image with corners everywhere."""
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX] + shift_px
    wave = np.sin(0.031 * row * col) + np.sin(0.4 * row + 0.1 * col) * np.cos(0.5 * col)
    return np.asarray(np.tanh(2 * wave))
