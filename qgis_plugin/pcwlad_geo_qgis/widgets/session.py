"""A warm engine that refits tie points while a user edits them: requests out, answers when they come."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from qgis.PyQt.QtCore import QProcess, QProcessEnvironment, QTimer, pyqtSignal

from ..process.advice import for_dialog
from ..process.engine import Engine

GRACE_MS = 2000
_ending: list[Session] = []
"""Those that were told to end and have not yet: to delete one is to wait for it."""


class Session(QProcess):
    """`pcwlad-geo edit`, once it is started; never waits."""

    answered = pyqtSignal(dict)
    """What the engine says; the last one is the event `ended`."""

    def __init__(self, engine: Engine, folder: Path, options: Sequence[str]) -> None:
        super().__init__()
        environment = QProcessEnvironment()
        for name, value in engine.environment().items():
            environment.insert(name, value)
        self.setProcessEnvironment(environment)
        self.setWorkingDirectory(str(folder))
        self.setStandardErrorFile(QProcess.nullDevice())
        self.readyReadStandardOutput.connect(self._hear)
        self.stateChanged.connect(self._told)
        self.setProgram(engine.command[0])
        self.setArguments([*engine.command[1:], "edit", str(folder), *options])

    def ask(self, what: str, **values: object) -> None:
        """Send a request; an engine that has ended says so among its answers."""
        self.write((json.dumps({"do": what, **values}) + "\n").encode())

    def end(self) -> None:
        """End the engine, in the background: it may be busy, or only starting."""
        self.answered.disconnect()
        if self.state() == self.ProcessState.NotRunning:
            return
        self.setParent(None)
        _ending.append(self)
        self.finished.connect(self._leave)
        self.closeWriteChannel()
        QTimer.singleShot(GRACE_MS, self.kill)

    def _leave(self) -> None:
        _ending.remove(self)
        self.deleteLater()

    def _hear(self) -> None:
        while self.canReadLine():
            with suppress(ValueError):
                answer = json.loads(bytes(self.readLine()).decode("utf-8", "replace"))
                if "message" in answer:
                    answer["message"] = for_dialog(answer["message"])
                self.answered.emit(answer)

    def _told(self, state: QProcess.ProcessState) -> None:
        if state == QProcess.ProcessState.NotRunning:
            self.answered.emit({"event": "ended"})
