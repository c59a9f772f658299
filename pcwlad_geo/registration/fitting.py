"""Tie points to a correction with its figures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.error_statistics import Accuracy, FitAccuracy
from pcwlad_geo.correction.fit import CANDIDATES, of_option
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.points import hold_out
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.options import Settings
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64


def footprint_px(table: TiePointTable, window_px: float, dense_points: int = 100) -> float:
    """Return the side of the window that neighbouring points share, target px; 0 for a few set by hand.

    From `dense_points` on they are taken to come from overlapping matching windows.
    """
    return window_px if np.count_nonzero(table.status == "matched") >= dense_points else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A table with residuals and statuses, the model behind them, and its accuracy."""

    table: TiePointTable
    selection: Selection
    accuracy: FitAccuracy
    """fit_px, check_px, fit_m, check_m."""

    @property
    def correction(self) -> Correction:
        """The model chosen."""
        return self.selection.fit.correction


def fit_correction(
    table: TiePointTable,
    settings: Settings,
    footprint_px: float,
    sizes_m: Float64 | None,
    shape: tuple[int, int] | None = None,
    candidates: tuple[str, ...] = CANDIDATES,
    smooth: Bool | None = None,
    perspective: bool = False,
    roles: NDArray[np.str_] | None = None,
) -> Fitted:
    """Fit a correction to the matched points of a table.

    Parameters
    ----------
    table : TiePointTable
        Status ``matched`` or ``rejected``.
    footprint_px : float
        Side of the matching window in target px.
    sizes_m : (n, 2) array, optional
        Size of a target pixel (col, row) on the ground at each point, metres.
    shape : (int, int), optional
        Rows and columns of the target: no model may fold it. By default the box of the fit points counts.
    candidates : tuple of str
        Models to choose from where the settings leave it open, the simplest first.
    smooth : (n,) bool array, optional
        The rows that are fitted and checked; other matched ones are ``unused``. By default all are.
    perspective : bool
        Whether one of the rasters may be a photograph, see `selection.choose`.
    roles : (n,) array of str, optional
        What earlier fits used the rows for: check points stay so, also ``rejected`` ones.
    """
    status = table.status.astype("<U8")
    if smooth is not None:
        status[(status == "matched") & ~smooth] = "unused"
    matched = np.flatnonzero(status == "matched")
    if roles is None:
        status[matched] = hold_out(table.predicted_px[matched], footprint_px)
    else:
        status[matched] = roles[matched]
        status[roles == "check"] = "check"
    fit_points = table[status == "fit"]
    models = candidates if settings.model in ("auto", "rpc") else of_option(settings.model)
    selection = choose(
        fit_points.predicted_px,
        fit_points.target_px,
        fit_points.covariance_px2,
        footprint_px,
        models,
        box_px=None if shape is None else (np.zeros(2), np.array(shape[::-1], dtype=np.float64)),
        perspective=perspective,
    )
    residual = table.target_px - selection.fit.correction.forward(table.predicted_px)
    fitted = replace(table, status=status, residual_px=residual)
    return Fitted(fitted, selection, _accuracy(fitted, sizes_m))


def _accuracy(table: TiePointTable, sizes_m: Float64 | None) -> FitAccuracy:
    residual_m = table.residual_px * (np.nan if sizes_m is None else sizes_m)
    result = FitAccuracy()
    for status in ("fit", "check"):
        members = table.status == status
        result[f"{status}_px"] = Accuracy.of(table.residual_px[members])
        result[f"{status}_m"] = Accuracy.of(residual_m[members])
    return result
