"""Captures of a synthetic rig over a synthetic ground: lenses, heights, relief, noise and blur are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from scipy import ndimage

from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.lens import Lens
from pcwlad_geo.rigs.warping import coefficients_of, resample

Array = NDArray[np.float64]
GROUND_M = 0.05
"""Pixel size of the ground's texture."""
XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:d="http://www.dji.com/drone-dji/1.0/" xmlns:Camera="http://pix4d.com/1.0" '
    "{attributes}/></rdf:RDF></x:xmpmeta>"
)


@dataclass(frozen=True, eq=False)
class TrueLens:
    """One lens of the synthetic rig."""

    name: str
    lens: Lens
    rotation: Array
    """(3, 3) from the reference's axes."""
    place_m: Array
    """(3,) position of its centre, in the reference's axes."""
    mix: tuple[float, float, float]
    """Weights of the ground's three textures."""
    calibrated: Lens | None
    """The calibration that its frames tell."""
    blur_px: float = 0.5
    noise: float = 0.01
    wavelength_nm: float | None = None


@dataclass(frozen=True, eq=False)
class Flown:
    """One capture: where the reference lens was."""

    place_m: Array
    """(3,) east, south, and height above the zero of the ground."""
    turn: Array
    """(3, 3) from the ground's axes (east, south, down) to the reference's."""
    motion_px: float = 0.0
    covered: str | None = None
    panel: bool = False
    """Of a calibration panel on dark ground: a grey square and its printed code."""
    defocus_px: float = 0.0


@dataclass(frozen=True, eq=False)
class Ground:
    """Three textures and a relief on a lattice of `GROUND_M`."""

    textures: tuple[NDArray[np.float32], ...]
    relief: NDArray[np.float32]
    """Heights, m."""
    _mixed: dict[tuple[tuple[float, ...], int], NDArray[np.float32]] = field(default_factory=dict)

    @staticmethod
    def made(seed: int, side: int = 4096, relief_m: float = 3.0) -> Ground:
        """Make a ground: plots, rows and grains of all sizes."""
        random = np.random.default_rng(seed)
        textures = tuple(_texture(random, side) for _ in range(3))
        rough = sum(
            cv2.resize(
                random.normal(size=(cells, cells)).astype(np.float32),
                (side, side),
                interpolation=cv2.INTER_CUBIC,
            )
            / cells
            for cells in (6, 12, 24, 48)
        )
        return Ground(textures, (rough / np.std(rough) * relief_m).astype(np.float32))

    @property
    def size_m(self) -> float:
        """Side of the ground."""
        return self.relief.shape[0] * GROUND_M

    def height_m(self, east_m: Array, south_m: Array) -> Array:
        """Return heights of the ground."""
        places = np.stack([south_m, east_m]) / GROUND_M - 0.5
        return ndimage.map_coordinates(self.relief, places, order=1, mode="mirror").astype(np.float64)

    def shade(self, east_m: Array, south_m: Array, px_m: float, mix: Sequence[float]) -> Array:
        """Return brightness, averaged over pixels of a size, at (rows, cols) places."""
        level = int(np.clip(np.round(np.log2(max(px_m / GROUND_M, 1.0))), 0, 5))
        key = tuple(mix), level
        if key not in self._mixed:
            plane = sum(weight * texture for weight, texture in zip(mix, self.textures, strict=True))
            for _ in range(level):
                plane = cv2.pyrDown(plane)  # which keeps the centre of the first pixel
            self._mixed[key] = coefficients_of(np.ascontiguousarray(plane, np.float32))
        grid = (np.stack([east_m, south_m], axis=-1) / GROUND_M - 0.5) / 2**level + 0.5
        out = np.empty(east_m.shape, np.float32)
        resample(self._mixed[key], np.pad(grid, ((0, 1), (0, 1), (0, 0))), 1, out)
        return np.nan_to_num(out).astype(np.float64)


def _texture(random: np.random.Generator, side: int) -> NDArray[np.float32]:
    total = np.zeros((side, side), np.float32)
    for _ in range(700):  # plots, trees, stones
        x, y = random.integers(0, side, 2)
        size = int(np.exp(random.uniform(np.log(4), np.log(160))))
        value = float(random.normal())
        if random.random() < 0.5:
            box = cv2.boxPoints(
                (
                    (float(x), float(y)),
                    (float(size), float(size * random.uniform(0.2, 1))),
                    float(random.uniform(0, 180)),
                )
            )
            cv2.fillPoly(total, [box.astype(np.int32)], value)
        else:
            cv2.circle(total, (int(x), int(y)), size // 2, value, -1)
    total = cv2.GaussianBlur(total, (0, 0), 0.8)
    for sigma, weight in ((0.8, 0.25), (2.0, 0.25), (5.0, 0.3), (14.0, 0.35), (40.0, 0.5)):
        grain = cv2.GaussianBlur(random.normal(size=(side, side)).astype(np.float32), (0, 0), sigma)
        total += weight * grain / grain.std()
    return total


def rotation(x: float, y: float, z: float) -> Array:
    """Return the (3, 3) matrix of a rotation vector, rad."""
    return np.asarray(cv2.Rodrigues(np.array([x, y, z]))[0])


def made_rig(
    seed: int, shape: tuple[int, int] = (480, 640), *, told: bool = True, told_off_px: float = 3.0
) -> tuple[TrueLens, ...]:
    """Make five lenses; the calibrations that they tell are off by some px."""
    random = np.random.default_rng(seed)
    rows, cols = shape
    mixes = ((0.6, 0.1, 1.0), (0.5, 0.2, 1.0), (0.5, 0.3, 0.9), (-0.2, 0.7, 0.9), (0.2, 0.5, 1.0))
    places = ((0, 0), (0.03, 0.0), (0.03, 0.03), (0.0, 0.03), (0.015, 0.015))
    lenses = []
    for number, name in enumerate(("Blue", "Green", "Red", "NIR", "RedEdge")):
        focal = 1.13 * cols * (1 + 0.01 * random.normal())
        bend = np.array([-0.1, 0.14, -0.02]) + random.normal(size=3) * [0.008, 0.01, 0.01]
        shear = random.normal(size=2) * 5e-4
        centre = np.array([cols, rows]) / 2 + random.normal(size=2) * 0.01 * cols
        lens = Lens("brown", shape, np.array([focal, *centre, *bend, *shear]))
        calibration = None
        if told:
            corner = lens.corner
            off = random.normal(size=3) * told_off_px / focal / corner ** np.array([3, 5, 7]) / 2
            calibration = replace(
                lens,
                vector=lens.vector
                + np.array([random.normal() * 0.004 * focal, *(random.normal(size=2) * 2), *off, 0, 0]),
            )
        turn = rotation(*(random.normal(size=3) * 0.006 * (number > 0)))
        lenses.append(
            TrueLens(
                name,
                lens,
                turn,
                np.array([*places[number], 0.0]),
                mixes[number],
                calibration,
                wavelength_nm=(475, 560, 668, 840, 717)[number],
            )
        )
    return tuple(lenses)


def flight(
    seed: int, count: int, ground: Ground, heights_m: tuple[float, float] = (30.0, 120.0), frame: float = 0.85
) -> list[Flown]:
    """Return captures along lines whose frames overlap by some three quarters, at changing heights."""
    random = np.random.default_rng(seed)
    middle = ground.size_m / 2
    east, south, heading = middle, middle, random.uniform(0, 2 * np.pi)
    low, high = np.log(heights_m)
    phase = random.uniform(0, 2 * np.pi)
    flown = []
    for number in range(count):
        height = float(np.exp((low + high) / 2 + (high - low) / 2 * np.sin(phase + 2 * np.pi * number / 15)))
        tilt = random.normal(size=2) * np.radians(2.5)
        turn = rotation(tilt[0], tilt[1], heading + random.normal() * 0.05)
        flown.append(Flown(np.array([east, south, height]), turn))
        step = 0.2 * frame * height
        east, south = east + step * np.cos(heading), south + step * np.sin(heading)
        heading += random.normal() * 0.25
        if abs(east - middle) > 0.2 * ground.size_m or abs(south - middle) > 0.2 * ground.size_m:
            heading = np.arctan2(middle - south, middle - east)
    return flown


def ground_points(ground: Ground, flown: Flown, rays: Array, place_m: Array) -> Array:
    """Return the (n, 3) points (east, south, up) at which (n, 3) rays meet the ground."""
    down = rays / rays[:, 2:]
    depth = np.full(len(rays), place_m[2])
    for _ in range(5):
        east, south = place_m[0] + down[:, 0] * depth, place_m[1] + down[:, 1] * depth
        relief = np.zeros(len(rays)) if flown.panel else ground.height_m(east, south)
        depth = place_m[2] - relief
    return np.column_stack(
        [place_m[0] + down[:, 0] * depth, place_m[1] + down[:, 1] * depth, place_m[2] - depth]
    )


def seen_by(lens: TrueLens, flown: Flown, points: Array) -> Array:
    """Return the (n, 2) px at which a lens sees (n, 3) points of the ground."""
    place = flown.place_m
    axes = (points * [1, 1, -1] - place * [1, 1, -1]) @ flown.turn.T
    own = (axes - lens.place_m) @ lens.rotation.T
    return lens.lens.project(own[:, :2] / own[:, 2:])


def lens_rays(lens: TrueLens, flown: Flown, xy_px: Array | None) -> tuple[Array, Array]:
    """Return (n, 3) rays of px in the ground's axes, and the place (east, south, up) that they start from.

    Without px they are those of all pixels' centres.
    """
    rays = _all_rays(lens) if xy_px is None else lens.lens.rays(xy_px)
    own = np.column_stack([rays, np.ones(len(rays))])
    rays = own @ lens.rotation @ flown.turn
    offset = lens.place_m @ flown.turn
    return rays, flown.place_m + offset * [1, 1, -1]


@lru_cache(maxsize=16)
def _all_rays(lens: TrueLens) -> Array:
    rows, cols = lens.lens.shape
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    return lens.lens.rays(np.column_stack([col.ravel(), row.ravel()]))


def render(lens: TrueLens, flown: Flown, ground: Ground, random: np.random.Generator) -> NDArray[np.uint16]:
    """Return the raw frame of a lens, twelve bits in sixteen."""
    rows, cols = lens.lens.shape
    rays, place = lens_rays(lens, flown, None)
    points = ground_points(ground, flown, rays, place)
    px_m = float(flown.place_m[2]) / lens.lens.focal_px
    if flown.panel:
        east, south = (points[:, :2] - flown.place_m[:2]).T.reshape(2, rows, cols)
        shade = np.where((np.abs(east - 0.15) < 0.1) & (np.abs(south) < 0.1), 1.5, -1.0)
        code = np.pad(cv2.QRCodeEncoder.create().encode("RP02-1234567-SC") > 0, 1, constant_values=True)
        cell_m = 0.3 / len(code)
        down, right = ((each / cell_m).astype(int) for each in (south + 0.15, east + 0.3))
        on_code = (np.abs(south) < 0.15) & (np.abs(east + 0.15) < 0.15)
        printed = code[np.clip(down, 0, len(code) - 1), np.clip(right, 0, len(code) - 1)]
        shade = np.where(on_code, np.where(printed, 3.0, -3.0), shade)
        shade += 0.1 * ground.shade(*(points[:, :2].T.reshape(2, rows, cols) * 20), px_m * 20, lens.mix)
    else:
        shade = ground.shade(*points[:, :2].T.reshape(2, rows, cols), px_m, lens.mix)
    values = 0.35 + 0.08 * shade
    if lens.name == flown.covered:
        values = np.full((rows, cols), 0.03) + 0.002 * values
    values = cv2.GaussianBlur(values, (0, 0), float(np.hypot(lens.blur_px, flown.defocus_px)))
    if flown.motion_px:
        kernel = np.zeros((41, 41))
        cv2.line(kernel, (20, 20), (20 + round(flown.motion_px), 20 + round(flown.motion_px / 2)), 1.0)
        values = cv2.filter2D(values, -1, kernel / kernel.sum())
    values = values + random.normal(size=values.shape) * lens.noise * 0.35
    return (np.clip(np.rint(values * 4095), 1, 4095) * 16).astype(np.uint16)


def write_capture(
    folder: Path, name: str, rig: Sequence[TrueLens], flown: Flown, ground: Ground, *, seed: int, height: bool
) -> None:
    """Write the frames of one capture, NAME_1.tif and so on, with what the lenses tell of themselves."""
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(seed)
    for number, lens in enumerate(rig, 1):
        values = render(lens, flown, ground, random)
        rows, cols = values.shape
        words = {
            "Camera:BandName": lens.name,
            "Camera:RigCameraIndex": str(number - 1),
            "d:CaptureUUID": f"{name}-{seed}",
        }
        if lens.wavelength_nm:
            words |= {"Camera:CentralWavelength": f"{lens.wavelength_nm}", "Camera:WavelengthFWHM": "20"}
        if lens.calibrated is not None:
            f, cx, cy, k1, k2, k3, p1, p2 = lens.calibrated.vector
            numbers = (f, f, cx - cols / 2, cy - rows / 2, k1, k2, p1, p2, k3)
            words["d:DewarpData"] = "2024-01-01;" + ",".join(f"{each:.9f}" for each in numbers)
        if height:
            words["d:RelativeAltitude"] = f"+{flown.place_m[2]:.2f}"
        text = XMP.format(attributes=" ".join(f'{key}="{value}"' for key, value in words.items()))
        path = folder / f"{name}_{number}.tif"
        with (
            ignoring(NotGeoreferencedWarning),
            rasterio.open(path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="uint16") as out,
        ):
            out.write(values, 1)
            out.update_tags(ns="xml:XMP", **{"xml:XMP": text})
        clean_packet(path, text)


def clean_packet(path: Path, text: str) -> None:
    """Remove the name of the tag that rasterio writes before an XMP packet."""
    name, packet = b"xml:XMP=", text.encode()
    path.write_bytes(path.read_bytes().replace(name + packet, packet + b" " * len(name)))


def made_thermal(seed: int, *, told: bool) -> tuple[TrueLens, ...]:
    """Make a visible lens and a thermal one beside it, of another focal length and few pixels."""
    random = np.random.default_rng(seed)
    lenses = []
    for name, (rows, cols), focal, mix, place in (
        ("Visible", (960, 1280), 1400.0, (0.6, 0.1, 1.0), (0.0, 0.0)),
        ("Thermal", (120, 160), 190.0, (-0.2, 0.7, 0.9), (0.03, 0.01)),
    ):
        centre = np.array([cols, rows]) / 2 + random.normal(size=2) * 0.005 * cols
        bend = np.array([-0.06, 0.05, 0.0]) + random.normal(size=3) * [0.005, 0.01, 0]
        lens = Lens("brown", (rows, cols), np.array([focal, *centre, *bend, 0, 0]))
        off = np.array([1.005 * focal, cols / 2, rows / 2, *(bend * 0.8), 0, 0])
        turn = rotation(*(random.normal(size=3) * 0.012 * (name == "Thermal")))
        calibration = replace(lens, vector=off) if told else None
        lenses.append(
            TrueLens(
                name,
                lens,
                turn,
                np.array([*place, 0.0]),
                mix,
                calibration,
                noise=0.01 if cols > 200 else 0.02,
            )
        )
    return tuple(lenses)
