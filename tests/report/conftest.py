"""The maker of registrations as a fixture."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pcwlad_geo.registration.result import Registration
from tests.registrations import make_registration


@pytest.fixture
def registration() -> Callable[..., Registration]:
    """Maker of registrations."""
    return make_registration
