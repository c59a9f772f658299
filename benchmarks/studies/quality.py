"""Grades of registrations, and the accuracy they expect, against a truth that is known everywhere."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.transform import Affine

from benchmarks.displacing import Field
from benchmarks.pairs import Image, as_uint8, write
from benchmarks.quality_scenes import CONDITIONS, HARDER, grounds
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.studies.quality_frame import frame
from benchmarks.studies.quality_rivals import periods, seams
from benchmarks.studies.quality_sets import (
    CRS,
    FINE_PX,
    FINE_SHARE,
    GRID,
    OFF_PX,
    TIMES,
    blocks,
    rigs,
    stacks,
)
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import map_px
from pcwlad_geo.registration import Registration
from pcwlad_geo.registration.fitting import fit_correction

Truth = Callable[[Array, Outcome | None], Array]
"""(n, 2) reference px, and what the undisplaced pair gave, to the target px where the ground is."""

SETTINGS: Final = Settings(jobs=1)
STEP_PX: Final = 6
"""Of the dense grid on which corrections are compared with the truth."""
HEIGHT_M: Final = 29.0
"""From the elevation model up to the ellipsoid, for the QuickBird image."""
MIN_PAIRS: Final = 60


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A pair of files, and where the ground is in them."""

    condition: str
    ground: str
    job: Job
    base: Job | None
    """The pair before it was displaced, where that does not lie exactly in place."""
    truth: Truth
    size_px: tuple[int, int]
    """(cols, rows) of the target file."""
    hidden: Image | None = None
    """(rows, cols) of the reference: where clouds hide the ground."""
    open_question: str = ""
    """What no image can tell: whether clouds over more than a tenth of both, which moved, or the ground is
    meant; how ground lies that shows nothing, where that is most of it."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What a case gave, beside the truth."""

    case: Case
    outcome: Outcome
    true_ce90_px: float
    """90th percentile of the correction's error on the dense grid of the common ground, px. Of a refused pair
    that of the correction that its points would give; NaN where they give none."""

    @property
    def grade(self) -> str:
        """The grade, or refused."""
        found = self.outcome.result.quality if self.outcome.accepted else None
        return found.grade if found else "refused"

    @property
    def expected_ce90_px(self) -> float:
        """What the registration expects; NaN where refused."""
        found = self.outcome.result.quality if self.outcome.accepted else None
        return found.expected_ce90_px if found else float("nan")

    @property
    def model(self) -> str:
        """The model chosen; a dash where refused."""
        found = self.outcome.result.model if self.outcome.accepted else None
        return found.name if found else "-"


def quality(data: Path, scratch: Path, runner: Runner, parts: Collection[str] = ()) -> Iterator[Table]:
    """Yield a table for each of the `QUALITY_PARTS` asked for, all by default."""
    for name in parts or QUALITY_PARTS:
        yield from QUALITY_PARTS[name](data, scratch, runner)


def _pairs(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield a table of all pairs: grade, expected and true accuracy."""
    made = [*_displaced(data, scratch), *_wrong_heights(data, scratch)]
    runner([job for case in made for job in (case.base, case.job) if job is not None])
    findings = [_finding(case, runner) for case in made]
    rows: list[list[Cell]] = [
        [
            f"{each.case.condition}: {each.case.ground}",
            each.grade,
            each.model,
            each.expected_ce90_px,
            each.true_ce90_px,
            _remark(each),
        ]
        for each in findings
    ]
    good = [each for each in findings if each.grade == "good"]
    fine = [each for each in findings if each.true_ce90_px < FINE_PX and not each.case.open_question]
    checks: list[Check] = [
        at_least("pairs", len(findings), MIN_PAIRS, digits=0),
        at_most(f"good pairs off by more than {OFF_PX:.0f} px", sum(map(_off, good)), 0, digits=0),
        at_most(
            f"good pairs off by more than {TIMES:.0f} x what is expected",
            sum(map(_unexpected, good)),
            0,
            digits=0,
        ),
        at_least(
            f"pairs truly better than {FINE_PX} px that are good",
            100 * sum(each.grade == "good" for each in fine) / len(fine),
            FINE_SHARE,
            "%",
            1,
        ),
    ]
    header = ("pair", "grade", "model", "CE90 expected", "true", "")
    counts = ", ".join(
        f"{sum(each.grade == grade for each in findings)} {grade}"
        for grade in ("good", "fair", "poor", "refused")
    )
    yield Table(f"Grades of {len(findings)} pairs ({counts}; {len(fine)} truly fine)", header, rows, checks)


QUALITY_PARTS: Final[dict[str, Callable[[Path, Path, Runner], Iterator[Table]]]] = {
    "pairs": _pairs,
    "stacks": stacks,
    "rigs": rigs,
    "blocks": blocks,
    "frame": frame,
    "periods": periods,
    "seams": seams,
}
"""What is graded."""


def _finding(case: Case, runner: Runner) -> Finding:
    (outcome,) = runner([case.job])
    correction = outcome.result.model if outcome.accepted else _of_refused(outcome)
    if correction is None:
        return Finding(case, outcome, float("nan"))
    base = None if case.base is None else runner([case.base])[0]
    errors = true_errors(case, outcome.result, correction, base)
    return Finding(case, outcome, float(np.percentile(np.linalg.norm(errors, axis=1), 90)))


def _of_refused(outcome: Outcome) -> Correction | None:
    """Return the correction that was not made: refusing a pair that it would have served counts, too."""
    found = outcome.registration
    if found is None:
        return None
    try:
        return fit_correction(found.tie_points, SETTINGS, found.window_px or 0.0, None).correction
    except InputError:
        return None


def true_errors(case: Case, found: Registration, correction: Correction, base: Outcome | None) -> Array:
    """Return the (n, 2) errors of a correction on a dense grid of the ground that both files show, px."""
    rows, cols = found.reference.grid.shape
    axes = [np.arange(STEP_PX / 2, side, STEP_PX) for side in (cols, rows)]
    at_px = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    if case.hidden is not None:
        col, row = at_px.astype(np.intp).T
        at_px = at_px[~case.hidden[row, col]]
    truth = case.truth(at_px, base)
    with np.errstate(invalid="ignore"):
        common = ((truth >= 0) & (truth < case.size_px)).all(axis=1)
    predicted = map_px(at_px[common], found.reference.grid, found.target.grid)
    return np.asarray(correction.forward(predicted) - truth[common])


def _off(each: Finding) -> bool:
    return each.true_ce90_px > OFF_PX


def _unexpected(each: Finding) -> bool:
    return each.true_ce90_px > TIMES * each.expected_ce90_px


def _remark(each: Finding) -> str:
    if each.grade == "good" and (_off(each) or _unexpected(each)):
        return "WRONG"
    if each.grade != "good" and each.true_ce90_px < FINE_PX:
        return each.case.open_question or "too strict"
    return ""


def _displaced(data: Path, scratch: Path) -> Iterator[Case]:
    """Yield pairs of bands, or of an image and its negative, the target displaced by a known field."""
    images = grounds(data)
    for number, (name, condition) in enumerate((CONDITIONS | HARDER).items()):
        for index in condition.grounds:
            ground = images[index]
            made = condition.make(ground, 100 * number + index)
            rows, cols = made.reference.shape
            begin = round((1 - condition.overlap) / 2 * cols)
            stem = f"quality_{number}_{index}"
            yield Case(
                name,
                ground.name,
                _job(
                    scratch / stem, made.reference[:, : cols - begin], as_uint8(made.target)[:, begin:], begin
                ),
                None if ground.exact else _job(scratch / f"quality_{index}", ground.reference, ground.target),
                partial(_displaced_to, made.field, begin),
                (cols - begin, rows),
                None if made.hidden is None else made.hidden[:, : cols - begin],
                made.open_question,
            )


def _job(stem: Path, reference: Image, target: Image, begin: int = 0) -> Job:
    """Write a pair; the target begins at a column of the reference."""
    paths = [Path(f"{stem}_{which}.tif") for which in ("reference", "target")]
    if not paths[1].exists():
        write(paths[0], reference, GRID, CRS)
        write(paths[1], target, GRID @ Affine.translation(begin, 0), CRS)
    return Job(*paths, SETTINGS, match_only=False)


def _displaced_to(field: Field, begin: int, at_px: Array, base: Outcome | None) -> Array:
    """Return where the ground is seen: as the undisplaced pair says, then moved."""
    correction = base.result.model if base else None
    placed = at_px if correction is None else correction.forward(at_px)
    return np.asarray(placed + field(placed) - [begin, 0.0])


def _wrong_heights(data: Path, scratch: Path) -> Iterator[Case]:
    """Yield the QuickBird image with elevation models that are ever more wrong."""
    reference, target = data / "cross_sensor/ngi_rgb_byte_1.tif", data / "rpc/qb2_basic1b.tif"
    dem = data / "rpc/dem_egm2008.tif"
    right = _with_heights(reference, target, dem)
    with rasterio.open(target) as file:
        size = file.width, file.height
    for name, wrong in _wrong_models(dem, scratch).items():
        job = _with_heights(reference, target, wrong)
        yield Case(name, "aerial - QuickBird", job, right, _by_right_heights, size)


def _with_heights(reference: Path, target: Path, dem: Path) -> Job:
    return Job(reference, target, replace(SETTINGS, dem=dem, dem_vertical=HEIGHT_M), match_only=False)


def _wrong_models(dem: Path, scratch: Path) -> dict[str, Path]:
    with rasterio.open(dem) as file:
        heights, profile = file.read(1), file.profile
    middle = float(np.nanmedian(heights))
    made = {
        "DEM 50 m too high": (heights + 50, 0),
        "DEM moved by 240 m": (heights, 10),
        "DEM without relief": (np.where(np.isfinite(heights), middle, np.nan), 0),
        "DEM upside down": (2 * middle - heights, 0),
        "DEM 15 m too high": (heights + 15, 0),
        "DEM moved by 60 m": (heights, 2.5),
    }
    paths = {}
    for number, (name, (values, moved)) in enumerate(made.items()):
        paths[name] = scratch / f"dem_{number}.tif"
        place = profile["transform"] @ Affine.translation(moved, 0)
        with rasterio.open(paths[name], "w", **{**profile, "transform": place}) as file:
            file.write(values.astype(profile["dtype"]), 1)
    return paths


def _by_right_heights(at_px: Array, base: Outcome | None) -> Array:
    """Return where the correction found with the right elevation model puts the ground."""
    if base is None or base.result.model is None:
        raise RuntimeError("the pair with the right elevation model was not registered")
    found = base.result
    return np.asarray(found.model.forward(map_px(at_px, found.reference.grid, found.target.grid)))
