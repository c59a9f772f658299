"""Refusal: unrelated pairs must not be registered; hard but good pairs must be, and rightly."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
from affine import Affine
from scipy import ndimage

from benchmarks.pairs import Image, Pair, as_uint8, landsat, read, rgbnir, uav, with_gamma, with_noise, write
from benchmarks.runs import Job, Outcome, Runner
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from pcwlad_geo.options import Settings

CROP_PX: Final = 224
UNRELATED_SETTINGS: Final = Settings(features=300)
HARD_SETTINGS: Final = Settings(features=500)
MIN_UNRELATED, MIN_HARD = 50, 20
WRONG_PX: Final = 1.0
GRID: Final = Affine(30.0, 0.0, 500000.0, 0.0, -30.0, 5000000.0)
CRS: Final = "EPSG:32633"
CUT_NEAR_RADIUS: Final = {"landsat_sub1": (8, 8), "rgbnir_sub1": (0, 13)}
"""Pixels (col, row) cut off the target so that the displacement is 9.4 to 9.6 px on an axis."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A pair made for the study."""

    name: str
    job: Job
    truth_xy_px: tuple[float, float] = (0.0, 0.0)


def refusal(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
    """Yield a table of the unrelated pairs that were accepted, and one of the hard pairs."""
    unrelated = list(_unrelated(data, scratch))
    outcomes = runner([trial.job for trial in unrelated])
    rows: list[list[Cell]] = [["all pairs", len(unrelated)]]
    accepted = [
        (trial, outcome) for trial, outcome in zip(unrelated, outcomes, strict=True) if outcome.accepted
    ]
    rows += [[f"  ACCEPTED: {trial.name}", len(outcome.points)] for trial, outcome in accepted]
    checks = [
        at_least("unrelated pairs tried", len(unrelated), MIN_UNRELATED, digits=0),
        at_most("unrelated pairs accepted", len(accepted), 0, digits=0),
    ]
    yield Table("Unrelated pairs", ("pair", "n"), rows, checks)
    yield _hard_table(
        [*_hard(landsat(data), scratch), *_hard(rgbnir(data), scratch), *_two_sensors(data)], runner
    )


def _hard_table(trials: list[Trial], runner: Runner) -> Table:
    rows: list[list[Cell]] = []
    errors: list[float] = []
    for trial, outcome in zip(trials, runner([trial.job for trial in trials]), strict=True):
        if outcome.accepted:
            errors.append(_largest_error_px(trial, outcome))
            rows.append([trial.name, len(outcome.points), errors[-1]])
        else:
            rows.append([f"{trial.name}: REFUSED, {(outcome.reason or '')[:70]}", 0, float("nan")])
    wrong = sum(error > WRONG_PX for error in errors)
    checks: list[Check] = [
        at_least("hard pairs tried", len(trials), MIN_HARD, digits=0),
        at_least("hard pairs accepted", 100 * len(errors) / len(trials), 90.0, "%", 1),
        at_most(f"accepted pairs wrong by more than {WRONG_PX:.0f} px", wrong, 0, digits=0),
    ]
    return Table("Hard but good pairs", ("pair", "points", "largest error of the model, px"), rows, checks)


def _largest_error_px(trial: Trial, outcome: Outcome) -> float:
    correction = outcome.result.model
    if correction is None:
        return float("inf")
    predicted = outcome.points.predicted_px
    moved = correction.forward(predicted) - predicted
    return float(np.linalg.norm(moved - trial.truth_xy_px, axis=1).max())


# --- unrelated pairs


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """An image and the ground it shows; places of the same number show the same ground in both images."""

    name: str
    ground: str
    image: Image
    places_rc: tuple[tuple[int, int], ...] = field(default=())

    def crop(self, place: int) -> Image:
        row, col = self.places_rc[place % len(self.places_rc)]
        return self.image[row : row + CROP_PX, col : col + CROP_PX]


def _scenes(data: Path) -> list[_Scene]:
    places = {
        "plain": ((0, 0), (0, 288), (288, 0), (288, 288)),
        "close range": ((0, 0), (0, 400), (0, 800), (440, 0), (440, 400), (440, 800)),
        "uav": ((0, 0), (0, 424), (292, 0), (292, 424)),
        "cape": ((560, 250), (820, 250), (560, 520), (820, 520)),
    }
    sensors = data / "cross_sensor"
    one, two, three = landsat(data), rgbnir(data), uav(data)
    found = [
        ("Landsat B2", "plain", read(one.reference)),
        ("Landsat B10", "plain", read(one.undisplaced)),
        ("red", "close range", read(two.reference)),
        ("near infrared", "close range", read(two.undisplaced)),
        ("UAV visible", "uav", read(three.reference)),
        ("UAV thermal", "uav", read(three.target)),
        ("Sentinel-2", "cape", read(sensors / "sentinel2_b432_byte.tif")),
    ]
    scenes = [_Scene(name, ground, image, places[ground]) for name, ground, image in found]
    aerial = read(sensors / "ngi_rgb_byte_1.tif")
    scenes.append(_Scene("aerial", "cape", aerial, ((420, 300), (720, 300))))
    scenes.append(_Scene("QuickBird", "cape", read(data / "rpc/qb2_basic1b.tif"), ((400, 300), (800, 300))))
    return scenes


def _unrelated(data: Path, scratch: Path) -> Iterator[Trial]:
    for number, (name, first, second) in enumerate(_unrelated_images(_scenes(data))):
        # half of them claim the same georeferencing, half have none; every third a wide search
        place = (GRID, CRS) if number % 2 else (None, None)
        paths = [
            write(scratch / f"unrelated_{number}_{which}.tif", image, *place)
            for which, image in enumerate((first, second))
        ]
        settings = replace(UNRELATED_SETTINGS, search_radius=30) if number % 3 == 0 else UNRELATED_SETTINGS
        yield Trial(f"{number}: {name}", Job(*paths, settings, match_only=False))


def _unrelated_images(scenes: list[_Scene]) -> Iterator[tuple[str, Image, Image]]:
    """Other ground; another place of the same scene; the same place mirrored, which no pose undoes."""
    for number, (first, second) in enumerate(combinations(scenes, 2)):
        if first.ground != second.ground:
            yield f"{first.name} - {second.name}", first.crop(number), second.crop(number // 2)
    of = {scene.name: scene for scene in scenes}
    places = [
        ("Landsat B2", "Landsat B10", 0, 3),
        ("Landsat B2", "Landsat B10", 1, 2),
        ("Landsat B2", "Landsat B2", 0, 1),
        ("red", "near infrared", 0, 2),
        ("red", "near infrared", 3, 1),
        ("red", "red", 4, 5),
        ("UAV visible", "UAV thermal", 0, 3),
        ("UAV visible", "UAV visible", 1, 2),
        ("Sentinel-2", "Sentinel-2", 0, 1),
        ("Sentinel-2", "Sentinel-2", 2, 3),
    ]
    for name, other, here, there in places:
        yield f"{name} - {other}, another place", of[name].crop(here), of[other].crop(there)
    mirrors: dict[str, Callable[[Image], Image]] = {
        "mirrored": np.fliplr,
        "upside down": np.flipud,
        "transposed": np.transpose,
    }
    for mirror, mirrored in mirrors.items():
        for name, other in (
            ("Landsat B2", "Landsat B10"),
            ("red", "near infrared"),
            ("UAV visible", "UAV visible"),
            ("Sentinel-2", "Sentinel-2"),
        ):
            yield (
                f"{name} - {other}, {mirror}",
                of[name].crop(3),
                np.ascontiguousarray(mirrored(of[other].crop(3))),
            )


# --- hard but good pairs


def _hard(pair: Pair, scratch: Path) -> Iterator[Trial]:
    reference, target = read(pair.reference), read(pair.target)
    truth = np.array(pair.truth)

    def trial(
        name: str, first: Image, second: Image, moved: tuple[int, int] = (0, 0), radius: int | None = None
    ) -> Trial:
        """Make a trial; the target's first `moved` (col, row) pixels are cut off."""
        stem = name.replace(" ", "_").replace(",", "")
        paths = [
            write(scratch / f"hard_{pair.name}_{stem}_{which}.tif", image)
            for which, image in enumerate((first, second[moved[1] :, moved[0] :]))
        ]
        settings = HARD_SETTINGS
        if radius is not None:
            settings = replace(settings, search_radius=radius, prealign="none")
        x, y = (truth - moved).tolist()
        return Trial(f"{pair.name}, {name}", Job(*paths, settings, match_only=False), (x, y))

    yield trial("noise 25 on both", with_noise(reference, 25, 1), with_noise(target, 25, 2))
    yield trial("clouds over a third of the target", reference, _clouded(target, 0.33, 3))
    yield trial("clouds over a quarter of both", _clouded(reference, 0.25, 4), _clouded(target, 0.25, 5))
    yield trial("inverted, gamma 0.5", reference, with_gamma(255 - target, 0.5))
    yield trial(
        "target blurred by 2 px", reference, as_uint8(ndimage.gaussian_filter(target.astype(float), 2.0))
    )
    strip = np.s_[:, 200:296]
    yield trial("overlap 96 px wide", reference[strip], target[strip])
    small = np.s_[150:310, 150:310]
    yield trial("160 x 160 px", reference[small], target[small])
    yield trial("16 grey levels, noise 10", with_noise(reference, 10, 6), target // 16 * 16)
    stripes = np.random.default_rng(7).normal(0, 15, target.shape[1])
    yield trial("striped target", reference, as_uint8(target + stripes))
    far = CUT_NEAR_RADIUS[pair.name]
    yield trial("displacement near the search radius", reference, target, far, radius=10)


def _clouded(image: Image, share: float, seed: int) -> Image:
    """Cover a share of an image with soft bright clouds."""
    noise = np.random.default_rng(seed).standard_normal(image.shape)
    thickness = ndimage.gaussian_filter(noise, 30.0, mode="wrap")
    thickness = (thickness - np.quantile(thickness, 1 - share)) / thickness.std()
    opacity = np.clip(thickness / 0.4, 0.0, 1.0)
    return as_uint8(image * (1 - opacity) + (225 + 10 * noise) * opacity)


def _two_sensors(data: Path) -> Iterator[Trial]:
    """Landsat 8 and Sentinel-2 red: measured about (-0.1, -0.8) px of 10 m apart."""
    reference, target = data / "cross_sensor/landsat8_byte.tif", data / "cross_sensor/sentinel2_b432_byte.tif"
    for name, band in (("red", 4), ("near infrared", 5), ("short-wave infrared", 6)):
        settings = replace(HARD_SETTINGS, ref_band=band)
        job = Job(reference, target, settings, match_only=False)
        yield Trial(f"Landsat {name} - Sentinel-2 red", job, (-0.09, -0.84))
