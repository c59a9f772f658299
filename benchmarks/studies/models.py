"""Corrections against a truth known everywhere: the model taken, its error, its predicted sigma, one warp."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial import Delaunay

from benchmarks.displacing import Field, displace
from benchmarks.pairs import as_uint8, landsat, read, rgbnir, with_gamma, with_noise, write
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.scenes import countryside, folds, image_pair
from benchmarks.tables import Cell, Check, Table, at_most, within
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.job import register
from pcwlad_geo.options import Settings

AMPLITUDE_PX: Final = 2.0
SHIFT_PX: Final = (2.37, -1.61)
STEP_PX: Final = 8
FIELD_LIMIT_PX, SHIFT_LIMIT_PX, AGAIN_LIMIT_PX = 0.08, 0.01, 0.03
SHORT_LIMIT_PX: Final = 0.12
"""For the measured field, where waves of 400 px are added."""
LOCAL: Final = ("polynomial2", "polynomial3", "tps", "field")
SEEDS: Final = (301, 302, 303)
PLAIN: Final = Settings(prealign="none", jobs=1)

"""Positions (..., 2) px to displacements: what is at p moves to p + field(p)."""


def models(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield tables: real targets displaced by fields and by a shift, scenes with exact truth, second runs."""
    yield from _real(data, scratch, runner)
    yield _short(data, scratch, runner)
    yield _again(data, scratch, runner)
    yield _exact(scratch, runner)


@dataclass(frozen=True, slots=True)
class Source:
    """A real pair that lies nearly in place."""

    name: str
    reference: Path
    target: Path
    exact: bool
    """Whether it lies exactly in place: the reference is made from the target."""


def waves(xy_px: Array, *, wavelength_px: float, turn: float) -> Array:
    """Return a smooth displacement of ±2 px."""
    x, y = np.moveaxis(xy_px, -1, 0)
    k, c, s = 2 * np.pi / wavelength_px, np.cos(turn), np.sin(turn)
    sines = (np.sin(k * (c * x + s * y) + 0.4 + turn), np.sin(k * (s * x - c * y) + 2.1 - turn))
    return np.asarray(AMPLITUDE_PX * np.stack(sines, axis=-1))


def constant(xy_px: Array) -> Array:
    """Return the same displacement everywhere."""
    return np.broadcast_to(np.array(SHIFT_PX), xy_px.shape)


FIELDS: Final[dict[str, Field]] = {
    "waves of 1000 px": partial(waves, wavelength_px=1000.0, turn=0.64),
    "waves of 1500 px": partial(waves, wavelength_px=1500.0, turn=2.2),
    "shift": constant,
}


def _sources(data: Path, scratch: Path) -> list[Source]:
    """Return images with their own noisy negatives, and pairs of bands; the bands of one file as files."""
    path = data / "cross_sensor/sentinel2_b432_byte.tif"
    red, blue = (write(scratch / f"s2_{band}.tif", read(path, band)) for band in (1, 3))
    visible, close = landsat(data), rgbnir(data)
    images = [
        ("Landsat thermal", visible.undisplaced),
        ("Sentinel-2 blue", blue),
        ("near infrared", close.undisplaced),
    ]
    return [
        *(
            Source(
                f"{name} - its negative", _negative(image, scratch / f"negative_{number}.tif"), image, True
            )
            for number, (name, image) in enumerate(images)
        ),
        Source("Landsat blue - thermal", visible.reference, visible.undisplaced, False),
        Source("Sentinel-2 red - blue", red, blue, False),
    ]


def _negative(image: Path, path: Path) -> Path:
    """Write the image as another band might show it: dark for bright, bent, with noise."""
    bent = with_gamma(255 - as_uint8(read(image)), 0.7)
    return write(path, with_noise(bent, 3.0, seed=5))


def _real(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Compare corrections with the field: added to what the undisplaced pair says, where bands differ."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for number, source in enumerate(_sources(data, scratch)):
        image = read(source.target)
        moved = [
            write(scratch / f"models_{number}_{index}.tif", displace(image, field))
            for index, field in enumerate(FIELDS.values())
        ]
        outcomes = runner([Job(source.reference, path, PLAIN, False) for path in moved])
        base = None if source.exact else runner([Job(source.reference, source.target, PLAIN, False)])[0]
        for (name, field), outcome in zip(FIELDS.items(), outcomes, strict=True):
            truth = partial(_moved, field) if base is None else partial(_after, base, field)
            what = f"{source.name}, {name}"
            rows.append(_row(what, [outcome], [truth]))
            checks += _checks(what, outcome, truth, field is constant)
    yield Table(
        f"Real targets displaced by known fields (+-{AMPLITUDE_PX:.0f} px), model auto, places in the hull",
        ("pair", "model", "points", "RMSE", "largest", "sigma", "68 %", "95 %"),
        rows,
        checks,
    )


def ripples(xy_px: Array) -> Array:
    """Return waves of 1000 px (±2 px) with waves of 400 px (±1 px) added."""
    x, y = np.moveaxis(xy_px, -1, 0)
    k, c, s = 2 * np.pi / 400.0, np.cos(1.1), np.sin(1.1)
    short = np.stack([np.sin(k * (c * x + s * y) + 0.9), np.sin(k * (s * x - c * y) + 1.7)], axis=-1)
    return FIELDS["waves of 1000 px"](xy_px) + short


def _short(data: Path, scratch: Path, runner: Runner) -> Table:
    """Compare models, fitted to the same tie points, with a field that varies within a few windows."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for number, source in enumerate(_sources(data, scratch)):
        moved = write(scratch / f"ripples_{number}.tif", displace(read(source.target), ripples))
        (outcome,) = runner([Job(source.reference, moved, PLAIN, False)])
        base = None if source.exact else runner([Job(source.reference, source.target, PLAIN, False)])[0]
        truth = partial(_moved, ripples) if base is None else partial(_after, base, ripples)
        found, places = outcome.result, _places(outcome)
        if found.model is None or found.selection is None:
            raise RuntimeError(f"{source.name} was refused: {outcome.reason}")
        points = found.tie_points.select("fit")
        given = points.predicted_px, points.target_px, points.covariance_px2
        errors = {}
        for name in ("affine", "polynomial3", "tps", "field"):
            fit = MODELS[name].fit(*given, footprint_px=found.selection.footprint_px)
            missed = fit.correction.forward(places) - truth(places)
            errors[name] = float(np.sqrt((missed**2).sum(axis=1).mean()))
        at_points = points.target_px - truth(points.predicted_px)
        own = float(np.sqrt((at_points**2).sum(axis=1).mean()))
        rows.append([source.name, found.model.name, len(points), own, *errors.values()])
        checks.append(at_most(f"{source.name}, 400 px: field", errors["field"], SHORT_LIMIT_PX, "px"))
    header = ("pair", "auto", "points", "tie points", "affine", "polynomial3", "tps", "field")
    return Table(
        "Waves of 400 px, +-1 px, added: RMSE of models fitted to the same tie points", header, rows, checks
    )


def _after(base: Outcome, field: Field, at_px: Array) -> Array:
    """Return where predicted positions are seen after the field: as the undisplaced pair says, then moved."""
    correction = base.result.model
    if correction is None:
        raise RuntimeError(f"the undisplaced pair was refused: {base.reason}")
    before = correction.forward(at_px)
    return np.asarray(before + field(before))


def _exact(scratch: Path, runner: Runner) -> Table:
    """Compare corrections of synthetic scenes with their exact truth."""
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for texture in (countryside, folds):
        for index, (name, field) in enumerate(FIELDS.items()):
            jobs = []
            for seed in SEEDS:
                images = image_pair(texture, (0, 1), seed, field)
                rng = np.random.default_rng(seed)
                noisy = (image + 0.05 * rng.standard_normal(image.shape) for image in images)
                stem = f"exact_{texture.__name__}_{index}_{seed}"
                paths = [
                    write(scratch / f"{stem}_{which}.tif", np.rint(20000 + 2000 * image).astype(np.uint16))
                    for which, image in enumerate(noisy)
                ]
                jobs.append(Job(*paths, PLAIN, False))
            outcomes = runner(jobs)
            what = f"{texture.__name__}, {name}"
            truths: list[Field] = [partial(_moved, field)] * len(SEEDS)
            row = _row(what, outcomes, truths)
            rows.append(row)
            if field is not constant:
                checks.append(within(f"{what}: 95 % interval", float(row[-1]), 92.0, 98.0, "%"))
                checks.append(at_most(f"{what}: RMSE", float(row[3]), FIELD_LIMIT_PX, "px"))
    return Table(
        f"Scenes of exact truth, {len(SEEDS)} each: predicted sigma on a dense grid in the hull",
        ("scene", "model", "points", "RMSE", "largest", "sigma", "68 %", "95 %"),
        rows,
        checks,
    )


def _moved(field: Field, at_px: Array) -> Array:
    return np.asarray(at_px + field(at_px))


def _again(data: Path, scratch: Path, runner: Runner) -> Table:
    """Register pairs, write the registered rasters, and register these again."""
    folder = data / "cross_sensor"
    land, aerial, s2 = "landsat8_byte.tif", "ngi_rgb_byte_1.tif", "sentinel2_b432_byte.tif"
    visible, close = landsat(data), rgbnir(data)
    pairs = [
        ("landsat_sub1", visible.reference, visible.target, 1),
        ("rgbnir_sub1", close.reference, close.target, 1),
        ("Sentinel-2 - Landsat 8", folder / s2, folder / land, 3),
        ("Landsat 8 - Sentinel-2", folder / land, folder / s2, 1),
        ("Sentinel-2 - aerial", folder / s2, folder / aerial, 1),
        ("aerial - Sentinel-2", folder / aerial, folder / s2, 1),
    ]
    rows: list[list[Cell]] = []
    checks: list[Check] = []
    for number, (name, reference, target, band) in enumerate(pairs):
        ref_band = 3 if reference.name == land else 1
        out = scratch / f"again_{number}"
        first = register(reference, target, out_dir=out, ref_band=ref_band, tgt_band=band, jobs=1)
        registered = next(out.glob("*_registered.tif"))
        settings = Settings(ref_band=ref_band, tgt_band=band, jobs=1)
        (second,) = runner([Job(reference, registered, settings)])
        left = second.points.displacement_px
        mean, median = left.mean(axis=0), np.median(left, axis=0)
        before = np.median(first.tie_points.select("fit", "check", "unused").displacement_px, axis=0)
        model = first.model.name if first.model else "-"
        rows.append([name, model, *before.tolist(), len(left), *mean.tolist(), *median.tolist()])
        checks.append(at_most(f"{name}: mean displacement", float(np.hypot(*mean)), AGAIN_LIMIT_PX, "px"))
    header = ("pair", "model", "first col", "row", "points", "mean col", "row", "median col", "row")
    return Table("Registered rasters, registered again", header, rows, checks)


def _row(what: str, outcomes: list[Outcome], truths: list[Field]) -> list[Cell]:
    """Return the figures of one condition, its scenes together."""
    error, sigma, names, points = [], [], [], 0
    for outcome, truth in zip(outcomes, truths, strict=True):
        places = _places(outcome)
        found = outcome.result
        if found.model is None or found.selection is None:
            raise RuntimeError(f"{what} was refused: {outcome.reason}")
        error.append(found.model.forward(places) - truth(places))
        sigma.append(found.selection.sigma(places))
        names.append(found.model.name)
        points += len(found.tie_points.select("fit"))
    missed, sigmas = np.concatenate(error), np.concatenate(sigma)
    size = np.linalg.norm(missed, axis=1)
    shares = [float(100 * (np.abs(missed) < factor * sigmas).mean()) for factor in (1.0, 1.96)]
    shown = ", ".join(dict.fromkeys(names))
    rmse, largest = float(np.sqrt((size**2).mean())), float(size.max())
    return [what, shown, points, rmse, largest, float(np.median(sigmas)), *shares]


def _checks(what: str, outcome: Outcome, truth: Field, pure_shift: bool) -> Iterator[Check]:
    row = _row(what, [outcome], [truth])
    wanted = ("shift",) if pure_shift else LOCAL
    yield Check(f"{what}: model", str(row[1]), " or ".join(wanted), row[1] in wanted)
    limit = SHIFT_LIMIT_PX if pure_shift else FIELD_LIMIT_PX
    yield at_most(f"{what}: RMSE", float(row[3]), limit, "px")
    if not pure_shift:  # of a shift all places err alike
        yield within(f"{what}: 95 % interval", float(row[-1]), 92.0, 98.0, "%")


def _places(outcome: Outcome) -> Array:
    """Return a dense grid of predicted positions inside the hull of the fit points."""
    points = outcome.result.tie_points.select("fit").predicted_px
    low, high = points.min(axis=0), points.max(axis=0)
    axes = [np.arange(first, last, STEP_PX) for first, last in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return np.asarray(grid[Delaunay(points).find_simplex(grid) >= 0])
