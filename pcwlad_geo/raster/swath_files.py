"""Arrays of HDF5 and netCDF-4 whose longitudes and latitudes lie in another file, as VRTs that name both."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.sax.saxutils import escape

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.hdf5 import array_uri, geolocation_metadata, open_hdf5
from pcwlad_geo.raster.trust.local_files import OnDisk, Stamp

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True, slots=True)
class SwathFiles:
    """How the files of a sensor are named, and which arrays place the pixels."""

    images: re.Pattern[str]
    """Whole name of a file with images, whose groups tell scenes apart."""
    partner: str
    """Name of the file that places them, with the groups of `images`, and * for any text."""
    arrays: re.Pattern[str]
    """Paths of the images; the group ``band`` is the name of the band."""
    group: str
    """Path of the longitudes and latitudes in the other file."""

    def geolocation_file(self, image: Path) -> Path:
        """Return the file that places the pixels of an image; raise `InputError` where it is missing."""
        name = self.images.sub(self.partner, image.name)
        candidates = sorted(image.parent.glob(name))
        if not candidates:
            raise InputError(f"{image} is placed by {name}, which is not in its folder: put it there")
        return candidates[-1]  # of the last processing


@dataclass(frozen=True, slots=True)
class CodeParameters:
    """Numbers that are codes of what is missing, such as lines deleted on board, and no measurement."""

    highest: int = 65527
    """Largest measurement in unsigned numbers of 16 bits."""
    lowest: float = -990.0
    """Smallest one in floating point."""


CODES: Final = CodeParameters()
"""Those in use."""
SWATH_FILES: Final = {
    "VIIRS": SwathFiles(
        re.compile(
            r"(?P<satellite>VNP|VJ[12])02(?P<kind>IMG|MOD|DNB)(?:_NRT)?\.(?P<time>A\d{7}\.\d{4})\..*\.nc"
        ),
        r"\g<satellite>03\g<kind>*.\g<time>.*.nc",
        re.compile(r"/observation_data/(?P<band>[IM]\d\d|DNB)(?:_observations)?"),
        "/geolocation_data",
    ),
    "ECOSTRESS": SwathFiles(
        re.compile(
            r"(?P<collection>ECOSTRESS|ECOv\d{3})_(?:L1B_RAD|L2_LSTE)_(?P<scene>\d{5}_\d{3}_\d{8}T\d{6})_.*\.h5"
        ),
        r"\g<collection>_L1B_GEO_\g<scene>_*.h5",
        re.compile(r"/(?:SDS|Radiance)/(?P<band>LST|EmisWB|Emis\d|radiance_\d)"),
        "/Geolocation",
    ),
}
"""VIIRS of level 1B; ECOSTRESS of levels 1B and 2, as seen."""
_GDAL_TYPES: Final = {"|u1": "Byte", "<u2": "UInt16", "<i2": "Int16", "<f4": "Float32"}


def swath_bands(path: Path, file: h5py.File) -> list[tuple[str, str]]:
    """Return the names of the bands in an open file of one of these sensors, and GDAL's names of them.

    Raises `InputError` if the file that places them is missing.
    """
    paths = [f"/{group}/{name}" for group in file for name in getattr(file[group], "keys", tuple)()]
    for files in SWATH_FILES.values():
        if files.images.fullmatch(path.name):
            files.geolocation_file(path)
            named = ((match["band"], at) for at in paths if (match := files.arrays.fullmatch(at)))
            return [(band, array_uri(path, at)) for band, at in sorted(named)]
    return []


def swath_vrt(path: str, array: str) -> str | None:
    """Return the VRT of an image of one of these sensors; None for every other array.

    The file was checked. Raises `InputError` if it is damaged, or the file that places it is missing.
    """
    image = Path(path).absolute()
    for files in SWATH_FILES.values():
        if files.images.fullmatch(image.name) and files.arrays.fullmatch(array):
            return _vrt(files, image, files.geolocation_file(image), array, OnDisk(image).stamp())
    return None


@lru_cache(maxsize=16)  # a job opens a file for every tile
def _vrt(files: SwathFiles, image: Path, placed_by: Path, array: str, _: Stamp) -> str:
    with open_hdf5(image) as file:
        values = file[array]
        rows, cols = values.shape
        kind = _GDAL_TYPES[values.dtype.newbyteorder("<").str]
        fill = _number(values, "_FillValue", -9999.0 if kind == "Float32" else 0.0)
        scale, offset = _number(values, "scale_factor", 1.0), _number(values, "add_offset", 0.0)
    codes = {
        "UInt16": f"0:0,{CODES.highest}:{CODES.highest},{CODES.highest + 0.5}:{fill:g},65535:{fill:g}",
        "Float32": f"{CODES.lowest - 1}:{fill!r},{CODES.lowest}:{CODES.lowest},0:0,1e9:1e9",
    }
    table = f"<LUT>{codes[kind]}</LUT>" if kind in codes else ""
    place = geolocation_metadata(placed_by, *(f"{files.group}/{name}" for name in ("longitude", "latitude")))
    return (
        f'<VRTDataset rasterXSize="{cols}" rasterYSize="{rows}">{place}'
        f'<VRTRasterBand dataType="{kind}" band="1"><NoDataValue>{fill!r}</NoDataValue>'
        f"<Scale>{scale!r}</Scale><Offset>{offset!r}</Offset><ComplexSource>"
        f"<SourceFilename>{escape(array_uri(image, array))}</SourceFilename><SourceBand>1</SourceBand>{table}"
        "</ComplexSource></VRTRasterBand></VRTDataset>"
    )


def _number(values: Any, name: str, default: float) -> float:  # noqa: ANN401  # h5py has no types
    return float(np.ravel(values.attrs.get(name, default))[0])
