"""Which pixel values can be measurements: fill values such as ±3.4e38 or 1e20 are none.

One pixel of such a value makes a mean or a range of a whole image useless, or infinite.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.types import Bool

LARGEST_VALUE: Final = 0.999e20
"""No sensor gives values as large as this. Common fill values are: 1e20 (CF conventions), 9.97e36 (NetCDF),
the largest numbers of float32 and float64. It is a little below 1e20, as that may have been rounded."""
LARGEST_DEVIATION: Final = 1e4
"""Largest distance of a value from the median of its image, in ranges that hold 99.9 % of the values. Beyond
it numbers of 32 bits keep too few digits of the rest."""

Limits = tuple[float, float]
"""The least and the largest value that counts."""
ALL_VALUES: Final[Limits] = (-LARGEST_VALUE, LARGEST_VALUE)
"""The limits of an image of which nothing is known."""


def is_plausible(values: NDArray[Any], limits: Limits = ALL_VALUES) -> Bool:
    """Return which of the (…,) `values` are finite and within the `limits`, (…,) bool."""
    if np.issubdtype(values.dtype, np.integer):
        held = np.iinfo(values.dtype)
        if limits[0] <= held.min and held.max <= limits[1]:
            return np.ones(values.shape, bool)
    with np.errstate(over="ignore"):  # of numbers of 16 bits, which hold no such limits
        return np.asarray((values >= limits[0]) & (values <= limits[1]))


def plausible_limits(values: NDArray[Any]) -> Limits:
    """Return the limits of what can be a measurement among the values of an image.

    The (n,) `values` are a sample of those that are not marked as nodata.
    """
    plausible = values[is_plausible(values)].astype(np.float64)
    if plausible.size == 0:
        return ALL_VALUES
    low, middle, high = np.percentile(plausible, (0.05, 50, 99.95)).tolist()
    reach = LARGEST_DEVIATION * (high - low)
    if reach == 0:
        return ALL_VALUES
    return max(middle - reach, -LARGEST_VALUE), min(middle + reach, LARGEST_VALUE)
