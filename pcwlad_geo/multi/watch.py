"""The geolocation of a time series: what the images of a finished stack do over time, and the ground below.

A stack gives every date a displacement with its sigma. Here the dates of one sensor are a series, in which
steps, drifts, seasons and outliers are sought; what the tie points of all pairs have beside that is motion of
the ground. What all images share, the frame itself, cannot be seen.
"""

from __future__ import annotations

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

from pcwlad_geo.arguments import checked
from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.models import AffineCorrection, Correction, affine_between, from_dict
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import RANK, pseudo_inverse
from pcwlad_geo.estimation.time_series import (
    MIN_IMAGES,
    MIN_SEASON_IMAGES,
    MIN_SEASON_YEARS,
    SeriesModel,
    analyse,
)
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore, only_warnings
from pcwlad_geo.limits import COORDINATE
from pcwlad_geo.multi.finished_stack import RasterInfoOrError, described_again, frame_again
from pcwlad_geo.multi.ground_motion import (
    DatedImage,
    GroundMotion,
    MotionRaster,
    moving_ground,
    page_data,
    write_motion,
)
from pcwlad_geo.multi.image_positions import NODES
from pcwlad_geo.multi.network import MIN_EDGE_SIGMA_REDUNDANCY
from pcwlad_geo.multi.rpc_block import MIN_BLOCK_SIGMA_REDUNDANCY
from pcwlad_geo.multi.stack_catalogue import COLLECTION, Asset, stac_item, stac_texts
from pcwlad_geo.multi.stack_frame import StackFrame
from pcwlad_geo.multi.stack_inputs import StackInput
from pcwlad_geo.multi.stack_numbers import NUMBERS as STACK_NUMBERS
from pcwlad_geo.multi.stack_numbers import PAGE, StackRequirement, numbers_of
from pcwlad_geo.multi.stack_outputs import VRT, warp_onto
from pcwlad_geo.multi.trend import seconds_of
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.finding import products_found_once
from pcwlad_geo.raster.file_tree import plain_name
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.trust.permissions import Trust, trusting
from pcwlad_geo.raster.vrt import corrected_transform, referred
from pcwlad_geo.report import figures
from pcwlad_geo.report.content import versions
from pcwlad_geo.report.page import page_environment, page_script
from pcwlad_geo.requirements import Requirement, RequirementResult, parse_requirements
from pcwlad_geo.text import csv_of
from pcwlad_geo.types import Float64, PathLike

NAMES: Final = {"numbers": "watch.json", "table": "watch.csv", "report": "watch.html", "motion": "motion.tif"}
"""File names of the outputs by kind."""
SATELLITE: Final = re.compile(r"(?<![A-Za-z0-9])(S[1-3][A-D]|L[COTEM]0[4-9])(?![A-Za-z0-9])")
"""The satellite in the name of a product: Sentinel or Landsat."""
YEAR_S: Final = 365.25 * 86400
"""Length of a year, s."""
FIRST_YEAR, LAST_YEAR = 1900, 2200
"""Years in which an image may have been taken."""
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


@checked()
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
    source = folder / STACK_NUMBERS
    numbers = _checked(numbers_of(folder), source)
    warnings: list[str] = []

    def warn(message: str) -> None:
        warnings.append(message)
        on_event(Warned(message))

    dated, undated, refused = _dated(numbers, source)
    covariance = _covariance(numbers)
    series = tuple(_series(name, images, covariance) for name, images in _grouped(dated).items())
    offsets = _offsets(series)
    out_folder = OutputFolder(place, overwrite=overwrite, results=NAMES["numbers"], inputs=[source])
    with out_folder as out, trusting(Trust(remote=allow_remote, vrt=trust_vrt)):
        infos = described_again(numbers)
        motion, raster, corrected = None, None, None
        with _warning_of(warn, "the motion of the ground is not known"):
            motion, raster = moving_ground(numbers, folder, dated, infos, on_event)
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


def _checked(numbers: Mapping[str, Any], place: Path) -> Mapping[str, Any]:
    """Return the content of stack.json; raises `InputError` if the figures of its pairs are not valid."""
    try:
        for pair in numbers["pairs"]:
            figures = [float(pair.get(name) or 0.0) for name in ("sigma_px", "redundancy")]
            if not all(0 <= figure <= COORDINATE for figure in figures):
                raise ValueError("the figures of a pair are not valid numbers")
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
                raise ValueError(f"the figures of {given.name} must be pairs of numbers")
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

    The unit is that of the sigmas of the pairs: only the correlations of the errors matter.
    """
    names = {entry["name"]: number for number, entry in enumerate(numbers["images"])}
    least = MIN_EDGE_SIGMA_REDUNDANCY if numbers.get("block") is None else MIN_BLOCK_SIGMA_REDUNDANCY
    normal = np.zeros((len(names), len(names)))
    for pair in numbers["pairs"]:
        first, second = names.get(pair["reference"]), names.get(pair["target"])
        sigma, redundancy = pair.get("sigma_px"), pair.get("redundancy")
        if pair["status"] != "used" or first is None or second is None or not sigma or redundancy is None:
            continue
        # the variance of the observation itself, of which `robust.reliability` made the sigma
        own = max(float(sigma), 1 / COORDINATE) ** 2 / max(float(redundancy), least)
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
    steps, drifts, seasons = (
        [each for each in model.found if each.term.kind == kind] for kind in ("step", "drift", "season")
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
                before=images[each.term.at - 1].given.name,
                image=images[each.term.at].given.name,
                date=str(images[each.term.at].given.day),
                size_px=float_pair(each.size_px[0]),
                sigma_px=each.sigma_px,
            )
            for each in steps
        ),
        drift=next((SeriesDrift(float_pair(each.size_px[0]), each.sigma_px) for each in drifts), None),
        season=next((_season(each.size_px, each.sigma_px) for each in seasons), None),
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


def _write_corrected(
    out: OutputFolder,
    numbers: Mapping[str, Any],
    stack: Path,
    infos: Sequence[RasterInfoOrError],
    series: Sequence[ImageSeries],
    apply: bool,
    on_event: EventCallback,
) -> CorrectedImages:
    """Write a STAC collection of the original images, and the images on the grid where that is asked for.

    Raises `InputError` where the images have RPCs or no CRS, or one cannot be read.
    """
    frame = frame_again(numbers, infos)
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
    if known is not None:
        series, image = known
        figures |= {"series": series, "outlier": image.outlier, "expected_px": image.expected_px}

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


def _write(out: OutputFolder, found: WatchNumbers, raster: MotionRaster | None) -> None:
    text = json.dumps(asdict(found), indent=1, allow_nan=False) + "\n"
    texts = {"table": csv_of(list(_rows(found))), "report": _page(found, raster), "numbers": text}
    with out.writing():
        if raster is not None:
            write_motion(raster, out.path(NAMES["motion"]))
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
            yield f"{series.name}: the last images deviate from the model: a step may begin there ({names})"
    for series in found.series:
        if series.outliers:
            names = ", ".join(f"{image.name} ({image.date})" for image in series.outliers)
            yield f"{series.name}: outliers: {names}"


def _size(size_px: tuple[float, float], sigma_px: float, px_m: float | None) -> str:
    metres = "" if px_m is None else f" ({px_m * float(np.hypot(*size_px)):.2f} m)"
    return f"({size_px[0]:+.3f}, {size_px[1]:+.3f}) ± {sigma_px:.3f} px{metres}"


def _page(found: WatchNumbers, raster: MotionRaster | None) -> str:
    """Return the page, which holds everything that it shows."""
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
        data = page_data(raster, box)
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


def _rows(found: WatchNumbers) -> Iterator[dict[str, object]]:
    for series in found.series:
        for image in series.images:
            numbers = [round(each, 6) for each in (*image.shift_px, image.sigma_px, *image.expected_px)]
            row = [image.name, series.name, image.date, *numbers, image.outlier]
            yield dict(zip(COLUMNS, row, strict=True))
