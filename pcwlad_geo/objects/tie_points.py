"""Tie points that know the pair that they are of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.objects.pairs import matched
from pcwlad_geo.objects.plots import plot_arrows
from pcwlad_geo.options import PairOptions
from pcwlad_geo.outputs.folder import place_file, stage_inside
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.raster import Grid, RasterInfo
from pcwlad_geo.raster.arrays import RasterLike
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.registration import Matches, Origin, conclude
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.format import PointRasters
from pcwlad_geo.tiepoints.geopackage import write_geopackage
from pcwlad_geo.tiepoints.readers import FORMATS
from pcwlad_geo.tiepoints.table import TiePointTable, joined
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from typing_extensions import Self, Unpack


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TiePoints(TiePointTable):
    """Tie points of a pair of rasters, one row each, as `tiepoints.csv` has them.

    Pixel coordinates are (col, row), corner-based, of the original files: the centre of the first pixel is
    (0.5, 0.5). Rows are chosen by an index, as those of an array: ``points[points.score > 0.5]``. Points of
    the same pair are added by ``+``.
    """

    matches: Matches | None = None
    """What the matching knows besides; None where the points come without their pair."""

    @classmethod
    def of(cls, table: TiePointTable, matches: Matches | None = None) -> Self:
        """Return the rows of a table as tie points of a pair."""
        values = {name: getattr(table, name) for name in TiePointTable.__dataclass_fields__}
        return cls(**values, matches=matches)

    @classmethod
    def from_file(
        cls,
        path: PathLike,
        reference: RasterLike,
        target: RasterLike,
        *,
        on_event: EventCallback = ignore,
        **options: Unpack[PairOptions],
    ) -> Self:
        """Read the tie points of a pair from a file; its format is recognised by its content.

        Parameters
        ----------
        path : path
            A tiepoints.csv or .gpkg, a saved correction, QGIS .points, ENVI .pts, or a raster with ground
            control points.
        reference, target : path, rasterio dataset, array, (array, Grid), Raster or xarray.DataArray
            The rasters of the pair.
        on_event : callable
            Receives `Warned` events.
        **options
            As for `match`.

        Raises
        ------
        RegistrationRejectedError
            If the points describe no common displacement.
        InputError
            If the file cannot be read, or is of another pair.
        """
        with_file: Any = {**options, "tie_points": path}
        matches, _ = matched(reference, target, (None, None), with_file, None, on_event)
        if not matches.accepted:
            raise RegistrationRejectedError(str(matches.reason), conclude(matches))
        return cls.of(matches.tie_points, matches)

    @property
    def reference(self) -> Raster:
        """The band of the reference that was matched, and its grid."""
        return self._raster("reference")

    @property
    def target(self) -> Raster:
        """The band of the target that was matched, and its grid."""
        return self._raster("target")

    def __add__(self, more: TiePoints) -> Self:
        """Return these points and `more` of the same pair; raises `InputError` if they are of another one."""
        if not isinstance(more, TiePoints):
            return NotImplemented
        if _grids(self) != _grids(more):
            raise InputError(
                "these tie points are of two pairs, whose rasters have other grids: fit each pair by itself"
            )
        return joined(self, more)

    def to_file(self, path: PathLike, *, overwrite: bool = False) -> Path:
        """Write the points to a file, and return its path.

        The suffix tells the format: .csv (as `tiepoints.csv`), .gpkg, .points (QGIS), .pts (ENVI), or that of
        a format of another package. `TiePoints.from_file` and ``--tie-points`` read them.

        Raises
        ------
        SettingsError
            If no format has the suffix.
        OutputError
            If the file exists and `overwrite` is False, or cannot be written.
        """
        place = Path(path)
        check_outputs([place], overwrite=overwrite)
        suffix = place.suffix.lower()
        with stage_inside(place.parent) as stage:
            staged = stage / place.name
            if suffix == ".csv":
                write_csv(self, staged)
            elif suffix == ".gpkg":
                grid = None if self.matches is None else self.matches.pair.target.grid
                write_geopackage(self, staged, grid)
            else:
                self._write_as(suffix, staged, place)
            place_file(staged, place, overwrite=overwrite)
        return place

    def plot(self, ax: Axes | None = None, *, scale: float | None = None) -> Axes:
        """Draw the displacements as arrows over the reference with Matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Where to draw; new axes by default.
        scale : float, optional
            How many times longer than they are the arrows are drawn; chosen by default, and written beside
            the key.

        Returns
        -------
        matplotlib.axes.Axes
            Of the pixels of the reference, rows downwards. Rejected points are crosses.
        """
        backdrop = None if self.matches is None else self.reference
        return plot_arrows(self, backdrop, ax=ax, scale=scale)

    def fitted_to(self) -> Matches:
        """Return what a correction is fitted to: the matching, with these points alone.

        Raises `InputError` if the points come without their pair.
        """
        matches = self.matches
        if matches is None:
            raise InputError(
                "these tie points come without their pair: read them with TiePoints.from_file(path, "
                "reference, target)"
            )
        known = matches.tie_points
        if self.status is known.status:  # all of them, as they were matched
            return matches
        status = np.where(self.status == "rejected", "rejected", "matched").astype("<U8")
        table = TiePointTable(**{**_columns(self), "status": status})
        roles = self.status if (self.status == "check").any() else _roles_of(table, matches)
        is_known = np.isin(_places(table), _places(matches.every))
        lost = np.count_nonzero(known.status != "rejected") - np.count_nonzero(status[is_known] == "matched")
        added = int(np.count_nonzero(~is_known))
        origin = matches.origin
        if lost > 0 or added:
            origin = origin or Origin("", window_px=matches.window_px)
            origin = replace(origin, left_out=origin.left_out + max(int(lost), 0), added=origin.added + added)
        every = joined(matches.every, table[~is_known])
        return replace(matches, tie_points=table, every=every, roles=roles, origin=origin)

    def _raster(self, side: str) -> Raster:
        if self.matches is None:
            raise InputError(f"these tie points come without their pair, so that no {side} is known")
        pair = self.matches.pair
        info: RasterInfo = getattr(pair, side)
        return Raster.of_file(info, whole=False, trust=pair.settings.trust, keep=pair.scratch)

    def _write_as(self, suffix: str, staged: Path, place: Path) -> None:
        forms = [form for form in FORMATS if form.write and Path(form.file_name).suffix == suffix]
        if not forms or self.matches is None:
            suffixes = sorted(
                {Path(form.file_name).suffix for form in FORMATS if form.write} | {".csv", ".gpkg"}
            )
            raise SettingsError(
                f"{place} has no suffix of a format of tie points: give one of {', '.join(suffixes)}"
                if not forms
                else f"{place} needs the rasters of the pair, which these points lack: give a .csv or .gpkg"
            )
        pair = self.matches.pair
        write: Any = forms[0].write
        with FORMATS.blamed(forms[0]):
            write(self, staged, PointRasters(pair.reference, pair.target, pair.target.on_map, place))


def _columns(table: TiePointTable) -> dict[str, Any]:
    return {name: getattr(table, name) for name in TiePointTable.__dataclass_fields__}


def _grids(points: TiePoints) -> tuple[Grid, Grid] | None:
    pair = None if points.matches is None else points.matches.pair
    return None if pair is None else (pair.reference.grid, pair.target.grid)


def _places(table: TiePointTable) -> NDArray[np.complex128]:
    """Return one number for each observed position, by which points are recognised."""
    return np.asarray(table.target_px @ np.array([1.0, 1j]))


def _roles_of(table: TiePointTable, matches: Matches) -> NDArray[np.str_] | None:
    """Return what an earlier fit used the rows of a table for; rows that it does not know are fitted."""
    if matches.roles is None:
        return None
    roles = dict(zip(_places(matches.tie_points).tolist(), matches.roles.tolist(), strict=True))
    return np.array([roles.get(place, "fit") for place in _places(table).tolist()], dtype="<U8")
