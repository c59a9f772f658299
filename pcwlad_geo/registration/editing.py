"""Tie points of a finished registration in the hands of a user: fits of those left on, points added."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.errors import InputError
from pcwlad_geo.execution.runner import one_library_thread
from pcwlad_geo.matching import MatchSettings, match_arrays
from pcwlad_geo.matching.first_pass import margin_px
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.raster import Window, file_px_per_px
from pcwlad_geo.registration.fitting import footprint_px
from pcwlad_geo.registration.point_file import user_points
from pcwlad_geo.registration.result import Pair
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.qgis_points import write_points
from pcwlad_geo.tiepoints.table import joined, place
from pcwlad_geo.types import Float64, PathLike


@dataclass(frozen=True, slots=True)
class EditingParameters:
    """Numbers of points that a user adds."""

    far_px: float = 1e7
    """Largest coordinate of a point in a file, px, either way."""
    around_px: int = 48
    """Distance from a place that a user shows up to which others are matched too, matching-grid px."""
    radius_px: float = 16.0
    """Distance from the two places shown within which a point is refined, matching-grid px."""
    fewest: int = 5
    """Of no more points than these the others contradict none."""
    wrong_px: float = 2.0
    """A point that the others predict so well is not wrong, target px."""
    wrong_factor: float = 4.0
    """How much farther off than the others in the median a wrong point lies."""
    spacing_px: float = 3.0
    """Two tie points do not lie nearer to each other in the reference, matching-grid px."""


@dataclass(frozen=True, slots=True, eq=False)
class EditedFit:
    """A model fitted to the points that are on."""

    model: str
    residual_px: Float64
    """(n, 2) observed minus model (col, row) of all points, on or off, target px."""
    rmse_px: float
    """Radial, at the check points; at the points that are on where there are none."""
    points: int
    """Number of points that are on."""
    checked: int
    """Number of check points, which no fit uses."""


class Editor:
    """The tie points of a pair, as a user changes them."""

    def __init__(self, pair: Pair, path: Path, parameters: EditingParameters = EditingParameters()) -> None:
        self._pair, self.parameters = pair, parameters
        self.files: tuple[PathLike, ...] = (path, *(file.identity.path for file in pair.inputs))
        """What has been read: the tie points, and the files of both rasters."""
        points = user_points(path, pair.views)
        self.table = points.table
        self._roles = np.full(len(points.table), "fit", "<U8") if points.roles is None else points.roles
        self._side = points.origin.window_px or pair.settings.matching_window.side_px
        self.off = np.flatnonzero(self.table.status == "rejected").tolist()
        """Rows that are off at first: those that the file disables or their neighbours contradict."""

    def try_model(self, model: str, off: Collection[int]) -> EditedFit:
        """Fit a model as `compare` does and keep its residuals, for `save`."""
        trial = self.compare(model, off)
        self.table = replace(self.table, residual_px=trial.residual_px)
        return trial

    @one_library_thread()
    def compare(self, model: str, off: Collection[int]) -> EditedFit:
        """Fit a model to all points but those `off`, numbered from 0 by their rows.

        Check points and points beside them stay out of the fit, as they did before.
        Raises `InputError` if the model is unknown or the points do not determine it.
        """
        if model not in MODELS:
            raise InputError(f"there is no model {model}: give one of {', '.join(MODELS)}")
        on = np.ones(len(self.table), dtype=bool)
        on[[index for index in off if 0 <= index < len(on)]] = False
        table, fitted, check = self.table, on & (self._roles == "fit"), self._roles == "check"
        footprint = footprint_px(replace(table, status=np.where(on, "matched", "rejected")), self._window_px)
        points = (table.predicted_px[fitted], table.target_px[fitted], table.covariance_px2[fitted])
        correction = MODELS[model].fit(*points, footprint_px=footprint).correction
        residual = table.target_px - correction.forward(table.predicted_px)
        judged = residual[check if check.any() else on]
        rmse_px = float(np.sqrt((judged**2).sum(axis=1).mean()))
        return EditedFit(model, residual, rmse_px, int(on.sum()), int(check.sum()))

    def add(
        self,
        reference_xy: tuple[float, float],
        target_xy: tuple[float, float] | None,
        radius_px: float = EditingParameters().radius_px,
        deleted: Collection[int] = (),
        target_px: tuple[float, float] | None = None,
    ) -> bool:
        """Add a point at two places, each on its own map; return whether matching has refined it.

        The pixel shown in the reference is sought in the target, or else the nearest corner that no other
        point is at, within `radius_px` (matching-grid px) of either place. Where there is none, the point is
        as it was shown, with a sigma of a pixel. The map coordinates (x, y) are in the CRS of each raster; a
        target whose place is not known is shown by a pixel (col, row) instead. The rows `deleted` were taken
        away, numbered from 0. Raises `InputError` where a point lies already,
        or neither raster is.
        """
        views, message = (
            self._pair.views,
            f"a point at {reference_xy}, {target_px or target_xy} lies nowhere near the images",
        )
        in_target = target_px or target_xy or ()
        if len(in_target) != 2 or not np.isfinite([*reference_xy, *in_target]).all():
            raise InputError(message)
        places = [np.array([xy], dtype=np.float64) for xy in (reference_xy, in_target)]
        to_px = views.target.info.grid.to_px
        places_px = views.reference.info.grid.to_px(places[0]), places[1] if target_px else to_px(places[1])
        if not np.abs(np.concatenate(places_px)).max() <= self.parameters.far_px:
            raise InputError(message)
        return self._add(places_px[0], places_px[1], radius_px, deleted)

    def improve(self, row: int, radius_px: float, deleted: Collection[int] = ()) -> bool:
        """Append a point of a row as matching refines it, and return whether it could.

        Where there is no match within `radius_px` (matching-grid px), the table stays as it is.
        """
        before, roles = self.table, self._roles
        place_px, target_px = before.reference_px[row : row + 1], before.target_px[row : row + 1]
        with suppress(InputError):  # another one lies there
            if self._add(place_px, target_px, radius_px, {*deleted, row}):
                return True
        self.table, self._roles = before, roles
        return False

    def contradicting(self, off: Collection[int]) -> list[int]:
        """Return the rows of points that the others contradict: those `off` neither judge nor are judged.

        Each point is predicted by an affine fit to the others. The worst is taken out while it lies farther
        off than `wrong_px`, and `wrong_factor` times as far as the others do in the median without it.
        """
        rows = np.setdiff1d(np.arange(len(self.table)), list(off))
        wrong: list[int] = []
        while len(rows) > self.parameters.fewest:
            left_out_px = _left_out_px(self.table.predicted_px[rows], self.table.target_px[rows])
            worst = int(left_out_px.argmax())
            remaining = np.delete(rows, worst)
            others_px = _left_out_px(self.table.predicted_px[remaining], self.table.target_px[remaining])
            likely_px = self.parameters.wrong_factor * float(np.median(others_px))
            if left_out_px[worst] < max(self.parameters.wrong_px, likely_px):
                break
            wrong.append(int(rows[worst]))
            rows = remaining
        return sorted(wrong)

    def _add(
        self, reference_px: Float64, target_px: Float64, radius_px: float, deleted: Collection[int]
    ) -> bool:
        """Add a point at two (1, 2) file positions, refined where it can be, as `add` does."""
        views, places_px = self._pair.views, (reference_px, target_px)
        other_px = np.delete(self.table.reference_px, list(deleted), axis=0)
        taken_px = views.reference.from_file_px(other_px)
        off_px = np.abs(taken_px - views.reference.from_file_px(places_px[0])).max(axis=1)
        if (off_px < self.parameters.spacing_px).any():
            raise InputError("there is a tie point already: move or delete that one")
        refined = self._refined(places_px[0], places_px[1], radius_px, taken_px)
        reference_px, matched_px, covariance_px2, score = refined or (
            places_px[0],
            places_px[1],
            np.eye(2)[None],
            np.ones(1),
        )
        self._roles = np.append(self._roles, "fit")
        self.table = joined(self.table, place(reference_px, matched_px, covariance_px2, score, views))
        return refined is not None

    def save(self, path: Path, off: Collection[int], deleted: Collection[int] = ()) -> None:
        """Write the points but those `deleted`; those `off` are not enabled.

        The file is one of the QGIS Georeferencer, or by its name the CSV, which keeps their sigmas.
        """
        status = np.full(len(self.table), "matched", dtype="<U8")
        status[list(off)] = "rejected"
        remaining = np.delete(np.arange(len(status)), list(deleted))
        table, target = replace(self.table, status=status)[remaining], self._pair.target
        if path.suffix == ".csv":
            write_csv(table, path)
        else:
            target = target.as_in_file()
            write_points(table, path, target.georeferenced, target.grid)

    @property
    def _window_px(self) -> float:
        return self._side * float(file_px_per_px(self._pair.views.target)[0])

    def _refined(
        self, reference_px: Float64, target_px: Float64, radius_px: float, taken_px: Float64
    ) -> tuple[Float64, Float64, Float64, Float64] | None:
        """Return positions in both files, covariance and score of the match of two file positions.

        The (n, 2) `taken_px` (col, row) of the reference view are those of other points.
        """
        views, settings = self._pair.views, self._pair.settings
        matching = MatchSettings(
            method=settings.method,
            features=60,
            template=settings.template,
            window=MatchingWindow(self._side),
            search_radius=max(1, int(np.ceil(radius_px))),
        )
        reach = margin_px(matching) + self.parameters.around_px
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
                also=np.array([[reach, reach]], dtype=np.intp),
            )
        except InputError:  # nothing to see there
            return None
        points = points.shifted(*corners)
        distance_px = np.hypot(*(points.reference_xy_px - middles[0]).T)
        largest_px = np.maximum(distance_px, np.hypot(*(points.target_xy_px - middles[1]).T))
        spacing_px = np.abs(points.reference_xy_px[:, None] - taken_px).max(axis=2, initial=0.0)
        occupied = (spacing_px < self.parameters.spacing_px).any(axis=1)
        distance_px[occupied | (largest_px > radius_px + 1)] = np.inf
        if len(distance_px) == 0 or np.isinf(distance_px.min()):
            return None
        nearest = int(distance_px.argmin())
        best = points[nearest : nearest + 1]
        files_px = (
            views.reference.to_file_px(best.reference_xy_px),
            views.target.to_file_px(best.target_xy_px),
        )
        scale = float(file_px_per_px(views.target)[0])
        return *files_px, best.covariance_px2 * scale**2, best.score


def _left_out_px(expected_px: Float64, observed_px: Float64) -> Float64:
    """Return (n,) how far each of (n, 2) points lies from where an affine fit to the others expects it."""
    basis, _ = np.linalg.qr(
        np.column_stack([expected_px - expected_px.mean(axis=0), np.ones(len(expected_px))])
    )
    offset_px = observed_px - expected_px
    alone = np.maximum(1 - (basis**2).sum(axis=1), np.finfo(np.float64).eps)
    distance_px: Float64 = np.hypot(*(offset_px - basis @ (basis.T @ offset_px)).T) / alone
    return distance_px
