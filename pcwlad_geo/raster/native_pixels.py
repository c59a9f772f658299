"""What the file names and band descriptions of known products say about a band."""

from __future__ import annotations

import re
from typing import Final

import numpy as np
from numpy.typing import NDArray

_LANDSAT: Final = re.compile(r"^L([COTEM])0([1-9])_\w{4}_\d{6}_.*?_(?:(?:SR|ST)_)?B(\d+)$", re.IGNORECASE)
_SENTINEL2: Final = re.compile(
    r"^(?:L2A_)?(?:T\d{2}[A-Z]{3}_\d{8}T\d{6}|S2[A-D]_.*)_B(\d{1,2}|8A)(?:_\d+m)?$", re.IGNORECASE
)
_SURFACE_TEMPERATURE: Final = re.compile(r"^ST_B(\d+)$", re.IGNORECASE)

_THERMAL_M: Final = {"10": 100.0, "11": 100.0}
_SENTINEL2_M: Final = {
    **dict.fromkeys(("1", "9", "10"), 60.0),
    **dict.fromkeys(("2", "3", "4", "8"), 10.0),
    **dict.fromkeys(("5", "6", "7", "8A", "11", "12"), 20.0),
}
TIRS_M: Final = 100.0
"""Native pixel of the thermal bands of Landsat 8 and 9, which are delivered at 30 m."""


_NOMINAL: Final = 0.002
"""Products state pixel sizes on their map grids: those of UTM are the length on the ground within 0.1 %."""


def native_per_px(px_m: tuple[float, float], native_m: float | tuple[float, float]) -> NDArray[np.float64]:
    """Return how many native pixels a pixel is long along (col, row).

    Parameters
    ----------
    px_m : (float, float)
        Size of the pixel on the ground, metres.
    native_m : float or (float, float)
        Size of the native one, nominally.

    Returns
    -------
    (2,) array
        1 where the two differ by no more than nominal sizes do.
    """
    ratio = np.array(px_m) / native_m
    return np.where(np.abs(ratio - 1.0) <= _NOMINAL, 1.0, ratio)


def native_px_m(stem: str, description: str | None) -> float | None:
    """Return the pixel size that the sensor recorded, in metres; None where the names do not tell.

    Parameters
    ----------
    stem : str
        File name without its ending: Landsat Collection 2 and Sentinel-2 band files are known.
    description : str, optional
        Of the band: surface temperature bands of Landsat are known (`ST_B10`; `ST_B6` of Landsat 4 to 7
        is 60 or 120 m, which it does not tell).
    """
    if match := _LANDSAT.match(stem):
        return _landsat(match[1].upper(), int(match[2]), match[3])
    if match := _SENTINEL2.match(stem):
        return _SENTINEL2_M.get(match[1].upper().lstrip("0"))
    if description and (match := _SURFACE_TEMPERATURE.match(description.strip())):
        return _THERMAL_M.get(match[1])
    return None


def _landsat(sensor: str, mission: int, band: str) -> float | None:
    if mission >= 8:
        return _THERMAL_M.get(band) or (15.0 if band == "8" else 30.0)
    if band == "6":
        return {"E": 60.0, "T": 120.0}.get(sensor)
    if sensor not in "ET":
        return None
    return 15.0 if band == "8" else 30.0
