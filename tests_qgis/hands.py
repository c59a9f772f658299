"""What people do who press twice, in the wrong order, or midway: ``qgis --code hands.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `noise` (of the reference's place), `photo` (a part
of the reference, turned, without a place), `package` (the target in a GeoPackage), `points` (of the
Georeferencer), and `folder`.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import processing
from qgis.core import QgsApplication, QgsPointXY, QgsProject, QgsRectangle
from qgis.PyQt.QtCore import QPoint, Qt
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QLineEdit, QProgressBar, QScrollArea, QWidget
from qgis.utils import iface, plugins
from steps import FOLDER, JOB, add, begin, editable, ended, go, grab, seen

PROJECT = QgsProject.instance()


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window = begin(1024, 740)
    seen["alone"] = window.minimumSizeHint().width()
    layers = add("reference", "target")
    iface.setActiveLayer(layers[1])
    plugin = plugins["pcwlad_geo_qgis"]
    yield from first_look(plugin)
    dock = plugin.dock
    yield from small_window(dock, window)
    yield from twice(dock, window)
    yield from refused(dock)
    yield from unplaced(dock)
    yield from trusted(dock)
    yield from opened(dock)
    yield from closing(dock)
    yield from dialogs()
    yield from themes(dock)
    dock.close_all()


def click(button: QWidget) -> None:
    QTest.mouseClick(button, Qt.MouseButton.LeftButton)


def shown(dock: Any) -> dict[str, bool]:
    """Return which parts of the dock can be seen and used."""
    names = ("run_box", "verdict_area", "apply_box", "given_button", "trust_button", "engine_box", "next_box")
    names += ("place_button",)
    return {name: getattr(dock, name).isVisible() for name in names}


def first_look(plugin: Any) -> Iterator[int]:
    """Open the dock where there is no engine."""
    engine = os.environ.pop("PCWLAD_GEO_PYTHON")
    path, os.environ["PATH"] = os.environ["PATH"], "/usr/bin:/bin"
    plugin.action.trigger()
    yield 1000
    dock = plugin.dock
    seen["no engine"] = [dock.verdict.text(), dock.engine_box.isVisible()]
    seen["width"] = [dock.width(), dock.align_page.horizontalScrollBar().isVisible()]
    seen["fits"] = dock.align_page.viewport().width() - dock.align_contents.minimumSizeHint().width()
    seen["focus"] = dock.start_button.hasFocus() or not iface.mainWindow().isActiveWindow()
    seen["selected"] = [each.text() for each in dock.findChildren(QLineEdit) if each.hasSelectedText()]
    texts = [dock.tabs.tabText(page) for page in range(dock.tabs.count())]
    for page, text in enumerate(texts):
        dock.tabs.setTabText(page, 2 * text)  # as in another language
    bar = dock.tabs.tabBar()
    seen["tabs in sight"] = [bar.rect().contains(bar.tabRect(page)) for page in range(dock.tabs.count())]
    for page, text in enumerate(texts):
        dock.tabs.setTabText(page, text)
    seen["without points"] = dock.no_points_label.isVisibleTo(dock.points_page)
    seen["empty page"] = [dock.compare_label.isEnabled(), dock.swipe_button.isEnabled()]
    seen["toolbar"] = [bar.objectName() for bar in plugin.action.associatedWidgets() if bar.isVisible()]
    grab(iface.mainWindow(), "no_engine_1024")
    os.environ.update(PCWLAD_GEO_PYTHON=engine, PATH=path)
    plugin.action.trigger()


def small_window(dock: Any, window: QWidget) -> Iterator[int]:
    """Look at every page in a window of 1024 x 740."""
    yield 500
    dock.advanced.setCollapsed(False)
    yield 500
    seen["advanced fits"] = dock.align_page.viewport().width() - dock.align_contents.minimumSizeHint().width()
    grab(window, "advanced_1024")
    dock.advanced.setCollapsed(True)
    seen["idle"] = shown(dock)
    yield from drawn()
    seen["window"] = [window.minimumSizeHint().width()]


def drawn() -> Iterator[int]:
    """Wait until the map is drawn: QGIS shows a bar of its progress meanwhile, which widens the window."""
    bar = iface.mainWindow().statusBar().findChild(QProgressBar, "mProgressBar")
    while iface.mapCanvas().isDrawing() or (bar is not None and bar.isVisible()):
        yield 100


def twice(dock: Any, window: QWidget) -> Iterator[int]:
    """Align; press “Align with these” twice, while it runs, and “Align” meanwhile."""
    dock.choices.set(
        "MORE", [each.id() for each in (dock.reference.currentLayer(), dock.target.currentLayer())]
    )
    click(dock.start_button)
    seen["more"] = dock.choices.layers("MORE")
    yield 300
    seen["tasks"] = [each.description() for each in QgsApplication.taskManager().tasks()]
    seen["running"] = [shown(dock)["run_box"], dock.start_button.isEnabled(), dock.cancel_button.isEnabled()]
    dock.start()
    yield from ended(dock)
    seen["aligned"] = dock.verdict.text()
    tree = iface.layerTreeView()
    seen["unfolded"] = tree.isExpanded(tree.node2index(PROJECT.layerTreeRoot().findGroup("target aligned")))
    seen["focus after"] = window.focusWidget() == dock.start_button
    dock.advanced.setCollapsed(False)
    yield 500
    seen["verdict in sight"] = [dock.verdict.visibleRegion().boundingRect().height(), dock.verdict.height()]
    bottom = dock.verdict_area.mapTo(window, dock.verdict_area.rect().bottomLeft()).y()
    seen["verdict in the window"] = window.height() - bottom
    dock.advanced.setCollapsed(True)
    yield 300
    grab(window, "aligned_1024")
    dock.tabs.setCurrentIndex(1)
    editor = dock.editor
    yield from editable(dock)
    yield from drawn()
    seen["window"].append(window.minimumSizeHint().width())
    grab(window, "points_1024")
    yield from keys(editor)
    dock.tabs.setCurrentIndex(2)
    dock.blink_button.setChecked(True)
    dock.swipe_button.setChecked(True)
    dock.tabs.setCurrentIndex(1)
    seen["still compares"] = [dock.blink_button.isChecked(), dock.swipe_button.isChecked()]
    seen["told"] = []
    QTest.mouseDClick(editor.use_button, Qt.MouseButton.LeftButton)
    click(editor.use_button)
    yield 200
    editor.use()
    for _ in range(5):
        yield 300
        seen["told"].append([shown(dock)["run_box"], editor.use_button.isEnabled(), dock.stage.text()])
        dock.start()
    grab(window, "again_1024")
    yield from ended(dock)
    yield from editable(dock)
    seen["again"] = [dock.verdict.text(), shown(dock)["verdict_area"], dock.editor.use_button.isEnabled()]
    root = PROJECT.layerTreeRoot()
    seen["groups"] = [[group.name(), group.itemVisibilityChecked()] for group in root.findGroups()]
    seen["folders"] = folders()


def folders() -> list[str]:
    """Return the names of the folders of the target's results."""
    return sorted(each.name for each in Path(JOB["target"]).parent.glob("target_*") if each.is_dir())


def keys(editor: Any) -> Iterator[int]:
    """Use the keys of the table, and leave adding by Esc."""
    control, shift = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier
    editor.select(4)
    editor.table.setFocus()
    seen["keys"] = []
    for key, held in (
        (Qt.Key.Key_Space, Qt.KeyboardModifier.NoModifier),
        (Qt.Key.Key_Space, Qt.KeyboardModifier.NoModifier),
        (Qt.Key.Key_Delete, Qt.KeyboardModifier.NoModifier),
        (Qt.Key.Key_Z, control),
        (Qt.Key.Key_Z, control | shift),
        (Qt.Key.Key_Z, control),
    ):
        editor.select(4)
        QTest.keyClick(editor.table, key, held)
        yield 300
        seen["keys"].append([4 in editor.points.off, 4 in editor.points.gone])
    while editor.points.can_undo:
        editor.undo()
    yield 500
    editor.add_button.click()
    tool = iface.mapCanvas().mapTool()
    QTest.keyClick(iface.mapCanvas(), Qt.Key.Key_Escape)
    yield 300
    ring = editor._marks["reference"].asGeometry().isEmpty()
    yield 1000
    seen["esc"] = [iface.mapCanvas().mapTool() != tool, ring, "Click" not in editor.told.text()]
    seen["menu"] = len(editor.table.actions())


def refused(dock: Any) -> Iterator[int]:
    """Align what cannot be aligned, after a pair that could; press “Align with these” meanwhile."""
    seen["before the refusal"] = shown(dock)
    (noise,) = add("noise")
    dock.target.setLayer(noise)
    dock.start()  # from the page of the points
    yield 800
    dock.editor.use()
    runs = dock._runner.running
    yield from ended(dock)
    seen["while another runs"] = [dock.verdict.text(), folders(), runs]
    dock.tabs.setCurrentIndex(0)
    yield 300
    seen["refused"] = [dock.verdict.text(), shown(dock)]
    grab(iface.mainWindow(), "refused_1024")
    dock.align_by(JOB["points"])
    yield from ended(dock)
    seen["by points"] = dock.verdict.text()


def unplaced(dock: Any) -> Iterator[int]:
    """Align what has no place, and look at its points."""
    (layer,) = add("photo")
    dock.tabs.setCurrentIndex(0)
    dock.target.setLayer(layer)
    click(dock.start_button)
    yield from ended(dock)
    seen["unplaced"] = dock.verdict.text()
    seen["alpha"] = dock.layers["after"].renderer().alphaBand()
    grab(iface.mainWindow(), "unplaced")
    dock.tabs.setCurrentIndex(1)
    editor = dock.editor
    yield from editable(dock)
    seen["the small map has a CRS"] = editor.view.mapSettings().destinationCrs().isValid()
    canvas = iface.mapCanvas()
    editor.select(5)
    yield 1500
    point = editor.points.points[5]
    col, row = point.target_px
    seen["photo"] = [editor.view.extent().contains(QgsPointXY(col, -row)), editor.view.extent().width()]
    editor.start_picking()
    other = editor.target_place(7)
    editor.view.setExtent(QgsRectangle.fromCenterAndSize(other, 40, 40))
    editor.view.refresh()
    yield 1000
    pick(editor.view, other)
    yield 500
    picked = editor.points.points[editor.selected()[0]].target_px
    seen["picked in the photo"] = math.dist(picked, editor.points.points[7].target_px)
    table = editor.table.geometry()
    editor.start_adding()  # which tells more than a line
    yield 300
    seen["the table stays"] = editor.table.geometry() == table
    editor.rest()
    grab(iface.mainWindow(), "photo_points")
    canvas.setExtent(QgsRectangle.fromCenterAndSize(QgsPointXY(point.x, point.y), 1500, 1500))
    canvas.refresh()
    yield 1000
    seen["followed"] = editor.view.extent().center().distance(QgsPointXY(col, -row))
    editor.delete_button.click()
    yield 1500
    editor.undo()
    count = len(editor.points.points)
    editor.points._change(editor.points.off, editor.points.gone | {5})
    editor.start_adding()
    editor.click_reference(QgsPointXY(point.x, point.y))
    editor.click_target(QgsPointXY(col, -row))
    for _ in range(100):
        if len(editor.points.points) > count or "…" not in editor.told.text():
            break
        yield 100
    yield 1500
    new = editor.sorted.mapFromSource(editor.model.index(len(editor.points.points) - 1, 0))
    cells = [editor.sorted.data(new.siblingAtColumn(at)) for at in range(len(editor.model.titles))]
    in_sight = editor.table.viewport().rect().contains(editor.table.visualRect(new).center())
    seen["new row"] = [in_sight, [str(cell) for cell in cells]]
    added = editor.points.points[-1]
    seen["added"] = [
        len(editor.points.points) - count,
        math.dist(added.target_px, (col, row)),
        editor.told.text(),
    ]


def pick(canvas: Any, place: QgsPointXY) -> None:
    """Click a place on a map."""
    at = canvas.getCoordinateTransform().transform(place)
    pixel = QPoint(round(at.x()), round(at.y()))
    QTest.mouseClick(canvas.viewport(), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, pixel)


def trusted(dock: Any) -> Iterator[int]:
    """Align a layer of a GeoPackage: asked once."""
    (layer,) = add("package")
    dock.tabs.setCurrentIndex(0)
    dock.target.setLayer(layer)
    click(dock.start_button)
    yield from ended(dock)
    seen["package"] = [dock.verdict.text(), shown(dock)]
    grab(dock, "package")
    click(dock.trust_button)
    yield from ended(dock)
    seen["trusted"] = [dock.verdict.text(), shown(dock)]
    dock.open_points(JOB["points"])
    yield from ended(dock)
    seen["trusted again"] = dock.verdict.text()
    dock.tabs.setCurrentIndex(1)
    yield from editable(dock)
    seen["edits the trusted"] = dock.editor.isEnabled()


def dialogs() -> Iterator[int]:
    """Look whether the dialogs of the toolbox show their parameters without a scroll to the right."""
    seen["clipped"] = {}
    for name in ("register", "qa", "stack", "installengine", "watch", "rig"):
        dialog = processing.createAlgorithmDialog(f"pcwlad_geo:{name}", {})
        dialog.show()
        yield 500
        bars = [area.horizontalScrollBar() for area in dialog.findChildren(QScrollArea) if area.isVisible()]
        seen["clipped"][name] = max(bar.maximum() for bar in bars)
        grab(dialog, f"dialog_{name}")
        dialog.close()


def opened(dock: Any) -> Iterator[int]:
    """Open a registration whose layers are in the project: nothing comes twice."""
    count, groups = len(PROJECT.mapLayers()), len(PROJECT.layerTreeRoot().findGroups())
    dock.open_earlier(str(dock._folder))
    yield 500
    seen["with points"] = dock.no_points_label.isVisibleTo(dock.points_page)
    seen["opened"] = [len(PROJECT.mapLayers()) - count, len(PROJECT.layerTreeRoot().findGroups()) - groups]
    rules = dock.layers["displacements"].renderer().rootRule().children()
    seen["legends"] = [dock.layers["tie_points"].renderer().type(), [each.label() for each in rules]]


def themes(dock: Any) -> Iterator[int]:
    """Look at verdicts on a light and on a dark window."""
    seen["themes"] = {}
    for theme in ("default", "Night Mapping"):
        QgsApplication.setUITheme(theme)
        yield 1000
        dock.footer.clear()
        for grade in ("good", "fair", "poor", "refused"):
            dock.footer.tell("The layers fit: 90 %", grade=grade)
        yield 500
        corner = dock.verdict.mapTo(dock, QPoint(dock.verdict.width() - 3, 3))
        ground = dock.grab().toImage().pixelColor(corner).name()
        seen["themes"][theme] = [ground, re.findall(r"color: (#\w+)", dock.verdict.text())]
        grab(dock, f"theme_{theme[:5]}")


def closing(dock: Any) -> Iterator[int]:
    """Close the dock with edits and without; save the project; begin another."""
    editor = dock.editor  # its page is shown
    yield from editable(dock)
    editor.switch([3], False)
    yield 500
    dock.close()
    yield 300
    dock.show()
    seen["edits"] = [dock.editor is editor, 3 in editor.points.off]
    place = FOLDER / "saved.qgs"
    PROJECT.write(str(place))
    seen["saved"] = "Tie points being edited" in place.read_text(encoding="utf-8")
    PROJECT.clear()
    yield 500
    seen["without points again"] = dock.no_points_label.isVisibleTo(dock.points_page)
    seen["new project"] = [dock.verdict.text(), dock.editor is None, shown(dock), dock.layers == {}]


go(steps)
