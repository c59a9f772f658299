"""Warnings of the libraries that are expected, ignored by one thread at a time."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

# The filters belong to the process: of two threads that swap them, the later one would put back the other's.
_filters = threading.RLock()


@contextmanager
def ignoring(category: type[Warning]) -> Iterator[None]:
    """Ignore the warnings of a category for as long as the context lasts; other threads wait for its end."""
    with _filters, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield
