"""Grades of pairs whose displacement has rivals: ground that repeats, and mosaics with a seam."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.displacing import displace
from benchmarks.pairs import Image, as_uint8, write
from benchmarks.quality_scenes import grounds
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.tables import Cell, Check, Table, at_most
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import map_px
from tests.repeating_ground import PATTERNS, repeating_pair
from tests.scenes import make_grid

SETTINGS: Final = Settings(jobs=1, features=400)
OFF_PX, TIMES, STEP_PX = 1.0, 3.0, 6.0
PERIODS: Final = (0.0, 0.5, 1.0, 2.0, 3.0)
"""How far the georeferencing is off, in periods."""
CONTENTS: Final[dict[str, dict[str, float | bool]]] = {
    "with edges": {},
    "another date": {"detail": 0.05, "change": 0.2},
    "nothing but the pattern": {"has_edges": False, "detail": 0.0},
}
"""What breaks the period, see `repeating_pair`; the second and third are matched at the odd displacements."""
SEAMS_PX: Final = (0.5, 1.0, 2.2, 4.0, 8.0, 14.0, 20.0)
"""Steps between the two blocks of a mosaic, of which the first lies 11.2 px off."""
SEAM_AT: Final = 0.55
"""Where the seam runs, as a share of the columns."""


@dataclass(frozen=True, slots=True)
class Case:
    """A pair of files and its truth."""

    name: str
    job: Job
    truth_px: tuple[tuple[float, float], tuple[float, float]]
    """Displacement (col, row) to the left and to the right of the seam."""


def periods(_data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield the grades of ten kinds of repeating ground, displaced by up to three periods."""
    yield _graded("pairs of ground that repeats", list(_repeating(scratch)), runner)


def seams(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield the grades of mosaics of two blocks, of which one lies within the search radius."""
    yield _graded("mosaics with a seam", list(_mosaics(data, scratch)), runner)


def _repeating(scratch: Path) -> Iterator[Case]:
    for kind, (_, period_px) in PATTERNS.items():
        for content, options in CONTENTS.items():
            for number in PERIODS if not options else PERIODS[2:4]:
                # a little more than whole periods, so that nothing lies on whole pixels
                col, row = (number * side + extra for side, extra in zip(period_px, (0.4, -0.7), strict=True))
                images = repeating_pair(kind, (col, row), side_px=260, **options)  # type: ignore[arg-type]
                name = f"{kind}, {content}, {number:g} periods"
                yield Case(name, _job(scratch, name, *images), ((col, row), (col, row)))


def _mosaics(data: Path, scratch: Path) -> Iterator[Case]:
    ground = next(each for each in grounds(data) if each.exact)
    for step_px in SEAMS_PX:
        moved = 11.2, 11.2 + step_px
        name = f"step of {step_px} px"
        job = _job(scratch, name, as_uint8(ground.reference), as_uint8(_mosaic(ground.target, moved)))
        truth = (moved[0], 0.0), (moved[1], 0.0)
        yield Case(name, job, truth)
        if step_px in (2.2, 14.0):
            bounded = replace(job, settings=replace(job.settings, search_radius=12))
            yield Case(f"{name}, radius given", bounded, truth)


def _mosaic(image: Image, moved_px: tuple[float, float]) -> Image:
    def field(at_px: Array) -> Array:
        col = np.where(at_px[..., 0] < SEAM_AT * image.shape[1], *moved_px)
        return np.stack([col, np.zeros_like(col)], axis=-1)

    return displace(image, field)


def _job(scratch: Path, name: str, reference: Image, target: Image) -> Job:
    grid = make_grid(reference.shape)
    stem = name.replace(" ", "_").replace(",", "")
    paths = [
        write(scratch / f"{stem}_{which}.tif", image, grid.transform, "EPSG:32633")
        for which, image in (("reference", reference), ("target", target))
    ]
    return Job(paths[0], paths[1], SETTINGS, match_only=False)


def _graded(what: str, cases: Sequence[Case], runner: Runner) -> Table:
    rows: list[list[Cell]] = []
    wrong, unnamed, good = 0, 0, 0
    for case, outcome in zip(cases, runner([case.job for case in cases]), strict=True):
        quality = outcome.result.quality if outcome.accepted else None
        if quality is None:
            rows.append([case.name, "refused", float("nan"), float("nan"), ""])
            continue
        true_px, expected_px = _true_ce90(case, outcome), quality.expected_ce90_px
        is_off = true_px > OFF_PX or true_px > TIMES * expected_px
        rivals = any("the ground repeats" in reason.text for reason in quality.reasons)
        is_silent = quality.grade != "poor" and not rivals and true_px > max(OFF_PX, TIMES * expected_px)
        good += quality.grade == "good"
        wrong += quality.grade == "good" and is_off
        unnamed += is_silent
        remark = "WRONG" if quality.grade == "good" and is_off else "silent" if is_silent else ""
        rows.append([case.name, quality.grade, expected_px, true_px, remark or ("rivals" if rivals else "")])
    checks: list[Check] = [
        at_most(
            f"good {what} off by more than {OFF_PX:.0f} px or {TIMES:.0f} x expected", wrong, 0, digits=0
        ),
        at_most("fair ones that are off and do not say why", unnamed, 0, digits=0),
    ]
    header = ("pair", "grade", "CE90 expected", "true", "")
    return Table(f"Grades of {len(rows)} {what} ({good} good)", header, rows, checks)


def _true_ce90(case: Case, outcome: Outcome) -> float:
    """Return the 90th percentile of the correction's error over the ground that both files show, px."""
    result = outcome.result
    rows, cols = result.reference.grid.shape
    axes = [np.arange(STEP_PX / 2, side, STEP_PX) for side in (cols, rows)]
    at_px = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    truth_px = at_px + np.where(at_px[:, :1] < SEAM_AT * cols, *(np.array(each) for each in case.truth_px))
    at_px, truth_px = (
        each[((truth_px >= 0) & (truth_px < (cols, rows))).all(axis=1)] for each in (at_px, truth_px)
    )
    if result.model is None:
        return float("nan")
    predicted_px = map_px(at_px, result.reference.grid, result.target.grid)
    off_px = result.model.forward(predicted_px) - truth_px
    return float(np.percentile(np.linalg.norm(off_px, axis=1), 90))
