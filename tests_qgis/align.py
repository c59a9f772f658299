"""What a user does with the dock “Align this layer…”, done by QGIS itself: ``qgis --code align.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `polygons`, and `folder` for pictures and `seen.json`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import processing
from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsPointXY,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
    QgsVectorLayer,
)
from qgis.PyQt.QtWidgets import QDockWidget, QWidget
from qgis.utils import iface, plugins
from steps import JOB, go, grab, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds to wait."""
    window = iface.mainWindow()
    window.resize(1400, 900)
    for name in ("Browser", "ProcessingToolbox"):
        window.findChild(QDockWidget, name).close()
    project = QgsProject.instance()
    project.setCrs(QgsCoordinateReferenceSystem("EPSG:32633"))
    layers = [QgsRasterLayer(JOB[name], Path(JOB[name]).stem) for name in ("reference", "target")]
    project.addMapLayers(layers)
    yield 1500
    plugin = plugins["pcwlad_geo_qgis"]
    iface.setActiveLayer(layers[1])
    seen["menu"] = plugin.action in iface.rasterMenu().actions() or any(
        plugin.action in each.menu().actions() for each in iface.rasterMenu().actions() if each.menu()
    )
    plugin.action.trigger()
    yield 800
    dock = plugin.dock
    seen["preset"] = [box.currentLayer().name() for box in (dock.target, dock.reference)]
    iface.messageBar().clearWidgets()
    window.resizeDocks(
        [dock], [430], __import__("qgis.PyQt.QtCore", fromlist=["Qt"]).Qt.Orientation.Horizontal
    )
    yield 800
    grab(window, "align")
    dialog = processing.createAlgorithmDialog("pcwlad_geo:register", {})
    dialog.show()
    yield 1000
    presets = dialog.createProcessingParameters()
    seen["dialog"] = [QgsProject.instance().mapLayer(presets[name]).name() for name in ("REFERENCE", "INPUT")]
    dialog.close()
    yield from align(dock)
    grab(window, "aligned")
    yield from edit(dock, window)
    yield from compare(dock, window)
    yield from limited(dock, layers)
    yield from cancel(dock)
    dock.close_all()


def wait(dock: Any) -> Iterator[int]:
    """Wait for the end of the work."""
    while not dock.start_button.isEnabled():
        yield 200
    yield 1500


def align(dock: Any) -> Iterator[int]:
    """Align with all defaults."""
    dock.field.setChecked(True)
    dock.start()
    yield from wait(dock)
    seen["verdict"] = dock.verdict.text()
    root = QgsProject.instance().layerTreeRoot()
    seen["groups"] = {
        group.name(): [node.name() for node in group.findLayers()]
        for group in root.children()
        if hasattr(group, "findLayers") and group.children()
    }
    after = dock.layers.get("after")
    seen["after"] = after.source() if after else ""
    seen["field"] = (
        [each.label() for each in dock.layers["field"].renderer().categories()]
        if "field" in dock.layers
        else []
    )


def edit(dock: Any, window: QWidget) -> Iterator[int]:
    """Switch points off, undo, add one, zoom; note how long a refit takes until the map is drawn."""
    editor = dock.editor
    dock.tabs.setCurrentIndex(1)
    while not editor.isEnabled():
        yield 100
    yield 3000
    seen["points"] = len(editor.points.points)
    seen["columns"] = editor.model.titles
    top = editor.sorted.mapToSource(editor.sorted.index(0, 0)).row()
    seen["sorted"] = [
        editor.points.points[editor.sorted.mapToSource(editor.sorted.index(row, 0)).row()].length_px
        for row in range(20)
    ]
    editor.table.selectRow(0)
    yield 1500
    point = editor.points.points[top]
    seen["zoomed"] = [
        iface.mapCanvas().extent().contains(QgsPointXY(point.x, point.y)),
        editor.view.extent().contains(editor.target_place(top)),
        iface.mapCanvas().extent().width(),
    ]
    grab(window, "editor")
    canvas, drawn = iface.mapCanvas(), []
    canvas.zoomToFullExtent()
    yield 2500
    canvas.mapCanvasRefreshed.connect(lambda: drawn.append(time.monotonic()))
    seen["refit_s"] = []
    rows = [row for row in range(seen["points"]) if row != top]
    for model in ("affine", "tps"):
        editor.models.setCurrentIndex(editor.models.findData(model))
        yield 2500
        for _ in range(3):
            drawn.clear()
            start, number = time.monotonic(), editor._number
            editor.switch([rows.pop()], False)
            while editor._shown_number <= number or not drawn or canvas.isDrawing():
                yield 10
            seen["refit_s"].append([model, time.monotonic() - start])
            yield 1500
    seen["rmse"] = dict(editor.points.rmse_px)
    seen["off"] = len(editor.points.off)
    editor.undo()
    yield 1500
    seen["off_after_undo"] = len(editor.points.off)
    editor.switch_long()
    on = next(each for number, each in enumerate(editor.points.points) if number not in editor.points.off)
    editor._in_rectangle(QgsRectangle(on.x - 400, on.y - 400, on.x + 400, on.y + 400))
    yield 1500
    seen["off_by_rectangle"] = len(editor.points.off)
    editor.start_adding()
    editor.click_reference(QgsPointXY(point.x + 900, point.y - 900 if point.y > 5.27e6 else point.y + 900))
    yield 800
    editor.click_target(QgsPointXY(point.x + 940, point.y - 920 if point.y > 5.27e6 else point.y + 920))
    while len(editor.points.points) == seen["points"] or math.isnan(editor.points.points[-1].length_px):
        yield 100
    added = editor.points.points[-1]
    seen["added"] = [added.length_px, added.sigma_px]
    editor.save(str(Path(JOB["folder"]) / "saved.points"))
    yield 1000
    editor.use()
    yield 1000
    yield from wait(dock)
    seen["again"] = dock.verdict.text()


def compare(dock: Any, window: QWidget) -> Iterator[int]:
    """Swipe, blink, arrows of another length."""
    dock.tabs.setCurrentIndex(2)
    canvas = iface.mapCanvas()
    box = dock.layers["before"].extent()
    box.scale(0.25)
    canvas.setExtent(box)
    canvas.refresh()
    yield 1500
    dock.swipe_button.setChecked(True)
    yield 1500
    dock.swipe.move(0.45)
    yield 500
    seen["swipe"] = dock.swipe._curtain.image.width()
    grab(window, "swipe")
    dock.swipe_button.setChecked(False)
    node = QgsProject.instance().layerTreeRoot().findLayer(dock.layers["after"].id())
    seen["blink"] = []
    dock.blink_button.setChecked(True)
    for _ in range(2):
        dock.blink.turn()
        seen["blink"].append(node.itemVisibilityChecked())
    dock.blink_button.setChecked(False)
    seen["blink"].append(node.itemVisibilityChecked())
    dock.factor.setValue(25)
    dock._scale_arrows()
    seen["legend"] = [each.label() for each in dock.layers["points"].renderer().categories()]
    yield 300


def limited(dock: Any, layers: list[QgsRasterLayer]) -> Iterator[int]:
    """Align an extent, within an area, only georeferencing."""
    dock.tabs.setCurrentIndex(0)
    polygons = QgsVectorLayer(JOB["polygons"], "polygons")
    QgsProject.instance().addMapLayer(polygons)
    dock.target.setLayer(layers[1])
    dock.reference.setLayer(layers[0])
    dock.area.setLayer(polygons)
    box = polygons.extent()
    box.scale(1.3)
    dock.extent.setOutputExtentFromUser(box, polygons.crs())
    dock.output.setCurrentIndex(1)
    dock.field.setChecked(False)
    dock.start()
    yield from wait(dock)
    seen["limited"] = dock.verdict.text()
    after = dock.layers["after"]
    seen["georeferenced"] = after.source()
    seen["limited_points"] = [[each.x, each.y] for each in dock.editor.points.points]
    seen["box"] = [box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum()]
    dock.reference.setLayer(layers[1])
    dock.start()
    yield 300
    seen["refused"] = dock.verdict.text()
    dock.reference.setLayer(layers[0])


def cancel(dock: Any) -> Iterator[int]:
    """Cancel what has begun."""
    dock.extent.clear()
    dock.area.setLayer(None)
    dock.start()
    yield 1500
    dock.cancel()
    yield from wait(dock)
    seen["cancelled"] = dock.verdict.text()


go(steps)
