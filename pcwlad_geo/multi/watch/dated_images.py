"""The images of a finished stack that have dates, and how their positions are correlated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import RANK, pseudo_inverse
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.multi.block.parameters import BLOCK
from pcwlad_geo.multi.stack.finished import ReadStack
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT
from pcwlad_geo.multi.watch.dates import FIRST_YEAR, LAST_YEAR, YEAR_S, seconds_of
from pcwlad_geo.types import Float64


def dated_images(stack: ReadStack, place: Path) -> tuple[list[DatedImage], tuple[str, ...], tuple[str, ...]]:
    """Return the images with dates, in their order, and the names of those without and of those refused."""
    dated, undated, refused = [], [], []
    for number, image in enumerate(stack.images):
        source = image.given
        if image.registered is None:
            refused.append(source.name)
        elif source.day is None or not FIRST_YEAR <= source.day.year <= LAST_YEAR:
            undated.append(source.name)
        else:
            size_m = float(np.sqrt(np.prod(image.pixel_size_m))) if image.pixel_size_m else None
            sigma_px = float(np.hypot(*image.sigma_px) / 2**0.5)
            dated.append(DatedImage(number, source, _year(source), image.shift_px, sigma_px, size_m))
    if len(dated) < 2:
        raise InputError(
            f"{place}: a series needs two images with dates, and there are {len(dated)}: stack them by a "
            "table with a column date"
        )
    dated.sort(key=lambda image: (image.year, image.number))
    return dated, tuple(undated), tuple(refused)


def position_covariance(stack: ReadStack) -> Float64 | None:
    """Return the (n, n) covariance of the places of all images that their pairs tell; None without sigmas.

    The unit is that of the sigmas of the pairs: only the correlations of the errors matter.
    """
    names = {image.name: number for number, image in enumerate(stack.images)}
    parameters = ADJUSTMENT if stack.block is None else BLOCK
    least = parameters.min_sigma_redundancy
    normal = np.zeros((len(names), len(names)))
    for pair in stack.pairs:
        first, second = names.get(pair.reference), names.get(pair.target)
        sigma, redundancy = pair.sigma_px, pair.redundancy
        if pair.status != "used" or first is None or second is None or not sigma or redundancy is None:
            continue
        # the variance of the observation itself, of which `robust.reliability` made the sigma
        variance = max(sigma, 1 / LIMITS.coordinate) ** 2 / max(redundancy, least)
        design = np.zeros(len(names))
        design[[first, second]] = -1.0, 1.0
        normal += np.outer(design, design) / variance
    if not np.isfinite(normal).all() or not normal.any():
        return None
    return pseudo_inverse(normal, RANK, hermitian=True)


def _year(image: StackInput) -> float:
    """Return the time of an image with a date, years since 1970; without a time of day it is midnight UTC."""
    try:
        return seconds_of(str(image.date).replace("Z", "+00:00")) / YEAR_S
    except ValueError:  # with a time in another form
        return seconds_of(str(image.day)) / YEAR_S


@dataclass(frozen=True, slots=True)
class DatedImage:
    """An image of a stack with its time, and what stack.json says of it."""

    number: int
    """In stack.json, counted from 0."""
    source: StackInput
    year: float
    """Time since 1970."""
    shift_px: tuple[float, float]
    sigma_px: float
    pixel_size_m: float | None
