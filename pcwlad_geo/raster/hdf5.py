"""HDF5 and netCDF-4: their structure, and GDAL's names of what is in them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

from pcwlad_geo.errors import InputError

if TYPE_CHECKING:
    import h5py


def array_uri(path: Path, array: str) -> str:
    """Return GDAL's name of an array of a file."""
    return f'HDF5:"{path}":/{array.replace(" ", "_")}'


@contextmanager
def open_hdf5(path: str | Path) -> Iterator[h5py.File]:
    """Open an HDF5 file that was checked; raise `InputError` if it is damaged, or lacks what is read."""
    try:
        import h5py  # optional, and rarely needed
    except ImportError as error:
        raise InputError(f"{path}: pip install 'pcwlad-geo[hdf5]' to read its structure") from error
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except (OSError, RuntimeError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"{path} is damaged, or lacks a part: {error}; get it again") from error


def geolocation_metadata(path: Path, longitudes: str, latitudes: str) -> str:
    """Return the element of a VRT that names the arrays with longitude and latitude of each pixel."""
    tags = {"X_DATASET": array_uri(path, longitudes), "Y_DATASET": array_uri(path, latitudes)}
    tags |= {"GEOREFERENCING_CONVENTION": "PIXEL_CENTER"}
    items = "".join(f'<MDI key="{key}">{escape(value)}</MDI>' for key, value in tags.items())
    return f'<Metadata domain="GEOLOCATION">{items}</Metadata>'
