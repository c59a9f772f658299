"""What goes wrong around the dock: engines that do not fit, layers that leave: ``qgis --code trouble.py``.

WINDOW_JOB names a JSON file: `reference`, `target`, `engines` (paths by name), `empty` and `index`
(folders that stand for package indexes), `wheel`, `python` (to install with), and `folder`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from processing.core.ProcessingConfig import ProcessingConfig
from qgis.PyQt.QtCore import Qt
from qgis.utils import plugins
from steps import JOB, add, begin, ended, go, grab, opened, seen


def steps() -> Iterator[int]:
    """Do one thing after the other; yield how many milliseconds it may take."""
    begin()
    yield from opened(add("reference", "target")[1], 430)
    plugin = plugins["pcwlad_geo_qgis"]
    for name, path in JOB["engines"].items():
        yield from engine(plugin.dock, name, path)
    grab(plugin.dock, "engine")
    seen["rich"] = plugin.dock.verdict.textFormat() == Qt.TextFormat.RichText
    flags = plugin.dock.verdict.textInteractionFlags()
    seen["selectable"] = bool(flags & Qt.TextInteractionFlag.TextSelectableByMouse)
    yield from install(plugin.dock)


def engine(dock: Any, name: str, path: str) -> Iterator[int]:
    """Start with an engine that does not do; cancel where it hangs."""
    ProcessingConfig.settings["PCWLAD_GEO_ENGINE"].value = path  # it may be gone: the dialog refuses it
    dock.start()
    yield 300
    if name == "hangs":
        dock.cancel_button.click()
    yield from ended(dock)
    offer = dock.index_button
    seen[name] = {
        "ready": dock.start_button.isEnabled(),
        "cancel": dock.cancel_button.isEnabled(),
        "verdict": dock.verdict.text(),
        "offer": offer.text() if offer.isVisible() else "",
        "stage": dock.stage.text(),
    }


def install(dock: Any) -> Iterator[int]:
    """Install an engine from an index that has none, from one that has one, and from a wheel."""
    ProcessingConfig.settings["PCWLAD_GEO_ENGINE"].value = ""
    os.environ.pop("PCWLAD_GEO_PYTHON")
    dock.start()
    yield 500
    seen["none"] = {"verdict": dock.verdict.text(), "offer": dock.index_button.text()}
    grab(dock, "no_engine")
    percent: list[int] = []
    stages: list[str] = []
    dock._runner.progress.connect(percent.append)
    dock._runner.stage.connect(stages.append)
    os.environ.update(PIP_NO_INDEX="1", PIP_FIND_LINKS=JOB["empty"])
    dock.index_button.click()
    yield from ended(dock)
    seen["failed"] = {"verdict": dock.verdict.text(), "offered": dock.index_button.isVisible()}
    os.environ["PIP_FIND_LINKS"] = JOB["index"]
    said, tell = [], dock.footer.tell
    dock.footer.tell = lambda message, *how, **more: (said.append(message), tell(message, *how, **more))
    dock.index_button.click()
    seen["installing"] = [dock.start_button.isEnabled(), dock.cancel_button.isEnabled()]
    yield from ended(dock)
    yield from ended(dock)  # what “Align” was pressed for goes on
    seen["installed"] = {"said": said, "offered": dock.index_button.isVisible()}
    seen["percent"], seen["stages"] = max(percent), list(stages)
    grab(dock, "installed")
    dock.install({"WHEEL": JOB["wheel"], "PYTHON": JOB["python"]})
    yield from ended(dock)
    seen["from a wheel"] = dock.verdict.text()
    dock.install({"WHEEL": JOB["wheel"], "PYTHON": JOB["python"]})
    yield 300
    dock.cancel_button.click()
    yield from ended(dock)
    seen["cancelled"] = dock.verdict.text()


go(steps)
