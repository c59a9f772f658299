"""ASTER of level 1B and surface temperature in HDF4: the files, and their bands and places as GeoTIFFs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.hdf4 import Hdf4File, Labels, geolocation, open_hdf4, write_planes
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class AsterFiles:
    """Names of the files, and the numbers of their format."""

    hdf4: re.Pattern[str] = re.compile(r"AST_(?P<kind>L1B|08)_(?P<scene>\d{17}_\d{14}_\d+)\.hdf")
    """Whole name of a file that is read."""
    raster: re.Pattern[str] = re.compile(
        r"AST_(?P<kind>L1B|08)_(?P<scene>\d{17}_\d{14}_\d+)_(?:B\d{1,2}N?|KineticTemperature)\.tif"
    )
    """Whole name of what is written of a band."""
    images: re.Pattern[str] = re.compile(
        r"(?P<swath>\w+):(?:ImageData(?P<band>\d{1,2}N?)|KineticTemperature)"
    )
    """Whole name of an array with a band, after its swath."""
    beside: str = "beside"
    """Folder of what is written of places."""
    temperature_scale: float = 0.1
    """Kelvin by a number."""
    second_eccentricity: float = 0.006694379990141317
    """Square of that of WGS 84, by which level 1 has geocentric latitudes."""

    def granule_of(self, name: str, names: Sequence[str]) -> list[str]:
        """Return, of the `names` of a folder, those of the scene of a file: itself."""
        return [name] if self.hdf4.fullmatch(name) and name in names else []

    def has_images(self, names: Sequence[str]) -> bool:
        """Whether there is a file with images among those of these `names`."""
        return any(map(self.hdf4.fullmatch, names))

    def write_rasters(self, path: Path, folder: Path) -> None:
        """Write the bands of a file into a folder, with its places beside them.

        Raises `InputError`, `TrustError` and `OutputError`.
        """
        match = self.hdf4.fullmatch(path.name)
        if match is None:
            raise InputError(f"{path} is no file of ASTER that is read: give AST_L1B_….hdf or AST_08_….hdf")
        with open_hdf4(path) as file:
            arrays = [image for name in file.shapes if (image := self.images.fullmatch(name))]
            if not arrays:
                raise ValueError("it has none of the images of its product")
            for swath in dict.fromkeys(image["swath"] for image in arrays):
                places = self._places(file, swath, geocentric=match["kind"] == "L1B")
                labels = Labels(("longitude", "latitude"))
                write_planes(
                    folder / self.beside / f"{path.stem}_{swath}_lonlat.tif", iter(places), 2, labels
                )
            for image in arrays:
                place = folder / self.beside / f"{path.stem}_{image['swath']}_lonlat.tif"
                name = f"B{image['band']}" if image["band"] else "KineticTemperature"
                scales = () if image["band"] else (self.temperature_scale,)
                labels = Labels((name,), 0, scales, (), _geolocation(file, image["swath"], place))
                write_planes(folder / f"{path.stem}_{name}.tif", iter([file.plane(image[0])]), 1, labels)

    def _places(self, file: Hdf4File, swath: str, *, geocentric: bool) -> Float64:
        """Return the (2, rows, cols) longitudes and latitudes of a swath, the latter geodetic."""
        lon, lat = file.places(swath)
        if geocentric:
            lat = np.degrees(np.arctan(np.tan(np.radians(lat)) / (1.0 - self.second_eccentricity)))
        return np.stack([lon, lat])


ASTER_FILES: Final = AsterFiles()
"""Those in use."""


def _geolocation(file: Hdf4File, swath: str, place: Path) -> dict[str, str]:
    """Return the metadata that place the pixels of a swath, as its own maps of dimensions say."""
    text = re.search(rf'SwathName="{re.escape(swath)}"(.*?)GROUP=GeoField', file.structure, re.DOTALL)
    places = []
    for dimension in ("ImageLine", "ImagePixel"):
        numbers = text and re.search(
            rf'DataDimension="{dimension}"\s*Offset=(\d+)\s*Increment=(\d+)', text[1]
        )
        if not numbers:
            raise ValueError(f"{swath} does not say which {dimension}s have places")
        places.append((int(numbers[1]), int(numbers[2])))
    return geolocation(place, *places)
