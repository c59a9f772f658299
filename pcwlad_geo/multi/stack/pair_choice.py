"""The choice of the pairs of a stack that are matched, by their common ground and likeness."""

from __future__ import annotations

import math
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
from pcwlad_geo.estimation.plausible import is_plausible
from pcwlad_geo.estimation.solving import components, pseudo_inverse
from pcwlad_geo.events import EventCallback, Warned
from pcwlad_geo.multi.stack.adjustment import Adjustment
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.equations import ends_of
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.inputs import StackInput, check_enough, read_table
from pcwlad_geo.multi.stack.result import Chosen
from pcwlad_geo.raster import RasterInfo, open_raster
from pcwlad_geo.raster.source import has_quick_overview
from pcwlad_geo.types import Float64, PathLike


@dataclass(frozen=True, slots=True)
class ChoiceParameters:
    """The tuned numbers of the choice of pairs."""

    all_pairs: int = 8
    """Largest number of images all of whose pairs are measured."""
    min_overlap: float = 0.1
    """Least common ground of a pair, as a share of the smaller image."""
    overview_px: int = 128
    """Longer side of an overview, px."""
    overlap_cells: int = 64
    """Number of positions along each axis at which the overviews of all images are compared."""
    uncertain_variance: float = 0.75
    """Variance of the position of an image, in those of a median pair, above which it gets another pair."""
    least_cost: float = 0.2
    """The variance of a pair is taken as the square of the sum of this and its cost."""
    uncertain_sigma: float = 1.5
    """Ratio of the sigma of an image to the median of all above which it gets further pairs."""
    direct_images: int = 300
    """Largest number of images whose variances are computed, which takes dense matrices."""
    pixels_alike: float = 0.1
    """Pixels whose sizes differ by a smaller share are those of one kind of image."""


CHOICE: Final = ChoiceParameters()
"""The numbers in use."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A pair with common ground, and its cost: low for images that are likely to match well."""

    pair: tuple[int, int]
    cost: float


def read_overview(info: RasterInfo, parameters: ChoiceParameters = CHOICE) -> Float64 | None:
    """Return the (rows, cols) gradient magnitude of an overview of an image; NaN where it has no data.

    It has at most `overview_px` px a side; None for a large image without stored overviews. Raises
    `InputError` if the pixels cannot be read.
    """
    if not has_quick_overview(info):
        return None
    rows, cols = info.grid.shape
    shape = tuple(
        max(2, min(side, round(side * parameters.overview_px / max(rows, cols)))) for side in (rows, cols)
    )
    with open_raster(info.uri) as dataset:
        read = dataset.read(info.band, out_shape=shape, masked=True, resampling=Resampling.average)
    valid = ~np.ma.getmaskarray(read) & is_plausible(read.data)
    if not valid.any():
        return np.full(shape, np.nan)
    values = np.where(valid, read.data, np.median(read.data[valid])).astype(np.float64)
    edges = ndimage.gaussian_gradient_magnitude(values, 1.0)
    return np.where(ndimage.binary_erosion(valid, border_value=1), edges, np.nan)


def candidates(
    frame: StackFrame,
    inputs: Sequence[StackInput],
    overviews: Sequence[Float64 | None],
    parameters: ChoiceParameters = CHOICE,
) -> list[Candidate]:
    """Return all pairs with common ground, those of the lowest cost first.

    The `overviews` of the images are those of `read_overview`, each (rows, cols) or None. The cost depends on
    the correlation of the overviews first (bands of one kind, one season, without clouds), then on season,
    sun, years between the images and clouds by the metadata, common ground and the ratio of pixel sizes.
    """
    outlines = [frame.outline(number) for number in range(len(frame.infos))]
    correlation = _correlations(frame, overviews, shapely.total_bounds(outlines), parameters.overlap_cells)
    pixel = [frame.pixel(number) for number in range(len(frame.infos))]
    pairs = []
    for one, other in combinations(range(len(outlines)), 2):
        overlap = _overlap(outlines[one], outlines[other])
        if overlap >= parameters.min_overlap:
            cost = 1.5 - correlation[one, other] - 0.5 * overlap + _metadata_cost(inputs[one], inputs[other])
            cost += 0.2 * abs(float(np.log2(pixel[one] / pixel[other])))
            pairs.append(Candidate((one, other), round(cost + 1e-6 * (other - one), 9)))
    return sorted(pairs, key=lambda candidate: (candidate.cost, candidate.pair))


def _overlap(one: shapely.Geometry, other: shapely.Geometry) -> float:
    smaller = min(one.area, other.area)
    return float(one.intersection(other).area / smaller) if smaller > 0 else 0.0


def _metadata_cost(one: StackInput, other: StackInput) -> float:
    """Return the part of the cost of a pair that depends on dates, sun and clouds in the metadata."""
    cost = 0.25 * ((one.cloud or 0.0) + (other.cloud or 0.0))
    if one.day is not None and other.day is not None:
        days = abs((one.day - other.day).days)
        season = min(days % 365.25, 365.25 - days % 365.25) / 182.6
        cost += 0.3 * season + 0.1 * min(1.0, days / 3650)
    if one.sun_elevation is not None and other.sun_elevation is not None:
        cost += 0.3 * min(1.0, abs(one.sun_elevation - other.sun_elevation) / 60)
    return cost


def _correlations(
    frame: StackFrame, overviews: Sequence[Float64 | None], bounds: Float64, cells: int
) -> Float64:
    """Return the (images, images) correlations of the overviews on common ground; 0.5 where unknown.

    They are compared within the (4,) `bounds`, px of the frame.
    """
    low, high = bounds.reshape(2, 2)
    step = (np.arange(cells) + 0.5) / cells
    at = low + np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2) * (high - low)
    samples = np.stack([_sampled(frame, number, overview, at) for number, overview in enumerate(overviews)])
    valid = np.isfinite(samples)
    values = np.where(valid, samples, 0.0)
    weight = valid.astype(np.float64)
    count = weight @ weight.T
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (values @ weight.T) / count  # of the first over what both show
        square = ((values**2) @ weight.T) / count - mean**2
        correlation = ((values @ values.T) / count - mean * mean.T) / np.sqrt(square * square.T)
    reliable = (count >= 64) & np.isfinite(correlation)
    return np.where(reliable, np.clip(correlation, 0.0, 1.0), 0.5)


def _sampled(frame: StackFrame, image: int, overview: Float64 | None, at: Float64) -> Float64:
    """Return the overview of an image at (n, 2) positions of the frame, scaled; NaN outside."""
    samples = np.full(len(at), np.nan)
    if overview is None or not np.isfinite(overview).any():
        return samples
    rows, cols = frame.infos[image].grid.shape
    per_px = np.array([overview.shape[1] / cols, overview.shape[0] / rows])
    with np.errstate(invalid="ignore"):
        index = np.floor(frame.to_image(image, at) * per_px)
    inside = ((index >= 0) & (index < overview.shape[::-1])).all(axis=1)
    col, row = index[inside].astype(int).T
    samples[inside] = overview[row, col] / np.nanstd(overview) if np.nanstd(overview) > 0 else np.nan
    return samples


def choose_pairs(
    ranked: Sequence[Candidate],
    images: int,
    most: int | None = None,
    before: Sequence[tuple[int, int]] = (),
    parameters: ChoiceParameters = CHOICE,
) -> list[tuple[int, int]]:
    """Return the pairs to measure, the most important first, not more than `most`.

    The candidates `ranked` are in the order of their cost; `images` is the number of images. Pairs measured
    `before`, by an earlier run, are kept, and only images that have none get others.
    """
    connected = {image for pair in before for image in pair}
    pairs = dict.fromkeys(before)
    for _ in range(3):  # two spanning trees without common pairs would close a cycle with every pair
        pairs |= dict.fromkeys(_spanning_tree(ranked, images, connected, pairs))
    if images <= parameters.all_pairs:
        pairs |= dict.fromkeys(
            candidate.pair for candidate in ranked if not connected.issuperset(candidate.pair)
        )
    elif images <= parameters.direct_images and not before:
        pairs |= dict.fromkeys(_strengthening(ranked, images, list(pairs), parameters))
    return list(pairs)[:most]


def _spanning_tree(
    ranked: Sequence[Candidate], images: int, connected: set[int], excluded: Mapping[tuple[int, int], None]
) -> Iterator[tuple[int, int]]:
    """Yield the pairs of a minimum spanning tree (Kruskal) but the `excluded`; `connected` images are one."""
    roots = [min(connected) if image in connected else image for image in range(images)]
    for candidate in ranked:
        one, other = (roots[image] for image in candidate.pair)
        if one != other and candidate.pair not in excluded:
            roots = [one if root == other else root for root in roots]
            yield candidate.pair


def _strengthening(
    ranked: Sequence[Candidate], images: int, pairs: list[tuple[int, int]], parameters: ChoiceParameters
) -> Iterator[tuple[int, int]]:
    """Yield further pairs for the images that are least well connected to the first."""
    all_pairs = set(pairs)
    weight = {candidate.pair: (parameters.least_cost + candidate.cost) ** -2 for candidate in ranked}
    usual = float(np.median([weight[pair] for pair in pairs]))
    laplace = np.zeros((images, images))
    for pair in pairs:
        _connect(laplace, pair, weight[pair] / usual)
    while len(all_pairs) < 4 * images:
        variance = np.insert(np.diag(pseudo_inverse(laplace[1:, 1:], hermitian=True)), 0, 0.0)
        addition = _another(ranked, all_pairs, variance, parameters.uncertain_variance)
        if addition is None:
            return
        all_pairs.add(addition)
        _connect(laplace, addition, weight[addition] / usual)
        yield addition


def _another(
    ranked: Sequence[Candidate], excluded: set[tuple[int, int]], variance: Float64, limit: float
) -> tuple[int, int] | None:
    """Return a pair for the image of the largest variance that can get one.

    None if no image has a variance above the `limit`.
    """
    for worst in np.argsort(-variance, kind="stable").tolist():
        if variance[worst] <= limit:
            return None
        for candidate in ranked:
            other = sum(candidate.pair) - worst
            if (
                worst in candidate.pair
                and candidate.pair not in excluded
                and variance[other] < variance[worst] / 2
            ):
                return candidate.pair
    return None


def _connect(laplace: Float64, pair: tuple[int, int], weight: float) -> None:
    """Add a pair to the weighted Laplacian matrix of the graph of pairs."""
    one, other = pair
    laplace[[one, other], [one, other]] += weight
    laplace[[one, other], [other, one]] -= weight


def asked_by_sigma(
    ranked: Sequence[Candidate],
    measured: Sequence[tuple[int, int]],
    sigma: Float64,
    kinds: Sequence[object],
    parameters: ChoiceParameters = CHOICE,
) -> list[tuple[int, int]]:
    """Return further pairs, at most two each, for images of an unusually large sigma.

    All pairs of two kinds of images may have an error in common, which only pairs with a third kind average:
    kinds with which an image has the fewest pairs come first. The candidates `ranked` are in the order of
    their cost, and those `measured` were measured. The (images,) array `sigma` has the standard deviation of
    the position of each image, and `kinds` its kind.
    """
    limit = parameters.uncertain_sigma * float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else np.inf
    pairs = dict.fromkeys(measured)
    count = len(pairs)
    for image in np.flatnonzero(sigma > limit).tolist():
        for _ in range(2):
            with_kind = Counter(kinds[sum(pair) - image] for pair in pairs if image in pair)
            free = [
                candidate.pair
                for candidate in ranked
                if image in candidate.pair
                and candidate.pair not in pairs
                and sigma[sum(candidate.pair) - image] <= limit
            ]
            if free:
                pairs[min(free, key=lambda pair: with_kind[kinds[sum(pair) - image]])] = None
    return list(pairs)[count:]


def additional_pairs(
    frame: StackFrame,
    ranked: Sequence[Candidate],
    plan: Sequence[tuple[int, int]],
    edges: Sequence[Edge],
    adjustment: Adjustment,
    parameters: ChoiceParameters = CHOICE,
) -> list[tuple[int, int]]:
    """Return the pairs to measure in addition, chosen by the sigmas of the images of a frame.

    `ranked` are the pairs to choose from, `plan` those that were measured, `edges` those that the adjustment
    has.
    """
    sigma = []
    for number, info in enumerate(frame.infos):
        middle = frame.from_image(number, info.grid.middle_px)
        sigma.append(float(np.sqrt(np.trace(adjustment.covariance(number, middle)[0]) / 2)))
    kinds = _kinds(frame, edges, adjustment, parameters)
    return asked_by_sigma(ranked, plan, np.array(sigma), kinds, parameters)


def _kinds(
    frame: StackFrame, edges: Sequence[Edge], adjustment: Adjustment, parameters: ChoiceParameters
) -> list[tuple[object, ...]]:
    """Return the kind of each image: like images have pairs of small errors, one band and one pixel size."""
    error = np.array([fit.shared for fit in adjustment.edges])
    precise = error <= parameters.uncertain_sigma * float(np.median(error))
    like = components(ends_of(edges)[precise], len(adjustment.coefficients))
    sizes = [
        round(math.log(frame.pixel(number)) / parameters.pixels_alike) for number in range(len(frame.infos))
    ]
    return [(int(like[number]), frame.given(number).band, size) for number, size in enumerate(sizes)]


def listed_pairs(table: PathLike, frame: StackFrame, inputs: Sequence[StackInput]) -> list[tuple[int, int]]:
    """Return the pairs of a CSV table with columns reference and target, names or paths of images.

    Raises `InputError` if it cannot be read or names an image that the stack does not have.
    """
    number = {name: index for index, name in enumerate(frame.names)}
    for index, image_input in enumerate(inputs):
        with suppress(OSError):
            number.setdefault(str(Path(image_input.path).resolve()), index)
    pairs: dict[tuple[int, int], None] = {}
    for row in read_table(Path(table), ("reference", "target")):
        ends = []
        for column in ("reference", "target"):
            text = row[column]
            end = number.get(text, number.get(str((Path(table).parent / text).resolve())))
            if end is None:
                names = ", ".join(frame.names)
                raise InputError(f"{table} names {text}, which is none of the images {names}")
            ends.append(end)
        if ends[0] == ends[1]:
            raise InputError(f"{table} has a pair of {row['reference']} with itself")
        pairs[min(ends), max(ends)] = None
    return list(pairs)


def planned_pairs(
    frame: StackFrame,
    ranked: Sequence[Candidate],
    listed_in: PathLike | None,
    most: int | None,
    before: Sequence[tuple[int, int]] = (),
) -> tuple[Chosen, list[tuple[int, int]]]:
    """Return how pairs are chosen, and the pairs: those of a table, or of the candidates `most` at most."""
    if listed_in is not None:
        return "listed", listed_pairs(listed_in, frame, frame.inputs)[:most]
    return "auto" if most is None else "limited", choose_pairs(ranked, len(frame.infos), most, before)


def overviews_of(
    inputs: list[StackInput], infos: list[RasterInfo], unreadable: dict[str, str], tell: EventCallback
) -> list[Float64 | None]:
    """Return the (rows, cols) overviews of images; those whose pixels cannot be read leave the lists."""
    overviews, count = [], len(inputs)
    for image, info in list(zip(inputs, infos, strict=True)):
        try:
            overviews.append(read_overview(info))
        except InputError as error:
            inputs.remove(image)
            infos.remove(info)
            unreadable[image.path] = str(error)
            tell(Warned(f"{image.name} is left out: {error}"))
    check_enough(len(inputs), count, unreadable)
    return overviews
