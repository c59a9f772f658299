"""The quality report as plain numbers: what `qa.json` and `qa.csv` hold and the page is made from."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any, Final

from pcwlad_geo.correction.error_statistics import ErrorStatistics
from pcwlad_geo.csv_cells import cell
from pcwlad_geo.report.statistics import rounded
from pcwlad_geo.report.summary import plain, versions
from pcwlad_geo.stacks.bands import Band
from pcwlad_geo.stacks.closure import Triangle
from pcwlad_geo.stacks.local import local_means
from pcwlad_geo.stacks.pairs import PairResult
from pcwlad_geo.stacks.requirements import Judged

if TYPE_CHECKING:
    from pcwlad_geo.stacks.run import QaResult

SCHEMA_VERSION: Final = 1
UNITS: Final = {"px": "px", "native_px": "native px", "m": "m"}
"""Units by their name in files."""
AXIS_STATISTICS: Final = ("mean", "median", "std", "rmse", "min", "max", "le90")
RADIAL_STATISTICS: Final = ("rmse", "ce90", "ce95", "ce99_7")

Summary = dict[str, Any]


def summarise(result: QaResult, outputs: Sequence[str]) -> Summary:
    """Return the content of `qa.json`.

    Parameters
    ----------
    result : QaResult
    outputs : sequence of str
        Names of the files written into the output folder.

    Returns
    -------
    dict
        JSON types only; NaN and infinity are None.
    """
    summary = {
        "schema_version": SCHEMA_VERSION,
        "kind": "qa",
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "passed": result.passed,
        "requirements": [_verdict(verdict) for verdict in result.verdicts],
        "against": result.against.name if result.against else None,
        "bands": [_band(band) for band in result.bands],
        "inputs": [each.to_json() for each in result.inputs],
        "pairs": [_pair(pair, result.verdicts) for pair in result.pairs],
        "closure": [_triangle(triangle) for triangle in result.triangles],
        "seconds": round(result.seconds, 3),
        "settings": asdict(result.settings),
        "versions": versions(),
        "outputs": list(outputs),
    }
    return {name: plain(rounded(value)) for name, value in summary.items()}


def to_csv(summary: Mapping[str, Any]) -> str:
    """Return the text of `qa.csv`: a line a pair; cells without a value are empty."""
    rows = [{name: cell(value) for name, value in _row(pair).items()} for pair in summary["pairs"]]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _verdict(judged: Judged) -> Summary:
    requirement, rule = judged.requirement, judged.requirement.rule
    worst = judged.worst
    return {
        "text": rule.text,
        "statistic": rule.statistic,
        "net": rule.net,
        "limit": rule.limit,
        "unit": rule.unit,
        "scope": requirement.scope,
        "preset": requirement.preset,
        "passed": judged.passed,
        "worst": {"name": worst[0], "value": worst[1]} if worst else None,
        "judged": len(judged.values) + len(judged.unmeasured),
        "failed": list(judged.failed),
    }


def _band(band: Band) -> Summary:
    return {
        "name": band.name,
        "path": band.file,
        "product": band.product,
        "band": band.info.band,
        "description": band.description,
        "shape": list(band.info.grid.shape),
        "px_m": band.px_m,
        "native_px_m": band.native_m,
        "native_told": band.native_told,
        "crs": band.info.grid.crs.to_string() if band.info.grid.crs else None,
        "mask": band.info.mask_uri,
    }


def _pair(pair: PairResult, verdicts: Sequence[Judged]) -> Summary:
    judged = [verdict for verdict in verdicts if pair.name in (*verdict.values, *verdict.unmeasured)]
    met = None if not judged else not any(pair.name in verdict.failed for verdict in judged)
    return {
        "name": pair.name,
        "reference": pair.reference.name,
        "target": pair.target.name,
        "status": pair.status,
        "reason": pair.reason,
        "passed": False if verdicts and pair.status == "refused" else met,
        "warnings": list(pair.warnings),
        "n": len(pair.points) if pair.points else 0,
        "rejected": pair.rejected,
        "px_m": pair.target.px_m,
        "native_px_m": pair.native_m,
        "local": _local(pair),
        "displacement": {name: _statistics(pair.statistics.get(unit)) for name, unit in UNITS.items()},
    }


def _local(pair: PairResult) -> list[Summary]:
    if pair.points is None:
        return []
    return [asdict(each) for each in local_means(pair.points, pair.target.info.grid.shape)]


def _statistics(statistics: ErrorStatistics | None) -> Summary | None:
    if statistics is None:
        return None
    content = asdict(statistics)
    del content["n"]  # the same in all units
    return content


def _triangle(triangle: Triangle) -> Summary:
    return {
        "bands": list(triangle.bands),
        "name": triangle.name,
        "cells": triangle.cells,
        "mean_px": triangle.mean_px,
        "error_px": triangle.error_px,
        "rms_px": triangle.rms_px,
        "mean_m": triangle.mean_m,
        "px_m": triangle.px_m,
    }


def _row(pair: Mapping[str, Any]) -> dict[str, object]:
    passed = pair["passed"]
    row: dict[str, object] = {name: pair[name] for name in ("reference", "target", "status")}
    row["passed"] = "" if passed is None else "yes" if passed else "no"
    row |= {name: pair[name] for name in ("n", "rejected")}
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
    for field, name in (("noise_xy", "noise"), ("std_xy", "net_std"), ("le90_xy", "net_le90")):
        values = net.get(field) or (None, None)
        flat |= {f"{name}_{axis}": value for axis, value in zip(("col", "row"), values, strict=True)}
    return flat
