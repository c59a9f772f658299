"""What a user does with points that a hand has made in the Georeferencer: ``qgis --code points.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `points`, `nonsense` (no points) and `folder`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from qgis.core import QgsProject, QgsRasterLayer
from qgis.PyQt.QtCore import Qt
from qgis.PyQt.QtWidgets import QDockWidget
from qgis.utils import iface, plugins
from steps import JOB, go, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds to wait."""
    window = iface.mainWindow()
    window.resize(1400, 900)
    for name in ("Browser", "ProcessingToolbox"):
        window.findChild(QDockWidget, name).close()
    layers = [QgsRasterLayer(JOB[name], Path(JOB[name]).stem) for name in ("reference", "target")]
    QgsProject.instance().addMapLayers(layers)
    iface.setActiveLayer(layers[1])
    plugin = plugins["pcwlad_geo_qgis"]
    plugin.action.trigger()
    yield 800
    dock = plugin.dock
    window.resizeDocks([dock], [560], Qt.Orientation.Horizontal)
    dock.tabs.setCurrentWidget(dock.points_page)
    dock.open_points(JOB["nonsense"])
    yield from wait(dock)
    seen["nonsense"] = dock.verdict.text()
    dock.choices.set("MODEL", 2)
    dock.open_points(JOB["points"])
    yield from wait(dock)
    seen["verdict"] = dock.verdict.text()
    seen["page"] = dock.tabs.currentWidget() is dock.points_page
    editor = dock.editor
    while not editor.isEnabled():
        yield 100
    yield 2000
    seen["rmse"] = [editor.points.rmse_px["affine"]]
    seen["rows"] = [editor.sorted.rowCount()]
    seen["off"] = sorted(editor.points.off)
    editor.switch(editor.points.off, True)
    yield 1500
    seen["rmse"].append(editor.points.rmse_px["affine"])
    for _ in range(2):
        editor.improve_button.click()  # the second press does nothing
    while not editor.improve_button.isEnabled():
        yield 200
    yield 2500
    seen["told"] = editor.told.text()
    seen["chosen"] = [editor.points.points[row].number for row in editor.selected()]
    editor.delete_button.click()
    yield 2000
    seen["rmse"].append(editor.points.rmse_px["affine"])
    seen["rows"].append(editor.sorted.rowCount())
    seen["undone"] = 0
    while editor.points.can_undo:
        editor.undo()
        seen["undone"] += 1
        yield 300
    yield 1500
    seen["rmse"].append(editor.points.rmse_px["affine"])
    dock.close_all()


def wait(dock: Any) -> Iterator[int]:
    """Wait for the end of the work."""
    while not dock.start_button.isEnabled():
        yield 200
    yield 1000


go(steps)
