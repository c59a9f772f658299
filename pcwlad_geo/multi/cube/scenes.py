"""The images of a cube as the stack takes them: each date is read once, into a file of a temporary folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Progress
from pcwlad_geo.in_memory import nodata_of, pixels_of
from pcwlad_geo.multi.cube.layout import CubeLayout, grid_of, same_pixels
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.raster import OutputFormat, describe, open_raster, plain_name, warp
from pcwlad_geo.raster.masks import accepted
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.types import Bool


@dataclass(frozen=True, slots=True)
class SceneParameters:
    """How a cube is read."""

    batch_bytes: int = 2**25
    """So much of a cube is read at a time; a chunk that is larger is read as a whole."""
    cells: int = 64
    """Number of cells along each axis in which images are looked at for common ground."""
    min_dates: int = 3
    """Least number of dates of a median: that of two shows all edges twice."""


SCENES: Final = SceneParameters()
"""The numbers in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """An image of a cube in a file."""

    given: StackInput
    valid: Bool
    """(cells, cells) whether a cell of the image has valid pixels."""


def nodata_value(cube: Any) -> float | None:  # noqa: ANN401  # of xarray, which need not be installed
    """Return the value of the pixels of a cube that are not valid; None if it has none."""
    nodata = nodata_of(cube, np.dtype(cube.dtype))
    return np.nan if nodata is None and cube.dtype.kind == "f" else nodata


def write_scenes(
    cube: Any,  # noqa: ANN401  # of xarray, which need not be installed
    mask: Any,  # noqa: ANN401
    layout: CubeLayout,
    scratch: Scratch,
    on_event: EventCallback,
) -> list[Scene]:
    """Write each image of a cube, and its mask, to files, and return them in the order of the cube.

    The cube and the mask, which may be None, are DataArrays of (time, y, x) with the same pixels. Each chunk
    is computed once, together with its mask.
    """
    scenes: list[Scene] = []
    names, nodata = layout.names, nodata_value(cube)
    for start, stop in _batches(cube):
        part = cube.isel({layout.dims[0]: slice(start, stop)}).to_dataset(name="pixels")
        if mask is not None:
            mask_part = mask.isel({layout.dims[0]: slice(start, stop)})
            part = part.assign(mask=(part["pixels"].dims, mask_part.data))
        part = part.compute()
        for number in range(start, stop):
            on_event(Progress("dates", number, len(names)))
            pixels = pixels_of(part["pixels"].values[number - start])
            raster = Raster(pixels, layout.grid.transform, layout.grid.crs, nodata)
            valid = np.isfinite(raster.array) & (True if nodata is None else raster.array != nodata)
            file, mask_file = scratch.file_of(raster, plain_name(names[number])), None
            if mask is not None:
                mask_name = plain_name(str(mask.name or "mask"))
                values = whole_numbers(part["mask"].values[number - start], mask_name)
                mask_raster = Raster(values, layout.grid.transform, layout.grid.crs)
                mask_file = scratch.file_of(mask_raster, f"{names[number]}_{mask_name}")
                valid &= accepted(describe(file, mask=mask_file).mask_kind, values[None])
            scenes.append(_scene(file, names[number], mask_file, valid, str(layout.times[number])))
    on_event(Progress("dates", len(names), len(names)))
    return scenes


def check_mask(mask: Any, layout: CubeLayout) -> Any:  # noqa: ANN401
    """Return a mask with the axes of a cube; raises `InputError` if it has other pixels or dates."""
    grid = grid_of(layout.ordered(mask), "the mask") if set(map(str, mask.dims)) == set(layout.dims) else None
    same_times = grid is not None and np.array_equal(
        np.asarray(mask.coords[layout.dims[0]].values).astype("datetime64[s]"), layout.times
    )
    if grid is None or not same_times or not same_pixels(grid, layout.grid):
        raise InputError(
            f"the mask {mask.name or ''} of ({', '.join(map(str, mask.dims))}) has other pixels, dates or "
            "a CRS other than the cube: load both together, or mask.reindex_like(cube, 'nearest')"
        )
    return layout.ordered(mask)


def write_warped(scene: Scene, correction: Correction, layout: CubeLayout, scratch: Scratch) -> str:
    """Write an image without the pixels that are not valid, warped by a correction; return the file."""
    grid = layout.grid
    raster = Raster(_valid_values(scene.given), grid.transform, grid.crs, np.nan)
    path = Path(scratch.file_of(raster, f"valid_{scene.given.name}"))
    place = path.with_name(f"warped_{path.name}")
    warp(path, place, correction, grid, "cubic", fmt=OutputFormat.of("GTiff", ()))
    path.unlink()
    return str(place)


def write_median(files: list[str], name: str, layout: CubeLayout, scratch: Scratch, month: int) -> Scene:
    """Write the median of the valid pixels of warped images, which are removed; 0 is no month."""
    rows, cols = layout.grid.shape
    median = np.full((rows, cols), np.nan, dtype=np.float32)
    step = max(1, SCENES.batch_bytes // (16 * cols * len(files)))
    for top in range(0, rows, step):
        window = ((top, min(top + step, rows)), (0, cols))
        parts = []
        for uri in files:
            with open_raster(uri) as file:
                parts.append(file.read(1, window=window))
        values = np.stack(parts)
        valid = np.isfinite(values).any(axis=0)
        median[top : top + step][valid] = np.nanmedian(values[:, valid], axis=0)
    for uri in files:
        Path(uri).unlink()
    raster = Raster(median, layout.grid.transform, layout.grid.crs, np.nan)
    return _scene(
        scratch.file_of(raster, name),
        name,
        None,
        np.isfinite(median),
        f"2000-{month:02}-15" if month else None,
    )


def _scene(file: str, name: str, mask: str | None, valid: Bool, date: str | None) -> Scene:
    rows, cols = valid.shape
    row, col = np.nonzero(valid)
    cells = np.zeros((SCENES.cells, SCENES.cells), dtype=bool)
    cells[row * SCENES.cells // rows, col * SCENES.cells // cols] = True
    cloud = 1 - float(valid.mean())
    return Scene(StackInput(file, 1, name, mask, date, cloud=cloud), cells)


def _valid_values(image: StackInput) -> NDArray[np.float32]:
    """Return the (rows, cols) pixels of an image of a cube; NaN where they are not valid."""
    with open_raster(image.path) as file:
        values = file.read(1, masked=True).astype(np.float32).filled(np.nan)
    if image.mask is not None:
        with open_raster(image.mask) as file:
            values[~accepted(describe(image.path, mask=image.mask).mask_kind, file.read())] = np.nan
    return np.asarray(values)


def _batches(cube: Any) -> Iterator[tuple[int, int]]:  # noqa: ANN401
    """Yield ranges of dates that are read at a time: whole chunks, as many as fit."""
    count, *sides = cube.shape
    sizes = cube.chunks[0] if cube.chunks else (1,) * count
    limit = max(1, SCENES.batch_bytes // max(1, cube.dtype.itemsize * int(np.prod(sides))))
    start = stop = 0
    for size in sizes:
        if stop > start and stop + size - start > limit:
            yield start, stop
            start = stop
        stop += size
    yield start, stop


def whole_numbers(values: NDArray[Any], name: str) -> NDArray[Any]:
    """Return the (…,) `values` of a mask of this name as (…,) whole numbers; NaN becomes no data."""
    if values.dtype.kind == "f":
        nothing = int(name.casefold().endswith(("qa_pixel", "bqa")))  # the bit of their fill
        values = np.where(np.isfinite(values), values, nothing).astype(np.uint16)
    return values.astype(np.uint8) if values.dtype.kind == "b" else values
