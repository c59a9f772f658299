"""The accessor `.pcwlad` of xarray: ``import pcwlad_geo.xarray`` registers it.

A DataArray has `register`, and a cube of dates, a DataArray or a Dataset, `align`.
"""

from __future__ import annotations

import warnings
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.multi.cube.layout import CubeLayout, layout_of, same_pixels
from pcwlad_geo.multi.cube.run import PlacedDate, place_dates
from pcwlad_geo.multi.cube.scenes import check_mask
from pcwlad_geo.multi.cube.warping import warped_cube
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.arrays import RasterLike
from pcwlad_geo.raster.masks import is_quality_raster
from pcwlad_geo.raster.scratch import Scratch

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options, PairOptions

__all__ = ["DataArrayAccessor", "DatasetAccessor"]


@xr.register_dataarray_accessor("pcwlad")
class DataArrayAccessor:
    """Registration of an image, and alignment of a cube of dates.

    Parameters
    ----------
    data : xarray.DataArray
        An image of (y, x) or (band, y, x), or a cube of (time, y, x) or (time, band, y, x), with a CRS as
        odc-stac, stackstac and rioxarray give it.
    """

    def __init__(self, data: xr.DataArray) -> None:
        self._data = data

    @checked("reference", "mask", "ref_mask")
    def register(
        self,
        reference: RasterLike,
        *,
        mask: RasterLike | None = None,
        ref_mask: RasterLike | None = None,
        on_event: EventCallback = ignore,
        **options: Unpack[PairOptions],
    ) -> xr.DataArray:
        """Register the image to a reference, and return it on the grid of the reference.

        Parameters
        ----------
        reference : path, rasterio dataset, array, Raster or xarray.DataArray
            The image that stays.
        mask, ref_mask : as reference, optional
            Masks of the image and of the reference: 0 = excluded, or SCL, QA_PIXEL, BQA by their names.
        on_event : callable
            Receives `Progress` and `Warned` events.
        **options
            Fields of `Settings`, such as `model`, `window`, `resampling`.

        Returns
        -------
        xarray.DataArray
            With the coordinates `dx_m`, `dy_m`, `sigma_m` and `grade`, see `align`.

        Raises
        ------
        InputError
            If an image or an option cannot be used, or the two do not overlap.
        RegistrationRejectedError
            If they cannot be registered reliably.
        """
        from pcwlad_geo.multi.cube.image import register_image  # slow to load

        masks = {"ref_mask": ref_mask, "tgt_mask": mask}
        warped, date = register_image(reference, self._data, masks, options, on_event)
        return warped.assign_coords(
            {name: ((), values[0]) for name, values in _figures([date]).items() if name != "reason"}
        )

    @checked("reference", "mask")
    def align(
        self,
        reference: Any = "median",  # noqa: ANN401
        *,
        mask: xr.DataArray | None = None,
        band: object = None,
        on_event: EventCallback = ignore,
        executor: Executor | Runner | None = None,
        **options: Unpack[Options],
    ) -> xr.DataArray:
        """Align the dates of a cube with each other, by the adjustment of a stack.

        Each date is read once, as a whole, into a temporary file (in the folder of TMPDIR) that lives as long
        as the result. Pairs of dates are matched, all are adjusted together, and each is warped onto the grid
        of the cube when it is computed. A date whose place is not certain is refused: it stays where it was,
        and a warning names it.

        Parameters
        ----------
        reference : {"median", "monthly"}, date or xarray.DataArray
            What stays: the median of all dates, once they are aligned with each other; the median of a month,
            that of most dates, where each date is compared with the median of its month over all years; the
            image of a date; another image.
        mask : xarray.DataArray, optional
            Of (time, y, x): 0 or False = excluded, or SCL, QA_PIXEL, BQA by its name.
        band : object, optional
            Label of the band that is matched, of a cube with bands; all are warped.
        on_event : callable
            Receives `Progress` and `Warned` events.
        executor : concurrent.futures.Executor or Runner, optional
            Runs the tiles; None = `jobs` processes.
        **options
            Fields of `Settings`, as `stack` takes them, such as `model`, `window`, `resampling`.

        Returns
        -------
        xarray.DataArray
            Like the cube, computed when it is asked for if the cube is, with coordinates along time: `dx_m`
            and `dy_m`, the mean displacement of a date along the axes of the CRS, metres, which was taken
            out; `sigma_m`, the standard deviation of its position along an axis; `grade`: good, fair, poor or
            refused; `reason`, why it is not good. Figures of refused dates are NaN.

        Raises
        ------
        InputError
            If the cube, the mask or an option cannot be used.
        RegistrationRejectedError
            If no two dates can be matched.
        """
        matched = _band_of(self._data, band)
        layout, dates, scratch = _placed(matched, mask, reference, options, on_event, executor)
        resampling = Settings.from_options(options).resampling
        files = scratch if matched.ndim == self._data.ndim and _is_here() else None
        warped = warped_cube(self._data, layout, dates, resampling, files)
        return warped.assign_coords(_along_time(layout, dates))


@xr.register_dataset_accessor("pcwlad")
class DatasetAccessor:
    """Alignment of a cube of dates with its bands as variables.

    Parameters
    ----------
    data : xarray.Dataset
        With variables of (time, y, x), and a CRS as odc-stac and rioxarray give it.
    """

    def __init__(self, data: xr.Dataset) -> None:
        self._data = data

    @checked("reference", "mask")
    def align(
        self,
        reference: Any = "median",  # noqa: ANN401
        *,
        band: str,
        mask: str | xr.DataArray | None = None,
        on_event: EventCallback = ignore,
        executor: Executor | Runner | None = None,
        **options: Unpack[Options],
    ) -> xr.Dataset:
        """Align the dates of a cube, all its variables by one of them, see `DataArrayAccessor.align`.

        Parameters
        ----------
        reference : {"median", "monthly"}, date or xarray.DataArray
        band : str
            Name of the variable that is matched.
        mask : str or xarray.DataArray, optional
            Name of the variable that is the mask, or one beside the cube.
        on_event : callable
        executor : concurrent.futures.Executor or Runner, optional
        **options
            Fields of `Settings`, as `stack` takes them.

        Returns
        -------
        xarray.Dataset
            Masks and quality rasters are resampled by nearest neighbour. Variables without times, rows and
            columns stay as they are.

        Raises
        ------
        InputError
            If the cube, the mask or an option cannot be used.
        RegistrationRejectedError
            If no two dates can be matched.
        """
        cube = _variable(self._data, band)
        image_mask = _variable(self._data, mask) if isinstance(mask, str) else mask
        layout = layout_of(cube)
        others = {
            name: layout_of(values)
            for name, values in self._data.data_vars.items()
            if set(layout.dims) <= set(map(str, values.dims))
        }
        for name, other in others.items():
            if not same_pixels(layout.grid, other.grid):
                raise InputError(
                    f"{name} has another CRS or other pixels than {band}: load all variables on one grid"
                )
        layout, dates, scratch = _placed(cube, image_mask, reference, options, on_event, executor)
        resampling = Settings.from_options(options).resampling
        warped = {}
        for name in others:
            values = self._data[name]
            classes = name == mask or values.dtype.kind == "b" or is_quality_raster(str(name))
            files = scratch if name == band and _is_here() else None
            warped[name] = warped_cube(values, layout, dates, "nearest" if classes else resampling, files)
        return self._data.assign(warped).assign_coords(_along_time(layout, dates))


def _band_of(cube: xr.DataArray, band: object) -> xr.DataArray:
    """Return the band of a cube that is matched; raises `InputError` if there are several."""
    further = [name for name in cube.dims[:-2] if str(name) not in ("time", "t")]
    if cube.ndim < 4 or not further:
        return cube
    name, labels = further[0], cube[further[0]].values.tolist()
    if band is None and len(labels) == 1:
        return cube.isel({name: 0})
    if band not in labels:
        raise InputError(
            f"band = {band!r}: the cube has the bands {', '.join(map(str, labels))}: name the one to match"
        )
    return cube.isel({name: labels.index(band)})


def _variable(data: xr.Dataset, name: str) -> xr.DataArray:
    if name not in data.data_vars:
        raise InputError(f"the Dataset has no variable {name}: it has {', '.join(map(str, data.data_vars))}")
    return data[name]


def _placed(
    cube: xr.DataArray,
    mask: xr.DataArray | None,
    reference: Any,  # noqa: ANN401
    options: Options,
    on_event: EventCallback,
    executor: Executor | Runner | None,
) -> tuple[CubeLayout, list[PlacedDate], Scratch]:
    """Place the dates of a cube; warns of those that are refused."""
    layout, scratch = layout_of(cube), Scratch()
    image_mask = None if mask is None else check_mask(mask, layout)
    dates = place_dates(
        layout.ordered(cube), image_mask, layout, reference, scratch, options, on_event, executor
    )
    refused = [
        f"{name} ({date.reason})"
        for name, date in zip(layout.names, dates, strict=True)
        if date.grade == "refused"
    ]
    if len(refused) == len(dates):
        raise RegistrationRejectedError(f"no date of the cube can be placed: {refused[0]}: mask what moves")
    if refused:
        count = f"{len(refused)} of {len(dates)} dates are refused, and stay where they were"
        warnings.warn(f"{count}: {'; '.join(refused)}", stacklevel=4)
    return layout, dates, scratch


def _figures(dates: list[PlacedDate]) -> dict[str, np.ndarray[Any, Any]]:
    """Return what is known of the places of images, by the names of the coordinates."""
    displacement_m = np.array([date.displacement_m for date in dates])
    return {
        "dx_m": displacement_m[:, 0],
        "dy_m": displacement_m[:, 1],
        "sigma_m": np.array([date.sigma_m for date in dates]),
        "grade": np.array([date.grade for date in dates]),
        "reason": np.array([date.reason for date in dates]),
    }


def _along_time(layout: CubeLayout, dates: list[PlacedDate]) -> dict[str, Any]:
    return {name: (layout.dims[0], values) for name, values in _figures(dates).items()}


def _is_here() -> bool:
    """Whether dask computes in this process or on this machine, which has the files of the dates."""
    import sys

    distributed = sys.modules.get("distributed")
    if distributed is None:
        return True
    try:
        distributed.default_client()
    except ValueError:  # there is none
        return True
    return False
