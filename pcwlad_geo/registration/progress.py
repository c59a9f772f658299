"""Events that a running job sends to whoever asked for it: an injected callback receives them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Progress:
    """`done` of `total` units of a stage are finished."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Warned:
    """Something the user should know; the job goes on."""

    message: str


Event = Progress | Warned
EventCallback = Callable[[Event], None]


def ignore(event: Event) -> None:
    """Do nothing with an event: the default callback."""
