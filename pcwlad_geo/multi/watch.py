"""The geolocation of a time series: what the images of a finished stack do over time, and the ground below.

A stack gives every date a displacement with its sigma. Here the dates of one sensor are a series, in which
steps, drifts, seasons and outliers are sought; what the tie points of all pairs have beside that is motion of
the ground. What all images share, the frame itself, cannot be seen.
"""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from datetime import date, datetime, timezone
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from affine import Affine
from scipy import ndimage

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.models import AffineCorrection, Correction, affine_between, from_dict
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import RANK, pseudo_inverse
from pcwlad_geo.estimation.time_series import (
    MIN_IMAGES,
    MIN_MOVING_IMAGES,
    MIN_SEASON_IMAGES,
    MIN_SEASON_YEARS,
    Motions,
    SeriesModel,
    analyse,
    displacements,
    velocities,
)
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore, only_warnings
from pcwlad_geo.limits import COORDINATE
from pcwlad_geo.multi.network import LEAST_CHECKED
from pcwlad_geo.multi.stack import VRT, frame_of, numbers_of, warp_onto
from pcwlad_geo.multi.stack_inputs import StackInput
from pcwlad_geo.multi.stack_pairs import PAIRS, StackFrame
from pcwlad_geo.multi.stack_result import (
    COLLECTION,
    NODES,
    PAGE,
    Asset,
    StackRequirement,
    stac_item,
    stac_texts,
)
from pcwlad_geo.multi.stack_result import NUMBERS as STACK_NUMBERS
from pcwlad_geo.multi.trend import seconds_of
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products import products_found_once
from pcwlad_geo.raster.grid import Grid, middle_pixel_size_m
from pcwlad_geo.raster.source import RasterInfo, describe, plain_name
from pcwlad_geo.raster.trust import Trust, trusting
from pcwlad_geo.raster.vrt import corrected_transform, referred
from pcwlad_geo.report.content import versions
from pcwlad_geo.report.page import page_environment, page_script
from pcwlad_geo.requirements import Requirement, RequirementResult, parse_requirements
from pcwlad_geo.text import csv_of
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Bool, Float64, Index, PathLike

NAMES: Final = {"numbers": "watch.json", "table": "watch.csv", "report": "watch.html", "motion": "motion.tif"}
"""File names of the outputs by kind."""
SATELLITE: Final = re.compile(r"(?<![A-Za-z0-9])(S[1-3][A-D]|L[COTEM]0[4-9])(?![A-Za-z0-9])")
"""The satellite in the name of a product: Sentinel or Landsat."""
YEAR_S: Final = 365.25 * 86400
"""Length of a year, s."""
FIRST_YEAR, LAST_YEAR = 1900, 2200
"""Years in which an image may have been taken."""
MAX_PACKED: Final = 120_000
"""Largest number of displacements of cells that the page holds, six bytes each."""
PACKED_LARGEST: Final = 32767
"""Largest whole number of 16 bits."""
APPLIED: Final = "{}_registered.tif"
"""File name of an image that was written on the grid of the stack."""
CORRECTED: Final = (
    "Original images of one ground, with the georeferencing that a common adjustment gives them"
)
"""Description of their collection."""
COLUMNS: Final = (
    *("name", "series", "date", "shift_col_px", "shift_row_px", "sigma_px"),
    *("expected_col_px", "expected_row_px", "outlier"),
)
"""Columns of watch.csv."""


@dataclass(frozen=True, slots=True)
class WatchedImage:
    """An image, beside what its series lets expect."""

    name: str
    date: str
    """Day, ISO 8601."""
    shift_px: tuple[float, float]
    """Displacement (col, row) in the frame of the stack, px of the image."""
    sigma_px: float
    """Its standard deviation along an axis."""
    expected_px: tuple[float, float]
    """What the model of its series says."""
    outlier: bool
    """Whether it is none of its series: errors of that size would hardly occur."""


@dataclass(frozen=True, slots=True)
class SeriesStep:
    """A step in a series."""

    before: str
    """Name of the last image before it."""
    image: str
    """Name of the first image after it."""
    date: str
    """Date of that image."""
    size_px: tuple[float, float]
    """(col, row)."""
    sigma_px: float
    """Standard deviation along an axis."""


@dataclass(frozen=True, slots=True)
class SeriesDrift:
    """A steady motion of a series."""

    px_per_year: tuple[float, float]
    """(col, row)."""
    sigma_px: float
    """Standard deviation along an axis, px a year."""


@dataclass(frozen=True, slots=True)
class SeriesSeason:
    """A yearly wave of a series."""

    amplitude_px: tuple[float, float]
    """(col, row)."""
    largest_on: tuple[str, str]
    """Day (month-day) of the largest value (col, row)."""
    sigma_px: float
    """Standard deviation of the amplitude along an axis."""


@dataclass(frozen=True, slots=True)
class ImageSeries:
    """The images of one sensor and band over time."""

    name: str
    images: tuple[WatchedImage, ...]
    """In the order of their dates."""
    pixel_size_m: float | None
    """Side of a pixel of the image; null without a CRS."""
    noise_px: float
    """Robust standard deviation along an axis of what the model leaves, px."""
    level_px: tuple[float, float]
    """Displacement (col, row) at the last date, without the season."""
    level_sigma_px: float
    """Its standard deviation along an axis."""
    steps: tuple[SeriesStep, ...]
    drift: SeriesDrift | None
    season: SeriesSeason | None

    @property
    def outliers(self) -> tuple[WatchedImage, ...]:
        """The images that are none of the series."""
        return tuple(image for image in self.images if image.outlier)

    @property
    def last_outliers(self) -> int:
        """How many images at its end are outliers, one after another."""
        return len(list(takewhile(lambda image: image.outlier, reversed(self.images))))

    @property
    def span_years(self) -> float:
        """Time from the first to the last image."""
        first, last = (date.fromisoformat(self.images[each].date) for each in (0, -1))
        return (last - first).days * 86400 / YEAR_S


@dataclass(frozen=True, slots=True)
class SeriesOffset:
    """How two series lie to each other, each at its last date."""

    first: str
    second: str
    dates: tuple[str, str]
    """These dates."""
    offset_px: tuple[float, float]
    """Second minus first (col, row), px of the first."""
    sigma_px: float
    """Standard deviation along an axis."""


@dataclass(frozen=True, slots=True)
class MovingRegion:
    """A part of the ground that moves by itself."""

    number: int
    """In motion.tif; 1 is the largest."""
    x: float
    """Its middle, CRS of the frame; px without one."""
    y: float
    share: float
    """Of the cells that could be tested."""
    velocity_px: tuple[float, float]
    """(col, row) of the cells that it fills, px of the frame a year."""
    sigma_px: float
    """Mean standard deviation of its cells along an axis."""


@dataclass(frozen=True, slots=True)
class GroundMotion:
    """Motion of the ground that is none of the images."""

    cell_px: float
    """Side of a cell, px of the frame."""
    tested: int
    """Number of cells with enough images."""
    sigma_px: float
    """Median standard deviation of their velocities along an axis, px of the frame a year."""
    regions: tuple[MovingRegion, ...]
    """The largest first."""
    px_m: float | None
    """Side of a pixel of the frame, metres; null without a CRS."""


@dataclass(frozen=True, slots=True)
class CorrectedImages:
    """A STAC collection of the original images, each with the georeferencing that its correction gives."""

    items: int
    """How many images it has."""
    on_grid: int
    """Of these, how many the stack itself has written on the grid of its frame."""
    written: tuple[str, ...]
    """Names of those that were written on that grid beside the collection, as asked for."""


@dataclass(frozen=True, slots=True)
class WatchNumbers:
    """The content of watch.json."""

    schema_version: int
    stack: str
    """Folder of the stack."""
    datum: str
    """Name of the image that stays in it, or `mean`."""
    series: tuple[ImageSeries, ...]
    offsets: tuple[SeriesOffset, ...]
    """Of each series to the first, where the sizes of their pixels relate them."""
    motion: GroundMotion | None
    """Motion of the ground; null where too few dates tell, or the images cannot be read any more."""
    corrected: CorrectedImages | None
    """The collection; null where the images cannot be read any more, or have RPCs or no CRS."""
    undated: tuple[str, ...]
    """Names of images without a date."""
    refused: tuple[str, ...]
    """Names of images that the stack has refused."""
    requirements: tuple[StackRequirement, ...]
    passed: bool | None
    """Whether all requirements are met; null without requirements."""
    warnings: tuple[str, ...]
    outputs: tuple[str, ...] = ()
    """Names of the files that belong to the result, which a later run may replace."""
    versions: Mapping[str, str] = field(default_factory=versions)
    """Of this program and of what it stands on."""


@products_found_once()
def watch(
    stack: PathLike,
    *,
    out_dir: PathLike | None = None,
    require: Sequence[str] = (),
    apply: bool = False,
    overwrite: bool = False,
    allow_remote: bool = False,
    trust_vrt: bool = False,
    on_event: EventCallback = ignore,
) -> WatchNumbers:
    """Tell what the images of a finished stack, and the ground below them, do over time.

    Parameters
    ----------
    stack : path
        Output folder of `stack`, which gave its images dates.
    out_dir : path, optional
        Output folder; ``<name of the stack>_watch`` in the working folder by default.
    require : sequence of str
        Requirements such as ``step<0.2px``; see `pcwlad_geo.requirements`.
    apply : bool
        Write the images on the grid of the stack that the stack itself has not written, as COG.
    overwrite : bool
        Replace an earlier result in `out_dir`.
    allow_remote, trust_vrt : bool
        What the images may make GDAL open, as in `Settings`.
    on_event : callable
        Receives `Progress` and `Warned` events.

    Returns
    -------
    WatchNumbers

    Raises
    ------
    InputError
        If the folder holds no stack, or fewer than two of its images have dates.
    OutputError
        If the results cannot be written, or would replace other files.
    """
    wanted = parse_requirements(require, "watch")
    folder, place = Path(stack), watch_folder(stack, out_dir)
    if place.resolve() == folder.resolve():
        raise InputError(f"{place} is the folder of the stack itself: give another output folder")
    numbers = _checked(numbers_of(folder), folder / STACK_NUMBERS)
    warnings: list[str] = []

    def warn(message: str) -> None:
        warnings.append(message)
        on_event(Warned(message))

    dated, undated, refused = _dated(numbers, folder / STACK_NUMBERS)
    covariance = _covariance(numbers)
    series = tuple(_series(name, images, covariance) for name, images in _grouped(dated).items())
    offsets = _offsets(series)
    out_folder = OutputFolder(
        place, overwrite=overwrite, results=NAMES["numbers"], inputs=[folder / STACK_NUMBERS]
    )
    with out_folder as out, trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        infos = _described(numbers)
        motion, raster = None, None
        with _warning_of(warn, "the motion of the ground is not known"):
            motion, raster = _moving_ground(numbers, folder, dated, infos, on_event)
        corrected = None
        with nullcontext() if apply else _warning_of(warn, "there is no collection of the corrected images"):
            corrected = _write_corrected(out, numbers, folder, infos, series, apply, on_event)
        results = _judged(series, offsets, motion, wanted)
        for left, why in ((undated, "have no date"), (refused, "were refused by the stack")):
            if left:
                warn(f"in no series, as they {why}: {', '.join(left)}")
        names = {name for kind, name in NAMES.items() if kind != "motion" or raster}
        watched = WatchNumbers(
            schema_version=1,
            stack=str(folder),
            datum=str(numbers["datum"]),
            series=series,
            offsets=offsets,
            motion=motion,
            corrected=corrected,
            undated=undated,
            refused=refused,
            requirements=tuple(map(StackRequirement.of, results)),
            passed=all(each.met for each in results) if results else None,
            warnings=tuple(warnings),
            outputs=tuple(sorted({*names, *(path.name for path in out.stage.iterdir())})),
        )
        _write(out, watched, raster)
    return watched


@contextmanager
def _warning_of(warn: Callable[[str], None], what: str) -> Iterator[None]:
    """Make a warning of an `InputError`."""
    try:
        yield
    except InputError as error:
        warn(f"{what}: {error}")


def watch_folder(stack: PathLike, out_dir: PathLike | None) -> Path:
    """Return the output folder: `out_dir`, or by default one named after the `stack`."""
    return Path(out_dir) if out_dir else Path(f"{Path(stack).resolve().name}_watch")


@dataclass(frozen=True, slots=True)
class DatedImage:
    """An image of a stack with its time, and what stack.json says of it."""

    number: int
    """In stack.json, counted from 0."""
    given: StackInput
    year: float
    """Time since 1970."""
    shift_px: tuple[float, float]
    sigma_px: float
    pixel_size_m: float | None


def _checked(numbers: Mapping[str, Any], place: Path) -> Mapping[str, Any]:
    """Return the content of stack.json; raises `InputError` if its pairs or names are none."""
    try:
        names = [numbers["reference"], *(entry["name"] for entry in numbers["images"])]
        for pair in numbers["pairs"]:
            names += [pair["reference"], pair["target"]]
            figures = [float(pair.get(name) or 0.0) for name in ("sigma_px", "redundancy")]
            if not all(0 <= figure <= COORDINATE for figure in figures):
                raise ValueError("the figures of a pair are none")
            if pair["status"] not in ("used", "left out", "refused"):
                raise ValueError("a pair is neither used nor left out nor refused")
        if not all(isinstance(name, str) for name in names):
            raise TypeError("a name is no text")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{place} is damaged ({error}): stack the images again") from error
    return numbers


def _dated(
    numbers: Mapping[str, Any], place: Path
) -> tuple[list[DatedImage], tuple[str, ...], tuple[str, ...]]:
    """Return the images with dates, in their order, and the names of those without and of those refused."""
    found, undated, refused = [], [], []
    try:
        for number, entry in enumerate(numbers["images"]):
            given = StackInput.from_dict(entry["given"])
            if given.name != plain_name(given.name):
                raise ValueError(f"{given.name!r} is no name of an image")
            shift, sigma = (np.array(entry[name], np.float64) for name in ("shift_px", "sigma_px"))
            size = np.array(entry["pixel_size_m"] or (1.0, 1.0), np.float64)
            sizes = np.array([shift, sigma, size])
            if sizes.shape != (3, 2) or not (np.abs(sizes) <= COORDINATE).all():
                raise ValueError(f"the figures of {given.name} are no pairs of numbers")
            if sigma.min() < 0 or size.min() < 1 / COORDINATE:
                raise ValueError(f"a sigma or a pixel of {given.name} is below zero")
            if (entry["registered"] or given.name) != plain_name(entry["registered"] or given.name):
                raise ValueError(f"{entry['registered']!r} is no name of a file")
            if entry["registered"] is None:
                refused.append(given.name)
            elif given.day is None or not FIRST_YEAR <= given.day.year <= LAST_YEAR:
                undated.append(given.name)
            else:
                size_m = float(np.sqrt(size.prod())) if entry["pixel_size_m"] else None
                sigma_px = float(np.hypot(*sigma) / 2**0.5)
                found.append(DatedImage(number, given, _year(given), float_pair(shift), sigma_px, size_m))
    except (KeyError, TypeError, ValueError, LookupError, AttributeError) as error:
        raise InputError(f"{place} is damaged ({error}): stack the images again") from error
    if len(found) < 2:
        raise InputError(
            f"{place}: a series needs two images with dates, and there are {len(found)}: stack them by a "
            "table with a column date"
        )
    found.sort(key=lambda image: (image.year, image.number))
    return found, tuple(undated), tuple(refused)


def _covariance(numbers: Mapping[str, Any]) -> Float64 | None:
    """Return the (n, n) covariance of the places of all images that their pairs tell; None without sigmas.

    The unit is that of the sigmas of the pairs: what matters is how the errors hang together.
    """
    names = {entry["name"]: number for number, entry in enumerate(numbers["images"])}
    normal = np.zeros((len(names), len(names)))
    for pair in numbers["pairs"]:
        first, second = names.get(pair["reference"]), names.get(pair["target"])
        sigma, redundancy = pair.get("sigma_px"), pair.get("redundancy")
        if pair["status"] != "used" or first is None or second is None or not sigma or redundancy is None:
            continue
        # what `robust.reliability` makes sigma of
        own = max(float(sigma), 1 / COORDINATE) ** 2 / max(float(redundancy), LEAST_CHECKED)
        design = np.zeros(len(names))
        design[[first, second]] = -1.0, 1.0
        normal += np.outer(design, design) / own
    if not np.isfinite(normal).all() or not normal.any():
        return None
    return pseudo_inverse(normal, RANK, hermitian=True)


def _year(given: StackInput) -> float:
    """Return the time of an image with a date, years since 1970; without a time of day it is midnight UTC."""
    try:
        return seconds_of(str(given.date).replace("Z", "+00:00")) / YEAR_S
    except ValueError:  # with a time in another form
        return seconds_of(str(given.day)) / YEAR_S


def _grouped(images: Sequence[DatedImage]) -> dict[str, list[DatedImage]]:
    """Return the images by their series: what took them, the band and the size of a pixel if these differ."""
    sensors = [image.given.series or _satellite(image.given) for image in images]
    bands = [image.given.shown_band for image in images]
    sizes = [f"{image.pixel_size_m:.2g} m" if image.pixel_size_m else "" for image in images]
    kinds = list(zip(sensors, bands, sizes, strict=True))
    found: dict[str, list[DatedImage]] = {}
    for image, (sensor, band, size) in zip(images, kinds, strict=True):
        alike = [kind for kind in kinds if kind[0] == sensor]
        parts = [sensor]
        parts += [band] if len({kind[1] for kind in alike}) > 1 else []
        parts += [size] if len({kind[2] for kind in alike}) > 1 else []
        found.setdefault(" ".join(filter(None, parts)) or "all images", []).append(image)
    return dict(sorted(found.items()))


def _satellite(given: StackInput) -> str:
    """Return the satellite that the name or the path of an image tells; nothing where they do not."""
    parts = (given.name, *reversed(Path(given.path).parts))
    return next((found[1] for found in map(SATELLITE.search, parts) if found), "")


def _series(name: str, images: Sequence[DatedImage], covariance: Float64 | None) -> ImageSeries:
    years = np.array([image.year for image in images])
    sigma_px = np.array([image.sigma_px for image in images])
    if covariance is not None:
        numbers = [image.number for image in images]
        covariance = _scaled(covariance[np.ix_(numbers, numbers)], sigma_px)
    model = analyse(years, np.array([image.shift_px for image in images]), sigma_px, covariance)
    sizes_m = [image.pixel_size_m for image in images if image.pixel_size_m]
    terms = {kind: [each for each in model.found if each.term.kind == kind] for kind in ("drift", "season")}
    return ImageSeries(
        name=name,
        images=tuple(_watched(image, model, number) for number, image in enumerate(images)),
        pixel_size_m=float(np.median(sizes_m)) if sizes_m else None,
        noise_px=model.noise_px,
        level_px=float_pair(model.level_px),
        level_sigma_px=model.level_sigma_px,
        steps=tuple(
            SeriesStep(
                before=images[each.term.at - 1].given.name,
                image=images[each.term.at].given.name,
                date=str(images[each.term.at].given.day),
                size_px=float_pair(each.size_px[0]),
                sigma_px=each.sigma_px,
            )
            for each in model.found
            if each.term.kind == "step"
        ),
        drift=next(
            (SeriesDrift(float_pair(each.size_px[0]), each.sigma_px) for each in terms["drift"]), None
        ),
        season=next((_season(each.size_px, each.sigma_px) for each in terms["season"]), None),
    )


def _scaled(covariance: Float64, sigma_px: Float64) -> Float64 | None:
    """Return the (n, n) covariance in px of the images, whose sigmas are told but for that of the datum."""
    own = np.diag(covariance)
    known = (sigma_px > 0) & (own > 0)
    return covariance * float(np.median(sigma_px[known] ** 2 / own[known])) if known.any() else None


def _watched(image: DatedImage, model: SeriesModel, number: int) -> WatchedImage:
    return WatchedImage(
        name=image.given.name,
        date=str(image.given.day),
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


def _offsets(series: Sequence[ImageSeries]) -> tuple[SeriesOffset, ...]:
    """Return how each series lies to the first, where the sizes of their pixels relate them."""
    first, found = series[0], []
    for other in series[1:]:
        if (first.pixel_size_m is None) != (other.pixel_size_m is None):
            continue
        ratio = (other.pixel_size_m or 1.0) / (first.pixel_size_m or 1.0)
        offset = np.multiply(ratio, other.level_px) - first.level_px
        sigma = float(np.hypot(ratio * other.level_sigma_px, first.level_sigma_px))
        dates = first.images[-1].date, other.images[-1].date
        found.append(SeriesOffset(first.name, other.name, dates, float_pair(offset), sigma))
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class _CellSeries:
    """What some cells do from date to date."""

    cells: Index
    """(n,) their numbers, along rows first."""
    days: tuple[str, ...]
    """Of the images, ISO 8601."""
    moved_px: Float64
    """(n, images, 2) about the mean of their dates, px of the frame; NaN where unknown."""
    sigma_px: Float64
    """(n, images) standard deviation along an axis."""

    def packed(self) -> dict[str, object]:
        """Return it for the script of the page: 16 bits a number, in steps of `unit_px`."""
        largest = np.nanmax(np.abs([np.nanmax(np.abs(self.moved_px)), np.nanmax(self.sigma_px)]))
        unit_px = max(float(largest), 1e-3) / PACKED_LARGEST
        values = np.concatenate([self.moved_px, self.sigma_px[..., None]], axis=2) / unit_px
        whole = np.where(np.isfinite(values), np.round(values), -PACKED_LARGEST - 1).astype("<i2")
        text = base64.b64encode(whole.tobytes()).decode("ascii")
        return {"cells": self.cells.tolist(), "days": self.days, "unit_px": unit_px, "values": text}


@dataclass(frozen=True, slots=True, eq=False)
class _MotionRaster:
    """Cells of the frame, and what they do a year."""

    frame: StackFrame
    cell_px: float
    velocity_px: Float64
    """(rows, cols, 2)."""
    sigma_px: Float64
    """(rows, cols)."""
    moving: Index
    """(rows, cols) number of the region that a cell is in, from 1; 0: it stands still."""
    series: _CellSeries | None


Described = RasterInfo | InputError
"""An image, or why it cannot be read."""


def _described(numbers: Mapping[str, Any]) -> list[Described]:
    """Describe all images of a stack."""
    found: list[Described] = []
    for entry in numbers["images"]:
        try:
            found.append(StackInput.from_dict(entry["given"]).describe())
        except InputError as error:
            found.append(error)
    return found


def _frame(numbers: Mapping[str, Any], infos: Sequence[Described]) -> StackFrame:
    """Return the frame of a stack; raises `InputError` if an image cannot be read, or it has RPCs."""
    if numbers.get("block") is not None:
        raise InputError("the images have RPCs, and what relief leaves of them is no motion")
    inputs = [StackInput.from_dict(entry["given"]) for entry in numbers["images"]]
    if numbers["reference"] not in [each.name for each in inputs]:
        raise InputError(f"{STACK_NUMBERS} is damaged (no image is its reference): stack again")
    readable = []
    for info in infos:
        if isinstance(info, InputError):
            raise info
        readable.append(info)
    return frame_of(inputs, readable, str(numbers["reference"]), "auto")


def _moving_ground(
    numbers: Mapping[str, Any],
    folder: Path,
    dated: Sequence[DatedImage],
    infos: Sequence[Described],
    on_event: EventCallback,
) -> tuple[GroundMotion, _MotionRaster]:
    """Return what the tie points of all pairs tell beside the corrections of their images.

    Raises `InputError` if too few dates tell, an image or a pair cannot be read, or the images have RPCs.
    """
    span = dated[-1].year - dated[0].year
    if len(dated) < MIN_MOVING_IMAGES or span < 0.1:  # years
        raise InputError(
            f"{len(dated)} dates in {span:.2f} years are too few: {MIN_MOVING_IMAGES} are needed"
        )
    frame = _frame(numbers, infos)
    corrections = [from_dict(entry["model"]) for entry in numbers["images"]]
    years = {image.given.name: (image.number, image.year) for image in dated}
    rows, cols = frame.grid.shape
    cell_px = max(16.0, max(rows, cols) / 48)
    shape = int(np.ceil(rows / cell_px)), int(np.ceil(cols / cell_px))
    parts = []
    pairs = [pair for pair in numbers["pairs"] if pair["status"] == "used"]
    for done, pair in enumerate(pairs):
        on_event(Progress("reading", done, len(pairs)))
        ends = years.get(pair["reference"]), years.get(pair["target"])
        if ends[0] is not None and ends[1] is not None and ends[0][1] != ends[1][1]:
            place = folder / PAIRS / f"{pair['reference']}__{pair['target']}" / "tiepoints.csv"
            parts.append(_motions_of(place, frame, corrections, (ends[0], ends[1]), cell_px, shape))
    on_event(Progress("reading", len(pairs), len(pairs)))
    if not parts:
        raise InputError("no pair of images of two dates has been used")
    every = Motions(*(np.concatenate([getattr(part, name) for part in parts]) for name in Motions.__slots__))
    found = velocities(every, shape[0] * shape[1], len(infos))
    moving = found.moving.reshape(shape)
    labels, count = ndimage.label(moving, np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    renumbered = np.zeros(count + 1, int)
    renumbered[1 + np.argsort(-sizes, kind="stable")] = np.arange(1, count + 1)
    regions = renumbered[labels]
    velocity_px, sigma_px = found.velocity_px.reshape(*shape, 2), found.sigma_px.reshape(shape)
    series = _cell_series(every, _shown(np.isfinite(sigma_px), regions, len(dated)), frame, dated)
    raster = _MotionRaster(frame, cell_px, velocity_px, sigma_px, regions, series)
    return _ground_motion(raster, count), raster


def _shown(known: Bool, regions: Index, dates: int) -> Index:
    """Return the numbers of the cells whose series the page holds.

    Those that move come first, and of the others so many along each axis that all fit.
    """
    most = max(1, MAX_PACKED // dates)
    found = np.flatnonzero(known)
    for spacing in range(1, max(known.shape) + 1):
        lattice = np.zeros(known.shape, bool)
        lattice[spacing // 2 :: spacing, spacing // 2 :: spacing] = True
        for chosen in (lattice | (regions > 0), lattice):
            found = np.flatnonzero(known & chosen)
            if len(found) <= most:
                return found
    return found[:most]


def _cell_series(
    motions: Motions, cells: Index, frame: StackFrame, dated: Sequence[DatedImage]
) -> _CellSeries | None:
    """Return what cells do from date to date; None without cells."""
    if not len(cells):
        return None
    place = np.full(len(frame.names), -1)
    place[[image.number for image in dated]] = np.arange(len(dated))
    own_px = np.array([frame.pixel(image.number) * image.sigma_px for image in dated])
    order = np.argsort(motions.cell, kind="stable")
    bounds = np.searchsorted(motions.cell[order], np.stack([cells, cells + 1]))
    moved, sigmas = [], []
    for first, last in bounds.T:
        part = order[first:last]
        each = Motions(*(getattr(motions, name)[part] for name in Motions.__slots__))
        found, sigma_px = displacements(replace(each, ends=place[each.ends]), len(dated))
        moved.append(found)
        sigmas.append(np.hypot(sigma_px, own_px))
    days = tuple(str(image.given.day) for image in dated)
    return _CellSeries(cells, days, np.array(moved), np.array(sigmas))


def _motions_of(
    place: Path,
    frame: StackFrame,
    corrections: Sequence[Correction],
    ends: tuple[tuple[int, float], tuple[int, float]],
    cell_px: float,
    shape: tuple[int, int],
) -> Motions:
    """Return the tie points of a pair, px of the frame, less what the corrections of both images say."""
    (first, before), (second, after) = ends
    points = read_point_file(place)
    sigma_px = np.full((len(points.enabled), 2), np.nan) if points.sigma_px is None else points.sigma_px
    good = points.enabled & (sigma_px > 0).all(axis=1)
    at = frame.from_image(first, corrections[first].inverse(points.reference[good]))
    moved = frame.from_image(second, corrections[second].inverse(points.target[good])) - at
    scale = np.abs(np.linalg.det(frame.scale(second, points.target[good]))) ** 0.5
    sigma = np.sqrt((sigma_px[good] ** 2).mean(axis=1)) * scale
    col, row = np.floor(at / cell_px).astype(np.intp).T
    inside = (col >= 0) & (row >= 0) & (col < shape[1]) & (row < shape[0]) & np.isfinite(moved).all(axis=1)
    count = int(inside.sum())
    return Motions(
        (row * shape[1] + col)[inside],
        np.tile(np.array([first, second]), (count, 1)),
        np.full(count, after - before),
        moved[inside],
        sigma[inside],
    )


def _ground_motion(raster: _MotionRaster, count: int) -> GroundMotion:
    known = np.isfinite(raster.sigma_px)
    tested = int(known.sum())
    regions = []
    for number in range(1, count + 1):
        inside = raster.moving == number
        row, col = (float(np.mean(each)) + 0.5 for each in np.nonzero(inside))
        middle = np.array([[col, row]]) * raster.cell_px
        x, y = (raster.frame.grid.to_xy(middle) if raster.frame.placed else middle)[0].tolist()
        velocity = float_pair(region_velocity(raster.velocity_px[inside]))
        sigma = float(raster.sigma_px[inside].mean())
        regions.append(MovingRegion(number, x, y, float(inside.sum()) / tested, velocity, sigma))
    sizes_m = middle_pixel_size_m(raster.frame.grid)
    return GroundMotion(
        cell_px=raster.cell_px,
        tested=tested,
        sigma_px=float(np.median(raster.sigma_px[known])) if tested else 0.0,
        regions=tuple(regions),
        px_m=None if sizes_m is None else float(np.sqrt(np.prod(sizes_m))),
    )


def region_velocity(velocity_px: Float64) -> Float64:
    """Return the (2,) velocity of a region from the (n, 2) `velocity_px` of its cells.

    Cells at its border move in part: of many dates these are found, too. The median counts of those that move
    more than half as fast, along the mean direction, as the fastest tenth.
    """
    along = velocity_px @ velocity_px.mean(axis=0)
    whole = along > np.percentile(along, 90) / 2
    return np.median(velocity_px[whole if whole.any() else slice(None)], axis=0)


def _write_corrected(
    out: OutputFolder,
    numbers: Mapping[str, Any],
    stack: Path,
    infos: Sequence[Described],
    series: Sequence[ImageSeries],
    apply: bool,
    on_event: EventCallback,
) -> CorrectedImages:
    """Write a STAC collection of the original images, and the images on the grid where that is asked for.

    Raises `InputError` where the images have RPCs or no CRS, or one cannot be read.
    """
    frame = _frame(numbers, infos)
    if not frame.placed:
        raise InputError("the images have no CRS")
    known = {image.name: (each.name, image) for each in series for image in each.images}
    items, missing, there = [], [], 0
    for number, entry in enumerate(numbers["images"]):
        if entry["registered"] is None:
            continue
        there += (stack / entry["registered"]).is_file()
        if apply and not (stack / entry["registered"]).is_file():
            missing.append(number)
            place = out.path(APPLIED.format(frame.names[number]))
            on_event(Progress("images", number, len(frame.names)))
            # on the grid of the corrected images of the stack; where there are none, of its frame
            like = stack / (numbers["images"][frame.reference]["registered"] or "")
            settings = Settings(like=like) if like.is_file() else Settings()
            tell = partial(only_warnings, on_event)
            warp_onto(frame, number, from_dict(entry["model"]), place, settings, tell)
        items.append(_corrected_item(out, frame, number, entry, stack, known.get(frame.names[number])))
    for name, text in stac_texts(items, "watch", CORRECTED).items() if items else ():
        out.path(name).write_text(text, encoding="utf-8", newline="")
    return CorrectedImages(len(items), there, tuple(frame.names[number] for number in missing))


def _corrected_item(
    out: OutputFolder,
    frame: StackFrame,
    number: int,
    entry: Mapping[str, Any],
    stack: Path,
    known: tuple[str, WatchedImage] | None,
) -> dict[str, Any]:
    """Return the item of an image; `known` are its series and what that says of it."""
    given, info, name = frame.given(number), frame.infos[number], frame.names[number]
    grid, error_px = _corrected_grid(info.grid, from_dict(entry["model"]))
    figures = {each: entry.get(each) for each in ("shift_px", "sigma_px")}
    figures |= {"quality": (entry.get("quality") or {}).get("grade"), "transform_error_px": error_px}
    figures |= {} if known is None else {"series": known[0], "outlier": known[1].outlier}
    figures |= {} if known is None else {"expected_px": known[1].expected_px}

    def referred_to(file: str | Path) -> str:
        return referred(os.fspath(file), out.final_path(COLLECTION))[0].removeprefix("/vsicurl/")

    kind = "JP2OPENJPEG" if info.uri.casefold().endswith(".jp2") else "GTiff"
    assets = {"original": Asset(referred_to(info.uri), kind, grid)}
    if (stack / VRT.format(name)).is_file():
        assets["corrected"] = Asset(referred_to(stack / VRT.format(name)), "VRT", grid)
    applied = out.stage / APPLIED.format(name)
    if applied.is_file() or (stack / entry["registered"]).is_file():
        file = applied if applied.is_file() else stack / entry["registered"]
        href = f"./{applied.name}" if applied.is_file() else referred_to(file)
        assets["registered"] = Asset(href, "COG", describe(file).grid, outlined=False)
    links = [{"rel": "describedby", "type": "text/html", "href": referred_to(stack / PAGE)}]
    links += [{"rel": "describedby", "type": "application/json", "href": referred_to(stack / STACK_NUMBERS)}]
    if given.item is not None:
        links.append({"rel": "derived_from", "type": "application/geo+json", "href": referred_to(given.item)})
    properties = {f"pcwlad_geo:{each}": value for each, value in figures.items()}
    return stac_item(name, given.date, assets, collection="watch", properties=properties, links=links)


def _corrected_grid(grid: Grid, correction: Correction) -> tuple[Grid, float]:
    """Return a grid with its corrected geotransform, and by how much, px, that lies off the correction."""
    if isinstance(correction, AffineCorrection):
        return replace(grid, transform=corrected_transform(grid, correction)), 0.0
    observed_px = grid.lattice_px(NODES)
    predicted_px = correction.inverse(observed_px)
    nearest = AffineCorrection("affine", affine_between(predicted_px, observed_px))
    off_px = np.hypot(*(nearest.forward(predicted_px) - observed_px).T)
    return replace(grid, transform=corrected_transform(grid, nearest)), float(off_px.max())


def _judged(
    series: Sequence[ImageSeries],
    offsets: Sequence[SeriesOffset],
    motion: GroundMotion | None,
    requirements: Sequence[Requirement],
) -> tuple[RequirementResult, ...]:
    """Evaluate requirements on the largest of any series or region; what was not sought is not known."""
    found: dict[str, list[tuple[tuple[float, float], float | None]]] = {
        "step": [(step.size_px, each.pixel_size_m) for each in series for step in each.steps],
        "drift": [(each.drift.px_per_year, each.pixel_size_m) for each in series if each.drift],
        "season": [(each.season.amplitude_px, each.pixel_size_m) for each in series if each.season],
        "latest": [(_off(each.images[-1]), each.pixel_size_m) for each in series],
        "offset": [(each.offset_px, series[0].pixel_size_m) for each in offsets],
        "motion": [(each.velocity_px, motion.px_m) for each in motion.regions] if motion else [],
    }
    results = []
    for each in requirements:
        lengths, reason = [], _not_sought(each.statistic, series, offsets, motion)
        for size_px, px_m in found[each.statistic]:
            scale = 1.0 if each.unit == "px" else px_m
            if scale is None:
                reason = "not known: the images have no size of a pixel in metres"
            else:
                lengths.append(scale * float(np.hypot(*size_px)))
        results.append(RequirementResult(each, None if reason else max(lengths, default=0.0), reason))
    return tuple(results)


def _off(image: WatchedImage) -> tuple[float, float]:
    """Return how far an image lies off what its series lets expect (col, row), px."""
    return float_pair(np.subtract(image.shift_px, image.expected_px))


def _not_sought(
    statistic: str,
    series: Sequence[ImageSeries],
    offsets: Sequence[SeriesOffset],
    motion: GroundMotion | None,
) -> str | None:
    """Return why a figure is not known; None where it is."""
    shortest, span = min(len(each.images) for each in series), min(each.span_years for each in series)
    if statistic in ("step", "drift", "latest") and shortest < MIN_IMAGES:
        return f"not known: a series has {shortest} images, and {MIN_IMAGES} are needed"
    if statistic == "season" and (shortest < MIN_SEASON_IMAGES or span < MIN_SEASON_YEARS):
        return f"not known: {MIN_SEASON_IMAGES} images in {MIN_SEASON_YEARS} years are needed of each series"
    if statistic == "offset" and len(offsets) < max(1, len(series) - 1):
        return "not known: there is one series, or no size of a pixel relates them"
    if statistic == "motion" and motion is None:
        return "not known: too few dates, or images that cannot be read"
    return None


def _write(out: OutputFolder, found: WatchNumbers, raster: _MotionRaster | None) -> None:
    text = json.dumps(asdict(found), indent=1, allow_nan=False) + "\n"
    texts = {"table": csv_of(list(_rows(found))), "report": _page(found, raster), "numbers": text}
    with out.writing():
        if raster is not None:
            _write_motion(raster, out.path(NAMES["motion"]))
        for kind, content in texts.items():
            out.path(NAMES[kind]).write_text(content, encoding="utf-8", newline="")
    out.commit()


def findings(found: WatchNumbers) -> Iterator[str]:
    """Yield a sentence for each thing that was found, outliers last."""
    for series in found.series:
        px_m = series.pixel_size_m
        for step in series.steps:
            size = _size(step.size_px, step.sigma_px, px_m)
            yield f"{series.name}: step of {size} at {step.date} ({step.image})"
        if drift := series.drift:
            yield f"{series.name}: drift of {_size(drift.px_per_year, drift.sigma_px, px_m)} a year"
        if season := series.season:
            yield f"{series.name}: yearly wave of {_size(season.amplitude_px, season.sigma_px, px_m)}"
    for region in found.motion.regions if found.motion else ():
        size = _size(region.velocity_px, region.sigma_px, found.motion.px_m if found.motion else None)
        where = f"x {region.x:.7g}, y {region.y:.7g}, {100 * region.share:.1f} % of what was tested"
        yield f"ground at {where}: moves by {size} a year"
    for offset in found.offsets:
        size = _size(offset.offset_px, offset.sigma_px, found.series[0].pixel_size_m)
        when = " and ".join(dict.fromkeys(offset.dates))
        yield f"{offset.second} lies {size} off {offset.first}, at their last dates ({when})"
    for series in found.series:
        if count := series.last_outliers:
            names = ", ".join(image.name for image in series.images[-count:])
            yield f"{series.name}: at its end off what is expected, where a step may begin: {names}"
    for series in found.series:
        if series.outliers:
            names = ", ".join(f"{image.name} ({image.date})" for image in series.outliers)
            yield f"{series.name}: outliers: {names}"


def _size(size_px: tuple[float, float], sigma_px: float, px_m: float | None) -> str:
    metres = "" if px_m is None else f" ({px_m * float(np.hypot(*size_px)):.2f} m)"
    return f"({size_px[0]:+.3f}, {size_px[1]:+.3f}) ± {sigma_px:.3f} px{metres}"


def _page(found: WatchNumbers, raster: _MotionRaster | None) -> str:
    """Return the page, which holds everything that it shows."""
    from pcwlad_geo.report import figures  # slow to load: matplotlib

    lines = []
    days = np.array([image.date for series in found.series for image in series.images], "datetime64[D]")
    for series in found.series:
        images = series.images
        line = figures.TimeLine(
            np.array([image.date for image in images], "datetime64[D]"),
            np.array([image.shift_px for image in images]),
            np.array([image.sigma_px for image in images]),
            np.array([image.expected_px for image in images]),
            np.array([image.outlier for image in images]),
            [[image.name for image in images].index(step.image) for step in series.steps],
            (days.min(), days.max()),
        )
        lines.append((series, figures.time_line_figure(line)))
    motion, data = None, None
    if raster is not None:
        shape = raster.frame.grid.shape
        motion, box = figures.motion_figure(raster.velocity_px, raster.moving, raster.cell_px, shape)
        data = _page_data(raster, box)
    events = len(found.motion.regions) if found.motion else 0
    for series in found.series:
        events += len(series.steps) + bool(series.drift) + bool(series.season) + bool(series.last_outliers)
    few = all(len(series.images) < MIN_IMAGES for series in found.series)
    state = "bad" if found.passed is False else "caution" if events or few else "good"
    environment = page_environment("pcwlad_geo.multi")
    return environment.get_template("watch.html.j2").render(
        **page_script(environment, "watch.js"),
        found=found,
        lines=lines,
        motion=motion,
        data=data,
        findings=list(findings(found)),
        events=events,
        few=few,
        state=state,
    )


def _page_data(raster: _MotionRaster, box: tuple[float, float, float, float]) -> dict[str, object] | None:
    """Return what the script of the page shows of single cells; None where no cell is known."""
    if raster.series is None:
        return None
    row, col = np.divmod(raster.series.cells, raster.moving.shape[1])
    middles_px = (np.column_stack([col, row]) + 0.5) * raster.cell_px
    at = raster.frame.grid.to_xy(middles_px) if raster.frame.placed else middles_px
    velocity = np.column_stack([raster.velocity_px[row, col], raster.sigma_px[row, col]])
    return {
        **raster.series.packed(),
        "box": box,
        "cols": raster.moving.shape[1],
        "across": [raster.frame.grid.shape[1] / raster.cell_px, raster.frame.grid.shape[0] / raster.cell_px],
        "at": np.round(at, 6 if np.abs(at).max() < 1000 else 1).tolist(),
        "velocity": np.round(velocity, 4).tolist(),
        "region": raster.moving[row, col].tolist(),
    }


def _rows(found: WatchNumbers) -> Iterator[dict[str, object]]:
    for series in found.series:
        for image in series.images:
            figures = [round(each, 6) for each in (*image.shift_px, image.sigma_px, *image.expected_px)]
            row = [image.name, series.name, image.date, *figures, image.outlier]
            yield dict(zip(COLUMNS, row, strict=True))


def _write_motion(raster: _MotionRaster, place: Path) -> None:
    """Write velocity x, y and sigma, units of the CRS a year (px without one), and the numbers of regions."""
    grid, (rows, cols) = raster.frame.grid, raster.sigma_px.shape
    linear, placed = np.eye(2), {}
    if raster.frame.placed:
        a, b, x, d, e, y = grid.transform[:6]
        linear = np.array([[a, b], [d, e]])
        (ca, cb), (cd, ce) = (linear * raster.cell_px).tolist()
        placed = {"crs": grid.crs, "transform": Affine(ca, cb, x, cd, ce, y)}
    velocity = raster.velocity_px @ linear.T
    sigma = raster.sigma_px * float(np.sqrt(abs(np.linalg.det(linear))))
    moving = np.where(np.isfinite(raster.sigma_px), raster.moving, np.nan)
    bands = [velocity[..., 0], velocity[..., 1], sigma, moving]
    names = ("velocity x, a year", "velocity y, a year", "sigma along an axis, a year", "moving region")
    with rasterio.open(
        place, "w", driver="GTiff", count=4, height=rows, width=cols, dtype="float32", nodata=np.nan, **placed
    ) as file:
        for number, (band, name) in enumerate(zip(bands, names, strict=True), 1):
            file.write(np.asarray(band, np.float32), number)
            file.set_band_description(number, name)
