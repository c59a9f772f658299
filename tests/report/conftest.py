"""The maker of registrations, and pages of text alone, as fixtures."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from pcwlad_geo.registration.result import Registration
from tests.pictures import no_pictures
from tests.registrations import make_registration


@pytest.fixture
def registration() -> Callable[..., Registration]:
    """Maker of registrations."""
    return make_registration


@pytest.fixture
def text_alone() -> Iterator[None]:
    """Leave pictures out of the pages of a test that is about their text."""
    with no_pictures():
        yield
