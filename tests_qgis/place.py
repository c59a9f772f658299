"""What a user does on the page “Place” of the dock, by mouse and keys: ``qgis --code place.py``.

WINDOW_JOB names a JSON file: `reference`, `target` (without georeferencing), `truth` (its geotransform),
`other` (unlike the reference), and `folder` for pictures and `seen.json`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from qgis.core import QgsCoordinateReferenceSystem, QgsPointXY, QgsProject, QgsRasterLayer
from qgis.PyQt.QtCore import QEvent, QPoint, QPointF, Qt
from qgis.PyQt.QtGui import QMouseEvent, QWheelEvent
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QApplication
from qgis.utils import iface, plugins
from steps import JOB, add, begin, ended, go, grab, opened, seen

NO = Qt.KeyboardModifier.NoModifier
LEFT = Qt.MouseButton.LeftButton
TRUTH = JOB["truth"]


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window = begin()
    project = QgsProject.instance()
    project.setCrs(QgsCoordinateReferenceSystem("EPSG:32633"))
    layers = add("reference", "target", "other")
    project.layerTreeRoot().findLayer(layers[2]).setItemVisibilityChecked(False)
    yield from opened(layers[1], 400)
    dock = plugins["pcwlad_geo_qgis"].dock
    iface.mapCanvas().setExtent(layers[0].extent())
    iface.mapCanvas().refresh()
    yield 1500
    dock.reference.setLayer(layers[0])
    dock.tabs.setCurrentWidget(dock.place)
    yield 1500
    seen["shown"] = [each.name() for each in iface.mapCanvas().layers()]
    yield from by_mouse(dock.place)
    yield from by_keys(dock.place)
    yield from by_pairs(dock.place, window)
    yield from pages(dock, layers)
    yield from refused(dock, layers)
    yield from snap(dock)
    yield from leave(dock, layers)
    dock.close_all()


def mouse(kind: QEvent.Type, place: QPointF, modifiers: Any = NO) -> None:
    """Send an event of the mouse to the map."""
    buttons = Qt.MouseButton.NoButton if kind == QEvent.Type.MouseButtonRelease else LEFT
    button = Qt.MouseButton.NoButton if kind == QEvent.Type.MouseMove else LEFT
    QApplication.sendEvent(
        iface.mapCanvas().viewport(), QMouseEvent(kind, QPointF(place), button, buttons, modifiers)
    )


def drag(page: Any, begin: QPointF, end: QPointF, modifiers: Any = NO) -> list[tuple[float, ...]]:
    """Drag in ten steps, and return the figures halfway and at the end."""
    mouse(QEvent.Type.MouseButtonPress, begin, modifiers)
    for part in range(1, 11):
        mouse(QEvent.Type.MouseMove, begin + (end - begin) * part / 10, modifiers)
        if part == 5:
            halfway = page.ghost.placement.figures()
    mouse(QEvent.Type.MouseButtonRelease, end, modifiers)
    return [halfway, page.ghost.placement.figures()]


def figures(page: Any) -> list[float]:
    """Return what the form shows: dx, dy, angle, scale."""
    return [box.value() for box in page.figures]


def by_mouse(page: Any) -> Iterator[int]:
    """Drag, turn, scale; type; take all back and do it again."""
    canvas = iface.mapCanvas()
    middle = QPointF(canvas.width() / 2, canvas.height() / 2)
    seen["unit"] = canvas.mapUnitsPerPixel()
    seen["dragged"] = drag(page, middle, middle + QPointF(100, 40))
    yield 200
    left, low, right, high = page.ghost.placement.box
    (centre,) = page.ghost.to_canvas(((left + right) / 2, (low + high) / 2))
    east, north = centre + QPointF(80, 0), centre - QPointF(0, 80)
    seen["turned"] = drag(page, east, north, Qt.KeyboardModifier.ControlModifier)[1]
    place = QPoint(int(centre.x()), int(centre.y()))
    before = canvas.scale()
    for modifiers in (Qt.KeyboardModifier.AltModifier, NO):
        wheel = (QPointF(place), QPointF(canvas.mapToGlobal(place)), QPoint(), QPoint(120, 0))
        if modifiers == NO:
            wheel = (*wheel[:3], QPoint(0, 120))
        event = QWheelEvent(*wheel, Qt.MouseButton.NoButton, modifiers, Qt.ScrollPhase.NoScrollPhase, False)
        QApplication.sendEvent(canvas.viewport(), event)
        yield 300
        seen.setdefault("wheel", []).append([figures(page)[3], canvas.scale() / before])
    page.figures[2].setValue(10.0)
    page.figures[3].setValue(1.5)
    seen["typed"] = page.ghost.placement.figures()
    drawn = page.ghost.scene().views()[0].grab()
    seen["drawn"] = not drawn.isNull()
    while page.undo_button.isEnabled():
        page.undo_button.click()
        seen.setdefault("undone", []).append(page.ghost.placement.figures())
    while page.redo_button.isEnabled():
        page.redo_button.click()
    seen["redone"] = page.ghost.placement.figures()


def by_keys(page: Any) -> Iterator[int]:
    """Step by arrow keys; take back by Ctrl-Z, on the map and in a field; Escape midway in a drag."""
    canvas, extent = iface.mapCanvas(), iface.mapCanvas().extent().toString()
    canvas.setFocus()
    start = figures(page)
    seen["keys_unit"] = canvas.mapUnitsPerPixel()
    for key, modifiers in ((Qt.Key.Key_Right, NO), (Qt.Key.Key_Up, Qt.KeyboardModifier.ShiftModifier)):
        QTest.keyClick(canvas, key, modifiers)
    seen["stepped"] = [now - was for now, was in zip(figures(page)[:2], start)]
    QTest.keyClick(canvas, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    page.figures[0].setFocus()
    QTest.keyClick(page.figures[0], Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    seen["taken_back"] = [now - was for now, was in zip(figures(page), start)]
    middle = QPointF(canvas.width() / 2, canvas.height() / 2)
    mouse(QEvent.Type.MouseButtonPress, middle)
    mouse(QEvent.Type.MouseMove, middle + QPointF(50, 50))
    QTest.keyClick(canvas, Qt.Key.Key_Escape)
    mouse(QEvent.Type.MouseMove, middle + QPointF(90, 50))
    mouse(QEvent.Type.MouseButtonRelease, middle + QPointF(90, 50))
    seen["escaped"] = [now - was for now, was in zip(figures(page), start)]
    seen["map_stood"] = canvas.extent().toString() == extent
    yield 100


def true_place(col: float, row: float) -> QgsPointXY:
    """Return where a pixel of the target belongs on the map."""
    x, a, b, y, c, d = TRUTH
    return QgsPointXY(x + a * col + b * row, y + c * col + d * row)


def by_pairs(page: Any, window: Any) -> Iterator[int]:
    """Click three pairs of places; two at the same place are refused."""
    page.view_button.click()
    page.pairs_button.click()
    yield 300
    seen["pairs_hint"] = page.told.text()
    for col, row in ((20.0, 20.0), (250.0, 40.0), (60.0, 230.0)):
        for place in (page.ghost.placement, None):
            shown = true_place(col, row)
            if place is not None:
                x, y = seen_at(page, col, row)
                shown = QgsPointXY(x, y)
            at = page.tool.toCanvasCoordinates(shown)
            mouse(QEvent.Type.MouseButtonPress, QPointF(at))
            mouse(QEvent.Type.MouseButtonRelease, QPointF(at))
            yield 200
        off = [
            math.dist(seen_at(page, *pixel), (true_place(*pixel).x(), true_place(*pixel).y()))
            for pixel in ((20.0, 20.0), (250.0, 40.0), (60.0, 230.0), (150.0, 150.0))
        ]
        seen.setdefault("pairs_off", []).append([each / iface.mapCanvas().mapUnitsPerPixel() for each in off])
    yield 500
    grab(window, "place")
    for name, code in (("where", 32633), ("where_3857", 3857)):
        crs = QgsCoordinateReferenceSystem(f"EPSG:{code}")
        seen[name] = page.ghost.placement.geotransform(crs)


def seen_at(page: Any, col: float, row: float) -> tuple[float, float]:
    """Return where the map shows a pixel of the target now."""
    x, a, b, y, c, d = page.ghost.placement.now
    return x + a * col + b * -row, y + c * col + d * -row


def pages(dock: Any, layers: list[QgsRasterLayer]) -> Iterator[int]:
    """Leave the page and the layer, and come back: the layer is where it was put."""
    before, canvas = dock.place.ghost.placement.now, iface.mapCanvas()
    dock.tabs.setCurrentIndex(0)
    yield 300
    seen["away"] = [canvas.mapTool() == dock.place.tool, dock.place.ghost is None]
    seen["shown_away"] = [each.name() for each in canvas.layers()]
    dock.tabs.setCurrentWidget(dock.place)
    dock.target.setLayer(None)
    seen["no_layer"] = [dock.place.heading.text(), dock.place.isEnabled()]
    dock.target.setLayer(layers[1])
    yield 300
    seen["come_back"] = dock.place.ghost.placement.now == before
    iface.actionPan().trigger()
    seen["other_tool"] = dock.place.move_button.isChecked()
    dock.place.move_button.click()
    seen["tool_again"] = canvas.mapTool() == dock.place.tool
    dock.place.save()
    yield 500
    seen["saved"] = dock.place.told.text()
    placed = QgsProject.instance().mapLayersByName("target")
    seen["saved_extent"] = [each.extent().toString(0) for each in placed]
    seen["saved_crs"] = sorted(each.crs().authid() for each in placed)


def refused(dock: Any, layers: list[QgsRasterLayer]) -> Iterator[int]:
    """Snap to what shows nothing of the layer: it stays where it was put."""
    before = dock.place.ghost.placement.now
    dock.reference.setLayer(layers[2])
    dock.place.snap_button.click()
    seen["while_it_runs"] = [dock.place.snap_button.isEnabled(), dock.cancel_button.isVisible()]
    yield from ended(dock)
    seen["refusal"] = dock.verdict.text()
    seen["stays"] = [
        dock.tabs.currentWidget() is dock.place,
        dock.place.ghost is not None and dock.place.ghost.placement.now == before,
    ]
    dock.reference.setLayer(layers[0])


def snap(dock: Any) -> Iterator[int]:
    """Snap, pressed twice; then from the cancelled state."""
    dock.place.snap_button.click()
    dock.place.snap_button.click()
    yield 1500
    dock.cancel_button.click()
    yield from ended(dock)
    seen["cancelled"] = dock.verdict.text()
    seen["ghost_stays"] = dock.place.ghost is not None
    dock.place.snap_button.click()
    yield from ended(dock)
    seen["snapped"] = dock.verdict.text()
    seen["page"] = dock.tabs.currentIndex()
    seen["after"] = dock.layers["after"].source() if "after" in dock.layers else ""


def leave(dock: Any, layers: list[QgsRasterLayer]) -> Iterator[int]:
    """Take the layer from the project while it is placed; then clear the project."""
    dock.target.setLayer(layers[1])
    dock.tabs.setCurrentWidget(dock.place)
    yield 300
    mouse(QEvent.Type.MouseButtonPress, QPointF(200, 200))
    QgsProject.instance().removeMapLayer(layers[1].id())
    mouse(QEvent.Type.MouseMove, QPointF(240, 200))
    mouse(QEvent.Type.MouseButtonRelease, QPointF(240, 200))
    yield 300
    seen["after_removal"] = dock.place.heading.text()
    QgsProject.instance().clear()
    yield 500


go(steps)
