"""Pairs of images whose displacement is known everywhere, made from real images: fields, layers, covers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks.displacing import Field, displace
from benchmarks.pairs import Image, as_uint8, landsat, read, rgbnir, uav, with_gamma, with_noise
from benchmarks.runs import Array

Index = NDArray[np.intp]
TENTH, HALF = 0.1, 0.5
CLOUDS_PX: Final = (8.0, 5.0)
"""How far clouds moved (col, row)."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """A pair of images of one ground, of the same size, that lie nearly in place."""

    name: str
    reference: Image
    target: Image
    exact: bool
    """Whether they lie exactly in place: the reference is made from the target."""


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


# --- harder ones


def jittered(at_px: Array, period_px: float, amplitude_px: float) -> Array:
    """Return what a shaking line scanner does beside a shift: every row is displaced as a whole."""
    row = at_px[..., 1]
    slow, fast = 2 * np.pi / period_px, 2 * np.pi / (0.37 * period_px)
    shake = np.stack([np.sin(slow * row) + 0.3 * np.sin(fast * row), 0.6 * np.cos(slow * row + 1.0)], axis=-1)
    return np.asarray(shifted(at_px) + amplitude_px * shake)


def _cold_clouds(share: float) -> Make:
    """Let clouds that moved be bright in the reference and dark in the target, as in a thermal band."""

    def make(ground: Ground, seed: int) -> Images:
        reference, hidden = clouded(ground.reference, share, seed)
        negative = as_uint8(255 - displace(ground.target, shifted))
        target = 255 - clouded(negative, share, seed, CLOUDS_PX)[0]
        question = "clouds or ground" if hidden.mean() > TENTH else ""
        return Images(reference, target, shifted, hidden, question)

    return make


def _water(shape: tuple[int, ...], seed: int) -> Array:
    """Return dark water whose waves no second image shows again."""
    waves_dn = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 1.2)
    return np.asarray(45 + 3 * waves_dn / waves_dn.std())


def _flooded(share: float, both: bool = False) -> Make:
    """Put water over a part of the target, or of both."""

    def make(ground: Ground, seed: int) -> Images:
        field = partial(turned, angle_deg=0.1)
        wet = ndimage.gaussian_filter(blobs(ground.target.shape, share, seed, 70.0).astype(np.float64), 1.0)
        coasts = wet, displace(wet, field)
        seen = [ground.reference.astype(np.float64), displace(ground.target, field)]
        for which in (0, 1) if both else (1,):
            water = _water(wet.shape, seed + which)
            seen[which] += (water - seen[which]) * coasts[which]
        return Images(
            as_uint8(seen[0]), as_uint8(seen[1]), field, None, "mostly flat" if share > HALF else ""
        )

    return make


def _ships(share: float, together: bool) -> Make:
    """Let ships sail on water in both images, each on its own course or all on the same."""
    coast = _flooded(share, both=True)

    def make(ground: Ground, seed: int) -> Images:
        made = coast(ground, seed)
        rng = np.random.default_rng(seed)
        rows, cols = made.target.shape
        sea = np.argwhere(blobs(made.target.shape, share, seed, 70.0))
        at_px = sea[rng.choice(len(sea), 60)][:, ::-1] + rng.uniform(0, 1, (60, 2))
        way = np.array([6.0, -4.0]) if together else rng.normal(0, 4.0, (60, 2))
        seen = [made.reference.astype(np.float64), made.target.astype(np.float64)]
        y, x = np.indices((rows, cols)) + 0.5
        for ship, (begin, end) in enumerate(zip(at_px, at_px + made.field(at_px) + way, strict=True)):
            turn, length = ship * 2.4, 4.0 + ship % 5
            for image, (col, row) in zip(seen, (begin, end), strict=True):
                along = (x - col) * np.cos(turn) + (y - row) * np.sin(turn)
                across = (y - row) * np.cos(turn) - (x - col) * np.sin(turn)
                outside_px = np.maximum(np.abs(along) - length, np.abs(across) - 1.5)
                hull = np.clip(0.5 - outside_px, 0.0, 1.0)
                image += (150 + ship - image) * hull
        question = "fleet or ground" if together else made.open_question
        return Images(as_uint8(seen[0]), as_uint8(seen[1]), made.field, None, question)

    return make


def _seasons(change: float) -> Make:
    """Give every field a brightness, and rows, of its own on either date; their borders stay."""

    def make(ground: Ground, seed: int) -> Images:
        rng = np.random.default_rng(seed)
        rows, cols = ground.target.shape
        corners, turn = rng.uniform(-40, cols + 40, (90, 2)), rng.uniform(0, np.pi, 90)
        level, rowed = rng.normal(110, 50, (2, 90)), rng.uniform(0, 9, (2, 90))

        def grown(date: int, at_px: Array) -> Array:
            field = cKDTree(corners).query(at_px)[1]
            across = at_px[..., 0] * np.cos(turn[field] + date) + at_px[..., 1] * np.sin(turn[field] + date)
            return np.asarray(level[date, field] + rowed[date, field] * np.sin(2 * np.pi * across / 7.0))

        y, x = np.indices((rows, cols)) + 0.5
        at_px = np.stack([x, y], axis=-1)
        seen = [grown(0, at_px), grown(1, at_px - shifted(at_px))]
        soft = [ndimage.gaussian_filter(each, 0.8) for each in seen]
        images = (ground.reference, displace(ground.target, shifted))
        first, second = (
            as_uint8((1 - change) * image + change * fields)
            for image, fields in zip(images, soft, strict=True)
        )
        return Images(first, second, shifted)

    return make


def _hazy(most: float) -> Make:
    """Let haze grow thicker from the left to the right of the target."""

    def make(ground: Ground, seed: int) -> Images:
        target = displace(ground.target, shifted)
        thick = most * np.linspace(0, 1, target.shape[1]) * np.ones(target.shape)
        veil = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(target.shape), 20.0)
        thick = np.clip(thick + 0.05 * veil / veil.std(), 0, 1)
        return Images(ground.reference, with_noise(target * (1 - thick) + 220 * thick, 1.0, seed), shifted)

    return make


def _orchard(share: float, alike: float, by_px: tuple[float, float]) -> Make:
    """Plant trees in rows, on a share of the ground; `alike` is how little one tree differs from the next."""

    def make(ground: Ground, seed: int) -> Images:
        rng = np.random.default_rng(seed)
        turn = np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
        trees = np.stack(np.meshgrid(np.arange(-60, 60), np.arange(-80, 80)), axis=-1).reshape(-1, 2)
        trees = (trees * [9.0, 7.0]) @ turn.T + 256 + rng.normal(0, 1 - alike, (len(trees), 2))
        grove = blobs(ground.target.shape, share, seed, 50.0)
        size = rng.normal(1.0, 1 - alike, len(trees))
        y, x = np.indices(ground.target.shape) + 0.5
        at_px = np.stack([x, y], axis=-1)
        field = partial(shifted, by_px=by_px)
        seen = []
        for date, moved in enumerate((np.zeros(2), np.array(by_px))):
            apart, tree = cKDTree(trees + moved).query(at_px)
            crown = (70 * size + rng.normal(0, 5, len(trees)))[tree] * np.exp(-((apart / 2.4) ** 2))
            image = (ground.reference, displace(ground.target, field))[date]
            covered = ndimage.shift(grove.astype(np.float64), moved[::-1], order=1, mode="nearest")
            soil = 60 + 0.1 * image
            seen.append(as_uint8(image * (1 - covered) + (soil + crown) * covered))
        return Images(seen[0], seen[1], field)

    return make


FAR_PX: Final = (5.4, -3.1)
"""More than half of what lies between two trees of an orchard."""
HARDER: Final[dict[str, Condition]] = {
    "cold clouds that moved, 8 %": Condition(_cold_clouds(0.08), (0, 1, 2)),
    "cold clouds that moved, 30 %": Condition(_cold_clouds(0.3), (0, 2, 5)),
    "two depths, 15 % by 4 px": Condition(_patched(0.15, (5.3, -0.7), 25.0), (0, 1, 4)),
    "two depths, 45 % by 1.8 px": Condition(_patched(0.45, (3.1, -0.7), 30.0), (1, 4, 5)),
    "ships on their own, 40 % sea": Condition(_ships(0.4, together=False), (0, 4, 5)),
    "ships of a fleet, 40 % sea": Condition(_ships(0.4, together=True), (0, 2, 5)),
    "ships of a fleet, 80 % sea": Condition(_ships(0.8, together=True), (1, 2, 4)),
    "seasonal fields, 60 %": Condition(_seasons(0.6), (1, 2, 5)),
    "seasonal fields, 85 %": Condition(_seasons(0.85), (0, 1, 6)),
    "haze up to 80 %": Condition(_hazy(0.8), (0, 1, 2)),
    "haze up to 98 %": Condition(_hazy(0.98), (1, 5, 6)),
    "jitter of 0.3 px, 60 rows": Condition(_by(partial(jittered, period_px=60, amplitude_px=0.3)), (0, 2, 5)),
    "jitter of 1 px, 60 rows": Condition(_by(partial(jittered, period_px=60, amplitude_px=1.0)), (0, 1, 5)),
    "jitter of 1.2 px, 25 rows": Condition(_by(partial(jittered, period_px=25, amplitude_px=1.2)), (1, 2, 5)),
    "orchard, half of the ground": Condition(_orchard(0.5, 0.9, FAR_PX), (0, 1, 5)),
    "orchard, all of the ground": Condition(_orchard(1.0, 0.9, FAR_PX), (0, 2, 5)),
    "orchard, all alike": Condition(_orchard(1.0, 0.99, FAR_PX), (1, 2, 4)),
    "half flooded": Condition(_flooded(0.5), (0, 1, 2, 4, 5)),
    "70 % flooded, in both": Condition(_flooded(0.7, both=True), (0, 2, 6)),
}
