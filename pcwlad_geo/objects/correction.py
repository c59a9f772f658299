"""A correction as an object: fitted, made by hand, composed, saved and read, applied."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rasterio.control import GroundControlPoint
from rasterio.io import DatasetReader

from pcwlad_geo.arguments import checked
from pcwlad_geo.correction.error_statistics import FitAccuracy
from pcwlad_geo.correction.models import Correction as Model
from pcwlad_geo.correction.precision import ComposedPrecision, Precision, SigmaLattice, slopes_of
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.objects.files import content_of
from pcwlad_geo.objects.plots import label_pixels, new_axes, plot_lattice
from pcwlad_geo.objects.tie_points import TiePoints
from pcwlad_geo.objects.vectors import is_vector_frame, warp_frame
from pcwlad_geo.objects.warping import WarpKeywords, warp_raster
from pcwlad_geo.outputs.folder import place_file, stage_inside
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.raster import Trust, trusting
from pcwlad_geo.raster.arrays import RasterLike
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.registration import Quality
from pcwlad_geo.report.correction_file import text_of
from pcwlad_geo.report.finished import FinishedRegistration
from pcwlad_geo.text import Shown
from pcwlad_geo.types import Float64, PathLike
from pcwlad_geo.vector_warping import Movement, in_metres, is_vector, moved_vectors, write_vectors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from typing_extensions import Unpack


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Correction(Shown):
    """Maps the target pixel that the original georeferencing predicts for a place to the one that shows it.

    Pixel coordinates are (col, row) of the original target, corner-based: the centre of the first pixel is
    (0.5, 0.5). ``later @ first`` is the correction that applies `first`, then `later`. One that is fitted
    knows its precision, its accuracy and its tie points; one made by hand is taken to be exact.
    """

    model: Model
    """The mapping alone."""
    pair: FinishedRegistration | None = None
    """The grids of reference and target; None of one made by hand."""
    precision: Precision | None = None
    """What knows its standard deviation; None of one made by hand."""
    points: TiePoints | None = None
    """The tie points, those rejected among them; None where it has none."""
    evidence: tuple[FitAccuracy, Quality] | None = None
    """How good it is; None unless it was fitted and not changed since."""
    warnings: tuple[str, ...] = ()
    """What was warned of, from opening the pair on."""
    trust: Trust = field(default_factory=Trust)
    """What the rasters of its pair may open."""
    keep: object = None
    """What keeps the files of arrays for as long as they are needed."""

    @property
    def name(self) -> str:
        """The model, such as affine; of a composition those of its steps."""
        return self.model.name

    @property
    def accuracy(self) -> FitAccuracy:
        """Statistics of the residuals at the points of the fit (`fit`) and the check points (`check`).

        Raises `InputError` if the correction was made by hand, or composed.
        """
        return self._evidence()[0]

    @property
    def quality(self) -> Quality:
        """Grade, reasons and the error expected over the common ground; raises as `accuracy` does."""
        return self._evidence()[1]

    @property
    def tie_points(self) -> TiePoints:
        """The tie points with residuals; status fit, check, unused or rejected.

        Raises `InputError` if it has none.
        """
        if self.points is None:
            raise InputError(f"this {self.name} correction has no tie points, as one that is made by hand")
        return self.points

    def forward(self, xy_px: ArrayLike) -> Float64:
        """Map (n, 2) predicted target px (col, row) to (n, 2) observed ones; NaN where the model has none."""
        return self.model.forward(_positions(xy_px))

    def inverse(self, xy_px: ArrayLike) -> Float64:
        """Map (n, 2) observed target px (col, row) to (n, 2) predicted ones; NaN where the model has none."""
        return self.model.inverse(_positions(xy_px))

    def sigma(self, xy_px: ArrayLike) -> Float64:
        """Return the (n, 2) standard deviation (col, row) at (n, 2) predicted target px (col, row), px.

        It is zero for a correction made by hand, and NaN where one that is read from a file does not know it:
        a tenth of its size beyond the target.
        """
        at_px = _positions(xy_px)
        return np.zeros(at_px.shape) if self.precision is None else self.precision.sigma(at_px)

    def __matmul__(self, first: Correction) -> Correction:
        """Return the correction that applies `first`, then this one.

        Raises `InputError` if both are fitted, or one corrects RPCs.
        """
        if not isinstance(first, Correction):
            return NotImplemented
        if self.pair is not None and first.pair is not None:
            raise InputError(
                "both corrections are fitted, each in the pixels of its target: register the original target "
                "to the reference of the later one instead"
            )
        fitted = self if self.pair is not None else first
        if fitted.pair is not None and fitted.pair.rpc is not None:
            raise InputError(
                "the correction of an RPC depends on heights, and cannot be composed: warp with it"
            )
        before, after = (first.model, None) if fitted is self else (None, self.model)
        precision, model = fitted.precision, self.model @ first.model
        if precision is not None:
            precision = ComposedPrecision(precision, fitted.model, before, after)
        points = None if after is None or fitted.points is None else _moved(fitted.points, after)
        return replace(fitted, model=model, precision=precision, points=points, evidence=None)

    def invert(self) -> Correction:
        """Return the correction that maps observed to predicted pixels, without a pair, taken to be exact."""
        return Correction(self.model.invert())

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

    def to_gdal(self) -> tuple[float, float, float, float, float, float]:
        """Return the geotransform, in GDAL's order, that places observed at predicted pixels.

        Raises `InputError` for a model that is no affine.
        """
        return self.model.to_gdal()

    def to_skimage(self) -> Any:  # noqa: ANN401  # of scikit-image, which has no types
        """Return the correction as a transform of scikit-image, which counts from pixel centres."""
        return self.model.to_skimage()

    def save(self, path: PathLike, *, overwrite: bool = False) -> Path:
        """Write the correction as JSON, with its precision and tie points, and return the path.

        `pcwlad_geo.load`, ``pcwlad-geo warp`` and, for its tie points, ``--tie-points`` read it.

        Raises
        ------
        OutputError
            If the file exists and `overwrite` is False, or cannot be written.
        """
        place = Path(path)
        check_outputs([place], overwrite=overwrite)
        shape = None if self.pair is None else self.pair.target_grid.shape
        lattice = self.precision
        if lattice is not None and shape is not None and not isinstance(lattice, SigmaLattice):
            lattice = SigmaLattice.of(lattice, shape)
        content = content_of(self.model, self.pair, lattice, self.points, self.evidence)
        with stage_inside(place.parent) as stage:
            staged = stage / place.name
            staged.write_text(text_of(content), encoding="utf-8", newline="\n")
            place_file(staged, place, overwrite=overwrite)
        return place

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacement that it corrects over the target, and its standard deviation, by Matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw; new axes by default.

        Returns
        -------
        matplotlib.axes.Axes
            Of the pixels of the target, rows downwards.
        """
        if self.pair is None:
            raise InputError("a correction made by hand has no target over which to draw: compose it first")
        shape = self.pair.target_grid.shape
        ax = new_axes(ax)
        plot_lattice(ax, shape, self.forward, self.sigma)
        ax.set_title(f"displacement by the {self.name} correction", loc="left")
        label_pixels(ax, shape, "target")
        return ax

    @overload
    def warp(self, src: RasterLike, dst: PathLike, **keywords: Unpack[WarpKeywords]) -> Path: ...

    @overload
    def warp(
        self, src: PathLike | Raster | DatasetReader, dst: None = None, **keywords: Unpack[WarpKeywords]
    ) -> Raster: ...

    @overload
    def warp(
        self, src: NDArray[Any], dst: None = None, **keywords: Unpack[WarpKeywords]
    ) -> np.ma.MaskedArray[Any, Any]: ...

    @overload
    def warp(self, src: object, dst: None = None, **keywords: Unpack[WarpKeywords]) -> Any: ...  # noqa: ANN401  # of its kind

    @checked("src", "like", "resampling")
    def warp(
        self,
        src: Any,
        dst: PathLike | None = None,
        *,
        inverse: bool = False,
        sigma_m: bool = False,
        overwrite: bool = False,
        on_event: EventCallback = ignore,
        **keywords: Unpack[WarpKeywords],
    ) -> Any:
        """Warp a raster of the target's geometry once, from its original pixels, or move vectors drawn on it.

        Parameters
        ----------
        src : path, rasterio dataset, array, Raster, xarray.DataArray or GeoDataFrame
            The target, or another band of it. An array of (rows, cols) or (bands, rows, cols), and a `Raster`
            or DataArray without georeferencing, has the target's pixels. Vectors, also the path of a vector
            file with `dst`, move from where the target draws them to where they belong; new vertices follow a
            curved correction to 0.05 px.
        dst : path, optional
            The file to write; by default the result is returned.
        inverse : bool
            Move vectors from where they belong to where the target draws them.
        sigma_m : bool
            Add the field ``sigma_m`` to vectors: the largest standard deviation of the correction, along an
            axis, at the vertices of each, metres.
        overwrite : bool
            Replace `dst` where it exists.
        on_event : callable
            Receives `Progress` and `Warned` events.
        **keywords
            `like`, a raster of any kind whose grid the result gets; `resampling`, `grid`, `tr`, `te`,
            `t_srs`, `of`, `co` as `pcwlad_geo.warp` takes them. By default a file gets what the pair was
            matched with, and what is returned has exactly the reference's grid.

        Returns
        -------
        pathlib.Path, Raster, numpy.ma.MaskedArray, xarray.DataArray or GeoDataFrame
            `dst`, or the kind of `src`; a `Raster` of a path or a dataset. Masked where the target shows
            nothing. In a DataArray that is `_FillValue` where `src` has one and NaN otherwise, so that whole
            numbers become float.

        Raises
        ------
        InputError
            If the raster or an option cannot be used.
        OutputError
            If `dst` cannot be written; nothing is left half-written.
        """
        is_file = isinstance(src, str | os.PathLike) and is_vector(os.fspath(src))
        if not is_file and not is_vector_frame(src):
            if inverse or sigma_m:
                raise InputError("inverse and sigma_m are for vectors: leave them out for a raster")
            with trusting(self.trust):
                return warp_raster(self._finished(), self.model, src, dst, keywords, overwrite, on_event)
        registration = self._finished()
        if registration is None:
            raise InputError("a correction made by hand has no target to draw vectors on: compose it first")
        if keywords:
            raise InputError(f"{next(iter(keywords))} is for rasters: leave it out for vectors")
        if not is_file:
            if dst is not None:
                raise InputError(
                    "the moved GeoDataFrame is returned: leave dst out, and write it with to_file"
                )
            precision = (self.precision or self) if sigma_m else None
            return warp_frame(src, registration, is_inverse=inverse, precision=precision, on_event=on_event)
        if dst is None:
            raise InputError("a file of vectors is moved to another file: give dst")
        place, names = Path(dst), [os.fspath(src)]
        check_outputs([place], [src], overwrite=overwrite)
        told_m = in_metres(self.precision or self, registration.target_grid) if sigma_m else None
        with trusting(self.trust):
            moved = moved_vectors(names, Movement(registration, None, inverse, precision=told_m), on_event)
            write_vectors(moved, names, [place], overwrite=overwrite, on_event=on_event)
        return place

    def _finished(self) -> FinishedRegistration | None:
        return None if self.pair is None else replace(self.pair, correction=self.model)

    def _evidence(self) -> tuple[FitAccuracy, Quality]:
        if self.evidence is None:
            raise InputError(
                f"nothing tells the accuracy of this {self.name} correction, which was made by hand or "
                "composed: ask the fitted one"
            )
        return self.evidence

    def _facts(self) -> dict[str, str]:
        facts = {"model": self.name}
        facts |= {} if self.points is None else {"tie points": self.points.summary()}
        if self.evidence is not None:
            group, what = self.accuracy.check, "check"
            if not group.n:
                group, what = self.accuracy.fit, "fit"
            facts["accuracy"] = f"RMSE {group.rmse_px:.2f} px at {group.n} {what} points"
            facts["quality"] = f"quality {self.quality.grade}"
        return facts


def _moved(points: TiePoints, later: Model) -> TiePoints:
    """Return tie points whose observed positions are mapped by a correction."""
    slopes = slopes_of(later, points.target_px)
    moved_px = later.forward(points.target_px)
    model_px = points.target_px - points.residual_px
    return replace(
        points,
        target_px=moved_px,
        residual_px=moved_px - later.forward(model_px),
        covariance_px2=slopes @ points.covariance_px2 @ slopes.transpose(0, 2, 1),
        displacement_m=np.full_like(points.displacement_m, np.nan),
    )


def _positions(xy_px: ArrayLike) -> Float64:
    """Return positions as an (n, 2) array."""
    points = np.asarray(xy_px, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"positions of shape {points.shape}: give an (n, 2) array of (col, row)")
    return points
