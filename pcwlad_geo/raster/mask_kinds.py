"""Which pixels a mask excludes: GDAL's zeros, or the clouds of Landsat's and Sentinel-2's quality rasters."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.file_tree import name_of_uri

MaskKind = Literal["zeros", "QA_PIXEL", "SCL", "MSK_CLASSI"]
"""zeros: 0 = excluded; the others are named as their products name them."""

QA_PIXEL_BITS: Final = (0, 1, 2, 3, 4)
"""Rejected bits of Landsat Collection 2: fill, dilated cloud, cirrus, cloud, cloud shadow."""
SCL_CLASSES: Final = (0, 1, 3, 8, 9, 10)
"""Rejected classes of Sentinel-2 L2A: no data, defective, cloud shadow, cloud (medium, high), thin cirrus."""
CLASSI_BANDS: Final = (1, 2)
"""Bands of the Sentinel-2 mask that are rejected where not 0: opaque clouds, cirrus (3 is snow)."""

_ENDINGS: Final = r"(_\d+m)?(\.\w+)?$"
_NAMES: Final[dict[MaskKind, str]] = {
    "QA_PIXEL": rf"(^|_)QA_PIXEL{_ENDINGS}",
    "SCL": rf"(^|_)SCL{_ENDINGS}",
    "MSK_CLASSI": rf"(^|_)MSK_CLASSI(_B00)?{_ENDINGS}",
}
_OTHERS: Final = re.compile(
    rf"(^|_)(BQA|QA_RADSAT|QA_AEROSOL|CLOUD_QA|ST_QA|MSK_(?!CLASSI)[A-Z]+(_B\w\w)?|CLD|SNW){_ENDINGS}",
    re.IGNORECASE,
)
"""Quality rasters whose values mean something else: read as zeros they would exclude the wrong pixels."""


def kind_of(uri: str, descriptions: Sequence[str | None], dtypes: Sequence[str]) -> MaskKind:
    """Tell a mask's kind by the ending of its file's name, else by the description of its first band.

    Parameters
    ----------
    uri : str
        Path or GDAL URI.
    descriptions, dtypes : sequence of str
        Of its bands.

    Raises
    ------
    InputError
        If the name is that of a quality raster that is not read, or of one that is and the bands are not.
    """
    names = [name_of_uri(uri.replace("\\", "/")), (descriptions[0] or "") if descriptions else ""]
    for name in names:
        for kind in get_args(MaskKind)[1:]:
            if re.search(_NAMES[kind], name, re.IGNORECASE):
                _check(kind, uri, dtypes)
                return kind  # type: ignore[no-any-return]  # get_args has no types
    if _OTHERS.search(names[0]):
        raise InputError(
            f"the mask {uri} is a quality raster whose values are not read: give QA_PIXEL, SCL, MSK_CLASSI, "
            "or a mask of your own (0 = excluded) under another name"
        )
    return "zeros"


def bands_of(kind: MaskKind) -> tuple[int, ...]:
    """Return the bands of a mask that its kind needs."""
    return CLASSI_BANDS if kind == "MSK_CLASSI" else (1,)


def accepted(kind: MaskKind, values: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Say which pixels a mask leaves.

    Parameters
    ----------
    kind : MaskKind
    values : (bands, rows, cols) array
        The bands of `bands_of`, as the file stores them.

    Returns
    -------
    (rows, cols) array of bool
        False = excluded; NaN excludes.
    """
    if kind == "QA_PIXEL":
        rejected = sum(1 << bit for bit in QA_PIXEL_BITS)
        return np.asarray((values[0].astype(np.int64) & rejected) == 0)
    if kind == "SCL":
        return np.asarray(~np.isin(values[0], SCL_CLASSES))
    if kind == "MSK_CLASSI":
        return np.asarray((values == 0).all(axis=0))
    return np.asarray((values[0] != 0) & np.isfinite(values[0]))


def _check(kind: MaskKind, uri: str, dtypes: Sequence[str]) -> None:
    wanted = max(bands_of(kind))
    if len(dtypes) < wanted or any(np.dtype(dtype).kind not in "iu" for dtype in dtypes[:wanted]):
        held = f"{len(dtypes)} band{'s' if len(dtypes) != 1 else ''} of type {', '.join(sorted(set(dtypes)))}"
        raise InputError(
            f"the mask {uri} is named like a {kind} raster, which has {wanted} whole-number "
            f"band{'s' if wanted > 1 else ''}, and holds {held}: give the product's own file, or rename a "
            "mask of your own (0 = excluded)"
        )
