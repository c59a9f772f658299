"""Runners execute the calls of a job: here, or on an executor of the caller.

Tasks get the sender's GDAL settings and one thread per library.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Final, NamedTuple, Protocol, TypeVar

import rasterio.env
from threadpoolctl import threadpool_limits

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import EventCallback, Progress, ignore
from pcwlad_geo.raster import Trust, trusting
from pcwlad_geo.raster.trust.permissions import current_trust

T = TypeVar("T")
Calls = Sequence[tuple[Any, ...]]
"""The arguments of each call."""
IN_FLIGHT: Final = 64
"""Largest number of calls submitted at a time to an executor of unknown size."""
CHECK_S: Final = 1.0
"""Time between two checks whether there are still workers."""
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
    forwarded = {name: value for name, value in settings.items() if not _SECRET.search(name.upper())}
    return {**forwarded, "GDAL_NUM_THREADS": "1"}


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


class _Answer(NamedTuple):
    """What a call has returned, if the executor has made it."""

    value: Any


def _marked(*call: Any) -> _Answer:  # noqa: ANN401  # see in_environment
    return _Answer(in_environment(*call))


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


@contextmanager
def one_library_thread() -> Iterator[None]:
    """Limit OpenCV and the BLAS libraries to one thread in this process; a context manager, or a decorator.

    Our images and systems of equations are small: further threads make them no faster, spin while they wait
    (a seventh of the CPU time of a search for a pose), and give results that depend on the number of cores in
    their last digits.
    """
    with one_opencv_thread(), threadpool_limits(1, user_api="blas"):
        yield


class Runner(Protocol):
    """Runs the calls of all stages of a job; by itself it has no workers."""

    @property
    def is_local(self) -> bool:
        """Whether the workers run on this machine, and write where this process does."""

    @property
    def shares_memory(self) -> bool:
        """Whether the workers are threads of this process: a call has what an earlier one has kept."""

    @property
    def threads(self) -> int:
        """Number of calls that run at a time, and of threads that a call may use which runs alone."""

    @property
    def shares_jobs(self) -> bool:
        """Whether `run_jobs` executes several at a time, in processes of this machine."""

    def run(
        self, function: Callable[..., T], calls: Calls, stage: str, on_event: EventCallback = ignore
    ) -> list[T]:
        """Call the function with each tuple of arguments; return the results in the order of the calls.

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

        Raises
        ------
        ExecutionError
            If the executor is lost.
        """

    def run_jobs(
        self, function: Callable[..., T], calls: Calls, stage: str, on_event: EventCallback = ignore
    ) -> list[T | ExecutionError]:
        """Do what `run` does with a function that does a whole job.

        The result of a call whose process was lost is an `ExecutionError` that says how.
        """
        return [*self.run(function, calls, stage, on_event)]


class InThisProcess(Runner):
    """Executes one call after another in this process."""

    is_local = True
    shares_memory = True
    shares_jobs = False
    threads = 1

    def run(
        self, function: Callable[..., T], calls: Calls, stage: str, on_event: EventCallback = ignore
    ) -> list[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        on_event(Progress(stage, 0, len(calls)))
        results = []
        for count, arguments in enumerate(calls, 1):
            with one_opencv_thread():
                results.append(function(*arguments))
            on_event(Progress(stage, count, len(calls)))
        return results


def run_calls(
    submit: Callable[[int], Future[T]],
    count: int,
    in_flight: int,
    stage: str,
    on_event: EventCallback,
    check: Callable[[], None] | None = None,
) -> list[T]:
    """Do calls, `in_flight` of them at a time; return the results in their order.

    `submit` starts a call by its number, of which there are `count`. A `Progress` of the `stage` is sent
    after each call. `check` is called every `CHECK_S` while calls are awaited; an exception that it raises
    ends the job.
    """
    results: dict[int, T] = {}
    waiting: dict[Future[T], int] = {}
    upcoming = iter(range(count))
    on_event(Progress(stage, 0, count))
    try:
        while len(results) < count:
            for index in islice(upcoming, in_flight - len(waiting)):
                waiting[submit(index)] = index
            finished, _ = wait(waiting, CHECK_S if check else None, return_when=FIRST_COMPLETED)
            if check:
                check()
            for future in finished:
                results[waiting.pop(future)] = future.result()
                on_event(Progress(stage, len(results), count))
    finally:  # after an error: the executor may belong to the caller and continue
        for future in waiting:
            future.cancel()
    return [results[index] for index in range(count)]


@dataclass(slots=True, eq=False)
class OnExecutor(Runner):
    """Submits the calls to an executor of the caller, which is not shut down."""

    executor: Executor
    in_flight: int = IN_FLIGHT
    """Largest number of calls submitted at a time."""
    broken: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)
    """Exceptions that the executor raises when it has lost its workers or its scheduler."""
    place: str = "the executor"
    """Name of the executor in messages."""
    is_local: bool = True
    """Whether its workers are threads or processes of this machine."""
    check: Callable[[EventCallback], None] | None = None
    """Called every `CHECK_S` while calls are awaited, with the receiver of warnings; it may raise."""
    shares_memory: bool = False
    """Whether its workers are threads of this process."""
    shares_jobs = False
    threads = 1

    def run(
        self, function: Callable[..., T], calls: Calls, stage: str, on_event: EventCallback = ignore
    ) -> list[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        settings, trust = gdal_settings(), current_trust()

        def submit(index: int) -> Future[_Answer]:
            try:
                future = self.executor.submit(_marked, settings, trust, function, calls[index])
            except RuntimeError as error:  # it was shut down
                raise BrokenExecutor(str(error)) from error
            if not isinstance(future, Future):
                raise ExecutionError(f"{self.place} returns a {type(future).__name__}, which is no Future")
            return future

        check = None if self.check is None else partial(self.check, on_event)
        try:
            with one_opencv_thread():  # its workers may be threads
                results = run_calls(submit, len(calls), self.in_flight, stage, on_event, check)
        except self.broken as error:
            detail = f"{type(error).__name__}: {error}".removesuffix(": ")
            raise ExecutionError(f"{self.place} is lost, or its workers are ({detail})") from error
        if not all(isinstance(result, _Answer) for result in results):
            raise ExecutionError(f"{self.place} returns other results than those of the calls: check it")
        return [result.value for result in results]
