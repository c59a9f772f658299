"""Motion of the ground: what the tie points of a stack tell beside the corrections of its images."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from affine import Affine
from scipy import ndimage

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.velocities import VELOCITY, Motions, displacements, velocities
from pcwlad_geo.events import EventCallback, Progress
from pcwlad_geo.multi.stack.finished import RasterInfoOrError, ReadStack, frame_again
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.pairs import PAIRS
from pcwlad_geo.multi.watch.dated_images import DatedImage
from pcwlad_geo.raster import middle_pixel_size_m
from pcwlad_geo.tiepoints.readers import read_point_file
from pcwlad_geo.types import Bool, Float64, Index

PACKED_LARGEST: Final = 32767
"""Largest whole number of 16 bits."""


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """The tuned numbers of the motion of the ground."""

    min_span_years: float = 0.1
    """Least time between the first and the last date."""
    min_cell_px: float = 16.0
    """Least side of a cell, px of the frame."""
    cells: int = 48
    """Largest number of cells along the longer side of the frame."""
    max_packed: int = 120_000
    """Largest number of displacements of cells that the page holds, six bytes each."""


MOTION: Final = MotionParameters()
"""The numbers in use."""


@dataclass(frozen=True, slots=True)
class MovingRegion:
    """A part of the ground that moves by itself."""

    number: int
    """In motion.tif; 1 is the largest."""
    x: float
    """Its middle, CRS of the frame; px without one."""
    y: float
    share: float
    """Of the cells that could be tested."""
    velocity_px: tuple[float, float]
    """(col, row) of the cells that it fills, px of the frame a year."""
    sigma_px: float
    """Mean standard deviation of its cells along an axis."""


@dataclass(frozen=True, slots=True)
class GroundMotion:
    """Motion of the ground that is none of the images."""

    cell_px: float
    """Side of a cell, px of the frame."""
    tested: int
    """Number of cells with enough images."""
    sigma_px: float
    """Median standard deviation of their velocities along an axis, px of the frame a year."""
    regions: tuple[MovingRegion, ...]
    """The largest first."""
    px_m: float | None
    """Side of a pixel of the frame, metres; null without a CRS."""


@dataclass(frozen=True, slots=True, eq=False)
class _CellSeries:
    """What some cells do from date to date."""

    cells: Index
    """(n,) their numbers, along rows first."""
    days: tuple[str, ...]
    """Of the images, ISO 8601."""
    moved_px: Float64
    """(n, images, 2) about the mean of their dates, px of the frame; NaN where unknown."""
    sigma_px: Float64
    """(n, images) standard deviation along an axis."""

    def packed(self) -> dict[str, object]:
        """Return it for the script of the page: 16 bits a number, in steps of `unit_px`."""
        largest = np.nanmax(np.abs([np.nanmax(np.abs(self.moved_px)), np.nanmax(self.sigma_px)]))
        unit_px = max(float(largest), 1e-3) / PACKED_LARGEST
        values = np.concatenate([self.moved_px, self.sigma_px[..., None]], axis=2) / unit_px
        whole = np.where(np.isfinite(values), np.round(values), -PACKED_LARGEST - 1).astype("<i2")
        text = base64.b64encode(whole.tobytes()).decode("ascii")
        return {"cells": self.cells.tolist(), "days": self.days, "unit_px": unit_px, "values": text}


@dataclass(frozen=True, slots=True, eq=False)
class MotionRaster:
    """Cells of the frame, and what they do a year."""

    frame: StackFrame
    cell_px: float
    velocity_px: Float64
    """(rows, cols, 2)."""
    sigma_px: Float64
    """(rows, cols)."""
    moving: Index
    """(rows, cols) number of the region that a cell is in, from 1; 0: it stands still."""
    series: _CellSeries | None


def moving_ground(
    stack: ReadStack,
    folder: Path,
    dated: Sequence[DatedImage],
    infos: Sequence[RasterInfoOrError],
    on_event: EventCallback,
    parameters: MotionParameters = MOTION,
) -> tuple[GroundMotion, MotionRaster]:
    """Return what the tie points of all pairs tell beside the corrections of their images.

    Raises `InputError` if too few dates tell, an image or a pair cannot be read, or the images have RPCs.
    """
    span = dated[-1].year - dated[0].year
    if len(dated) < VELOCITY.min_images or span < parameters.min_span_years:
        raise InputError(
            f"{len(dated)} dates in {span:.2f} years are too few: {VELOCITY.min_images} are needed"
        )
    frame = frame_again(stack, infos)
    corrections = [from_dict(image.model) for image in stack.images]
    years = {image.source.name: (image.number, image.year) for image in dated}
    rows, cols = frame.grid.shape
    cell_px = max(parameters.min_cell_px, max(rows, cols) / parameters.cells)
    shape = int(np.ceil(rows / cell_px)), int(np.ceil(cols / cell_px))
    parts = []
    pairs = [pair for pair in stack.pairs if pair.status == "used"]
    for number, pair in enumerate(pairs):
        on_event(Progress("reading", number, len(pairs)))
        ends = years.get(pair.reference), years.get(pair.target)
        if ends[0] is not None and ends[1] is not None and ends[0][1] != ends[1][1]:
            place = folder / PAIRS / f"{pair.reference}__{pair.target}" / "tiepoints.csv"
            parts.append(_motions_of(place, frame, corrections, (ends[0], ends[1]), cell_px, shape))
    on_event(Progress("reading", len(pairs), len(pairs)))
    if not parts:
        raise InputError("no pair of images of two dates has been used")
    every = Motions(*(np.concatenate([getattr(part, name) for part in parts]) for name in Motions.__slots__))
    solution = velocities(every, shape[0] * shape[1], len(infos))
    moving = solution.moving.reshape(shape)
    labels, count = ndimage.label(moving, np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    renumbered = np.zeros(count + 1, int)
    renumbered[1 + np.argsort(-sizes, kind="stable")] = np.arange(1, count + 1)
    regions = renumbered[labels]
    velocity_px, sigma_px = solution.velocity_px.reshape(*shape, 2), solution.sigma_px.reshape(shape)
    series = _cell_series(
        every, _shown(np.isfinite(sigma_px), regions, len(dated), parameters.max_packed), frame, dated
    )
    raster = MotionRaster(frame, cell_px, velocity_px, sigma_px, regions, series)
    return _ground_motion(raster, count), raster


def _shown(testable: Bool, regions: Index, dates: int, max_packed: int) -> Index:
    """Return the numbers of the cells whose series the page holds.

    Those that move come first, and of the others so many along each axis that all fit.
    """
    most = max(1, max_packed // dates)
    cells = np.flatnonzero(testable)
    for spacing in range(1, max(testable.shape) + 1):
        lattice = np.zeros(testable.shape, bool)
        lattice[spacing // 2 :: spacing, spacing // 2 :: spacing] = True
        for selection in (lattice | (regions > 0), lattice):
            cells = np.flatnonzero(testable & selection)
            if len(cells) <= most:
                return cells
    return cells[:most]


def _cell_series(
    motions: Motions, cells: Index, frame: StackFrame, dated: Sequence[DatedImage]
) -> _CellSeries | None:
    """Return what cells do from date to date; None without cells."""
    if not len(cells):
        return None
    place = np.full(len(frame.names), -1)
    place[[image.number for image in dated]] = np.arange(len(dated))
    own_px = np.array([frame.pixel(image.number) * image.sigma_px for image in dated])
    order = np.argsort(motions.cell, kind="stable")
    bounds = np.searchsorted(motions.cell[order], np.stack([cells, cells + 1]))
    displacements_px, sigmas = [], []
    for first, last in bounds.T:
        part = order[first:last]
        cell_motions = Motions(*(getattr(motions, name)[part] for name in Motions.__slots__))
        moved_px, sigma_px = displacements(replace(cell_motions, ends=place[cell_motions.ends]), len(dated))
        displacements_px.append(moved_px)
        sigmas.append(np.hypot(sigma_px, own_px))
    days = tuple(str(image.source.day) for image in dated)
    return _CellSeries(cells, days, np.array(displacements_px), np.array(sigmas))


def _motions_of(
    place: Path,
    frame: StackFrame,
    corrections: Sequence[Correction],
    ends: tuple[tuple[int, float], tuple[int, float]],
    cell_px: float,
    shape: tuple[int, int],
) -> Motions:
    """Return the tie points of a pair, px of the frame, less what the corrections of both images say."""
    (first, before), (second, after) = ends
    points = read_point_file(place)
    sigma_px = np.full((len(points.enabled), 2), np.nan) if points.sigma_px is None else points.sigma_px
    good = points.enabled & (sigma_px > 0).all(axis=1)
    at = frame.from_image(first, corrections[first].inverse(points.reference[good]))
    displacement = frame.from_image(second, corrections[second].inverse(points.target[good])) - at
    scale = np.abs(np.linalg.det(frame.scale(second, points.target[good]))) ** 0.5
    sigma = np.sqrt((sigma_px[good] ** 2).mean(axis=1)) * scale
    col, row = np.floor(at / cell_px).astype(np.intp).T
    inside = (
        (col >= 0) & (row >= 0) & (col < shape[1]) & (row < shape[0]) & np.isfinite(displacement).all(axis=1)
    )
    count = int(inside.sum())
    return Motions(
        (row * shape[1] + col)[inside],
        np.tile(np.array([first, second]), (count, 1)),
        np.full(count, after - before),
        displacement[inside],
        sigma[inside],
    )


def _ground_motion(raster: MotionRaster, count: int) -> GroundMotion:
    testable = np.isfinite(raster.sigma_px)
    tested = int(testable.sum())
    regions = []
    for number in range(1, count + 1):
        inside = raster.moving == number
        row, col = (float(np.mean(indices)) + 0.5 for indices in np.nonzero(inside))
        middle = np.array([[col, row]]) * raster.cell_px
        x, y = (raster.frame.grid.to_xy(middle) if raster.frame.georeferenced else middle)[0].tolist()
        velocity = float_pair(region_velocity(raster.velocity_px[inside]))
        sigma = float(raster.sigma_px[inside].mean())
        regions.append(MovingRegion(number, x, y, float(inside.sum()) / tested, velocity, sigma))
    sizes_m = middle_pixel_size_m(raster.frame.grid)
    return GroundMotion(
        cell_px=raster.cell_px,
        tested=tested,
        sigma_px=float(np.median(raster.sigma_px[testable])) if tested else 0.0,
        regions=tuple(regions),
        px_m=None if sizes_m is None else float(np.sqrt(np.prod(sizes_m))),
    )


def region_velocity(velocity_px: Float64) -> Float64:
    """Return the (2,) velocity of a region from the (n, 2) `velocity_px` of its cells.

    Cells at its border move in part: of many dates these are found, too. The median counts of those that move
    more than half as fast, along the mean direction, as the fastest tenth.
    """
    along = velocity_px @ velocity_px.mean(axis=0)
    whole = along > np.percentile(along, 90) / 2
    return np.median(velocity_px[whole if whole.any() else slice(None)], axis=0)


def page_data(raster: MotionRaster, box: tuple[float, float, float, float]) -> dict[str, object] | None:
    """Return what the script of the page shows of single cells; None where no cell is known."""
    if raster.series is None:
        return None
    row, col = np.divmod(raster.series.cells, raster.moving.shape[1])
    middles_px = (np.column_stack([col, row]) + 0.5) * raster.cell_px
    at = raster.frame.grid.to_xy(middles_px) if raster.frame.georeferenced else middles_px
    velocity = np.column_stack([raster.velocity_px[row, col], raster.sigma_px[row, col]])
    return {
        **raster.series.packed(),
        "box": box,
        "cols": raster.moving.shape[1],
        "across": [raster.frame.grid.shape[1] / raster.cell_px, raster.frame.grid.shape[0] / raster.cell_px],
        "at": np.round(at, 6 if np.abs(at).max() < 1000 else 1).tolist(),
        "velocity": np.round(velocity, 4).tolist(),
        "region": raster.moving[row, col].tolist(),
    }


def write_motion(raster: MotionRaster, place: Path) -> None:
    """Write velocity x, y and sigma, units of the CRS a year (px without one), and the numbers of regions."""
    grid, (rows, cols) = raster.frame.grid, raster.sigma_px.shape
    linear, georeferencing = np.eye(2), {}
    if raster.frame.georeferenced:
        a, b, x, d, e, y = grid.transform[:6]
        linear = np.array([[a, b], [d, e]])
        (ca, cb), (cd, ce) = (linear * raster.cell_px).tolist()
        georeferencing = {"crs": grid.crs, "transform": Affine(ca, cb, x, cd, ce, y)}
    velocity = raster.velocity_px @ linear.T
    sigma = raster.sigma_px * float(np.sqrt(abs(np.linalg.det(linear))))
    moving = np.where(np.isfinite(raster.sigma_px), raster.moving, np.nan)
    bands = [velocity[..., 0], velocity[..., 1], sigma, moving]
    names = ("velocity x, a year", "velocity y, a year", "sigma along an axis, a year", "moving region")
    with rasterio.open(
        place,
        "w",
        driver="GTiff",
        count=4,
        height=rows,
        width=cols,
        dtype="float32",
        nodata=np.nan,
        **georeferencing,
    ) as file:
        for number, (band, name) in enumerate(zip(bands, names, strict=True), 1):
            file.write(np.asarray(band, np.float32), number)
            file.set_band_description(number, name)
