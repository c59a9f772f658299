"""Scanned photographs of a simulated flight: which ones `batch` places with a flight index, and how well."""

from __future__ import annotations

import json
import re
import resource
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

import pcwlad_geo
from benchmarks.flight_scenes import (
    FRAME_PX,
    INDEX_M,
    ORIGIN,
    PX_M,
    SIDE_PX,
    Photograph,
    fly,
    write_orthophoto,
)
from benchmarks.runs import Array, Runner
from benchmarks.tables import Table, at_least, at_most
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.multi.batch.run import BatchResult

PHOTOGRAPHS: Final = 60
ORTHOPHOTO_PX: Final = 4000
PLACED_SHARE: Final = 57 / 60
RIGHT_PX: Final = 1.0
"""Largest mean error of a photograph that counts as placed, px of the photograph."""
MEMORY_MB: Final = 1500.0


def flight(data: Path, scratch: Path, runner: Runner, share: float = 1.0) -> Iterator[Table]:
    """Yield how many of the photographs, or of a share of them over a smaller orthophoto, are placed."""
    count = max(1, round(PHOTOGRAPHS * share))
    side_px = max(2000, round(ORTHOPHOTO_PX * np.sqrt(share)))
    write_orthophoto(scratch / "ortho.tif", side_px)
    photographs = fly(scratch / "photographs", count, side_px)
    result = pcwlad_geo.batch(
        scratch / "photographs" / "flight.gpkg",
        out_dir=scratch / "out",
        reference=scratch / "ortho.tif",
        photo_size=0.8 * PX_M * SIDE_PX,
        within=INDEX_M,
        jobs=runner.processes,
        no_report=True,
    )
    yield _table(result, {photograph.name: photograph for photograph in photographs})


def _table(result: BatchResult, photographs: dict[str, Photograph]) -> Table:
    errors = {
        Path(outcome.pair.target).stem: _error_px(outcome.pair.out_dir, outcome.pair.reference, photographs)
        for outcome in result.pairs
        if outcome.status == "registered"
    }
    verdicts = Counter("placed" if error <= RIGHT_PX else "WRONG" for error in errors.values())
    kinds = ("placed", "WRONG", "rejected", "unusable", "failed")
    counts = [verdicts[kind] + result.count(kind) for kind in kinds]
    figures = np.array([*errors.values(), np.nan])
    memory_mb = max(
        resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ) / 1024  # fmt: skip
    row = (str(len(photographs)), *counts, float(np.nanmedian(figures)), float(np.nanmax(figures)), memory_mb)
    return Table(
        f"Photographs of a flight, index good to {INDEX_M:.0f} m",
        ("photographs", *kinds, "median error, px", "largest, px", "memory, MB"),
        [row],
        [
            at_least("placed within 1 px, %", 100 * counts[0] / len(photographs), 100 * PLACED_SHARE, "%", 1),
            at_most("wrong", float(counts[1]), 0.0, digits=0),
            at_most("memory", memory_mb, MEMORY_MB, "MB", 0),
        ],
    )


def _error_px(folder: Path, reference: str, photographs: dict[str, Photograph]) -> float:
    """Return the mean distance of the correction from the truth, px of the photograph, all over it."""
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    photograph = photographs[Path(report["target"]["path"]).stem]
    rows, cols = photograph.shape
    margin = 2 * FRAME_PX
    at = np.stack(np.meshgrid(*(np.linspace(margin, n - margin, 12) for n in (cols, rows))), -1).reshape(
        -1, 2
    )
    places: Array = (photograph.to_xy(at) - np.array(ORIGIN)) / [PX_M, -PX_M]
    match = re.search(r"srcwin=(\d+),(\d+)", reference)
    first = np.array([int(number) for number in match.groups()]) if match else np.zeros(2)
    found = from_dict(report["model"]).forward(places - first)
    return float(np.hypot(*(found - at).T).mean())
