"""HDF4, for which most builds of GDAL have no driver: its arrays, and GeoTIFFs of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.geolocation import DOMAIN
from pcwlad_geo.raster.opening import check_source
from pcwlad_geo.raster.writing import scratch_folder, sink
from pcwlad_geo.types import Float64


class Hdf4File:
    """An open file."""

    def __init__(self, opened: Any) -> None:  # noqa: ANN401  # pyhdf has no types
        self._opened = opened
        self._numbers: dict[str, int] = {}
        self.shapes: dict[str, tuple[int, ...]] = {}
        """Shapes of the arrays by name; of swaths of HDF-EOS, of which several have the same, by
        ``swath:name`` too."""
        for number in range(opened.info()[0]):
            array = opened.select(number)
            name, rank, shape, *_ = array.info()
            swath = array.dim(0).info()[0].partition(":")[2] if rank else ""
            for key in {name, f"{swath}:{name}" if swath else name} - self._numbers.keys():
                self._numbers[key], self.shapes[key] = number, tuple(np.atleast_1d(shape).tolist())

    @property
    def structure(self) -> str:
        """How HDF-EOS tells the structure of its swaths; empty of other files."""
        return str(self._opened.attributes().get("StructMetadata.0", ""))

    def attributes(self, name: str) -> dict[str, Any]:
        """Return the attributes of an array."""
        return dict(self._opened.select(self._numbers[name]).attributes())

    def plane(self, name: str, number: int = 0) -> NDArray[Any]:
        """Return the (rows, cols) values of an array, or of one of its planes.

        Raises `ValueError` if it has none, or more than can be read.
        """
        *planes, rows, cols = self.shapes[name]
        if len(planes) > 1 or not 0 < rows * cols <= LIMITS.checked_px:
            raise ValueError(f"{name} has the shape {self.shapes[name]}")
        start, count = ([number] * len(planes), [1] * len(planes))
        values = self._opened.select(self._numbers[name]).get(
            start=[*start, 0, 0], count=[*count, rows, cols]
        )
        return np.reshape(values, (rows, cols))

    def places(self, swath: str = "") -> Float64:
        """Return the (2, rows, cols) longitudes and latitudes of the file, or of one of its swaths."""
        prefix = f"{swath}:" if swath else ""
        return np.stack([self.plane(prefix + name).astype(np.float64) for name in ("Longitude", "Latitude")])


@contextmanager
def open_hdf4(path: Path) -> Iterator[Hdf4File]:
    """Open an HDF4 file, after the check that all of it is inside.

    Raises `InputError` if it is damaged or lacks what is read, or pyhdf is missing, and `TrustError` if it
    refers to other files.
    """
    check_source(str(path))
    try:
        from pyhdf.error import HDF4Error  # optional, and rarely needed
        from pyhdf.SD import SD
    except ImportError as error:
        raise InputError(f"{path}: pip install 'pcwlad-geo[hdf4]' to read HDF4") from error
    try:
        opened = SD(str(path))
        try:
            yield Hdf4File(opened)
        finally:
            opened.end()
    except (HDF4Error, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"{path} is damaged, or lacks a part: {error}; get it again") from error


@dataclass(frozen=True, slots=True)
class Labels:
    """What a GeoTIFF of arrays says besides their values."""

    names: Sequence[str] = ()
    """Descriptions of the bands."""
    nodata: float | None = None
    scales: Sequence[float] = ()
    offsets: Sequence[float] = ()
    """Physical value = number · scale + offset."""
    geolocation: Mapping[str, str] = field(default_factory=dict)
    """GDAL's metadata domain GEOLOCATION."""
    transform: Affine | None = None
    crs: CRS | None = None


def geolocation(place: Path, line: tuple[float, float], pixel: tuple[float, float]) -> dict[str, str]:
    """Return the metadata that place pixels by a GeoTIFF of longitudes and latitudes.

    The `line` and the `pixel` are the first that has a place, and how many there are from one to the next.
    """
    tags = {"X_DATASET": place.absolute(), "Y_DATASET": place.absolute(), "X_BAND": 1, "Y_BAND": 2}
    tags |= {"LINE_OFFSET": line[0], "LINE_STEP": line[1], "PIXEL_OFFSET": pixel[0], "PIXEL_STEP": pixel[1]}
    tags |= {"SRS": "EPSG:4326", "GEOREFERENCING_CONVENTION": "PIXEL_CENTER"}
    return {key: str(value) for key, value in tags.items()}


def write_planes(path: Path, planes: Iterator[NDArray[Any]], count: int, labels: Labels) -> None:
    """Write (rows, cols) `planes` as the bands of a GeoTIFF.

    Raises `OutputError` if that is impossible, and `ValueError` if there is none.
    """
    first = next(planes, None)
    if first is None:
        raise ValueError("an array of it has no bands")
    rows, cols = first.shape
    profile = {"driver": "GTiff", "height": rows, "width": cols, "count": count, "dtype": first.dtype.name}
    profile |= {"tiled": True, "blockxsize": 256, "blockysize": 256, "interleave": "band", "sparse_ok": False}
    profile |= {"nodata": labels.nodata, "crs": labels.crs}
    path.parent.mkdir(parents=True, exist_ok=True)
    with scratch_folder(path) as folder:
        with sink(folder / path.name, profile) as file:
            if labels.transform is not None:
                file.transform = labels.transform
            for number in range(1, count + 1):
                file.write(first if number == 1 else next(planes), number)
            file.scales, file.offsets = labels.scales or [1.0] * count, labels.offsets or [0.0] * count
            file.descriptions = labels.names or [None] * count
            if labels.geolocation:
                file.update_tags(ns=DOMAIN, **labels.geolocation)
        (folder / path.name).replace(path)
