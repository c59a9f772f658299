"""HDF4 files of the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

Arrays = dict[str, tuple[np.ndarray, dict[str, Any]]]


def write_hdf4(path: Path, arrays: Arrays) -> Path:
    """Write compressed arrays with attributes: text, whole numbers, or lists of numbers."""
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
        array = file.create(name, types[values.dtype.name], values.shape)
        array.setcompress(sd.SDC.COMP_DEFLATE, 1)
        array[:] = values
        for key, value in attributes.items():
            if isinstance(value, list):
                array.attr(key).set(sd.SDC.FLOAT32, value)
            else:
                setattr(array, key, value)
        array.endaccess()
    file.end()
    return path
