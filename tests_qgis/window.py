"""What a user does in the window of QGIS, done by QGIS itself: ``qgis --code window.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `load` (results to open) and `folder`, where the
pictures and `seen.json` go.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import processing
from qgis.core import QgsProject, QgsRasterLayer, QgsVectorLayer
from qgis.gui import QgsMapCanvas
from qgis.PyQt.QtCore import Q_ARG, QMetaObject, Qt, QTimer
from qgis.PyQt.QtWidgets import (
    QAction,
    QApplication,
    QComboBox,
    QDockWidget,
    QLineEdit,
    QTableView,
    QTreeView,
    QTreeWidget,
    QWidget,
)
from qgis.utils import iface
from steps import JOB, add, go, grab, more_maps, seen, wanted


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window = iface.mainWindow()
    window.resize(1400, 860)
    layers = add("reference", "target")
    yield 1500
    yield from toolbox(window)
    yield from look("prove", layers)
    yield from run(window, layers)
    yield from load()
    yield from georeferencer(window)


def toolbox(window: QWidget) -> Iterator[int]:
    """Show the algorithms."""
    dock = window.findChild(QDockWidget, "ProcessingToolbox")
    dock.show()
    yield 500
    dock.findChild(QLineEdit).setText("pcwlad")
    yield 500
    tree = dock.findChild(QTreeView)
    tree.expandAll()
    dock.resize(340, 420)
    yield 500
    seen["algorithms"] = names_in(tree)
    grab(dock, "toolbox")


def names_in(tree: QTreeView) -> list[str]:
    """Return the texts of a tree, two levels below its top."""
    model, found = tree.model(), []
    for top in range(model.rowCount()):
        provider = model.index(top, 0)
        for row in range(model.rowCount(provider)):
            group = model.index(row, 0, provider)
            found += [model.data(model.index(each, 0, group)) for each in range(model.rowCount(group))]
    return found


def look(name: str, layers: list[QgsRasterLayer]) -> Iterator[int]:
    """Open the dialog of an algorithm on a pair and look at it."""
    dialog = processing.createAlgorithmDialog(
        f"pcwlad_geo:{name}", {"REFERENCE": layers[0].id(), "INPUT": layers[1].id()}
    )
    dialog.resize(980, 700)
    dialog.show()
    yield 1000
    grab(dialog, name)
    dialog.close()


def run(window: QWidget, layers: list[QgsRasterLayer]) -> Iterator[int]:
    """Open the dialog, run, look at the map and the Results Viewer."""
    dialog = processing.createAlgorithmDialog(
        "pcwlad_geo:register", {"REFERENCE": layers[0].id(), "INPUT": layers[1].id()}
    )
    dialog.resize(980, 700)
    dialog.show()
    yield 1000
    grab(dialog, "dialog")
    finished: list[bool] = []
    dialog.algorithmFinished.connect(lambda done, results: finished.append(done))
    dialog.runAlgorithm()
    while not finished:
        yield 200
    yield 2000
    dialog.close()
    seen["finished"] = finished
    by_name = {layer.name(): layer for layer in QgsProject.instance().mapLayers().values()}
    seen["layers"] = sorted(by_name)
    points = by_name["Tie points"]
    seen["renderer"] = points.renderer().type()
    categories = points.renderer().categories()  # kept: its symbols go with it
    seen["arrows"] = categories[0].symbol().symbolLayer(1).layerType()
    window.findChild(QDockWidget, "Browser").close()
    iface.messageBar().clearWidgets()
    iface.setActiveLayer(points)
    iface.zoomToActiveLayer()
    yield 2500
    grab(window, "result")
    results = window.findChild(QDockWidget, "ResultsDock") or next(
        dock for dock in window.findChildren(QDockWidget) if "esult" in dock.windowTitle()
    )
    results.show()
    results.raise_()
    yield 500
    starts = Qt.MatchFlag.MatchStartsWith | Qt.MatchFlag.MatchRecursive
    found = results.findChild(QTreeWidget).findItems("Report", starts)
    seen["results"] = [item.text(0) for item in found]


def load() -> Iterator[int]:
    """Open results as a user would, and note their CRS."""
    seen["crs"] = {}
    for path in JOB["load"]:
        if path.endswith(".gpkg"):
            layers = [
                QgsVectorLayer(f"{path}|layername={name}", name) for name in ("tie_points", "displacements")
            ]
        else:
            layers = [iface.addRasterLayer(path)]
        for layer in layers:
            QgsProject.instance().addMapLayer(layer)
            seen["crs"][f"{Path(path).name} {layer.name()}"] = layer.crs().authid()
        yield 400


def georeferencer(window: QWidget) -> Iterator[int]:
    """Open the target in the Georeferencer: its `.points` lie beside it; fit a polynomial of first order."""
    window.findChild(QAction, "mActionShowGeoreferencer").trigger()
    yield 1000
    tool = next(w for w in QApplication.topLevelWidgets() if "Georef" in w.metaObject().className())
    tool.resize(1200, 800)
    more_maps.extend(tool.findChildren(QgsMapCanvas))
    if tool.metaObject().indexOfMethod("openRaster(QString)") < 0:  # newer ones take a file by a dialog only
        return
    QMetaObject.invokeMethod(
        tool, "openRaster", Qt.ConnectionType.DirectConnection, Q_ARG(str, JOB["target"])
    )
    yield 1500
    wanted.append("QgsTransformSettingsDialog")
    QTimer.singleShot(800, choose_polynomial)
    QMetaObject.invokeMethod(tool, "getTransformSettings", Qt.ConnectionType.DirectConnection)
    yield 1500
    table = next(view for view in tool.findChildren(QTableView) if "GCP" in view.metaObject().className())
    model = table.model()
    horizontal = Qt.Orientation.Horizontal
    seen["header"] = [model.headerData(col, horizontal) for col in range(model.columnCount())]
    seen["points"] = [
        [model.data(model.index(row, col)) for col in range(1, model.columnCount())]
        for row in range(model.rowCount())
    ]
    seen["enabled"] = [
        model.data(model.index(row, 0), Qt.ItemDataRole.CheckStateRole) for row in range(model.rowCount())
    ]
    tool.statusBar().hide()  # it holds a path of this machine
    grab(tool, "georeferencer")


def choose_polynomial() -> None:
    """Choose the transformation in the dialog that is open now."""
    dialog = QApplication.activeModalWidget()
    kinds = dialog.findChild(QComboBox, "cmbTransformType")
    kinds.setCurrentIndex(kinds.findText("Polynomial 1"))
    dialog.accept()


go(steps)
