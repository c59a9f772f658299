"""The result of a watch, as watch.json holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from itertools import takewhile

from pcwlad_geo.multi.stack.numbers import StackRequirement
from pcwlad_geo.multi.watch.dates import YEAR_S
from pcwlad_geo.multi.watch.ground_motion import GroundMotion
from pcwlad_geo.report.json_content import versions


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
        first, last = (date.fromisoformat(self.images[index].date) for index in (0, -1))
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
