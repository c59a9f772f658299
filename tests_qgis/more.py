"""What the dock does beside one pair: choices, several layers, an earlier job: ``qgis --code more.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `other` (another raster of the target's place), `mask`
(of the reference), and `folder`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pcwlad_geo_qgis.algorithms.base import MODELS
from qgis.core import QgsApplication, QgsPointXY, QgsProject, QgsRasterLayer, QgsVectorLayer
from qgis.PyQt.QtCore import QObject, QPoint, Qt, QUrl, pyqtSlot
from qgis.PyQt.QtGui import QDesktopServices
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QAbstractButton
from qgis.utils import iface, plugins
from steps import FOLDER, JOB, begin, editable, ended, go, grab, opened, seen


class Opened(QObject):
    """Takes what would be opened in the browser."""

    def __init__(self) -> None:
        super().__init__()
        self.urls: list[str] = []

    @pyqtSlot(QUrl)
    def take(self, url: QUrl) -> None:
        self.urls.append(url.toString())


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window = begin()
    names = ("reference", "target", "other", "mask")
    layers = {name: QgsRasterLayer(JOB[name], name) for name in names}
    QgsProject.instance().addMapLayers(list(layers.values()))
    plugin = plugins["pcwlad_geo_qgis"]
    seen["toolbar"] = plugin.action in iface.pluginToolBar().actions()
    yield from opened(layers["target"], 430)
    dock = plugin.dock
    dock.reference.setLayer(layers["reference"])
    yield from choose(dock, layers)
    seen["stages"] = []
    dock._runner.stage.connect(seen["stages"].append)
    dock.start_button.click()
    yield from ended(dock)
    seen["several"] = dock.verdict.text()
    grab(window, "several")
    dock.choices.set("OTHERS", [layers["other"].id()])
    drawn = QgsVectorLayer(f"{JOB['drawn']}|layername=plots", "plots", "ogr")
    QgsProject.instance().addMapLayer(drawn)
    dock.choices.set("DRAWN", [drawn.id()])
    dock.apply_button.click()
    yield from ended(dock)
    seen["applied"] = dock.verdict.text()
    root = QgsProject.instance().layerTreeRoot()
    seen["groups"] = {
        group.name(): [node.name() for node in group.findLayers()] for group in root.findGroups()
    }
    yield from earlier(dock)


def choose(dock: Any, layers: dict[str, QgsRasterLayer]) -> Iterator[int]:
    """Open the advanced choices and make some."""
    seen["collapsed"] = dock.advanced.isCollapsed()
    seen["untold"] = [
        each.objectName()
        for each in dock.tabs.findChildren(QAbstractButton)
        if each.objectName().endswith("_button") and not each.toolTip()
    ]
    dock.advanced.setCollapsed(False)
    dock.target_band.setBand(1)
    dock.choices.set("SEARCH_RADIUS", 9)
    dock.choices.set("MODEL", MODELS.index("affine"))
    box = dock.choices._wrappers["WINDOW"].wrappedWidget()
    seen["windows"] = []
    for change in (box.stepUp, box.stepUp, box.stepDown, box.stepDown, lambda: box.setValue(80), box.clear):
        change()
        seen["windows"].append(dock.choices.value("WINDOW"))
    opened = Opened()
    for scheme in ("file", "https"):
        QDesktopServices.setUrlHandler(scheme, opened, "take")
    dock.help_button.click()
    registry = QgsApplication.processingRegistry()
    seen["help"] = opened.urls
    seen["algorithm_help"] = [each.helpUrl() for each in registry.providerById("pcwlad_geo").algorithms()]
    dock.choices.set("REFERENCE_MASK", layers["mask"].id())
    dock.choices.set("LIKE", layers["reference"].id())
    dock.choices.set("MORE", [layers["other"].id()])
    yield 500
    seen["least_width"] = dock.align_contents.minimumSizeHint().width()
    grab(dock, "advanced")
    dock.folder.setFilePath(str(FOLDER / "all"))
    dock.resize(430, 300)
    seen["least"] = [dock.tabs.widget(page).minimumSizeHint().height() for page in range(2)]


def earlier(dock: Any) -> Iterator[int]:
    """Begin a new project and open what was done; click a point on the map; close the dock."""
    seen["before"] = dock.verdict.text()
    QgsProject.instance().clear()
    yield 500
    seen["choices_after_clearing"] = [dock.choices.value(name) for name in ("SEARCH_RADIUS", "LIKE", "MORE")]
    dock.open_earlier(str(FOLDER))
    seen["none"] = dock.verdict.text()
    dock.open_earlier(str(FOLDER / "all" / f"{Path(JOB['target']).stem}_aligned"))
    seen["opened"] = dock.verdict.text()
    yield 1500
    seen["layers"] = sorted(each.source() for each in QgsProject.instance().mapLayers().values())
    dock.tabs.setCurrentIndex(1)
    editor = dock.editor
    yield from editable(dock)
    seen["points"] = len(editor.points.points)
    canvas = iface.mapCanvas()
    canvas.zoomToFullExtent()
    yield 2000
    point = editor.points.points[17]
    editor.pick_button.click()
    place = canvas.getCoordinateTransform().transform(QgsPointXY(point.x, point.y))
    pixel = QPoint(round(place.x()), round(place.y()))
    QTest.mouseClick(canvas.viewport(), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, pixel)
    yield 1500
    (row,) = editor.selected()
    seen["picked_off_m"] = QgsPointXY(point.x, point.y).distance(
        editor.points.points[row].x, editor.points.points[row].y
    )
    seen["pixel_m"] = canvas.mapUnitsPerPixel()
    index = editor.sorted.mapFromSource(editor.model.index(row, 0))
    seen["in_sight"] = editor.table.viewport().rect().contains(editor.table.visualRect(index).center())
    residual = editor.table.visualRect(index.siblingAtColumn(editor.model.residual_column))
    seen["residual_in_sight"] = editor.table.viewport().rect().contains(residual.center())
    grab(iface.mainWindow(), "picked")
    small = editor.view
    place = small.getCoordinateTransform().transform(
        QgsPointXY(editor.points.points[row].x, editor.points.points[row].y)
    )
    editor.table.clearSelection()
    pixel = QPoint(round(place.x()), round(place.y()))
    QTest.mouseClick(small.viewport(), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, pixel)
    yield 1000
    seen["picked_on_the_small_map"] = editor.selected() == [row]
    process = Path(f"/proc/{editor._session.processId()}")
    seen["edits"] = process.exists()
    dock.tabs.setCurrentIndex(2)
    yield 1000
    seen["compared"] = [each.name() for each in canvas.layers()]
    dock.blink_button.setChecked(True)
    dock.close()
    while process.exists():  # it ends meanwhile
        yield 50
    yield 1500
    seen["closed"] = [dock.blink.isActive(), dock.editor is None, process.exists()]
    seen["shown_after_closing"] = [each.name() for each in canvas.layers()]


go(steps)
