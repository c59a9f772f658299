"""Tie points to correction: hold check points out, choose a model, fit, figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.accuracy import Accuracy
from pcwlad_geo.correction.check_points import hold_out
from pcwlad_geo.correction.fit import CANDIDATES
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.raster.tie_point_table import TiePointTable
from pcwlad_geo.registration.settings import Settings

Float64 = NDArray[np.float64]

ORDERS: Mapping[str, tuple[str, ...]] = MappingProxyType({"polynomial": ("polynomial2", "polynomial3")})
"""Candidates of the option that leaves the order open."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A table with residuals and statuses, the model behind them, and its accuracy."""

    table: TiePointTable
    selection: Selection
    accuracy: dict[str, Accuracy]
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
) -> Fitted:
    """Fit a correction to the matched points of a table.

    Parameters
    ----------
    table : TiePointTable
        Status ``matched`` or ``rejected``.
    settings : Settings
    footprint_px : float
        Side of the matching window in target px.
    sizes_m : (n, 2) array, optional
        Size of a target pixel (col, row) on the ground at each point, metres.
    shape : (int, int), optional
        Rows and columns of the target: no model may fold it. By default the box of the fit points counts.
    candidates : tuple of str
        Models to choose from where the settings leave it open, the simplest first.
    """
    status = table.status.astype("<U8")
    matched = np.flatnonzero(status == "matched")
    status[matched] = hold_out(table.predicted_px[matched], footprint_px)
    fit_points = table[status == "fit"]
    named = ORDERS.get(settings.model, (settings.model,))
    models = candidates if settings.model in ("auto", "rpc") else named
    selection = choose(
        fit_points.predicted_px,
        fit_points.target_px,
        fit_points.covariance_px2,
        footprint_px,
        models,
        box_px=None if shape is None else (np.zeros(2), np.array(shape[::-1], dtype=np.float64)),
    )
    residual = table.target_px - selection.fit.correction.forward(table.predicted_px)
    done = replace(table, status=status, residual_px=residual)
    return Fitted(done, selection, _accuracy(done, sizes_m))


def _accuracy(table: TiePointTable, sizes_m: Float64 | None) -> dict[str, Accuracy]:
    residual_m = table.residual_px * (np.nan if sizes_m is None else sizes_m)
    result = {}
    for status in ("fit", "check"):
        chosen = table.status == status
        result[f"{status}_px"] = Accuracy.of(table.residual_px[chosen])
        result[f"{status}_m"] = Accuracy.of(residual_m[chosen])
    return result
