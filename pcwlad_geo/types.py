"""Types that several rooms share: arrays by the type of their values, and paths."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Floating = NDArray[np.floating[Any]]
Complex64 = NDArray[np.complex64]
Bool = NDArray[np.bool_]
Index = NDArray[np.intp]
PathLike = str | os.PathLike[str]
