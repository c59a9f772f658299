"""The images of a finished stack that have dates, and how their positions are correlated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import RANK, pseudo_inverse
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.multi.block.parameters import BLOCK
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT
from pcwlad_geo.multi.watch.dates import FIRST_YEAR, LAST_YEAR, YEAR_S, seconds_of
from pcwlad_geo.raster import plain_name
from pcwlad_geo.types import Float64


def checked_numbers(numbers: Mapping[str, Any], place: Path) -> Mapping[str, Any]:
    """Return the content of stack.json; raises `InputError` if the figures of its pairs are not valid."""
    try:
        for pair in numbers["pairs"]:
            figures = [float(pair.get(name) or 0.0) for name in ("sigma_px", "redundancy")]
            if not all(0 <= figure <= LIMITS.coordinate for figure in figures):
                raise ValueError("the figures of a pair are not valid numbers")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{place} is damaged ({error}): stack the images again") from error
    return numbers


def dated_images(
    numbers: Mapping[str, Any], place: Path
) -> tuple[list[DatedImage], tuple[str, ...], tuple[str, ...]]:
    """Return the images with dates, in their order, and the names of those without and of those refused."""
    dated, undated, refused = [], [], []
    try:
        for number, entry in enumerate(numbers["images"]):
            source = StackInput.from_dict(entry["given"])
            if source.name != plain_name(source.name):
                raise ValueError(f"{source.name!r} is no name of an image")
            shift, sigma = (np.array(entry[name], np.float64) for name in ("shift_px", "sigma_px"))
            size = np.array(entry["pixel_size_m"] or (1.0, 1.0), np.float64)
            sizes = np.array([shift, sigma, size])
            if sizes.shape != (3, 2) or not (np.abs(sizes) <= LIMITS.coordinate).all():
                raise ValueError(f"the figures of {source.name} must be pairs of numbers")
            if sigma.min() < 0 or size.min() < 1 / LIMITS.coordinate:
                raise ValueError(f"a sigma or a pixel of {source.name} is below zero")
            if (entry["registered"] or source.name) != plain_name(entry["registered"] or source.name):
                raise ValueError(f"{entry['registered']!r} is no name of a file")
            if entry["registered"] is None:
                refused.append(source.name)
            elif source.day is None or not FIRST_YEAR <= source.day.year <= LAST_YEAR:
                undated.append(source.name)
            else:
                size_m = float(np.sqrt(size.prod())) if entry["pixel_size_m"] else None
                sigma_px = float(np.hypot(*sigma) / 2**0.5)
                dated.append(DatedImage(number, source, _year(source), float_pair(shift), sigma_px, size_m))
    except (KeyError, TypeError, ValueError, LookupError, AttributeError) as error:
        raise InputError(f"{place} is damaged ({error}): stack the images again") from error
    if len(dated) < 2:
        raise InputError(
            f"{place}: a series needs two images with dates, and there are {len(dated)}: stack them by a "
            "table with a column date"
        )
    dated.sort(key=lambda image: (image.year, image.number))
    return dated, tuple(undated), tuple(refused)


def position_covariance(numbers: Mapping[str, Any]) -> Float64 | None:
    """Return the (n, n) covariance of the places of all images that their pairs tell; None without sigmas.

    The unit is that of the sigmas of the pairs: only the correlations of the errors matter.
    """
    names = {entry["name"]: number for number, entry in enumerate(numbers["images"])}
    parameters = ADJUSTMENT if numbers.get("block") is None else BLOCK
    least = parameters.min_sigma_redundancy
    normal = np.zeros((len(names), len(names)))
    for pair in numbers["pairs"]:
        first, second = names.get(pair["reference"]), names.get(pair["target"])
        sigma, redundancy = pair.get("sigma_px"), pair.get("redundancy")
        if pair["status"] != "used" or first is None or second is None or not sigma or redundancy is None:
            continue
        # the variance of the observation itself, of which `robust.reliability` made the sigma
        variance = max(float(sigma), 1 / LIMITS.coordinate) ** 2 / max(float(redundancy), least)
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
