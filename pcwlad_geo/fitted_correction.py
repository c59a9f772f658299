"""A correction fitted to tie points, and what can be made of it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rasterio.control import GroundControlPoint
from rasterio.io import DatasetReader

from pcwlad_geo.arguments import checked
from pcwlad_geo.band_warping import WarpOptions, WarpOutput, apply, requested_output
from pcwlad_geo.correction.error_statistics import Accuracy
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.options import Resampling
from pcwlad_geo.raster import RpcGrid, trusting
from pcwlad_geo.raster.arrays import (
    DataArrayLike,
    Raster,
    RasterLike,
    Scratch,
    is_dataset,
    like_the_source,
    read_raster,
    to_raster,
)
from pcwlad_geo.registration import (
    Quality,
    Registration,
)
from pcwlad_geo.report.finished import finished
from pcwlad_geo.text import Shown
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64, PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack


GRID_OPTIONS: Final = ("grid", "like", "tr", "te", "t_srs")
"""Options that ask for another output grid than the reference's."""


class _WarpKeywords(WarpOptions, total=False):
    """What `FittedCorrection.warp` takes by keyword."""

    resampling: Resampling | None
    overwrite: bool
    on_event: EventCallback


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FittedCorrection(Shown):
    """A correction fitted to tie points, with its precision, and what can be made of it.

    It maps the target pixel that the original georeferencing predicts for a place on the ground (without
    georeferencing: the reference's pixel) to the one where the target shows that place. Pixel coordinates are
    (col, row) of the original target, corner-based: the centre of the first pixel is (0.5, 0.5).
    """

    registration: Registration
    """All that is known of the pair, as `register` returns it."""
    scratch: object = None
    """What keeps the files of arrays for as long as they are needed."""

    @property
    def name(self) -> str:
        """The model chosen, as `model.name` of report.json has it."""
        return self.model.name

    @property
    def model(self) -> Correction:
        """The model with its parameters."""
        if self.registration.correction is None:
            raise InputError(f"a pair that is {self.registration.status} has no correction: fit one first")
        return self.registration.correction

    @property
    def accuracy(self) -> Mapping[str, Accuracy]:
        """Statistics of the residuals: keys fit_px, check_px (target px), fit_m, check_m (metres)."""
        return self.registration.accuracy

    @property
    def quality(self) -> Quality | None:
        """Grade, reasons and the error expected over the common ground."""
        return self.registration.quality

    @property
    def tie_points(self) -> TiePointTable:
        """The tie points with residuals; status fit, check, unused or rejected."""
        return self.registration.tie_points

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was warned of, from opening the pair on."""
        return self.registration.warnings

    def forward(self, xy_px: ArrayLike) -> Float64:
        """Map (n, 2) predicted target px (col, row) to (n, 2) observed ones; NaN where the model has none."""
        return self.model.forward(_points(xy_px))

    def inverse(self, xy_px: ArrayLike) -> Float64:
        """Map (n, 2) observed target px (col, row) to (n, 2) predicted ones; NaN where the model has none."""
        return self.model.inverse(_points(xy_px))

    def sigma(self, xy_px: ArrayLike) -> Float64:
        """Return the (n, 2) standard deviation (col, row) at (n, 2) predicted target px (col, row), px."""
        if self.registration.selection is None:
            raise InputError(
                f"a pair that is {self.registration.status} has no sigma: fit a correction first"
            )
        return self.registration.selection.sigma(_points(xy_px))

    def to_gcps(self) -> list[GroundControlPoint]:
        """Return the tie points, all but the rejected ones, as ground control points of the target.

        `col` and `row` are px of the original target, corner-based; `x` and `y` map coordinates in the
        reference's CRS (`tie_points.crs`), without one px of the reference, y = -row.
        """
        table = self.tie_points
        points = table[table.status != "rejected"].placed
        return [
            GroundControlPoint(row=row, col=col, x=x, y=y, id=str(number))
            for number, ((col, row), (x, y)) in enumerate(
                zip(points.target_px.tolist(), points.xy.tolist(), strict=True), start=1
            )
        ]

    def to_skimage(self) -> Any:  # noqa: ANN401  # of scikit-image, which has no types
        """Return the correction as a transform of scikit-image, see `Correction.to_skimage`."""
        return self.model.to_skimage()

    @overload
    def warp(self, src: RasterLike, dst: PathLike, **keywords: Unpack[_WarpKeywords]) -> Path: ...

    @overload
    def warp(
        self, src: NDArray[Any], dst: None = None, **keywords: Unpack[_WarpKeywords]
    ) -> np.ma.MaskedArray[Any, Any]: ...

    @overload
    def warp(
        self, src: Raster | DatasetReader, dst: None = None, **keywords: Unpack[_WarpKeywords]
    ) -> Raster: ...

    @overload
    def warp(self, src: DataArrayLike, dst: None = None, **keywords: Unpack[_WarpKeywords]) -> Any: ...  # noqa: ANN401  # xarray.DataArray

    @checked("src", "resampling")
    def warp(
        self,
        src: RasterLike,
        dst: PathLike | None = None,
        *,
        resampling: Resampling | None = None,
        overwrite: bool = False,
        on_event: EventCallback = ignore,
        **output: Unpack[WarpOptions],
    ) -> Any:
        """Warp a raster of the target's geometry by the correction, once, from its original pixels.

        Parameters
        ----------
        src : path, rasterio dataset, array, Raster or xarray.DataArray
            The target, or another band of it. An array of (rows, cols) or (bands, rows, cols), and a `Raster`
            or DataArray without georeferencing, has the target's pixels.
        dst : path, optional
            The file to write; by default the result is returned as `src` is given, which is no path then.
        resampling : str, optional
            As for `register`; what the pair was opened with by default.
        overwrite : bool
            Replace `dst` where it exists.
        on_event : callable
            Receives `Progress` and `Warned` events.
        **output
            `grid`, `like`, `tr`, `te`, `t_srs`, `of`, `co` as `pcwlad_geo.warp` takes them. By default a
            file gets what the pair was opened with, and what is returned has exactly the reference's grid.

        Returns
        -------
        pathlib.Path, numpy.ma.MaskedArray, Raster or xarray.DataArray
            Masked where the target shows nothing; a `Raster` has such an array. In a DataArray that is
            `_FillValue` where `src` has one and NaN otherwise, so that whole numbers become float.

        Raises
        ------
        InputError
            If the raster or an option cannot be used.
        OutputError
            If `dst` cannot be written; nothing is left half-written.
        """
        if dst is None and isinstance(src, str | os.PathLike):
            raise InputError(
                f"warp({os.fspath(src)!r}) has no place to write to: give the file, warp(src, dst)"
            )
        scratch = Scratch()
        place = scratch.folder / "warped.tif" if dst is None else Path(dst)
        requested: WarpOptions = {**output}
        if dst is None:
            requested |= {"of": "GTiff", "co": ()}
            if all(requested.get(name) is None for name in GRID_OPTIONS):
                requested["grid"] = "reference-exact"
        with trusting(self.registration.settings.trust):
            registration = finished(self.registration)
            request, fmt = requested_output(registration, requested)
            warp_output = WarpOutput(
                registration.reference_grid, request, fmt, resampling or registration.resampling
            )
            uri = scratch.file_of(self._placed(src), "array")
            apply(registration, [uri], [place], warp_output, False, overwrite, on_event)
        return place if dst is not None else like_the_source(read_raster(place), src)

    def _placed(self, src: RasterLike) -> RasterLike:
        """Return what has no place of its own as a raster on the target's pixels; the rest as it is."""
        if isinstance(src, str | os.PathLike) or is_dataset(src):
            return src
        raster, grid = to_raster(src), self.registration.target.grid
        if raster.transform is not None or raster.crs is not None:
            return raster
        if raster.shape != grid.shape:
            (rows, cols), (wanted_rows, wanted_cols) = raster.shape, grid.shape
            raise InputError(
                f"the array has {cols} x {rows} px, the target {wanted_cols} x {wanted_rows}: give one of "
                "that size, or pcwlad_geo.Raster(array, transform, crs)"
            )
        if isinstance(grid, RpcGrid) or not grid.located:
            return raster
        return replace(raster, transform=grid.transform, crs=grid.crs)

    def _facts(self) -> dict[str, str]:
        facts = {"model": self.name, "tie points": self.tie_points.summary()}
        checked = self.accuracy["check_px"]
        figure, what = (checked, "check") if checked.n else (self.accuracy["fit_px"], "fit")
        facts["accuracy"] = f"RMSE {figure.rmse:.2f} px at {figure.n} {what} points"
        if self.quality is not None:
            facts["quality"] = f"quality {self.quality.grade}"
        return facts


def _points(xy_px: ArrayLike) -> Float64:
    """Return positions as an (n, 2) array."""
    points = np.asarray(xy_px, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"positions of shape {points.shape}: give an (n, 2) array of (col, row)")
    return points
