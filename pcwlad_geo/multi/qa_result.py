"""Requirements on pairs and triangles of bands, and the content of `qa.json` and `qa.csv`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Any, Final, Literal, cast

from pcwlad_geo.correction.error_statistics import Count, FloatPair, Proof, UnitStatistics
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.multi.bands import Band, BandPairStatus, LocalMean, PairResult, Triangle, local_means
from pcwlad_geo.options import Settings
from pcwlad_geo.products.landsat import TIRS_M
from pcwlad_geo.raster.identity import FileIdentity
from pcwlad_geo.report.content import Positive, filled, rounded, versions
from pcwlad_geo.requirements import Requirement, Unit, parse_requirement, value_of
from pcwlad_geo.text import csv_of, plain

Scope = Literal["all", "no thermal", "one thermal", "both thermal"]
Preset = Literal["sentinel2", "landsat-oli", "landsat-tirs"]


@dataclass(frozen=True, slots=True)
class BandRequirement:
    """A requirement, and the pairs of bands to which it applies."""

    rule: Requirement
    scope: Scope = "all"
    """Pairs to which the requirement applies."""
    preset: Preset | None = None
    """Preset that contains the requirement; None if it is the user's."""


@dataclass(frozen=True, slots=True)
class Judged:
    """The evaluation of a requirement."""

    requirement: BandRequirement
    values: dict[str, float]
    """Values by pair or triangle, for those that the requirement applies to and that were measured."""
    unmeasured: tuple[str, ...] = ()
    """Refused pairs to which the requirement applies."""
    failed: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        rule = self.requirement.rule
        over = [name for name, value in self.values.items() if not rule.is_met(value)]
        object.__setattr__(self, "failed", (*over, *self.unmeasured))

    @property
    def passed(self) -> bool:
        """Whether all values meet the requirement; without any value it is not met."""
        return bool(self.values) and not self.failed

    @property
    def worst(self) -> tuple[str, float] | None:
        """The pair or triangle with the largest value."""
        if not self.values:
            return None
        name = max(self.values, key=lambda each: self.values[each])
        return name, self.values[name]


def _net(statistic: str, limit: float, unit: Unit, scope: Scope, preset: Preset) -> BandRequirement:
    return BandRequirement(Requirement(statistic, limit, unit, net=True), scope, preset)


PRESETS: Final[dict[Preset, tuple[BandRequirement, ...]]] = {
    "sentinel2": (_net("CE99.7", 0.3, "native px", "all", "sentinel2"),),
    "landsat-oli": (_net("LE90", 4.5, "m", "no thermal", "landsat-oli"),),
    "landsat-tirs": (
        _net("LE90", 18.0, "m", "both thermal", "landsat-tirs"),
        _net("LE90", 30.0, "m", "one thermal", "landsat-tirs"),
    ),
}
"""Band-to-band requirements of the missions; they concern the sensor, so matching noise is removed."""


def read_requirement(text: str) -> BandRequirement:
    """Parse a requirement of the user on all pairs; see `parse_requirement`."""
    return BandRequirement(parse_requirement(text, "qa"))


def preset_requirements(name: str) -> tuple[BandRequirement, ...]:
    """Return the requirements of a preset.

    Raises `SettingsError` if there is no preset of that name.
    """
    for preset, requirements in PRESETS.items():
        if preset == name:
            return requirements
    raise SettingsError(f"preset = {name!r}: give one of {', '.join(PRESETS)}")


def is_about(requirement: BandRequirement, reference: Band, target: Band) -> bool:
    """Whether `requirement` applies to the pair of bands `reference` and `target`."""
    if requirement.rule.statistic == "closure":
        return False
    thermal = sum(band.native_m is not None and min(band.native_m) >= TIRS_M for band in (reference, target))
    return requirement.scope in ("all", ("no thermal", "one thermal", "both thermal")[thermal])


def check_applicable(
    requirements: Sequence[BandRequirement], planned: Sequence[tuple[Band, Band]], triangles: bool
) -> list[BandRequirement]:
    """Return the requirements that apply to the planned pairs.

    A requirement of a preset that applies to no pair is left out if another one of the preset does. Raises
    `SettingsError` if one cannot be judged: metres without a CRS, closure without triangles, a preset for
    other bands.
    """
    kept = []
    for requirement in requirements:
        if requirement.rule.statistic == "closure":
            if not triangles:
                raise SettingsError(
                    "a limit on closure needs all pairs of three bands or more: give more bands, without "
                    "--against, or leave out that requirement"
                )
            about = list(planned)
        else:
            about = [pair for pair in planned if is_about(requirement, *pair)]
        if requirement.rule.unit == "m" and any(target.px_m is None for _, target in about):
            raise SettingsError(
                f"{requirement.rule.text}: a band has no CRS, so metres are not known: give px"
            )
        if about:
            kept.append(requirement)
    for preset in {requirement.preset for requirement in requirements if requirement.preset}:
        if not any(requirement.preset == preset for requirement in kept):
            what = "a thermal band" if preset == "landsat-tirs" else "two bands that are not thermal"
            raise SettingsError(
                f"the preset {preset} needs {what}, and the names tell of none: check the bands, or say "
                "which are thermal with --native-px NAME=100"
            )
    return kept


def judge_pairs(requirement: BandRequirement, pairs: Sequence[PairResult]) -> Judged:
    """Compare the `pairs` with a `requirement`."""
    values, unmeasured = {}, []
    for pair in pairs:
        if not is_about(requirement, pair.reference, pair.target):
            continue
        statistics = pair.statistics.get(str(requirement.rule.unit))
        if statistics is None:
            unmeasured.append(pair.name)
        else:
            values[pair.name] = value_of(requirement.rule, statistics)
    return Judged(requirement, values, tuple(unmeasured))


def judge_triangles(requirement: BandRequirement, triangles: Sequence[Triangle]) -> Judged:
    """Compare the `triangles` with a `requirement` on the closure error, of the larger axis of each."""
    values = {}
    for triangle in triangles:
        gap = triangle.mean_m if requirement.rule.unit == "m" else triangle.mean_px
        values[triangle.name] = math.nan if gap is None else max(abs(gap[0]), abs(gap[1]))
    return Judged(requirement, values)


UNITS: Final[Mapping[Literal["px", "native_px", "m"], Unit]] = {
    "px": "px",
    "native_px": "native px",
    "m": "m",
}
"""Units by their names in files."""
AXIS_STATISTICS: Final = ("mean", "median", "std", "rmse", "min", "max", "le90")
"""Statistics per axis, by their names in files."""
RADIAL_STATISTICS: Final = ("rmse", "ce90", "ce95", "ce99_7")
"""Radial statistics, by their names in files."""

Summary = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class QaResult:
    """The result of a band QA."""

    bands: tuple[Band, ...]
    against: Band | None
    """Band with which all others are compared; None for all pairs."""
    pairs: tuple[PairResult, ...]
    triangles: tuple[Triangle, ...]
    verdicts: tuple[Judged, ...]
    """Evaluations of the requirements."""
    settings: Settings
    seconds: float
    out_dir: Path
    """Folder of `qa.json`, `qa.csv` and `qa.html`."""
    inputs: tuple[FileIdentity, ...] = ()
    """Identities, before the matching, of the files of the bands and masks."""

    @property
    def refused(self) -> tuple[PairResult, ...]:
        """Pairs that could not be matched reliably."""
        return tuple(pair for pair in self.pairs if pair.status == "refused")

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met and no pair was refused; None without requirements."""
        if not self.verdicts:
            return None
        return not self.refused and all(verdict.passed for verdict in self.verdicts)


@dataclass(frozen=True, slots=True)
class WorstEntry:
    """A pair or triangle, and its value."""

    name: str
    value: float | None


@dataclass(frozen=True, slots=True)
class BandRequirementEntry:
    """A requirement and its evaluation."""

    text: str
    """As the command line takes it."""
    statistic: str
    net: bool
    """With the matching noise taken out."""
    limit: float | str
    unit: Unit | None
    scope: Scope
    """Which pairs it is about; thermal: native pixel of 100 m or more."""
    preset: Preset | None
    passed: bool
    worst: WorstEntry | None
    """Pair or triangle with the largest value."""
    judged: Count
    """Number of pairs or triangles that it is about."""
    failed: tuple[str, ...]
    """Pairs or triangles that do not meet it, refused pairs among them."""


@dataclass(frozen=True, slots=True)
class BandEntry:
    """A band."""

    name: str
    """Short and unique in the stack."""
    path: str
    product: str | None
    """Path of the product that the band was taken from; null where its file was given."""
    band: Positive
    description: str | None
    shape: tuple[Positive, Positive]
    """Rows, columns."""
    px_m: FloatPair | None
    """Pixel size (col, row) on the ground in the middle of the band, metres on the ellipsoid; null without a
    CRS."""
    native_px_m: FloatPair | None
    """Pixel size that the sensor recorded; that of the file where nothing else is known."""
    native_known: bool
    """Whether a known sensor or the user says so."""
    crs: str | None
    mask: str | None


@dataclass(frozen=True, slots=True)
class BandPairEntry:
    """A pair of bands."""

    name: str
    reference: str
    target: str
    status: BandPairStatus
    reason: str | None
    """Why it was refused."""
    passed: bool | None
    """Null where no requirement is about it."""
    warnings: tuple[str, ...]
    n: Count
    """Tie points that agree with their neighbours: those of the statistics."""
    rejected: Count
    """Tie points that do not."""
    px_m: FloatPair | None
    """Pixel size of the target on the ground in its middle, metres."""
    native_px_m: FloatPair | None
    """The coarser of the two native pixel sizes, metres."""
    local: tuple[LocalMean, ...]
    """Mean displacement in squares of an eighth of the target's longer side, px of the target; squares with
    fewer than 3 tie points are left out."""
    displacement: Mapping[Literal["px", "native_px", "m"], UnitStatistics | None]
    """The same statistics in pixels of the target, in native pixels, in metres along columns and rows."""
    proof: Proof | None
    """The tool's own error on the pair, target px, without its map; null where no proof was asked for."""


@dataclass(frozen=True, slots=True)
class TriangleEntry:
    """The closure error of three bands A, B, C, the last the coarsest."""

    bands: tuple[str, str, str]
    name: str
    cells: Count
    """Places, one matching window each or more where tie points are few, where all three pairs have tie
    points."""
    mean_px: FloatPair | None
    """BC(AB(x)) - AC(x), mean over the places x, px (col, row) of C; null without common ground."""
    error_px: FloatPair | None
    """Standard error of that mean, neighbouring places taken as correlated; null with a single place."""
    rms_px: FloatPair | None
    """Root mean square over the places."""
    mean_m: FloatPair | None
    """The mean in metres."""
    px_m: FloatPair | None
    """Size of that pixel on the ground, metres."""


@dataclass(frozen=True, slots=True)
class QaNumbers:
    """The content of qa.json.

    Displacement = where the target shows the ground, less where its georeferencing says; (col, row), positive
    to the right and down. NaN and unknown values are null.
    """

    schema_version: Literal[1]
    kind: Literal["qa"]
    created: Annotated[str, ("format", "date-time")]
    """ISO 8601, UTC."""
    passed: bool | None
    """Whether all requirements are met and no pair was refused; null where nothing was required."""
    requirements: tuple[BandRequirementEntry, ...]
    against: str | None
    """Name of the band that all others were compared with; null: all pairs."""
    bands: tuple[BandEntry, ...]
    inputs: tuple[FileIdentity, ...]
    """The files that the bands and masks were read from, as they were before the matching; compared before
    the results are put in place. Also those that belong to a raster and the sources of a VRT, save statistics
    beside it (.aux.xml)."""
    pairs: tuple[BandPairEntry, ...]
    closure: tuple[TriangleEntry, ...]
    """Every triangle of bands whose three pairs were measured; empty with against."""
    seconds: float
    settings: Settings
    """By option name."""
    versions: Mapping[str, str]
    outputs: tuple[str, ...]
    """Names of the files in the folder."""


def summarise(result: QaResult, outputs: Sequence[str]) -> Summary:
    """Return the content of `qa.json` in JSON types, as `QaNumbers` has it.

    The `outputs` are names of the files in the output folder.
    """
    numbers = filled(
        QaNumbers,
        result,
        schema_version=1,
        kind="qa",
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        requirements=tuple(_verdict(verdict) for verdict in result.verdicts),
        against=result.against.name if result.against else None,
        bands=tuple(_band(band) for band in result.bands),
        pairs=tuple(_pair(pair, result.verdicts) for pair in result.pairs),
        closure=tuple(filled(TriangleEntry, triangle) for triangle in result.triangles),
        seconds=round(result.seconds, 3),
        versions=versions(),
        outputs=tuple(outputs),
    )
    return cast(Summary, plain(rounded(numbers)))


def to_csv(summary: Mapping[str, Any]) -> str:
    """Return the text of `qa.csv`: one line per pair; cells without a value are empty."""
    return csv_of([_row(pair) for pair in summary["pairs"]])


def _verdict(judged: Judged) -> BandRequirementEntry:
    worst = WorstEntry(*judged.worst) if judged.worst else None
    count = len(judged.values) + len(judged.unmeasured)
    rule = judged.requirement.rule
    return filled(BandRequirementEntry, judged, judged.requirement, rule, worst=worst, judged=count)


def _band(band: Band) -> BandEntry:
    crs = band.info.grid.crs
    return filled(
        BandEntry,
        band,
        path=band.file,
        band=band.info.band,
        shape=band.info.grid.shape,
        native_px_m=band.native_m,
        crs=crs.to_string() if crs else None,
        mask=band.info.mask_uri,
    )


def _pair(pair: PairResult, verdicts: Sequence[Judged]) -> BandPairEntry:
    judged = [verdict for verdict in verdicts if pair.name in (*verdict.values, *verdict.unmeasured)]
    by_unit = {name: pair.statistics.get(unit) for name, unit in UNITS.items()}
    met = None if not judged else not any(pair.name in verdict.failed for verdict in judged)
    return filled(
        BandPairEntry,
        pair,
        reference=pair.reference.name,
        target=pair.target.name,
        passed=False if verdicts and pair.status == "refused" else met,
        n=len(pair.points) if pair.points else 0,
        px_m=pair.target.px_m,
        native_px_m=pair.native_m,
        local=tuple(local_means(pair.points, pair.target.info.grid.shape)) if pair.points else (),
        displacement={name: found and found.of_unit for name, found in by_unit.items()},
        proof=replace(pair.proof, map=()) if pair.proof else None,
    )


def _row(pair: Mapping[str, Any]) -> dict[str, object]:
    names = ("reference", "target", "status", "passed", "n", "rejected")
    row: dict[str, object] = {name: pair[name] for name in names}
    for unit, statistics in pair["displacement"].items():
        row |= {f"{name}_{unit}": value for name, value in _flat(statistics).items()}
    return {**row, "reason": pair["reason"]}


def _flat(statistics: Mapping[str, Any] | None) -> dict[str, float | None]:
    """Return all statistics of one unit by name: `mean_col`, `ce90`, `net_ce90`, `noise_row`."""
    found = statistics or {}
    flat = {
        f"{name}_{axis}": found.get(axis, {}).get(name) for axis in ("col", "row") for name in AXIS_STATISTICS
    }
    flat |= {name: found.get("radial", {}).get(name) for name in RADIAL_STATISTICS}
    net = found.get("net", {})
    flat |= {f"net_{name}": net.get(name) for name in RADIAL_STATISTICS}
    for entry, name in (("noise_xy", "noise"), ("std_xy", "net_std"), ("le90_xy", "net_le90")):
        values = net.get(entry) or (None, None)
        flat |= {f"{name}_{axis}": value for axis, value in zip(("col", "row"), values, strict=True)}
    return flat
