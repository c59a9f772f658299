"""Temperatures of radiometric JPEGs by readers that the user has: flyr for FLIR, DJI's own library."""

from __future__ import annotations

import ctypes
import os
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.jpeg_segments import segments
from pcwlad_geo.types import Float32

Maker = Literal["FLIR", "DJI"]
DJI_LIBRARY: Final = "PCWLAD_GEO_DJI_SDK"
"""Environment variable with the path of libdirp of DJI's Thermal SDK, which may not be passed on."""
FLYR: Final = "flyr"
"""Reader of FLIR's JPEGs. Its licence, the EUPL, is not permissive: it is neither required nor an extra."""
ZERO_C_K: Final = 273.15
"""0 °C in kelvin."""
_APP1, _APP3 = 0xE1, 0xE3
_LEAST_BYTES: Final = 100_000
"""Of DJI's segments with the readings of a sensor; the smallest has 256 x 160 of two bytes, less a header."""


def maker_of(path: str) -> Maker | None:
    """Return whose radiometric JPEG a file is; None of another file."""
    if Path(path).suffix.lower() not in (".jpg", ".jpeg"):
        return None
    try:
        parts = list(segments(Path(path).read_bytes()))
    except OSError:
        return None
    if any(marker == _APP1 and content.startswith(b"FLIR\0") for marker, content in parts):
        return "FLIR"
    readings = sum(len(content) for marker, content in parts if marker == _APP3)
    is_dji = any(marker == _APP1 and b"drone-dji" in content for marker, content in parts)
    return "DJI" if is_dji and readings > _LEAST_BYTES // 2 else None


def problem_of(maker: Maker) -> str | None:
    """Return why the temperatures of a maker's JPEGs cannot be read, and what to do; None if they can."""
    if maker == "DJI":
        library = os.environ.get(DJI_LIBRARY)
        return None if library else f"set {DJI_LIBRARY} to the path of libdirp of DJI's Thermal SDK"
    try:
        import_module(FLYR)
    except ImportError:
        return "install flyr"
    return None


def temperatures_k(path: str, maker: Maker) -> Float32:
    """Return the (rows, cols) temperatures of a radiometric JPEG, kelvin.

    Raises `InputError` if the reader of its maker cannot read them.
    """
    try:
        values = (
            _of_dji(path) if maker == "DJI" else np.ascontiguousarray(unpacked_flir(path).kelvin, np.float32)
        )
    except Exception as error:  # of any kind: readers of others, on files of strangers
        raise InputError(f"the temperatures of {path} cannot be read: {error}") from error
    if values.ndim != 2 or not np.isfinite(values).all():
        raise InputError(f"the temperatures of {path} cannot be read: they are no finite numbers")
    return values


def unpacked_flir(path: str) -> Any:  # noqa: ANN401  # flyr has its own types
    """Return what flyr reads of a JPEG: kelvin, optical, pip_info; raises errors of any kind."""
    return import_module(FLYR).unpack(path)


class _Resolution(ctypes.Structure):
    _fields_ = (("width", ctypes.c_int32), ("height", ctypes.c_int32))


def _of_dji(path: str) -> Float32:
    """Call the library that the user names, by the functions of its header dirp_api.h."""
    library = ctypes.CDLL(os.environ[DJI_LIBRARY])
    block, handle, size = Path(path).read_bytes(), ctypes.c_void_p(), _Resolution()
    _check(library.dirp_create_from_rjpeg(block, ctypes.c_int32(len(block)), ctypes.byref(handle)))
    try:
        _check(library.dirp_get_rjpeg_resolution(handle, ctypes.byref(size)))
        if not 0 < size.width * size.height < len(block):
            raise ValueError(f"{size.width} x {size.height} px")
        celsius = np.empty((size.height, size.width), np.float32)
        pointer = celsius.ctypes.data_as(ctypes.c_void_p)
        _check(library.dirp_measure_ex(handle, pointer, ctypes.c_int32(celsius.nbytes)))
    finally:
        library.dirp_destroy(handle)
    return celsius + np.float32(ZERO_C_K)


def _check(code: int) -> None:
    if code != 0:
        raise OSError(f"DJI's library answers with the code {code}")
