"""The precision of a finished registration, by the same fit to the tie points of its folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.error_statistics import FitAccuracy
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid, is_folder, middle_pixel_size_m
from pcwlad_geo.registration import Quality, Reason
from pcwlad_geo.report.finished import FinishedRegistration, ReadReport
from pcwlad_geo.report.read_figures import read_figures
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64

POINTS: Final = "tiepoints.csv"
"""The file of tie points in the folder of a registration."""
SAME_PX: Final = 0.05
"""Largest difference between a correction and its fit again, target px: that of the rounding of the file, and
of a window whose size is known to a pixel of the matching grid."""


@dataclass(frozen=True)
class FittedAgain:
    """A finished registration with its tie points, and its precision when that is asked for."""

    place: Path
    """The folder."""
    finished: FinishedRegistration
    points: TiePointTable
    """With all statuses."""

    @classmethod
    def read(cls, folder: str | os.PathLike[str], finished: FinishedRegistration) -> FittedAgain:
        """Read the tie points of a folder, or of that of a report.json.

        Raises `InputError` if there are none from which the precision follows.
        """
        place, correction = Path(folder) if is_folder(folder) else Path(folder).parent, finished.correction
        if not (place / POINTS).is_file() or correction.name not in MODELS:
            what = f"no {POINTS}" if correction.name in MODELS else f"a {correction.name} correction"
            raise InputError(
                f"{place} has {what}, from which the sigma of the correction would follow: register the pair "
                "again without --output-tiepoints, or leave out --write-sigma"
            )
        points = read_point_file(place / POINTS)
        if points.sigma_px is None or points.displacement_px is None or points.status is None:
            raise InputError(
                f"{place / POINTS} lacks the columns of sigma, displacement or status: restore it"
            )
        count, predicted_px = len(points.target), points.target - points.displacement_px
        covariance_px2 = points.sigma_px[:, :, None] * points.sigma_px[:, None, :]
        if points.correlation is not None:
            covariance_px2[:, [0, 1], [1, 0]] *= points.correlation[:, None]
        unknown = np.full((count, 2), np.nan)
        table = TiePointTable(
            reference_px=points.reference,
            target_px=points.target,
            predicted_px=predicted_px,
            xy=unknown if points.xy is None else points.xy,
            displacement_m=unknown if points.displacement_m is None else points.displacement_m,
            covariance_px2=covariance_px2,
            score=np.ones(count) if points.score is None else points.score,
            residual_px=points.target - correction.forward(predicted_px),
            status=points.status,
            crs=finished.reference_grid.crs,
        )
        return cls(place, finished, table)

    @cached_property
    def selection(self) -> Selection:
        """The fit with its covariance; raises `InputError` if the points give another correction."""
        finished, points = self.finished, self.points.select("fit")
        figures = read_figures(self.place)
        side_px = (figures and figures.window_px) or 0
        window_px = _footprint_px(side_px, finished.reference_grid, finished.target_grid)
        selection = choose(
            points.predicted_px,
            points.target_px,
            points.covariance_px2,
            window_px,
            (finished.correction.name,),
        )
        _check_same(selection.fit.correction, finished.correction, points.predicted_px, self.place)
        return selection

    def sigma(self, at_px: Float64) -> Float64:
        """Return the (n, 2) standard deviation (col, row), px, at the (n, 2) predicted `at_px`."""
        return self.selection.sigma(at_px)


def evidence_of(report: ReadReport) -> tuple[FitAccuracy, Quality] | None:
    """Return accuracy and quality of a finished registration as its report.json tells them, rounded.

    It tells the grade of the worst reason alone, and of what an extent leaves out only the whole. None if it
    does not tell the quality.
    """
    quality = report.quality
    if quality is None:
        return None
    units = (
        (f"{group}_{unit}", accuracy)
        for group, by in report.accuracy.items()
        for unit, accuracy in by.items()
    )
    whole = quality.whole_ce90_px
    return FitAccuracy({name: accuracy for name, accuracy in units if accuracy is not None}), Quality(
        grade=quality.grade,
        reasons=tuple(Reason(quality.grade, text) for text in quality.reasons),
        expected_ce90_px=quality.expected_ce90_px,
        extrapolated_share=quality.extrapolated_share,
        kept_share=quality.kept_share,
        whole=None if whole is None else (whole, quality.extrapolated_share),
    )


def _footprint_px(side_px: int, reference: Grid, target: Grid) -> float:
    """Return the side of the matching window, target px: it was matched on the coarser pixels of the two."""
    sizes = [middle_pixel_size_m(grid) for grid in (reference, target)]
    ratio = 1.0
    if sizes[0] is not None and sizes[1] is not None:
        ratio = max(1.0, float(np.mean(sizes[0]) / np.mean(sizes[1])))
    return side_px * ratio


def _check_same(again: Correction, correction: Correction, at_px: np.ndarray[Any, Any], place: Path) -> None:
    off_px = np.abs(again.forward(at_px) - correction.forward(at_px)).max(initial=0.0)
    if not off_px <= SAME_PX:
        raise InputError(
            f"the tie points of {place} give a correction that lies up to {off_px:.2f} px off that of its "
            "report.json, so that its sigma is not known: register the pair again"
        )
