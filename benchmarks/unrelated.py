"""Pairs of images that show no common ground, made from all real images."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from benchmarks.pairs import Image, landsat, rgbnir, uav

REPOSITORY: Final = Path(__file__).resolve().parents[1]
SIDES_PX: Final = (160, 513)
"""Least side of a part, and what every side is below; an image that is smaller is taken whole."""
CHIP_SIDES_PX: Final = (64, 161)
"""The same of chips, which fit few windows."""
GAP_PX: Final = 48
"""Least distance between two parts of one scene: bands of one frame are up to 25 px apart."""
MIN_LONG_PX: Final = 400
"""Least longer side of a scene that is parted."""
MIN_VALID: Final = 0.6
"""Least share of a part that has data."""
MIN_CONTRAST: Final = 0.05
"""Least contrast of a part, as a share of the whole image's."""
TRIES: Final = 50
"""Number of times that a part with too little in it is drawn again."""

Box = tuple[int, int, int, int]
"""First row and column, rows, columns."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A band of a file, and what it shows."""

    name: str
    path: Path
    band: int
    ground: str
    """Pictures of different ground show nothing in common."""
    frame: str
    """Pictures of one frame show the same ground at the same pixels, within `GAP_PX`."""
    kind: str
    """A scene, or the kind of a pair of images of unknown place."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What is seen of a picture."""

    picture: Picture
    image: Image
    nodata: float | None
    box: Box

    def __str__(self) -> str:
        row, col, rows, cols = self.box
        return f"{self.picture.name} [{row}:{row + rows}, {col}:{col + cols}]"


def scenes(data: Path) -> list[Picture]:
    """Return the pictures whose ground is known to differ or to be the same."""
    one, two, three = landsat(data), rgbnir(data), uav(data)
    sensors, pleiades = data / "cross_sensor", data / "rpc_pair"
    sample = REPOSITORY / "sample_data"
    found = [
        _scene("Landsat B2", one.reference, "plain"),
        _scene("Landsat B10", one.undisplaced, "plain"),
        _scene("red", two.reference, "close range"),
        _scene("near infrared", two.undisplaced, "close range"),
        _scene("UAV visible", three.reference, "uav", frame="uav visible"),
        _scene("UAV thermal", three.target, "uav", frame="uav thermal"),
        _scene("QuickBird", data / "rpc/qb2_basic1b.tif", "cape", frame="QuickBird"),
        _scene("Pleiades 1", pleiades / "img_01.tif", "island", frame="Pleiades 1"),
        _scene("Pleiades 2", pleiades / "img_02.tif", "island", frame="Pleiades 2"),
        _scene("Pleiades orthoimage", pleiades / "ortho_01.tif", "island", frame="Pleiades heights"),
        _scene("surface heights", pleiades / "dsm.tif", "island", frame="Pleiades heights"),
        _scene("heights", data / "rpc/dem_egm2008.tif", "cape", frame="heights"),
        _scene("sample red", sample / "landsat_b4.tif", "sample"),
        _scene("sample thermal", sample / "landsat_b10.tif", "sample"),
        _scene("desert", data / "metrology/T19KER_r+0.00c+0.25-left.tif", "desert"),
    ]
    bands = {"sentinel2_b432_byte.tif": 3, "ngi_rgb_byte_1.tif": 3, "landsat8_byte.tif": 7}
    found += [
        _scene(f"{name.split('_')[0]} band {band}", sensors / name, "cape", band, name)
        for name, count in bands.items()
        for band in range(1, count + 1)
    ]
    rig = [_scene(f"rig {lens}", data / f"rig/rededge/IMG_0001_{lens}.tif", "field") for lens in range(1, 6)]
    return found + rig


def _scene(name: str, path: Path, ground: str, band: int = 1, frame: str | None = None) -> Picture:
    return Picture(name, path, band, ground, frame or ground, "scene")


def pose_pictures(data: Path) -> list[Picture]:
    """Return the images of `data/pose`: those of one kind may show the same ground, whatever their number."""
    return [
        Picture(f"{path.parent.name} {path.stem}", path, 1, path.parent.name, str(path), path.parent.name)
        for path in sorted((data / "pose").glob("*/pair*_[12].jpg"))
    ]


@cache
def _read(path: Path, band: int) -> tuple[Image, float | None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as file:
            return np.asarray(file.read(band)), file.nodata


def any_part(rng: np.random.Generator, picture: Picture) -> Part:
    """Return a part of a picture that shows something."""
    shape = _read(picture.path, picture.band)[0].shape
    return _with_content(picture, partial(random_box, rng, (0, 0, shape[0], shape[1])))


def apart(rng: np.random.Generator, first: Picture, second: Picture) -> tuple[Part, Part]:
    """Return parts of two pictures of one frame that do not overlap."""
    shapes = [_read(picture.path, picture.band)[0].shape for picture in (first, second)]
    fields = list(halves(rng, tuple(np.min(shapes, axis=0).tolist())))
    if rng.integers(2):
        fields.reverse()
    parts = [
        _with_content(picture, partial(random_box, rng, field))
        for picture, field in zip((first, second), fields, strict=True)
    ]
    return parts[0], parts[1]


def halves(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Box, Box]:
    """Cut an image of a shape in two across its longer side, somewhere near the middle, `GAP_PX` apart."""
    rows, cols = shape
    cut = round(max(shape) * rng.uniform(0.4, 0.6))
    begin, end = cut - GAP_PX // 2, cut + GAP_PX // 2
    if rows >= cols:
        return (0, 0, begin, cols), (end, 0, rows - end, cols)
    return (0, 0, rows, begin), (0, end, rows, cols - end)


def random_box(rng: np.random.Generator, within: Box, sides_px: tuple[int, int] = SIDES_PX) -> Box:
    """Return a box within another; a side that is short is taken whole."""
    row, col, *most = within
    sides = [min(int(rng.integers(*sides_px)), side) for side in most]
    down, across = (int(rng.integers(side - part + 1)) for side, part in zip(most, sides, strict=True))
    return row + down, col + across, sides[0], sides[1]


def _with_content(picture: Picture, draw: Callable[[], Box]) -> Part:
    """Draw boxes until one shows something; a part that shows nothing would be refused for that alone."""
    image, nodata = _read(picture.path, picture.band)
    whole = _contrast(image, nodata)
    for _ in range(TRIES):
        row, col, rows, cols = box = draw()
        part = image[row : row + rows, col : col + cols]
        if _valid(part, nodata).mean() >= MIN_VALID and _contrast(part, nodata) >= MIN_CONTRAST * whole:
            break
    return Part(picture, part, nodata, box)


def _valid(image: Image, nodata: float | None) -> Image:
    return np.isfinite(image) if nodata is None else np.isfinite(image) & (image != nodata)


def _contrast(image: Image, nodata: float | None) -> float:
    seen = image[_valid(image, nodata)].astype(np.float64)
    return float(np.ptp(np.percentile(seen, [2, 98]))) if seen.size else 0.0


# --- pairs of parts


def unrelated_parts(data: Path, number: int, seed: int) -> tuple[str, Part, Part]:
    """Return what is paired and the two parts, drawn from a number: each gives a pair of its own."""
    rng = np.random.default_rng([seed, number])
    name, pair = list(PAIRINGS.items())[number % len(PAIRINGS)]
    return name, *pair(rng, scenes(data), pose_pictures(data))


def unrelated_chips(data: Path, number: int, seed: int) -> tuple[str, Part, Part]:
    """Return chips of the parts that `unrelated_parts` gives for a number."""
    rng = np.random.default_rng([seed, number, CHIP_SIDES_PX[0]])
    name, *parts = unrelated_parts(data, number, seed)
    first, second = (
        _with_content(part.picture, partial(random_box, rng, part.box, CHIP_SIDES_PX)) for part in parts
    )
    return name, first, second


Pairing = Callable[[np.random.Generator, list[Picture], list[Picture]], tuple[Part, Part]]


def _scene_and_pose(
    rng: np.random.Generator, known: list[Picture], posed: list[Picture]
) -> tuple[Part, Part]:
    chosen = [pick(rng, known), pick(rng, posed)]
    first, second = (any_part(rng, chosen[index]) for index in rng.permutation(2))
    return first, second


def _other_grounds(
    rng: np.random.Generator, known: list[Picture], _posed: list[Picture]
) -> tuple[Part, Part]:
    first = pick(rng, known)
    second = pick(rng, [picture for picture in known if picture.ground != first.ground])
    return any_part(rng, first), any_part(rng, second)


def _two_kinds(rng: np.random.Generator, _known: list[Picture], posed: list[Picture]) -> tuple[Part, Part]:
    first = pick(rng, posed)
    second = pick(rng, [picture for picture in posed if picture.kind != first.kind])
    return any_part(rng, first), any_part(rng, second)


def _parts_of_one(rng: np.random.Generator, known: list[Picture], posed: list[Picture]) -> tuple[Part, Part]:
    large = [picture for picture in (known if rng.uniform() < 0.75 else posed) if _can_be_parted(picture)]
    first = pick(rng, large)
    second = pick(rng, [picture for picture in large if picture.frame == first.frame])
    return apart(rng, first, second)


PAIRINGS: Final[dict[str, Pairing]] = {
    "scene - image of data/pose": _scene_and_pose,
    "scenes of other ground": _other_grounds,
    "images of two kinds of data/pose": _two_kinds,
    "parts of one scene that do not overlap": _parts_of_one,
}


def pick(rng: np.random.Generator, pictures: list[Picture]) -> Picture:
    """Pick a picture: every ground as often as another, however many show it."""
    grounds = sorted({picture.ground for picture in pictures})
    ground = grounds[int(rng.integers(len(grounds)))]
    shown = [picture for picture in pictures if picture.ground == ground]
    return shown[int(rng.integers(len(shown)))]


def _can_be_parted(picture: Picture) -> bool:
    return bool(max(_read(picture.path, picture.band)[0].shape) >= MIN_LONG_PX)
