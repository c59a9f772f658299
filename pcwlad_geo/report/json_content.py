"""What JSON files of results share: dataclasses filled from others, rounded numbers, versions, the text."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from typing import Any, TypeVar

import rasterio

from pcwlad_geo.text import plain

LIBRARIES = ("numpy", "scipy", "cv2", "rasterio", "pyproj")
"""Libraries whose versions the report states."""
PX_DIGITS, M_DIGITS, SECONDS_DIGITS, SHARE_DIGITS = 5, 4, 3, 3
"""Numbers of decimal places of pixels, metres, seconds and shares."""

T = TypeVar("T")


def to_json(content: object) -> str:
    """Return `content` as the text of a JSON file; `plain` defines how values are written."""
    return json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def filled(kind: type[T], /, *sources: object, **values: Any) -> T:  # noqa: ANN401  # of the fields' types
    """Return a dataclass of a `kind`; fields not in `values` are those of the first source that has them."""
    for name in {field.name for field in fields(kind)} - values.keys():  # type: ignore[arg-type]
        values_of_sources = [getattr(source, name) for source in sources if hasattr(source, name)]
        values |= {name: values_of_sources[0]} if values_of_sources else {}
    return kind(**values)


def rounded(value: T, digits: int = PX_DIGITS) -> T:
    """Return a value with all numbers in it, also nested ones, rounded to `digits` decimal places."""
    result: Any = value
    if isinstance(value, float):
        result = round(value, digits)
    elif isinstance(value, Mapping):
        result = {name: rounded(item, digits) for name, item in value.items()}
    elif isinstance(value, list | tuple):
        result = type(value)(rounded(item, digits) for item in value)
    elif is_dataclass(value) and not isinstance(value, type):
        result = replace(
            value, **{field.name: rounded(getattr(value, field.name), digits) for field in fields(value)}
        )
    return result  # type: ignore[no-any-return]


def versions() -> dict[str, str]:
    """Return the versions of this package, Python, GDAL and the numerical libraries."""
    return {
        # Of the code that runs, which may differ from the installed package.
        "pcwlad-geo": str(import_module("pcwlad_geo").__version__),
        "python": platform.python_version(),
        "gdal": rasterio.__gdal_version__,
        **{name: str(import_module(name).__version__) for name in LIBRARIES},
    }
