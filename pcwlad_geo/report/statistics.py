"""Error statistics of a registration, before and after its correction, in three units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.error_statistics import ErrorStatistics, in_units
from pcwlad_geo.raster.geodesy import pixel_sizes_m
from pcwlad_geo.raster.native_pixels import native_per_px, native_px_m
from pcwlad_geo.raster.rpc_grid import levelled
from pcwlad_geo.raster.source import RasterInfo, file_name
from pcwlad_geo.registration.result import Registration

KEPT: Final = ("fit", "check", "unused", "matched")
"""Statuses of the tie points that the displacement statistics count."""
GROUPS: Final[Mapping[str, tuple[str, ...]]] = {"all": KEPT, "fit": ("fit",), "check": ("check",)}
"""Statuses of the tie points of a group, by its name."""
DIGITS: Final = 5
When = Literal["before", "after"]
WHEN: Final[tuple[When, ...]] = ("before", "after")

Array = NDArray[np.float64]


def error_statistics(registration: Registration) -> dict[str, object]:
    """Return the statistics of displacements (before) and residuals (after) of all, fit and check points.

    Returns
    -------
    dict
        `before` and `after`, each with the groups `all`, `fit`, `check`: None, or `n` and, by unit (`px` of
        the target, `native_px`, `m`), `col`, `row`, `radial` and `net` (without the matching noise) as
        `ErrorStatistics` has them. Metres are target px times the size of the pixel on the ground at each
        point, along its columns and rows; a unit that is not known is None. `native_px_m` is the coarser
        native pixel of the two, None where none is known.
    """
    found: dict[str, object] = {
        when: {group: _plain(statistics_of(registration, when, group)) for group in GROUPS} for when in WHEN
    }
    return {"native_px_m": native_size_m(registration.reference, registration.target), **found}


def statistics_of(registration: Registration, when: When, group: str) -> dict[str, ErrorStatistics | None]:
    """Return the statistics of one of the `GROUPS` before or after the correction, by unit."""
    points = registration.tie_points.select(*GROUPS[group])
    native = native_size_m(registration.reference, registration.target)
    sizes_m = pixel_sizes_m(levelled(registration.target.grid), points.predicted_px)
    errors_px = points.displacement_px if when == "before" else points.residual_px
    return in_units(errors_px, points.sigma_px, _factors(registration.px_m, sizes_m, native))


def native_size_m(*rasters: RasterInfo) -> float | None:
    """Return the coarsest pixel that the sensors recorded, as far as file names tell, metres."""
    sizes = [native_px_m(Path(file_name(info.uri)).stem, None) for info in rasters]
    return max((size for size in sizes if size is not None), default=None)


def _factors(
    px_m: tuple[float, float] | None, sizes_m: Array | None, native_m: float | None
) -> dict[str, Array | None]:
    native = None if px_m is None or native_m is None else native_per_px(px_m, native_m)
    return {"px": np.ones(2), "native_px": native, "m": sizes_m}


def _plain(by_unit: Mapping[str, ErrorStatistics | None]) -> dict[str, object] | None:
    in_px = by_unit["px"]
    if in_px is None:
        return None
    return {"n": in_px.n} | {
        unit: None if found is None else rounded({k: v for k, v in asdict(found).items() if k != "n"})
        for unit, found in by_unit.items()
    }


def rounded(value: object) -> object:
    """Return numbers, also those within, without the digits that say nothing."""
    if isinstance(value, float):
        return round(value, DIGITS)
    if isinstance(value, Mapping):
        return {name: rounded(item) for name, item in value.items()}
    return [rounded(item) for item in value] if isinstance(value, list | tuple) else value
