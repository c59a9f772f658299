"""Coefficients of the cubic B-spline through an image's pixels.

References
----------
.. [1] Unser, M. (1999), Splines: a perfect fit for signal and image processing, doi:10.1109/79.799930.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

POLE: Final = float(np.sqrt(3.0)) - 2.0
REACH_PX: Final = 12
"""The prefilter's response falls to 1e-7 of its peak within this distance."""

Float32 = NDArray[np.float32]


def spline_coefficients(image: Float32, out: Float32) -> None:
    """Prefilter an image for cubic B-spline interpolation; it continues mirrored about its outermost pixels.

    Parameters
    ----------
    image : (rows, cols) float32 array
    out : (rows, cols) float32 array
        Filled as `scipy.ndimage.spline_filter` would, to 1e-6 of its range.

    Notes
    -----
    The recursive filter, cut off where float32 ends, is a short symmetric kernel: several times as fast.
    """
    kernel = POLE ** np.abs(np.arange(-REACH_PX, REACH_PX + 1))
    kernel /= kernel.sum()
    cv2.sepFilter2D(image, -1, kernel, kernel, dst=out, borderType=cv2.BORDER_REFLECT_101)
