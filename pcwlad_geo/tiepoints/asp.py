"""The `.gcp` files of the Ames Stereo Pipeline: points on the ground, each with its pixels in images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.raster import WGS84, RpcGrid, file_name, transform_xy
from pcwlad_geo.text import write_lines
from pcwlad_geo.tiepoints.cells import number_in
from pcwlad_geo.tiepoints.format import PointFile, PointRasters, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import TiePointTable


@dataclass(frozen=True, slots=True)
class AspParameters:
    """What the file holds beside the points."""

    ground_sigma_m: float = 1.0
    """Standard deviation along each axis on the ground, m: that of the reference is not known, and ASP's own
    gcp_gen writes this."""
    origin_px: float = 0.5
    """What ASP calls 0: the middle of the first pixel."""
    ground_cells: int = 7
    """Number, latitude, longitude, height and three standard deviations."""
    image_cells: int = 5
    """Name of an image, column, row and their standard deviations."""


ASP_FILE: Final = AspParameters()
"""As files are written."""


def _write(table: TiePointTable, path: Path, rasters: PointRasters) -> None:
    """Write the points on ground of known height; rejected ones are left out."""
    grid, points = rasters.target.grid, table[table.status != "rejected"].placed
    if not isinstance(grid, RpcGrid):
        raise TypeError("the heights of the points are not known")
    lon_lat = transform_xy(points.xy, points.crs, WGS84)
    heights_m = grid.heights.at(lon_lat)
    name = "_".join(file_name(rasters.target.uri).split())  # blanks part the cells
    ground = " ".join([f"{ASP_FILE.ground_sigma_m:g}"] * 3)
    lines = ["# latitude, longitude (WGS 84), height above the ellipsoid (m)"]
    for number in np.flatnonzero(np.isfinite(heights_m)):
        (lon, lat), (col, row) = lon_lat[number], points.target_px[number] - ASP_FILE.origin_px
        place = f"{len(lines)} {lat:.9f} {lon:.9f} {heights_m[number]:.3f} {ground}"
        sigma_col, sigma_row = points.sigma_px[number]
        lines.append(f"{place} {name} {col:.6f} {row:.6f} {sigma_col:.6f} {sigma_row:.6f}")
    write_lines(path, lines)


def _read(source: PointSource) -> PointFile:
    """Read the points that are seen in the target, or in the only image of the file."""
    points = list(_seen(source.path, source.lines or ()))
    names = {image for _, image, _ in points}
    image_name = "_".join(file_name(source.target_name).split())
    if len(names) > 1 and image_name not in names:
        raise InputError(
            f"{source.path} has points of {', '.join(sorted(names)[:5])}, and none of {image_name}: name the "
            "target as the file does"
        )
    ours = [(ground, pixel) for ground, image, pixel in points if image == image_name or len(names) == 1]
    lon_lat = np.array([ground for ground, _ in ours], dtype=np.float64).reshape(-1, 2)
    pixels = np.array([pixel for _, pixel in ours], dtype=np.float64).reshape(-1, 4)
    enabled = np.ones(len(ours), bool)
    target_px = pixels[:, :2] + ASP_FILE.origin_px
    return PointFile(lon_lat, target_px, enabled, "map", "px", WGS84, sigma_px=pixels[:, 2:])


def _seen(path: str, lines: Sequence[str]) -> Iterator[tuple[list[float], str, list[float]]]:
    """Yield longitude and latitude, the image, and pixel and sigma, of each point in each image."""
    check_count(path, len(lines), 2 * LIMITS.points, "lines")  # including comments
    first, step = ASP_FILE.ground_cells, ASP_FILE.image_cells
    for number, line in enumerate(lines, start=1):
        cells = line.replace(",", " ").split()
        if not cells or cells[0].startswith("#"):
            continue
        if len(cells) < first + step or (len(cells) - first) % step:
            raise InputError(
                f"{path}, line {number} has {len(cells)} cells, not {first} of a point and {step} of each "
                "image"
            )
        ground = [number_in(path, number, "a coordinate", cell) for cell in (cells[2], cells[1])]
        for start in range(first, len(cells), step):
            values = cells[start + 1 : start + step]
            pixel = [number_in(path, number, "a pixel or its sigma", cell) for cell in values]
            if min(pixel[2:]) <= 0:
                raise InputError(f"{path}, line {number}: a standard deviation is not above 0")
            yield ground, file_name(cells[start]), pixel


def _recognises(source: PointSource) -> bool:
    cells = source.first_line.replace(",", " ").split()
    first = ASP_FILE.ground_cells
    return len(cells) > first and all(map(_is_number, cells[:first])) and not _is_number(cells[first])


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


ASP: Final = TiePointFormat(
    "asp",
    _recognises,
    _read,
    "{stem}.gcp",
    "GCPs with heights for ASP's `bundle_adjust`",
    _write,
    needs_heights=True,
)
"""The format of the Ames Stereo Pipeline."""
