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
    Qgis,
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsPointXY,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
    QgsVectorLayer,
)
from qgis.gui import QgsMapToolPan
from qgis.PyQt.QtWidgets import QWidget
from qgis.utils import iface, plugins
from steps import JOB, add, begin, editable, ended, go, grab, opened, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window = begin()
    QgsProject.instance().setCrs(QgsCoordinateReferenceSystem("EPSG:32633"))
    layers = add("reference", "target")
    yield 1500
    plugin = plugins["pcwlad_geo_qgis"]
    seen["menu"] = plugin.action in iface.rasterMenu().actions() or any(
        plugin.action in each.menu().actions() for each in iface.rasterMenu().actions() if each.menu()
    )
    yield from opened(layers[1], 430)
    dock = plugin.dock
    seen["preset"] = [box.currentLayer().name() for box in (dock.target, dock.reference)]
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
    yield from leave(dock)
    dock.close_all()


def align(dock: Any) -> Iterator[int]:
    """Align with all defaults."""
    seen["moved"] = []
    dock.progress.valueChanged.connect(lambda percent: seen["moved"].append([dock.stage.text(), percent]))
    dock.start()
    yield from ended(dock)
    dock.progress.valueChanged.disconnect()
    seen["verdict"] = dock.verdict.text()
    root = QgsProject.instance().layerTreeRoot()
    seen["groups"] = {
        group.name(): [node.name() for node in group.findLayers()]
        for group in root.children()
        if hasattr(group, "findLayers") and group.children()
    }
    seen["shown"] = [
        node.name()
        for node in root.children()[0].findLayers()
        if not node.layer().flags() & QgsRasterLayer.Private
    ][::-1]
    scratch = [each for each in QgsProject.instance().mapLayers().values() if each.isTemporary()]
    seen["scratch"] = [each.name() for each in scratch if each.customProperty("skipMemoryLayersCheck")]
    seen["scratch_asked"] = [
        each.name() for each in scratch if not each.customProperty("skipMemoryLayersCheck")
    ]
    seen["tie_points"] = dock.layers["tie_points"].source()
    after = dock.layers.get("after")
    seen["after"] = after.source() if after else ""
    seen["field"] = dock.layers["displacements"].source()
    seen["field_rules"] = [
        each.label() for each in dock.layers["displacements"].renderer().rootRule().children()
    ]


def visible_rasters() -> list[str]:
    """Return the rasters that are switched on in the layer tree."""
    nodes = QgsProject.instance().layerTreeRoot().findLayers()
    return [
        node.layer().source()
        for node in nodes
        if isinstance(node.layer(), QgsRasterLayer) and node.itemVisibilityChecked()
    ]


def edit(dock: Any, window: QWidget) -> Iterator[int]:
    """Switch points off, undo, add one, zoom; note how long a refit takes until the map is drawn."""
    editor = dock.editor
    seen["before_the_editor"] = visible_rasters()
    dock.tabs.setCurrentIndex(1)
    yield from editable(dock)
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
    seen["refit_s"], seen["arrows"] = [], []
    rows = [row for row in range(seen["points"]) if row != top]
    for model in ("affine", "tps"):
        editor.models.setCurrentIndex(editor.models.findData(model))
        yield 2500
        legend = [each.label() for each in dock.layers["points"].renderer().categories()]
        seen["arrows"].append([label for label in legend if "×" in label])
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
    editor.long_button.click()
    on = next(each for number, each in enumerate(editor.points.points) if number not in editor.points.off)
    editor._in_rectangle(QgsRectangle(on.x - 400, on.y - 400, on.x + 400, on.y + 400))
    yield 1500
    seen["off_by_rectangle"] = len(editor.points.off)
    yield from change_points(editor, window, point)
    editor.save(str(Path(JOB["folder"]) / "saved.points"))
    yield 1000
    dock.tabs.setCurrentIndex(0)
    yield 300
    seen["after_the_editor"] = visible_rasters()
    dock.reference.setLayer(None)
    dock.target.setLayer(None)  # what was edited counts, not what is chosen
    editor.use()
    yield 1000
    yield from ended(dock)
    seen["again"] = dock.verdict.text()


def free_place(editor: Any, near: Any, apart: float = 120.0) -> QgsPointXY:
    """Return a place inside, far from all points, map units."""
    sign = -1 if near.y > 5.27e6 else 1
    places = [QgsPointXY(near.x + 900 + step * 17, near.y + sign * (900 + step * 29)) for step in range(200)]
    return next(
        place
        for place in places
        if min(math.hypot(each.x - place.x(), each.y - place.y()) for each in editor.points.points) > apart
    )


def change_points(editor: Any, window: QWidget, near: Any) -> Iterator[int]:
    """Add a point by clicks on both maps, the small one first; again; move it; delete it; take all back."""
    canvas, tool = iface.mapCanvas(), iface.mapCanvas().mapTool()
    place = free_place(editor, near)
    shown = [canvas.layers()[index].name() for index in range(len(canvas.layers()))]
    seen["on_the_map"] = shown
    counts = []

    def count() -> None:
        counts.append([editor.sorted.rowCount(), len(editor.points.off), editor.told.text()])

    count()
    editor.add_button.click()
    editor.click_target(QgsPointXY(place.x() + 36 + 15, place.y() + 23 - 12))
    yield 500
    editor.click_reference(place)
    yield from answered(editor)
    added = editor.points.points[-1]
    seen["added"] = [added.length_px, added.sigma_px]
    seen["added_off_m"] = math.hypot(added.x - place.x(), added.y - place.y())
    seen["drawn"] = [editor.layer.layer.featureCount(), len(editor.points.points)]
    seen["bar"] = [
        each.text() for each in iface.messageBar().items() if each.level() == Qgis.MessageLevel.Critical
    ]
    seen["tool_is_back"] = canvas.mapTool() == tool
    count()
    grab(window, "added")
    editor.add_button.click()
    editor.click_reference(QgsPointXY(added.x + 20, added.y - 20))
    editor.click_target(QgsPointXY(added.x + 60, added.y))
    yield 3000
    count()
    last = editor.sorted.mapFromSource(editor.model.index(len(editor.points.points) - 1, 0)).row()
    editor.table.selectRow(last)
    yield 500
    editor.move_button.click()
    other = free_place(editor, added, 90.0)
    editor.click_reference(other)
    yield from answered(editor)
    moved = editor.points.points[-1]
    seen["moved_off_m"] = math.hypot(moved.x - other.x(), moved.y - other.y())
    count()
    grab(window, "moved")
    last = editor.sorted.mapFromSource(editor.model.index(len(editor.points.points) - 1, 0)).row()
    editor.table.selectRow(last)
    editor.delete_button.click()
    yield from answered(editor)
    count()
    grab(window, "deleted")
    for _ in range(3):
        editor.undo_button.click()
        yield from answered(editor)
        count()
    seen["counts"] = counts
    editor.add_button.click()
    editor.click_reference(place)
    editor.click_target(QgsPointXY(place.x() + 36, place.y() + 23))
    yield from answered(editor)


def answered(editor: Any) -> Iterator[int]:
    """Wait until the newest fit is shown, after a point was placed or changed."""
    yield 1500
    while editor._shown_number < editor._number or "…" in editor.told.text():
        yield 100
    yield 300


def leave(dock: Any) -> Iterator[int]:
    """Take away layers while the editor, swipe and blink are open, and the project while a run goes on."""
    project = QgsProject.instance()
    dock.tabs.setCurrentIndex(2)
    yield 500
    dock.blink_button.setChecked(True)
    dock.swipe_button.setChecked(True)
    yield 1000
    project.removeMapLayer(dock.layers["after"].id())
    yield 1500
    seen["compare_after_leaving"] = [
        dock.blink_button.isChecked(),
        dock.swipe_button.isChecked(),
        dock.compare_box.isEnabled(),
    ]
    dock.tabs.setCurrentIndex(1)
    yield 500
    dock.editor.table.selectRow(3)
    project.removeMapLayer(dock.layers["before"].id())
    yield 500
    dock.editor.table.selectRow(5)
    dock.editor.undo()
    yield 1000
    seen["editor_after_leaving"] = dock.editor is None
    layers = add("reference", "target")
    dock.tabs.setCurrentIndex(0)
    dock.reference.setLayer(layers[0])
    dock.target.setLayer(layers[1])
    dock.choices.set("EXTENT", extent_of(layers[0].extent(), layers[0]))
    dock.start()
    yield 1000
    project.clear()
    yield from ended(dock)
    seen["after_clearing"] = {
        "verdict": dock.verdict.text(),
        "progress": dock.progress.value(),
        "extent": bool(dock.choices.value("EXTENT")),
        "layers": len(project.mapLayers()),
    }


def extent_of(box: QgsRectangle, layer: Any) -> str:
    """Return an extent as Processing writes it."""
    return f"{box.xMinimum()},{box.xMaximum()},{box.yMinimum()},{box.yMaximum()} [{layer.crs().authid()}]"


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
    dock.with_reference.setChecked(True)
    yield 1500
    seen["left"] = [each.source() for each in dock.swipe._layers]
    grab(window, "swipe_reference")
    canvas.setMapTool(QgsMapToolPan(canvas))
    seen["swipe_after_another_tool"] = dock.swipe_button.isChecked()
    shown = [each.source() for each in canvas.layers()]
    seen["blink"] = []
    dock.blink_button.setChecked(True)
    seen["blinks"] = dock.blink.isActive()
    dock.blink.stop()  # so that it does not turn between the looks
    for with_reference in (True, False):
        dock.with_reference.setChecked(with_reference)
        for _ in range(2):
            dock.turn()
            seen["blink"].append([each.source() for each in canvas.layers()])
    dock.blink_button.setChecked(False)
    seen["after_blinking"] = [each.source() for each in canvas.layers()] == shown
    dock.editor.factor.setValue(25)
    dock.editor.scale_arrows()
    seen["legend"] = [each.label() for each in dock.layers["points"].renderer().categories()]
    yield 300


def limited(dock: Any, layers: list[QgsRasterLayer]) -> Iterator[int]:
    """Align an extent, within an area, only georeferencing."""
    dock.tabs.setCurrentIndex(0)
    polygons = QgsVectorLayer(JOB["polygons"], "polygons")
    QgsProject.instance().addMapLayer(polygons)
    dock.target.setLayer(layers[1])
    dock.reference.setLayer(layers[0])
    dock.choices.set("AREA", polygons.id())
    box = polygons.extent()
    box.scale(1.3)
    dock.choices.set("EXTENT", extent_of(box, polygons))
    dock.choices.set("GEOREFERENCE", True)
    dock.start()
    yield from ended(dock)
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
    """Cancel what has begun in the list of tasks of QGIS; the editor of what was there before stays."""
    before = dock.editor
    dock.choices.reset()
    dock.start()
    yield 1500
    (task,) = QgsApplication.taskManager().activeTasks()
    task.cancel()
    yield from ended(dock)
    seen["cancelled"] = dock.verdict.text()
    seen["editor_kept"] = dock.editor is before and before is not None


go(steps)
