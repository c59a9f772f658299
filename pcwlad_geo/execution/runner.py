"""Runners execute the calls of a job; tasks get the sender's GDAL settings and one thread per library."""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Generic, Protocol, TypeVar

import rasterio.env

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import EventCallback, Progress, ignore
from pcwlad_geo.raster.trust import Trust, current_trust, trusting

T = TypeVar("T")

_FORWARDED: Final = re.compile(
    "CPL_VSIL_|VSI_CACHE|VSIS3_|GDAL_HTTP_|GDAL_DISABLE_READDIR_ON_OPEN$|GDAL_INGESTED_BYTES_AT_OPEN$|"
    "GDAL_CACHEMAX$|AWS_"
)
"""Environment variables that set how GDAL reads over a network; none names a file of this machine."""
_SECRET: Final = re.compile(
    "SECRET|TOKEN|KEY|PASS|PWD|BEARER|AUTH|HEADER|COOKIE|CREDENTIAL|PROFILE|FILE|ROLE"
)


def gdal_settings() -> dict[str, str]:
    """Return the GDAL settings of this process that tasks in other processes need, see `in_environment`.

    They are those of an open ``rasterio.Env``, and the environment variables for reading over a network.
    Credentials are left out, as they must not be sent in messages; each worker has its own.
    """
    settings: dict[str, Any] = {name: value for name, value in os.environ.items() if _FORWARDED.match(name)}
    if rasterio.env.hasenv():
        settings |= rasterio.env.getenv()
    kept = {name: value for name, value in settings.items() if not _SECRET.search(name.upper())}
    return {**kept, "GDAL_NUM_THREADS": "1"}


def in_environment(
    settings: Mapping[str, Any], trust: Trust, function: Callable[..., T], arguments: tuple[Any, ...]
) -> T:
    """Call a function with the given GDAL settings and trust in rasters, and with OpenCV on one thread.

    The `settings` are those of `gdal_settings`; `trust` says which rasters may be opened.
    """
    import cv2  # inside: slow to load, and workers may be started before

    if cv2.getNumThreads() != 1:
        cv2.setNumThreads(1)
    with trusting(trust), rasterio.Env(**settings):
        return function(*arguments)


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Limit OpenCV to one thread in this process for the duration of the context."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


IN_FLIGHT: Final = 64
"""Largest number of calls submitted at a time to an executor of unknown size."""
CHECK_S: Final = 1.0
"""Time between two checks whether there are still workers."""
Affinity = Sequence[int | None]


@dataclass(frozen=True, slots=True, eq=False)
class CallResults(Generic[T]):
    """The results of the calls of a stage."""

    results: list[T]
    """Results in the order of the calls."""
    workers: list[int | None]
    """The worker that executed each call, for the `affinity` of a later stage; None if it has no number."""


class Runner(Protocol):
    """Runs the calls of all stages of a job."""

    @property
    def shares_kernels(self) -> bool:
        """Whether the workers load the kernels that this process has compiled."""

    @property
    def honours_affinity(self) -> bool:
        """Whether a call is sent to the worker that is requested for it."""

    @property
    def threads(self) -> int:
        """Number of threads that a call may use which runs alone."""

    def expect(self, calls: int) -> None:
        """Prepare for about `calls` calls, without waiting."""

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Call `function` with `arguments` in every worker that has started, if possible, without waiting."""

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> CallResults[T]:
        """Call the function with each tuple of arguments.

        Parameters
        ----------
        function : callable
            Importable, as it may run in another process; its result depends on the arguments only.
        calls : sequence of tuples
            The arguments of each call.
        stage : str
            Name of the stage in progress events.
        on_event : callable
            Receives a `Progress` after each call; an exception that it raises ends the stage.
        affinity : sequence of (int or None), optional
            For each call the worker that should execute it, from `CallResults.workers`; None = any. It is a
            hint: the worker may have been replaced by a new process, and only `OwnProcesses` honours it.

        Raises
        ------
        ExecutionError
            If the processes or the executor are lost.
        """


class InThisProcess:
    """Executes one call after another in this process."""

    shares_kernels = True
    honours_affinity = True
    threads = 1

    def expect(self, calls: int) -> None:
        """Do nothing, as this process is ready."""

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Do nothing, as the first call prepares this process."""

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> CallResults[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        on_event(Progress(stage, 0, len(calls)))
        results = []
        for done, arguments in enumerate(calls, 1):
            with one_opencv_thread():
                results.append(function(*arguments))
            on_event(Progress(stage, done, len(calls)))
        return CallResults(results, [None] * len(calls))


def run_calls(
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
        For each call the slot that should execute it; None = any.
    slots : int
        Number of slots.
    stage : str
        Name of the stage in progress events.
    on_event : callable
        Receives a `Progress` after each call.
    check : callable, optional
        Called every `CHECK_S` while calls are awaited; an exception that it raises ends the job.

    Returns
    -------
    results, slots : list
        Result and slot of each call.
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
    finally:  # after an error: the executor may belong to the caller and continue
        for future in waiting:
            future.cancel()
    order = range(len(wanted))
    return [results[index] for index in order], [done_by[index] for index in order]


@dataclass(slots=True, eq=False)
class OnExecutor:
    """Submits the calls to an executor of the caller, which is not shut down."""

    executor: Executor
    in_flight: int = IN_FLIGHT
    """Largest number of calls submitted at a time."""
    broken: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)
    """Exceptions that the executor raises when it has lost its workers or its scheduler."""
    place: str = "the executor"
    """Name of the executor in messages."""
    shares_kernels: bool = True
    """Whether its workers are threads or processes of this machine."""
    check: Callable[[EventCallback], None] | None = None
    """Called every `CHECK_S` while calls are awaited, with the receiver of warnings; it may raise."""
    honours_affinity = False
    threads = 1

    def expect(self, calls: int) -> None:
        """Do nothing, as an executor manages its own workers."""

    def prepare(self, function: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        """Do nothing, as its workers are not known."""

    def run(
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
        affinity: Affinity | None = None,
    ) -> CallResults[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        settings, trust = gdal_settings(), current_trust()

        def submit(index: int, _: int) -> Future[T]:
            return self.executor.submit(in_environment, settings, trust, function, calls[index])

        slots = min(self.in_flight, len(calls))
        check = None if self.check is None else partial(self.check, on_event)
        try:
            with one_opencv_thread():  # its workers may be threads
                results, _ = run_calls(submit, [None] * len(calls), slots, stage, on_event, check)
        except self.broken as error:
            detail = f"{type(error).__name__}: {error}".removesuffix(": ")
            raise ExecutionError(f"{self.place} is lost, or its workers are ({detail})") from error
        return CallResults(results, [None] * len(calls))
