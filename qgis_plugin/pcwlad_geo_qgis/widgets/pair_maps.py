"""The maps of a pair: places of the reference on that of the target, and the other way round."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Union

from qgis import core, gui

from ..process.points import Points
from ..text import tr

Pair = Sequence[core.QgsRasterLayer]
"""The reference and the target."""
Shape = Union[core.QgsPointXY, core.QgsRectangle]


def map_crs(layer: core.QgsRasterLayer) -> core.QgsCoordinateReferenceSystem:
    """Return a CRS for a map of a layer alone: its own, or one in which a layer without is drawn as it is.

    QGIS may crash in a map whose own CRS is invalid.
    """
    return layer.crs() if layer.crs().isValid() else core.QgsCoordinateReferenceSystem("EPSG:3857")


class PairMaps:
    """Where the reference, the target and the main map (`map`) show a place.

    A target without a place of its own, or far from it, is shown in its own frame: the points place it.
    """

    def __init__(self, points: Points, pair: Pair, canvas: gui.QgsMapCanvas) -> None:
        self._points, self._canvas = points, canvas
        self._reference, self._target = pair
        self.own_frame = self._is_elsewhere()

    def _is_elsewhere(self) -> bool:
        if not self._points.points or self._target.crs().isValid() != self._reference.crs().isValid():
            return True
        first, extent = self._points.points[0], self._target.extent()
        with suppress(core.QgsCsException):
            moved = self._transformed(core.QgsPointXY(first.x, first.y), "reference", "target")
            return moved.distance(self.target_place(0)) > math.hypot(extent.width(), extent.height()) / 2
        return True

    def target_place(self, row: int) -> core.QgsPointXY:
        """Return where the target shows a point, as the Georeferencer has it: on its map or (col, -row)."""
        return self._place_of(*self._points.points[row].target_px)

    def _place_of(self, col: float, line: float) -> core.QgsPointXY:
        extent, target = self._target.extent(), self._target
        x = extent.xMinimum() + col * target.rasterUnitsPerPixelX()
        return core.QgsPointXY(x, extent.yMaximum() - line * target.rasterUnitsPerPixelY())

    def target_px(self, place: core.QgsPointXY) -> tuple[float, float]:
        """Return the pixel (col, row) of the target at a place on its map."""
        extent, target = self._target.extent(), self._target
        col = (place.x() - extent.xMinimum()) / target.rasterUnitsPerPixelX()
        return col, (extent.yMaximum() - place.y()) / target.rasterUnitsPerPixelY()

    def crs(self, which: str) -> core.QgsCoordinateReferenceSystem:
        """Return the CRS of the reference, the target, or what the main map shows (`map`)."""
        layers = {"reference": self._reference, "target": self._target}
        return layers[which].crs() if which in layers else self._canvas.mapSettings().destinationCrs()

    def moved(self, shape: Shape, come: str, go: str) -> Shape:
        """Return a point or a box of one map on another; `QgsCsException` is raised where it is not there."""
        if not self.own_frame or come == go or "target" not in (come, go):
            return self._transformed(shape, come, go)
        if come == "target":
            return self._transformed(self._by_points(shape, True), "reference", go)
        return self._by_points(self._transformed(shape, come, "reference"), False)

    def _by_points(self, shape: Shape, to_map: bool) -> Shape:
        """Return a shape of the target on the reference, or back, as the points that are on say."""
        placement = self._points.placement()
        if placement is None:
            raise core.QgsCsException(tr("Too few tie points place the layer."))
        from_map = placement.inverse()

        def move(x: float, y: float) -> core.QgsPointXY:
            if to_map:
                return core.QgsPointXY(*placement(*self.target_px(core.QgsPointXY(x, y))))
            return self._place_of(*from_map(x, y))

        if isinstance(shape, core.QgsPointXY):
            return move(shape.x(), shape.y())
        xs, ys = (shape.xMinimum(), shape.xMaximum()), (shape.yMinimum(), shape.yMaximum())
        corners = [move(x, y) for x in xs for y in ys]
        return core.QgsGeometry.fromMultiPointXY(corners).boundingBox()

    def _transformed(self, shape: Shape, come: str, go: str) -> Shape:
        if come == go or not (self.crs(come).isValid() and self.crs(go).isValid()):
            return shape
        transform = core.QgsCoordinateTransform(self.crs(come), self.crs(go), core.QgsProject.instance())
        box = isinstance(shape, core.QgsRectangle)
        return transform.transformBoundingBox(shape) if box else transform.transform(shape)

    def unit(self, which: str) -> float:
        """Return the larger pixel of the two rasters, in units of the reference or of the target."""
        target, reference = (each.rasterUnitsPerPixelX() for each in (self._target, self._reference))
        placement = self._points.placement() if self.own_frame else None
        if placement is None:
            return max(target, reference)
        scale = math.sqrt(abs(placement.determinant))
        return max(reference, scale) * (1.0 if which == "reference" else target / scale)
