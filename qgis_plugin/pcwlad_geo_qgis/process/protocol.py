"""The engine's side of the conversation: JSON lines in, progress and a result out."""

from __future__ import annotations

import json
import shlex
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..help import STAGES
from ..text import tr
from .advice import for_dialog, report_in
from .child import Feedback, follow
from .engine import Engine, EngineError
from .page import translate

REJECTED = 3
UNEXPECTED = 1
STDERR_LINES = 20
PAIRS = ("register", "match", "prove")
"""Commands whose pages are those of a pair."""
Shares = Mapping[str, tuple[float, float]]
SHARES: Shares = {
    "reading": (0, 2),
    "prealignment": (2, 10),
    "matching": (10, 45),
    "refining": (45, 75),
    "fitting": (75, 85),
    "writing": (85, 100),
}
"""From which to which percent of a registration a stage goes."""
CREEP = 0.005
"""Share of the way to its next figure by which the bar goes on whenever there is no news, every `POLL_S`."""


class RunError(EngineError):
    """The engine has ended without a result; the message is its own, in the terms of QGIS."""

    def __init__(self, message: str, report: str = "") -> None:
        super().__init__(message)
        self.report = report


class _Conversation:
    """What the engine has said so far."""

    def __init__(self, feedback: Feedback, shares: Shares) -> None:
        self.last: dict[str, Any] = {}
        self.stderr: deque[str] = deque(maxlen=STDERR_LINES)
        self._feedback = feedback
        self._shares = shares
        self._stage = ""
        self._percent = self._ahead = 0.0
        self._told: set[str] = set()

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
            if event["message"] not in self._told:  # each once
                self._told.add(event["message"])
                self._feedback.pushWarning(for_dialog(event["message"]))
        else:
            self.last = event

    def on_err(self, line: str) -> None:
        """Take a line of standard error; what begins as an error is told at the end, and once."""
        self.stderr.append(line)
        if not line.startswith("error: "):
            self._feedback.pushConsoleInfo(line)

    def on_wait(self) -> None:
        """Go on towards the next figure, ever slower: the bar moves, and never says more than is done."""
        if self._percent < self._ahead:
            self._percent += CREEP * (self._ahead - self._percent)
            self._feedback.setProgress(self._percent)

    def _progress(self, stage: str, done: int, total: int) -> None:
        if stage != self._stage:
            self._stage = stage
            self._feedback.setProgressText(tr(STAGES.get(stage, stage)))
        if stage in self._shares and total:
            first, last = self._shares[stage]
            self._percent = max(self._percent, first + (last - first) * done / total)
            self._ahead = max(self._percent, first + (last - first) * min(done + 1, total) / total)
            self._feedback.setProgress(self._percent)
        if stage == "matching" and done == total and "refining" in self._shares:
            # windows are chosen first, which takes long: the engine tells the steps after that
            self._progress("refining", 0, 1)


def run_engine(
    engine: Engine,
    arguments: Sequence[str],
    feedback: Feedback,
    folder: Path,
    shares: Shares = SHARES,
    variables: Mapping[str, str] | None = None,
) -> dict[str, Any] | None:
    """Run a command of the engine.

    Parameters
    ----------
    engine : Engine
    arguments : sequence of str
        The command and its options, without those of the protocol.
    feedback
        Is told how the work goes, and asked whether the user has cancelled.
    folder : pathlib.Path
        Working folder of the engine.
    shares : mapping
        From which to which percent of the work a stage goes.
    variables : mapping, optional
        More variables of its environment, such as those of a proxy.

    Returns
    -------
    dict
        The `result` event; None where the user cancelled.

    Raises
    ------
    RunError
        If there is no result, with the engine's own message.
    """
    command = [*engine.command, *arguments, "--progress", "json", "--watch-stdin"]
    feedback.pushCommandInfo(shlex.join(command))
    said = _Conversation(feedback, shares)
    try:
        where = {"environment": engine.environment(variables), "on_wait": said.on_wait}
        status = follow(command, feedback, said.on_out, said.on_err, folder, **where)
    except OSError as error:
        raise RunError(tr("The engine does not start: {}").format(error)) from error
    kind, refused = said.last.get("event"), report_in(said.last.get("message", ""))
    if arguments and arguments[0] in PAIRS:
        for path in [refused, *said.last.get("paths", {}).values()]:
            if str(path).endswith(".html"):
                translate(folder / path)
    if kind == "result":
        return said.last
    if feedback.isCanceled() or kind == "cancelled":
        return None
    raise RunError(_reason(said, status), refused)


def _reason(said: _Conversation, status: int) -> str:
    message = for_dialog(said.last.get("message", ""))
    if said.last.get("exit_status") == REJECTED:
        return tr("The pair was refused, and nothing was corrected: {}").format(message)
    if message and said.last.get("exit_status") != UNEXPECTED:
        return message
    parts = [message or tr("The engine ended with status {} and without a result.").format(status)]
    lines = [line for line in said.stderr if line != f"error: {said.last.get('message')}"]
    parts += [tr("Its last lines:"), *lines] if lines else []
    return "\n".join(parts)
