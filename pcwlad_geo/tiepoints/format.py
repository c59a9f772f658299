"""A format of tie point files: how it is recognised, read and written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from pcwlad_geo.raster import RasterInfo
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True, eq=False)
class PointFile:
    """The content of a file of tie points."""

    reference: Float64
    """(n, 2): px (col, row) of the reference, or map coordinates (x, y)."""
    target: Float64
    """(n, 2): px (col, row) of the target, or its layer coordinates (x, y) in QGIS."""
    enabled: Bool
    """(n,): False where the file disables a point."""
    reference_in: Literal["px", "map"]
    target_in: Literal["px", "layer"]
    crs: CRS | None = None
    """CRS of map coordinates, if the file states it."""
    sigma_px: Float64 | None = None
    """(n, 2) standard deviations (col, row), px, if the file states them; NaN for empty cells."""
    correlation: Float64 | None = None
    """(n,) correlations of the errors along columns and rows, if the file states them."""
    score: Float64 | None = None
    """(n,) scores, if the file states them."""
    xy: Float64 | None = None
    """(n, 2) map coordinates (x, y) given besides the pixels, for a consistency check."""
    displacement_px: Float64 | None = None
    """(n, 2) displacements (col, row), px, given besides the pixels, for a consistency check."""
    displacement_m: Float64 | None = None
    """(n, 2) displacements along the map axes, metres, if the file states them."""
    shape: tuple[int, int] | None = None
    """Rows, columns of the raster that holds the points."""
    status: NDArray[np.str_] | None = None
    """(n,) statuses, if the file states them."""

    def __post_init__(self) -> None:
        if not np.shape(self.reference) == np.shape(self.target) == (len(self.enabled), 2):
            raise ValueError("the reference and target positions of tie points must be two (n, 2) arrays")


@dataclass(frozen=True, slots=True)
class PointSource:
    """A file of tie points that is to be read."""

    path: str
    """Its path, or a GDAL URI."""
    head: bytes
    """Its first bytes; none of what is no file."""
    lines: tuple[str, ...] | None
    """Its lines; None if it is no text."""
    reference_name: str
    target_name: str
    """File names of the rasters."""

    @property
    def first_line(self) -> str:
        """The first line that is neither blank nor a comment (#), in lower case; empty if there is none."""
        lines = (line for line in self.lines or () if line.strip() and not line.startswith("#"))
        return next(lines, "").lower()


@dataclass(frozen=True, slots=True)
class PointRasters:
    """The rasters to which tie points belong that are to be written."""

    reference: RasterInfo
    target: RasterInfo
    target_on_map: bool
    """Whether a program shows the target in map coordinates."""
    final_path: Path
    """Where the file will lie in the end, to which paths in it are relative."""


@dataclass(frozen=True, slots=True)
class TiePointFormat:
    """A format of files of tie points.

    Other packages add formats by entry points of the group ``pcwlad_geo.formats``. A format without `write`
    is only read. One with it is written by each job, unless the pair is refused.
    """

    name: str
    """Short name, the kind of the output."""
    recognises: Callable[[PointSource], bool]
    """Tells, by its content, whether a file has this format."""
    read: Callable[[PointSource], PointFile]
    """Reads a file; raises `InputError`, which says what to do, if a cell cannot be used."""
    file_name: str = ""
    """Name of the written file, such as ``{stem}.pts``: {stem} is that of the target."""
    description: str = ""
    """What the written file is for."""
    write: Callable[[TiePointTable, Path, PointRasters], None] | None = None
    """Writes a table to a path."""
    needs_heights: bool = False
    """Whether it is written only of a target with RPCs, whose `grid` knows the height of the ground."""

    def __post_init__(self) -> None:
        name = self.file_name.format(name="a.tif", stem="a")
        if self.write is not None and (not name or Path(name).name != name):
            raise ValueError(f"file_name = {self.file_name!r} is no name of a file, such as '{{stem}}.pts'")
