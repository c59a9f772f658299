"""Run on an existing dask.distributed cluster (optional dependency: the extra `dask`)."""

from __future__ import annotations

import asyncio
import logging
import struct
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.events import EventCallback, Warned
from pcwlad_geo.execution.runner import IN_FLIGHT, OnExecutor

if TYPE_CHECKING:
    from distributed import Client

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
NUMERIC: Final = ("numpy", "scipy", "numba", "cv2", "rasterio")
"""Packages whose versions determine the last bits of the tie points."""
_OTHER_LANGUAGES: Final = (MemoryError, ValueError, TypeError, LookupError, struct.error)
"""Exceptions raised by the answer of a server that is no scheduler: a length of exabytes, a random header."""
_LOGGERS: Final = ("distributed", "distributed.client", "tornado", "tornado.application")


@contextmanager
def connected(address: str, on_event: EventCallback) -> Iterator[OnExecutor]:
    """Provide a runner on the cluster of a scheduler for the duration of the context.

    Raises `ExecutionError` if the extra `dask` is not installed, the scheduler cannot be reached, or a worker
    lacks this version of pcwlad-geo.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as ``tcp://host:8786``.
    on_event : callable
        Receives a warning if the workers' packages differ from those here.
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
            shares_kernels=False,
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
