"""Run the same function on many arguments, bounded and in order: what does it, and the simplest one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any, Final, Generic, Protocol, TypeVar

from pcwlad_geo.registration.environment import one_opencv_thread
from pcwlad_geo.registration.progress import EventCallback, Progress, ignore

T = TypeVar("T")

CHECK_S: Final = 1.0
"""Between two looks at whether there are still workers."""
Affinity = Sequence[int | None]


@dataclass(frozen=True, slots=True, eq=False)
class Ran(Generic[T]):
    """What the calls of a stage gave."""

    results: list[T]
    """In the order of the calls."""
    workers: list[int | None]
    """The worker that did each call, for the `affinity` of a later stage; None: it has no number."""


class Runner(Protocol):
    """Runs the calls of all stages of a job."""

    @property
    def shares_kernels(self) -> bool:
        """Whether the workers load the kernels that this process has compiled."""

    @property
    def heeds_affinity(self) -> bool:
        """Whether a call goes to the worker that is wanted for it."""

    def expect(self, calls: int) -> None:
        """Make ready for about so many calls, without waiting for it."""

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Call a function in every worker that has started, if that can be done, without waiting for it."""

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> Ran[T]:
        """Call the function with each tuple of arguments.

        Parameters
        ----------
        function : callable
            Importable, as it may run in another process; its result depends on the arguments only.
        calls : sequence of tuples
        stage : str
            Name of the stage in progress events.
        on_event : callable
            Receives a `Progress` after each call; an exception that it raises ends the stage.
        affinity : sequence of (int or None), optional
            For each call the worker that should do it, from `Ran.workers`; None = any. A hint: the worker may
            have been replaced by a new process, and only processes of our own heed it.

        Raises
        ------
        ExecutionError
            If the processes or the executor are lost.
        """


class InThisProcess:
    """Does one call after another here."""

    shares_kernels = True
    heeds_affinity = True

    def expect(self, calls: int) -> None:
        """Do nothing: this process is ready."""

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Do nothing: the first call will."""

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> Ran[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        on_event(Progress(stage, 0, len(calls)))
        results = []
        for done, arguments in enumerate(calls, 1):
            with one_opencv_thread():
                results.append(function(*arguments))
            on_event(Progress(stage, done, len(calls)))
        return Ran(results, [None] * len(calls))


def drive(
    submit: Callable[[int, int], Future[T]],
    wanted: Sequence[int | None],
    slots: int,
    stage: str,
    on_event: EventCallback,
    check: Callable[[], None] | None = None,
) -> tuple[list[T], list[int]]:
    """Keep each of the slots busy with one call at a time until all are done.

    Parameters
    ----------
    submit : callable
        Starts call number `index` on slot number `slot`.
    wanted : sequence of (int or None)
        For each call the slot that it should go to.
    slots : int
    stage : str
        Name of the stage in progress events.
    on_event : callable
    check : callable, optional
        Called every `CHECK_S` while calls are awaited; what it raises ends the job.

    Returns
    -------
    results, slots : list
        Of each call.
    """
    anywhere: deque[int] = deque()
    reserved: list[deque[int]] = [deque() for _ in range(slots)]
    for index, slot in enumerate(wanted):
        queue = anywhere if slot is None or not 0 <= slot < slots else reserved[slot]
        queue.append(index)
    results: dict[int, T] = {}
    done_by: dict[int, int] = {}
    waiting: dict[Future[T], int] = {}
    idle = list(range(slots))
    on_event(Progress(stage, 0, len(wanted)))
    try:
        while len(results) < len(wanted):
            for slot in idle:
                queue = reserved[slot] or anywhere
                if queue:
                    index = queue.popleft()
                    done_by[index] = slot
                    waiting[submit(index, slot)] = index
            finished, _ = wait(waiting, CHECK_S if check else None, return_when=FIRST_COMPLETED)
            if check:
                check()
            idle = []
            for future in finished:
                index = waiting.pop(future)
                idle.append(done_by[index])
                results[index] = future.result()
                on_event(Progress(stage, len(results), len(wanted)))
    finally:  # after an error: an executor may be the caller's and live on
        for future in waiting:
            future.cancel()
    order = range(len(wanted))
    return [results[index] for index in order], [done_by[index] for index in order]
