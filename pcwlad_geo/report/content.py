"""The content of report.json: its types, from which docs/make_schemas.py makes the schema, and its assembly.

In the schema, docstrings of fields become descriptions, and pairs in `Annotated` keywords and their values.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import datetime, timezone
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
import rasterio

from pcwlad_geo.correction.error_statistics import Accuracy, Amount, Count, FloatPair, Share, UnitStatistics
from pcwlad_geo.correction.jitter import JITTER, Peak, Profile, peaks, profile, without_trend
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.bands import BandPart
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.rpc.dem import Dem
from pcwlad_geo.raster.rpc.grid import RpcGrid
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.raster.source import RasterInfo, bands_of
from pcwlad_geo.registration import (
    Grade,
    InputFile,
    Motion,
    Origin,
    PairGeometry,
    Prealignment,
    Registration,
    RegistrationStatus,
    RpcRegistration,
)
from pcwlad_geo.registration.inputs import INLINE
from pcwlad_geo.report.statistics import (
    DIGITS,
    GROUPS,
    KEPT,
    REASONS,
    SHARE_DIGITS,
    PointGroup,
    PrecisionMap,
    When,
    coverage_of,
    heights_m,
    native_size_m,
    precision_of,
    statistics_of,
    target_px_m,
)
from pcwlad_geo.requirements import Requirement
from pcwlad_geo.text import plain
from pcwlad_geo.types import Float64

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
        return tuple(each for each in (self.by_column, self.by_row, self.by_height) if each is not None)


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


def to_json(content: object) -> str:
    """Return `content` as the text of a JSON file; `plain` defines how values are written."""
    return json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


T = TypeVar("T")


def filled(kind: type[T], /, *sources: object, **values: Any) -> T:  # noqa: ANN401  # of the fields' types
    """Return a dataclass of a `kind`; fields not in `values` are those of the first source that has them."""
    for name in {each.name for each in fields(kind)} - values.keys():  # type: ignore[arg-type]
        found = [getattr(source, name) for source in sources if hasattr(source, name)]
        values |= {name: found[0]} if found else {}
    return kind(**values)


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


SCHEMA_VERSION: Final = 1
"""Version of the structure of report.json."""
LIBRARIES = ("numpy", "scipy", "cv2", "rasterio", "pyproj")
"""Libraries whose versions the report states."""
PX_DIGITS, M_DIGITS, SECONDS_DIGITS = 5, 4, 3
"""Numbers of decimal places of pixels, metres and seconds."""


def summarise(
    registration: Registration,
    outputs: Sequence[str],
    precision: PrecisionMap | None = None,
    output_grid: Grid | None = None,
) -> Report:
    """Return the content of `report.json`.

    The `outputs` are names of the files in the output folder; the predicted sigma `precision` is given if it
    is already computed, and the grid of the registered raster if there is one.
    """
    kept = registration.tie_points.select(*KEPT)
    rpc = registration.rpc
    return filled(
        Report,
        registration,
        schema_version=SCHEMA_VERSION,
        requirements=tuple(
            filled(RequirementEntry, each, text=each.requirement.text, message=each.text)
            for each in registration.requirements
        ),
        reference=reference_entry(registration.reference),
        target=raster_entry(registration.target),
        output_grid=_grid(output_grid) if output_grid else None,
        tie_points=_tie_point_counts(registration),
        displacement_px=_statistics(kept.displacement_px, PX_DIGITS),
        displacement_m=_statistics(kept.displacement_m, M_DIGITS),
        rpc=_rpc(rpc, registration.settings) if rpc else None,
        model=_model(registration, precision or precision_of(registration)),
        accuracy={"fit": _accuracy(registration, "fit"), "check": _accuracy(registration, "check")},
        quality=_quality(registration),
        statistics=error_statistics(registration),
        profiles=_profiles(registration),
        coverage=_coverage(registration),
        seconds=rounded(registration.seconds, SECONDS_DIGITS),
        versions=versions(),
        proof=rounded(registration.proof, PROOF_DIGITS),
        outputs=tuple(outputs),
    )


def versions() -> dict[str, str]:
    """Return the versions of this package, Python, GDAL and the numerical libraries."""
    return {
        # Of the code that runs, which may differ from the installed package.
        "pcwlad-geo": str(import_module("pcwlad_geo").__version__),
        "python": platform.python_version(),
        "gdal": rasterio.__gdal_version__,
        **{name: str(import_module(name).__version__) for name in LIBRARIES},
    }


def error_statistics(registration: Registration) -> StatisticsEntry:
    """Return the statistics of displacements (before) and residuals (after) of all, fit and check points."""
    sizes_m = target_px_m(registration)

    def groups(when: When) -> dict[PointGroup, GroupStatistics | None]:
        return {group: _group(registration, when, group, sizes_m) for group in GROUPS}

    native_m = native_size_m(registration.reference, registration.target)
    return StatisticsEntry(native_m, groups("before"), groups("after"))


def _group(
    registration: Registration, when: When, group: PointGroup, sizes_m: Float64 | None
) -> GroupStatistics | None:
    found = statistics_of(registration, when, group, sizes_m)
    px, native_px, m = (found[unit] for unit in ("px", "native_px", "m"))
    if px is None:
        return None
    return rounded(GroupStatistics(px.n, px.of_unit, native_px and native_px.of_unit, m and m.of_unit))


def _grid(grid: Grid) -> GridEntry:
    a, b, col_off, d, e, row_off = (float(value) for value in grid.transform[:6])
    crs = grid.crs.to_string() if grid.crs and not isinstance(grid, RpcGrid) else None
    return GridEntry(grid.shape, (a, b, col_off, d, e, row_off), crs)


def reference_entry(info: RasterInfo) -> ReferenceEntry:
    """Return the reference; with an RPC, also the grid onto which it is orthorectified."""
    ground = _grid(ground_grid(info.grid)) if isinstance(info.grid, RpcGrid) else None
    return filled(ReferenceEntry, raster_entry(info), ground=ground)


def raster_entry(info: RasterInfo) -> RasterEntry:
    """Return the entry of a band of an input."""
    return filled(
        RasterEntry,
        info,
        path=info.uri,
        matched=bands_of(info).text,
        weights=info.several.parts if info.several else (),
        grid=_grid(info.grid),
        georeferenced=info.georeferenced and not isinstance(info.grid, RpcGrid),
        mask=info.mask_uri,
        mask_kind=info.mask_kind if info.mask_uri else None,
    )


def _rpc(rpc: RpcRegistration, settings: Settings) -> RpcEntry:
    """Return the RPCs before and after and the heights used, sufficient to correct other rasters."""
    heights = rpc.original.heights
    dem = heights if isinstance(heights, Dem) else None
    return RpcEntry(
        origin=rpc.origin,
        dem=str(_found_again(dem.uri)) if dem else None,
        dem_vertical=_found_again(settings.dem_vertical) if dem else None,
        undulation_m=round(dem.undulation.mean_m, M_DIGITS) if dem else None,
        height_m=None if isinstance(heights, Dem) else heights.height_m,
        height_range_m=rounded(rpc.heights_m, 1),
        original=rpc.original.rpc,
        corrected=rpc.corrected.rpc if rpc.corrected else None,
        fold_error_px=rpc.bias_error_px,
    )


def _found_again(file: float | Path | str | None) -> float | str | None:
    """Return an absolute path for the name of an existing file; other values are unchanged."""
    if not isinstance(file, str | Path):
        return file
    return str(Path(file).absolute() if Path(file).exists() else file)


def _tie_point_counts(registration: Registration) -> dict[str, int]:
    status = registration.tie_points.status
    names = ("matched",) if registration.status == "matched" else ("fit", "check", "unused")
    counts = {name: int(np.count_nonzero(status == name)) for name in (*names, "rejected")}
    return {"total": len(status), **counts}


def _model(registration: Registration, precision: PrecisionMap | None) -> ModelEntry | None:
    """Return the correction in full precision, and the candidates from which it was chosen."""
    if registration.correction is None:
        return None
    candidates = tuple(
        filled(
            CandidateEntry,
            each,
            parameters=_known(each.parameters, 1),
            rmse_px=_known(each.rmse_px, PX_DIGITS),
            rmse_standard_error_px=_known(each.rmse_standard_error_px, PX_DIGITS),
        )
        for each in (registration.selection.candidates if registration.selection else ())
    )
    sigma = _predicted_sigma(precision) if precision else None
    found: Any = registration.correction.to_dict()
    return ModelEntry(**found, predicted_sigma_px=sigma, candidates=candidates)


def _known(value: float, digits: int) -> float | None:
    """Return a rounded value; None if it is not finite."""
    return round(value, digits) if math.isfinite(value) else None


def _quality(registration: Registration) -> QualityEntry | None:
    quality, px_m = registration.quality, registration.px_m
    if quality is None:
        return None
    expected_px = quality.expected_ce90_px
    whole_px, extrapolated = quality.whole or (None, quality.extrapolated_share)
    size_m = None if px_m is None else math.sqrt(px_m[0] * px_m[1])
    return QualityEntry(
        grade=quality.grade,
        reasons=tuple(reason.text for reason in quality.reasons),
        expected_ce90_px=round(expected_px, PX_DIGITS),
        expected_ce90_m=None if size_m is None else round(expected_px * size_m, M_DIGITS),
        whole_ce90_px=rounded(whole_px, PX_DIGITS),
        whole_ce90_m=None if whole_px is None or size_m is None else round(whole_px * size_m, M_DIGITS),
        extrapolated_share=round(extrapolated, SHARE_DIGITS),
        kept_share=round(quality.kept_share, SHARE_DIGITS),
    )


def _predicted_sigma(precision: PrecisionMap) -> PredictedSigma:
    """Return the sigma of the correction over the target, and the share that is extrapolated."""
    sigma = precision.sigma_px.reshape(-1, 2)
    return PredictedSigma(
        median=_pair(np.median(sigma, axis=0), PX_DIGITS),
        largest=_pair(sigma.max(axis=0), PX_DIGITS),
        extrapolated_share=round(float(precision.extrapolated.mean()), SHARE_DIGITS),
    )


def _profiles(registration: Registration) -> ProfilesEntry | None:
    """Return the displacement along rows and columns of the target beyond its cubic trend."""
    points = registration.tie_points.select("fit", "check", "unused")
    if registration.selection is None or len(points) < JITTER.min_points:
        return None
    window_px, at_px = registration.selection.footprint_px, points.predicted_px
    rest = without_trend(at_px, points.displacement_px)
    col, row = at_px.T
    heights = heights_m(registration, at_px)
    found = ProfilesEntry(
        peaks(at_px, rest, window_px),
        profile(col, row, rest, window_px / 2),
        profile(row, col, rest, window_px / 2),
        None if heights is None else profile(heights, row, rest, 0.0),
    )
    return rounded(found, PX_DIGITS)


def _coverage(registration: Registration) -> CoverageEntry:
    """Return the tie points by square of the reference, and the reasons where there are none."""
    found = coverage_of(registration.tie_points, registration.reference.grid.shape, registration.record)
    rows, cols = found.points.shape
    return CoverageEntry(
        squares=(rows, cols),
        points=tuple(map(tuple, found.points.tolist())),
        reason=tuple(tuple(name or None for name in row) for row in found.reason.tolist()),
        without_points=found.without,
        empty_share=round(found.empty_share, SHARE_DIGITS),
    )


def _statistics(values: Float64, digits: int) -> AxisSummary | None:
    """Return mean, median and population standard deviation per axis; None without points."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) == 0:
        return None
    found = values.mean(axis=0), np.median(values, axis=0), values.std(axis=0)
    return AxisSummary(*(_pair(each, digits) for each in found))


def _accuracy(registration: Registration, group: str) -> dict[Literal["px", "m"], Accuracy | None]:
    def accuracy(unit: str, digits: int) -> Accuracy | None:
        found = registration.accuracy.get(f"{group}_{unit}")
        return rounded(found, digits) if found and found.n else None

    return {"px": accuracy("px", PX_DIGITS), "m": accuracy("m", M_DIGITS)}


def _pair(values: Float64, digits: int) -> FloatPair:
    col, row = np.round(values, digits).tolist()
    return col, row


PROOF_DIGITS: Final = 5
"""Number of decimal places of its figures."""


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


def proof_numbers(registration: Registration, proof: Proof, outputs: Sequence[str]) -> ProofNumbers:
    """Return the content of `proof.json`.

    The proof is of the pair of the `registration`; `outputs` are the names of the files in the folder.
    """
    return filled(
        ProofNumbers,
        registration,
        schema_version=1,
        kind="proof",
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        reference=reference_entry(registration.reference),
        target=raster_entry(registration.target),
        proof=rounded(proof, PROOF_DIGITS),
        seconds=rounded(registration.seconds, SECONDS_DIGITS),
        versions=versions(),
        outputs=tuple(outputs),
    )
