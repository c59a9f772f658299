"""The content of report.json as types, from which docs/make_schemas.py makes its schema too, and its JSON.

Docstrings of fields are the descriptions of the schema, pairs in `Annotated` keywords of it and their values.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pcwlad_geo.correction.error_statistics import Accuracy, Amount, Pair, UnitStatistics
from pcwlad_geo.correction.jitter import Peak, Profile
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.registration.fitting import Grade
from pcwlad_geo.registration.inputs import INLINE, InputFile
from pcwlad_geo.registration.judge import Motion
from pcwlad_geo.registration.prealign import Prealignment
from pcwlad_geo.registration.result import PairGeometry, Status
from pcwlad_geo.report.statistics import DIGITS, REASONS, Group
from pcwlad_geo.requirements import Requirement

Count = Annotated[int, ("minimum", 0)]
Positive = Annotated[int, ("minimum", 1)]
Share = Annotated[float, ("minimum", 0), ("maximum", 1)]
Reason = Annotated[str, ("enum", REASONS)]
Versions = Annotated[Mapping[str, str], ("required", ["pcwlad-geo"])]


@dataclass(frozen=True, slots=True)
class RequirementEntry:
    """A requirement and what was found."""

    text: str
    """As the option takes it."""
    requirement: Requirement = field(metadata=INLINE)
    value: float | str | None
    """The figure, in the unit of the limit; null where it is not known."""
    met: bool
    """A figure that is not known meets nothing."""
    reason: str | None
    """Why the figure is not known."""
    message: str
    """All of it in a line for the reader."""


@dataclass(frozen=True, slots=True)
class GridEntry:
    """Where the pixels of a raster lie."""

    shape: tuple[Positive, Positive]
    """Rows, columns."""
    transform: tuple[float, float, float, float, float, float]
    """Geotransform a, b, c, d, e, f: x = a·col + b·row + c, y = d·col + e·row + f."""
    crs: str | None


@dataclass(frozen=True, slots=True)
class RasterEntry:
    """A band of an input."""

    path: str
    """Path or GDAL URI."""
    band: Count
    """From 1."""
    band_count: Count
    grid: GridEntry = field(metadata=INLINE)
    georeferenced: bool
    dtype: str
    nodata: float | None
    mask: str | None
    mask_kind: str | None


@dataclass(frozen=True, slots=True)
class ReferenceEntry(RasterEntry):
    """The band of the reference."""

    ground: GridEntry | None
    """The grid on the ground that a reference with RPC is seen on; null for any other."""


@dataclass(frozen=True, slots=True)
class AxisSummary:
    """Per axis; std of the population."""

    mean: Pair
    median: Pair
    std: Pair


@dataclass(frozen=True, slots=True)
class RpcEntry:
    """RPCs before and after the correction, and the heights used: enough to correct other rasters."""

    origin: str
    dem: str | None
    dem_vertical: float | str | None
    """What the DEM's heights are above, as given: metres from the ellipsoid, a file of them, or null (its CRS
    told)."""
    undulation_m: float | None
    height_m: float | None
    height_range_m: Pair
    original: RpcModel
    corrected: RpcModel | None
    fold_error_px: float | None


@dataclass(frozen=True, slots=True)
class PredictedSigma:
    """Sigma of the correction over the target."""

    median: Pair
    largest: Pair
    extrapolated_share: Share


@dataclass(frozen=True, slots=True)
class CandidateEntry:
    """How well a model predicts points that it was not fitted to; null where it was not fitted."""

    name: str
    parameters: float | None
    rmse_px: float | None
    rmse_standard_error_px: float | None
    chosen: bool
    note: str


@dataclass(frozen=True, slots=True)
class ModelEntry:
    """The correction in full precision, and the candidates from which it was chosen."""

    name: str
    forward: Annotated[Mapping[str, object], ("required", ["type"])]
    """What maps predicted to observed target px (col, row)."""
    predicted_sigma_px: PredictedSigma | None
    """Over the target; null without a fit."""
    candidates: tuple[CandidateEntry, ...]


@dataclass(frozen=True, slots=True)
class QualityEntry:
    """What the registered raster can be trusted with."""

    grade: Grade
    """good: 90 % of the common ground is expected to lie within 0.5 target px, and nothing speaks against it;
    fair: within 1 px; poor: neither."""
    reasons: tuple[str, ...]
    """Why it is not good, the worst first."""
    expected_ce90_px: Amount
    """Error within which 90 % of the ground that both show is expected to lie, target px."""
    expected_ce90_m: Amount | None
    """The same in metres; null without a CRS."""
    extrapolated_share: Share
    """Share of the ground that both show beyond the tie points."""
    kept_share: Share
    """Share of all matches that their neighbours do not contradict."""


@dataclass(frozen=True, slots=True)
class GroupStatistics:
    """Statistics of n points by unit."""

    n: Positive
    px: UnitStatistics
    native_px: UnitStatistics | None
    """Null where the file names tell no native pixel."""
    m: UnitStatistics | None
    """Null without a CRS."""


@dataclass(frozen=True, slots=True)
class StatisticsEntry:
    """Displacements (before) and residuals (after the correction).

    Metres are target px times the pixel's size on the ground at each point, along columns and rows.
    """

    native_px_m: float | None
    """The coarser pixel that the two sensors recorded, as the file names tell; metres."""
    before: Mapping[Group, GroupStatistics | None]
    """Of all points that were not rejected, of those of the fit, of the check points; null without any."""
    after: Mapping[Group, GroupStatistics | None]

    @property
    def judged(self) -> GroupStatistics | None:
        """Residuals of the check points, or of the fit where there are none."""
        return self.after["check"] or self.after["fit"]


@dataclass(frozen=True, slots=True)
class ProfilesEntry:
    """Displacement along rows and columns of the target, less its cubic trend in both: jitter, stripes."""

    waves: tuple[Peak, ...]
    """The strongest wave along the columns and along the rows, in each component; none of too few points."""
    by_column: Profile
    by_row: Profile
    by_height: Profile | None
    """Against the height of the ground, m; null without an elevation model."""

    @property
    def parts(self) -> tuple[Profile, ...]:
        """The profiles that there are."""
        return tuple(each for each in (self.by_column, self.by_row, self.by_height) if each is not None)


@dataclass(frozen=True, slots=True)
class CoverageEntry:
    """Tie points by square of the reference, row by row from its top-left corner, and why there are none."""

    squares: tuple[Positive, Positive]
    """How many there are down and across."""
    points: tuple[tuple[Count, ...], ...]
    """Tie points that agree with the others, of each square."""
    reason: tuple[tuple[Reason | None, ...], ...]
    """Why a square has no tie point; null where it has. edge: within a matching window of an edge or of
    masked pixels; unread: the file could not be read there; not_asked: no window was laid there; no_texture:
    faint contrast at most in one of the two, or no corner; not_comparable to directions_disagree: the stage
    that lost most of its candidates (as in counts); rejected: its matches contradict their neighbours;
    unknown: the points are those of a file."""
    without_points: Annotated[Mapping[str, Positive], ("propertyNames", {"enum": REASONS})]
    """How many squares have no tie point, by reason; those that occur."""
    empty_share: Share
    """Of the squares where both images have data, the part without a tie point."""


@dataclass(frozen=True, slots=True)
class Report:
    """The content of report.json.

    Further keys may be added. Displacement = where the target shows the ground, less where its georeferencing
    says; residual = what the correction leaves of it. Target px (col, row), positive to the right and down;
    corner-based, (0, 0) is the top-left corner of the first pixel. NaN and unknown values are null.
    """

    schema_version: Literal[1]
    status: Status
    reason: str | None
    """Why the pair was rejected."""
    warnings: tuple[str, ...]
    """For the reader."""
    passed: bool | None
    """Whether all requirements are met; null where nothing was required."""
    requirements: tuple[RequirementEntry, ...]
    """What was required, in the order given."""
    reference: ReferenceEntry
    target: RasterEntry
    inputs: tuple[InputFile, ...]
    """The files that the job read, as they were before it opened any of them; compared before the results are
    put in place. Of a raster, those that belong to it and the sources of a VRT too (the first 200 of an
    input), save statistics beside it (.aux.xml)."""
    px_m: Pair | None
    """Size of a target pixel (col, row) on the ground in the middle of the overlap, metres on the ellipsoid;
    null without a CRS."""
    output_grid: GridEntry | None
    """That the registered raster has, or would have where it was not written because a requirement is not
    met; null for a pair that is refused or only matched."""
    prealignment: Prealignment
    """What the matching started from, matching-grid px."""
    geometry: PairGeometry
    """By what the tie points were told from wrong matches."""
    motions: tuple[Motion, ...]
    """What parts of the matches agree on, if more than one displacement; the one taken comes first."""
    jitter_px: Amount
    """By how much rows and columns move within a window, RMS, target px; 0 where that is not seen."""
    window_px: int | None
    """Side of the window that the tie points were refined with, matching-grid px; null for those of a
    file."""
    tie_points: Annotated[Mapping[str, Count], ("required", ["total", "rejected"])]
    """By status, and in all."""
    counts: Mapping[str, int]
    """Candidates and what became of them, stage by stage, in order."""
    displacement_px: AxisSummary | None
    """Of all tie points that were not rejected."""
    displacement_m: AxisSummary | None
    """Along the axes of the reference CRS, y north."""
    rpc: RpcEntry | None
    """A target with RPCs: where its RPC came from, the heights it was used with, and its coefficients before
    and after; null for other targets."""
    model: ModelEntry | None
    """The correction; null where there is none."""
    accuracy: Mapping[Literal["fit", "check"], Mapping[Literal["px", "m"], Accuracy | None]]
    """Residuals, in short; statistics.after has more. Null without points, in metres without a CRS too."""
    quality: QualityEntry | None
    """What the registered raster can be trusted with. Reasons are warnings, too, or part of the reason of a
    refusal; null where nothing was fitted."""
    statistics: StatisticsEntry
    profiles: ProfilesEntry | None
    """Null where nothing was fitted."""
    coverage: CoverageEntry
    seconds: Mapping[str, float]
    """By stage."""
    settings: Settings
    """By option name."""
    versions: Versions
    outputs: tuple[str, ...]
    """Names of the files in the folder."""


def to_json(content: object) -> str:
    """Return `content` as the text of a JSON file, by `plain`."""
    return json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: object) -> object:
    """Return a value in JSON types: of NaN None, of paths text, of arrays lists, of dataclasses dicts."""
    if hasattr(value, "tolist"):  # of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if not is_dataclass(value):
        return value
    found: dict[str, object] = {}
    for each in fields(value):
        item = plain(getattr(value, each.name))
        found |= item if "inline" in each.metadata and isinstance(item, dict) else {each.name: item}
    return found


T = TypeVar("T")


def rounded(value: T, digits: int = DIGITS) -> T:
    """Return a value with all numbers in it, also nested ones, rounded to `digits` decimal places."""
    found: Any = value
    if isinstance(value, float):
        found = round(value, digits)
    elif isinstance(value, Mapping):
        found = {name: rounded(item, digits) for name, item in value.items()}
    elif isinstance(value, list | tuple):
        found = type(value)(rounded(item, digits) for item in value)
    elif is_dataclass(value) and not isinstance(value, type):
        found = replace(
            value, **{each.name: rounded(getattr(value, each.name), digits) for each in fields(value)}
        )
    return found  # type: ignore[no-any-return]
