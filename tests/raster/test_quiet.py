from __future__ import annotations

import threading
import warnings

import pytest

from pcwlad_geo.raster.gdal import ignoring
from tests.patience import PATIENCE_S


def test_other_warnings_are_seen() -> None:
    with ignoring(UserWarning):
        warnings.warn("expected", UserWarning, stacklevel=1)
        with ignoring(UserWarning), pytest.raises(DeprecationWarning):
            warnings.warn("not expected", DeprecationWarning, stacklevel=1)


def test_two_threads_leave_the_filters_as_they_were() -> None:
    """The second enters while the first is inside, and would leave after it: it has to wait."""
    before = list(warnings.filters)
    asked, entered = threading.Event(), threading.Event()

    def other() -> None:
        asked.set()
        with ignoring(UserWarning):
            entered.set()

    thread = threading.Thread(target=other)
    with ignoring(UserWarning):
        thread.start()
        assert asked.wait(PATIENCE_S)
        assert not entered.wait(0.2)
    thread.join(PATIENCE_S)
    assert entered.is_set()
    assert list(warnings.filters) == before
