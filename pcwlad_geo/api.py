"""The steps of a registration, to be composed: open_pair, match, fit, and a correction that warps.

`job.register` does the same four steps for two files and writes the folder.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import Executor
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
from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.options import Model, PairOptions, Resampling, Settings
from pcwlad_geo.raster import RpcGrid, check_unchanged, trusting
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
    Matches,
    Pair,
    Quality,
    Registration,
    conclude,
    fit_pair,
    match_pair,
    prepare_pair,
)
from pcwlad_geo.registration.rpc import check_model
from pcwlad_geo.report.finished import finished
from pcwlad_geo.text import Shown
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64, PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack


OF_THE_FOLDER: Final = ("require", "keep", "pdf", "no_report", "write_sigma", "write_displacement")
"""Options about the files of `register` alone."""
GRID_OPTIONS: Final = ("grid", "like", "tr", "te", "t_srs")
"""Options that ask for another output grid than the reference's."""


@checked("reference", "target", "ref_mask", "tgt_mask")
def open_pair(
    reference: RasterLike,
    target: RasterLike,
    *,
    ref_mask: RasterLike | None = None,
    tgt_mask: RasterLike | None = None,
    on_event: EventCallback = ignore,
    **options: Unpack[PairOptions],
) -> Pair:
    """Describe two rasters and decide on which pixels they are compared; nothing is computed yet.

    Parameters
    ----------
    reference, target : path, rasterio dataset, array, Raster or xarray.DataArray
        Raster that stays, raster that moves; products by their path. What is in memory is written to a
        temporary file that lives as long as the pair or what is made of it. A NumPy array has no
        georeferencing: `Raster` gives it one.
    ref_mask, tgt_mask : as reference, optional
        0 = excluded, or a quality raster (QA_PIXEL, BQA, SCL, MSK_CLASSI).
    on_event : callable
        Receives `Warned` events; the warnings are in the result too.
    **options
        The other fields of `Settings`, but those about the files of `register`.

    Returns
    -------
    Pair
        Files, grids, what the matching starts from, warnings.

    Raises
    ------
    InputError
        If a raster or an option cannot be used, or the two do not overlap.
    """
    scratch = Scratch()
    masks = {"ref_mask": ref_mask, "tgt_mask": tgt_mask}
    files = {name: scratch.file_of(mask, name) for name, mask in masks.items() if mask is not None}
    settings, default = Settings.from_options(options | files), Settings()
    for name in OF_THE_FOLDER:
        if getattr(settings, name) != getattr(default, name):
            raise SettingsError(f"{name} is about the files that register writes: give it there")
    with trusting(settings.trust):
        uris = scratch.file_of(reference, "reference"), scratch.file_of(target, "target")
        return replace(prepare_pair(*uris, settings, on_event=on_event), scratch=scratch)


@checked("pair")
def match(
    pair: Pair, *, executor: Executor | Runner | None = None, on_event: EventCallback = ignore
) -> Matches:
    """Find the tie points of a pair, each with the covariance of its position.

    Parameters
    ----------
    pair : Pair
        Of `open_pair`.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = as many processes as the pair's option `jobs` says, or the workers of its
        `scheduler`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the work.

    Returns
    -------
    Matches
        `accepted` tells whether the pair is matched reliably, `reason` why not.

    Raises
    ------
    InputError
        If a file cannot be read, was changed meanwhile, or holds nothing to match.
    ExecutionError
        If what the tiles run on cannot be used or is lost.
    """
    if not isinstance(pair, Pair):
        raise InputError(
            "match takes the pair that open_pair returns: match(open_pair(reference, target)); "
            "match_files(reference, target) writes tie points and report into a folder"
        )
    settings = pair.settings
    # points of a file leave workers nothing to do
    tile_executor = InThisProcess() if settings.tie_points else executor
    with trusting(settings.trust), open_job_runner(settings, tile_executor, on_event) as runner:
        matches = match_pair(pair, runner, on_event=on_event)
        check_unchanged(file.identity for file in pair.inputs)
        return matches


@checked("matches", "model")
def fit(
    matches: Matches, model: Model | None = None, *, on_event: EventCallback = ignore
) -> FittedCorrection:
    """Fit a correction to the tie points of a pair.

    Parameters
    ----------
    matches : Matches
        Of `match`.
    model : {"auto", "shift", "affine", "projective", "polynomial", "tps", "field", "jitter", "rpc"}, optional
        By default what the pair was opened with: ``"auto"``, the simplest model that no other beats in
        predicting blocks of points left out.
    on_event : callable
        Receives `Progress` and `Warned` events.

    Raises
    ------
    RegistrationRejectedError
        If the tie points, or the correction, are not reliable; its `registration` holds the figures.
    InputError
        If the model cannot be fitted, or is not one.
    """
    if not isinstance(matches, Matches):
        raise InputError(
            "fit takes the tie points that match returns: fit(match(open_pair(reference, target)))"
        )
    pair = matches.pair
    settings = pair.settings if model is None else replace(pair.settings, model=model)
    if pair.rpc is not None:
        check_model(settings.model)
    elif settings.model == "rpc":
        raise SettingsError(
            "model = 'rpc': the pair was opened without the target's RPC: open it with model='rpc'"
        )
    with trusting(settings.trust):
        fitted = fit_pair(matches, settings, on_event=on_event) if matches.accepted else None
        registration = conclude(matches, fitted)
    if registration.status == "rejected":
        raise RegistrationRejectedError(str(registration.reason), registration)
    return FittedCorrection(registration, pair.scratch)


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
