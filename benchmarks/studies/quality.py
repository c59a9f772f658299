"""Grades of registrations, and the accuracy they expect, against a truth that is known everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine
from scipy import ndimage

from benchmarks.displacing import Field, displace
from benchmarks.pairs import Image, as_uint8, landsat, read, rgbnir, uav, with_gamma, with_noise, write
from benchmarks.runs import Array, Job, Outcome, Runner
from benchmarks.tables import Cell, Check, Table, at_least, at_most
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.grid import map_px
from pcwlad_geo.registration.fitting import fit_correction
from pcwlad_geo.registration.result import Registration

Index = NDArray[np.intp]
Truth = Callable[[Array, Outcome | None], Array]
"""(n, 2) reference px, and what the undisplaced pair gave, to the target px where the ground is."""

GRID: Final = Affine(10.0, 0.0, 500000.0, 0.0, -10.0, 5000000.0)
CRS: Final = "EPSG:32633"
SETTINGS: Final = Settings(jobs=1)
STEP_PX: Final = 6
"""Of the dense grid on which corrections are compared with the truth."""
FINE_PX, OFF_PX, TIMES = 0.5, 1.0, 3.0
FINE_SHARE: Final = 95.0
TENTH, HALF = 0.1, 0.5
CLOUDS_PX: Final = (8.0, 5.0)
"""How far clouds moved (col, row)."""
HEIGHT_M: Final = 29.0
"""From the elevation model up to the ellipsoid, for the QuickBird image."""
MIN_PAIRS: Final = 60


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """A pair of images of one ground, of the same size, that lie nearly in place."""

    name: str
    reference: Image
    target: Image
    exact: bool
    """Whether they lie exactly in place: the reference is made from the target."""


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
        found = self.outcome.result.correction if self.outcome.accepted else None
        return found.name if found else "-"


def quality(data: Path, scratch: Path, runner: Runner) -> Iterator[Table]:
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


def _finding(case: Case, runner: Runner) -> Finding:
    (outcome,) = runner([case.job])
    correction = outcome.result.correction if outcome.accepted else _of_refused(outcome)
    if correction is None:
        return Finding(case, outcome, float("nan"))
    base = None if case.base is None else runner([case.base])[0]
    errors = true_errors(case, outcome.result, correction, base)
    return Finding(case, outcome, float(np.percentile(np.linalg.norm(errors, axis=1), 90)))


def _of_refused(outcome: Outcome) -> Correction | None:
    """Return the correction that was not made: refusing a pair that it would have served counts, too."""
    if outcome.registration is None:
        return None
    try:
        return fit_correction(outcome.registration.tie_points, SETTINGS, SETTINGS.window, None).correction
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


def grounds(data: Path) -> list[Ground]:
    """Return the images that the cases are made from, at most 512 px a side."""
    close, visible = rgbnir(data), landsat(data)
    sensors = data / "cross_sensor"
    s2, aerial, land = (
        sensors / name for name in ("sentinel2_b432_byte.tif", "ngi_rgb_byte_1.tif", "landsat8_byte.tif")
    )
    flight = read(uav(data).reference)[2:514, 60:572]
    thermal = read(visible.undisplaced)
    near = np.s_[84:596, 256:768]
    place = np.s_[500:1012, 150:662]
    return [
        Ground("Landsat blue - thermal", read(visible.reference), thermal, False),
        Ground("red - near infrared", read(close.reference)[near], read(close.undisplaced)[near], False),
        Ground("Sentinel-2 red - blue", read(s2, 1)[place], read(s2, 3)[place], False),
        Ground("Landsat red - near infrared", read(land, 4), read(land, 5), False),
        Ground("aerial red - blue", read(aerial, 1)[place], read(aerial, 3)[place], False),
        Ground("UAV - its negative", _negative(flight), flight, True),
        Ground("thermal - its negative", _negative(thermal), thermal, True),
    ]


def _negative(image: Image) -> Image:
    """Return the image as another band might show it: dark for bright, bent, with noise."""
    return with_noise(with_gamma(255 - as_uint8(image), 0.7), 3.0, seed=5)


# --- displacement fields


def shifted(at_px: Array, by_px: tuple[float, float] = (2.37, -1.61)) -> Array:
    """Return the same displacement everywhere."""
    return np.broadcast_to(np.array(by_px), at_px.shape)


def turned(at_px: Array, angle_deg: float = 0.3, scale: float = 1.002) -> Array:
    """Return what a small rotation and scale about (256, 256) and a shift do."""
    angle = np.deg2rad(angle_deg)
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) - np.eye(2)
    return np.asarray((at_px - 256.0) @ matrix.T + [1.2, -0.8])


def waves(at_px: Array, wavelength_px: float, amplitude_px: float, turn: float = 0.64) -> Array:
    """Return a smooth displacement of up to the amplitude on either axis."""
    x, y = np.moveaxis(at_px, -1, 0)
    k, c, s = 2 * np.pi / wavelength_px, np.cos(turn), np.sin(turn)
    sines = (np.sin(k * (c * x + s * y) + 0.4 + turn), np.sin(k * (s * x - c * y) + 2.1 - turn))
    return np.asarray(amplitude_px * np.stack(sines, axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Ground in layers that move by a constant each: at a place, the layer of the highest number."""

    layer: Index
    """(rows, cols) number of the layer seen."""
    moves_px: Array
    """(layers, 2) displacement (col, row) of each, px."""

    def __call__(self, at_px: Array) -> Array:
        """Return the displacement of what is seen at positions (..., 2), px."""
        rows, cols = self.layer.shape
        col, row = np.floor(at_px).astype(np.intp).reshape(-1, 2).T
        seen = self.layer[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]
        return np.asarray(self.moves_px[seen].reshape(at_px.shape))

    def displace(self, image: Image) -> Image:
        """Return the image with its layers moved, each painted over those below."""
        moved = np.zeros(image.shape)
        for number, (col, row) in enumerate(self.moves_px.tolist()):
            cover = ndimage.shift(
                (self.layer >= number).astype(np.float32), (row, col), order=1, mode="nearest"
            )
            layer = ndimage.shift(image.astype(np.float64), (row, col), order=5, mode="mirror")
            moved = np.where(cover > 0.5, layer, moved)
        return moved


def blobs(shape: tuple[int, int], share: float, seed: int, size_px: float = 40.0) -> Array:
    """Return a mask of soft-edged patches that cover a share of the image."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), size_px, mode="wrap")
    return np.asarray(noise > np.quantile(noise, 1 - share))


def relief(shape: tuple[int, int], most_px: float, seed: int, size_px: float, steps: int = 12) -> Layers:
    """Return hills as another viewpoint sees them: displaced along the columns by up to so many px."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), size_px, mode="wrap")
    height = (noise - noise.min()) / np.ptp(noise)
    level = np.minimum((height * steps).astype(np.intp), steps - 1)
    return Layers(level, np.stack([np.linspace(0, most_px, steps), np.full(steps, 0.6)], axis=1))


def clouded(
    image: Image, share: float, seed: int, moved_px: tuple[float, float] = (0.0, 0.0)
) -> tuple[Image, Image]:
    """Cover a share of an image with soft bright clouds, all of them moved, and return what they hide."""
    noise = np.random.default_rng(seed).standard_normal(image.shape)
    texture = ndimage.gaussian_filter(noise, 3.0, mode="wrap")
    thickness = ndimage.gaussian_filter(noise, 25.0, mode="wrap")
    thickness = (thickness - np.quantile(thickness, 1 - share)) / thickness.std()
    opacity = np.clip(thickness / 0.4, 0.0, 1.0)
    cloud = 205 + 40 * texture / texture.std() * np.clip(thickness, 0, 1)
    moved = moved_px[::-1]
    opacity, cloud = (ndimage.shift(part, moved, order=3, mode="nearest") for part in (opacity, cloud))
    return as_uint8(image * (1 - opacity) + cloud * opacity), opacity > 0.5


# --- pairs


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """A pair of images of the same size, and the displacement between them."""

    reference: Image
    target: Image
    field: Field
    hidden: Image | None = None
    """(rows, cols) where clouds hide the ground of the reference."""
    open_question: str = ""


Make = Callable[[Ground, int], Images]
"""Ground and seed to a pair."""


def _by(field: Field) -> Make:
    return lambda ground, seed: Images(ground.reference, displace(ground.target, field), field)


def _layered(layers: Callable[[tuple[int, ...], int], Layers]) -> Make:
    def make(ground: Ground, seed: int) -> Images:
        field = layers(ground.target.shape, seed)
        return Images(ground.reference, field.displace(ground.target), field)

    return make


def _blurred(image: Image) -> Image:
    return as_uint8(ndimage.gaussian_filter(image.astype(np.float64), 1.5))


def _inverted(image: Image) -> Image:
    return with_gamma(255 - image, 0.5)


def _otherwise(seen: Callable[[Image], Image]) -> Make:
    """Let the target be seen by another sensor."""
    return lambda ground, seed: Images(
        ground.reference, seen(as_uint8(displace(ground.target, shifted))), shifted
    )


def _noisy(sigma: float) -> Make:
    def make(ground: Ground, seed: int) -> Images:
        target = displace(ground.target, shifted)
        return Images(with_noise(ground.reference, sigma, seed), with_noise(target, sigma, seed + 1), shifted)

    return make


def _cloudy(share: float, both: bool = True) -> Make:
    def make(ground: Ground, seed: int) -> Images:
        target, cover = clouded(displace(ground.target, shifted), share, seed, CLOUDS_PX)
        reference, hidden = clouded(ground.reference, share, seed) if both else (ground.reference, cover)
        question = "clouds or ground" if both and hidden.mean() > TENTH else ""
        return Images(reference, target, shifted, hidden, question)

    return make


def _patched(share: float, by_px: tuple[float, float], size_px: float = 40.0) -> Make:
    """Let patches of the ground move on their own."""
    moves = np.array([[1.3, -0.7], by_px])
    return _layered(lambda shape, seed: Layers(blobs(shape, share, seed, size_px).astype(np.intp), moves))


def _relief(most_px: float, size_px: float) -> Make:
    return _layered(lambda shape, seed: relief(shape, most_px, seed, size_px))


def _partly_flat(share: float, field: Field) -> Make:
    """Leave structure in the top left corner only, this share of the sides."""

    def make(ground: Ground, seed: int) -> Images:
        rows, cols = np.indices(ground.target.shape)
        flat = (rows > share * rows.max()) | (cols > share * cols.max())
        soft = ndimage.gaussian_filter(flat.astype(np.float64), 6.0)
        noise = np.random.default_rng(seed).normal(0, 1.0, (2, *flat.shape))
        images = (
            as_uint8(image * (1 - soft) + 90 * soft + noise[which])
            for which, image in enumerate((ground.reference, displace(ground.target, field)))
        )
        return Images(*images, field, None, "mostly flat" if flat.mean() > HALF else "")

    return make


@dataclass(frozen=True, slots=True)
class Condition:
    """How pairs are made, and of which grounds."""

    make: Make
    grounds: tuple[int, ...]
    overlap: float = 1.0
    """Share of the width that the two files have in common."""


LONG: Final = partial(waves, wavelength_px=1500.0, amplitude_px=2.0)
MIDDLE: Final = partial(waves, wavelength_px=400.0, amplitude_px=1.5)
CONDITIONS: Final[dict[str, Condition]] = {
    "shift": Condition(_by(shifted), (0, 1, 2, 3, 4, 5, 6)),
    "rotation 0.3 deg, scale 1.002": Condition(_by(turned), (0, 1, 2, 4, 5, 6)),
    "waves of 1500 px": Condition(_by(LONG), (0, 1, 2, 5)),
    "waves of 400 px": Condition(_by(MIDDLE), (0, 1, 2, 5, 6)),
    "waves of 150 px": Condition(_by(partial(waves, wavelength_px=150.0, amplitude_px=2.5)), (0, 2, 6)),
    "waves of 80 px": Condition(_by(partial(waves, wavelength_px=80.0, amplitude_px=2.0)), (1, 4, 6)),
    "target blurred by 1.5 px": Condition(_otherwise(_blurred), (0, 1, 2, 4)),
    "target inverted, gamma 0.5": Condition(_otherwise(_inverted), (0, 1, 2, 4)),
    "noise of 15": Condition(_noisy(15.0), (0, 1, 2, 4, 6)),
    "noise of 35": Condition(_noisy(35.0), (0, 5)),
    "clouds on the target, 30 %": Condition(_cloudy(0.3, both=False), (0, 2, 5)),
    "moved clouds, 20 %": Condition(_cloudy(0.2), (0, 1, 2, 4)),
    "moved clouds, 50 %": Condition(_cloudy(0.5), (0, 2, 5, 6)),
    "moved clouds, 80 %": Condition(_cloudy(0.8), (0, 2, 4)),
    "5 % moves by (7, -5) px": Condition(_patched(0.05, (7.0, -5.0)), (0, 1, 5)),
    "25 % moves by (7, -5) px": Condition(_patched(0.25, (7.0, -5.0)), (0, 1, 2, 5)),
    "50 % moves by (5, 3) px": Condition(_patched(0.5, (5.0, 3.0), 70.0), (0, 1, 2, 5)),
    "30 % moves by (2.5, -1.5) px": Condition(_patched(0.3, (2.5, -1.5)), (0, 2, 4, 6)),
    "relief, 2 px": Condition(_relief(2.0, 60.0), (0, 2, 5, 6)),
    "relief, 6 px": Condition(_relief(6.0, 40.0), (0, 1, 2, 5)),
    "relief, 20 px": Condition(_relief(20.0, 40.0), (0, 1, 2, 4)),
    "half overlap, waves of 1500 px": Condition(_by(LONG), (0, 1, 2, 4), overlap=0.5),
    "overlap of 15 %": Condition(_by(shifted), (0, 1, 2, 4), overlap=0.15),
    "overlap of 15 %, rotated": Condition(_by(turned), (0, 1, 2, 5), overlap=0.15),
    "structure in 35 % of the sides, waves of 400 px": Condition(_partly_flat(0.35, MIDDLE), (0, 2, 5)),
    "structure in 35 % of the sides, shift": Condition(_partly_flat(0.35, shifted), (0, 4)),
    "structure in 75 % of the sides, rotated": Condition(_partly_flat(0.75, turned), (0, 2, 4, 6)),
}


def _displaced(data: Path, scratch: Path) -> Iterator[Case]:
    """Yield pairs of bands, or of an image and its negative, the target displaced by a known field."""
    images = grounds(data)
    for number, (name, condition) in enumerate(CONDITIONS.items()):
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
    correction = base.result.correction if base else None
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
    if base is None or base.result.correction is None:
        raise RuntimeError("the pair with the right elevation model was not registered")
    found = base.result
    return np.asarray(found.correction.forward(map_px(at_px, found.reference.grid, found.target.grid)))
