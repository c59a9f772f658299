"""The images of a cube, warped when they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.multi.cube.layout import CubeLayout
from pcwlad_geo.multi.cube.run import PlacedDate
from pcwlad_geo.multi.cube.scenes import nodata_value
from pcwlad_geo.raster import Grid, OutputFormat, warp
from pcwlad_geo.raster.raster import Raster, read_raster
from pcwlad_geo.raster.scratch import Scratch


@dataclass(frozen=True, slots=True, eq=False)
class DateWarp:
    """How the images of a date are warped; small and picklable."""

    correction: Correction | None
    """None: they stay as they are."""
    grid: Grid
    resampling: str
    nodata: float | None
    dtype: str
    """Data type of the result, which holds the fill."""
    file: str | None = None
    """A file of the pixels, which need not be read again then."""
    scratch: Scratch | None = None
    """What keeps that file for as long as it is needed."""

    def __call__(self, pixels: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return the warped (…, rows, cols) pixels of the same shape, by default those of the file."""
        if pixels is None:
            return self._warped(str(self.file))
        if self.correction is None:
            return pixels.astype(self.dtype)
        images = pixels.reshape(-1, *pixels.shape[-2:])
        scratch, warped = Scratch(), []
        for image in images:
            raster = Raster(image, self.grid.transform, self.grid.crs, self.nodata)
            warped.append(self._warped(scratch.file_of(raster, "image")))
        return np.stack(warped).reshape(pixels.shape)

    def _warped(self, file: str) -> NDArray[Any]:
        """Return the warped (rows, cols) pixels of a file."""
        scratch, place = Scratch(), file
        if self.correction is not None:
            place = str(scratch.folder / "warped.tif")
            plain = OutputFormat.of("GTiff", ())
            warp(file, scratch.folder / "warped.tif", self.correction, self.grid, self.resampling, fmt=plain)
        pixels: Any = np.ma.asarray(read_raster(place).array[0])
        fill = np.nan if np.dtype(self.dtype).kind == "f" and self.nodata is None else self.nodata or 0
        return np.asarray(pixels.astype(self.dtype).filled(fill))


def warped_cube(
    cube: Any,  # noqa: ANN401  # of xarray, which need not be installed
    layout: CubeLayout,
    dates: Sequence[PlacedDate],
    resampling: str,
    scratch: Scratch | None,
) -> Any:  # noqa: ANN401
    """Return a cube of (time, y, x), or of bands besides, with its images warped onto its own grid.

    It is computed when it is asked for if the cube is. Images are read from the files of `dates` where these
    are of the cube, and their `scratch` is given. Whole numbers without a nodata value become floating-point
    numbers, unless the resampling is nearest, and NaN where nothing is known.
    """
    ordered, nodata = layout.ordered(cube), nodata_value(cube)
    dtype = np.dtype(cube.dtype)
    if dtype.kind in "iu" and nodata is None and resampling != "nearest":
        dtype = np.dtype("float32" if dtype.itemsize < 4 else "float64")
    how = DateWarp(None, layout.grid, resampling, nodata, str(dtype))
    hows = [
        replace(how, correction=date.correction)
        if scratch is None
        else replace(how, correction=date.correction, file=date.file, scratch=scratch)
        for date in dates
    ]
    if cube.chunks is None:
        values = np.stack([how(ordered.data[number]) for number, how in enumerate(hows)])
    else:
        values = _lazily(ordered.data, hows)
    return ordered.copy(data=values).transpose(*cube.dims)


def _lazily(data: Any, hows: Sequence[DateWarp]) -> Any:  # noqa: ANN401  # of dask
    """Return a dask array of the warped images of another."""
    import dask
    import dask.array as da

    images = []
    for number, how in enumerate(hows):
        shape, dtype = data.shape[1:], np.dtype(how.dtype)
        if how.file is None:
            images.append(data[number].map_blocks(how, dtype=dtype, meta=np.empty((0,) * len(shape), dtype)))
        else:
            images.append(da.from_delayed(dask.delayed(how, pure=False)(), shape, dtype))
    return da.stack(images)
