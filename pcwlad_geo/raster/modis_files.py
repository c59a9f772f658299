"""MODIS of levels 1B and 2 in HDF4: its files, and their bands, places and clear ground as GeoTIFFs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.hdf4 import Hdf4File, Labels, geolocation, open_hdf4, write_planes
from pcwlad_geo.types import Bool, Float64

_GRANULE: Final = r"(?P<satellite>M[OY]D)(?P<kind>{})\.(?P<time>A\d{{7}}\.\d{{4}})\..*"
_KINDS: Final = "021KM|02HKM|02QKM|11_L2"
_IMAGES: Final = r"EV_(?:1KM|250|500)(?:_Aggr(?:1km|500))?_(?:RefSB|Emissive)|LST"


@dataclass(frozen=True, slots=True)
class ModisFiles:
    """Names of the files, and the numbers of their format."""

    hdf4: re.Pattern[str] = re.compile(_GRANULE.format(f"{_KINDS}|03|35_L2") + r"\.hdf")
    """Whole name of a file that is read."""
    raster: re.Pattern[str] = re.compile(_GRANULE.format(_KINDS) + rf"_(?:{_IMAGES})\.tif")
    """Whole name of what is written of one with images."""
    beside: str = "beside"
    """Folder of what is written of places and clear ground."""
    example: str = "MOD021KM.….hdf, MOD02HKM.….hdf, MOD02QKM.….hdf or MOD11_L2.….hdf"
    """Names of files with images, for messages."""
    largest_number: int = 32767
    """Largest measurement of level 1B; larger numbers are codes of what is missing."""
    fill: int = 65535
    """The number that stands for all of these."""
    no_place: float = -999.0
    """Longitude and latitude of what has none."""
    sampled_rows: tuple[int, int] = (2, 7)
    """Rows of a scan whose places a file of 1 km holds …"""
    scan_rows: int = 10
    """… of so many."""
    first_col: int = 2
    """The first of its columns with places, which are as far apart as the rows."""
    clear_bits: int = 0b101
    """Bits of the mask of clouds, on ground that is decided, and confidently or probably clear."""
    not_produced: int = 0b10
    """Bit of the quality of surface temperature, where there is none."""

    def step(self, kind: str) -> int:
        """Return how many pixels of a kind of file lie in a kilometre."""
        return {"02HKM": 2, "02QKM": 4}.get(kind, 1)

    def granule_of(self, name: str, names: Sequence[str]) -> list[str]:
        """Return, of the `names` of a folder, a file and those that place it and tell its clouds."""
        image = self.hdf4.fullmatch(name)
        matches = [match for match in map(self.hdf4.fullmatch, names) if match and image]
        return [
            match[0]
            for match in matches
            if image
            and (match[0] == name or match["kind"] in ("03", "35_L2"))
            and match.group("satellite", "time") == image.group("satellite", "time")
        ]

    def has_images(self, names: Sequence[str]) -> bool:
        """Whether there is a file with images among those of these `names`."""
        matches = map(self.hdf4.fullmatch, names)
        return any(match and match["kind"] not in ("03", "35_L2") for match in matches)

    def write_rasters(self, path: Path, names: Sequence[str], folder: Path) -> None:
        """Write the arrays of a file into a folder, with places of another one if it is among the `names`.

        Raises `InputError`, `TrustError` and `OutputError`.
        """
        match = self.hdf4.fullmatch(path.name)
        if match is None:
            raise InputError(f"{path} is no file of MODIS that is read: give {self.example}")
        granule = f"{match['satellite']}{{}}.{match['time']}"
        beside, places = folder / self.beside, granule.format("03")
        with open_hdf4(path) as file:
            if match["kind"] == "03":
                _write_places(beside / f"{places}_lonlat.tif", file.places())
            elif match["kind"] == "35_L2":
                clear = (file.plane("Cloud_Mask") & self.clear_bits) == self.clear_bits
                _write_clear(beside / f"{granule.format('35_L2')}_clear.tif", clear)
            else:
                has_places = any(name.startswith(f"{places}.") for name in names)
                _write_granule(
                    file, folder / path.stem, self.step(match["kind"]), places if has_places else ""
                )


MODIS_FILES: Final = ModisFiles()
"""Those in use."""


def _write_granule(file: Hdf4File, stem: Path, step: int, places: str) -> None:
    """Write what a file with images holds; `places` begins the name of their file, if they lie elsewhere."""
    beside = stem.parent / MODIS_FILES.beside
    place = beside / f"{places if places and step == 1 else stem.name}_lonlat.tif"
    if not places or step > 1:
        own = file.places()
        _write_places(place, own if step > 1 else _between(own, _image_shape(file)))
    # in a row the first pixel of each kilometre lies on its place, and the middle of them along the track
    _write_images(file, stem, geolocation(place, ((step - 1) / 2, step), (0, step)))
    if "QC" in file.shapes:
        _write_clear(beside / f"{stem.name}_clear.tif", (file.plane("QC") & MODIS_FILES.not_produced) == 0)


def _image_shape(file: Hdf4File) -> tuple[int, int]:
    rows, cols = next(shape for name, shape in file.shapes.items() if re.fullmatch(_IMAGES, name))[-2:]
    return rows, cols


def _between(places: Float64, shape: tuple[int, int]) -> Float64:
    """Return the (2, rows, cols) places of all pixels by those of some, each scan by its own alone."""
    (first, last), scan_rows = MODIS_FILES.sampled_rows, MODIS_FILES.scan_rows
    gap = last - first
    if places.shape[1] * scan_rows != 2 * shape[0] or abs(places.shape[2] * gap - shape[1]) > gap:
        raise ValueError(f"{shape} pixels have places at {places.shape[1:]}")
    places = np.where(np.abs(places) <= [[[360.0]], [[90.0]]], places, np.nan)
    lon, lat = np.radians(places)
    away = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    upper, lower = away[:, ::2, None], away[:, 1::2, None]
    down = (np.arange(scan_rows) - first)[:, None] / gap
    away = (upper + down * (lower - upper)).reshape(3, shape[0], -1)
    col = (np.arange(shape[1]) - MODIS_FILES.first_col) / gap
    left = np.clip(np.floor(col), 0, places.shape[2] - 2).astype(np.intp)
    x, y, z = away[:, :, left] + (col - left) * (away[:, :, left + 1] - away[:, :, left])
    return np.degrees([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])


def _write_images(file: Hdf4File, stem: Path, placed: dict[str, str]) -> None:
    for name, shape in file.shapes.items():
        if not re.fullmatch(_IMAGES, name):
            continue
        tags = file.attributes(name)
        numbers = str(tags.get("band_names", "")).rstrip("\0")
        names = [f"B{number}" for number in numbers.split(",")] if numbers else [name]
        count = shape[0] if len(shape) == 3 else 1
        unit = "radiance" if name.endswith("Emissive") else "reflectance"
        scales, offsets = (
            np.atleast_1d(tags.get(f"{unit}_{end}", tags.get(other, default))).astype(np.float64)
            for end, other, default in (("scales", "scale_factor", 1.0), ("offsets", "add_offset", 0.0))
        )
        if not len(names) == len(scales) == len(offsets) == count:
            raise ValueError(f"{name} has {count} bands, and {len(names)} names")
        labels = Labels(
            names,
            0 if name == "LST" else MODIS_FILES.fill,
            scales.tolist(),
            (-scales * offsets).tolist(),
            placed,
        )
        write_planes(stem.with_name(f"{stem.name}_{name}.tif"), _measured(file, name, count), count, labels)


def _measured(file: Hdf4File, name: str, count: int) -> Iterator[NDArray[Any]]:
    """Yield the planes of an array of images; codes of what is missing become one."""
    for number in range(count):
        plane = file.plane(name, number)
        if name != "LST":
            plane[plane > MODIS_FILES.largest_number] = MODIS_FILES.fill
        yield plane


def _write_places(path: Path, places: Float64) -> None:
    labels = Labels(("longitude", "latitude"), MODIS_FILES.no_place)
    write_planes(path, iter(places.astype(np.float32)), 2, labels)


def _write_clear(path: Path, clear: Bool) -> None:
    write_planes(path, iter(clear.astype(np.uint8)[None]), 1, Labels(("clear ground",)))
