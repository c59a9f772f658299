"""Tie points of a finished registration in the hands of a user: fits of those left on, points added."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.fit import FITS
from pcwlad_geo.errors import InputError
from pcwlad_geo.matching.matcher import margin_px, match_arrays
from pcwlad_geo.matching.types import MatchSettings
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.trust import trusting
from pcwlad_geo.raster.view import file_px_per_px
from pcwlad_geo.registration.fitting import footprint_px, user_points
from pcwlad_geo.registration.result import Pair
from pcwlad_geo.tiepoints.table import TiePointTable, place
from pcwlad_geo.tiepoints.writers import write_points
from pcwlad_geo.types import Float64, PathLike

FAR_PX: Final = 1e7
"""Largest coordinate of a point in a file, px, either way."""
AROUND_PX: Final = 48
"""Distance from a place that a user shows up to which a corner is taken for it, matching-grid px."""
RADIUS_PX: Final = 16
"""Search radius around it, matching-grid px."""
CANDIDATES: Final = 60
"""Number of corners tried around it, so that they can be checked against one another."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A model fitted to the points that are on."""

    model: str
    residual_px: Float64
    """(n, 2) observed minus model (col, row) of all points, on or off, target px."""
    rmse_px: float
    """Radial, of the points that are on."""
    points: int
    """Number of points that are on."""


class Editor:
    """The tie points of a pair, as a user changes them."""

    def __init__(self, pair: Pair, path: Path) -> None:
        self._pair = pair
        self.files: tuple[PathLike, ...] = (path, *(file.identity.path for file in pair.inputs))
        """What has been read: the tie points, and the files of both rasters."""
        with trusting(pair.settings.trust):
            self.table, _, _ = user_points(path, pair.views)
        self.off = np.flatnonzero(self.table.status == "rejected").tolist()
        """Rows that are off at first: those that the file disables or their neighbours contradict."""

    def try_model(self, model: str, off: Collection[int]) -> Trial:
        """Fit a model as `compare` does and keep its residuals, for `save`."""
        trial = self.compare(model, off)
        self.table = replace(self.table, residual_px=trial.residual_px)
        return trial

    def compare(self, model: str, off: Collection[int]) -> Trial:
        """Fit a model to all points but those `off`, numbered from 0 by their rows.

        Raises `InputError` if the model is unknown or the points do not determine it.
        """
        if model not in FITS:
            raise InputError(f"there is no model {model}: give one of {', '.join(FITS)}")
        on = np.ones(len(self.table), dtype=bool)
        on[[index for index in off if 0 <= index < len(on)]] = False
        table = self.table
        footprint = footprint_px(replace(table, status=np.where(on, "matched", "rejected")), self._window_px)
        given = (table.predicted_px[on], table.target_px[on], table.covariance_px2[on])
        correction = FITS[model](*given, footprint_px=footprint).correction
        residual = table.target_px - correction.forward(table.predicted_px)
        return Trial(model, residual, float(np.sqrt((residual[on] ** 2).sum(axis=1).mean())), int(on.sum()))

    def add(self, reference_xy: tuple[float, float], target_xy: tuple[float, float]) -> bool:
        """Add a point near two places, each on its own map; return whether matching has refined it.

        The place in the reference becomes that of the nearest corner that can be matched. Where there is
        none, the point is as it was shown, with a sigma of a pixel.
        """
        views, far = self._pair.views, f"a point at {reference_xy}, {target_xy} lies nowhere near the images"
        if not np.isfinite([*reference_xy, *target_xy]).all():
            raise InputError(far)
        given = tuple(
            info.grid.to_px(np.array([xy], dtype=np.float64))
            for info, xy in ((views.reference.info, reference_xy), (views.target.info, target_xy))
        )
        if not np.abs(np.concatenate(given)).max() <= FAR_PX:
            raise InputError(far)
        with trusting(self._pair.settings.trust):
            found = self._refined(given[0], given[1])
        reference_px, target_px, covariance_px2, score = found or (
            given[0],
            given[1],
            np.eye(2)[None],
            np.ones(1),
        )
        self.table = _joined(self.table, place(reference_px, target_px, covariance_px2, score, views))
        return found is not None

    def save(self, path: Path, off: Collection[int]) -> None:
        """Write the points for the QGIS Georeferencer, those `off` not enabled."""
        status = np.full(len(self.table), "matched", dtype="<U8")
        status[list(off)] = "rejected"
        target = self._pair.target
        write_points(replace(self.table, status=status), path, target.georeferenced, target.grid)

    @property
    def _window_px(self) -> float:
        return self._side * float(file_px_per_px(self._pair.views.target)[0])

    @property
    def _side(self) -> int:
        """Side of the matching window, matching-grid px."""
        window = self._pair.settings.window
        return window if isinstance(window, int) else MatchSettings().window

    def _refined(
        self, reference_px: Float64, target_px: Float64
    ) -> tuple[Float64, Float64, Float64, Float64] | None:
        """Return positions in both files, covariance and score of the best corner near two file positions."""
        views, settings = self._pair.views, self._pair.settings
        matching = MatchSettings(
            method=settings.method,
            features=CANDIDATES,
            template=settings.template,
            window=self._side,
            search_radius=RADIUS_PX,
        )
        reach = margin_px(matching) + AROUND_PX
        middles = (views.reference.from_file_px(reference_px)[0], views.target.from_file_px(target_px)[0])
        if not np.isfinite(middles).all():
            return None
        corners = [np.floor(middle).astype(int) - reach for middle in middles]
        patches = [
            view.read(Window(int(row), int(col), 2 * reach, 2 * reach))
            for view, (col, row) in zip((views.reference, views.target), corners, strict=True)
        ]
        try:
            points = match_arrays(
                patches[0].values,
                patches[1].values,
                reference_valid=patches[0].valid,
                target_valid=patches[1].valid,
                settings=matching,
            )
        except InputError:  # nothing to see there
            return None
        far = np.abs(points.reference_xy_px + corners[0] - middles[0]).max(axis=1)
        if len(far) == 0 or far.min() > AROUND_PX:
            return None
        nearest = int(far.argmin())
        best = points[nearest : nearest + 1]
        found_px = (
            views.reference.to_file_px(best.reference_xy_px + corners[0]),
            views.target.to_file_px(best.target_xy_px + corners[1]),
        )
        scale = float(file_px_per_px(views.target)[0])
        return *found_px, best.covariance_px2 * scale**2, best.score


def _joined(table: TiePointTable, more: TiePointTable) -> TiePointTable:
    fields: dict[str, Any] = {
        name: np.concatenate([getattr(table, name), getattr(more, name)])
        for name in TiePointTable.__dataclass_fields__
        if name != "crs"
    }
    return TiePointTable(**fields, crs=table.crs)
