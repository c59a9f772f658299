"""Kinds of masks: files of zeros, and the quality rasters of products."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.file_tree import name_of_uri
from pcwlad_geo.types import Bool

MaskKind = Literal[
    "zeros",
    "QA_PIXEL",
    "BQA",
    "SCL",
    "MSK_CLASSI",
    "Fmask",
    "UDM2",
    "CLM",
    "QL_QUALITY_CLOUD",
    "QL_QUALITY-2",
    "cloud",
    "CloudMask",
    "Cloud_Mask",
    "EMIT mask",
    "Integer_Cloud_Mask",
]
"""zeros: 0 = excluded; the other kinds have the names that the products give them."""

_EXCLUDED: Final[dict[str, tuple[int, ...]]] = {
    "QA_PIXEL": (0, 1, 2, 3, 4),  # fill, dilated cloud, cirrus, cloud, shadow
    "BQA": (0, 1, 4, 6, 8, 12),  # fill, dropped or hidden, cloud, above a third of cloud, shadow, cirrus
    "older BQA": (0, 1, 2, 13, 15),  # fill, dropped, hidden, above a third of cirrus, cloud
    "SCL": (0, 1, 3, 8, 9, 10),  # no data, defective, cloud shadow, medium or high cloud, cirrus
    "Fmask": (0, 1, 2, 3),  # cirrus, cloud, beside cloud or shadow, shadow; fill sets all
}
"""Bits of quality rasters of Landsat and HLS, and classes of Sentinel-2, whose pixels are excluded.

Landsat has the confidence of clouds, shadow and cirrus in thirds. The older kind is that of before the
Collections.
"""
_OLDER_BQA: Final = 1 << 13
"""Least value of before the Collections, which always sets one of the bits that Collection 1 leaves empty."""
_EXCLUDING_BANDS: Final[dict[str, tuple[int, ...]]] = {
    "MSK_CLASSI": (1, 2),  # opaque clouds, cirrus; 3 is snow
    "UDM2": (3, 5, 6, 8),  # shadow, heavy haze, cloud, and the bits of the older mask
    "QL_QUALITY-2": (1, 6, 7),  # shadow, cloud over land, cloud over water
    "EMIT mask": (1, 2, 5),  # clouds, cirrus, near clouds
}
"""Bands of masks of several whose nonzero pixels are excluded."""
_UDM2_OLDER_CLOUD: Final = 1 << 1
"""The bit of band 8 that does not exclude, as it also marks snow."""
_CLOUDS_OF_PRISMA: Final = 1, 255
"""Values of the mask of PRISMA that exclude: clouds, and errors."""
FLAGS_ONLY: Final = ("UDM2", "CLM", "QL_QUALITY_CLOUD", "QL_QUALITY-2", "cloud", "Cloud_Mask", "EMIT mask")
"""Kinds whose 0 is clear ground even where the file declares it as nodata."""
_CLOUD_MASK_BITS: Final = 0b111, 0b001
"""Bits of the mask of ECOSTRESS of Collection 1, and those of clear ground: decided, no cloud, none near."""
_CLEAR_OF_VIIRS: Final = 2, 3
"""Classes of the cloud mask of VIIRS that are clear ground: probably, and confidently."""
_MASK_TYPES: Final = {"EMIT mask": "f"}
"""Kinds of NumPy's types of masks that are not whole numbers."""
_ENDINGS: Final = r"(_\d+m)?(\.\w+)?$"
_MASK_FILES: Final[dict[MaskKind, str]] = {
    "QA_PIXEL": rf"(^|_)QA_PIXEL{_ENDINGS}",
    "BQA": rf"(^|_)BQA{_ENDINGS}",
    "SCL": rf"(^|_)SCL{_ENDINGS}",
    "MSK_CLASSI": rf"(^|_)MSK_CLASSI(_B00)?{_ENDINGS}",
    "Fmask": r"^HLS\..*\.Fmask(\.\w+)?$",
    "UDM2": r"(^|_)udm2(_clip)?(\.\w+)?$",
    "QL_QUALITY_CLOUD": r"^ENMAP.*-QL_QUALITY_CLOUD(_COG)?\.\w+$",
    "QL_QUALITY-2": r"^DESIS-.*-QL_QUALITY-2\.\w+$",
    "cloud": r"^ECOv\d+_L2T_LSTE_.*_cloud\.\w+$|^Cloud_final$",
    "CloudMask": r"^CloudMask$",
    "Cloud_Mask": r"^Cloud_Mask$",
    "EMIT mask": r"^EMIT mask$",
    "Integer_Cloud_Mask": r"^Integer_Cloud_Mask(\?.*)?$",
    "CLM": r"(^|_)CLM_(R[123]|XS)(\.\w+)?$",
}
_OTHERS: Final = re.compile(
    rf"(^|_)(QA_RADSAT|QA_AEROSOL|CLOUD_QA|ST_QA|MSK_(?!CLASSI)[A-Z]+(_B\w\w)?|CLD|SNW){_ENDINGS}|"
    r"^ECOv\d+_L2T_.*_(QC|water|height|view_zenith|LST_err)\.\w+$|^HLS\..*\.[SV][AZ]A\.\w+$|"
    r"_L2A_.*_(ATB|IAB|EDG|SAT|MG2|DFP|DTF|PIX)_(R[123]|XS)\.\w+$|_DN_udm(_clip)?\.\w+$",
    re.IGNORECASE,
)
"""Quality rasters with values of another meaning; as masks of zeros they would exclude the wrong pixels."""


def kind_of(uri: str, descriptions: Sequence[str | None], dtypes: Sequence[str]) -> MaskKind:
    """Return the kind of a mask by the ending of its file name, else by the description of its first band.

    Raises `InputError` if the name is that of an unsupported quality raster, or the bands do not fit the
    name. The `uri` is a path or a GDAL URI; descriptions and data types are those of its bands.
    """
    names = [name_of_uri(uri.replace("\\", "/")), (descriptions[0] or "") if descriptions else ""]
    for name in names:
        for kind in get_args(MaskKind)[1:]:
            if re.search(_MASK_FILES[kind], name, re.IGNORECASE):
                _check(kind, uri, dtypes)
                return kind  # type: ignore[no-any-return]  # get_args has no types
    if _OTHERS.search(names[0]):
        raise InputError(
            f"the mask {uri} is a quality raster whose values are not read: give "
            f"{', '.join(get_args(MaskKind)[1:])}, or a mask of your own (0 = excluded) under another name"
        )
    return "zeros"


def is_quality_raster(name: str) -> bool:
    """Whether a file has the name of a quality raster of a product, which is no image."""
    is_mask = any(re.search(pattern, name, re.IGNORECASE) for pattern in _MASK_FILES.values())
    return is_mask or _OTHERS.search(name) is not None


def bands_of(kind: MaskKind) -> tuple[int, ...]:
    """Return the numbers of the bands, from 1, that a kind of mask consists of."""
    return _EXCLUDING_BANDS.get(kind, (1,))


def files_of_mask(kind: MaskKind, uri: str) -> tuple[str, ...]:
    """Return the files that a mask of a kind consists of, itself first.

    That of EnMAP lies in three. Of an archive whose long names GDAL does not read, it is the first alone.
    """
    if kind != "QL_QUALITY_CLOUD" or uri.startswith("/vsisubfile/"):
        return (uri,)
    folder, _, name = uri.rpartition("-QL_QUALITY_CLOUD")
    return (uri, *(f"{folder}-QL_QUALITY_{part}{name}" for part in ("CLOUDSHADOW", "CIRRUS")))


def accepted(kind: MaskKind, values: NDArray[np.generic]) -> Bool:
    """Return the pixels that a mask does not exclude.

    The (bands, rows, cols) `values` are those of the bands of `bands_of`, with the dtype of the file; NaN
    excludes. The result is a (rows, cols) array of bool.
    """
    if kind in ("QA_PIXEL", "Fmask"):
        return _without(kind, values[0])
    if kind == "UDM2":
        *classes, older = values
        return np.asarray(((older | _UDM2_OLDER_CLOUD) == _UDM2_OLDER_CLOUD) & ~np.any(classes, axis=0))
    if kind == "BQA":
        older, later = (_without(bits, values[0]) for bits in ("older BQA", "BQA"))
        return np.where(values[0] >= _OLDER_BQA, older, later)
    if kind == "SCL":
        return ~np.isin(values[0], _EXCLUDED[kind])
    if kind in ("MSK_CLASSI", "CLM", "QL_QUALITY-2", "QL_QUALITY_CLOUD", "cloud", "EMIT mask"):
        return np.asarray((values == 0).all(axis=0))
    if kind == "Cloud_Mask":
        return ~np.isin(values[0], _CLOUDS_OF_PRISMA)
    if kind == "CloudMask":
        decided, clear = _CLOUD_MASK_BITS
        return np.asarray((values[0] & decided) == clear)
    if kind == "Integer_Cloud_Mask":
        return np.isin(values[0], _CLEAR_OF_VIIRS)
    return np.asarray((values[0] != 0) & np.isfinite(values[0]))


def _without(kind: str, values: NDArray[np.generic]) -> Bool:
    """Return the pixels that have none of the excluded bits of a kind."""
    return np.asarray((values.astype(np.int64) & sum(1 << bit for bit in _EXCLUDED[kind])) == 0)


def _check(kind: MaskKind, uri: str, dtypes: Sequence[str]) -> None:
    count = max(bands_of(kind))
    types = _MASK_TYPES.get(kind, "iu")
    if len(dtypes) < count or any(np.dtype(dtype).kind not in types for dtype in dtypes[:count]):
        plural = "s" if len(dtypes) != 1 else ""
        content = f"{len(dtypes)} band{plural} of type {', '.join(sorted(set(dtypes)))}"
        raise InputError(
            f"the mask {uri} is named like a {kind} raster, which has {count} whole-number "
            f"band{'s' if count > 1 else ''}, and holds {content}: give the product's own file, or rename a "
            "mask of your own (0 = excluded)"
        )
