"""The plugin under PyQt6, with QGIS stood in for: modules import, forms, dock and table work.

In a process of its own, as no process can hold both the real QGIS and what stands for it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
pytest.importorskip("PyQt6.QtWidgets", reason="PyQt6 is not installed", exc_type=ImportError)
BEGIN = """
import qt6_stubs
qt6_stubs.install()
from qgis import core, gui
from qgis.PyQt import QtCore, QtGui, QtTest, QtWidgets
application = QtWidgets.QApplication([])
assert QtCore.PYQT_VERSION_STR.startswith("6.")
"""


def run(code: str) -> str:
    """Run code under PyQt6 and return what it prints."""
    places = [str(REPOSITORY / "qgis_plugin"), str(Path(__file__).parent)]
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "PYTHONPATH": os.pathsep.join(places)}
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning", "-c", BEGIN + code],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_all_modules_import_and_none_needs_qt5() -> None:
    printed = run("""
import importlib, sys
from pathlib import Path
import pcwlad_geo_qgis
root = Path(pcwlad_geo_qgis.__file__).parent
paths = [path.relative_to(root).with_suffix("") for path in root.rglob("*.py")]
names = [".".join(["pcwlad_geo_qgis", *path.parts]) for path in paths]
for name in names:
    importlib.import_module(name.removesuffix(".__init__"))
assert not any(name.startswith("PyQt5") for name in sys.modules)
print(len(names))
""")
    assert int(printed) > 30


def test_the_dock_is_built_and_tells_a_verdict() -> None:
    run("""
from pcwlad_geo_qgis.widgets.align_dock import AlignDock

class Window(qt6_stubs.Stub):
    window = QtWidgets.QMainWindow()
    canvas = gui.QgsMapCanvas()
    mainWindow = lambda self: self.window
    mapCanvas = lambda self: self.canvas

dock = AlignDock(Window())
assert dock.tabs.count() >= 4
dock.show()
dock.footer.tell("The layers fit well: 90 % of it.", grade="good", more=["Tie points: 12", ""])
assert "✔ The layers fit well" in dock.verdict.text()
assert not dock.verdict_area.isHidden()
dock._offer(running=True)
assert dock.cancel_button.isEnabled() and not dock.start_button.isEnabled()
dock._offer(running=False)
assert dock.start_button.isEnabled() and dock.run_box.isHidden()
dock.grab()
""")


def test_every_form_is_loaded() -> None:
    run("""
from pathlib import Path
import pcwlad_geo_qgis
from qgis.PyQt import uic
forms = sorted(Path(pcwlad_geo_qgis.__file__).parent.rglob("*.ui"))
assert len(forms) >= 3
for form in forms:
    assert uic.loadUi(str(form)).layout() is not None or form.stem == "align"
""")


def test_boxes_numbers_and_keys_of_the_table() -> None:
    run("""
from pcwlad_geo_qgis.process.points import Point, Points
from pcwlad_geo_qgis.widgets.points_table import PointsModel, SortedPoints
points = Points([Point(n, 1.0, 2.0, (3.0, 4.0), 0.1, "fit", (0.1 * n, 0.0)) for n in range(3)])
class Place:
    x = y = lambda self: 5.0
model = PointsModel(points, lambda row: Place())
table = QtWidgets.QTableView()
sorted_points = SortedPoints(points, model, table)
table.setModel(sorted_points)
heard = []
model.switched.connect(lambda row, on: heard.append((row, on)))
box = model.index(1, 0)
assert model.data(box, QtCore.Qt.ItemDataRole.CheckStateRole) == QtCore.Qt.CheckState.Checked
assert model.setData(box, QtCore.Qt.CheckState.Unchecked.value, QtCore.Qt.ItemDataRole.CheckStateRole)
assert heard == [(1, False)]
right = model.data(model.index(1, 8), QtCore.Qt.ItemDataRole.TextAlignmentRole)
assert right & QtCore.Qt.AlignmentFlag.AlignRight
assert model.data(model.index(1, 8)) == "0.100"
points.points[0].sigma_px = float("nan")
assert model.data(model.index(0, 9)) == "–"
table.sortByColumn(8, QtCore.Qt.SortOrder.DescendingOrder)
assert sorted_points.mapToSource(sorted_points.index(0, 0)).row() == 2
""")
