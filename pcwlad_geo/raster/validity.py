"""How a warped raster tells which of its pixels are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.io import DatasetReader

from pcwlad_geo.raster.metadata import has_alpha, has_mask_band, usable_nodata


def validity(source: DatasetReader) -> tuple[float | None, bool, bool]:
    """Return the nodata value of the output, whether it is filled in here, and whether there is a mask."""
    nodata = _output_nodata(source)
    # GDAL's warper is almost three times as slow where it fills in nodata itself, but knows it band by band
    fills = nodata is not None and source.count == 1 and not has_alpha(source)
    return nodata, fills, nodata is None and not has_alpha(source)


def _output_nodata(source: DatasetReader) -> float | None:
    nodata = usable_nodata(source)
    if nodata is None and not has_alpha(source) and not has_mask_band(source):
        floating = np.result_type(*source.dtypes).kind == "f"
        return math.nan if floating else None
    return nodata


def fill(values: NDArray[Any], valid: NDArray[np.bool_], nodata: float) -> None:
    """Write the nodata value where a band is not valid, and only there; in place.

    A valid pixel that happens to be as large becomes the next larger value, or smaller where there is none.
    """
    if values.dtype.kind == "f":
        beside = np.nextafter(values.dtype.type(nodata), values.dtype.type(np.inf))
    else:
        beside = int(nodata) + (1 if nodata < np.iinfo(values.dtype).max else -1)
    values[values == nodata] = beside
    values[~valid] = nodata
