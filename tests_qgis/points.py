"""What a user does with points that a hand has made in the Georeferencer: ``qgis --code points.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `points`, `nonsense` (no points) and `folder`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from qgis.utils import iface, plugins
from steps import JOB, add, begin, editable, ended, go, grab, opened, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    window, layers = begin(), add("reference", "target")
    yield from opened(layers[1], 560)
    dock = plugins["pcwlad_geo_qgis"].dock
    dock.tabs.setCurrentWidget(dock.points_page)
    dock.open_points(JOB["nonsense"])
    yield from ended(dock)
    seen["nonsense"] = dock.verdict.text()
    dock.choices.set("MODEL", 2)
    dock.open_points(JOB["points"])
    yield from ended(dock)
    seen["verdict"] = dock.verdict.text()
    seen["page"] = dock.tabs.currentWidget() is dock.points_page
    editor = dock.editor
    yield from editable(dock)
    seen["rmse"] = [editor.points.rmse_px["affine"]]
    seen["rows"] = [editor.sorted.rowCount()]
    seen["off"] = sorted(editor.points.off)
    editor.live_button.click()
    iface.mapCanvas().setExtent(layers[0].extent())
    yield 2000
    grab(window, "live")
    seen["live"] = [put(editor)]
    editor.switch(editor.points.off, True)
    yield 1500
    seen["live"].append(put(editor))
    grab(window, "live_wrong")
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
    seen["live"].append(put(editor))
    seen["rmse"].append(editor.points.rmse_px["affine"])
    seen["rows"].append(editor.sorted.rowCount())
    seen["undone"] = 0
    while editor.points.can_undo:
        editor.undo()
        seen["undone"] += 1
        yield 300
    yield 1500
    seen["rmse"].append(editor.points.rmse_px["affine"])
    seen["live"].append(put(editor))
    editor.models.setCurrentIndex(editor.models.findData("shift"))
    yield 1500
    seen["live_shift"] = list(editor.live.ghost.placement.now)
    dock.tabs.setCurrentIndex(0)
    yield 300
    dock.tabs.setCurrentWidget(dock.points_page)
    seen["live_left"] = [editor.live.ghost is None, editor.live_button.isChecked()]
    editor.live_button.click()
    editor.points.delete(range(len(editor.points.points)))
    editor.live.follow()
    seen["live_without_points"] = editor.live.ghost.isVisible()
    dock.close_all()
    seen["live_closed"] = [type(each).__name__ for each in iface.mapCanvas().scene().items()].count("Ghost")


def put(editor: Any) -> list[float]:
    """Return by how much the live layer is moved in the middle, map units, and what it is scaled by."""
    placement = editor.live.ghost.placement
    left, low, right, high = placement.box
    x, y = placement.centre
    return [x - (left + right) / 2, y - (low + high) / 2, placement.now[1], placement.now[5]]


go(steps)
