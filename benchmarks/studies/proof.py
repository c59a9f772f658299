"""Does `prove` tell the truth? What it tells of synthetic pairs beside the errors that they have.

The two images of the first twelve pairs show the same structure, by other grey values, noise and blur. Their
true errors are those of several pairs that differ in noise alone. What each errs by without noise, as a blur
moves what an edge beside another looks like, is in the match of the target as it lies and in that after a
move: `prove` cannot see it, so that it is taken out of the true errors, and the bound that is told must hold
it. In other pairs the structure of the target lies elsewhere by a mean of 0.05 px, which nothing can see
either.

Windows overlap, so that a pair has some twelve errors that are independent: the scatter of six pairs is known
to 6 %, what one proof tells of it to 5 %, and the share of the errors of one kind within their sigmas to 4 of
100. Shares are therefore checked on the errors of all twelve kinds together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks.pairs import write
from benchmarks.runs import Array, Runner
from benchmarks.tables import Cell, Check, Table, at_least, at_most, within
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import prove_pair, register_pair
from pcwlad_geo.tiepoints.table import TiePointTable
from tests.scenes import make_grid, render

SIDE_PX: Final = 640
NOISES: Final = 6
"""Pairs of a kind, each of other noise."""
SHIFT_XY_PX: Final = (0.35, -0.25)
WITHIN: Final = 0.15
"""Share by which figures may differ from the true ones."""
SHARED_PX: Final = 0.05
SETTINGS: Final = Settings(prealign="none", search_radius=10, model="shift")
GREY_LEVELS: Final = 200
"""Steps of a file for one of the scene."""


@dataclass(frozen=True, slots=True)
class Kind:
    """What a pair is like."""

    name: str
    target: Callable[[Array], Array]
    """From the values that both show to those of the target."""
    noise: float
    """Standard deviation, of values about 0 to 255."""
    band: str = "red"
    blur_px: float = 0.0
    """Sigma, the target only."""


def same(values: Array) -> Array:
    """Return the same values."""
    return values


def inverted(values: Array) -> Array:
    """Return dark for bright."""
    return 255 - values


def bent(values: Array) -> Array:
    """Return values bent as by a gamma."""
    return np.asarray(255 * (np.clip(values, 1, 254) / 255) ** 0.5)


KINDS: Final = tuple(
    Kind(f"{band}, {how.__name__}, noise {noise:g}, blur {blur:g}", how, noise, band, blur)
    for band, how, noise, blur in (
        ("red", same, 2.0, 0.0),
        ("red", inverted, 4.0, 0.0),
        ("red", bent, 6.0, 0.0),
        ("red", inverted, 8.0, 1.0),
        ("red", same, 4.0, 1.5),
        ("red", bent, 10.0, 0.0),
        ("thermal", same, 3.0, 0.0),
        ("thermal", inverted, 6.0, 0.0),
        ("thermal", bent, 4.0, 1.0),
        ("thermal", inverted, 2.0, 2.0),
        ("thermal", same, 8.0, 0.0),
        ("thermal", inverted, 12.0, 0.0),
    )
)
SHARED: Final = ("all of it by 0.05 px", "half of it by 0.1 px", "another band, by 0.05 px")


def proof(_data: Path, scratch: Path, _runner: Runner) -> Iterator[Table]:
    """Yield three tables."""
    rows: list[list[Cell]] = []
    held: list[list[Cell]] = []
    checks: list[Check] = []
    ratios = []
    for number, kind in enumerate(KINDS):
        told, tables, still = _both(kind, number, scratch)
        errors = [_errors(table, still) for table in tables]
        shared = float(np.hypot(*_errors(still).std(axis=0)))
        rows.append([kind.name, *_figures(told), *_true(errors), f"{shared:.4f}"])
        checks += _checks(kind.name, told, errors)
        what = f"{kind.name}: up to, of what is shared"
        checks.append(at_least(what, told.unobservable.up_to_px, shared, "px"))
        ratio = np.abs(np.concatenate(errors)) / np.concatenate([table.sigma_px for table in tables])
        ratios.append((ratio, ratio / told.sigma.factor))
        held.append([kind.name, *(f"{share:.1f}" for each in ratios[-1] for share in _shares(each))])
    header = ("pair", "told: bias x", "y", "scatter x", "y", "CE90", "true: bias x", "y", "scatter x", "y")
    title = "The tool's own error as told, and the true one, px"
    yield Table(title, (*header, "CE90", "shared"), rows, checks)
    together = [np.concatenate(each) for each in zip(*ratios, strict=True)]
    held.append(["all", *(f"{share:.1f}" for each in together for share in _shares(each))])
    one, two = _shares(together[1])
    names = ("pair", "68 %", "95 %", "68 % calibrated", "95 % calibrated")
    yield Table(
        "Share of the true errors within the sigmas, before and after the factor",
        names,
        held,
        [within("within sigma", one, 66, 70, "%"), within("within 1.96 sigma", two, 94, 96, "%")],
    )
    yield _shared(scratch)


def _both(kind: Kind, number: int, scratch: Path) -> tuple[Proof, list[TiePointTable], TiePointTable]:
    """Return what is told of the first of the pairs of a kind, the points of all, and those without noise."""
    grid = make_grid((SIDE_PX, SIDE_PX))
    seed = 300 + number
    images = [
        render(grid, kind.band, seed=seed, noise=0.0, displacement_px=moved)
        for moved in ((0, 0), SHIFT_XY_PX)
    ]
    images[1] = ndimage.gaussian_filter(kind.target(images[1]), kind.blur_px, mode="nearest")
    files = [_files(images, kind.noise, (number, noise), scratch) for noise in range(NOISES)]
    files.append(_files(images, 0.0, (number, NOISES), scratch))
    found = [register_pair(*pair, SETTINGS, match_only=True).tie_points.select("matched") for pair in files]
    return prove_pair(*files[0], SETTINGS, "quick")[1], found[:-1], found[-1]


def _files(images: list[Array], noise: float, seed: tuple[int, int], scratch: Path) -> tuple[Path, Path]:
    random = np.random.default_rng(seed)
    paths = []
    for which, image in enumerate(images):
        noisy = GREY_LEVELS * (image + noise * random.standard_normal(image.shape) + 20)
        numbers = np.clip(np.rint(noisy), 0, 65535).astype(np.uint16)
        paths.append(write(scratch / f"proof_{seed[0]}_{seed[1]}_{which}.tif", numbers))
    return paths[0], paths[1]


def _shared(scratch: Path) -> Table:
    """Put a displacement of structure in that both matches share, and look at the bound that is told."""
    grid, rows, checks = make_grid((SIDE_PX, SIDE_PX)), list[list[Cell]](), list[Check]()
    for number, name in enumerate(SHARED):
        moved = np.add(SHIFT_XY_PX, (SHARED_PX, 0))
        band = "thermal" if number == 2 else "red"
        target = render(grid, band, seed=340, noise=0.0, displacement_px=moved)
        if number == 1:
            parts = (SHIFT_XY_PX, np.add(moved, (SHARED_PX, 0)))
            target = sum(render(grid, seed=340, noise=0.0, displacement_px=each) for each in parts) / 2
        images = [render(grid, seed=340, noise=0.0), 255 - target]
        told = prove_pair(*_files(images, 3.0, (40 + number, 0), scratch), SETTINGS, "quick")[1]
        bound = told.unobservable
        rows.append([name, f"{told.bias_px[0]:+.4f}", f"{bound.at_least_px:.4f}", f"{bound.up_to_px:.4f}"])
        checks.append(at_least(f"{name}: up to", bound.up_to_px, SHARED_PX, "px"))
        checks.append(at_most(f"{name}: at least", bound.at_least_px, SHARED_PX + 0.02, "px"))
    header = ("structure that lies elsewhere", "bias x as seen", "at least", "up to")
    return Table("A displacement of structure that both matches share, px", header, rows, checks)


def _errors(points: TiePointTable, still: TiePointTable | None = None) -> Array:
    """Return the errors of points, less that without noise of the nearest point `still` where it is given."""
    errors = np.asarray(points.displacement_px - SHIFT_XY_PX)
    if still is None:
        return errors
    _, nearest = cKDTree(still.reference_px).query(points.reference_px)
    return np.asarray(errors - _errors(still)[nearest])


def _figures(told: Proof) -> list[Cell]:
    bias = [f"{value:+.4f}" for value in told.bias_px]
    return [*bias, *(f"{value:.4f}" for value in (*told.scatter_px, told.ce90_px))]


def _statistics(errors: list[Array]) -> tuple[Array, Array, float]:
    every = np.concatenate(errors)
    scatter = np.sqrt(np.mean([each.var(axis=0) for each in errors], axis=0))
    return every.mean(axis=0), scatter, float(np.percentile(np.linalg.norm(every, axis=1), 90))


def _true(errors: list[Array]) -> list[Cell]:
    bias, scatter, ce90 = _statistics(errors)
    return [*(f"{value:+.4f}" for value in bias), *(f"{value:.4f}" for value in (*scatter, ce90))]


def _checks(name: str, told: Proof, errors: list[Array]) -> list[Check]:
    bias, scatter, ce90 = _statistics(errors)
    means = np.array([each.mean(axis=0) for each in errors])
    chance = np.hypot(means.std(axis=0, ddof=1) / np.sqrt(len(means)), told.bias_error_px)
    off = np.abs(np.array(told.bias_px) - bias) - 2 * chance
    ratio = float(np.linalg.norm(told.scatter_px) / np.linalg.norm(scatter))
    return [
        at_most(
            f"{name}: bias off beyond chance, of the scatter",
            float(off.max() / np.linalg.norm(scatter)),
            WITHIN,
        ),
        within(f"{name}: scatter told, of the true one", ratio, 1 - WITHIN, 1 + WITHIN, digits=2),
        within(f"{name}: CE90 told, of the true one", told.ce90_px / ce90, 1 - WITHIN, 1 + WITHIN, digits=2),
    ]


def _shares(ratio: Array) -> tuple[float, float]:
    """Return the percentages of errors per axis within one and 1.96 sigmas, given the ratios of both."""
    return float(100 * (ratio <= 1).mean()), float(100 * (ratio <= 1.96).mean())
