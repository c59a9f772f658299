"""Which pairs of a stack are worth measuring: a sparse graph in which every image is checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from rasterio.enums import Resampling
from scipy import ndimage

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import pseudo_inverse
from pcwlad_geo.raster.source import RasterInfo, has_quick_overview, open_raster
from pcwlad_geo.stacks.inputs import StackInput, read_table
from pcwlad_geo.stacks.pairs import Frame
from pcwlad_geo.types import Float64, PathLike

ALL_PAIRS: Final = 8
"""Of so many images every pair is measured."""
SPANNING_TREES: Final = 3
"""Beyond, so many spanning trees without a common pair: each gives every image a pair, and two close
a cycle with every pair."""
MIN_OVERLAP: Final = 0.1
"""Least common ground of a pair, as a share of the smaller image."""
OVERVIEW_PX: Final = 128
"""Side of a overview, px."""
OVERLAP_CELLS: Final = 64
"""The common ground of all images is compared at so many places along each axis."""
MIN_CELLS: Final = 64
"""Least number of common places at which overviews are compared."""
FAR: Final = 0.75
"""An image whose position has a larger variance, in those of a usual pair, gets one more pair."""
LEAST_COST: Final = 0.2
"""The variance of a pair is taken as the square of this and its cost."""
MOST: Final = 4
"""Pairs an image, at most."""
UNSURE: Final = 1.5
"""An image of a sigma larger than so many medians gets further pairs."""
DIRECT_IMAGES: Final = 300
"""Of more images the variances are not asked for, which take dense matrices."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A pair with common ground, and how little promising it is."""

    pair: tuple[int, int]
    cost: float


def read_overview(info: RasterInfo) -> Float64 | None:
    """Return a (rows, cols) image of where an image shows edges; NaN where it shows nothing.

    It has at most `OVERVIEW_PX` px a side.

    None where reading it would take as long as reading a large image. Raises `InputError` if the pixels
    cannot be read.
    """
    if not has_quick_overview(info):
        return None
    rows, cols = info.grid.shape
    shape = tuple(max(2, min(side, round(side * OVERVIEW_PX / max(rows, cols)))) for side in (rows, cols))
    with open_raster(info.uri) as dataset:
        read = dataset.read(info.band, out_shape=shape, masked=True, resampling=Resampling.average)
    valid = ~np.ma.getmaskarray(read) & np.isfinite(read.data)
    if not valid.any():
        return np.full(shape, np.nan)
    values = np.where(valid, read.data, np.median(read.data[valid])).astype(np.float64)
    edges = ndimage.gaussian_gradient_magnitude(values, 1.0)
    return np.where(ndimage.binary_erosion(valid, border_value=1), edges, np.nan)


def candidates(
    frame: Frame, inputs: Sequence[StackInput], overviews: Sequence[Float64 | None]
) -> list[Candidate]:
    """Return all pairs with common ground, the most promising first.

    `overviews` are the overviews of the images, each (rows, cols) or None.

    What counts is how alike the overviews' edges are (bands of one kind, one season, without clouds), then
    season, sun, years between them, clouds told by the metadata, common ground and pixels of one size.
    """
    outlines = [
        shapely.Polygon(frame.from_image(number, info.grid.boundary_px()))
        for number, info in enumerate(frame.infos)
    ]
    alike = _likeness(frame, overviews)
    pixel = [
        abs(float(np.linalg.det(frame.scale(number, info.grid.middle_px)[0]))) ** 0.5
        for number, info in enumerate(frame.infos)
    ]
    found = []
    for one, other in combinations(range(len(outlines)), 2):
        overlap = _overlap(outlines[one], outlines[other])
        if overlap >= MIN_OVERLAP:
            cost = 1.5 - alike[one, other] - 0.5 * overlap + _metadata_cost(inputs[one], inputs[other])
            cost += 0.2 * abs(float(np.log2(pixel[one] / pixel[other])))
            found.append(Candidate((one, other), round(cost + 1e-6 * (other - one), 9)))
    return sorted(found, key=lambda each: (each.cost, each.pair))


def _overlap(one: shapely.Polygon, other: shapely.Polygon) -> float:
    smaller = min(one.area, other.area)
    return float(one.intersection(other).area / smaller) if smaller > 0 else 0.0


def _metadata_cost(one: StackInput, other: StackInput) -> float:
    """Return what dates, sun and clouds of the metadata say against a pair."""
    cost = 0.25 * ((one.cloud or 0.0) + (other.cloud or 0.0))
    if one.day is not None and other.day is not None:
        days = abs((one.day - other.day).days)
        season = min(days % 365.25, 365.25 - days % 365.25) / 182.6
        cost += 0.3 * season + 0.1 * min(1.0, days / 3650)
    if one.sun_elevation is not None and other.sun_elevation is not None:
        cost += 0.3 * min(1.0, abs(one.sun_elevation - other.sun_elevation) / 60)
    return cost


def _likeness(frame: Frame, overviews: Sequence[Float64 | None]) -> Float64:
    """Return the (images, images) correlation of the overviews on common ground; 0.5 where unknown."""
    corners = [frame.from_image(number, info.grid.boundary_px()) for number, info in enumerate(frame.infos)]
    low, high = np.min(np.vstack(corners), axis=0), np.max(np.vstack(corners), axis=0)
    step = (np.arange(OVERLAP_CELLS) + 0.5) / OVERLAP_CELLS
    at = low + np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2) * (high - low)
    samples = np.stack([_sampled(frame, number, overview, at) for number, overview in enumerate(overviews)])
    valid = np.isfinite(samples)
    values = np.where(valid, samples, 0.0)
    weight = valid.astype(np.float64)
    count = weight @ weight.T
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (values @ weight.T) / count  # of the first over what both show
        square = ((values**2) @ weight.T) / count - mean**2
        found = ((values @ values.T) / count - mean * mean.T) / np.sqrt(square * square.T)
    known = (count >= MIN_CELLS) & np.isfinite(found)
    return np.where(known, np.clip(found, 0.0, 1.0), 0.5)


def _sampled(frame: Frame, image: int, overview: Float64 | None, at: Float64) -> Float64:
    """Return the overview of an image at (n, 2) positions of the frame, scaled; NaN outside."""
    found = np.full(len(at), np.nan)
    if overview is None or not np.isfinite(overview).any():
        return found
    rows, cols = frame.infos[image].grid.shape
    per_px = np.array([overview.shape[1] / cols, overview.shape[0] / rows])
    with np.errstate(invalid="ignore"):
        index = np.floor(frame.to_image(image, at) * per_px)
    inside = ((index >= 0) & (index < overview.shape[::-1])).all(axis=1)
    col, row = index[inside].astype(int).T
    found[inside] = overview[row, col] / np.nanstd(overview) if np.nanstd(overview) > 0 else np.nan
    return found


def choose_pairs(
    found: Sequence[Candidate], images: int, most: int | None = None, before: Sequence[tuple[int, int]] = ()
) -> list[tuple[int, int]]:
    """Return the pairs to measure, at `most` so many, those without which the rest is worth less first.

    The candidates are `found` the most promising first, for so many `images`. Pairs measured `before`, by an
    earlier run, stay, and only images that have none get others.
    """
    known = {image for pair in before for image in pair}
    chosen = dict.fromkeys(before)
    for _ in range(SPANNING_TREES):
        chosen |= dict.fromkeys(_spanning_tree(found, images, known, chosen))
    if images <= ALL_PAIRS:
        chosen |= dict.fromkeys(each.pair for each in found if not known.issuperset(each.pair))
    elif images <= DIRECT_IMAGES and not before:
        chosen |= dict.fromkeys(_strengthening(found, images, list(chosen)))
    return list(chosen)[:most]


def _spanning_tree(
    found: Sequence[Candidate], images: int, known: set[int], taken: Mapping[tuple[int, int], None]
) -> Iterator[tuple[int, int]]:
    """Yield the cheapest pairs not taken that connect all images (Kruskal); those known are connected."""
    tree = list(range(images))
    for image in known:
        tree[image] = min(known)
    for each in found:
        one, other = (tree[image] for image in each.pair)
        if one != other and each.pair not in taken:
            tree = [one if root == other else root for root in tree]
            yield each.pair


def _strengthening(
    found: Sequence[Candidate], images: int, chosen: list[tuple[int, int]]
) -> Iterator[tuple[int, int]]:
    """Yield further pairs for the images that are least well connected to the first."""
    taken = set(chosen)
    weight = {each.pair: (LEAST_COST + each.cost) ** -2 for each in found}
    usual = float(np.median([weight[pair] for pair in chosen]))
    laplace = np.zeros((images, images))
    for pair in chosen:
        _connect(laplace, pair, weight[pair] / usual)
    while len(taken) < MOST * images:
        variance = np.diag(pseudo_inverse(laplace[1:, 1:], hermitian=True))
        variance = np.concatenate([[0.0], variance])
        another = _another(found, taken, variance)
        if another is None:
            return
        taken.add(another)
        _connect(laplace, another, weight[another] / usual)
        yield another


def _another(
    found: Sequence[Candidate], taken: set[tuple[int, int]], variance: Float64
) -> tuple[int, int] | None:
    """Return a pair for the image of the largest variance that can get one; None where none needs it."""
    for worst in np.argsort(-variance, kind="stable").tolist():
        if variance[worst] <= FAR:
            return None
        for each in found:
            other = sum(each.pair) - worst
            if worst in each.pair and each.pair not in taken and variance[other] < variance[worst] / 2:
                return each.pair
    return None


def _connect(laplace: Float64, pair: tuple[int, int], weight: float) -> None:
    """Add a pair to the matrix whose inverse tells how well images are connected."""
    one, other = pair
    laplace[[one, other], [one, other]] += weight
    laplace[[one, other], [other, one]] -= weight


def asked_by_sigma(
    found: Sequence[Candidate],
    chosen: Sequence[tuple[int, int]],
    sigma: Float64,
    kinds: Sequence[object] | None = None,
) -> list[tuple[int, int]]:
    """Return further pairs, two an image, for images of an unusually large sigma.

    What one kind of image sees otherwise than another is the same in all pairs of the two kinds, and only
    pairs with a third kind average it: kinds with which an image has the fewest pairs come first. The
    candidates are `found` the most promising first, and those `chosen` are there already. The (images,) array
    `sigma` has the standard deviation of the position of each; all are of one of the `kinds` by default.
    """
    limit = UNSURE * float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else np.inf
    kinds = kinds if kinds is not None else [None] * len(sigma)
    taken, more = dict.fromkeys(chosen), []
    for image in np.flatnonzero(sigma > limit).tolist():
        for _ in range(2):
            with_kind = Counter(kinds[sum(pair) - image] for pair in taken if image in pair)
            free = [
                each.pair
                for each in found
                if image in each.pair and each.pair not in taken and sigma[sum(each.pair) - image] <= limit
            ]
            if free:
                pair = min(free, key=lambda pair: with_kind[kinds[sum(pair) - image]])
                taken[pair] = None
                more.append(pair)
    return more


def listed_pairs(table: PathLike, frame: Frame, inputs: Sequence[StackInput]) -> list[tuple[int, int]]:
    """Return the pairs of a CSV table with columns reference and target, names or paths of images.

    Raises `InputError` if it cannot be read or names an image that the stack does not have.
    """
    number = {name: index for index, name in enumerate(frame.names)}
    for index, given in enumerate(inputs):
        with suppress(OSError):
            number.setdefault(str(Path(given.path).resolve()), index)
    chosen: dict[tuple[int, int], None] = {}
    for row in read_table(Path(table), ("reference", "target")):
        ends = []
        for column in ("reference", "target"):
            text = row[column]
            place = str((Path(table).parent / text).resolve())
            if text not in number and place not in number:
                raise InputError(
                    f"{table} names {text}, which is none of the images {', '.join(frame.names)}"
                )
            ends.append(number.get(text, number.get(place, 0)))
        if ends[0] == ends[1]:
            raise InputError(f"{table} has a pair of {row['reference']} with itself")
        chosen[min(ends), max(ends)] = None
    return list(chosen)
