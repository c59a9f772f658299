"""Cubes in HDF5 whose bands are not their first axis, PRISMA's and EMIT's, as VRTs of one slice a band."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import rasterio
from rasterio.crs import CRS
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.hdf5 import geolocation_metadata, open_hdf5
from pcwlad_geo.raster.swath_files import swath_vrt
from pcwlad_geo.raster.trust.local_files import OnDisk, Stamp

_URI: Final = re.compile(r'HDF5:"?(?P<file>[^"]+?)"?:/(?P<array>/[^"]+)')
"""GDAL's name of an array, spaces of whose path it writes as underscores."""
_PRISMA: Final = re.compile(r"/HDFEOS/SWATHS/PRS_L(?P<level>1|2B|2C|2D)_HCO/Data Fields/(?:VNIR|SWIR)_Cube")
_EMIT: Final = ("/reflectance", "/mask")
_CORNERS: Final = (
    *("Product_ULcorner_easting", "Product_ULcorner_northing"),
    *("Product_LRcorner_easting", "Product_LRcorner_northing"),
)


@dataclass(frozen=True, slots=True)
class CubeParameters:
    """How a cube without geotransform is placed."""

    pixel_m: float = 30.0
    """Pixel size of PRISMA L2D, by which corners of the image are told from centres of its pixels."""
    gdal: tuple[int, int] = (3, 9)
    """The first version of GDAL that reads slices of arrays in a VRT; earlier ones give empty bands."""
    fill: float = -9999.0
    """Value of EMIT's pixels without data."""


CUBES: Final = CubeParameters()
"""The numbers in use."""


class CubeReader(DatasetReader):  # type: ignore[misc]  # rasterio has no types
    """A cube that is open as a VRT, and has the name by which it is opened again."""

    def __init__(self, uri: str, cube: str, options: Mapping[str, object]) -> None:
        super().__init__(cube, driver=["VRT"], **options)
        self._uri = uri

    @property
    def name(self) -> str:
        """GDAL's name of the array."""
        return self._uri


def as_vrt(uri: str) -> str | None:
    """Return the VRT of a cube or swath by its name; None for all that GDAL opens as it should.

    The file was checked. Raises `InputError` if it is damaged, or the file that places a swath is missing.
    """
    match = _URI.fullmatch(uri)
    array = match["array"].replace("Data_Fields", "Data Fields") if match else ""
    if match is None:
        return None
    if not (array in _EMIT or _PRISMA.fullmatch(array)):
        return swath_vrt(match["file"], array)
    if tuple(map(int, rasterio.__gdal_version__.split(".")[:2])) < CUBES.gdal:
        raise InputError(
            f"{uri} has its bands in the middle or last, which GDAL {rasterio.__gdal_version__} does not "
            "read: update it to 3.9 (pip install -U rasterio)"
        )
    return _vrt(match["file"], array, OnDisk(Path(match["file"])).stamp())


@lru_cache(maxsize=16)  # a job opens a file for every tile
def _vrt(path: str, array: str, _: Stamp) -> str | None:
    prisma = _PRISMA.fullmatch(array)
    with open_hdf5(path) as file:
        values = file[array]
        if values.ndim != 3 or (prisma is None and "location/lon" not in file):
            return None
        if prisma:
            rows, bands, cols = values.shape
            view = ":,{},:"
        else:
            rows, cols, bands = values.shape
            view = ":,:,{}"
        kind = {"u2": "UInt16", "f4": "Float32"}[values.dtype.str[1:]]
        if prisma and prisma["level"] == "2D":
            place = _geotransform(file, (rows, cols))
        else:  # a mask counts by its pixels
            place = "" if array == "/mask" else _geolocation(file, path, array, prisma is not None)
    nodata = 0 if prisma else CUBES.fill
    source = (
        "<ArraySource><DerivedArray><SingleSourceArray><SourceFilename>"
        f"{escape(str(Path(path).absolute()))}</SourceFilename><SourceArray>{escape(array)}</SourceArray>"
        '</SingleSourceArray><Step><View expr="[{}]"/></Step></DerivedArray></ArraySource>'
    )
    described = "<Description>EMIT mask</Description>" if array == "/mask" else ""
    parts = (
        f'<VRTRasterBand dataType="{kind}" band="{band + 1}">{described}<NoDataValue>{nodata}</NoDataValue>'
        f"{source.format(view.format(band))}</VRTRasterBand>"
        for band in range(bands)
    )
    return f'<VRTDataset rasterXSize="{cols}" rasterYSize="{rows}">{place}{"".join(parts)}</VRTDataset>'


def _geotransform(file: Any, shape: tuple[int, int]) -> str:  # noqa: ANN401  # h5py has no types
    """Return the elements that place a cube by the corners that its attributes tell."""
    left, top, right, bottom = (float(file.attrs[name]) for name in _CORNERS)
    crs = CRS.from_epsg(int(file.attrs["Epsg_Code"]))
    rows, cols = shape
    centres = abs((right - left) / (cols - 1) - CUBES.pixel_m) < abs((right - left) / cols - CUBES.pixel_m)
    gaps = (cols - 1, rows - 1) if centres else (cols, rows)
    px, py = (right - left) / gaps[0], (bottom - top) / gaps[1]
    x, y = (left - px / 2, top - py / 2) if centres else (left, top)
    return f"<SRS>{escape(crs.to_wkt())}</SRS><GeoTransform>{x!r},{px!r},0,{y!r},0,{py!r}</GeoTransform>"


def _geolocation(file: Any, path: str, array: str, is_prisma: bool) -> str:  # noqa: ANN401
    """Return the metadata that name the longitudes and latitudes of all pixels, as GDAL has them."""
    if not is_prisma:
        group, names = file["location"], ("lon", "lat")
    else:
        group = file[array.partition("/Data Fields")[0] + "/Geolocation Fields"]
        ending = f"_{array[-9:-5]}" if f"Longitude_{array[-9:-5]}" in group else ""
        names = (f"Longitude{ending}", f"Latitude{ending}")
    if group[names[0]].shape != group[names[1]].shape or group[names[0]].ndim != 2:
        raise ValueError(f"{names[0]} has another shape than {names[1]}")
    return geolocation_metadata(Path(path).absolute(), *(group[name].name for name in names))
