"""The images of a stack, and the grid in whose pixels all are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.multi.stack.inputs import StackInput, check_reference
from pcwlad_geo.raster import Grid, GridRequest, RasterInfo, jacobian, map_px, output_grids
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True, eq=False)
class StackFrame:
    """The images, and the grid in whose pixels all are compared."""

    names: list[str]
    infos: list[RasterInfo]
    grid: Grid
    georeferenced: bool
    """Whether all images are georeferenced; otherwise their pixels are compared."""
    inputs: tuple[StackInput, ...] = ()
    """The images as the user gave them; empty: the files of `infos`."""
    reference: int = 0
    """Number of the image whose grid it is."""

    def given(self, image: int) -> StackInput:
        """Return an image as the user gave it."""
        info = self.infos[image]
        return self.inputs[image] if self.inputs else StackInput(info.uri, info.band, self.names[image])

    def from_image(self, image: int, px: Float64) -> Float64:
        """Map the (n, 2) `px` of an image to px of the frame by its georeferencing."""
        return map_px(px, self.infos[image].grid, self.grid) if self.georeferenced else px

    def to_image(self, image: int, px: Float64) -> Float64:
        """Map the (n, 2) `px` of the frame to px of an image."""
        return map_px(px, self.grid, self.infos[image].grid) if self.georeferenced else px

    def scale(self, image: int, px: Float64) -> Float64:
        """Return the (n, 2, 2) Jacobian of `from_image` at the (n, 2) `px` of an image."""
        if not self.georeferenced:
            return np.broadcast_to(np.eye(2), (len(px), 2, 2))
        own_grid = self.infos[image].grid
        return jacobian(own_grid.within_scans(px), own_grid, self.grid)

    def outline(self, image: int) -> shapely.Geometry:
        """Return the ground that an image shows by its georeferencing, a polygon in px of the frame."""
        outline_px = self.from_image(image, self.infos[image].grid.boundary_px())
        if self.infos[image].grid.swath_uri:  # the ends of its scans overlap, and some pixels have no place
            return shapely.MultiPoint(outline_px[np.isfinite(outline_px).all(axis=1)]).convex_hull
        return shapely.Polygon(outline_px)

    def directed(self, pair: tuple[int, int]) -> tuple[int, int]:
        """Return a pair with the image first that can be the reference: one on a map before a swath."""
        one, other = pair
        swaths = [self.infos[image].grid.swath_uri is not None for image in pair]
        return (other, one) if swaths == [True, False] else (one, other)

    def pixel(self, image: int) -> float:
        """Return the side of a pixel in the middle of an image, px of the frame."""
        return math.sqrt(abs(np.linalg.det(self.scale(image, self.infos[image].grid.middle_px)[0])))


def frame_of(
    inputs: Sequence[StackInput], infos: list[RasterInfo], reference: str | None, model: str
) -> StackFrame:
    """Return the frame of images: the grid of the reference, a name, or of the first on a map.

    A swath has no grid that others could lie on: as the reference it has one of longitudes and latitudes.

    Raises `InputError` if the reference is none of them, or they are not of one kind; `SettingsError` if the
    model does not suit them.
    """
    names = [image.name for image in inputs]
    check_reference(reference, names)
    for name, info in zip(names, infos, strict=True):
        if type(info.grid) is not Grid and not info.grid.swath_uri:
            raise InputError(f"{name} has no plain geotransform: a stack takes images with one, or with none")
    lacking = [name for name, info in zip(names, infos, strict=True) if not info.georeferenced]
    if lacking and len(lacking) < len(names):
        raise InputError(
            f"{', '.join(lacking)} without georeferencing among images with it: give images of one kind"
        )
    if model == "projective" and not lacking:
        raise SettingsError(
            "model = 'projective': a homography an image is for frames without georeferencing"
        )
    on_map = [number for number, info in enumerate(infos) if not info.grid.swath_uri]
    number = next(iter(on_map), 0) if reference is None else names.index(reference)
    grid = infos[number].grid
    if grid.swath_uri:
        still = AffineCorrection("shift", np.eye(2, 3))
        (grid,) = output_grids(grid, grid, still, GridRequest("target"), [grid])
    return StackFrame(names, infos, grid, not lacking, tuple(inputs), number)
