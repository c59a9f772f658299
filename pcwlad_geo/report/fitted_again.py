"""The precision of a finished registration, by the same fit to the tie points of its folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid, is_folder, middle_pixel_size_m
from pcwlad_geo.report.finished import FinishedRegistration, read_report
from pcwlad_geo.tiepoints.readers import read_point_file

POINTS: Final = "tiepoints.csv"
"""The file of tie points in the folder of a registration."""
SAME_PX: Final = 0.05
"""Largest difference between a correction and its fit again, target px: that of the rounding of the file, and
of a window whose size is known to a pixel of the matching grid."""


def read_precision(folder: str | os.PathLike[str], finished: FinishedRegistration) -> Selection:
    """Return the fit of a finished registration with its covariance.

    Raises `InputError` if the folder lacks its tie points, or these give another correction.
    """
    place = Path(folder) if is_folder(folder) else Path(folder).parent
    report, correction = read_report(place), finished.correction
    if not (place / POINTS).is_file() or correction.name not in MODELS:
        what = f"no {POINTS}" if correction.name in MODELS else f"a {correction.name} correction"
        raise InputError(
            f"{place} has {what}, from which the sigma of the correction would follow: register the pair "
            "again without --output-tiepoints, or leave out --write-sigma"
        )
    points = read_point_file(place / POINTS)
    if points.sigma_px is None or points.displacement_px is None or points.status is None:
        raise InputError(f"{place / POINTS} lacks the columns of sigma, displacement or status: restore it")
    is_fit = points.status == "fit"
    target_px, sigma_px = points.target[is_fit], points.sigma_px[is_fit]
    predicted_px = target_px - points.displacement_px[is_fit]
    covariance_px2 = sigma_px[:, :, None] * sigma_px[:, None, :]
    correlation = np.zeros(len(sigma_px)) if points.correlation is None else points.correlation[is_fit]
    covariance_px2[:, [0, 1], [1, 0]] *= correlation[:, None]
    window_px = _footprint_px(report, finished.reference_grid, finished.target_grid)
    selection = choose(predicted_px, target_px, covariance_px2, window_px, (correction.name,))
    _check_same(selection.fit.correction, correction, predicted_px, place)
    return selection


def _footprint_px(report: dict[str, Any], reference: Grid, target: Grid) -> float:
    """Return the side of the matching window, target px: it was matched on the coarser pixels of the two."""
    sizes = [middle_pixel_size_m(grid) for grid in (reference, target)]
    ratio = 1.0
    if sizes[0] is not None and sizes[1] is not None:
        ratio = max(1.0, float(np.mean(sizes[0]) / np.mean(sizes[1])))
    return float(report.get("window_px") or 0) * ratio


def _check_same(again: Correction, correction: Correction, at_px: np.ndarray[Any, Any], place: Path) -> None:
    off_px = np.abs(again.forward(at_px) - correction.forward(at_px)).max(initial=0.0)
    if not off_px <= SAME_PX:
        raise InputError(
            f"the tie points of {place} give a correction that lies up to {off_px:.2f} px off that of its "
            "report.json, so that its sigma is not known: register the pair again"
        )
