"""What the scripts in the window of QGIS share: steps with pauses, pictures, and what was seen."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QWidget

JOB = json.loads(Path(os.environ["WINDOW_JOB"]).read_text(encoding="utf-8"))
FOLDER = Path(JOB["folder"])
LIMIT_MS = 500_000
seen: dict[str, Any] = {"modal": [], "errors": [], "done": False}
wanted: list[str] = []
"""Classes of dialogs that a step opens itself."""
_kept: list[object] = []


def grab(widget: QWidget, name: str) -> None:
    """Save a picture of a widget."""
    widget.grab().save(str(FOLDER / f"{name}.png"))


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


def _go_on(script: Iterator[int]) -> None:
    """Do the next step."""
    try:
        QTimer.singleShot(next(script), lambda: _go_on(script))
        _write()
    except StopIteration:
        seen["done"] = True
        _end()
    except Exception:
        _end(traceback.format_exc())


def go(steps: Callable[[], Iterator[int]]) -> None:
    """Do the steps, and end QGIS."""
    # what a slot raises is told to no one who called it
    sys.excepthook = lambda *error: seen["errors"].append("".join(traceback.format_exception(*error)))
    watcher = QTimer()
    watcher.timeout.connect(_watch)
    watcher.start(100)
    _kept.append(watcher)
    QTimer.singleShot(LIMIT_MS, lambda: _end("the time is over"))
    QTimer.singleShot(2000, lambda: _go_on(steps()))
