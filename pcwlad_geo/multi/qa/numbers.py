"""The result of a band QA, and the content of `qa.json` and `qa.csv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated, Final, Literal

from pcwlad_geo.correction.error_statistics import Count, FloatPair, UnitStatistics
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.multi.qa.band_pairs import BandPairStatus, LocalMean, PairResult, local_means
from pcwlad_geo.multi.qa.bands import Band
from pcwlad_geo.multi.qa.closure import Triangle
from pcwlad_geo.multi.qa.requirements import Judged, Preset, Scope
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import FileIdentity
from pcwlad_geo.report.content import Positive
from pcwlad_geo.report.json_content import filled, rounded, versions
from pcwlad_geo.requirements import Unit
from pcwlad_geo.text import csv_of

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


def summarise(result: QaResult, outputs: Sequence[str]) -> QaNumbers:
    """Return the content of `qa.json`; the `outputs` are names of the files in the output folder."""
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
    return rounded(numbers)


def to_csv(numbers: QaNumbers) -> str:
    """Return the text of `qa.csv`: one line per pair; cells without a value are empty."""
    return csv_of([_row(pair) for pair in numbers.pairs])


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
        displacement={name: statistics and statistics.of_unit for name, statistics in by_unit.items()},
        proof=replace(pair.proof, map=()) if pair.proof else None,
    )


def _row(pair: BandPairEntry) -> dict[str, object]:
    names = ("reference", "target", "status", "passed", "n", "rejected")
    row: dict[str, object] = {name: getattr(pair, name) for name in names}
    for unit, statistics in pair.displacement.items():
        row |= {f"{name}_{unit}": value for name, value in _flat(statistics).items()}
    return {**row, "reason": pair.reason}


def _flat(statistics: UnitStatistics | None) -> dict[str, float | None]:
    """Return all statistics of one unit by name: `mean_col`, `ce90`, `net_ce90`, `noise_row`."""
    axes = {axis: getattr(statistics, axis, None) for axis in ("col", "row")}
    radial, net = getattr(statistics, "radial", None), getattr(statistics, "net", None)
    flat = {
        f"{name}_{axis}": getattr(values, name, None)
        for axis, values in axes.items()
        for name in AXIS_STATISTICS
    }
    flat |= {name: getattr(radial, name, None) for name in RADIAL_STATISTICS}
    flat |= {f"net_{name}": getattr(net, name, None) for name in RADIAL_STATISTICS}
    for entry, name in (("noise_xy", "noise"), ("std_xy", "net_std"), ("le90_xy", "net_le90")):
        values = getattr(net, entry, (None, None))
        flat |= {f"{name}_{axis}": value for axis, value in zip(axes, values, strict=True)}
    return flat
