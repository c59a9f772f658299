"""Any pose: real pairs of six kinds, pairs warped by drawn poses, and unrelated pairs that must be refused.

Everything is the default call on files without georeferencing, unless it says otherwise.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

import cv2
import numpy as np

from benchmarks.pairs import landsat, read, read_masked, rgbnir, uav, write
from benchmarks.poses import (
    SCALES,
    TO_CORNERS,
    Warp,
    draw_perspective,
    draw_stretch,
    draw_warp,
    grid_px,
    inside,
    mapped,
    mean_distance_px,
    mutual_information,
    nearest_rotation,
    read_similarity,
    share_of,
    spread_sample,
    warp_image,
)
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.scores import distance_to_lines, fundamental_matrix, score
from benchmarks.studies.refusal import CRS, GRID
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from benchmarks.timing import cheapest
from benchmarks.unrelated import PAIRINGS, REPOSITORY, Part, unrelated_chips, unrelated_parts
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.matching.pose.grey_search import poses_by_grey_values
from pcwlad_geo.matching.pose.search import search_pose
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import map_px
from pcwlad_geo.registration import register_pair

sys.path.insert(0, str(REPOSITORY / "sample_data"))
from make_sample_data import true_displacement_px

SETTINGS: Final = Settings()
"""The default call."""
SEED: Final = 16
WRONG_PX: Final = 5.0
"""An accepted pair with a larger mean error is wrong."""
RIGHT_PX: Final = 3.0
MEDIAN_PX: Final = 1.0
BEST_OF_OTHERS_PX: Final = 47.0
"""Least mean corner error of a learned matcher on 600 pairs of the set (arXiv 2604.10217)."""
BEYOND: Final = {"affine": (draw_stretch, 95.0), "perspective": (draw_perspective, 85.0)}
"""What is drawn, and the percentage that must register."""
BEYOND_KINDS: Final = ("Optical-Optical", "Optical-Infrared", "Nighttime", "Optical-Depth")
UNDONE: Final = {
    "Optical-Map": 97.0,
    "Optical-Infrared": 97.0,
    "Optical-Optical": 97.0,
    "Nighttime": 100.0,
    "Optical-Depth": 100.0,
}
"""Percentage that must register where the pose is undone; of radar the set tells no pose but a rotation."""
SAR: Final = "Optical-SAR"
SAR_SIDE_PX: Final = 256
SAR_ABOUT_PX: Final = (128.5, 128.5)
"""Corner-based, for (128, 128) of 0-based pixel centres."""
WARPS_A_GROUND: Final = 80
WARPED_SHARE: Final = 98.0
RMSE_RATIO: Final = 1.15
SEARCHED: Final = (0.25, 4.0)
"""Scales that the tool looks for: a pair of two pixel sizes is not warped beyond them."""
UNRELATED_CASES: Final = 2000
UNRELATED_AT_A_TIME: Final = 200
CHIP_CASES: Final = 1000
CHIP_SETTINGS: Final = Settings(features=300)
NODATA: Final = -9999.0
SEARCH_S, REFUSED_S = 2.0, 4.0
UNSEARCHED_RATIO: Final = 1.02


def pose(
    data: Path, scratch: Path, runner: Runner, share: float = 1.0, parts: Sequence[str] = ()
) -> Iterator[Table]:
    """Yield tables as they are done, so that a study that is broken off has said something.

    Parameters
    ----------
    data, scratch : Path
    runner : Runner
    share : float
        Of the cases, spread over all of them.
    parts : sequence of str
        Names of `PARTS`; none: all.
    """
    for name in parts or PARTS:
        yield from PARTS[name](data, scratch, runner, share)


@dataclass(frozen=True, slots=True)
class Trial:
    """A related pair: what came of it."""

    name: str
    outcome: Outcome
    error_px: float
    """Mean error of the correction on a grid; NaN where refused."""
    right_px: float = RIGHT_PX
    """Largest error of a pair that counts as registered."""
    shared: tuple[float, float] | None = None
    """Mutual information of the grey values where the correction puts the target, and by the truth."""
    corners_px: float = math.nan
    """Mean error at the four corners of the reference; NaN where refused."""

    @property
    def verdict(self) -> Literal["registered", "truth off", "inexact", "WRONG", "refused"]:
        """What the pair counts as."""
        if math.isnan(self.error_px):
            return "refused"
        if self.error_px <= self.right_px:
            return "registered"
        if self.shared is not None and self.shared[0] > self.shared[1]:
            return "truth off"
        return "WRONG" if self.error_px > WRONG_PX else "inexact"


HEADER: Final = (
    "",
    "pairs",
    "registered %",
    "median error, px",
    "truth off",
    "inexact",
    "WRONG",
    "refused",
    "CPU s a pair",
)


def _counts(name: str, trials: Sequence[Trial]) -> list[Cell]:
    verdicts = [trial.verdict for trial in trials]
    return [
        name,
        len(trials),
        f"{_registered(trials):.1f}",
        _median_px(trials),
        *(verdicts.count(each) for each in ("truth off", "inexact", "WRONG", "refused")),
        f"{np.mean([trial.outcome.cpu_s for trial in trials]):.1f}",
    ]


def _registered(trials: Sequence[Trial]) -> float:
    """Return the percentage of pairs registered, without those whose truth is off."""
    return share_of([trial.verdict == "registered" for trial in trials if trial.verdict != "truth off"])


def _wrong(trials: Sequence[Trial]) -> int:
    return sum(trial.verdict == "WRONG" for trial in trials)


def _median_px(trials: Sequence[Trial]) -> float:
    errors = [trial.error_px for trial in trials if trial.verdict == "registered"]
    return float(np.median(errors)) if errors else math.nan


def _misses(title: str, trials: Sequence[Trial]) -> Table:
    """List what was not registered, and why."""
    rows: list[list[Cell]] = [
        [trial.name, trial.verdict, trial.error_px, _shared(trial), _told(trial.outcome)]
        for trial in trials
        if trial.verdict != "registered"
    ]
    title = f"{title}: {len(trials) - len(rows)} of {len(trials)} registered by the truths given"
    return Table(title, ("not registered", "", "error, px", "", ""), rows)


def _shared(trial: Trial) -> str:
    """Return which of found and true pose makes grey values tell more of each other: some truths are off."""
    if trial.shared is None:
        return ""
    found, true = trial.shared
    return f"mutual information {found:.4f}, of the truth {true:.4f}"


def _told(outcome: Outcome) -> str:
    """Return why a pair was refused, or how it was found."""
    if not outcome.accepted:
        return (outcome.reason or "")[:90]
    start = outcome.result.prealignment
    return f"{start.method}, {len(outcome.points)} points, {start.pose or ''}"


def _corrected_px(outcome: Outcome, at_px: Array) -> Array | None:
    """Return where the correction puts (n, 2) reference px in the target; None where refused."""
    if not outcome.accepted or outcome.result.model is None:
        return None
    found = outcome.result
    predicted = map_px(at_px, found.reference.grid, found.target.grid)
    return np.asarray(found.model.forward(predicted))  # type: ignore[union-attr]


# --- the pairs of data/pose


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of pairs, and what must be reached with it."""

    share: float
    """Percentage registered."""
    right_px: float = RIGHT_PX


KINDS: Final[dict[str, Kind]] = {
    "Optical-Depth": Kind(95.0),
    "Optical-Optical": Kind(95.0),
    "Optical-Infrared": Kind(85.0),
    "Nighttime": Kind(85.0),
    "Optical-SAR": Kind(75.0),
    "Optical-Map": Kind(75.0, 5.0),
}


def _real_pairs(data: Path, _scratch: Path, runner: Runner, share: float) -> Iterator[Table]:
    """Yield a table of what was not registered for each kind, and one of all kinds."""
    of_kind: dict[str, list[Trial]] = {}
    for name, kind in KINDS.items():
        folder, chosen = _chosen(data, name, share)
        jobs = [_pair_job(folder, number) for number in chosen]
        of_kind[name] = [
            _compared(folder, number, outcome, kind.right_px)
            for number, outcome in zip(chosen, runner(jobs), strict=True)
        ]
        yield _misses(name, of_kind[name])
    every = [trial for trials in of_kind.values() for trial in trials]
    checks: list[Check] = []
    for name, trials in of_kind.items():
        reach = KINDS[name]
        what = f"{name}: within {reach.right_px:.0f} px"
        checks.append(at_least(what, _registered(trials), reach.share, "%", 1))
        checks.append(at_most(f"{name}: median of those", _median_px(trials), MEDIAN_PX, "px", 2))
    checks.append(at_most(f"accepted, off by more than {WRONG_PX:.0f} px", _wrong(every), 0, digits=0))
    named = [*of_kind.items(), ("all", every)]
    rows = [_counts(name, trials) for name, trials in named]
    yield Table(f"{len(every)} pairs of data/pose", HEADER, rows, checks)
    yield _corner_errors(named)


def _corner_errors(named: Sequence[tuple[str, Sequence[Trial]]]) -> Table:
    """Return the mean corner errors by the truths given, as others state theirs, with what was refused."""
    rows: list[list[Cell]] = []
    for name, trials in named:
        errors_px = np.array([trial.corners_px for trial in trials if trial.verdict != "refused"])
        refused = len(trials) - len(errors_px)
        if refused == len(trials):
            rows.append([name, len(trials), refused, "-", "-", "-"])
            continue
        even = f"{(BEST_OF_OTHERS_PX * len(trials) - errors_px.sum()) / refused:.0f}" if refused else "-"
        found = float(errors_px.mean()), float(np.median(errors_px)), even
        rows.append([name, len(trials), refused, *found])
    header = ("", "pairs", "refused", "mean corner error, px", "median", "a refusal that costs as much, px")
    return Table(f"Corner errors, beside {BEST_OF_OTHERS_PX} px", header, rows)


def _chosen(data: Path, kind: str, share: float) -> tuple[Path, list[int]]:
    """Return the folder of a kind, and the numbers of its pairs that are tried."""
    folder = data / "pose" / kind
    numbers = sorted(int(path.stem[3:]) for path in folder.glob("gt_*.txt"))
    return folder, [numbers[index] for index in spread_sample(len(numbers), share, SEED)]


def _pair_job(folder: Path, number: int) -> Job:
    return Job(folder / f"pair{number}_1.jpg", folder / f"pair{number}_2.jpg", SETTINGS, match_only=False)


def _compared(folder: Path, number: int, outcome: Outcome, right_px: float) -> Trial:
    """Compare a correction with the truth on a grid of the whole reference."""
    name = f"{folder.name} {number}"
    images = [read(folder / f"pair{number}_{which}.jpg") for which in (1, 2)]
    at_px = grid_px(images[0].shape)
    found = _corrected_px(outcome, at_px)
    if found is None:
        return Trial(name, outcome, math.nan, right_px)
    true = _true_px(folder, number, at_px, found)
    shared = [
        mutual_information(*images, AffineTransform.fit(at_px, places).rows) for places in (found, true)
    ]
    corners = np.isin(at_px, [at_px[0], at_px[-1]]).all(axis=1)
    return Trial(
        name,
        outcome,
        mean_distance_px(found, true),
        right_px,
        (shared[0], shared[1]),
        mean_distance_px(found[corners], true[corners]),
    )


def _true_px(folder: Path, number: int, at_px: Array, found: Array) -> Array:
    """Return where reference px truly are in the target."""
    if folder.name == SAR:
        return nearest_rotation(_resized(at_px), found, SAR_ABOUT_PX)
    return mapped(read_similarity(folder / f"gt_{number}.txt"), at_px)


def _resized(at_px: Array) -> Array:
    """Return where places of an image are after it was resized to 256 px a side; the last is its corner."""
    return np.asarray(at_px * (SAR_SIDE_PX / at_px[-1]))


# --- the same pairs, their pose undone by the truth


def _undone(data: Path, scratch: Path, runner: Runner, share: float) -> Iterator[Table]:
    """Yield the same of pairs whose targets lie where the truth puts them, and have georeferencing."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for name, least in UNDONE.items():
        folder, chosen = _chosen(data, name, share)
        jobs = [_undone_job(folder, number, scratch) for number in chosen]
        trials = [
            _compared_undone(f"{name} {number}", job, outcome, KINDS[name].right_px)
            for number, job, outcome in zip(chosen, jobs, runner(jobs), strict=True)
        ]
        yield _misses(f"{name}, pose undone", trials)
        rows.append(_counts(name, trials))
        checks.append(at_least(f"{name}, undone: registered", _registered(trials), least, "%", 1))
        checks.append(at_most(f"{name}, undone: wrong", _wrong(trials), 0, digits=0))
    yield Table("Pairs of data/pose, their pose undone", HEADER, rows, checks)


def _undone_job(folder: Path, number: int, scratch: Path) -> Job:
    """Write both images of a pair on one grid, the target by the mean of several samples a pixel."""
    reference, target = (read(folder / f"pair{number}_{which}.jpg") for which in (1, 2))
    to_target = read_similarity(folder / f"gt_{number}.txt")
    samples = max(1, math.ceil(_scale_of(to_target)))
    finer = np.linalg.inv(TO_CORNERS) @ to_target @ np.diag([1 / samples, 1 / samples, 1.0]) @ TO_CORNERS
    rows, cols = reference.shape

    def placed(image: Array, how: int) -> Array:
        size = cols * samples, rows * samples
        fine = cv2.warpAffine(image, finer[:2], size, flags=how | cv2.WARP_INVERSE_MAP)
        return np.asarray(cv2.resize(fine, (cols, rows), interpolation=cv2.INTER_AREA))

    known = placed(np.ones(target.shape, np.float32), cv2.INTER_LINEAR) > 0.999
    values = np.where(known, placed(target.astype(np.float32), cv2.INTER_CUBIC), NODATA).astype(np.float32)
    stem = f"{folder.name} {number}"
    return Job(
        write(scratch / f"{stem} r.tif", reference.astype(np.float32), GRID, CRS),
        write(scratch / f"{stem} t.tif", values, GRID, CRS, NODATA),
        SETTINGS,
        match_only=False,
    )


def _scale_of(matrix: Array) -> float:
    """Return the target px per reference px of a (3, 3) similarity."""
    return math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))


def _compared_undone(name: str, job: Job, outcome: Outcome, right_px: float) -> Trial:
    """Compare a correction with none, on a grid of what the target shows."""
    image, (moving, valid, _) = read(job.reference), read_masked(job.target, 1)
    at_px = grid_px(image.shape)
    at_px = at_px[valid[tuple(np.minimum(at_px, np.array(image.shape[::-1]) - 1).astype(int).T[::-1])]]
    found = _corrected_px(outcome, at_px)
    if found is None:
        return Trial(name, outcome, math.nan, right_px)
    shared = [
        mutual_information(image, moving, AffineTransform.fit(at_px, there).rows) for there in (found, at_px)
    ]
    return Trial(name, outcome, mean_distance_px(found, at_px), right_px, (shared[0], shared[1]))


# --- pairs of which the target is warped


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """A pair as it is, and what is known of it."""

    name: str
    base: Job
    truth: Callable[[Array, Outcome], Array] | None
    """(n, 2) reference px, and what the pair gave as it is, to target px; None: what the pair gave."""
    target_per_reference: float = 1.0
    """Target px per reference px."""
    epipolar: bool = False
    """Whether points are compared with epipolar lines, as of another viewpoint."""

    @property
    def scales(self) -> tuple[float, float]:
        """Scales from which the target's is drawn."""
        low, high = (limit / self.target_per_reference for limit in SEARCHED)
        return max(SCALES[0], low), min(SCALES[1], high)

    def true_px(self, at_px: Array, base: Outcome) -> Array:
        """Return where (n, 2) reference px are in the target as it is."""
        found = self.truth(at_px, base) if self.truth else _corrected_px(base, at_px)
        if found is None:
            raise RuntimeError(f"{self.name} was not registered as it is: {base.reason}")
        return found

    def errors_px(self, points: Array, base: Outcome) -> Array:
        """Return (n, 1) or (n, 2) errors of (n, 4) points, target px."""
        if self.epipolar:
            return distance_to_lines(points, fundamental_matrix(base.positions))
        return points[:, 2:] - self.true_px(points[:, :2], base)


def grounds(data: Path) -> list[Ground]:
    """Return the pairs whose targets are warped."""
    sample, sensors = REPOSITORY / "sample_data", data / "cross_sensor"
    one, two, three = landsat(data), rgbnir(data), uav(data)
    bands = Settings(ref_band=1, tgt_band=4)
    across = sensors / "sentinel2_b432_byte.tif", sensors / "landsat8_byte.tif"
    return [
        Ground("LS1", _as_it_is(one.reference, one.target), partial(moved, one.truth)),
        Ground("RN1", _as_it_is(two.reference, two.target), partial(moved, two.truth)),
        Ground("sample", _as_it_is(sample / "landsat_b4.tif", sample / "landsat_b10.tif"), _displaced_sample),
        Ground("Sentinel-2 - Landsat", _as_it_is(*across, bands), None, 1 / 3),
        Ground("UAV-1", _as_it_is(three.reference, three.target), None, epipolar=True),
    ]


def _as_it_is(reference: Path, target: Path, settings: Settings = SETTINGS) -> Job:
    return Job(reference, target, settings, match_only=False)


def moved(truth_xy_px: tuple[float, float], at_px: Array, _base: Outcome) -> Array:
    """Return (n, 2) places after a known translation."""
    return np.asarray(at_px + truth_xy_px)


def _displaced_sample(at_px: Array, base: Outcome) -> Array:
    predicted = map_px(at_px, base.result.reference.grid, base.result.target.grid)
    return np.asarray(predicted + true_displacement_px(predicted))


@dataclass(frozen=True, slots=True)
class Precision:
    """Squared errors of the points of a warped pair, and of the same part of the pair as it is."""

    warped: tuple[int, float]
    """Number of points, and their mean square error, px²."""
    as_it_is: tuple[int, float]

    @property
    def ratio(self) -> float:
        """RMSE of the warped pair as a multiple of the other's."""
        return math.sqrt(self.warped[1] / self.as_it_is[1])


def _warped(data: Path, scratch: Path, runner: Runner, share: float) -> Iterator[Table]:
    """Yield a table of what was not registered for each pair, and one of all of them."""
    every: list[Trial] = []
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for ground in grounds(data):
        numbers = spread_sample(WARPS_A_GROUND, share, SEED)
        with TemporaryDirectory(dir=scratch) as folder:
            found = _warp_trials(ground, numbers, Path(folder), runner)
        trials = [trial for trial, _ in found]
        yield _misses(ground.name, trials)
        every += trials
        precisions = [precision for _, precision in found if precision is not None]
        ratios = [precision.ratio for precision in precisions] or [math.nan]
        pooled = pooled_ratio(precisions)
        rows.append([*_counts(ground.name, trials), float(np.median(ratios)), max(ratios), pooled])
        checks.append(at_most(f"{ground.name}: RMSE, as a multiple", pooled, RMSE_RATIO, digits=2))
    checks = [
        at_least("warped pairs registered", _registered(every), WARPED_SHARE, "%", 1),
        at_most(f"accepted, off by more than {WRONG_PX:.0f} px", _wrong(every), 0, digits=0),
        *checks,
    ]
    rows.append([*_counts("all", every), "", "", ""])
    header = (*HEADER, "RMSE, multiple: median", "largest", "all points")
    yield Table(f"{len(every)} pairs with a warped target", header, rows, checks)


def pooled_ratio(precisions: Sequence[Precision]) -> float:
    """Return the ratio of the RMSEs of all points; NaN of none."""
    if not precisions:
        return math.nan
    pooled = [
        np.average([mean for _, mean in sets], weights=[count for count, _ in sets])
        for sets in ([each.warped for each in precisions], [each.as_it_is for each in precisions])
    ]
    return math.sqrt(pooled[0] / pooled[1])


def _warp_trials(
    ground: Ground,
    numbers: Sequence[int],
    folder: Path,
    runner: Runner,
    draw: Callable[[np.random.Generator, tuple[float, float]], Warp] = draw_warp,
) -> list[tuple[Trial, Precision | None]]:
    warps = [
        draw(np.random.default_rng([SEED, number, *ground.name.encode()]), ground.scales)
        for number in numbers
    ]
    (base,) = runner([ground.base])
    reference = _without_place(ground.base.reference, int(ground.base.settings.ref_band), folder)
    jobs = [
        _as_it_is(reference, _warped_target(ground.base, warp, folder / f"{number}.tif"))
        for number, warp in zip(numbers, warps, strict=True)
    ]
    outcomes = Runner(runner.processes)(jobs)  # one that forgets: tables of points are large
    rows, cols = read(ground.base.target).shape
    shape = rows, cols
    found = []
    for number, warp, outcome in zip(numbers, warps, outcomes, strict=True):
        trial = Trial(
            f"{ground.name} {number}: {warp}", outcome, _warp_error_px(ground, base, warp, outcome, shape)
        )
        precise = precision_of(ground, base, warp, outcome, shape) if trial.verdict == "registered" else None
        found.append((trial, precise))
    return found


def _without_place(path: Path, band: int, folder: Path) -> Path:
    """Write a band without georeferencing."""
    image, _, nodata = read_masked(path, band)
    return write(folder / "reference.tif", image, nodata=nodata)


def _warped_target(base: Job, warp: Warp, path: Path) -> Path:
    image, valid, _ = read_masked(base.target, int(base.settings.tgt_band))
    image, seen = warp_image(image, valid, warp)
    return write(path, np.where(seen, image, NODATA).astype(np.float32), nodata=NODATA)


def _warp_error_px(
    ground: Ground, base: Outcome, warp: Warp, outcome: Outcome, shape: tuple[int, int]
) -> float:
    """Return the mean error of a correction on the ground that is seen, px of the warped target."""
    at_px = grid_px(read(ground.base.reference).shape)
    true = ground.true_px(at_px, base)
    warped = mapped(warp.matrix(shape), true)
    common = inside(true, shape) & inside(warped, warp.canvas(shape))
    found = _corrected_px(outcome, at_px[common])
    return math.nan if found is None else mean_distance_px(found, warped[common])


def precision_of(
    ground: Ground, base: Outcome, warp: Warp, outcome: Outcome, shape: tuple[int, int]
) -> Precision | None:
    """Compare the points of a warped pair with those that the pair as it is has on the same ground.

    The errors are taken in the original target, in px of the warped one where that is coarser.
    """
    matrix = warp.matrix(shape)
    points = outcome.positions
    original = np.hstack([points[:, :2], mapped(warp.inverse(shape), points[:, 2:])])
    warped = score(ground.errors_px(original, base) * min(1.0, warp.scale))
    seen = inside(mapped(matrix, base.positions[:, 2:]), warp.canvas(shape))
    as_it_is = score(ground.errors_px(base.positions[seen], base))
    if not (warped.correct and as_it_is.correct):
        return None
    return Precision((warped.correct, warped.rmse_px**2), (as_it_is.correct, as_it_is.rmse_px**2))


def _beyond_similarities(data: Path, scratch: Path, runner: Runner, share: float) -> Iterator[Table]:
    """Yield, for pairs of data/pose that register as they are, how they do when the target is warped more.

    Errors count from what the pair gives as it is.
    """
    for what, (draw, reach) in BEYOND.items():
        every: list[Trial] = []
        rows: list[list[Cell]] = []
        for kind in BEYOND_KINDS:
            found = [
                trial
                for ground in _registering(data / "pose" / kind, runner, share)
                for trial in _warp_once(ground, draw, scratch, runner)
            ]
            yield _misses(f"{kind}, {what}", found)
            rows.append(_counts(kind, found))
            every += found
        checks = [
            at_least(f"{what}: registered", _registered(every), reach, "%", 1),
            at_most(f"{what}: accepted, off by more than {WRONG_PX:.0f} px", _wrong(every), 0, digits=0),
        ]
        yield Table(f"{len(every)} pairs, {what}", HEADER, [*rows, _counts("all", every)], checks)


def _registering(folder: Path, runner: Runner, share: float) -> list[Ground]:
    """Return the pairs of a folder that register as they are, and rightly as far as is known."""
    numbers = sorted(int(path.stem[3:]) for path in folder.glob("gt_*.txt"))
    chosen = [numbers[index] for index in spread_sample(len(numbers), share, SEED)]
    jobs = [_pair_job(folder, number) for number in chosen]
    trials = [
        (job, _compared(folder, number, outcome, RIGHT_PX))
        for number, job, outcome in zip(chosen, jobs, runner(jobs), strict=True)
    ]
    return [
        Ground(trial.name, job, None)
        for job, trial in trials
        if trial.verdict in ("registered", "truth off", "inexact")
    ]


def _warp_once(
    ground: Ground,
    draw: Callable[[np.random.Generator, tuple[float, float]], Warp],
    scratch: Path,
    runner: Runner,
) -> list[Trial]:
    with TemporaryDirectory(dir=scratch) as folder:
        return [trial for trial, _ in _warp_trials(ground, [0], Path(folder), runner, draw)]


# --- unrelated pairs


def _unrelated(
    data: Path, scratch: Path, runner: Runner, share: float, *, chips: bool = False
) -> Iterator[Table]:
    """Yield a table after every batch: how many pairs, or `chips`, so far, and those accepted."""
    numbers = spread_sample(CHIP_CASES if chips else UNRELATED_CASES, share, SEED)
    tried = dict.fromkeys(PAIRINGS, 0)
    refused_s: list[float] = []
    accepted: list[tuple[str, Outcome]] = []
    for begin in range(0, len(numbers), UNRELATED_AT_A_TIME):
        batch = numbers[begin : begin + UNRELATED_AT_A_TIME]
        with TemporaryDirectory(dir=scratch) as folder:
            made = [_unrelated_job(data, number, Path(folder), chips=chips) for number in batch]
            outcomes = Runner(runner.processes)([job for _, _, job in made])  # one that forgets
        for (pairing, name, _), outcome in zip(made, outcomes, strict=True):
            tried[pairing] += 1
            accepted += [(name, outcome)] if outcome.accepted else []
            refused_s += [] if outcome.accepted else [outcome.cpu_s]
        rows: list[list[Cell]] = [[pairing, count, ""] for pairing, count in tried.items()]
        rows += [[f"  ACCEPTED {name}", "", _told(outcome)] for name, outcome in accepted]
        done = begin + len(batch)
        what = "chips" if chips else "pairs"
        title = f"Unrelated {what}, {done} of {len(numbers)}: {len(accepted)} accepted"
        title += f", {np.mean(refused_s or math.nan):.1f} s of CPU a refused one"
        last = (
            [at_most(f"unrelated {what} accepted", len(accepted), 0, digits=0)]
            if done == len(numbers)
            else []
        )
        yield Table(title, ("", "pairs", ""), rows, last)


def _unrelated_job(data: Path, number: int, folder: Path, *, chips: bool) -> tuple[str, str, Job]:
    """Return what is paired, a name, and the job. Half of the pairs claim the same georeferencing."""
    pairing, first, second = (unrelated_chips if chips else unrelated_parts)(data, number, SEED)
    grid, crs = (GRID, CRS) if number // len(PAIRINGS) % 2 else (None, None)

    def written(which: str, part: Part) -> Path:
        return write(folder / f"{number}_{which}.tif", part.image, grid, crs, part.nodata)

    settings = CHIP_SETTINGS if chips else SETTINGS
    job = Job(written("reference", first), written("target", second), settings, match_only=False)
    return pairing, f"{number}: {first} - {second}", job


# --- time


def _searched(*images: Array) -> None:
    """Search as a job does that finds no start: by the structure, and by the grey values too."""
    search = search_pose(*images)
    if search.proposal is None or not search.proposal.accepted:
        list(poses_by_grey_values(search))


def _time(data: Path, scratch: Path, _runner: Runner, _share: float) -> Iterator[Table]:
    """Yield the CPU time of the search alone, and of a match that needs none, left to find out and told."""
    cv2.setNumThreads(1)
    side = np.s_[:512, :512]
    reference, near = read(landsat(data).reference)[side], read(rgbnir(data).reference)[side]
    target = read(landsat(data).target)[side]
    everywhere = np.ones(target.shape, bool)
    turned, seen = warp_image(target, everywhere, Warp(30.0, 1.0, 0.0, (0.0, 0.0)))
    searches = [
        partial(_searched, reference.astype(float), turned, everywhere, seen),
        partial(_searched, reference.astype(float), near.astype(float), everywhere, everywhere),
    ]
    related, unrelated = cheapest(searches, 2)
    placed = [
        write(scratch / f"{name}.tif", image, GRID, CRS) for name, image in (("r", reference), ("t", target))
    ]
    told: list[Settings] = [replace(SETTINGS, prealign=which) for which in ("auto", "georef")]
    open_, sound = cheapest([partial(register_pair, *placed, each, match_only=True) for each in told], 5)
    checks = [
        at_most("pose search, 512 x 512 px: CPU", related.cpu_s, SEARCH_S, "s", 2),
        at_most("of an unrelated pair", unrelated.cpu_s, REFUSED_S, "s", 2),
        at_most(
            "match with sound georeferencing, as a multiple", open_.cpu_s / sound.cpu_s, UNSEARCHED_RATIO
        ),
    ]
    rows: list[list[Cell]] = [
        ["search: turned by 30 degrees", related.cpu_s],
        ["search: unrelated", unrelated.cpu_s],
        ["match, georeferencing sound: --prealign auto", open_.cpu_s],
        ["match, georeferencing sound: --prealign georef", sound.cpu_s],
    ]
    yield Table("512 x 512 px, one core", ("", "CPU s"), rows, checks)


PARTS: Final[dict[str, Callable[[Path, Path, Runner, float], Iterator[Table]]]] = {
    "time": _time,
    "pairs": _real_pairs,
    "undone": _undone,
    "warped": _warped,
    "beyond": _beyond_similarities,
    "unrelated": _unrelated,
    "chips": partial(_unrelated, chips=True),
}
"""What the study consists of, the shortest first."""
