"""What a user does with the ways to look at a result: ``qgis --code look.py``.

WINDOW_JOB names a JSON file: `done` (the folder of a registration) and `folder`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from qgis.core import QgsCoordinateReferenceSystem, QgsProject, QgsRaster
from qgis.PyQt.QtCore import QEvent, Qt
from qgis.PyQt.QtGui import QKeyEvent
from qgis.PyQt.QtWidgets import QApplication
from qgis.utils import iface, plugins
from steps import JOB, begin, go, grab, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window = begin()
    QgsProject.instance().setCrs(QgsCoordinateReferenceSystem("EPSG:32633"))
    plugin = plugins["pcwlad_geo_qgis"]
    plugin.open_dock()
    dock = plugin.dock
    dock.open_earlier(JOB["done"])
    seen["verdict"] = dock.verdict.text()
    window.resizeDocks([dock], [400], Qt.Orientation.Horizontal)
    iface.messageBar().clearWidgets()
    yield 2000
    dock.tabs.setCurrentWidget(dock.compare_page)
    canvas = iface.mapCanvas()
    box = dock.layers["after"].extent()
    box.scale(0.25)
    canvas.setExtent(box)
    yield 1500
    for button in (dock.red_cyan_button, dock.edges_button):
        button.click()
        while dock.views.composite._curtain.image.isNull():
            yield 100
        curtain = dock.views.composite._curtain
        seen.setdefault("drawn", []).append([curtain.image.width(), curtain.image.height()])
        if button is dock.red_cyan_button:
            grab(window, "red_cyan")
    size = canvas.mapSettings().outputSize()
    seen["size"] = [size.width(), size.height()]
    seen["one_is_on"] = [dock.red_cyan_button.isChecked(), dock.edges_button.isChecked()]
    yield from hold_space(dock)
    dock.blink_button.click()
    yield 300
    seen["blinks_alone"] = [dock.edges_button.isChecked(), dock.views.composite._curtain is None]
    dock.edges_button.click()
    seen["blink_is_off"] = [dock.blink_button.isChecked(), dock.blink.isActive()]
    yield from fade(dock)
    dock.tabs.setCurrentIndex(0)
    yield 300
    seen["page_left"] = [dock.edges_button.isChecked(), dock.views.composite._curtain is None]
    seen["opaque again"] = dock.layers["after"].opacity()
    dock.tabs.setCurrentWidget(dock.compare_page)
    yield from heat(dock)
    dock.red_cyan_button.click()
    QgsProject.instance().removeMapLayer(dock.layers["reference"].id())
    yield 500
    seen["without_reference"] = [dock.red_cyan_button.isChecked(), dock.views.composite._curtain is None]
    dock.red_cyan_button.click()
    yield 500
    QgsProject.instance().clear()
    yield 500
    dock.close_all()


def hold_space(dock: Any) -> Iterator[int]:
    """Hold Space, which repeats itself, and let it go."""
    canvas = iface.mapCanvas()
    before = [each.source() for each in canvas.layers()]
    for kind, repeated in ((QEvent.Type.KeyPress, False), (QEvent.Type.KeyPress, True)):
        QApplication.sendEvent(
            canvas, QKeyEvent(kind, Qt.Key.Key_Space, Qt.KeyboardModifier.NoModifier, " ", repeated)
        )
    yield 500
    seen["held"] = [[each.source() for each in canvas.layers()], dock.views.composite._curtain.isVisible()]
    release = QKeyEvent(QEvent.Type.KeyRelease, Qt.Key.Key_Space, Qt.KeyboardModifier.NoModifier, " ")
    QApplication.sendEvent(canvas, release)
    yield 500
    seen["let_go"] = [
        [each.source() for each in canvas.layers()] == before,
        dock.views.composite._curtain.isVisible(),
    ]


def fade(dock: Any) -> Iterator[int]:
    """Make the result transparent over the layer as it was, and over the reference; press a button then."""
    after, canvas = dock.layers["after"], iface.mapCanvas()
    seen["fade"] = []
    dock.fade_slider.setValue(60)
    yield 500
    for reference in (False, True):
        dock.with_reference.setChecked(reference)
        beneath = [each.source() for each in canvas.layers()][1:]
        seen["fade"].append([canvas.layers()[0] == after, after.opacity(), beneath])
    grab(iface.mainWindow(), "transparent")
    dock.with_reference.setChecked(False)
    seen["fade stops edges"] = dock.edges_button.isChecked()
    dock.edges_button.click()
    yield 300
    seen["edges stop fade"] = [after.opacity(), dock.fade_slider.value(), len(canvas.layers()) > 2]
    dock.fade_slider.setValue(30)


def heat(dock: Any) -> Iterator[int]:
    """Show the map of the residuals, twice; compare it with the points."""
    iface.mapCanvas().setExtent(dock.layers["after"].extent())
    dock.heat_button.click()
    yield 2000
    layer = dock.layers["heat"]
    lengths = []
    for point in dock.layers["tie_points"].getFeatures():
        if point["status"] == "fit":
            length = (point["residual_col"] ** 2 + point["residual_row"] ** 2) ** 0.5
            place = point.geometry().asPoint()
            values = layer.dataProvider().identify(place, QgsRaster.IdentifyFormatValue).results()
            lengths.append((length, values.get(1)))
    lengths.sort()
    known = [(length, value) for length, value in lengths if value is not None]
    few = len(known) // 10
    seen["heat"] = [sum(value for _, value in part) / len(part) for part in (known[:few], known[-few:])]
    seen["heat_points"] = len(known)
    dock.heat_button.click()
    yield 300
    seen["heat_off"] = "heat" in dock.layers
    dock.heat_button.click()
    yield 300
    QgsProject.instance().removeMapLayer(dock.layers["heat"].id())
    yield 300
    seen["heat_removed"] = dock.heat_button.isChecked()


go(steps)
