"""The engine's side of the conversation: JSON lines in, progress and a result out."""

from __future__ import annotations

import json
import shlex
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from qgis.core import QgsProcessingException, QgsProcessingFeedback

from .child import follow
from .engine import Engine
from .text import for_dialog, tr

REJECTED = 3
UNEXPECTED = 1
STDERR_LINES = 20
Shares = Mapping[str, tuple[float, float]]


class _Conversation:
    """What the engine has said so far."""

    def __init__(self, feedback: QgsProcessingFeedback, shares: Shares) -> None:
        self.last: dict[str, Any] = {}
        self.stderr: deque[str] = deque(maxlen=STDERR_LINES)
        self._feedback = feedback
        self._shares = shares
        self._stage = ""
        self._percent = 0.0

    def on_out(self, line: str) -> None:
        """Take a line of the protocol."""
        try:
            event = json.loads(line)
            kind = event["event"]
        except (ValueError, TypeError, KeyError):
            self._feedback.pushDebugInfo(line)
            return
        if kind == "progress":
            self._progress(event["stage"], event["done"], event["total"])
        elif kind == "warning":
            self._feedback.pushWarning(for_dialog(event["message"]))
        else:
            self.last = event

    def on_err(self, line: str) -> None:
        """Take a line of standard error."""
        self.stderr.append(line)
        self._feedback.pushConsoleInfo(line)

    def _progress(self, stage: str, done: int, total: int) -> None:
        if stage != self._stage:
            self._stage = stage
            self._feedback.setProgressText(_stage_text(stage))
        if stage in self._shares and total:
            first, last = self._shares[stage]
            self._percent = max(self._percent, first + (last - first) * done / total)
            self._feedback.setProgress(self._percent)


def run_engine(
    engine: Engine, arguments: Sequence[str], feedback: QgsProcessingFeedback, folder: Path, shares: Shares
) -> dict[str, Any] | None:
    """Run a command of the engine.

    Parameters
    ----------
    engine : Engine
    arguments : sequence of str
        The command and its options, without those of the protocol.
    feedback : QgsProcessingFeedback
    folder : pathlib.Path
        Working folder of the engine.
    shares : mapping
        From which to which percent of the work a stage goes.

    Returns
    -------
    dict
        The `result` event; None where the user cancelled.

    Raises
    ------
    QgsProcessingException
        If there is no result, with the engine's own message.
    """
    command = [*engine.command, *arguments, "--progress", "json", "--watch-stdin"]
    feedback.pushCommandInfo(shlex.join(command))
    said = _Conversation(feedback, shares)
    try:
        status = follow(command, feedback, said.on_out, said.on_err, folder)
    except OSError as error:
        raise QgsProcessingException(tr("The engine does not start: {}").format(error)) from error
    kind = said.last.get("event")
    if kind == "result":
        return said.last
    if feedback.isCanceled() or kind == "cancelled":
        return None
    raise QgsProcessingException(_reason(said, status))


def _reason(said: _Conversation, status: int) -> str:
    message = for_dialog(said.last.get("message", ""))
    if said.last.get("exit_status") == REJECTED:
        return tr("The pair was refused, and nothing was corrected: {}").format(message)
    if message and said.last.get("exit_status") != UNEXPECTED:
        return message
    parts = [message or tr("The engine ended with status {} and without a result.").format(status)]
    if said.stderr:
        parts += [tr("Its last lines:"), *said.stderr]
    return "\n".join(parts)


def _stage_text(stage: str) -> str:
    texts = {
        "reading": tr("Reading"),
        "prealignment": tr("Rough alignment"),
        "matching": tr("Matching"),
        "fitting": tr("Fitting the correction"),
        "writing": tr("Writing"),
        "warping": tr("Warping"),
        "pairs": tr("Pairs"),
        "rasters": tr("Rasters"),
    }
    return texts.get(stage, stage)
