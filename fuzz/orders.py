"""What is asked of a fork server, and what it answers."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any, Final

CASE: Final = "1/2/3/4/5/6/7/8/9/case"
"""The folder of a case in the folder of its run, so deep that paths with many `..` end in the latter."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a command may take."""

    seconds: float = 60.0
    memory_mb: int = 3072


@dataclass(frozen=True, slots=True)
class Order:
    """A command to run."""

    folder: str
    """Of the run: it receives `stdout`, `stderr` and `where`, the traces of what crashed or hung."""
    argv: tuple[str, ...]
    figures: bool = True
    """Whether the report's figures are drawn."""
    limits: Limits = field(default_factory=Limits)

    def to_json(self) -> str:
        """Return it as a line."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(line: str) -> Order:
        """Read it from a line."""
        values = json.loads(line)
        return Order(values["folder"], tuple(values["argv"]), values["figures"], Limits(**values["limits"]))


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a command ended."""

    status: int | None
    """Exit status; None where a signal ended it."""
    signal: int | None = None
    """The signal that ended it, unless that was ours."""
    ended: str | None = None
    """`memory` or `hang`: the limit that it exceeded, so that it was ended."""
    seconds: float = 0.0
    peak_mb: int = 0
    processes_left: int = 0
    stdout: str = ""
    stderr: str = ""
    where: str = ""
    """Traces of what crashed or hung."""

    def to_json(self) -> dict[str, Any]:
        """Return its values by name."""
        return asdict(self)
