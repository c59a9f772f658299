"""A runner on a cluster of dask.distributed, which is an optional dependency: the extra `dask`."""

from __future__ import annotations

import logging
import struct
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    ThreadPoolExecutor,
)
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import EventCallback, Warned
from pcwlad_geo.execution.runner import IN_FLIGHT, OnExecutor

if TYPE_CHECKING:
    from distributed import Client


NUMERIC: Final = ("numpy", "scipy", "cv2", "rasterio")
"""Packages whose versions determine the last bits of the tie points."""
_OTHER_LANGUAGES: Final = (MemoryError, ValueError, TypeError, LookupError, struct.error)
"""Exceptions raised by the answer of a server that is no scheduler: a length of exabytes, a random header."""
_LOGGERS: Final = ("distributed", "distributed.client", "tornado", "tornado.application")


@dataclass(frozen=True, slots=True)
class ClusterParameters:
    """How long a job waits for a cluster, s, and how much it gives it to do."""

    connect_s: float = 3.0
    """Longest time that a scheduler may take to answer."""
    close_s: float = 1.0
    """Longest time that closing the connection may take."""
    warn_after_s: float = 10.0
    """Time without workers after which a warning is sent."""
    lost_after_s: float = 60.0
    """Time without workers after which the job fails; a worker that is restarted takes some seconds."""
    calls_per_thread: int = 2
    """Number of calls submitted per thread: one that runs and one that waits, so that no worker is idle."""


CLUSTER: Final = ClusterParameters()
"""As jobs use one."""


@contextmanager
def connected(
    address: str, on_event: EventCallback, parameters: ClusterParameters = CLUSTER
) -> Iterator[OnExecutor]:
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
    with _silent(), _connect(address, parameters) as client:
        _check_versions(client, address, on_event)
        threads = sum(client.nthreads().values())
        yield OnExecutor(
            client.get_executor(pure=False),  # no result is reused for another call, also in a later run
            max(IN_FLIGHT, parameters.calls_per_thread * threads),
            (BrokenExecutor, CancelledError, distributed.KilledWorker),
            f"the scheduler {address}",
            is_local=False,
            check=WorkerWatch(lambda: len(client.nthreads()), address, parameters),
        )


class WorkerWatch:
    """Raises an error if a scheduler has had no worker for too long: its calls would wait for ever.

    Parameters
    ----------
    count : callable
        Returns the number of workers.
    address : str
        Address of the scheduler, for messages.
    parameters : ClusterParameters, optional
        How long it may have none.
    clock : callable, optional
        Returns the time, s.
    """

    def __init__(
        self,
        count: Callable[[], int],
        address: str,
        parameters: ClusterParameters = CLUSTER,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._count, self._address, self._parameters, self._clock = count, address, parameters, clock
        self._missing_since: float | None = None
        self._warned = False

    def __call__(self, on_event: EventCallback) -> None:
        """Check once; warn of a lack of workers, and raise `ExecutionError` if it goes on."""
        import asyncio  # slow to load, and only those on a cluster need it

        warn_after_s, lost_after_s = self._parameters.warn_after_s, self._parameters.lost_after_s
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
        if missing_s > lost_after_s:
            raise ExecutionError(
                f"the scheduler {self._address} has had no worker for {lost_after_s:.0f} s: start some "
                f"(dask worker {self._address}) and run the command again, or leave --scheduler out"
            )
        if missing_s > warn_after_s and not self._warned:
            self._warned = True
            on_event(
                Warned(
                    f"the scheduler {self._address} has no workers left: the job waits "
                    f"{lost_after_s - warn_after_s:.0f} s for new ones"
                )
            )


@contextmanager
def _connect(address: str, parameters: ClusterParameters) -> Iterator[Client]:
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
            thread.submit(asyncio.run, _probe(address, parameters.connect_s)).result()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of version mismatches: `_check_versions` reports what matters
            client = Client(address, timeout=parameters.connect_s, set_as_default=False)
    except (OSError, asyncio.TimeoutError, *_OTHER_LANGUAGES) as error:
        raise ExecutionError(
            f"the scheduler {address} cannot be reached within {parameters.connect_s:.0f} s: check the "
            "address, and that a dask scheduler runs there"
        ) from error
    try:
        yield client
    finally:
        with suppress(TimeoutError, OSError):
            client.close(timeout=parameters.close_s)


async def _probe(address: str, timeout_s: float) -> None:
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

    await asyncio.wait_for(ask(), timeout_s)


def _check_versions(client: Client, address: str, on_event: EventCallback) -> None:
    """Refuse workers without this version of pcwlad-geo, and warn of other versions of numeric packages."""
    inspect = _inspection(("pcwlad_geo", *NUMERIC))
    ours = inspect()
    version = ours["pcwlad_geo"]
    differing: set[str] = set()
    for worker, theirs in client.run(inspect, on_error="return").items():
        if not isinstance(theirs, dict):  # it does not answer, which the scheduler will notice
            continue
        if theirs["pcwlad_geo"] != version:
            installed = theirs["pcwlad_geo"]
            has = f"has pcwlad-geo {installed}" if installed else "has no pcwlad-geo"
            raise ExecutionError(
                f"the worker {worker} of the scheduler {address} {has}: install pcwlad-geo {version} there"
            )
        differing |= {
            f"{name} {theirs[name]} instead of {ours[name]}" for name in NUMERIC if theirs[name] != ours[name]
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

        versions: dict[str, str | None] = {}
        for name in names:
            try:
                versions[name] = str(import_module(name).__version__)
            except ImportError:
                versions[name] = None
        return versions

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
