"""Events that a running job sends to a callback of its caller."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Progress:
    """`done` of `total` units of a stage are finished."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Warned:
    """A warning for the user; the job continues."""

    message: str


Event = Progress | Warned
EventCallback = Callable[[Event], None]


def ignore(event: Event) -> None:
    """Ignore an event; this is the default callback."""


def only_warnings(on_event: EventCallback, event: Event) -> None:
    """Pass an event on if it is a warning: the progress of a part is not that of the whole."""
    if isinstance(event, Warned):
        on_event(event)


@dataclass(slots=True)
class JobLog:
    """Warnings and stage times of a run."""

    on_event: EventCallback
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def warn(self, message: str) -> None:
        """Record a warning for the report, and send it, once."""
        if message in self.warnings:
            return
        self.warnings.append(message)
        self.on_event(Warned(message))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the duration of the context to the time of a stage."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun
