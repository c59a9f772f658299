"""Series of images of one sensor: their steps, drifts, seasons and outliers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.estimation.time_series import SeriesModel, analyse
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.watch.dated_images import DatedImage
from pcwlad_geo.multi.watch.dates import YEAR_S
from pcwlad_geo.multi.watch.numbers import (
    ImageSeries,
    SeriesDrift,
    SeriesOffset,
    SeriesSeason,
    SeriesStep,
    WatchedImage,
)
from pcwlad_geo.types import Float64

_RADAR_ORBIT: Final = re.compile(
    r"(?<![A-Za-z0-9])(S1[A-D])(?:[-_]\w{2,4}){2,4}?[-_]\d{8}T\d{6}[-_]\d{8}T\d{6}[-_](\d{6})(?!\d)",
    re.IGNORECASE,
)
"""The satellite and the number of the orbit in the name of a product of Sentinel-1, or of its image."""
_ORBITS: Final = 175
"""Orbits of Sentinel-1 until it comes over the same ground again."""
_FIRST_ORBIT: Final = {"S1A": 73, "S1B": 27}
"""An orbit whose relative number is 1."""
SATELLITE: Final = re.compile(r"(?<![A-Za-z0-9])(S[1-3][A-D]|L[COTEM]0[4-9])(?![A-Za-z0-9])")
"""The satellite in the name of a product: Sentinel or Landsat."""


def images_by_series(images: Sequence[DatedImage]) -> dict[str, list[DatedImage]]:
    """Return the images by their series: what took them, the band and the size of a pixel if these differ."""
    sensors = [image.source.series or _satellite(image.source) for image in images]
    bands = [image.source.shown_band for image in images]
    sizes = [f"{image.pixel_size_m:.2g} m" if image.pixel_size_m else "" for image in images]
    kinds = list(zip(sensors, bands, sizes, strict=True))
    groups: dict[str, list[DatedImage]] = {}
    for image, (sensor, band, size) in zip(images, kinds, strict=True):
        same_sensor = [kind for kind in kinds if kind[0] == sensor]
        parts = [sensor]
        parts += [band] if len({kind[1] for kind in same_sensor}) > 1 else []
        parts += [size] if len({kind[2] for kind in same_sensor}) > 1 else []
        groups.setdefault(" ".join(filter(None, parts)) or "all images", []).append(image)
    return dict(sorted(groups.items()))


def _satellite(image: StackInput) -> str:
    """Return the satellite that the name or the path of an image tells; nothing where they do not.

    Of Sentinel-1 it is the satellite and its relative orbit, as radar sees the ground from another side in
    each: hills and walls lie elsewhere.
    """
    parts = (image.name, *reversed(Path(image.path).parts))
    radar = next(filter(None, map(_RADAR_ORBIT.search, parts)), None)
    if radar is not None:
        satellite, orbit = radar[1].upper(), int(radar[2])
        first = _FIRST_ORBIT.get(satellite)
        relative = (
            f"R{(orbit - first) % _ORBITS + 1:03d}" if first else f"orbit {orbit % _ORBITS} of {_ORBITS}"
        )
        return f"{satellite} {relative}"
    return next((match[1] for match in map(SATELLITE.search, parts) if match), "")


def series_of(name: str, images: Sequence[DatedImage], covariance: Float64 | None) -> ImageSeries:
    """Return what images of one series do over time, by the (n, n) `covariance` of all if known."""
    years = np.array([image.year for image in images])
    sigma_px = np.array([image.sigma_px for image in images])
    if covariance is not None:
        numbers = [image.number for image in images]
        covariance = _scaled(covariance[np.ix_(numbers, numbers)], sigma_px)
    model = analyse(years, np.array([image.shift_px for image in images]), sigma_px, covariance)
    sizes_m = [image.pixel_size_m for image in images if image.pixel_size_m]
    steps, drifts, seasons = (
        [change for change in model.terms if change.term.kind == kind] for kind in ("step", "drift", "season")
    )
    return ImageSeries(
        name=name,
        images=tuple(_watched(image, model, number) for number, image in enumerate(images)),
        pixel_size_m=float(np.median(sizes_m)) if sizes_m else None,
        noise_px=model.noise_px,
        level_px=float_pair(model.level_px),
        level_sigma_px=model.level_sigma_px,
        steps=tuple(
            SeriesStep(
                before=images[change.term.at - 1].source.name,
                image=images[change.term.at].source.name,
                date=str(images[change.term.at].source.day),
                size_px=float_pair(change.size_px[0]),
                sigma_px=change.sigma_px,
            )
            for change in steps
        ),
        drift=next((SeriesDrift(float_pair(change.size_px[0]), change.sigma_px) for change in drifts), None),
        season=next((_season(change.size_px, change.sigma_px) for change in seasons), None),
    )


def _scaled(covariance: Float64, sigma_px: Float64) -> Float64 | None:
    """Return the (n, n) covariance in px of the images, whose sigmas are told but for that of the datum."""
    variances = np.diag(covariance)
    valid = (sigma_px > 0) & (variances > 0)
    return covariance * float(np.median(sigma_px[valid] ** 2 / variances[valid])) if valid.any() else None


def _watched(image: DatedImage, model: SeriesModel, number: int) -> WatchedImage:
    return WatchedImage(
        name=image.source.name,
        date=str(image.source.day),
        shift_px=image.shift_px,
        sigma_px=image.sigma_px,
        expected_px=float_pair(model.fitted_px[number]),
        outlier=bool(model.outliers[number]),
    )


def _season(waves_px: Float64, sigma_px: float) -> SeriesSeason:
    """Return a yearly wave from its (2, 2) cosine and sine (col, row); times count from 1970-01-01."""
    days = []
    for cosine, sine in waves_px.T:
        day = float(np.arctan2(sine, cosine)) / (2 * np.pi) % 1 * YEAR_S
        days.append(datetime.fromtimestamp(day, timezone.utc).strftime("%m-%d"))
    return SeriesSeason(float_pair(np.hypot(*waves_px)), (days[0], days[1]), sigma_px)


def offsets_of(series: Sequence[ImageSeries]) -> tuple[SeriesOffset, ...]:
    """Return how each series lies to the first, where the sizes of their pixels relate them."""
    first, offsets = series[0], []
    for other in series[1:]:
        if (first.pixel_size_m is None) != (other.pixel_size_m is None):
            continue
        ratio = (other.pixel_size_m or 1.0) / (first.pixel_size_m or 1.0)
        offset = np.multiply(ratio, other.level_px) - first.level_px
        sigma = float(np.hypot(ratio * other.level_sigma_px, first.level_sigma_px))
        dates = first.images[-1].date, other.images[-1].date
        offsets.append(SeriesOffset(first.name, other.name, dates, float_pair(offset), sigma))
    return tuple(offsets)
