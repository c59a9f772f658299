"""Runners execute the calls of a job: here, on an executor of the caller, on a cluster of dask.distributed.

Tasks get the sender's GDAL settings and one thread per library. The cluster is an optional dependency: the
extra `dask`.
"""

from __future__ import annotations

import logging
import os
import re
import struct
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeVar

import rasterio.env
from threadpoolctl import threadpool_limits

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import EventCallback, Progress, Warned, ignore
from pcwlad_geo.raster.trust.permissions import Trust, current_trust, trusting

if TYPE_CHECKING:
    from distributed import Client

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


IN_FLIGHT: Final = 64
"""Largest number of calls submitted at a time to an executor of unknown size."""
CHECK_S: Final = 1.0
"""Time between two checks whether there are still workers."""


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
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
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
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
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
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
    ) -> list[T]:
        """Call the function with each tuple of arguments; see `Runner`."""
        on_event(Progress(stage, 0, len(calls)))
        results = []
        for done, arguments in enumerate(calls, 1):
            with one_opencv_thread():
                results.append(function(*arguments))
            on_event(Progress(stage, done, len(calls)))
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
        self,
        function: Callable[..., T],
        calls: Sequence[tuple[Any, ...]],
        stage: str,
        on_event: EventCallback = ignore,
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


CONNECT_S: Final = 3.0
"""Longest time that a scheduler may take to answer."""
CLOSE_S: Final = 1.0
"""Longest time that closing the connection may take."""
WARN_AFTER_S: Final = 10.0
"""Time without workers after which a warning is sent."""
LOST_AFTER_S: Final = 60.0
"""Time without workers after which the job fails; a worker that is restarted takes some seconds."""
CALLS_PER_THREAD: Final = 2
"""Number of calls submitted per thread: one that runs and one that waits, so that no worker is idle."""
NUMERIC: Final = ("numpy", "scipy", "cv2", "rasterio")
"""Packages whose versions determine the last bits of the tie points."""
_OTHER_LANGUAGES: Final = (MemoryError, ValueError, TypeError, LookupError, struct.error)
"""Exceptions raised by the answer of a server that is no scheduler: a length of exabytes, a random header."""
_LOGGERS: Final = ("distributed", "distributed.client", "tornado", "tornado.application")


@contextmanager
def connected(address: str, on_event: EventCallback) -> Iterator[OnExecutor]:
    """Provide a runner on the cluster of a scheduler for the duration of the context.

    The address is such as ``tcp://host:8786``. `on_event` receives a warning if the workers' packages differ
    from those here. Raises `ExecutionError` if the extra `dask` is not installed, the scheduler cannot be
    reached, or a worker lacks this version of pcwlad-geo.
    """
    try:
        import distributed
    except ImportError as error:
        message = f"the scheduler {address} needs dask.distributed: pip install 'pcwlad-geo[dask]' ({error})"
        raise ExecutionError(message) from error
    with _silent(), _connect(address) as client:
        _check_versions(client, address, on_event)
        threads = sum(client.nthreads().values())
        yield OnExecutor(
            client.get_executor(pure=False),  # no result is reused for another call, also in a later run
            max(IN_FLIGHT, CALLS_PER_THREAD * threads),
            (BrokenExecutor, CancelledError, distributed.KilledWorker),
            f"the scheduler {address}",
            is_local=False,
            check=WorkerWatch(lambda: len(client.nthreads()), address),
        )


class WorkerWatch:
    """Raises an error if a scheduler has had no worker for too long: its calls would wait for ever.

    Parameters
    ----------
    count : callable
        Returns the number of workers.
    address : str
        Address of the scheduler, for messages.
    clock : callable, optional
        Returns the time, s.
    """

    def __init__(
        self, count: Callable[[], int], address: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._count, self._address, self._clock = count, address, clock
        self._missing_since: float | None = None
        self._warned = False

    def __call__(self, on_event: EventCallback) -> None:
        """Check once; warn after `WARN_AFTER_S` without workers.

        Raises `ExecutionError` after `LOST_AFTER_S` without workers.
        """
        import asyncio  # slow to load, and only those on a cluster need it

        count = 0
        with suppress(OSError, TimeoutError, asyncio.TimeoutError):
            count = self._count()
        now = self._clock()
        if count:
            self._missing_since, self._warned = None, False
            return
        if self._missing_since is None:
            self._missing_since = now
        missing_s = now - self._missing_since
        if missing_s > LOST_AFTER_S:
            raise ExecutionError(
                f"the scheduler {self._address} has had no worker for {LOST_AFTER_S:.0f} s: start some "
                f"(dask worker {self._address}) and run the command again, or leave --scheduler out"
            )
        if missing_s > WARN_AFTER_S and not self._warned:
            self._warned = True
            on_event(
                Warned(
                    f"the scheduler {self._address} has no workers left: the job waits "
                    f"{LOST_AFTER_S - WARN_AFTER_S:.0f} s for new ones"
                )
            )


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    import asyncio

    from distributed import Client
    from distributed.comm import get_address_host_port

    try:
        get_address_host_port(address, strict=True)
    except (ValueError, TypeError) as error:
        message = f"{address} is no address of a scheduler ({error}): give one such as tcp://host:8786"
        raise ExecutionError(message) from error
    try:
        with ThreadPoolExecutor(1) as thread:  # the caller's may have an event loop, as notebooks do
            thread.submit(asyncio.run, _probe(address)).result()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of version mismatches: `_check_versions` reports what matters
            client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, asyncio.TimeoutError, *_OTHER_LANGUAGES) as error:
        raise ExecutionError(
            f"the scheduler {address} cannot be reached within {CONNECT_S:.0f} s: check the address, "
            "and that a dask scheduler runs there"
        ) from error
    try:
        yield client
    finally:
        with suppress(TimeoutError, OSError):
            client.close(timeout=CLOSE_S)


async def _probe(address: str) -> None:
    """Ask the scheduler to identify itself, as its client would retry for a long time."""
    import asyncio

    from distributed import Security
    from distributed.comm import connect

    async def ask() -> None:
        comm = await connect(address, **Security().get_connection_args("client"))
        try:
            await comm.write({"op": "identity", "reply": True})
            await comm.read()
        finally:
            comm.abort()

    await asyncio.wait_for(ask(), CONNECT_S)


def _check_versions(client: Client, address: str, on_event: EventCallback) -> None:
    """Refuse workers without this version of pcwlad-geo, and warn of other versions of numeric packages."""
    inspect = _inspection(("pcwlad_geo", *NUMERIC))
    here = inspect()
    differing: set[str] = set()
    for worker, there in client.run(inspect, on_error="return").items():
        if not isinstance(there, dict):  # it does not answer, which the scheduler will notice
            continue
        ours = there["pcwlad_geo"]
        if ours != here["pcwlad_geo"]:
            has = f"has pcwlad-geo {ours}" if ours else "has no pcwlad-geo"
            raise ExecutionError(
                f"the worker {worker} of the scheduler {address} {has}: "
                f"install pcwlad-geo {here['pcwlad_geo']} there"
            )
        differing |= {
            f"{name} {there[name]} instead of {here[name]}" for name in NUMERIC if there[name] != here[name]
        }
    if differing:
        on_event(
            Warned(
                f"workers of the scheduler {address} have {', '.join(sorted(differing))}: "
                "tie points may differ in their last digits from those made here"
            )
        )


def _inspection(names: Sequence[str]) -> Callable[[], dict[str, str | None]]:
    """Return a function that returns the versions of packages, None for those that are missing."""

    # A nested function is pickled as code, not by its name: a worker may lack this module.
    def inspect() -> dict[str, str | None]:
        from importlib import import_module

        found: dict[str, str | None] = {}
        for name in names:
            try:
                found[name] = str(import_module(name).__version__)
            except ImportError:
                found[name] = None
        return found

    return inspect


@contextmanager
def _silent() -> Iterator[None]:
    """Keep dask's own log off the terminal, as errors arrive as exceptions."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
