"""What a user does to bring a layer onto a web map in the window of QGIS: ``qgis --code basemap.py``.

WINDOW_JOB names a JSON file: `target`, `tiles` (the layer of a server), `pulse` (a file that grows whenever
the window turns, while the map is drawn), `folder` for pictures and `seen.json`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from qgis.core import QgsProject, QgsRasterLayer, QgsRectangle, QgsVector
from qgis.PyQt.QtCore import QTimer
from qgis.utils import iface, plugins
from steps import JOB, begin, go, grab, opened, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window = begin()
    layers = [QgsRasterLayer(JOB["tiles"], "Luftbild", "wms"), QgsRasterLayer(JOB["target"], "thermal")]
    QgsProject.instance().addMapLayers(layers)
    yield from opened(layers[1], 420)
    dock = plugins["pcwlad_geo_qgis"].dock
    iface.zoomToActiveLayer()
    yield 2000
    seen["preset"] = dock.reference.currentText()
    dock.tabs.setCurrentWidget(dock.place)
    seen["heading"] = dock.place.heading.text()
    dock.tabs.setCurrentIndex(0)
    grab(window, "basemap_before")
    beats: list[tuple[float, str]] = []
    pulse, turns = QTimer(), Path(JOB["pulse"])

    def beat() -> None:
        beats.append((time.thread_time(), dock.footer.stage.text()))
        with turns.open("ab") as file:
            file.write(b".")

    pulse.timeout.connect(beat)
    pulse.start(20)
    dock.start_button.click()
    groups = QgsProject.instance().layerTreeRoot()
    while not groups.findGroup("thermal aligned") and dock.cancel_button.isEnabled():
        if "Drawing" in dock.footer.stage.text() and "stage" not in seen:
            seen["stage"] = dock.footer.stage.text()
            grab(window, "basemap_drawing")
            iface.mapCanvas().setExtent(QgsRectangle(-2e7, -2e7, 2e7, 2e7))
        yield 100
    pulse.stop()
    turns.unlink()  # what asks for tiles from now on need not wait
    drawing = [spent for spent, stage in beats if "Drawing" in stage]
    seen["turns"] = len(drawing)
    seen["longest_ms"] = 1000 * max(b - a for a, b in zip(drawing, drawing[1:]))  # noqa: RUF007  # Python 3.9
    yield 2500
    seen["seen"] = iface.mapCanvas().extent().width()
    dock.tabs.setCurrentIndex(2)
    dock.red_cyan_button.click()
    yield 2500
    seen["red and cyan"] = dock.views.composite._curtain is not None
    yield from pans(dock, turns, pulse)
    dock.tabs.setCurrentIndex(0)
    seen["verdict"] = dock.footer.verdict.text()
    seen["layers"] = sorted(each.name() for each in QgsProject.instance().mapLayers().values())
    grab(window, "basemap_after")


def pans(dock: Any, turns: Path, pulse: QTimer) -> Iterator[int]:
    """Move the map on while the tiles of the last move are awaited, and come back, in two ways to look."""
    canvas, start = iface.mapCanvas(), iface.mapCanvas().extent()
    running = sys.modules["pcwlad_geo_qgis.widgets.drawing"].running
    dock.with_reference.setChecked(True)
    for button in (dock.red_cyan_button, dock.swipe_button):
        button.setChecked(True)
        turns.touch()
        pulse.start(20)
        for part in (1, 2, 0):  # beyond the edges, where tiles are missing
            extent = QgsRectangle(start)
            extent += QgsVector(part * start.width() / 3, 0)
            canvas.setExtent(extent)
            time.sleep(0.2)  # the tiles are asked for, and the window has not turned
        seen.setdefault("given up", []).append(len(running))  # no job is waited for
        yield 2500
        pulse.stop()
        turns.unlink()
    seen["swiped"] = not dock.swipe._curtain.image.isNull()
    dock.swipe_button.setChecked(False)


go(steps)
