"""The figures of a pair, read back of the report.json of its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.errors import InputError
from pcwlad_geo.registration import Grade, Motion, RegistrationStatus
from pcwlad_geo.report.content import Report
from pcwlad_geo.text import mismatch, read_json, typed

REPORT_FILE = "report.json"
"""Name of the file in an output folder that describes the registration."""


@dataclass(frozen=True, slots=True)
class ReadRequirement:
    """A requirement as a report.json has it."""

    met: bool
    message: str


@dataclass(frozen=True, slots=True)
class ReadAxes:
    """A displacement as a report.json has it."""

    mean: tuple[float, float]
    median: tuple[float, float]


@dataclass(frozen=True, slots=True)
class ReadAccuracy:
    """Residuals as a report.json has them."""

    rmse: float
    ce90: float


@dataclass(frozen=True, slots=True)
class ReadQuality:
    """A quality as a report.json has it."""

    grade: Grade
    expected_ce90_px: float


@dataclass(frozen=True, slots=True)
class ReadCoverage:
    """The coverage of a pair as a report.json has it."""

    empty_share: float | None = None


@dataclass(frozen=True, slots=True)
class ReadSide:
    """The reference or the target as a report.json has it."""

    path: str
    band: int
    band_count: int


@dataclass(frozen=True, slots=True)
class ReadFigures:
    """The figures of a pair that are read back of a report.json; see `Report`."""

    reference: ReadSide | None = None
    target: ReadSide | None = None
    status: RegistrationStatus | None = None
    reason: str | None = None
    warnings: tuple[str, ...] = ()
    passed: bool | None = None
    requirements: tuple[ReadRequirement, ...] = ()
    motions: tuple[Motion, ...] = ()
    jitter_px: float = 0.0
    window_px: int | None = None
    tie_points: Mapping[str, int] = field(default_factory=dict)
    displacement_px: ReadAxes | None = None
    model: Mapping[str, object] | None = None
    accuracy: Mapping[str, Mapping[str, ReadAccuracy | None]] = field(default_factory=dict)
    quality: ReadQuality | None = None
    coverage: ReadCoverage = ReadCoverage()
    proof: Proof | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)


def read_report(out_dir: Path) -> dict[str, Any]:
    """Return the report.json of a folder; an empty dict if there is none of this program."""
    try:
        report = read_json(out_dir / REPORT_FILE)
    except (OSError, ValueError, InputError):
        return {}
    is_ours = isinstance(report, dict) and "schema_version" in report and "settings" in report
    return report if is_ours and mismatch(report, Report) is None else {}


def read_figures(out_dir: Path) -> ReadFigures | None:
    """Return the figures of the report.json of a folder; None if there is none of this program."""
    report = read_report(out_dir)
    try:
        return typed(report, ReadFigures) if report else None
    except ValueError:  # of an earlier version
        return None
