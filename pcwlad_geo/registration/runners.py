"""Where the calls of a job run: in processes of our own, on an executor of the caller's, on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import contextmanager
from functools import partial
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Final, TypeVar

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.raster.trust import current_trust
from pcwlad_geo.registration.environment import gdal_settings, in_environment, one_opencv_thread
from pcwlad_geo.registration.processes import Workers, available_cores, can_start_workers
from pcwlad_geo.registration.progress import Event, EventCallback, Warned, ignore
from pcwlad_geo.registration.settings import Settings
from pcwlad_geo.registration.tasks import Affinity, InThisProcess, Ran, Runner, drive

IN_FLIGHT: Final = 64
"""Calls that an executor of unknown size holds at a time."""
TASKS_MODULE: Final = "pcwlad_geo.registration.tiles"
"""Workers import it before their first call, or what they are forked from does."""

T = TypeVar("T")


class OnExecutor:
    """Hands the calls to an executor of the caller's, which lives on.

    Parameters
    ----------
    executor : concurrent.futures.Executor
    in_flight : int
        Calls that it holds at a time.
    broken : tuple of exception types
        What it raises when it has lost its workers, or `place` itself.
    place : str
        How messages call it.
    shares_kernels : bool
        Whether its workers are threads or processes of this machine.
    check : callable, optional
        Called again and again while calls are awaited, with the receiver of warnings; it raises where there
        is nothing to wait for.
    """

    heeds_affinity = False

    def __init__(
        self,
        executor: Executor,
        in_flight: int = IN_FLIGHT,
        broken: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError),
        place: str = "the executor",
        shares_kernels: bool = True,
        check: Callable[[EventCallback], None] | None = None,
    ) -> None:
        self._check = check
        self.shares_kernels = shares_kernels
        self._executor = executor
        self._in_flight = in_flight
        self._broken = broken
        self._place = place

    def expect(self, calls: int) -> None:
        """Do nothing: an executor minds its own workers."""

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Do nothing: its workers are not known."""

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> Ran[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        settings, trust = gdal_settings(), current_trust()

        def submit(index: int, _: int) -> Future[T]:
            return self._executor.submit(in_environment, settings, trust, function, calls[index])

        slots = min(self._in_flight, len(calls))
        check = None if self._check is None else partial(self._check, on_event)
        try:
            with one_opencv_thread():  # its workers may be threads
                results, _ = drive(submit, [None] * len(calls), slots, stage, on_event, check)
        except self._broken as error:
            detail = f"{type(error).__name__}: {error}".removesuffix(": ")
            raise ExecutionError(f"{self._place} is lost, or its workers are ({detail})") from error
        return Ran(results, [None] * len(calls))


class OwnProcesses:
    """Runs the calls in worker processes of its own, which serve all stages; a context manager.

    A single call runs in this process, as everything does where there is one worker only.

    Parameters
    ----------
    jobs : int
        Worker processes, at most; they start when calls are expected.
    preload : str
        Module that a worker imports at its start.
    """

    shares_kernels = True
    heeds_affinity = True

    def __init__(self, jobs: int, preload: str = TASKS_MODULE) -> None:
        self._jobs = jobs if can_start_workers() else 1
        self._wanted = 0
        self._losses: SimpleQueue[str] = SimpleQueue()
        self._workers = Workers(preload, self._losses.put)

    def __enter__(self) -> OwnProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._workers.stop()

    @property
    def process_ids(self) -> list[int]:
        """Of the workers; those that are expected start."""
        return [worker.process_id for worker in self._workers.at_least(self._wanted)]

    def expect(self, calls: int) -> None:
        """Make the workers ready that so many calls can use."""
        wanted = min(self._jobs, calls)
        if wanted > max(1, self._wanted):
            self._wanted = wanted
            self._workers.expect(wanted)

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Call a function in every worker that is expected, without waiting for it."""
        self._workers.prepare(in_environment, (gdal_settings(), current_trust(), function, arguments))

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> Ran[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        self.expect(len(calls))
        wanted = list(affinity) if affinity is not None else [None] * len(calls)
        if not self._wanted or (len(calls) == 1 and wanted[0] is None):
            return InThisProcess().run(function, calls, stage, on_event)
        settings, trust = gdal_settings(), current_trust()
        crew = self._workers.at_least(self._wanted)

        def submit(index: int, worker: int) -> Future[T]:
            return crew[worker].submit(in_environment, (settings, trust, function, calls[index]))

        def tell(event: Event) -> None:
            self._tell_losses(on_event)
            on_event(event)

        results, workers = drive(submit, wanted, len(crew), stage, tell)
        return Ran(results, list(workers))

    def _tell_losses(self, on_event: EventCallback) -> None:
        while True:
            try:
                message = self._losses.get_nowait()
            except Empty:
                return
            on_event(Warned(message))


@contextmanager
def open_runner(
    settings: Settings, executor: Executor | Runner | None, on_event: EventCallback
) -> Iterator[Runner]:
    """Give what runs the calls of a job, or of many, for as long as the context lasts.

    Parameters
    ----------
    settings : Settings
        `scheduler` and `jobs` choose it where there is no executor.
    executor : concurrent.futures.Executor or Runner, optional
        A runner is open already, and stays so.
    on_event : callable
        Receives warnings about it.

    Raises
    ------
    ExecutionError
        If the scheduler cannot be used.
    """
    if isinstance(executor, Executor):
        yield OnExecutor(executor)
    elif executor is not None:
        yield executor
    elif settings.scheduler is not None:
        from pcwlad_geo.registration.cluster import connected  # an optional dependency

        with connected(settings.scheduler, on_event) as runner:
            yield runner
    else:
        with OwnProcesses(settings.jobs or available_cores()) as processes:
            yield processes
