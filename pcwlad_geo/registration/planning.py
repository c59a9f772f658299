"""The plan of the matching: tiles that cover the scene, or small windows where it has structure.

Phase congruency costs the same for a lake as for a town. An overview shows which small windows have
structure in both bands, and are neither masked nor beyond the edge: for each place of a lattice the best one
is matched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

from pcwlad_geo.matching import AUTO_FEATURES, MatchSettings
from pcwlad_geo.matching.gaps import fill_smoothly, narrow_gaps
from pcwlad_geo.matching.kernels.library import fast_even
from pcwlad_geo.matching.keypoints import cell_side_px, contrast_weight
from pcwlad_geo.matching.rounds import in_rounds
from pcwlad_geo.matching.window import WINDOWS
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Patch, ViewPair, Window
from pcwlad_geo.registration.inputs import tiles_along
from pcwlad_geo.registration.starts.overviews import Overviews
from pcwlad_geo.registration.tiles import TileJob, TileResult
from pcwlad_geo.types import Float32, Float64, Index


@dataclass(frozen=True, slots=True)
class PlanParameters:
    """Numbers of the plan of a matching."""

    window_candidates: int = 20
    """Number of candidates at which a small window aims."""
    cells_across: int = 2
    """Number of cells of candidates across a small window."""
    least_core_px: int = 80
    """Least side of the core of a small window."""
    least_valid: float = 0.75
    """Least share of a window, including the margin for the matching, that must be valid in both bands, or
    in narrow gaps."""
    least_texture: float = 0.05
    """Least share of a window that must have more than faint contrast in both bands."""
    centre_preference: float = 0.3
    """Share of its score that a window in the corner of its place loses, so that the points are well
    spread."""
    feature_area_px: int = 1024
    """Side of the square over which `features` candidates are spread, or the scene if that is smaller."""
    point_candidates: float = 1.25
    """Number of candidates for each tie point wanted."""
    poor_share: float = 1 / 3
    """A small window in which a smaller share of the candidates agrees is followed by another."""
    enough_share: float = 0.95
    """Share of the tie points wanted that is enough to end the matching."""
    all_points_tile_px: int = 640
    """Largest side of a tile where all points are matched, which keeps two processes below 1 GB of
    memory."""


def lattice_shape(
    region: Window, candidates: int, parameters: PlanParameters = PlanParameters()
) -> tuple[int, int]:
    """Return the numbers of rows and columns of places into which `region` is divided for `candidates`."""
    count = max(64, round(candidates / parameters.window_candidates))
    rows = max(1, round(np.sqrt(count * region.rows / region.cols)))
    return rows, int(np.ceil(count / rows))


def lattice_places(
    region: Window, candidates: int, parameters: PlanParameters = PlanParameters()
) -> list[Window]:
    """Return the places into which `region` is divided for so many `candidates`, row by row."""
    shape = lattice_shape(region, candidates, parameters=parameters)
    return [_place(region, shape, row, col) for row in range(shape[0]) for col in range(shape[1])]


def small_window(
    base: TileJob, candidates: int, wanted: int, parameters: PlanParameters = PlanParameters()
) -> TileJob:
    """Return a small window in the corner of the region whose core consists of whole cells of candidates.

    All windows have so many `candidates` together, of which tie points are `wanted`: those beyond that
    replace others that fail.
    """
    rows, cols = lattice_shape(base.region, candidates, parameters=parameters)
    around = replace(base, core=Window(0, 0, 0, 0)).read_window.rows
    cell = (fast_even(around + parameters.least_core_px) - around) // parameters.cells_across
    cells = rows * cols * parameters.cells_across**2
    per_cell = int(np.ceil(candidates / cells))
    settings = replace(
        base.settings,
        features=per_cell * parameters.cells_across**2,
        per_cell=per_cell,
        spare=max(0, per_cell - int(np.ceil(wanted / cells))),
        features_area_px2=float((parameters.cells_across * cell) ** 2),
    )
    core = Window(
        base.region.row, base.region.col, parameters.cells_across * cell, parameters.cells_across * cell
    )
    return replace(base, settings=settings, core=core)


def find_sites(
    window: TileJob, overviews: Overviews, candidates: int, parameters: PlanParameters = PlanParameters()
) -> tuple[tuple[TileJob, ...], ...]:
    """Return, for every place of the lattice, the windows that show structure, best first.

    The window is one of `small_window`; all first windows have so many `candidates` together.
    """
    region = window.region
    texture, valid = _merged(window, overviews)
    step = window.core.rows // parameters.cells_across
    sites: list[tuple[TileJob, ...]] = []
    count = 0
    for place in lattice_places(region, candidates, parameters=parameters):
        windows = _best_windows(place, window, step, texture, valid, overviews.factor, parameters)
        sites.append(tuple(replace(window, id=count + k, core=core) for k, core in enumerate(windows)))
        count += len(windows)
    return tuple(sites)


def _place(region: Window, shape: tuple[int, int], row: int, col: int) -> Window:
    edges = [
        np.linspace(0, length, count + 1).round().astype(int)
        for length, count in zip(region.shape, shape, strict=True)
    ]
    return Window.from_bounds(
        region.row + int(edges[0][row]),
        region.col + int(edges[1][col]),
        region.row + int(edges[0][row + 1]),
        region.col + int(edges[1][col + 1]),
    )


def _best_windows(
    place: Window,
    window: TileJob,
    step: int,
    texture: Float64,
    valid: Float64,
    factor: float,
    parameters: PlanParameters,
) -> list[Window]:
    """Return the windows of a place in the order of their score; they do not share pixels."""
    side, region = window.core.rows, window.region
    reach = (window.window.rows - side) // 2
    # cores begin where cells of the scene's lattice begin, so that no cell reaches beyond its core
    rows = _starts(place.row - region.row, place.rows, side, step) + region.row
    cols = _starts(place.col - region.col, place.cols, side, step) + region.col
    corners = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
    middle = corners + side / 2
    off_centre = np.abs((middle - [place.row, place.col]) / place.shape - 0.5).max(axis=1) * 2
    valid_share = _mean_in(valid, corners - reach, side + 2 * reach, factor)
    score = _mean_in(texture, corners, side, factor)
    good = (valid_share >= parameters.least_valid) & (score >= parameters.least_texture)
    score = score * valid_share * (1 - parameters.centre_preference * off_centre)
    selection: list[int] = []
    for index in np.argsort(-np.where(good, score, -np.inf), kind="stable"):
        separate = all(np.abs(corners[index] - corners[other]).max() >= side for other in selection)
        if good[index] and separate:
            selection.append(int(index))
        if len(selection) == 4:  # the first choice and those that may follow it
            break
    return [Window(int(corners[k, 0]), int(corners[k, 1]), side, side) for k in selection]


def _starts(begin: int, length: int, side: int, step: int) -> Index:
    """Return the multiples of the step at which cores lie within a range, or begin in it if it is narrow."""
    first, last = -(-begin // step), (begin + max(length - side, step - 1)) // step
    return np.arange(first, max(first, last) + 1) * step


def _merged(window: TileJob, overviews: Overviews) -> tuple[Float64, Float64]:
    """Return integral images of the texture of both bands and of what counts, on an overview."""
    scenes = (window.reference_scene, window.target_scene)
    textures, valids = [], []
    for patch, scene in zip((overviews.reference, overviews.target), scenes, strict=True):
        textures.append(texture_of(patch, scene.epsilon))
        counts = patch.valid | narrow_gaps(patch.valid, overviews.factor)
        valids.append(counts.astype(np.float32))
    shape = textures[0].shape
    offset = np.round(np.asarray(window.target_offset_px) / overviews.factor).astype(int)
    textures[1], valids[1] = (_moved(plane, offset, shape) for plane in (textures[1], valids[1]))
    merged = np.minimum(*textures), np.minimum(*valids)
    texture, valid = (np.asarray(cv2.integral(plane, sdepth=cv2.CV_64F), np.float64) for plane in merged)
    return texture, valid


def texture_of(patch: Patch, epsilon: float) -> Float32:
    """Return the (rows, cols) float32 contrast weight of `patch`, 0 to 1, for the scene's `epsilon`."""
    filled = fill_smoothly(np.where(patch.valid, patch.values, 0), patch.valid)
    return contrast_weight(filled, epsilon) * patch.valid


def _moved(plane: Float32, offset_xy: Index, shape: tuple[int, ...]) -> Float32:
    """Return result[r, c] = plane[r + offset, c + offset], 0 outside."""
    result = np.zeros(shape, np.float32)
    col, row = offset_xy.tolist()
    rows = slice(max(0, -row), max(0, min(shape[0], plane.shape[0] - row)))
    cols = slice(max(0, -col), max(0, min(shape[1], plane.shape[1] - col)))
    if rows.stop > rows.start and cols.stop > cols.start:
        result[rows, cols] = plane[rows.start + row : rows.stop + row, cols.start + col : cols.stop + col]
    return result


def _mean_in(integral: Float64, corners_rc: Index, side: int, factor: float) -> Float64:
    """Return the mean of a plane over squares given in view px; pixels outside count as 0."""
    limits = np.array(integral.shape) - 1
    begin, end = corners_rc / factor, (corners_rc + side) / factor
    first = np.clip(np.round(begin), 0, limits).astype(np.intp)
    last = np.clip(np.maximum(np.round(end), np.round(begin) + 1), 0, limits).astype(np.intp)
    total = (
        integral[last[:, 0], last[:, 1]]
        - integral[first[:, 0], last[:, 1]]
        - integral[last[:, 0], first[:, 1]]
        + integral[first[:, 0], first[:, 1]]
    )
    area = np.maximum(np.round(end) - np.round(begin), 1).prod(axis=1)
    return np.asarray(total / area)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The tiles to match first, and the windows that may follow."""

    first: list[TileJob]
    wanted: int | None = None
    """Number of tie points wanted from small windows; None if the tiles cover the scene."""
    sites: tuple[tuple[TileJob, ...], ...] = ()
    """Small windows: one tuple for each place of the lattice, the best window first."""
    without_structure: tuple[Window, ...] = ()
    """Places of the lattice that show no structure, so that they have no window."""
    parameters: PlanParameters = PlanParameters()

    def following(self, results: Sequence[TileResult]) -> list[TileJob]:
        """Return the windows to match next, given all results so far.

        A window with few points is followed by the next of its place. If that cannot be enough, the places
        with most points get another window.
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
            if upcoming and most < self.parameters.poor_share * upcoming[0].settings.candidates:
                poor.append(upcoming[0])
            elif upcoming:
                rich.append((most, upcoming[0]))
        missing = self.parameters.enough_share * self.wanted - sum(gave.values())
        windows = max(0, int(np.ceil(missing / np.median(good))) - len(poor))
        rich.sort(key=lambda entry: (-entry[0], entry[1].id))
        return poor + [job for _, job in rich[:windows]]


def agreeing(result: TileResult) -> int:
    """Return the number of points of a small window whose displacements agree."""
    displacement_px = result.points.displacement_px
    if len(displacement_px) == 0:
        return 0
    return int((np.linalg.norm(displacement_px - np.median(displacement_px, axis=0), axis=1) < 1.0).sum())


def plan(
    pair: ViewPair,
    overviews: Overviews,
    target_offset_px: tuple[int, int],
    matching: MatchSettings,
    settings: Settings,
    parameters: PlanParameters = PlanParameters(),
) -> Plan:
    """Decide which windows of the overlap are matched.

    A scene of one tile is matched whole, as is one of which all points are wanted; where they are wanted
    dense, with one candidate of every square of a quarter of a window. Otherwise as many candidates as the
    points need are spread over tiles that cover the scene, or over small windows, whichever has fewer pixels
    to filter. The `target_offset_px` (col, row) leads from reference view to target view, pre-alignment
    included. The usable area is `features_area_px2` of `matching`, whose number and spread of candidates the
    plan replaces; `points`, `features` and `tile_size` are those of `settings`.
    """
    region = common_region(pair, target_offset_px)
    area = matching.features_area_px2 or float(max(region.area_px2, 1))
    one_tile = tiles_along(max(region.shape), settings.tile_size) == 1
    matching = in_rounds(matching, area) if one_tile else replace(matching, features=matching.candidates)
    if matching.window.is_open and not one_tile:  # tiles and small windows would have to reach farther
        matching = replace(matching, window=replace(matching.window, others_px=WINDOWS.others_px))
    base = TileJob(
        0, pair.reference, pair.target, region, region, target_offset_px, *overviews.scenes, matching
    )
    wanted = 1000 if settings.points is None else settings.points
    candidates = parameters.point_candidates * wanted if isinstance(wanted, int) else np.inf
    densest = (settings.features or AUTO_FEATURES) / min(area, parameters.feature_area_px**2)
    if wanted == "dense":
        base = replace(base, settings=replace(matching, per_cell=1))
        densest = (4 / matching.window.side_px) ** 2  # four along the side of a window
    if one_tile:
        return Plan(_cover(base, densest, settings.tile_size))
    if candidates >= densest * area:
        return Plan(_cover(base, densest, min(settings.tile_size, parameters.all_points_tile_px)))
    tiles = _cover(base, candidates / area, settings.tile_size)
    window = small_window(base, round(candidates), int(wanted), parameters=parameters)
    count = int(np.prod(lattice_shape(region, round(candidates), parameters=parameters)))
    if count * window.read_window.area_px2 >= sum(job.read_window.area_px2 for job in tiles):
        return Plan(tiles)
    sites = find_sites(window, overviews, round(candidates), parameters=parameters)
    places = lattice_places(region, round(candidates), parameters=parameters)
    without_structure = tuple(place for place, site in zip(places, sites, strict=True) if not site)
    return Plan([site[0] for site in sites if site], int(wanted), sites, without_structure, parameters)


def common_region(pair: ViewPair, target_offset_px: tuple[int, int]) -> Window:
    """Return the part of the reference view of `pair` that the target view covers at `target_offset_px`."""
    col, row = target_offset_px
    return Window.whole(pair.target.grid.shape).moved(-row, -col).clipped(pair.reference.grid.shape)


def farthest_px(pair: ViewPair, target_offset_px: tuple[int, int]) -> int:
    """Return the largest displacement, px, from `target_offset_px` where the views of `pair` still touch."""
    rows_cols = zip(pair.reference.grid.shape, pair.target.grid.shape, target_offset_px[::-1], strict=True)
    return max(1, *(max(reference + shift, target - shift) for reference, target, shift in rows_cols))


def _cover(base: TileJob, density: float, tile_size: int) -> list[TileJob]:
    """Cover the region with tiles of a given density of candidates, 1/px²."""
    settings = replace(base.settings, features_area_px2=base.settings.candidates / density)
    margin = cell_side_px(settings.candidates, settings.per_cell, settings.candidates / density)
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
