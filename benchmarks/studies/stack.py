"""Many images of one ground: a synthetic stack of exact truth, with wrong pairs among the right ones."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
from scipy import ndimage

from benchmarks.runs import Array, Runner
from benchmarks.tables import Cell, Table, at_least, at_most
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.execution.workers import open_runner
from pcwlad_geo.multi.stack.adjustment import Adjustment, adjust
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.pair_choice import additional_pairs, candidates, choose_pairs, read_overview
from pcwlad_geo.multi.stack.pairs import edges_of, measure
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, describe
from tests.scenes import make_grid, render, write

IMAGES: Final = 24
SHAPE: Final = (1024, 1024)
SENSORS: Final = (("red", 30.0), ("thermal", 30.0), ("red", 42.0))
"""Band and pixel size, metres."""
SEED: Final = 18
WRONG_SHARE: Final = 0.08
UNUSED_SHARE: Final = 0.1
SEASONS: Final = 4
NOISE_DN: Final = 2.0
CLOUD_SHARE: Final = 0.08
"""Of an image, roughly."""
RMSE_PX, CLOSURE_PX, BETTER, COVER_POINTS = 0.03, 0.02, 1.5, 8.0
NODES: Final = 9


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where an image truly lies: observed = linear · predicted + shift, px of the image."""

    linear: Array
    shift: Array

    def observed(self, at_px: Array) -> Array:
        """Map (n, 2) predicted to observed px of the image."""
        return np.asarray(at_px @ self.linear.T + self.shift)


def stack(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield how well every image of a synthetic stack is placed, which pairs are left out, and closure."""
    rng = np.random.default_rng(SEED)
    frame, truths = _images(scratch, rng)
    given = [frame.given(number) for number in range(IMAGES)]
    found = candidates(frame, given, [read_overview(info) for info in frame.infos])
    chosen = choose_pairs(found, IMAGES)
    with open_runner(None, _ignore, jobs=runner.processes) as pool:
        measured = list(measure(frame, chosen, scratch / "out", Settings(), False, _ignore, pool))
        edges = edges_of(measured)
        more = additional_pairs(frame, found, chosen, edges, adjust(edges, IMAGES))
        measured += measure(frame, more, scratch / "out", Settings(), False, _ignore, pool)
    edges = edges_of(measured)
    kept, unused = _set_apart(edges, rng)
    spoiled, wrong = _spoil(kept, rng)
    adjusted = adjust(spoiled, IMAGES)
    yield _placed(frame, truths, adjusted, spoiled, len(measured) - len(edges))
    yield _checked(adjusted, wrong, unused)
    yield _bands(data, scratch, runner)


def _ignore(_event: object) -> None:
    pass


def _images(scratch: Path, rng: np.random.Generator) -> tuple[StackFrame, list[Truth]]:
    names, truths = [f"image{number:02}" for number in range(IMAGES)], []
    infos = []
    for number, name in enumerate(names):
        band, pixel_m = SENSORS[number % len(SENSORS)]
        shape = tuple(round(side * 30.0 / pixel_m) for side in SHAPE)
        grid = make_grid((shape[0], shape[1]), pixel_m=pixel_m)
        linear = np.eye(2) + (rng.normal(0.0, 5e-4, (2, 2)) if number else 0.0)
        shift = rng.uniform(-5.0, 5.0, 2) if number else np.zeros(2)
        values = 0.85 * render(grid, band, linear=linear, displacement_px=shift, noise=0.0)
        season = 10 + number % SEASONS
        values += 0.15 * render(grid, band, seed=season, linear=linear, displacement_px=shift, noise=0.0)
        # of its own: a pattern that all images share would hold pairs that lie near each other in place
        values += np.random.default_rng([SEED, number]).normal(0.0, NOISE_DN, values.shape)
        cloudy = _clouds(values, rng)
        infos.append(describe(write(scratch / f"{name}.tif", cloudy, grid)))
        truths.append(Truth(linear, shift))
    return StackFrame(names, infos, infos[0].grid, True), truths


def _clouds(values: Array, rng: np.random.Generator) -> Array:
    """Put bright, soft clouds over a part of an image."""
    smooth = ndimage.gaussian_filter(rng.normal(size=values.shape), 18.0)
    veil = np.clip((smooth - np.quantile(smooth, 1 - CLOUD_SHARE)) / smooth.std() * 4, 0.0, 1.0)
    return np.asarray(values * (1 - veil) + 1.2 * float(values.max()) * veil)


def _bands(data: Path, scratch: Path, runner: Runner) -> Table:
    """Adjust three bands of Landsat 8 and the same of Sentinel-2, and look at pairs that took no part."""
    folder = data / "cross_sensor"
    files = [(folder / "landsat8_byte.tif", band, f"Landsat {name}") for band, name in LANDSAT]
    files += [(folder / "sentinel2_b432_byte.tif", band, f"Sentinel-2 {name}") for band, name in SENTINEL]
    inputs = tuple(StackInput(str(path), band, name) for path, band, name in files)
    infos = [given.describe() for given in inputs]
    frame = StackFrame([given.name for given in inputs], infos, infos[0].grid, True, inputs)
    chosen = list(combinations(range(len(inputs)), 2))
    with open_runner(None, _ignore, jobs=runner.processes) as pool:
        measured = list(measure(frame, chosen, scratch / "bands", Settings(), False, _ignore, pool))
    edges = edges_of(measured)
    left: list[Array] = []
    rows: list[list[Cell]] = []
    for turn in range(TURNS):  # each pair is set apart once
        apart = [edge for number, edge in enumerate(edges) if number % TURNS == turn]
        found = adjust([edge for number, edge in enumerate(edges) if number % TURNS != turn], len(inputs))
        for edge in apart:
            left.append(_misclosure(found, edge))
            names = f"{inputs[edge.first].name} - {inputs[edge.second].name}"
            rows.append([names, len(edge), *(f"{value:+.3f}" for value in left[-1])])
    closure = float(np.sqrt(np.square(left).sum(axis=1).mean()))
    checks = [at_most("closure of pairs that took no part, RMS", closure, BANDS_CLOSURE_PX, "px", 3)]
    title = f"Bands of Landsat 8 and Sentinel-2, {len(edges)} of {len(chosen)} pairs; px of 30 m"
    return Table(title, ("pair that took no part", "points", "left over x", "y"), rows, checks)


LANDSAT: Final = ((2, "blue"), (3, "green"), (4, "red"))
SENTINEL: Final = ((3, "blue"), (2, "green"), (1, "red"))
"""Number and colour of the bands of the files."""
TURNS: Final = 5
BANDS_CLOSURE_PX: Final = 0.05


def _misclosure(found: Adjustment, edge: Edge) -> Array:
    """Return the median (x, y) by which a pair lies off what an adjustment tells without it."""
    ground = found.to_ground(edge.first, edge.first_xy)
    told = found.displacement(edge.second, ground) - found.displacement(edge.first, ground)
    return np.asarray(np.median(edge.second_xy - edge.first_xy - told, axis=0))


def _set_apart(edges: Sequence[Edge], rng: np.random.Generator) -> tuple[list[Edge], list[Edge]]:
    """Return the pairs to adjust, and some that only check the result."""
    apart = set(rng.choice(len(edges), round(UNUSED_SHARE * len(edges)), replace=False).tolist())
    return (
        [edge for number, edge in enumerate(edges) if number not in apart],
        [edge for number, edge in enumerate(edges) if number in apart],
    )


def _spoil(edges: Sequence[Edge], rng: np.random.Generator) -> tuple[list[Edge], set[int]]:
    """Return the pairs, some of them moved as a whole by 1 to 8 px, and the numbers of those."""
    wrong = set(rng.choice(len(edges), round(WRONG_SHARE * len(edges)), replace=False).tolist())
    size, turn = rng.uniform(1.0, 8.0, len(edges)), rng.uniform(0.0, 2 * np.pi, len(edges))
    off = np.column_stack([size * np.cos(turn), size * np.sin(turn)])
    return [
        replace(edge, second_xy=edge.second_xy + off[number]) if number in wrong else edge
        for number, edge in enumerate(edges)
    ], wrong


def _placed(
    frame: StackFrame, truths: Sequence[Truth], found: Adjustment, edges: Sequence[Edge], refused: int
) -> Table:
    """Compare every image with the truth, and with the best single path of pairs in use."""
    good = [edge for edge, fit in zip(edges, found.edges, strict=True) if fit.in_use]
    paths = _paths(good)
    rows: list[list[Cell]] = []
    errors, chained, ratios = [], [], []
    for number, truth in enumerate(truths):
        if number == 0:
            continue
        grid: Grid = frame.infos[number].grid
        at_px = grid.lattice_px(NODES)
        ground, true = frame.from_image(number, at_px), frame.from_image(number, truth.observed(at_px))
        off = ground + found.displacement(number, ground) - true
        sigma = np.sqrt(np.diagonal(found.covariance(number, ground), axis1=1, axis2=2))
        along = ground
        for edge, forward in paths[number]:
            along = along + _of_edge(edge, forward, along)
        errors.append(float(np.sqrt((off**2).sum(axis=1).mean())))
        chained.append(float(np.sqrt(((along - true) ** 2).sum(axis=1).mean())))
        ratios.append(np.abs(off) / sigma)
        rows.append(
            [frame.names[number], errors[-1], chained[-1], float(np.sqrt((sigma**2).sum(axis=1).mean()))]
        )
    ratio = np.array(ratios)
    better = float(np.sqrt(np.mean(np.square(chained)) / np.mean(np.square(errors))))
    checks = [
        at_most("worst image, RMSE against the truth", max(errors), RMSE_PX, "px", 3),
        at_least("times better than the best single path", better, BETTER, "", 2),
        at_most(
            "share within sigma less 68 %", abs(100 * (ratio < 1).mean() - 68), COVER_POINTS, "points", 1
        ),
        at_most(
            "share within 1.96 sigma less 95 %",
            abs(100 * (ratio < 1.96).mean() - 95),
            COVER_POINTS,
            "points",
            1,
        ),
    ]
    title = f"{IMAGES} images, {len(edges)} pairs in the adjustment, {refused} refused; px of the frame"
    return Table(title, ("", "RMSE", "of a single path", "sigma"), rows, checks)


def _paths(edges: Sequence[Edge]) -> dict[int, list[tuple[Edge, bool]]]:
    """Return the shortest chain of pairs from the first image to each, and whether each is gone forwards."""
    paths: dict[int, list[tuple[Edge, bool]]] = {0: []}
    waiting = deque([0])
    while waiting:
        here = waiting.popleft()
        for edge in edges:
            for one, other, forward in ((edge.first, edge.second, True), (edge.second, edge.first, False)):
                if one == here and other not in paths:
                    paths[other] = [*paths[here], (edge, forward)]
                    waiting.append(other)
    return paths


def _of_edge(edge: Edge, forward: bool, xy: Array) -> Array:
    """Return the displacement that the affine through a pair's points adds along a chain."""
    ends = (edge.first_xy, edge.second_xy) if forward else (edge.second_xy, edge.first_xy)
    affine = AffineTransform.fit(*ends).rows
    return np.asarray(xy @ affine[:, :2].T + affine[:, 2] - xy)


def _checked(found: Adjustment, wrong: set[int], unused: Sequence[Edge]) -> Table:
    """Compare the pairs left out with those spoiled, and pairs that took no part with the result."""
    out = {number for number, fit in enumerate(found.edges) if not fit.in_use}
    left = [_misclosure(found, edge) for edge in unused]
    closure = float(np.sqrt(np.mean(np.square(left)) * 2))
    checks = [
        at_most("wrong pairs that were not found", len(wrong - out), 0, digits=0),
        at_most("right pairs that were left out", len(out - wrong), 0, digits=0),
        at_most("closure of pairs that took no part, RMS", closure, CLOSURE_PX, "px", 3),
    ]
    rows: list[list[Cell]] = [
        ["wrong pairs", len(wrong)],
        ["pairs left out", len(out)],
        ["pairs that took no part", len(unused)],
        ["error that the points of a pair share, in what its own blocks tell", f"{found.shared:.2f}"],
    ]
    return Table("Pairs", ("", ""), rows, checks)
