"""What a user does with points that a hand has made in the Georeferencer: ``qgis --code points.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `points`, `nonsense` (no points) and `folder`.
"""

from __future__ import annotations

from collections.abc import Iterator

from qgis.utils import plugins
from steps import JOB, add, begin, editable, ended, go, opened, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    begin()
    yield from opened(add("reference", "target")[1], 560)
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


go(steps)
