"""Results as layers of the project: with the target's own style and name, in a group of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence

from qgis import core

from ..process.points import Points
from ..text import tr
from .tie_points import pixel_to_map, renderer_of

MOST_ARROWS = 2500
FIELDS = ("tgt_col", "tgt_row", "x", "y", "residual_x", "residual_y", "displacement_x", "displacement_y")


def add_group(name: str) -> core.QgsLayerTreeGroup:
    """Add a group at the top of the layer tree."""
    return core.QgsProject.instance().layerTreeRoot().insertGroup(0, name)


def add_raster(path: str, target: core.QgsRasterLayer, group: core.QgsLayerTreeGroup) -> core.QgsRasterLayer:
    """Add a corrected raster with the style and name of its target."""
    layer = core.QgsRasterLayer(path, target.name(), "gdal")
    style = core.QgsMapLayerStyle()
    style.readFromLayer(target)
    style.writeToLayer(layer)
    layer.setName(target.name())
    core.QgsProject.instance().addMapLayer(layer, False)
    group.addLayer(layer)
    return layer


class PointLayer:
    """A layer of the points that are being edited: colours say which are on, arrows what is left."""

    def __init__(self, points: Points, crs: core.QgsCoordinateReferenceSystem) -> None:
        self._points = points
        self.layer = _memory_layer(tr("Tie points"), FIELDS, crs)
        self._ids: list[int] = []
        self.factor: float | None = None
        self.refresh()

    def refresh(self, arrows: bool = True) -> None:
        """Show the points as they are now; the length of arrows is chosen anew where asked for."""
        provider, points = self.layer.dataProvider(), self._points.points
        for index in range(len(self._ids), len(points)):
            feature = core.QgsFeature(self.layer.fields())
            feature.setGeometry(
                core.QgsGeometry.fromPointXY(core.QgsPointXY(points[index].x, points[index].y))
            )
            feature.setAttributes(self._attributes(index, None))
            self._ids.append(provider.addFeatures([feature])[1][0].id())
        matrix = pixel_to_map(
            {
                "tgt_col": each.target_px[0],
                "tgt_row": each.target_px[1],
                "x": each.x,
                "y": each.y,
                "status": self._points.status(index),
            }
            for index, each in enumerate(points)
        )
        provider.changeAttributeValues(
            {
                self._ids[index]: dict(enumerate(self._attributes(index, matrix)))
                for index in range(len(points))
            }
        )
        if arrows:
            self.layer.setRenderer(renderer_of(self.layer, self.factor))
        self.layer.updateExtents()
        self.layer.triggerRepaint()

    def index_of(self, feature_id: int) -> int:
        """Return the point that a feature shows."""
        return self._ids.index(feature_id)

    def _attributes(self, index: int, matrix: tuple[float, float, float, float] | None) -> list[object]:
        point = self._points.points[index]
        vector: list[object] = [core.NULL, core.NULL]
        if matrix is not None and not math.isnan(point.length_px):
            col, row = (-part for part in point.residual_px)  # observed minus model, as in all our layers
            vector = [matrix[0] * col + matrix[1] * row, matrix[2] * col + matrix[3] * row]
        place = [*point.target_px, point.x, point.y]
        return [self._points.status(index), *place, *vector, core.NULL, core.NULL]


def _memory_layer(
    title: str, numbers: Sequence[str], crs: core.QgsCoordinateReferenceSystem
) -> core.QgsVectorLayer:
    fields = "&".join(["field=status:string", *(f"field={name}:double" for name in numbers)])
    layer = core.QgsVectorLayer(f"Point?{fields}", title, "memory")
    layer.setCrs(crs)
    return layer


def displacement_layer(path: str, factor: float | None = None) -> core.QgsVectorLayer:
    """Return arrows of a displacement field in metres, sampled so that they can be told apart."""
    raster = core.QgsRasterLayer(path, "field", "gdal")
    provider = raster.dataProvider()
    extent, shape = raster.extent(), (provider.xSize(), provider.ySize())
    step = max(1, math.ceil(math.sqrt(shape[0] * shape[1] / MOST_ARROWS)))
    size = (max(1, shape[0] // step), max(1, shape[1] // step))
    blocks = [provider.block(band, extent, *size) for band in (1, 2)]
    layer = _memory_layer(tr("Displacement"), FIELDS[4:], raster.crs())
    features = []
    for row in range(size[1]):
        for col in range(size[0]):
            values = [block.value(row, col) for block in blocks]
            if any(block.isNoData(row, col) for block in blocks) or not all(map(math.isfinite, values)):
                continue
            x = extent.xMinimum() + (col + 0.5) * extent.width() / size[0]
            y = extent.yMaximum() - (row + 0.5) * extent.height() / size[1]
            feature = core.QgsFeature(layer.fields())
            feature.setGeometry(core.QgsGeometry.fromPointXY(core.QgsPointXY(x, y)))
            feature.setAttributes(["matched", core.NULL, core.NULL, *values])
            features.append(feature)
    layer.dataProvider().addFeatures(features)
    layer.updateExtents()
    layer.setRenderer(renderer_of(layer, factor))
    return layer
