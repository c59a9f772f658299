"""Results as layers of the project: with the target's own style and name, in a group of their own."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, Callable

from qgis import core

from ..process.points import Points
from ..text import tr
from .tie_points import COLOURS, add_vectors, open_tie_points, renderer_of, symbol_of, translate_legend

CHANGING = ("status", "residual_col", "residual_row")
"""Columns of tie points that change while they are edited."""


def add_group(name: str, anew: bool = True) -> core.QgsLayerTreeGroup:
    """Add a group at the top of the layer tree, with a number where its name is used, or take that one."""
    root = core.QgsProject.instance().layerTreeRoot()
    found = root.findGroup(name)
    return found if found and not anew else root.insertGroup(0, unused(name, " ", root.findGroup))


def unused(name: str, separator: str, used: Callable[[str], object]) -> str:
    """Return a name that is not used, with the least number at its end that it needs."""
    names = (name if number == 1 else f"{name}{separator}{number}" for number in itertools.count(1))
    return next(each for each in names if not used(each))


def add_raster(path: str, target: core.QgsMapLayer, group: core.QgsLayerTreeGroup) -> core.QgsMapLayer:
    """Add a corrected raster, or vectors, with the style and name of what was corrected."""
    made = core.QgsVectorLayer if isinstance(target, core.QgsVectorLayer) else core.QgsRasterLayer
    layer = made(path, target.name(), target.providerType())
    own_alpha = layer.renderer().alphaBand() if made is core.QgsRasterLayer else -1
    style = core.QgsMapLayerStyle()
    style.readFromLayer(target)
    style.writeToLayer(layer)
    if own_alpha > 0:  # the target has no such band, and its style would show what is empty in black
        layer.renderer().setAlphaBand(own_alpha)
    layer.setName(target.name())
    core.QgsProject.instance().addMapLayer(layer, False)
    group.insertLayer(0 if made is core.QgsVectorLayer else -1, layer)
    return layer


def show_results(
    raster: str, geopackage: str, target: core.QgsRasterLayer, name: str
) -> tuple[dict[str, core.QgsMapLayer], str]:
    """Show a registration in a group, and return its layers by what they are, and the name of the group.

    What the project shows of it already stays, read anew. Earlier groups of the name are switched off.
    """
    root = core.QgsProject.instance().layerTreeRoot()
    known = {each.source(): each for each in core.QgsProject.instance().mapLayers().values()}
    node = root.findLayer(known[raster].id()) if raster in known else None
    group = node.parent() if node is not None and node.parent() != root else None
    if group is None:
        for earlier in root.findGroups():
            if earlier.name().rstrip("0123456789").rstrip() == name:
                earlier.setItemVisibilityChecked(False)
                earlier.setExpanded(False)
        group = add_group(name)
        layers = {"after": add_raster(raster, target, group)}
    else:
        layers = {"after": known[raster]}
        known[raster].reload()
    for role, title in (("tie_points", tr("Tie points")), ("displacements", tr("Displacement"))):
        source = f"{geopackage}|layername={role}"
        layers[role] = known.get(source) or _add_points(source, title, role == "tie_points", group)
    for unfolded in (False, True):  # the view takes no heed of it before there are layers in the group
        group.setExpanded(unfolded)
    return layers, group.name()


def _add_points(source: str, title: str, points: bool, group: core.QgsLayerTreeGroup) -> core.QgsVectorLayer:
    """Add tie points, as “Register raster” shows them, or displacements, which are hidden at first."""
    layer = core.QgsVectorLayer(source, title)
    if points:
        add_vectors(layer)
        layer.setRenderer(renderer_of(layer))
    else:
        translate_legend(layer)
    core.QgsProject.instance().addMapLayer(layer, False)
    node = group.insertLayer(0, layer)
    node.setItemVisibilityChecked(points)
    node.setExpanded(False)  # a long legend would push the raster out of sight
    return layer


class PointLayer:
    """A layer of the points that are being edited: colours say which are on, arrows what is left."""

    def __init__(self, points: Points, geopackage: Path) -> None:
        self._points = points
        title = tr("Tie points being edited")
        self.layer = open_tie_points(str(geopackage), title).materialize(core.QgsFeatureRequest())
        self.layer.setName(title)
        self.layer.setFlags(self.layer.flags() | core.QgsMapLayer.LayerFlag.Private)
        self.layer.setCustomProperty("skipMemoryLayersCheck", 1)  # nothing is lost with it
        self._columns = [self.layer.fields().indexOf(name) for name in CHANGING]
        self._ids = sorted(self.layer.allFeatureIds())
        add_vectors(self.layer)
        self.factor: float | None = None
        self.refresh()

    def refresh(self, arrows: bool = True) -> None:
        """Show the points as they are now; the length of arrows is chosen anew where asked for."""
        provider, points = self.layer.dataProvider(), self._points.points
        for point in points[len(self._ids) :]:
            feature = core.QgsFeature(provider.fields())  # without those that are computed
            feature.setGeometry(core.QgsGeometry.fromPointXY(core.QgsPointXY(point.x, point.y)))
            self._ids.append(provider.addFeatures([feature])[1][0].id())
        changed = {key: dict(zip(self._columns, self._values(row))) for row, key in enumerate(self._ids)}
        provider.changeAttributeValues(changed)
        if arrows:
            self.layer.setRenderer(renderer_of(self.layer, self.factor))
        self.layer.updateExtents()
        self.layer.triggerRepaint()

    def index_of(self, feature_id: int) -> int:
        """Return the point that a feature shows."""
        return self._ids.index(feature_id)

    def _values(self, row: int) -> list[object]:
        """Return status and residual of a point: observed minus model, as in all our layers."""
        residual = [core.NULL if math.isnan(part) else -part for part in self._points.points[row].residual_px]
        return [self._points.status(row), *residual]


class FrameLayer:
    """A layer of the points where the target shows them, in its own frame: it has no place on the map."""

    def __init__(self, points: Points, target: core.QgsRasterLayer, place: Callable[[int], Any]) -> None:
        self._points, self._place = points, place
        self.layer = core.QgsVectorLayer("Point?field=row:integer&field=status:string", "target", "memory")
        self.layer.setCrs(target.crs())
        categories = [core.QgsRendererCategory(each, symbol_of(COLOURS[each]), each) for each in COLOURS]
        self.layer.setRenderer(core.QgsCategorizedSymbolRenderer("status", categories))
        self.refresh()

    def refresh(self) -> None:
        """Show the points as they are now."""
        shown = []
        for row in range(len(self._points.points)):
            feature = core.QgsFeature(self.layer.fields())
            feature.setGeometry(core.QgsGeometry.fromPointXY(self._place(row)))
            feature.setAttributes([row, self._points.status(row)])
            shown.append(feature)
        self.layer.dataProvider().truncate()
        self.layer.dataProvider().addFeatures(shown)
        self.layer.updateExtents()
        self.layer.triggerRepaint()

    def index_of(self, feature_id: int) -> int:
        """Return the point that a feature shows."""
        return self.layer.getFeature(feature_id)["row"]
