"""What the scripts in the window of QGIS share: steps with pauses, pictures, and what was seen.

A step yields how many milliseconds QGIS may take for what it began: the next step comes once QGIS has nothing
to do any more, or when the time is over.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from qgis.core import QgsApplication, QgsProject, QgsRasterLayer
from qgis.gui import QgsMapCanvas
from qgis.PyQt.QtCore import Qt, QTimer
from qgis.PyQt.QtWidgets import QApplication, QDockWidget, QWidget
from qgis.utils import iface, plugins

JOB = json.loads(Path(os.environ["WINDOW_JOB"]).read_text(encoding="utf-8"))
FOLDER = Path(JOB["folder"])
LIMIT_MS = 500_000
START_S = 10.0
"""QGIS may take so long until its window is there."""
LOOK_MS = 25
"""How often it is looked whether QGIS has anything to do."""
QUIET_LOOKS = 4
"""So many looks in a row that find nothing to do: one thing may begin another."""
seen: dict[str, Any] = {"modal": [], "errors": [], "done": False}
wanted: list[str] = []
"""Classes of dialogs that a step opens itself."""
more_maps: list[QgsMapCanvas] = []
"""Maps beside those of the window and the dock, to be waited for."""
_kept: list[object] = []


def grab(widget: QWidget, name: str) -> None:
    """Save a picture of a widget."""
    widget.grab().save(str(FOLDER / f"{name}.png"))


def begin(width: int = 1400, height: int = 900) -> QWidget:
    """Return the main window, of a size and without the docks of QGIS."""
    window = iface.mainWindow()
    window.resize(width, height)
    for name in ("Browser", "ProcessingToolbox"):
        window.findChild(QDockWidget, name).close()
    return window


def add(*names: str) -> list[QgsRasterLayer]:
    """Add rasters of the job to the project, named as their files."""
    layers = [QgsRasterLayer(JOB[name], Path(JOB[name]).stem) for name in names]
    QgsProject.instance().addMapLayers(layers)
    return layers


def opened(layer: QgsRasterLayer, width: int) -> Iterator[int]:
    """Open the dock for a layer, so wide."""
    iface.setActiveLayer(layer)
    plugin = plugins["pcwlad_geo_qgis"]
    plugin.action.trigger()
    yield 1000
    iface.mainWindow().resizeDocks([plugin.dock], [width], Qt.Orientation.Horizontal)
    iface.messageBar().clearWidgets()
    yield 1000


def ended(dock: Any) -> Iterator[int]:
    """Wait until nothing runs any more, and what came of it is shown."""
    yield 500
    while dock._runner.running:
        yield 100
    yield 1500
    iface.messageBar().clearWidgets()  # QGIS tells of each task that has ended


def editable(dock: Any) -> Iterator[int]:
    """Wait until points can be edited, or until the engine has said why not."""
    while not dock.editor.isEnabled() and "starting" in dock.editor.told.text():
        yield 100
    yield 3000


def busy() -> bool:
    """Return whether QGIS has anything to do: tasks, maps to draw, an engine to hear."""
    dock = getattr(plugins.get("pcwlad_geo_qgis"), "dock", None)
    if not iface.mainWindow().isVisible() or QgsApplication.taskManager().countActiveTasks() > 0:
        return True
    if dock is not None and _dock_is_busy(dock):
        return True
    maps = [iface.mapCanvas(), *more_maps]
    if dock is not None and dock.editor is not None:
        maps.append(dock.editor.view)
    if any(each.isDrawing() for each in maps):
        return True
    # last, as it looks at every child: most looks come while an engine works, and others want the processor
    timers = [timer for each in maps for timer in each.findChildren(QTimer) if timer.isSingleShot()]
    return any(timer.isActive() for timer in timers)


def _dock_is_busy(dock: Any) -> bool:
    """Return whether the dock draws beside the maps, or waits for an engine."""
    editor = dock.editor
    asked = editor is not None and (editor._shown_number < editor._number or "…" in editor.told.text())
    used = editor is not None and editor._using is not None
    starts = editor is not None and not editor.isEnabled()  # that may take longer than anything it is asked
    drawn = sys.modules["pcwlad_geo_qgis.widgets.drawing"].running
    return dock._runner.running or used or bool(drawn) or (asked and not starts)


def _watch() -> None:
    """Note every dialog that asks something."""
    dialog = QApplication.activeModalWidget()
    if dialog is not None and dialog.metaObject().className() not in wanted:
        seen["modal"].append(f"{dialog.metaObject().className()}: {dialog.windowTitle()}")


def _write() -> None:
    """Write what was seen so far: a QGIS that crashes tells nothing later."""
    (FOLDER / "seen.json").write_text(json.dumps(seen, ensure_ascii=False, default=str), encoding="utf-8")


def _end(error: str = "") -> None:
    """Write what was seen, and leave at once."""
    seen["error"] = error
    _write()
    os._exit(0)


def _go_on(script: Iterator[int], until: float = 0.0, quiet: int = 0) -> None:
    """Do the next step once QGIS is quiet, or when its time is over."""
    try:
        if time.monotonic() < until and quiet < QUIET_LOOKS:
            quiet = 0 if busy() else quiet + 1
        else:
            until, quiet = time.monotonic() + next(script) / 1000, 0
            _write()
    except StopIteration:
        seen["done"] = True
        _end()
    except Exception:
        _end(traceback.format_exc())
    rest_ms = math.ceil(1000 * max(0.0, until - time.monotonic()))
    QTimer.singleShot(min(LOOK_MS, rest_ms), lambda: _go_on(script, until, quiet))


def go(steps: Callable[[], Iterator[int]]) -> None:
    """Do the steps, and end QGIS."""
    # what a slot raises is told to no one who called it
    sys.excepthook = lambda *error: seen["errors"].append("".join(traceback.format_exception(*error)))
    watcher = QTimer()
    watcher.timeout.connect(_watch)
    watcher.start(100)
    _kept.append(watcher)
    QTimer.singleShot(LIMIT_MS, lambda: _end("the time is over"))
    QTimer.singleShot(0, lambda: _go_on(steps(), time.monotonic() + START_S))
