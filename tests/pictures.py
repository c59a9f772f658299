"""Pages without their pictures, which cost more than the matching of a small pair."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

BLANK = "no picture"


@contextmanager
def no_pictures() -> Iterator[None]:
    """Leave figures and views out of the pages that this process writes, for tests that ask for none."""
    from pcwlad_geo.multi.stack import page as stack_page  # slow to load
    from pcwlad_geo.multi.watch import page as watch_page
    from pcwlad_geo.report import page, proof_page

    with pytest.MonkeyPatch.context() as patch:
        for module in (page, proof_page, stack_page, watch_page):
            for name in dir(module):
                if name.endswith("_figure"):
                    patch.setattr(module, name, lambda *_, **__: BLANK)
        patch.setattr(watch_page, "motion_figure", lambda *_, **__: (BLANK, (0.0, 0.0, 1.0, 1.0)))
        for module in (page, stack_page):
            patch.setattr(module, "pair_views", lambda *_, **__: [])
        yield


@pytest.fixture(scope="module", autouse=True)
def without_pictures() -> Iterator[None]:
    """Leave them out of all tests of the module, or of the room whose conftest imports this."""
    with no_pictures():
        yield


@pytest.fixture
def text_alone() -> Iterator[None]:
    """Leave them out in a test that is about other things, in a room or module whose pages have them."""
    with no_pictures():
        yield
