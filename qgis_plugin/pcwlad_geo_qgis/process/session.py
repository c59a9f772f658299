"""A warm engine that refits tie points while a user edits them: requests out, answers when they come."""

from __future__ import annotations

import json
import queue
import subprocess
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..text import tr
from .advice import for_dialog
from .child import hidden_window
from .engine import Engine, EngineError

GRACE_S = 2.0


class Session:
    """A running `pcwlad-geo edit`; never waits, but for its end."""

    def __init__(self, engine: Engine, folder: Path, variables: Mapping[str, str] | None = None) -> None:
        try:
            self._child = subprocess.Popen(
                [*engine.command, "edit", str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=engine.environment(variables),
                cwd=folder,
                **hidden_window(),
            )
        except OSError as error:
            raise EngineError(tr("The engine does not start: {}").format(error)) from error
        self._heard: queue.Queue[dict[str, Any]] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def ask(self, what: str, **values: object) -> None:
        """Send a request; an engine that has ended says so among its answers."""
        with suppress(OSError, ValueError):
            self._child.stdin.write((json.dumps({"do": what, **values}) + "\n").encode())
            self._child.stdin.flush()

    def answers(self) -> list[dict[str, Any]]:
        """Return what was answered since the last call."""
        found = []
        with suppress(queue.Empty):
            while True:
                found.append(self._heard.get_nowait())
        return found

    def close(self) -> None:
        """End the engine."""
        with suppress(OSError):
            self._child.stdin.close()
        try:
            self._child.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()

    def _listen(self) -> None:
        with self._child.stdout as stream:
            for line in stream:
                with suppress(ValueError):
                    answer = json.loads(line)
                    if "message" in answer:
                        answer["message"] = for_dialog(answer["message"])
                    self._heard.put(answer)
        self._heard.put({"event": "ended"})
