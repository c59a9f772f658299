"""HDF4 files of the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

Arrays = dict[str, tuple[np.ndarray, dict[str, Any]]]


def write_hdf4(path: Path, arrays: Arrays, structure: str = "") -> Path:
    """Write compressed arrays with attributes: text, whole numbers, or lists of numbers.

    Those of a swath of HDF-EOS, whose `structure` is told, are named ``swath:name``.
    """
    sd: Any = __import__("pyhdf.SD").SD
    types = {
        "uint8": sd.SDC.UINT8,
        "int8": sd.SDC.INT8,
        "uint16": sd.SDC.UINT16,
        "float32": sd.SDC.FLOAT32,
        "float64": sd.SDC.FLOAT64,
    }
    path.parent.mkdir(exist_ok=True, parents=True)
    file = sd.SD(str(path), sd.SDC.WRITE | sd.SDC.CREATE | sd.SDC.TRUNC)
    for name, (values, attributes) in arrays.items():
        swath, _, own_name = name.rpartition(":")
        array = file.create(own_name, types[values.dtype.name], values.shape)
        for axis, size in enumerate(values.shape if swath else ()):
            array.dim(axis).setname(f"Axis{axis}of{size}:{swath}")
        array.setcompress(sd.SDC.COMP_DEFLATE, 1)
        array[:] = values
        for key, value in attributes.items():
            if isinstance(value, list):
                array.attr(key).set(sd.SDC.FLOAT32, value)
            else:
                setattr(array, key, value)
        array.endaccess()
    if structure:
        setattr(file, "StructMetadata.0", structure)
    file.end()
    return path
