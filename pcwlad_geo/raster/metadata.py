"""What a raster carries beside its pixels, and what of it still holds once the pixels have moved."""

from __future__ import annotations

import math

import numpy as np
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.io import DatasetReader

# Georeferencing that a corrected raster must not inherit, and what GDAL derives by itself.
_DROPPED_DOMAINS = frozenset(
    {"RPC", "GEOLOCATION", "IMAGE_STRUCTURE", "DERIVED_SUBDATASETS", "SUBDATASETS", "COLOR_PROFILE"}
)
Tags = dict[str, dict[str, str]]


def kept_tags(source: DatasetReader, band: int = 0) -> Tags:
    """Return the metadata domains of a dataset (band 0) or a band that still hold.

    RPC, GEOLOCATION and STATISTICS_* are left out: they describe the pixels where they were.
    The default domain has the name "".
    """
    domains = ["", *sorted(set(source.tag_namespaces(band)) - _DROPPED_DOMAINS - {""})]
    tags = {domain: _tags(source, band, domain) for domain in domains}
    return {domain: items for domain, items in tags.items() if items}


def _tags(source: DatasetReader, band: int, domain: str) -> dict[str, str]:
    items = source.tags(band, ns=domain) if domain else source.tags(band)
    return {key: str(value) for key, value in items.items() if not key.startswith("STATISTICS_")}


def usable_nodata(source: DatasetReader, band: int = 1) -> float | None:
    """Return the nodata value of a band, or None where there is none or its type cannot hold it."""
    value: float | None = source.nodatavals[band - 1]
    dtype = np.dtype(source.dtypes[band - 1])
    if value is None or dtype.kind in "fc":
        return value
    limits = np.iinfo(dtype)
    fits = math.isfinite(value) and float(value).is_integer() and limits.min <= value <= limits.max
    return value if fits else None


def has_alpha(source: DatasetReader) -> bool:
    """Tell whether a band is an alpha band."""
    return ColorInterp.alpha in source.colorinterp


def has_mask_band(source: DatasetReader) -> bool:
    """Tell whether the dataset has a mask of its own (internal or .msk), not alpha, not nodata."""
    flags = source.mask_flag_enums[0]
    return MaskFlags.per_dataset in flags and MaskFlags.alpha not in flags


def is_paletted(source: DatasetReader) -> bool:
    """Tell whether a band holds indices into a colour table, which must not be interpolated."""
    return ColorInterp.palette in source.colorinterp
