"""Functions that worker processes can import, and executors that make trouble."""

from __future__ import annotations

import os
import random
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from tests.patience import PATIENCE_S

T = TypeVar("T")


def slow_square(value: int) -> int:
    time.sleep(0.002 * (value % 5))  # they end in another order than they began
    return value * value


def process_of(value: int) -> int:
    return os.getpid()


def parent_of(process_id: int) -> int:
    """Return the parent of a process."""
    return int(Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[1])


def children_of(process_id: int) -> list[int]:
    """Return the processes that a process has started and that still run."""
    running = [int(folder.name) for folder in Path("/proc").iterdir() if folder.name.isdigit()]
    found = []
    for each in running:
        with suppress(OSError):  # it has just ended
            if parent_of(each) == process_id:
                found.append(each)
    return found


def fail_at_three(value: int) -> int:
    if value == 3:
        raise ValueError("three")
    return value


def die_at_three(value: int) -> int:
    """Crash as a library does."""
    if value == 3:
        os.kill(os.getpid(), signal.SIGSEGV)
    return value


def thread_of(barrier: threading.Barrier | None = None) -> str:
    """Return the name of the thread, once as many as the barrier wants are there."""
    if barrier is not None:
        barrier.wait(PATIENCE_S)
    return threading.current_thread().name


def die(value: int) -> int:
    os._exit(7)


def sleep(seconds: float) -> None:
    time.sleep(seconds)


def print_something(value: int) -> int:
    sys.stdout.write("from Python\n")
    os.write(1, b"from C\n")
    return len(sys.stdin.read()) + value


class OddError(Exception):
    """An error that pickle cannot bring back."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(f"{code}: {reason}")


def fail_oddly(value: int) -> int:
    raise OddError(value, "odd")


def unpicklable(value: int) -> Callable[[], int]:
    return lambda: value


def threads_of(value: int) -> dict[str, object]:
    """Return how many threads the libraries may use in this process, and GDAL's settings."""
    import cv2
    import rasterio.env

    names = ("GDAL_NUM_THREADS", "CPL_VSIL_CURL_CACHE_SIZE", "GDAL_HTTP_TIMEOUT")
    return {
        "cv2": cv2.getNumThreads(),
        "blas": os.environ.get("OPENBLAS_NUM_THREADS"),
        **{name: rasterio.env.get_gdal_config(name) for name in names},
    }


class Counting(Executor):
    """Threads, and how many calls they had at most at a time."""

    def __init__(self) -> None:
        self.pool = ThreadPoolExecutor(4)
        self.lock = threading.Lock()
        self.open = self.most = 0

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        with self.lock:
            self.open += 1
            self.most = max(self.most, self.open)
        future = self.pool.submit(fn, *args, **kwargs)
        future.add_done_callback(self._done)
        return future

    def _done(self, future: Future[Any]) -> None:
        with self.lock:
            self.open -= 1


class Shuffled(Executor):
    """Does calls in a random order, one at a time, once it holds so many, or has waited for more in vain."""

    def __init__(self, seed: int, holds: int = 4) -> None:
        self._random = random.Random(seed)
        self._holds = holds
        self._held: list[tuple[Future[Any], Callable[[], Any]]] = []
        self._changed = threading.Condition()
        self._ended = False
        self.order: list[int] = []
        self._count = 0
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        future: Future[T] = Future()
        with self._changed:
            number, self._count = self._count, self._count + 1

            def call() -> T:
                self.order.append(number)
                return fn(*args, **kwargs)

            self._held.append((future, call))
            self._changed.notify()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: len(self._held) >= self._holds or self._ended, timeout=0.05)
                if not self._held:
                    if self._ended:
                        return
                    continue
                future, call = self._held.pop(self._random.randrange(len(self._held)))
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(call())
                except Exception as error:
                    future.set_exception(error)


def is_running(process_id: int) -> bool:
    """Tell whether a process is there and no zombie, which waits for a parent that does not ask."""
    try:
        state = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_for_end(process_ids: list[int]) -> None:
    """Return once none of the processes runs any more."""
    for _ in range(10 * PATIENCE_S):
        if not any(is_running(process_id) for process_id in process_ids):
            return
        time.sleep(0.1)
    raise AssertionError(f"still running: {[each for each in process_ids if is_running(each)]}")


def wait_for_end_of_group(group: int) -> None:
    """Return once no process of the group is left."""
    for _ in range(10 * PATIENCE_S):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    raise AssertionError("processes are left")
