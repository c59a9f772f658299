"""Warnings and stage times that a job gathers while it runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from pcwlad_geo.registration.progress import EventCallback, Warned


@dataclass(slots=True)
class JobLog:
    """Warnings and stage times of a run."""

    on_event: EventCallback
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def warn(self, message: str) -> None:
        """Keep a warning for the report, and send it."""
        self.warnings.append(message)
        self.on_event(Warned(message))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun
