"""The content of report.json and proof.json: their types, from which docs/make_schemas.py makes the schemas.

In the schema, docstrings of fields become descriptions, and pairs in `Annotated` keywords and their values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pcwlad_geo.correction.error_statistics import Accuracy, Amount, Count, FloatPair, Share, UnitStatistics
from pcwlad_geo.correction.jitter import Peak, Profile
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Basemap, RpcModel
from pcwlad_geo.raster.bands import BandPart
from pcwlad_geo.registration import (
    Grade,
    InputFile,
    Motion,
    Origin,
    PairGeometry,
    Prealignment,
    RegistrationStatus,
)
from pcwlad_geo.registration.inputs import INLINE
from pcwlad_geo.report.statistics import (
    REASONS,
    PointGroup,
)
from pcwlad_geo.requirements import Requirement

Positive = Annotated[int, ("minimum", 1)]
RejectionReason = Annotated[str, ("enum", REASONS)]
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
    """False where the figure is not known."""
    reason: str | None
    """Why the figure is not known."""
    caveat: str | None
    """Why meeting it says little about the ground, whose grade is not good; else null."""
    message: str
    """The requirement and its result in one line."""


@dataclass(frozen=True, slots=True)
class GridEntry:
    """Shape, geotransform and CRS of a raster."""

    shape: tuple[Positive, Positive]
    """Rows, columns."""
    transform: tuple[float, float, float, float, float, float]
    """Geotransform a, b, c, d, e, f: x = a·col + b·row + c, y = d·col + e·row + f."""
    crs: str | None
    swath: str | None = field(default=None, kw_only=True)
    """The raster whose geolocation arrays place a swath, which no geotransform does; null for any other."""


@dataclass(frozen=True, slots=True)
class RasterEntry:
    """A band of an input."""

    path: str
    """Path or GDAL URI."""
    band: Count
    """From 1; the first of several."""
    matched: str
    """The band or bands that are matched, for people."""
    weights: tuple[BandPart, ...]
    """Several bands, whose sum is matched, with what each is multiplied by; empty for one."""
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
    """The grid onto which a reference with RPC is orthorectified; null for any other."""
    basemap: Basemap | None
    """The web map that the reference is a copy of, to which the accuracy is relative; null for any other."""


@dataclass(frozen=True, slots=True)
class AxisSummary:
    """Per axis; std of the population."""

    mean: FloatPair
    median: FloatPair
    std: FloatPair


@dataclass(frozen=True, slots=True)
class RpcEntry:
    """RPCs before and after the correction, and the heights used: enough to correct other rasters."""

    origin: str
    dem: str | None
    dem_vertical: float | str | None
    """Vertical datum of the DEM, as given: metres above the ellipsoid, a file of them, or null (that of its
    CRS)."""
    undulation_m: float | None
    height_m: float | None
    height_range_m: FloatPair
    original: RpcModel
    corrected: RpcModel | None
    fold_error_px: float | None


@dataclass(frozen=True, slots=True)
class PredictedSigma:
    """Sigma of the correction over the target."""

    median: FloatPair
    largest: FloatPair
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
    """Error within which 90 % of the ground that both show is expected to lie, target px; within the extent
    and the masks where such are given."""
    expected_ce90_m: Amount | None
    """The same in metres; null without a CRS."""
    whole_ce90_px: Amount | None
    """The same of all ground that both show; null where neither an extent nor a mask leaves out a part."""
    whole_ce90_m: Amount | None
    """The same in metres."""
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
    """Null where the file names do not imply a native pixel size."""
    m: UnitStatistics | None
    """Null without a CRS."""


@dataclass(frozen=True, slots=True)
class StatisticsEntry:
    """Displacements (before) and residuals (after the correction).

    Metres are target px times the pixel's size on the ground at each point, along columns and rows.
    """

    native_px_m: float | None
    """The coarser native pixel size of the two sensors, from the file names; metres."""
    before: Mapping[PointGroup, GroupStatistics | None]
    """Of all points that were not rejected, of those of the fit, of the check points; null without any."""
    after: Mapping[PointGroup, GroupStatistics | None]

    @property
    def judged(self) -> GroupStatistics | None:
        """Residuals of the check points, or of the fit where there are none."""
        return self.after["check"] or self.after["fit"]


@dataclass(frozen=True, slots=True)
class ProfilesEntry:
    """Displacement along rows and columns of the target minus its cubic trend: jitter, stripes."""

    waves: tuple[Peak, ...]
    """The strongest wave along the columns and along the rows, in each component; none of too few points."""
    by_column: Profile
    by_row: Profile
    by_height: Profile | None
    """Against the height of the ground, m; null without an elevation model."""

    @property
    def parts(self) -> tuple[Profile, ...]:
        """The profiles that there are."""
        return tuple(part for part in (self.by_column, self.by_row, self.by_height) if part is not None)


@dataclass(frozen=True, slots=True)
class CoverageEntry:
    """Tie points by square of the reference, row by row from its top-left corner, and why there are none."""

    squares: tuple[Positive, Positive]
    """How many there are down and across."""
    points: tuple[tuple[Count, ...], ...]
    """Tie points that agree with the others, of each square."""
    reason: tuple[tuple[RejectionReason | None, ...], ...]
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
    status: RegistrationStatus
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
    px_m: FloatPair | None
    """Size of a target pixel (col, row) on the ground in the middle of the overlap, metres on the ellipsoid;
    null without a CRS."""
    output_grid: GridEntry | None
    """Grid of the registered raster, also where that was not written because a requirement is not met; null
    for a pair that is refused or only matched."""
    prealignment: Prealignment
    """What the matching started from, matching-grid px."""
    geometry: PairGeometry
    """The geometric constraint by which wrong matches were rejected."""
    motions: tuple[Motion, ...]
    """Displacements of groups of consistent matches, if there are several; the chosen one comes first."""
    jitter_px: Amount
    """RMS displacement of rows and columns within a window, target px; 0 where none was detected."""
    bend_px: Amount
    """RMS of what windows average away of a displacement that bends within them, target px."""
    window_px: int | None
    """Side of the window that the tie points were refined with, matching-grid px; null where it is not
    known."""
    origin: Origin | None
    """What is known of tie points of a file; null for those that were matched."""
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
    proof: Proof | None
    """The tool's own error on this pair; null where it was not asked for."""
    outputs: tuple[str, ...]
    """Names of the files in the folder."""


SCHEMA_VERSION: Final = 1
"""Version of the structure of report.json."""


@dataclass(frozen=True, slots=True)
class ProofNumbers:
    """The content of proof.json."""

    schema_version: Literal[1]
    kind: Literal["proof"]
    created: Annotated[str, ("format", "date-time")]
    """ISO 8601, UTC."""
    reference: ReferenceEntry
    target: RasterEntry
    inputs: tuple[InputFile, ...]
    """The files that were read, as they were before."""
    px_m: FloatPair | None
    """Size of a target pixel (col, row) on the ground, metres; null without a CRS."""
    proof: Proof = field(metadata=INLINE)
    seconds: Mapping[str, float]
    """By stage."""
    settings: Settings
    """By option name."""
    versions: Versions
    outputs: tuple[str, ...]
    """Names of the files in the folder."""
